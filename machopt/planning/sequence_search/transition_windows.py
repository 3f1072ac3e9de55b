"""What a step between two stations may do and what a vertex costs, on the grid of
:mod:`machopt.planning.sequence_search.dynamic_programming`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import AXIS_SPEED, ObjectiveTerms, compute_node_cost
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.configurations import CandidateGrid
from machopt.planning.stations.planning_path import PlanningPath

Ints = NDArray[np.int32]
TURNING = AXIS_SPEED  # share of the slowest axis's velocity limit that rotation about the tool axis may take
MAX_TURN = np.radians(80.0)  # of the rotation between neighbouring stations
FREE, LIFT = -1, -2


def compute_widest_window(rotations: int) -> int:
    """Grid steps that the rotation may turn between neighbouring stations at most."""
    return max(1, int(MAX_TURN * rotations / (2 * np.pi) + 1e-6))


def compute_transition_windows(
    path: PlanningPath, candidates: CandidateGrid, slowest: float, wide: NDArray[np.bool_] | None = None
) -> tuple[Ints, Array]:
    """Window of the step into each station, and the time the axes have for it.

    FREE over rapid moves, else grid steps of rotation, 0 keeps it. On dense paths a grid step would take longer than
    the way from station to station, so rotation may only change at ticks, as far apart as a grid step takes. Where
    nothing else leads on (``wide``), it may change from any station to the next, and the feed waits for it.
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
            out[s] = 0  # made only of plunges: the rotation is kept
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
    """(S,) grid steps from a station's phi to the phi of the station before that points TCP x the same way."""
    st = path.stations
    reference, axis = path.reference[st], path.axis[st]
    before = np.roll(reference, 1, axis=0)
    angle = np.arctan2(np.sum(np.cross(before, reference) * -axis, axis=1), np.sum(before * reference, axis=1))
    return np.asarray(np.round(angle / (2 * np.pi / rotations)), dtype=np.int32)


def vertex_price(terms: ObjectiveTerms, candidates: CandidateGrid, scores: CandidateScores) -> Array:
    """(S, R, B) price of a vertex: its share of the mean index, and the preferred rotation."""
    cost = np.where(np.isfinite(scores.cost), scores.cost, 0.0) / scores.scale
    liked = terms.liked(candidates.phi_at().T).T[:, :, None]
    if scores.crowded is not None:
        liked = liked + terms.weights.clearance * scores.crowded
    return np.ascontiguousarray(compute_node_cost(cost, liked, terms.weights.mean) * terms.share[:, None, None])
