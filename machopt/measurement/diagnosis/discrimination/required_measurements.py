"""Number of poses and rounds until diagnose itself rejects the wrong one of two explanations.

Diagnose requires a clearly larger gain. If the rival reaches most of the gain, it also requires a larger gain pose by
pose: Student's t of the differences, whose mean is λ_g at pose g and whose variance is 4 λ_g. More rounds increase
every λ_g. If a few poses contribute most of λ, only more poses make the test pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from machopt.measurement import thresholds
from machopt.measurement.design.maximin_discrimination import (
    ModelContest,
    compute_contest_noncentrality,
    compute_noncentrality_by_pose,
    draw_random_readings,
    select_maximin_readings,
)
from machopt.measurement.design.measurement_plan import MeasurementPlanSize
from machopt.numerics.array_types import Array, Ints

MOST_CYCLES = 10  # most rounds that a plan proposes
MAX_COUNTED_CYCLES = 50  # most rounds that are evaluated
HARDER_FORM_SHARE = 0.8  # a rival shape is added if it leaves less than this share of the residual of known shapes
POSE_GROWTH, MOST_POSES = 1.6, 40  # growth factor of the number of poses, and its limit
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
    """Select readings of ``size.poses`` poses, and more poses if diagnose can then reject the rival of more pairs.

    Args:
        pairs: Contests of each separable pair.
        base: (N, R, P) base columns, always refitted.
        covariance: (N, R, R) noise covariance of each reading.
        shared: (R, R) covariance shared by the readings of a pose.
        pose: (N,) pose label of each reading.
        size: Number of poses and loads.
        rng: Random generator of the search.
        grow: Whether the number of poses may increase.

    Returns:
        Selected readings, grouped by pose.
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
    while found - before > 2:  # check whether fewer suffice
        poses = (before + found) // 2
        passed, blocks = of(poses, 1)
        if passed >= most:
            best, found = blocks, poses
        else:
            before = poses
    return best


@dataclass(frozen=True)
class ContestSide:
    """One direction of a pair: the true law, and all shapes that diagnose may fit to the rival."""

    truth: int
    rival: int
    signal: Array  # (N, R)
    base: Array  # (N, R, P) columns refitted together with the rival
    forms: tuple[Array, ...]  # (N, R, p) each


def select_hardest_rivals(
    contests: Sequence[ModelContest], sides: Sequence[ContestSide], covariance: Array, blocks: Sequence[Sequence[int]]
) -> list[ModelContest]:
    """Add for each side the rival shape that the readings separate worst, unless a known shape is equally hard.

    Args:
        contests: Contests of the pair, in both directions.
        sides: Both directions of the pair with all rival shapes.
        covariance: (N, R, R) noise covariance of each reading.
        blocks: Selected readings, grouped by pose.

    Returns:
        The extended contests.
    """
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
    """Compute the noncentrality of a design, the smallest over all contests.

    Args:
        contests: Contests of the pair, in both directions.
        covariance: (N, R, R) noise covariance of each reading.
        shared: (R, R) covariance shared by the readings of a pose.
        pose: (N,) pose label of each reading.
        blocks: Selected readings, grouped by pose.

    Returns:
        Noncentrality of the χ² test.
    """
    return min(compute_contest_noncentrality(c, covariance, shared, pose, blocks) for c in contests)


def compute_required_rounds(planned: Callable[[int], float], first: float, enough: float) -> int | None:
    """Compute the least number of rounds with sufficient noncentrality. The load error does not average out.

    Args:
        planned: Noncentrality as a function of the number of rounds.
        first: Noncentrality of one round.
        enough: Required noncentrality.

    Returns:
        Number of rounds; None if the limit is exceeded.
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
    """Combine the rounds that the pairs need to the number that a plan proposes.

    Args:
        wanted: Rounds of each pair by noncentrality; None if rounds do not suffice.
        excluded: Rounds of each pair by the test of diagnose; None if rounds do not suffice.

    Returns:
        Number of rounds, at most :data:`MOST_CYCLES`.
    """
    each = [max(n, m or 1) if n is not None else 1 for n, m in zip(wanted, excluded, strict=True)]
    return max((min(n, MOST_CYCLES) for n in each), default=1)


def compute_rounds_to_exclude(
    contests: Sequence[ModelContest], covariance: Array, blocks: Sequence[Sequence[int]], base: Array
) -> int | None:
    """Compute the rounds after which diagnose rejects the rival with 90 % power, the larger of both directions.

    Args:
        contests: Contests of the pair, in both directions.
        covariance: (N, R, R) noise covariance of each reading.
        blocks: Selected readings, grouped by pose.
        base: (N, R, P) base columns, always refitted.

    Returns:
        Number of rounds; None if more than :data:`MAX_COUNTED_CYCLES`.
    """
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
    critical = (
        float(stdtrit(G - 1, 1.0 - thresholds.LEVELS.mismatch_significance_level)) + thresholds.LEVELS.power_quantile
    )
    alone = 1.0 - total / whole < thresholds.SHARES.majority  # the rival reaches less than most of the gain
    for n in range(1, MAX_COUNTED_CYCLES + 1):
        larger = (
            n * total - thresholds.LEVELS.power_quantile * 2.0 * np.sqrt(n * total)
            >= thresholds.LEVELS.gain_three_sigma
        )
        if larger and (alone or n * total / np.sqrt(G * n**2 * spread + 4.0 * n * total) >= critical):
            return n
    return None
