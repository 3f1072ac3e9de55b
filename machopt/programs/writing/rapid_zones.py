"""How far before and after the end of a joint move a controller may begin to round the corner to the next joint move.

The plan has checked the triangle of the corner w and the places at the shares α and β of the two straight joint moves.
A controller that leaves the first move where the tool comes within a distance d of w, and follows the second one from
where it leaves that distance, stays in the triangle if no place of either move outside of α and β is nearer:

    d = min( min_{t ≥ α} |p(w + t Δ_a) − p(w)|,  min_{t ≥ β} |p(w + t Δ_b) − p(w)| ),      t ≤ 1,

with the tool's place p. It is at most half of the way of the tool along either move, because zones must not overlap.
Where an external axis moves, the distances of rail, table and tool are not comparable, and d is 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from machopt.numerics.array_types import Array

PLACES = 33  # of each move outside of the triangle
HALF = 0.49  # of the distance between the ends of a move
STILL = 1e-9  # m or rad of an external axis


def compute_rapid_zone_limits(
    corner: Array, ends: tuple[Array, Array], share: Array, compute_place: Callable[[Array], Array]
) -> Array:
    """Return (C,) m, the largest d of each corner.

    Args:
        corner: (C, 6 + E) rad or m, joints at the corners.
        ends: the same where the move to each corner begins and where the move from it ends.
        share: (C, 2) α and β.
        compute_place: (S, 6 + E) joints → (S, 3) m, the tool in the workpiece.
    """
    if not len(corner):
        return np.zeros(0)
    most = np.full(len(corner), np.inf)
    here = compute_place(corner)
    for n, end in enumerate(ends):
        t = share[:, n, None] + (1.0 - share[:, n, None]) * np.linspace(0.0, 1.0, PLACES)  # (C, PLACES)
        x = corner[:, None] + t[..., None] * (end - corner)[:, None]
        place = compute_place(x.reshape(-1, corner.shape[1])).reshape(len(corner), PLACES, 3)
        away = np.linalg.norm(place - here[:, None], axis=2)
        most = np.minimum(most, np.minimum(away.min(axis=1), HALF * away[:, -1]))
        most[np.abs(end - corner)[:, 6:].max(axis=1, initial=0.0) > STILL] = 0.0
    return most
