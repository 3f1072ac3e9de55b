"""The cell with the workpiece and what holds it, or the robot and what it stands on, somewhere else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell, Shape
from machopt.errors import InputError, nearest
from machopt.placement.asked import Search, Shift


@dataclass(frozen=True)
class Carried:
    """What moves: the workpiece or base_link, and obstacles by name."""

    base: bool
    names: frozenset[str]
    centre: Array  # (3,) m in world: a turn is about the vertical through it


def moved(cell: Cell, carried: Carried, shift: Shift) -> Cell:
    """The cell at a place; everything else stays as it is."""
    S = shift.matrix(carried.centre)
    obstacles = tuple(_moved(o, S) if o.name in carried.names else o for o in cell.obstacles)
    if carried.base:
        return replace(cell, T_world_base=S @ cell.T_world_base, obstacles=obstacles)
    part = replace(cell.workpiece, T_link_workpiece=S @ cell.workpiece.T_link_workpiece)
    return replace(cell, workpiece=part, obstacles=obstacles)


def _moved(shape: Shape, S: Array) -> Shape:
    return replace(shape, T_parent_shape=S @ shape.T_parent_shape)


def refuse(cell: Cell) -> None:
    """Refuse cells whose workpiece or robot stands on something that moves by itself.

    Raises:
        InputError: with what would work.
    """
    if cell.offsets:
        raise InputError(
            f"the cell has work offsets ({', '.join(cell.offsets)}), and the setups of one job are not moved together "
            "here; a cell with one setup would work",
            file=cell.folder / "cell.yaml",
            where="offsets",
        )
    if cell.external_joints or cell.workpiece.link != "world":
        raise InputError(
            "placement moves a workpiece or a robot that stands in the world; where external axes carry it, machopt "
            "optimize chooses their values",
            file=cell.folder / "cell.yaml",
            where="robot.external_joints" if cell.external_joints else "workpiece.link",
        )


def centre_of(cell: Cell, positions: Array, *, base: bool) -> Array:
    """(3,) m in world: base_link's origin, or the middle of all toolpaths, (N, 3) m in workpiece."""
    if base:
        return np.asarray(cell.T_world_base[:3, 3])
    T = cell.workpiece.T_link_workpiece
    return np.asarray(T[:3, :3] @ (0.5 * (positions.min(axis=0) + positions.max(axis=0))) + T[:3, 3])


def named(cell: Cell, search: Search, holding: frozenset[str]) -> frozenset[str]:
    """The obstacles that move along: those the user names, else what holds the workpiece or the robot.

    Raises:
        InputError: the cell has no obstacle of that name.
    """
    have = [o.name for o in cell.obstacles]
    for option, names in (("--carry", search.carry or ()), ("--stay", search.stay)):
        for name in names:
            if name not in have:
                raise InputError(f"the cell has no obstacle {name!r}; {nearest(name, have)}", where=option)
    along = holding if search.carry is None else frozenset(search.carry)
    return along - frozenset(search.stay)
