"""URDF, read strictly and by standard means only: nothing of it is dropped without a word."""

from machopt.formats.urdf.meshes import Fail, FoundMesh, find_mesh
from machopt.formats.urdf.read import read_urdf
from machopt.formats.urdf.tree import Urdf, UrdfJoint, UrdfLink, UrdfMesh, UrdfSolid

__all__ = ["Fail", "FoundMesh", "Urdf", "UrdfJoint", "UrdfLink", "UrdfMesh", "UrdfSolid", "find_mesh", "read_urdf"]
