"""Pairs of bodies that touch by construction: selected by the planner, listed in the manifest, confirmed here.

Two samplings of random poses would disagree about a pair whose share of poses in contact lies near the limit. So the
verifier takes the planner's list. It confirms each entry with its own geometry and poses at a lower limit. An entry
that is not confirmed is checked like any other pair, and named.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.cell import Cell
from machopt.numerics.array_types import Array
from machopt.verification.motion.collision.bodies import CoalBody, invert_transforms, is_near
from machopt.verification.motion.collision.checked_pairs import (
    COARSE,
    RANDOM_POSES,
    TOUCHING,
    is_two_apart,
    list_candidate_pairs,
    sample_random_placements,
)
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs as verification_list_checked_pairs
from machopt.verification.motion.collision.gouge_check import find_deepest_point
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

EXTRA_POSES, UNCERTAIN_SHARE = 1000, 0.15  # poses where the share is so near to its limit


def list_checked_pairs(
    cell: Cell,
    arm: UrdfKinematics,
    bodies: list[CoalBody],
    clearance: float,
    touching: Sequence[tuple[str, str]] | None,
) -> tuple[list[tuple[CoalBody, CoalBody]], list[str]]:
    """Return the pairs that must not touch, and the names of listed pairs that do not touch by construction.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
        clearance: Required clearance, m.
        touching: Names of bodies as the manifest lists them. None: the manifest lists none (a folder of an earlier
            version), and the pairs are selected here.
    """
    if touching is None:
        return verification_list_checked_pairs(cell, arm, bodies, clearance), []
    listed = {frozenset(pair) for pair in touching}
    out, robot = list_candidate_pairs(cell, arm, bodies)
    known = {frozenset((a.name, b.name)) for a, b in robot}
    unfounded = [" ~ ".join(sorted(pair)) for pair in listed - known]  # no pair of the arm that could be left out
    for a, b in robot:
        if frozenset((a.name, b.name)) in listed:
            if _is_touching_by_construction(cell, arm, a, b, clearance):
                continue
            unfounded.append(f"{a.name} ~ {b.name}")
        out.append((a, b))
    return out, unfounded


def _is_touching_by_construction(cell: Cell, arm: UrdfKinematics, a: CoalBody, b: CoalBody, clearance: float) -> bool:
    limits = [(clearance, TOUCHING)] + ([(0.0, COARSE)] if is_two_apart(a, b) else [])
    for distance, least in limits:
        share = _compute_contact_share(a, b, sample_random_placements(cell, arm, a, b, RANDOM_POSES), distance)
        if abs(share - least) < UNCERTAIN_SHARE:
            share = _compute_contact_share(a, b, sample_random_placements(cell, arm, a, b, EXTRA_POSES), distance)
        if share > least:
            return True
    return False


def _compute_contact_share(a: CoalBody, b: CoalBody, T: Array, distance: float) -> float:
    """Share of placements T (S, 4, 4) of b seen from a in which they touch, or one is inside the other."""
    touch = np.array([is_near(a, b, x, distance) for x in T])
    for n in np.flatnonzero(~touch).tolist():
        touch[n] = _is_inside(a, b, T[n]) or _is_inside(b, a, invert_transforms(T[n]))
    return float(touch.mean())


def _is_inside(outer: CoalBody, inner: CoalBody, T: Array) -> bool:
    """A point of the surface of ``inner`` is inside ``outer``; their surfaces do not cross."""
    centre = inner.place[:3, :3] @ inner.box_centre + inner.place[:3, 3]
    seen = invert_transforms(outer.place) @ T
    if (np.abs(seen[:3, :3] @ centre + seen[:3, 3] - outer.box_centre) > outer.half_size).any():
        return False
    return find_deepest_point(outer, centre[None], T[None], 0.0)[0] > 0.0
