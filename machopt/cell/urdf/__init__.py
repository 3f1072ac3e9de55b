"""URDF, read strictly and by standard means only: nothing of it is dropped without a word."""

from machopt.cell.urdf.arm_detection import ArmLinks, TooManyJointsError, find_arm
from machopt.cell.urdf.element_removal import remove_bodies, remove_model_bodies
from machopt.cell.urdf.mesh_lookup import ErrorFactory, MeshLocation, find_mesh, find_package
from machopt.cell.urdf.robot_description import (
    RobotDescription,
    find_standalone_package,
    read_description,
    read_robot,
    read_standalone_description,
)
from machopt.cell.urdf.urdf_model import UrdfJoint, UrdfLink, UrdfMesh, UrdfModel, UrdfSolid
from machopt.cell.urdf.urdf_reader import read_urdf

__all__ = [
    "ArmLinks",
    "ErrorFactory",
    "MeshLocation",
    "RobotDescription",
    "TooManyJointsError",
    "UrdfJoint",
    "UrdfLink",
    "UrdfMesh",
    "UrdfModel",
    "UrdfSolid",
    "find_arm",
    "find_mesh",
    "find_package",
    "find_standalone_package",
    "read_description",
    "read_robot",
    "read_standalone_description",
    "read_urdf",
    "remove_bodies",
    "remove_model_bodies",
]
