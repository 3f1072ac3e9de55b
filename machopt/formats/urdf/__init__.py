"""URDF, read strictly and by standard means only: nothing of it is dropped without a word."""

from machopt.formats.urdf.arm import ArmLinks, find_arm
from machopt.formats.urdf.describe import Description, describe, describe_alone, package_alone, read_robot
from machopt.formats.urdf.meshes import Fail, FoundMesh, find_mesh, find_package
from machopt.formats.urdf.read import read_urdf
from machopt.formats.urdf.tree import Urdf, UrdfJoint, UrdfLink, UrdfMesh, UrdfSolid
from machopt.formats.urdf.without import remove_bodies, without_bodies

__all__ = [
    "ArmLinks",
    "Description",
    "Fail",
    "FoundMesh",
    "Urdf",
    "UrdfJoint",
    "UrdfLink",
    "UrdfMesh",
    "UrdfSolid",
    "describe",
    "describe_alone",
    "find_arm",
    "find_mesh",
    "find_package",
    "package_alone",
    "read_robot",
    "read_urdf",
    "remove_bodies",
    "without_bodies",
]
