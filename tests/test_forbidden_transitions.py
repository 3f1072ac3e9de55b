"""Transitions between stations across forbidden rotations, compared with every sequence."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.transition_cost_table import TransitionCostTable
from machopt.planning.sequence_search.transition_windows import FREE
from machopt.planning.sequence_search.worst_value_constraint import GAP

S, R = 4, 8
WORST, PRICE = 0.8, 0.1


def random_grid(seed: int) -> SequenceGrid:
    """One branch whose joints do not change with the rotation; up to three rotation steps between stations."""
    rng = np.random.default_rng(seed)
    feasible = rng.uniform(size=(S, R, 1, 1)) < 0.8
    candidates = CandidateGrid(
        branch=np.arange(1),
        phi=np.arange(R) * 2 * np.pi / R,
        q=np.zeros((S, R, 1, 6)),
        turns=np.zeros((1, 6)),
        reason=np.zeros((S, R, 1), np.uint8),
        feasible=feasible,
        stable=True,
        shortfall=np.zeros(S),
    )
    raw = np.where(feasible[..., 0], rng.uniform(0.2, 2.0, (S, R, 1)), np.inf)
    window = np.array([FREE, 3, 3, 3], np.int32)
    return SequenceGrid(
        candidates=candidates,
        counted=rng.uniform(size=S) < 0.9,
        window=window,
        seconds=np.ones(S),
        shift=np.zeros(S, np.int32),
        node=rng.uniform(0, 0.3, (S, R, 1)),
        raw=raw,
        slowness=np.ones(6),
        price_q=np.zeros(S),
        price_r=np.full(S, PRICE),
        price_t=np.zeros(S),
        nudged=np.zeros(S),
        hidden=np.r_[False, rng.uniform(size=S - 1) < 0.7],
        worst=WORST,
        priced=TransitionCostTable.none_yet(window, R, 1, stable=True),
    )


def price(grid: SequenceGrid, rotation: tuple[int, ...], keep: dict[int, int]) -> float:
    """Return J of a sequence; infinite if the sequence is not allowed."""
    there = grid.candidates.feasible[..., 0, 0]
    if not all(there[s, r] for s, r in enumerate(rotation)) or any(rotation[s] != r for s, r in keep.items()):
        return np.inf
    total = sum(float(grid.node[s, r, 0]) for s, r in enumerate(rotation))
    observed = [float(grid.raw[s, r, 0]) for s, r in enumerate(rotation) if grid.counted[s]]
    for s in range(1, S):
        up = (rotation[s] - rotation[s - 1]) % R
        steps, sign = (up, 1) if up <= R - up else (R - up, -1)
        if steps > 3:
            return np.inf
        total += PRICE * steps * 2 * np.pi / R
        if grid.hidden[s]:
            for k in range(1, steps):
                at = (rotation[s - 1] + sign * k) % R
                if not there[s, at] and not there[s - 1, at]:
                    return np.inf
                if grid.counted[s] and grid.counted[s - 1]:
                    observed.append(float(min(grid.raw[s, at, 0], grid.raw[s - 1, at, 0])))
    return total + WORST * max(observed, default=0.0)


def best(grid: SequenceGrid, keep: dict[int, int] | None = None) -> float:
    return min(price(grid, rotation, keep or {}) for rotation in product(range(R), repeat=S))


@pytest.mark.parametrize("seed", range(12))
def test_choice_is_the_best_of_all_sequences_with_crossing_costs(seed: int) -> None:
    grid = random_grid(seed)
    ideal, choice = best(grid), grid.choose()
    if not np.isfinite(ideal):
        assert choice.broken or choice.dropped.any()
        return
    assert choice.total == pytest.approx(price(grid, tuple(choice.rotation.tolist()), {}), rel=1e-12)
    assert ideal * (1 - 1e-12) <= choice.total <= ideal * (1 + 1.01 * GAP)
    assert choice.bound <= ideal * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_segment_is_chosen_again_with_crossings_at_its_ends(seed: int) -> None:
    grid = random_grid(seed)
    choice = grid.choose()
    if choice.broken or choice.dropped.any():
        return
    keep = {0: int(choice.rotation[0]), 3: int(choice.rotation[3])}
    again = grid.again(choice, 0, 3, ForbiddenTransitions.none())
    assert again is not None
    ideal = best(grid, keep)
    assert ideal * (1 - 1e-12) <= again.total <= ideal * (1 + 1.01 * GAP)


def test_cases_differ_from_those_without_hidden_edges() -> None:
    """Without this difference, the tests above could not fail."""
    less = 0
    for seed in range(12):
        grid = random_grid(seed)
        paid = best(grid)
        grid.hidden[:] = False
        less += np.isfinite(paid) and best(grid) < paid * (1 - 1e-3)
    assert less >= 3
