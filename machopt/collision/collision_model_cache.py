"""Collision models that a process needs again: building one takes longer than planning a short toolpath."""

from __future__ import annotations

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell, select_geometry
from machopt.kinematics.robot import LinkShape, Robot
from machopt.numerics.content_cache import ContentCache

MODELS: ContentCache[CollisionModel] = ContentCache()
"""Models as they were built. Distances that a job measures stay in its own copy."""


def load_collision_model(
    cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...], clearance: float, *, still: bool = False
) -> CollisionModel:
    """Return a new collision model, or a copy of one of the same content; see :class:`CollisionModel`.

    Args:
        cell: tool, workpiece, obstacles, T_world_base and external joints.
        robot: kinematics of the arm.
        shapes: the URDF's collision bodies, from :func:`machopt.kinematics.urdf_loading.load_chain`.
        clearance: m, required distance.
        still: the external joints are fixed at home.

    Raises:
        InputError: a mesh cannot be read, or the external joints form no chain.
    """
    inputs = (select_geometry(cell), cell.urdf_text, robot, shapes, clearance, still)
    return MODELS.get(inputs, lambda: CollisionModel(cell, robot, shapes, clearance, still=still)).copy_unused()
