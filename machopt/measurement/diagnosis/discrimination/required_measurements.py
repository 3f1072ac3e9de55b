"""How many poses and rounds it takes until diagnose itself excludes the wrong one of two explanations.

It asks for a gain that is clearly larger, and where the rival reaches most of the gain, for one that is larger pose by
pose too: Student's t of the differences, whose mean is λ_g at pose g and whose variance is 4 λ_g. Rounds make every λ_g
larger; where a few poses hold most of λ, only more poses make the test pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from machopt.measurement.design.maximin_discrimination import (
    ModelContest,
    compute_contest_noncentrality,
    compute_noncentrality_by_pose,
    draw_random_readings,
    select_maximin_readings,
)
from machopt.measurement.design.measurement_plan import MeasurementPlanSize
from machopt.measurement.diagnosis import thresholds
from machopt.numerics.array_types import Array, Ints

MOST_CYCLES = 10  # that a plan asks for by itself
MAX_COUNTED_CYCLES = 50  # cycles counted up to
HARDER_FORM_SHARE = 0.8  # of what a rival's known forms leave: a form that leaves less counts from then on
POSE_GROWTH, MOST_POSES = 1.6, 40  # poses by which a plan that diagnose's test asks more of grows, and the most
Blocks = tuple[tuple[int, ...], ...]


def select_poses_for_exclusion(
    pairs: Sequence[Sequence[ModelContest]],
    base: Array,
    covariance: Array,
    shared: Array,
    pose: Ints,
    size: MeasurementPlanSize,
    rng: np.random.Generator,
    *,
    grow: bool = True,
) -> Blocks:
    """The readings: ``size.poses`` poses, and more where that lets diagnose exclude one of more pairs.

    Args:
        pairs: contests of each pair that can be split.
        base: (N, R, P) refitted whatever is true.
        covariance, shared, pose: of the N readings.
        grow: False: as many poses as asked for.
    """
    if not pairs:
        return draw_random_readings(pose, size.poses, size.loads, rng)
    flat = [c for both in pairs for c in both]
    there = len(np.unique(pose))

    def of(poses: int, starts: int) -> tuple[int, Blocks]:
        blocks = select_maximin_readings(flat, covariance, shared, pose, poses, size.loads, rng, starts)
        rounds = [compute_rounds_to_exclude(both, covariance + shared, blocks, base) for both in pairs]
        return sum(n is not None and n <= MOST_CYCLES for n in rounds), blocks

    poses = before = size.poses
    most, best = of(poses, size.starts)
    found = poses
    while grow and most < len(pairs) and poses < min(MOST_POSES, there):
        last, poses = poses, min(int(np.ceil(POSE_GROWTH * poses)), MOST_POSES)
        passed, blocks = of(poses, 1)
        if passed > most:
            most, best, before, found = passed, blocks, last, poses
    while found - before > 2:  # fewer may do as well
        poses = (before + found) // 2
        passed, blocks = of(poses, 1)
        if passed >= most:
            best, found = blocks, poses
        else:
            before = poses
    return best


@dataclass(frozen=True)
class ContestSide:
    """One way round of a pair: what is true, and all that diagnose lets the rival be."""

    truth: int
    rival: int
    signal: Array  # (N, R)
    base: Array  # (N, R, P) refitted beside the rival
    forms: tuple[Array, ...]  # (N, R, p) each


def select_hardest_rivals(
    contests: Sequence[ModelContest], sides: Sequence[ContestSide], covariance: Array, blocks: Sequence[Sequence[int]]
) -> list[ModelContest]:
    """The contests, and the form of each rival that these readings tell worst, where no known one is as hard."""
    out = list(contests)
    rows = np.array([n for b in blocks for n in b], np.int64)
    ends = np.cumsum([0, *(len(b) for b in blocks)])
    inner = [range(a, b) for a, b in pairwise(ends)]

    def left(signal: Array, base: Array, columns: Array) -> float:
        one = ModelContest(0, 1, np.concatenate([base[rows], columns[rows]], axis=2), signal[rows])
        return float(compute_noncentrality_by_pose(one, covariance[rows], inner).sum())

    for side in sides:
        known = [c for c in contests if (c.truth, c.rival) == (side.truth, side.rival)]
        least = HARDER_FORM_SHARE * min(left(c.signal, c.columns[..., :0], c.columns) for c in known)
        hardest: Array | None = None
        for columns in side.forms:
            rest = left(side.signal, side.base, columns)
            if rest < least:
                least, hardest = rest, columns
        if hardest is not None:
            both = np.concatenate([side.base, hardest], axis=2)
            out.append(ModelContest(side.truth, side.rival, both, side.signal))
    return out


def compute_separation(
    contests: Sequence[ModelContest], covariance: Array, shared: Array, pose: Ints, blocks: Sequence[Sequence[int]]
) -> float:
    """Noncentrality of a design, the worst way round."""
    return min(compute_contest_noncentrality(c, covariance, shared, pose, blocks) for c in contests)


def compute_required_rounds(planned: Callable[[int], float], first: float, enough: float) -> int | None:
    """The least number of rounds whose noncentrality is enough; the load's own error does not average.

    Args:
        planned: noncentrality of so many rounds.
        first: of one.
    """
    if first >= enough:
        return 1
    n = int(np.ceil(enough / max(first, 1e-12))) if first * MAX_COUNTED_CYCLES >= enough else MAX_COUNTED_CYCLES + 1
    while n <= MAX_COUNTED_CYCLES:
        if planned(n) >= enough:
            return n
        n += 1 + n // 8
    return None


def combine_required_rounds(wanted: Sequence[int | None], excluded: Sequence[int | None]) -> int:
    """Rounds that a plan asks for by itself: what its pairs need, as far as rounds do it; one for what they do not."""
    each = [max(n, m or 1) if n is not None else 1 for n, m in zip(wanted, excluded, strict=True)]
    return max((min(n, MOST_CYCLES) for n in each), default=1)


def compute_rounds_to_exclude(
    contests: Sequence[ModelContest], covariance: Array, blocks: Sequence[Sequence[int]], base: Array
) -> int | None:
    """Rounds after which diagnose excludes the rival in nine of ten cases, the worse way round; None: not in LOOKED."""
    each = [_find_exclusion_rounds(c, covariance, blocks, base) for c in contests]
    known = [n for n in each if n is not None]
    return max(known) if known and len(known) == len(each) else None


def _find_exclusion_rounds(
    contest: ModelContest, covariance: Array, blocks: Sequence[Sequence[int]], base: Array
) -> int | None:
    each = compute_noncentrality_by_pose(contest, covariance, blocks)
    whole = compute_noncentrality_by_pose(replace(contest, columns=base), covariance, blocks).sum()
    G, total, spread = len(each), float(each.sum()), float(each.var(ddof=1)) if len(each) > 1 else 0.0
    if total <= 0.0 or G < 2:
        return None
    critical = float(stdtrit(G - 1, 1.0 - thresholds.DETECTION.paired)) + thresholds.DETECTION.nine_of_ten
    alone = 1.0 - total / whole < thresholds.DETECTION.most_of  # the rival does not reach most of the gain
    for n in range(1, MAX_COUNTED_CYCLES + 1):
        larger = n * total - thresholds.DETECTION.nine_of_ten * 2.0 * np.sqrt(n * total) >= thresholds.DETECTION.as_good
        if larger and (alone or n * total / np.sqrt(G * n**2 * spread + 4.0 * n * total) >= critical):
            return n
    return None
