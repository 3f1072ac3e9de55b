"""The cell with the workpiece and what holds it, or the robot and what it stands on, somewhere else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell, Shape
from machopt.errors import InputError, nearest
from machopt.model.lines import Carriers
from machopt.model.machine import load_machine
from machopt.model.robot import load_robot
from machopt.placement.asked import Search, Shift
from machopt.se3 import inverse, transform


@dataclass(frozen=True)
class Carried:
    """What moves: the workpiece or base_link, and obstacles by name."""

    base: bool
    names: frozenset[str]
    centre: Array  # (3,) m in world: a turn is about the vertical through it
    frames: Mapping[str, Array] = field(default_factory=dict)  # link: (4, 4) in world, all joints at home; not "world"

    def within(self, link: str, S: Array) -> Array:
        """(4, 4) what a shift S of the world is within a link that carries what moves."""
        T = self.frames.get(link)
        return S if T is None else np.asarray(inverse(T) @ S @ T)


def moved(cell: Cell, carried: Carried, shift: Shift) -> Cell:
    """The cell at a place; everything else stays as it is."""
    S = shift.matrix(carried.centre)
    obstacles = tuple(_moved(o, carried.within(o.link, S)) if o.name in carried.names else o for o in cell.obstacles)
    if carried.base:
        return replace(cell, T_world_base=S @ cell.T_world_base, obstacles=obstacles)
    within = carried.within(cell.workpiece.link, S)
    part = replace(cell.workpiece, T_link_workpiece=within @ cell.workpiece.T_link_workpiece)
    return replace(cell, workpiece=part, obstacles=obstacles)


def _moved(shape: Shape, S: Array) -> Shape:
    return replace(shape, T_parent_shape=S @ shape.T_parent_shape)


def refuse(cell: Cell, *, base: bool) -> None:
    """Refuse a robot that is asked to move and stands on, or beside, what moves by itself.

    Raises:
        InputError: with what would work.
    """
    if base and (cell.external_joints or cell.workpiece.link != "world"):
        raise InputError(
            "robot.pose is that of the whole tree in a cell with external axes, so that moving it moves everything; "
            "moving the workpiece (--move workpiece) would work",
            file=cell.folder / "cell.yaml",
            where="robot.external_joints" if cell.external_joints else "workpiece.link",
        )


def frames_of(cell: Cell) -> dict[str, Array]:
    """(4, 4) in world of the links on which workpiece and obstacles stand, all joints at home."""
    links = sorted({cell.workpiece.link, *(o.link for o in cell.obstacles)} - {"world"})
    if not links:
        return {}
    machine = load_machine(cell, load_robot(cell))
    carriers = Carriers(cell, machine)
    R, p = machine.links(np.append(np.zeros(6), cell.external_home)[None])
    out = {}
    for link in links:
        number, T = carriers.place(link)
        hall, own = transform(R[0, machine.hall], p[0, machine.hall]), transform(R[0, number], p[0, number])
        out[link] = np.asarray(cell.T_world_base @ inverse(hall) @ own @ T)
    return out


def centre_of(cell: Cell, positions: Array, *, base: bool, frames: Mapping[str, Array] | None = None) -> Array:
    """(3,) m in world: base_link's origin, or the middle of all toolpaths, (N, 3) m in workpiece."""
    if base:
        return np.asarray(cell.T_world_base[:3, 3])
    T = cell.workpiece.T_link_workpiece
    T = T if cell.workpiece.link == "world" else (frames or frames_of(cell))[cell.workpiece.link] @ T
    return np.asarray(T[:3, :3] @ (0.5 * (positions.min(axis=0) + positions.max(axis=0))) + T[:3, 3])


def named(cell: Cell, search: Search, holding: frozenset[str]) -> frozenset[str]:
    """The obstacles that move along: those the user names, else what holds the workpiece or the robot.

    Fixtures of the cell's work offsets stand in its frames and always move with the workpiece.

    Raises:
        InputError: the cell has no obstacle of that name, or it stands on another link than the workpiece.
    """
    have = {o.name: o.link for o in cell.obstacles}
    link = "world" if search.base else cell.workpiece.link
    for option, names in (("--carry", search.carry or ()), ("--stay", search.stay)):
        for name in names:
            if name not in have:
                raise InputError(f"the cell has no obstacle {name!r}; {nearest(name, list(have))}", where=option)
            if option == "--stay" and name in cell.fixtures and not search.base:
                raise InputError(
                    f"{name} stands in a work offset, which moves with the workpiece; obstacles of the cell would work",
                    where=option,
                )
            if option == "--carry" and have[name] != link:
                raise InputError(
                    f"{name} stands on {have[name]}, what moves on {link}; an obstacle on {link} would work",
                    where=option,
                )
    along = holding if search.carry is None else frozenset(search.carry)
    along = frozenset(name for name in along if have[name] == link) - frozenset(search.stay)
    return along if search.base else along | frozenset(cell.fixtures)
