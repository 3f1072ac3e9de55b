"""Which pairs of bodies touch by construction: decided once, by the planner, listed in the manifest, confirmed here.

Two samplings of random poses would disagree about a pair whose share of poses in contact lies near the limit. So the
verifier takes the planner's list, and confirms each entry with its own geometry and its own poses at a lower limit: an
entry that is not confirmed is checked like any other pair, and named.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.verify.arm import Arm
from machopt.verify.bodies import (
    COARSE,
    POSES,
    TOUCHING,
    Body,
    candidate_pairs,
    inverse,
    is_two_apart,
    near,
    pairs,
    random_placements,
)
from machopt.verify.gouge import deepest

MORE_POSES, UNSURE = 1000, 0.15  # poses where the share is so near to its limit


def checked_pairs(
    cell: Cell, arm: Arm, bodies: list[Body], clearance: float, touching: Sequence[tuple[str, str]] | None
) -> tuple[list[tuple[Body, Body]], list[str]]:
    """The pairs that must not touch, and the names of listed pairs that do not touch by construction.

    Args:
        cell, arm, bodies: as for :func:`machopt.verify.bodies.pairs`.
        clearance: m, that the plan keeps.
        touching: names of bodies as the manifest lists them; None: it lists none (a folder of an earlier version), and
            the decision is made here.
    """
    if touching is None:
        return pairs(cell, arm, bodies, clearance), []
    listed = {frozenset(pair) for pair in touching}
    out, robot = candidate_pairs(cell, arm, bodies)
    unfounded = []
    for a, b in robot:
        if frozenset((a.name, b.name)) in listed:
            if _touch_by_construction(cell, arm, a, b, clearance):
                continue
            unfounded.append(f"{a.name} ~ {b.name}")
        out.append((a, b))
    return out, unfounded


def _touch_by_construction(cell: Cell, arm: Arm, a: Body, b: Body, clearance: float) -> bool:
    limits = [(clearance, TOUCHING)] + ([(0.0, COARSE)] if is_two_apart(a, b) else [])
    for distance, least in limits:
        share = _share(a, b, random_placements(cell, arm, a, b, POSES), distance)
        if abs(share - least) < UNSURE:
            share = _share(a, b, random_placements(cell, arm, a, b, MORE_POSES), distance)
        if share > least:
            return True
    return False


def _share(a: Body, b: Body, T: Array, distance: float) -> float:
    """Share of placements T (S, 4, 4) of b seen from a in which they touch, or one is inside the other."""
    touch = np.array([near(a, b, x, distance) for x in T])
    for n in np.flatnonzero(~touch).tolist():
        touch[n] = _holds(a, b, T[n]) or _holds(b, a, inverse(T[n]))
    return float(touch.mean())


def _holds(outer: Body, inner: Body, T: Array) -> bool:
    """A point of the surface of ``inner`` is inside ``outer``; their surfaces do not cross."""
    centre = inner.place[:3, :3] @ inner.middle + inner.place[:3, 3]
    seen = inverse(outer.place) @ T
    if (np.abs(seen[:3, :3] @ centre + seen[:3, 3] - outer.middle) > outer.half).any():
        return False
    return deepest(outer, centre[None], T[None], 0.0)[0] > 0.0
