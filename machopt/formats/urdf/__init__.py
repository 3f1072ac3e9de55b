"""URDF, read strictly and by standard means only: nothing of it is dropped without a word."""

from machopt.formats.urdf.describe import Description, describe, read_robot
from machopt.formats.urdf.meshes import Fail, FoundMesh, find_mesh, find_package
from machopt.formats.urdf.read import read_urdf
from machopt.formats.urdf.tree import Urdf, UrdfJoint, UrdfLink, UrdfMesh, UrdfSolid

__all__ = [
    "Description",
    "Fail",
    "FoundMesh",
    "Urdf",
    "UrdfJoint",
    "UrdfLink",
    "UrdfMesh",
    "UrdfSolid",
    "describe",
    "find_mesh",
    "find_package",
    "read_robot",
    "read_urdf",
]
