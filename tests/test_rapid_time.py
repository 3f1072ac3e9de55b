"""Costs of rapid moves, branch changes and whole turns: timing law, and search compared with all sequences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_sequence_search import VELOCITY, every_sequence, get_joints, random_problem

from machopt.data_types.cell import JointLimits
from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.planning.cost.rapid_time import STOP, RapidPricing, compute_rest_time, find_rapids
from machopt.planning.motion.rapid_moves import retime_straight_segments
from machopt.planning.sequence_search.dynamic_programming import choose_sequence
from machopt.planning.sequence_search.worst_value_constraint import GAP

LIMITS = np.stack([VELOCITY, 2.5 * VELOCITY, 20.0 * VELOCITY])
HOME = np.array([0.1, -0.4, 0.8, 0.0, 0.5, 0.2])


def limits() -> JointLimits:
    reach = np.full(6, 10.0)
    return JointLimits(lower=-reach, upper=reach, velocity=LIMITS[0], acceleration=LIMITS[1], jerk=LIMITS[2])


@pytest.mark.parametrize("size", [1e-4, 3e-3, 0.05, 0.4, 1.5, 6.0])
def test_time_of_a_rapid_move_equals_that_of_its_samples(size: float) -> None:
    rng = np.random.default_rng(7)
    for _ in range(5):
        step = size * rng.uniform(-1, 1, 6)
        sample = 1e-4
        x = retime_straight_segments(np.array([np.zeros(6), step]), limits(), 0.8, sample)
        need = (np.abs(step) / (0.8 * LIMITS)).max(axis=1)
        assert compute_rest_time(*need) == pytest.approx((len(x) - 1) * sample, abs=1.01 * sample)


def test_zero_move_takes_no_time() -> None:
    assert compute_rest_time(0.0, 0.0, 0.0) == 0.0


def ride(a: np.ndarray, b: np.ndarray) -> float:
    """Return the duration of a rapid move in s, from its samples."""
    return 1e-3 * (len(retime_straight_segments(np.array([a, b]), limits(), 0.8, 1e-3)) - 1)


def near(q: np.ndarray) -> np.ndarray:
    """Return the configuration with the whole turns that are nearest to home."""
    return q - 2 * np.pi * np.round((q - HOME) / (2 * np.pi))


@pytest.mark.parametrize("seed", range(8))
def test_search_costs_of_rapids_equal_those_of_every_sequence(seed: int) -> None:
    path, candidates, scores = random_problem(seed, rapid=(0, 2, 3))
    weights = ObjectiveWeights(worst=0.3, rapid=0.7, reorientation=0.3)
    options = PlanOptions(weights=weights)
    pricing = RapidPricing.build(path, LIMITS, HOME, np.ones(6), scores.least, True, options)
    assert pricing is not None
    scores = replace(scores, rapid=pricing)
    least = np.nanmin(scores.cost, axis=(1, 2))
    counted = path.counted[path.stations]
    unit = float(path.station_weight @ least) + 0.3 * float(least[counted].max())
    seconds = float(path.time[-1]) + STOP * float(find_rapids(path).sum())
    flown = [s for s in range(1, 5) if path.run[path.stations[s]] != path.run[path.stations[s - 1]]]
    best = np.inf
    rides: dict[tuple[object, ...], tuple[float, int]] = {}
    for total, worst, sequence in every_sequence(path, candidates, scores, options):
        q = [get_joints(candidates, s, v) for s, v in enumerate(sequence)]
        value = total + 0.3 * worst
        if value >= best:
            continue
        for s in flown:
            key = (s, sequence[s - 1], sequence[s])
            if key not in rides:
                turns = int(np.round(np.abs(q[s] - q[s - 1]) / (2 * np.pi)).sum())
                rides[key] = ride(q[s - 1], q[s]), turns + (sequence[s][1] != sequence[s - 1][1])
            value += 0.7 * rides[key][0] / seconds + 0.3 * unit * rides[key][1]
        for end in (q[0], q[-1]):
            value += 0.7 * ride(HOME, near(end)) / seconds
        best = min(best, value)
    if not np.isfinite(best):
        pytest.skip("this random problem has no sequence")
    choice = choose_sequence(path, candidates, scores, VELOCITY, options)
    rounding = 0.7 * 5 * 1e-3 / seconds  # every duration above is rounded up to 1 ms
    assert choice.total == pytest.approx(best, rel=GAP, abs=rounding)
    share, changes = pricing.measure(path, choice.q, choice.branch)
    assert changes / unit == pytest.approx(round(changes / unit))
    assert share > 0


def test_expensive_change_keeps_the_branch() -> None:
    for seed in range(8):
        path, candidates, scores = random_problem(seed, rapid=(0, 2, 3))
        found = []
        for reorientation in (0.0, 100.0):
            options = PlanOptions(weights=ObjectiveWeights(rapid=0.0, reorientation=reorientation, travel=0.0))
            pricing = RapidPricing.build(path, LIMITS, HOME, np.ones(6), scores.least, True, options)
            choice = choose_sequence(path, candidates, replace(scores, rapid=pricing), VELOCITY, options)
            if choice.broken or choice.dropped.any():
                break
            turns = np.round(np.abs(np.diff(choice.q, axis=0)) / (2 * np.pi)).sum()
            found.append(int((np.diff(choice.branch) != 0).sum() + turns))
        assert len(found) < 2 or found[1] <= found[0]
