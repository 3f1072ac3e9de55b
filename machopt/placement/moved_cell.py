"""Cell with the workpiece and its fixtures, or the robot and its base, at another place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.data_types.cell import Cell, CollisionShape
from machopt.errors import InputError, suggest_nearest_word
from machopt.kinematics.machine import load_machine
from machopt.kinematics.machine_lines import LinkCarriers
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, invert_transform
from machopt.placement.search_options import PlacementOptions, PlacementShift


@dataclass(frozen=True)
class MovedBodies:
    """Moved bodies: the workpiece or base_link, and obstacles by name."""

    base: bool
    names: frozenset[str]
    centre: Array  # (3,) m in world: rotations are about the vertical through it
    frames: Mapping[str, Array] = field(default_factory=dict)  # link: (4, 4) in world, all joints at home; not "world"

    def transform_in_link(self, link: str, S: Array) -> Array:
        """Return (4, 4) a shift of the world expressed in a link that carries moved bodies.

        Args:
            link: name of the link.
            S: (4, 4) shift in world.
        """
        T = self.frames.get(link)
        return S if T is None else np.asarray(invert_transform(T) @ S @ T)


def move_cell(cell: Cell, carried: MovedBodies, shift: PlacementShift) -> Cell:
    """Return the cell at a place; everything else is unchanged.

    Args:
        cell: cell to move.
        carried: moved bodies.
        shift: shift of the place.
    """
    S = shift.build_matrix(carried.centre)
    obstacles = tuple(
        _move_shape(o, carried.transform_in_link(o.link, S)) if o.name in carried.names else o for o in cell.obstacles
    )
    if carried.base:
        return replace(cell, T_world_base=S @ cell.T_world_base, obstacles=obstacles)
    within = carried.transform_in_link(cell.workpiece.link, S)
    part = replace(cell.workpiece, T_link_workpiece=within @ cell.workpiece.T_link_workpiece)
    return replace(cell, workpiece=part, obstacles=obstacles)


def _move_shape(shape: CollisionShape, S: Array) -> CollisionShape:
    return replace(shape, T_parent_shape=S @ shape.T_parent_shape)


def check_robot_movable(cell: Cell, *, base: bool) -> None:
    """Refuse to move a robot in a cell with external axes, where robot or workpiece are on moving links.

    Args:
        cell: robot cell.
        base: whether the robot is to be moved.

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


def compute_link_frames(cell: Cell) -> dict[str, Array]:
    """Return the (4, 4) frames in world of the links that carry workpiece and obstacles, all joints at home.

    Args:
        cell: robot cell.
    """
    links = sorted({cell.workpiece.link, *(o.link for o in cell.obstacles)} - {"world"})
    if not links:
        return {}
    machine = load_machine(cell, load_robot(cell))
    carriers = LinkCarriers(cell, machine)
    R, p = machine.compute_links(np.append(np.zeros(6), cell.external_home)[None])
    out = {}
    for link in links:
        number, T = carriers.locate_link(link)
        hall, own = (
            build_transform(R[0, machine.world_link], p[0, machine.world_link]),
            build_transform(R[0, number], p[0, number]),
        )
        out[link] = np.asarray(cell.T_world_base @ invert_transform(hall) @ own @ T)
    return out


def compute_rotation_centre(
    cell: Cell, positions: Array, *, base: bool, frames: Mapping[str, Array] | None = None
) -> Array:
    """Return (3,) m in world: base_link's origin, or the middle of all toolpaths.

    Args:
        cell: robot cell.
        positions: (N, 3) m, points of all toolpaths in the workpiece frame.
        base: whether the robot is moved.
        frames: frames of the links as of :func:`compute_link_frames`; None: computed where needed.
    """
    if base:
        return np.asarray(cell.T_world_base[:3, 3])
    T = cell.workpiece.T_link_workpiece
    T = T if cell.workpiece.link == "world" else (frames or compute_link_frames(cell))[cell.workpiece.link] @ T
    return np.asarray(T[:3, :3] @ (0.5 * (positions.min(axis=0) + positions.max(axis=0))) + T[:3, 3])


def select_moved_obstacles(cell: Cell, search: PlacementOptions, holding: frozenset[str]) -> frozenset[str]:
    """Return the obstacles that move along: those the user names, else those that support the workpiece or the robot.

    Fixtures of the cell's work offsets are defined in its frames and always move with the workpiece.

    Args:
        cell: robot cell.
        search: options with ``carry`` and ``stay``.
        holding: obstacles that support the moved body.

    Raises:
        InputError: the cell has no obstacle of that name, or it is on another link than the workpiece.
    """
    have = {o.name: o.link for o in cell.obstacles}
    link = "world" if search.base else cell.workpiece.link
    for option, names in (("--carry", search.carry or ()), ("--stay", search.stay)):
        for name in names:
            if name not in have:
                raise InputError(
                    f"the cell has no obstacle {name!r}; {suggest_nearest_word(name, list(have))}", where=option
                )
            if option == "--stay" and name in cell.fixtures and not search.base:
                raise InputError(
                    f"{name} is in a work offset, which moves with the workpiece; obstacles of the cell would work",
                    where=option,
                )
            if option == "--carry" and have[name] != link:
                raise InputError(
                    f"{name} is on {have[name]}, what moves on {link}; an obstacle on {link} would work",
                    where=option,
                )
    along = holding if search.carry is None else frozenset(search.carry)
    along = frozenset(name for name in along if have[name] == link) - frozenset(search.stay)
    return along if search.base else along | frozenset(cell.fixtures)
