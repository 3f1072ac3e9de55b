"""URDF, read strictly and by standard means only: nothing of it is dropped without a word."""

from machopt.formats.urdf.expand import expand, is_xacro
from machopt.formats.urdf.meshes import Fail, FoundMesh, find_mesh, find_package
from machopt.formats.urdf.read import read_urdf
from machopt.formats.urdf.tree import Urdf, UrdfJoint, UrdfLink, UrdfMesh, UrdfSolid

__all__ = [
    "Fail",
    "FoundMesh",
    "Urdf",
    "UrdfJoint",
    "UrdfLink",
    "UrdfMesh",
    "UrdfSolid",
    "expand",
    "find_mesh",
    "find_package",
    "is_xacro",
    "read_urdf",
]
