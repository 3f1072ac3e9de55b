"""Pairs of bodies whose distance is checked."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.numerics.array_types import Array
from machopt.verification.motion.collision.bodies import CoalBody, invert_transforms, is_near
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

RANDOM_POSES = 120  # random poses that tell link pairs that touch by construction
TOUCHING, COARSE = 0.90, 0.40  # share of them in touch: any pair; links two apart (their meshes often overlap)


def list_checked_pairs(
    cell: Cell, arm: UrdfKinematics, bodies: list[CoalBody], clearance: float = 0.0
) -> list[tuple[CoalBody, CoalBody]]:
    """Return the pairs that must not touch: (fixed or lower body, moving or higher body).

    Robot bodies from link 2 on are paired with workpiece and obstacles. Links and tool are paired with links at least
    two apart. The cutter is paired with obstacles and links 0 … 5, and, shortened, with the workpiece. External
    joints add the pairs of :func:`_list_external_pairs`.

    Excluded are pairs that touch in most random poses, like link 1 and the robot's pedestal. Excluded are also pairs
    that are always nearer than ``clearance``, and those that the cell allows to touch.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
        clearance: Required clearance, m.
    """
    out, robot = list_candidate_pairs(cell, arm, bodies)
    for a, b in robot:
        T = sample_random_placements(cell, arm, a, b, RANDOM_POSES)
        if np.mean([is_near(a, b, x, clearance) for x in T]) > TOUCHING:
            continue
        if not (is_two_apart(a, b) and np.mean([is_near(a, b, x) for x in T]) > COARSE):
            out.append((a, b))
    return out


def list_candidate_pairs(
    cell: Cell, arm: UrdfKinematics, bodies: list[CoalBody]
) -> tuple[list[tuple[CoalBody, CoalBody]], list[tuple[CoalBody, CoalBody]]]:
    """Return pairs that are always checked, and pairs of robot and tool that may touch by construction.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
    """
    may = list_allowed_contacts(cell)
    out: list[tuple[CoalBody, CoalBody]] = []
    robot = _list_external_pairs(arm, bodies, may) if cell.external_joints else []
    for a in bodies:
        for b in bodies:
            if (a.name, b.name) in may:
                continue
            if a.kind == "link" and a.link < 0:
                out += [(a, b)] if b.kind == "cutter" else []
            elif a.kind in ("workpiece", "obstacle"):
                if b.kind in ("cutter", "grazing"):
                    wanted = (b.kind == "grazing") == (a.kind == "workpiece")
                    out += [(a, b)] if wanted else []
                elif b.link >= 1:
                    (out if b.link >= 2 else robot).append((a, b))
            elif a.kind == "link" and b.kind == "cutter" and a.link <= 5:
                (out if a.link <= 4 else robot).append((a, b))
            elif a.kind == "link" and b.kind in ("link", "tool") and b.link - a.link >= 2:
                robot.append((a, b))
    return out, robot


def is_two_apart(a: CoalBody, b: CoalBody) -> bool:
    """Return whether exactly one link lies between two bodies of the arm; meshes of such links often overlap.

    Args:
        a: The first body.
        b: The second body.
    """
    return a.kind == "link" and a.link >= 0 and b.link - a.link == 2 and b.kind != "cutter"


def sample_random_placements(cell: Cell, arm: UrdfKinematics, a: CoalBody, b: CoalBody, count: int) -> Array:
    """Return (count, 4, 4) poses of b's carrier in a's carrier at random joint positions, other than the planner's.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        a: The first body.
        b: The second body.
        count: Number of poses.
    """
    rng = np.random.default_rng(20)
    lower, upper = cell.limits.lower, cell.limits.upper
    x = lower + (upper - lower) * rng.random((count, len(lower)))
    world = arm.compute_placements(x[:, :6], x[:, 6:])
    return np.asarray(
        world[:, b.carrier] if a.carrier < 0 else invert_transforms(world[:, a.carrier]) @ world[:, b.carrier]
    )


def _list_external_pairs(
    arm: UrdfKinematics, bodies: list[CoalBody], may: set[tuple[str, str]]
) -> list[tuple[CoalBody, CoalBody]]:
    """Pairs beyond those of an arm on a floor, by which joints lie between the two bodies.

    What is fixed in the hall or rides on a positioner (a machine's link, the part, an obstacle) against base and link 1
    of the arm, and against each other; a machine's own links against the arm's others and the tool too. Two links of
    one machine are neighbours with a single joint between them; a part on a turning table can meet its cheeks.
    """
    things = [b for b in bodies if b.link < 0]
    out = []
    for n, a in enumerate(things):
        low = a.kind == "link"
        rivals = [b for b in bodies if b.kind == "link" and b.link >= 0 and (low or b.link == 0)]
        rivals += [b for b in bodies if low and b.kind == "tool"]
        for b in (*rivals, *things[n + 1 :]):
            moved = arm.list_moving_joints(a.carrier), arm.list_moving_joints(b.carrier)
            between = len(moved[0] ^ moved[1])
            links = [x for x in (a, b) if x.kind == "link"]
            if len(links) == 2:
                facing = any(_is_on_workpiece(arm, x) and _is_on_base(arm, y) for x, y in (links, links[::-1]))
                neighbours = between < 2 and not facing
            else:
                neighbours = False
            if between and not neighbours and (a.name, b.name) not in may:
                out.append((b, a) if b.carrier < 0 else (a, b))
    return out


def _is_on_base(arm: UrdfKinematics, body: CoalBody) -> bool:
    """It rides on what carries base_link, or on the arm."""
    return body.link >= (1 if arm.is_workpiece_on_base else 0) or bool(
        arm.list_moving_joints(body.carrier) & arm.list_moving_joints(arm.base)
    )


def _is_on_workpiece(arm: UrdfKinematics, body: CoalBody) -> bool:
    """It rides with the workpiece on a positioner."""
    return bool(arm.list_moving_joints(body.carrier) & arm.list_moving_joints(arm.workpiece_placement))


def list_allowed_contacts(cell: Cell) -> set[tuple[str, str]]:
    """Return the names of body pairs that the cell allows to touch, in both orders.

    Args:
        cell: The robot cell.
    """
    one_way = {(a, b) for pair in cell.may_touch for a in pair.first for b in pair.second}
    return one_way | {(b, a) for a, b in one_way}
