"""Mesh files: whole, of a type that planner and verifier both load, a body, and of a size that fits the robot."""

from machopt.cell.mesh.body_size_check import SceneSize, SizedBody, check_body_size
from machopt.cell.mesh.closed_surface_check import MeshSurface, find_open_surfaces, read_collada_surface, read_surface
from machopt.cell.mesh.mesh_errors import ErrorFactory
from machopt.cell.mesh.second_library_check import find_collada_original

__all__ = [
    "ErrorFactory",
    "MeshSurface",
    "SceneSize",
    "SizedBody",
    "check_body_size",
    "find_collada_original",
    "find_open_surfaces",
    "read_collada_surface",
    "read_surface",
]
