"""Terms of the objective about rapid moves, recomputed from the joints in points.csv.

Time of a rapid move, with the share s ∈ [0, 1] of the way and the tightest axis' limits V, A, J of ds/dt and its
derivatives: the peak speed p is that of the shortest ramp up and down which covers the whole way, at most V,

    ramp(p) = p/A + A/J  where p ≥ A²/J, else 2·√(p/J),      t = ramp(p) + 1/p,      p·ramp(p) ≤ 1.

p follows by bisection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.verification.folder.result_json.comparison_inputs import (
    CheckedPoints,
    ResultComparison,
    check_equal,
    require_number,
)

SHARE_TOLERANCE = 0.03  # relative: the driven rotation is a little smoother than the planned one
# of J₀ over the index terms of the sequence on the grid, over which J₀ is the lowest, or of a plan with more: stations
# carry the weights of the points between them
INDEX_TOLERANCE = 1.05
STOP_S = 1.0  # added for every rapid move to the time of the job
FASTEST_M_S, UNKNOWN_M_S = 0.3, 0.05  # feeds of the time of the job: the largest that counts, and where none is given
HALVINGS = 60


def check_rapid_terms(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the time of the rapid moves and the number of changes in the objective.

    Args:
        t: Result.json and everything that it is compared with.
    """
    own, w = t.result.objective.chosen, t.options.weights
    share, changes = (
        require_number("chosen.rapid", own.rapid),
        require_number("chosen.reorientation", own.reorientation),
    )
    if w.rapid == 0.0 and w.reorientation == 0.0:
        yield from check_equal("objective.chosen.rapid", share, 0.0)
        yield from check_equal("objective.chosen.reorientation", changes, 0.0)
        return
    points = CheckedPoints.from_file(t)
    if len(t.segments[0]) > 1 or not points.is_ok.all() or own.mean is None or own.worst is None:
        return  # of several tools it is a sum by shares; of a plan with gaps the ends are not known
    x = _read_joints(t, points)
    flown = np.flatnonzero(t.toolpath.move[1:] == MoveKind.RAPID)
    lifts = _find_reentry_steps(t)
    steps = np.vstack([x[flown + 1] - x[flown], lifts])
    turns = int(np.round(np.abs(steps[:, :6]) / (2.0 * math.pi)).sum())
    branch = points.get_column("branch")
    most = turns + int((branch[flown + 1] != branch[flown]).sum()) + len(lifts)
    unit = INDEX_TOLERANCE * max(
        w.mean * one.mean + w.worst * one.worst
        for one in (own, t.result.objective.grid)
        if one is not None and one.mean is not None and one.worst is not None
    )
    if (turns and changes == 0.0) or changes > most * unit:
        yield (
            f"objective.chosen.reorientation is {changes:.6g}; points.csv has {turns} whole turns and {most - turns} "
            "changes of the branch in rapid moves"
        )
    home = x[[0, -1]] - t.cell.joints_at_home
    home[:, :6] -= 2.0 * math.pi * np.round(home[:, :6] / (2.0 * math.pi))
    seconds = sum(compute_line_time(t, step) for step in np.vstack([steps, home]))
    whole = _compute_programmed_time(t) + STOP_S * (len(flown) + len(lifts))
    expected = seconds / whole if whole > 0.0 else 0.0
    if abs(share - expected) > SHARE_TOLERANCE * expected:
        yield f"objective.chosen.rapid is {share:.6g}, the joints in points.csv give {expected:.6g}"


def compute_line_time(t: ResultComparison, step: Array) -> float:
    """Return the time in s of a rapid move straight in joint space, from rest to rest.

    Args:
        t: Result.json and everything that it is compared with.
        step: (6 + E,) rad or m.
    """
    limits, scale, size = t.cell.limits, t.options.rapid_scale, np.abs(step)
    if size.max() < 1e-9:
        return 0.0
    with np.errstate(divide="ignore"):
        v, a, j = (float((scale * x / size).min()) for x in (limits.velocity, limits.acceleration, limits.jerk))

    def ramp(p: float) -> float:
        return p / a + a / j if p >= a * a / j else 2.0 * math.sqrt(p / j)

    low, high = 0.0, v
    if v * ramp(v) > 1.0:
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if middle * ramp(middle) <= 1.0 else (low, middle)
    return ramp(high) + 1.0 / high


def _read_joints(t: ResultComparison, points: CheckedPoints) -> Array:
    """(N, 6 + E) rad or m, joints at the points."""
    return _stack_joints(t, points.get_column)


def _read_motion_joints(t: ResultComparison) -> Array:
    """(S, 6 + E) rad or m, joints of the samples."""
    return _stack_joints(t, t.motion.read_numbers)


def _stack_joints(t: ResultComparison, read: Callable[[str], Array]) -> Array:
    columns = [np.radians(read(f"q{n}_deg")) for n in range(1, 7)]
    for n, slides in enumerate(t.cell.external_prismatic, 1):
        column = read(f"e{n}_mm" if slides else f"e{n}_deg")
        columns.append(1e-3 * column if slides else np.radians(column))
    return np.column_stack(columns)


def _find_reentry_steps(t: ResultComparison) -> Array:
    """(L, 6 + E) rad or m between leaving and entering a cut at each re-entry (retract, link, approach)."""
    x, words = _read_motion_joints(t), t.motion.read_words("move")
    steps = []
    for row in t.lift_starts:
        first, last = row, row
        while first and words[first] != MoveKind.CUT.word:
            first -= 1
        while last + 1 < len(words) and words[last + 1] in (MoveKind.LINK.word, MoveKind.APPROACH.word):
            last += 1
        steps.append(x[last] - x[first])
    return np.array(steps).reshape(-1, x.shape[1])


def _compute_programmed_time(t: ResultComparison) -> float:
    """Time in s of all moves at the feed, at their programmed feed."""
    p, path = t.toolpath.position, t.toolpath
    led = path.move[1:] != MoveKind.RAPID
    length = np.linalg.norm(np.diff(p, axis=0), axis=1)
    feed = np.where(path.feed[1:] > 0, np.minimum(path.feed[1:], FASTEST_M_S), UNKNOWN_M_S)
    return float((length / feed)[led].sum())
