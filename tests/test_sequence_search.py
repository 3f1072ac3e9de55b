"""Global sequence search compared with every sequence of small problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from test_planning_path import Rows, length_weight, toolpath

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import FixedRotation, ObjectiveWeights, PlanOptions
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.cost.objective import AXIS_SPEED, NEAR
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_enumeration import _forbid_by_user
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.joint_path import MARGINS, JointAssignment
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, SequenceGrid, choose_sequence
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.search_kernels import JUMP
from machopt.planning.sequence_search.transition_windows import TURNING, compute_transition_windows
from machopt.planning.sequence_search.worst_value_constraint import GAP, SOLVES, WorstLimitedSequence, trade_worst_index
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path

UP = (0.0, 0.0, 1.0)
C, R = MoveKind.CUT, MoveKind.RAPID
VELOCITY = np.array([2.0, 2.0, 2.0, 3.0, 3.0, 4.0])
NO_TURN = np.zeros((1, 6))
Vertex = tuple[int, int, int]
Rapid = tuple[int, ...]


def line(n: int, rapid: tuple[int, ...] = (0,), spacing: float = 0.019) -> PlanningPath:
    rows: Rows = [((spacing * k, 0.0, 0.0), UP, R if k in rapid else C) for k in range(n)]
    path = build_planning_path(toolpath(rows, feed=0.002))  # slow enough for the rotation to change at every station
    assert len(path.index) == n
    return path


def random_problem(
    seed: int, rapid: tuple[int, ...] = (0, 3), turning: int = 2
) -> tuple[PlanningPath, CandidateGrid, CandidateScores]:
    """Five stations, four rotations, two branches, two turns of joint 6; joints vary by up to some tens of degrees."""
    rng = np.random.default_rng(seed)
    S, rotations, B = 5, 4, 2
    path = line(S, rapid)
    drift = np.cumsum(rng.normal(size=(S, 1, B, 6)) * 0.15, axis=0)
    spread = np.cumsum(rng.normal(size=(1, rotations, 1, 6)) * 0.12, axis=1)
    q = rng.uniform(-1, 1, (1, 1, B, 6)) + drift + spread
    q[..., 5] += np.pi - 0.4  # joint 6 near the discontinuity at 180°
    turns = np.zeros((turning, 6))
    turns[1:, 5] = -2 * np.pi
    feasible = rng.uniform(size=(S, rotations, B, turning)) < 0.75
    cost = np.where(feasible.any(axis=-1), rng.uniform(0.5, 2.0, (S, rotations, B)), np.nan)
    reason = np.where(feasible.any(axis=-1), InfeasibilityReason.OK, InfeasibilityReason.LIMIT).astype(np.uint8)
    candidates = CandidateGrid(
        branch=np.arange(reason.shape[2]),
        phi=np.arange(rotations) * np.pi / 2 - np.pi,
        q=wrap_angle(q),
        turns=turns,
        reason=reason,
        feasible=feasible,
        stable=True,
        shortfall=np.zeros(S),
    )
    return path, candidates, CandidateScores(cost=cost, index="stiffness", scale=1.0)


def get_joints(candidates: CandidateGrid, s: int, v: Vertex) -> np.ndarray:
    return candidates.q[s, v[0], v[1]] + candidates.turns[v[2]]


def transition(
    path: PlanningPath,
    candidates: CandidateGrid,
    window: np.ndarray,
    seconds: np.ndarray,
    s: int,
    a: Vertex,
    b: Vertex,
    options: PlanOptions,
) -> float:
    """Return the cost from vertex a at station s − 1 to b at s; infinite if the rules forbid it."""
    w, share = options.weights, path.motion_share[path.stations[s]]
    dq = np.abs(get_joints(candidates, s, b) - get_joints(candidates, s - 1, a))
    travel = w.travel / np.pi * share * dq.sum()
    if window[s] < 0:  # a rapid move; a short one should not change the configuration
        way = np.linalg.norm(np.diff(path.position[path.stations[[s - 1, s]]], axis=0))
        return float(travel * (1 + NEAR / (way + NEAR / 10)))
    n = len(candidates.phi)
    steps = min((b[0] - a[0]) % n, (a[0] - b[0]) % n)
    if steps > window[s] or (a[1] != b[1] and candidates.stable) or dq.max() > JUMP:
        return np.inf
    late = max(float((dq / (AXIS_SPEED * VELOCITY)).max()) - seconds[s], 0.0)
    return float(travel + w.rotation / np.pi * share * steps * 2 * np.pi / n + w.feed * late / path.time[-1])


@dataclass(frozen=True)
class Priced:
    """Costs of vertices and steps of a problem: each is computed once, though a million sequences share it."""

    vertices: list[list[Vertex]]  # by station
    node: Callable[[int, Vertex], float]  # cost without the worst index
    step: Callable[[int, Vertex, Vertex], float]  # infinite where the rules forbid it
    index: Callable[[int, Vertex], float]  # 0 where it does not count


def compute_costs(
    path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, options: PlanOptions
) -> Priced:
    window, seconds = compute_transition_windows(path, candidates, float(VELOCITY.min()))
    counted = path.counted[path.stations]
    gamma = wrap_angle(candidates.phi[None] + path.offset[path.stations][:, None])
    S = len(path.stations)
    vertices = [[tuple(int(x) for x in v) for v in np.argwhere(candidates.feasible[s])] for s in range(S)]
    price = np.full((S, len(candidates.phi)), 0.0)
    weight = length_weight(path)
    if options.preferred_rotation is not None:
        liked = options.preferred_weight * (1.0 - np.cos(gamma - options.preferred_rotation)) / 2.0
        price[counted] = liked[counted] * weight[counted, None]

    @cache
    def node(s: int, v: Vertex) -> float:
        share = weight[s]
        return float(options.weights.mean * scores.cost[s, v[0], v[1]] / scores.scale * share + price[s, v[0]])

    @cache
    def step(s: int, a: Vertex, b: Vertex) -> float:
        return transition(path, candidates, window, seconds, s, a, b, options)

    @cache
    def index(s: int, v: Vertex) -> float:
        return float(scores.cost[s, v[0], v[1]] / scores.scale) if counted[s] else 0.0

    return Priced(vertices, node, step, index)


def every_sequence(
    path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, options: PlanOptions
) -> Iterator[tuple[float, float, list[Vertex]]]:
    """Return (cost without the worst index, worst index, sequence) of every allowed sequence, depth first."""
    p = compute_costs(path, candidates, scores, options)

    def go(s: int, before: list[Vertex], total: float, worst: float) -> Iterator[tuple[float, float, list[Vertex]]]:
        if s == len(p.vertices):
            yield total, worst, before
            return
        for v in p.vertices[s]:
            price_of_step = 0.0 if s == 0 else p.step(s, before[-1], v)
            if np.isfinite(price_of_step):
                high = max(worst, p.index(s, v))
                yield from go(s + 1, [*before, v], total + price_of_step + p.node(s, v), high)

    return go(0, [], 0.0, 0.0)


def every_price(
    path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, options: PlanOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) cost without the worst index and (N,) worst index of all sequences, station by station."""
    p = compute_costs(path, candidates, scores, options)
    last, total, worst = np.zeros(1, int), np.zeros(1), np.zeros(1)  # vertex at which each sequence ends
    for s, here in enumerate(p.vertices):
        before = p.vertices[s - 1] if s else [(0, 0, 0)]
        steps = np.array([[p.step(s, a, b) if s else 0.0 for b in here] for a in before]).reshape(
            len(before), len(here)
        )
        at, to = np.nonzero(np.isfinite(steps)[last])
        node, index = (np.array([of(s, v) for v in here]) for of in (p.node, p.index))
        last, total, worst = to, total[at] + steps[last[at], to] + node[to], np.maximum(worst[at], index[to])
    return total, worst


def sequence(choice: SequenceChoice) -> list[Vertex]:
    return [tuple(int(x) for x in v) for v in zip(choice.rotation, choice.branch, choice.turn, strict=True)]


def price_of(
    found: list[Vertex], path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, options: PlanOptions
) -> tuple[float, float]:
    return next((t, w) for t, w, v in every_sequence(path, candidates, scores, options) if v == found)


# --- comparison with every sequence -------------------------------------------------------------------------


def test_single_and_batched_sequences_have_the_same_cost() -> None:
    path, candidates, scores = random_problem(2)
    options = PlanOptions(weights=ObjectiveWeights(travel=0.3, rotation=0.4), preferred_rotation=0.5)
    total, worst = every_price(path, candidates, scores, options)
    one_by_one = [(t, w) for t, w, _ in every_sequence(path, candidates, scores, options)]
    assert len(one_by_one) > 1000
    np.testing.assert_allclose(np.transpose([total, worst]), one_by_one, rtol=1e-14)


@pytest.mark.parametrize("seed", range(8))
def test_cheapest_of_all_sequences(seed: int) -> None:
    path, candidates, scores = random_problem(seed)
    options = PlanOptions(
        weights=ObjectiveWeights(mean=1.0, worst=0.0, travel=0.3, rotation=0.4), preferred_rotation=0.5
    )
    best = min(every_sequence(path, candidates, scores, options), key=lambda x: x[0], default=None)
    choice = choose_sequence(path, candidates, scores, VELOCITY, options)
    if best is None:
        assert choice.broken
        return
    assert not choice.broken
    assert not choice.dropped.any()
    assert price_of(sequence(choice), path, candidates, scores, options)[0] == pytest.approx(best[0], rel=1e-12)
    for s, v in enumerate(sequence(choice)):
        np.testing.assert_array_equal(choice.q[s], get_joints(candidates, s, v))


@pytest.mark.parametrize("rapid", [(0, 3), (0,), (0, 2, 4)])
@pytest.mark.parametrize("seed", range(12))
def test_no_sequence_is_below_the_bound_and_the_choice_is_within_the_gap(seed: int, rapid: Rapid) -> None:
    path, candidates, scores = random_problem(seed, rapid)
    weights = ObjectiveWeights(mean=1.0, worst=0.0, travel=0.3, rotation=0.4)
    found = every_sequence(path, candidates, scores, PlanOptions(weights=weights))
    # costs and worst index separately: the same for each weight of the worst index
    every = {tuple(v): (t, w) for t, w, v in found}
    for worst in (0.05, 0.5, 4.0):
        options = PlanOptions(weights=replace(weights, worst=worst))
        ideal = min((t + worst * w for t, w in every.values()), default=None)
        choice = choose_sequence(path, candidates, scores, VELOCITY, options)
        if ideal is None:
            assert choice.broken
            continue
        total, high = every[tuple(sequence(choice))]
        assert choice.total == pytest.approx(total + worst * high, rel=1e-12)
        assert choice.bound <= ideal * (1 + 1e-12)
        assert ideal * (1 - 1e-12) <= choice.total <= ideal * (1 + 1.01 * GAP)
        assert choice.total - choice.bound <= 1.01 * GAP * choice.total


@pytest.mark.parametrize("seed", range(12))
def test_no_rapid_move_joins_blocked_branches(seed: int) -> None:
    path, candidates, scores = random_problem(seed, (0, 2, 4))
    options = PlanOptions(weights=ObjectiveWeights(mean=1.0, worst=0.0, travel=0.3, rotation=0.4))
    branches = candidates.q.shape[2]
    shut = np.random.default_rng(seed).random((branches, branches)) < 0.4
    np.fill_diagonal(shut, False)
    run = path.run[path.stations]
    rapid = [s for s in range(1, len(run)) if run[s] != run[s - 1]]
    assert rapid

    def may(v: list[Vertex]) -> bool:
        return not any(shut[v[s - 1][1], v[s][1]] for s in rapid)

    every = [(t, v) for t, _, v in every_sequence(path, candidates, scores, options)]
    left = [t for t, v in every if may(v)]
    choice = choose_sequence(path, replace(candidates, shut=shut), scores, VELOCITY, options)
    if not left:
        assert choice.broken or choice.dropped.any()
        return
    found = sequence(choice)
    assert may(found)
    assert next(t for t, v in every if v == found) == pytest.approx(min(left), rel=1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_worst_case_search_ends_at_the_optimum(seed: int) -> None:
    """Sequences are pairs (value, worst) only, with numbers that no real job has."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 200))
    value, worst = rng.gamma(2.0, size=n), rng.gamma(2.0, size=n)
    weight = float(rng.uniform(0.01, 3.0))
    values = []

    def at(k: int) -> WorstLimitedSequence:
        return WorstLimitedSequence(np.full((1, 3), k, np.int32), float(value[k]), float(worst[k]))

    def solve(cap: float, limit: float) -> WorstLimitedSequence | None:
        values.append(cap)
        inside = np.flatnonzero((worst <= cap) & (value < limit))
        return at(int(inside[np.argmin(value[inside])])) if len(inside) else None

    found = trade_worst_index(at(int(np.argmin(value))), float(worst.min()), weight, solve)
    ideal = float((value + weight * worst).min())
    assert found.bound <= ideal <= found.total <= ideal * (1 + 1.01 * GAP)
    assert found.gap <= 1.01 * GAP
    assert len(values) <= SOLVES


def test_unordered_branches_may_be_followed_by_continuity() -> None:
    """Solvers without a fixed branch order: the sequence follows the joint values, not the branch number."""
    path, candidates, scores = random_problem(3, rapid=(0,), turning=1)
    q = np.broadcast_to(candidates.q[:1, :1], candidates.q.shape).copy()
    q[:, :, 1, 1] += np.radians(90.0)  # configurations so far apart that no step connects them
    q[2] = q[2][:, ::-1]  # at station 2 the two branches are exchanged
    free = np.ones_like(candidates.feasible)
    cost = np.full(scores.cost.shape, 2.0)
    cost[:2, :, 0] = cost[2, :, 1] = cost[3:, :, 0] = 1.0
    for stable, expected in ((False, [0, 0, 1, 0, 0]), (True, None)):
        swapped = replace(candidates, q=q, feasible=free, stable=stable)
        choice = choose_sequence(path, swapped, replace(scores, cost=cost), VELOCITY, PlanOptions())
        if expected is None:
            assert choice.broken
        else:
            assert not choice.broken
            assert choice.branch.tolist() == expected


# --- continuity ---------------------------------------------------------------------------------------------


def winding(path: PlanningPath, limit_turns: tuple[int, ...]) -> tuple[CandidateGrid, CandidateScores]:
    """One rotation, one branch; joint 6 moves from 150° to 210° in steps of 15°, across the discontinuity at 180°."""
    S = len(path.stations)
    q = np.zeros((S, 1, 1, 6))
    q[:, 0, 0, 5] = wrap_angle(np.radians(150 + 15.0 * np.arange(S)))
    turns = np.zeros((len(limit_turns), 6))
    turns[:, 5] = 2 * np.pi * np.array(limit_turns)
    feasible = np.ones((S, 1, 1, len(turns)), bool)
    candidates = CandidateGrid(
        branch=np.arange(1),
        phi=np.zeros(1),
        q=q,
        turns=turns,
        reason=np.zeros((S, 1, 1), np.uint8),
        feasible=feasible,
        stable=True,
        shortfall=np.zeros(S),
    )
    return candidates, CandidateScores(np.ones((S, 1, 1)), "stiffness", 1.0)


def test_joint_6_passes_180_degrees_without_a_jump() -> None:
    path = line(5)
    candidates, scores = winding(path, (0, 1))
    choice = choose_sequence(path, candidates, scores, VELOCITY, PlanOptions())
    assert not choice.broken
    np.testing.assert_allclose(np.degrees(choice.q[:, 5]), 150 + 15.0 * np.arange(5))
    assert choice.turn.tolist() == [0, 0, 0, 1, 1]


def test_sequence_breaks_where_the_next_turn_exceeds_the_limits() -> None:
    path = line(5)
    candidates, scores = winding(path, (0,))
    choice = choose_sequence(path, candidates, scores, VELOCITY, PlanOptions())
    assert choice.broken == (3,)
    assert not choice.dropped.any()


def test_rapid_move_unwinds_at_its_cost() -> None:
    path = line(5, rapid=(0, 3))
    candidates, scores = winding(path, (0,))
    choice = choose_sequence(path, candidates, scores, VELOCITY, PlanOptions())
    assert choice.broken == ()
    assert np.degrees(choice.q[3, 5] - choice.q[2, 5]) == pytest.approx(-345)
    both, _ = winding(path, (0, 1))
    dear = PlanOptions(weights=ObjectiveWeights(travel=1.0))
    assert np.degrees(np.diff(choose_sequence(path, both, scores, VELOCITY, dear).q[:, 5])).max() == pytest.approx(15)


def test_branch_changes_only_over_a_rapid_move() -> None:
    path = line(6, rapid=(0, 3))
    rng = np.random.default_rng(0)
    q = np.broadcast_to(rng.uniform(-1, 1, (1, 1, 2, 6)), (6, 1, 2, 6)).copy()
    cost = np.ones((6, 1, 2))
    cost[:3, :, 1] = cost[3:, :, 0] = 5.0
    candidates = CandidateGrid(
        branch=np.arange(2),
        phi=np.zeros(1),
        q=q,
        turns=NO_TURN,
        reason=np.zeros((6, 1, 2), np.uint8),
        feasible=np.ones((6, 1, 2, 1), bool),
        stable=True,
        shortfall=np.zeros(6),
    )
    choice = choose_sequence(path, candidates, CandidateScores(cost, "stiffness", 1.0), VELOCITY, PlanOptions())
    assert choice.branch.tolist() == [0, 0, 0, 1, 1, 1]
    whole = line(6)
    choice = choose_sequence(whole, candidates, CandidateScores(cost, "stiffness", 1.0), VELOCITY, PlanOptions())
    assert len(set(choice.branch.tolist())) == 1


def test_missing_branch_is_no_predecessor() -> None:
    """The joints of a branch that does not exist at the station before are NaN:
    it is not a predecessor and causes no error."""
    path, candidates, scores = random_problem(1, rapid=(0,))
    q = candidates.q.copy()
    feasible = np.ones_like(candidates.feasible)
    q[2, 1:, :, :] = np.nan
    feasible[2, 1:] = False
    holes = replace(candidates, q=q, feasible=feasible)
    cost = np.random.default_rng(0).uniform(0.5, 2, scores.cost.shape)
    cost[2, 1:] = np.nan
    choice = choose_sequence(
        path, holes, replace(scores, cost=cost), VELOCITY, PlanOptions(weights=ObjectiveWeights(worst=0.0))
    )
    best = min(
        every_sequence(path, holes, replace(scores, cost=cost), PlanOptions(weights=ObjectiveWeights(worst=0.0))),
        key=lambda x: x[0],
    )
    assert sequence(choice) == best[2]


def test_stations_without_configurations_are_dropped() -> None:
    path, candidates, scores = random_problem(0, rapid=(0,), turning=1)
    feasible = np.ones_like(candidates.feasible)
    feasible[2] = False
    cost = np.where(feasible.any(axis=-1), 1.0, np.nan)
    choice = choose_sequence(
        path, replace(candidates, feasible=feasible), replace(scores, cost=cost), VELOCITY, PlanOptions()
    )
    assert choice.dropped.tolist() == [False, False, True, False, False]
    assert np.isnan(choice.q[2]).all()
    assert np.isfinite(choice.q[[0, 1, 3, 4]]).all()
    nothing = choose_sequence(
        path,
        replace(candidates, feasible=feasible & False),
        replace(scores, cost=cost * np.nan),
        VELOCITY,
        PlanOptions(),
    )
    assert nothing.dropped.all()
    assert nothing.broken == ()
    first = feasible.copy()
    first[0] = False
    assert choose_sequence(
        path, replace(candidates, feasible=first), replace(scores, cost=cost), VELOCITY, PlanOptions()
    ).dropped[0]


def test_rotation_is_constant_in_plunges_and_limited_by_the_axes() -> None:
    rows: Rows = [
        ((0, 0, 0.03), UP, R),
        ((0, 0, 0.0), UP, C),
        ((0.006, 0, 0), UP, C),
        ((0.012, 0, 0), UP, C),
        ((0.012, 0, 0.01), UP, C),
    ]
    for feed in (0.002, 0.3):
        path = build_planning_path(toolpath(rows, feed=feed))
        n, S = 72, len(path.stations)
        candidates = CandidateGrid(
            branch=np.arange(1),
            phi=np.arange(n) * 2 * np.pi / n - np.pi,
            q=np.zeros((S, n, 1, 6)),
            turns=NO_TURN,
            reason=np.zeros((S, n, 1), np.uint8),
            feasible=np.ones((S, n, 1, 1), bool),
            stable=True,
            shortfall=np.zeros(S),
        )
        window, seconds = compute_transition_windows(path, candidates, 2.0)
        assert (window[path.plunge[path.stations]] == 0).all()
        assert window[0] < 0
        turning = window > 0
        rate = window[turning] * 2 * np.pi / n / seconds[turning]
        assert (rate <= TURNING * 2.0 * 1.01).all()
        assert turning.any() == (feed < 0.1)  # 12 mm at 0.3 m/s do not leave the time for 5° at 1.6 rad/s


# --- requirements of the user -------------------------------------------------------------------------------


def open_grid(path: PlanningPath, n: int = 72) -> CandidateGrid:
    S = len(path.stations)
    return CandidateGrid(
        branch=np.arange(1),
        phi=np.arange(n) * 2 * np.pi / n - np.pi,
        q=np.zeros((S, n, 1, 6)),
        turns=NO_TURN,
        reason=np.zeros((S, n, 1), np.uint8),
        feasible=np.ones((S, n, 1, 1), bool),
        stable=True,
        shortfall=np.zeros(S),
    )


def test_bounds_fixed_and_preferred_rotation() -> None:
    path = line(5)
    low, high = np.radians([-20.0, 35.0])
    bounded = open_grid(path)
    _forbid_by_user(path, bounded.phi, PlanOptions(rotation_range=(low, high)), bounded.reason, bounded.feasible)
    gamma = wrap_angle(bounded.phi[None] + path.offset[path.stations][:, None])
    inside = (gamma >= low - 1e-6) & (gamma <= high + 1e-6)
    np.testing.assert_array_equal(bounded.feasible[:, :, 0, 0], inside)
    assert (bounded.reason[~inside] == InfeasibilityReason.BOUNDS).all()
    fixed = open_grid(path)
    _forbid_by_user(
        path, fixed.phi, PlanOptions(fixed=(FixedRotation(2, np.radians(42.0)),)), fixed.reason, fixed.feasible
    )
    assert fixed.feasible[[0, 1, 3, 4]].all()
    assert np.degrees(gamma[2, fixed.feasible[2, :, 0, 0]]) == pytest.approx(
        [40.0]
    )  # the nearest grid rotation; smoothing makes it exact
    scores = CandidateScores(np.ones((5, 72, 1)), "stiffness", 1.0)
    liked = PlanOptions(preferred_rotation=np.radians(65.0), weights=ObjectiveWeights(worst=0.0))
    choice = choose_sequence(path, open_grid(path), scores, VELOCITY, liked)
    np.testing.assert_allclose(np.degrees(gamma[np.arange(1, 5), choice.rotation[1:]]), 65.0)


@pytest.mark.parametrize("worst", [0.5, 4.0])
@pytest.mark.parametrize("seed", range(8))
def test_segment_chosen_again_is_the_best_with_the_rest_fixed(seed: int, worst: float) -> None:
    path, candidates, scores = random_problem(seed)
    options = PlanOptions(weights=ObjectiveWeights(mean=1.0, worst=worst, travel=0.3, rotation=0.4))
    grid = SequenceGrid.build(path, candidates, scores, VELOCITY, options)
    choice = grid.choose()
    if choice.broken or choice.dropped.any():
        return
    S, s = len(choice.rotation), int(np.random.default_rng(seed).integers(0, len(choice.rotation)))
    candidates.feasible[s, choice.rotation[s], choice.branch[s], choice.turn[s]] = False
    first, last = max(s - 2, -1), min(s + 2, S)
    old = sequence(choice)
    ideal = min(
        (
            t + worst * w
            for t, w, v in every_sequence(path, candidates, scores, options)
            if v[: max(first + 1, 0)] == old[: max(first + 1, 0)] and v[last:] == old[last:]
        ),
        default=None,
    )
    again = grid.again(choice, first, last, ForbiddenTransitions.none())
    if ideal is None:
        assert again is None
        return
    assert again is not None
    assert ideal * (1 - 1e-12) <= again.total <= ideal * (1 + 1.01 * GAP)
    total, high = price_of(sequence(again), path, candidates, scores, options)
    assert again.total == pytest.approx(total + worst * high, rel=1e-12)
    assert again.bound == choice.bound


def test_choice_and_assignment_are_read_only() -> None:
    """Code that needs another choice creates a new object: the data of other steps do not change."""
    row = np.zeros(3, np.int32)
    choice = SequenceChoice(rotation=row, branch=row.copy(), turn=row.copy(), q=np.zeros((3, 6)), broken=())
    assignment = JointAssignment(
        phi=np.zeros(3),
        q=np.zeros((3, 6)),
        branch=np.zeros(3, np.int32),
        reason=np.zeros(3, np.uint8),
        **{margin: np.zeros(3) for margin in MARGINS},
    )
    for found in (choice, assignment, assignment.marked(np.array([True, False, False]), InfeasibilityReason.GAP)):
        for values in vars(found).values():
            if isinstance(values, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    values[0] = 1
