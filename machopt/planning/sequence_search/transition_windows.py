"""Permitted steps between two stations and prices of vertices, on the grid of
:mod:`machopt.planning.sequence_search.dynamic_programming`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import AXIS_SPEED, ObjectiveTerms, compute_node_cost
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stations.planning_path import PlanningPath

Ints = NDArray[np.int32]
TURNING = AXIS_SPEED  # share of the slowest axis's velocity limit available for rotation about the tool axis
MAX_TURN = np.radians(80.0)  # of the rotation between neighbouring stations
FREE, LIFT = -1, -2


def compute_widest_window(rotations: int) -> int:
    """Return the maximum number of grid steps that the rotation may change between neighbouring stations.

    Args:
        rotations: number of rotations of the grid.
    """
    return max(1, int(MAX_TURN * rotations / (2 * np.pi) + 1e-6))


def compute_transition_windows(
    path: PlanningPath, candidates: CandidateGrid, slowest: float, wide: NDArray[np.bool_] | None = None
) -> tuple[Ints, Array]:
    """Return the window of the step into each station, and the time available for it.

    FREE over rapid moves, else grid steps of rotation, 0 keeps it. On dense paths a grid step would take longer than
    the move from station to station. There the rotation may only change at ticks, as far apart as a grid step takes.
    Where
    no edge exists otherwise (``wide``), it may change from any station to the next, at reduced feed.

    Args:
        path: planning points.
        candidates: candidate grid.
        slowest: rad/s, velocity limit of the slowest axis.
        wide: (S,) stations into which the rotation may change at reduced feed; None: none.

    Returns:
        (S,) windows and (S,) s.
    """
    st = path.stations
    tick = 2 * np.pi / len(candidates.phi) / (TURNING * slowest)  # s
    t = path.time[st]
    out = np.zeros(len(st), np.int32)
    seconds = np.diff(t, prepend=t[0])
    same = np.r_[False, path.run[st][1:] == path.run[st][:-1]]
    dropped = np.asarray(~candidates.feasible.any(axis=(1, 2, 3)))
    plunged = np.r_[0, np.cumsum(~path.plunge)]
    since = 0.0
    for s in range(1, len(st)):
        if not same[s]:
            out[s], since = FREE, 0.0
        elif dropped[s - 1]:
            out[s], since = LIFT, 0.0
        elif plunged[st[s] + 1] == plunged[st[s - 1] + 1]:
            out[s] = 0  # plunges only: the rotation is kept
        elif wide is not None and wide[s]:
            out[s] = compute_widest_window(len(candidates.phi))
        else:
            since += seconds[s]
            if since >= 0.999 * tick:
                out[s] = min(int(since / tick + 1e-3), compute_widest_window(len(candidates.phi)))
                seconds[s], since = since, 0.0
    out[0] = FREE
    return out, seconds


def match_tcp_directions(path: PlanningPath, rotations: int) -> Ints:
    """Return (S,) grid steps from a station's phi to the phi of the previous station with the same direction of TCP x.

    Args:
        path: planning points.
        rotations: number of rotations of the grid.
    """
    st = path.stations
    reference, axis = path.reference[st], path.axis[st]
    before = np.roll(reference, 1, axis=0)
    angle = np.arctan2(np.sum(np.cross(before, reference) * -axis, axis=1), np.sum(before * reference, axis=1))
    return np.asarray(np.round(angle / (2 * np.pi / rotations)), dtype=np.int32)


def vertex_price(terms: ObjectiveTerms, candidates: CandidateGrid, scores: CandidateScores) -> Array:
    """Return the (S, R, B) price of a vertex: its share of the mean index, the preferred rotation, and at both ends the
    rapid move from or to home.

    Args:
        terms: terms of J at the stations.
        candidates: candidate grid.
        scores: cost of the candidates.
    """
    cost = np.where(np.isfinite(scores.cost), scores.cost, 0.0) / scores.scale
    preference_price = terms.liked(candidates.phi_at().T).T[:, :, None]
    if scores.crowded is not None:
        preference_price = preference_price + terms.weights.clearance * scores.crowded
    price = compute_node_cost(cost, preference_price, terms.weights.mean) * terms.share[:, None, None]
    if scores.feed_price is not None:
        price = price + scores.feed_price
    if scores.rapid is not None and candidates.usable.any():
        known = np.flatnonzero(candidates.usable.any(axis=(1, 2)))
        for s, end in ((known[0], 0), (known[-1], 1)):
            price[s] = price[s] + np.nan_to_num(scores.rapid.price_ends(candidates.q[s], scores.rapid.ends[end]))
    return np.ascontiguousarray(price if scores.place_price is None else price + scores.place_price)
