"""Search that first ignores whole turns, compared with the turn-resolved search."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.kinematics.inverse.solver import choose_angle_origin, shift_angles
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.sequence_stretch import SequenceStretch
from machopt.planning.sequence_search.transition_cost_table import TransitionCostTable
from machopt.planning.sequence_search.transition_windows import FREE, LIFT

TURN = 2 * np.pi
RANGES = (100.0, 185.0, 300.0, 350.0, 400.0, 540.0, 720.0)  # ± deg


def random_grid(rng: np.random.Generator) -> SequenceGrid:
    """Return joints that vary across their turns, all kinds of ranges, rapid moves, and some infeasible turns."""
    S, R, B = (int(n) for n in (rng.integers(2, 8), rng.integers(3, 6), rng.integers(1, 3)))
    half = np.radians(rng.choice(RANGES, 6))
    half[[0, 3, 4]] = np.radians(170.0)  # otherwise there are too many turns for a quick test
    origin, turns = choose_angle_origin(-half, half)
    drift = np.cumsum(rng.normal(0, 0.7, (S, 1, 1, 6)), axis=0)
    q = np.array(wrap_angle(drift + rng.uniform(-3, 3, (1, 1, B, 6)) + rng.normal(0, 0.3, (S, R, B, 6))))
    shift_angles(origin, q)
    values = q[..., None, :] + turns
    feasible = ((values >= -half) & (values <= half)).all(axis=-1) & (rng.random((S, R, B, len(turns))) < 0.9)
    window = rng.choice([0, 1, 2, FREE], S, p=[0.2, 0.4, 0.2, 0.2]).astype(np.int32)
    window[0] = FREE
    window[1:][~feasible.any(axis=(1, 2, 3))[:-1] & (window[1:] >= 0)] = LIFT
    return grid_of(q, turns, feasible, window, rng, bool(rng.integers(2)))


def grid_of(
    q: np.ndarray, turns: np.ndarray, feasible: np.ndarray, window: np.ndarray, rng: np.random.Generator, stable: bool
) -> SequenceGrid:
    S, R, B, _ = feasible.shape
    candidates = CandidateGrid(
        branch=np.arange(B),
        phi=np.arange(R) * TURN / R,
        q=q,
        turns=turns,
        reason=np.zeros((S, R, B), np.uint8),
        feasible=feasible,
        stable=stable,
        shortfall=np.zeros(S),
    )
    return SequenceGrid(
        candidates=candidates,
        counted=np.ones(S, bool),
        window=window,
        seconds=rng.uniform(0.1, 1, S),
        shift=rng.integers(0, R, S).astype(np.int32),
        node=rng.uniform(0, 1, (S, R, B)),
        raw=rng.uniform(1, 2, (S, R, B)),
        slowness=rng.uniform(0.3, 1, 6),
        price_q=rng.uniform(0, 1, S),
        price_r=rng.uniform(0, 1, S),
        price_t=rng.uniform(0, 1, S),
        nudged=np.zeros(S),
        hidden=np.zeros(S, bool),
        worst=1.0,
        priced=TransitionCostTable.none_yet(window, R, B, stable),
    )


def forbid_motion(edges: ForbiddenTransitions, s: int, u: int, v: int, T: int) -> ForbiddenTransitions:
    """Forbid the transition from vertex u to every turn of v, as the search does."""
    rows = np.full(T, s), np.full(T, u), v * T + np.arange(T)
    return edges.plus(*(x.astype(np.int32) for x in rows))


@pytest.mark.parametrize("seed", range(6))
def test_answer_equals_the_search_with_separate_turns(seed: int) -> None:
    rng, requested, found = np.random.default_rng(seed), 0, 0
    unbroken = 0
    while requested < 60:
        grid = random_grid(rng)
        c = grid.candidates
        S, R, B, T = c.feasible.shape
        edges = ForbiddenTransitions.none()
        for s in np.flatnonzero(grid.window >= 0).tolist():
            for _ in range(rng.integers(0, 6)):
                edges = forbid_motion(edges, s, int(rng.integers(R * B * T)), int(rng.integers(R * B)), T)
            for _ in range(rng.integers(0, 2)):
                edges = edges.plus_closed(np.array([(s, rng.integers(R * B), rng.integers(R * B))]))
        part = SequenceStretch(grid, edges, slice(0, S))
        mask = c.feasible.copy()
        for end in (0, -1):
            left = np.argwhere(mask[end])
            if len(left) and rng.random() < 0.5:  # as where the rest of the path has fixed vertices
                mask[end] = False
                mask[(end, *left[rng.integers(len(left))])] = True
        some = mask.any(axis=3)
        allowed = grid.raw < rng.choice([1.3, 1.7, 9.0])
        if not (some & allowed).any(axis=(1, 2))[c.feasible.any(axis=(1, 2, 3))].all():
            continue
        requested += 1
        whole = mask & allowed[..., None]
        told_apart, (free, broken, reached) = part.solve(whole), part.free(whole)
        assert (broken == told_apart[3]).all()
        assert free.value == pytest.approx(told_apart[1], abs=1e-9)
        assert ((free.vertex[:, 0] >= 0) == (told_apart[0][:, 0] >= 0)).all()
        assert reached is not None or not broken.any()  # the part after a break is determined from it
        unbroken += reached is None
        vertex, value, stop, *_ = part.solve(whole, 1e300)
        got = part.below(mask, some, allowed, 1e300)
        assert (got is None) == (stop >= 0)
        if got is not None:
            found += 1
            assert got[1] == pytest.approx(value, abs=1e-9)
            retained = np.flatnonzero(got[0][:, 0] >= 0)
            assert mask[(retained, *got[0][retained].T)].all()
            assert ((got[0][:, 0] >= 0) == (vertex[:, 0] >= 0)).all()
    assert min(found, unbroken) > 8


def test_motion_is_forbidden_in_every_turn_only_if_no_turn_remains() -> None:
    feasible = np.ones((2, 1, 1, 2), bool)
    one = forbid_motion(ForbiddenTransitions.none(), 1, 0, 0, 2)  # turn 0 to both turns
    assert not len(one.in_every_turn(feasible))
    assert len(forbid_motion(one, 1, 1, 0, 2).in_every_turn(feasible)) == 1
    feasible[0, 0, 0, 0] = False  # the forbidden turn is infeasible anyway; the other one is still usable
    assert not len(one.in_every_turn(feasible))


@pytest.mark.parametrize("seed", range(6))
def test_closed_motion_is_forbidden_turn_by_turn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(4):
        grid = random_grid(rng)
        S, R, B, T = grid.candidates.feasible.shape
        ways = np.column_stack([rng.integers(1, S, 8), rng.integers(0, R * B, 8), rng.integers(0, R * B, 8)])
        closed, each = ForbiddenTransitions.none().plus_closed(ways), ForbiddenTransitions.none()
        for s, u, v in ways.tolist():
            for t in range(T):
                each = forbid_motion(each, s, u * T + t, v, T)
        by_way, by_turn = (
            SequenceStretch(grid, e, slice(0, S)).solve(grid.candidates.feasible) for e in (closed, each)
        )
        assert (by_way[0] == by_turn[0]).all()
        assert by_way[1] == by_turn[1]
        flat = np.ravel_multi_index(tuple(np.maximum(by_way[0], 0).T), (R, B, T))
        assert (closed.into(flat, T) == each.into(flat, T)).all()
        flat[by_way[0][:, 0] < 0] = -1
        assert closed.taken(slice(0, S), flat, T) == each.taken(slice(0, S), flat, T)


def test_equal_sequences_use_no_unnecessary_turns() -> None:
    """Travel has no cost: only the turns distinguish the sequences."""
    half = np.radians(np.full(6, 100.0))
    half[3] = np.radians(350.0)
    origin, turns = choose_angle_origin(-half, half)
    q = np.zeros((4, 1, 1, 6))
    q[:, 0, 0, 3] = np.radians([5.0, 5.0, 15.0, 15.0])
    shift_angles(origin, q)
    values = q[..., None, :] + turns
    feasible = ((values >= -half) & (values <= half)).all(axis=-1)
    window = np.array([FREE, 0, FREE, 0], np.int32)
    grid = grid_of(q, turns, feasible, window, np.random.default_rng(0), True)
    grid.price_q[:] = 0.0
    assert np.degrees(grid.choose().q[:, 3]) == pytest.approx([5.0, 5.0, 15.0, 15.0])
