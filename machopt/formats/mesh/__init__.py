"""Mesh files: whole, of a type that planner and verifier both load, a body, and of a size that fits the robot."""

from machopt.formats.mesh.fail import Fail
from machopt.formats.mesh.second import original_of
from machopt.formats.mesh.size import Scene, Sized, judge_size
from machopt.formats.mesh.surface import Surface, open_surfaces, read_surface

__all__ = ["Fail", "Scene", "Sized", "Surface", "judge_size", "open_surfaces", "original_of", "read_surface"]
