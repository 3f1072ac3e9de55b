"""D-optimal choice of readings, compared with exhaustive search and independent algebra."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from machopt.measurement.design.d_optimal_search import (
    compute_design_criterion,
    compute_information_matrix,
    find_d_optimal_design,
)
from machopt.measurement.design.design_problem import DesignProblem, ModelBelief
from machopt.measurement.design.efficiency_bound import compute_efficiency_bound
from machopt.measurement.design.expected_accuracy import (
    compute_design_efficiency,
    compute_expected_accuracy,
    find_smallest_number,
)
from machopt.measurement.design.measurement_schedule import build_schedule, order_poses_by_travel
from machopt.measurement.design.reading_noise import ReadingNoise


def build_random_design(
    seed: int, poses: int = 6, loads: int = 4, rows: int = 2, unknowns: int = 3, shared: float = 0.5
) -> DesignProblem:
    """Return random responses, noise of different size and shape for each reading, and a correlated pose error."""
    rng = np.random.default_rng(seed)
    n = poses * loads
    half = rng.normal(size=(n, rows, rows))
    W = rng.normal(size=(rows, rows))
    model = ModelBelief(rng.normal(size=(n, rows, unknowns)), 0.3 * half @ half.transpose(0, 2, 1) + 0.2 * np.eye(rows))
    return DesignProblem((model,), np.repeat(np.arange(poses), loads), shared * W @ W.T)


def every_design(problem: DesignProblem, poses: int, loads: int):
    blocks = [
        list(itertools.combinations(np.flatnonzero(problem.pose == p).tolist(), loads)) for p in np.unique(problem.pose)
    ]
    for chosen in itertools.combinations(blocks, poses):
        yield from itertools.product(*chosen)


def whiten_design(problem: DesignProblem, blocks, columns=None):
    """Return the whitened responses of a design from its full covariance matrix, including pose errors."""
    m = problem.models[0]
    rows = [n for b in blocks for n in b]
    D = len(problem.shared)
    V = np.zeros((len(rows) * D,) * 2)
    for i, a in enumerate(rows):
        for j, b in enumerate(rows):
            part = problem.shared if problem.pose[a] == problem.pose[b] else np.zeros((D, D))
            V[i * D : i * D + D, j * D : j * D + D] = part + (m.covariance[a] if a == b else 0.0)
    A = (m.response if columns is None else columns)[rows]
    return np.linalg.solve(np.linalg.cholesky(V), A.reshape(len(rows) * D, -1))


def test_information_equals_generalised_least_squares() -> None:
    problem = build_random_design(0)
    blocks = ((0, 2), (5,), (9, 10, 11))
    white = whiten_design(problem, blocks)
    np.testing.assert_allclose(compute_information_matrix(problem, blocks), white.T @ white, rtol=1e-10)


@pytest.mark.parametrize(("poses", "loads", "shared"), [(2, 1, 0.0), (3, 1, 0.5), (2, 2, 0.5), (3, 2, 5.0)])
@pytest.mark.parametrize("seed", range(4))
def test_chosen_design_is_the_best_of_all(poses: int, loads: int, shared: float, seed: int) -> None:
    problem = build_random_design(seed, shared=shared)
    found = find_d_optimal_design(problem, poses, loads, rng=np.random.default_rng(0), starts=8)
    best = max(compute_design_criterion(problem, blocks) for blocks in every_design(problem, poses, loads))
    assert found.value == pytest.approx(best, abs=1e-9)  # 8 starts find the global optimum of such small problems
    assert compute_design_criterion(problem, found.blocks) == pytest.approx(found.value, abs=1e-9)


@pytest.mark.parametrize("loads", [1, 2, 3])
def test_bound_is_below_the_true_efficiency(loads: int) -> None:
    for seed in range(3):
        problem = build_random_design(seed, poses=5)
        designs = list(every_design(problem, 3, loads))
        best = max(compute_design_criterion(problem, b) for b in designs)
        rng = np.random.default_rng(seed)
        good = find_d_optimal_design(problem, 3, loads, rng=rng)
        poor = [designs[i] for i in rng.integers(len(designs), size=10)]
        for blocks in (good.blocks, *poor):
            true = np.exp((compute_design_criterion(problem, blocks) - best) / 3)
            # the bound does not include the ridge of the criterion, 1e-4 of the information
            assert compute_efficiency_bound(problem, type(good)(blocks, 0.0), loads) <= true * (1 + 1e-3)
        assert compute_efficiency_bound(problem, good, loads) > 0.3  # not trivial: a bound of 0 would always hold


def build_large_design(seed: int = 3) -> DesignProblem:
    return build_random_design(seed, poses=300, loads=12, rows=3, unknowns=6)


def test_exchange_never_worsens_and_uses_each_pose_once() -> None:
    problem = build_large_design()
    found = find_d_optimal_design(problem, 10, 2, rng=np.random.default_rng(5), starts=3)
    assert len(found.history) > 1
    assert (np.diff(found.history) > 0).all()
    assert found.history[-1] == found.value
    poses = [{int(problem.pose[n]) for n in block} for block in found.blocks]
    assert all(len(p) == 1 for p in poses)
    assert len(set.union(*poses)) == len(found.blocks) == 10
    assert all(len(set(block)) == 2 for block in found.blocks)


def test_same_seed_same_design() -> None:
    a, b = (find_d_optimal_design(build_large_design(), 8, 2, rng=np.random.default_rng(7), starts=3) for _ in range(2))
    assert a.blocks == b.blocks


def test_fewer_candidates_than_requested_are_all_taken() -> None:
    problem = build_random_design(1, poses=3, loads=2)
    found = find_d_optimal_design(problem, 9, 5, rng=np.random.default_rng(0))
    assert sorted(n for b in found.blocks for n in b) == list(range(6))


def test_unit_of_an_unknown_has_no_influence() -> None:
    """With constant noise, scaling an unknown adds a constant to log det: the design does not depend on the prior
    stiffness."""
    problem = build_large_design()
    m = problem.models[0]
    scaled = DesignProblem(
        (ModelBelief(m.response * np.array([3.0, 0.2, 1, 7, 0.5, 2]), m.covariance),), problem.pose, problem.shared
    )
    a, b = (find_d_optimal_design(p, 8, 2, rng=np.random.default_rng(0)) for p in (problem, scaled))
    # only the ridge has a unit; it changes log det by less than 1e-4
    assert compute_design_criterion(problem, b.blocks) == pytest.approx(a.value, abs=1e-3)


def test_design_for_several_priors_maximises_their_mean() -> None:
    one, other = build_random_design(0), build_random_design(10)
    halves = tuple(replace(p.models[0], weight=0.5) for p in (one, other))
    both = DesignProblem(halves, one.pose, one.shared)
    found = find_d_optimal_design(both, 2, 2, rng=np.random.default_rng(0), starts=8)
    best = max(compute_design_criterion(both, blocks) for blocks in every_design(both, 2, 2))
    assert found.value == pytest.approx(best, abs=1e-9)
    alone = find_d_optimal_design(one, 2, 2, rng=np.random.default_rng(0), starts=8)
    assert compute_design_criterion(both, alone.blocks) < found.value


def test_accuracy_names_unobservable_parameters() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(40, 5))
    A[:, 3] = -2.0 * A[:, 1]  # only a combination of these two is observable
    A[:, 4] = 0.0
    found = compute_expected_accuracy(A.T @ A)
    assert found.unidentified_groups == ((1, 3), (4,))
    assert np.isinf(found.sigma[[1, 3, 4]]).all()
    clean = np.linalg.inv(A[:, [0, 1, 2]].T @ A[:, [0, 1, 2]])
    np.testing.assert_allclose(found.sigma[[0, 2]], np.sqrt(np.diag(clean))[[0, 2]], rtol=1e-9)
    assert compute_design_efficiency(found, found) == pytest.approx((1, 1, 1))
    assert compute_design_efficiency(compute_expected_accuracy(0.25 * A.T @ A), found) == pytest.approx(
        (0.25, 0.25, 0.25)
    )
    assert compute_design_efficiency(compute_expected_accuracy(np.diag([0.0, 1, 1, 1, 1])), found) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("first", [1, 7, 30, 200])
@pytest.mark.parametrize("target", [0.11, 0.3, 1.0])
def test_smallest_sufficient_number_is_found(first: int, target: float) -> None:
    def reaches(n: int) -> float:
        return 1.0 / np.sqrt(n) if n > 2 else np.inf

    n = find_smallest_number(reaches, target, first, 150)
    assert n is not None
    assert reaches(n) <= target < reaches(n - 1)
    assert find_smallest_number(reaches, 0.05, first, 150) is None


def test_reversed_second_round_cancels_a_steady_drift() -> None:
    """The second round is in reverse order: the mean time of both visits is the same for every pose."""
    blocks = [(0, 1), (5, 4), (9,), (12, 13)]
    visits = build_schedule(blocks, 2, np.random.default_rng(0))
    assert sorted(v.reading for v in visits) == sorted(2 * [n for b in blocks for n in b])
    poses = [v.pose for v in visits]
    assert poses == poses[::-1]
    for pose in range(len(blocks)):
        own = [v.cycle for v in visits if v.pose == pose]
        assert own == list(range(len(own)))
        times = [n for n, v in enumerate(visits) if v.pose == pose]
        assert np.mean(times) == pytest.approx((len(visits) - 1) / 2)
    assert {v.round for v in visits} == {0, 1}


def test_visiting_order_is_short() -> None:
    rng = np.random.default_rng(2)
    q, home, v = rng.uniform(-2, 2, (7, 6)), np.zeros(6), np.array([1, 1, 1, 2, 2, 3.0])

    def seconds(order) -> float:
        at = np.concatenate([home[None], q[list(order)]])
        return float(np.max(np.abs(np.diff(at, axis=0)) / v, axis=1).sum())

    way = order_poses_by_travel(q, home, v)
    assert sorted(way.tolist()) == list(range(7))
    best = min(seconds(p) for p in itertools.permutations(range(7)))
    assert seconds(way) <= 1.15 * best  # 2-opt is no global optimizer; its error on few points is usually at most 15 %


def test_noise_of_a_reading_by_simulation() -> None:
    noise = ReadingNoise(displacement=12e-6, cycle=15e-6, pose=30e-6, force=0.01, targets=0.2, cycles=3)
    rng = np.random.default_rng(0)
    true = np.array([[1e-3, 0, 0, 2e-3, 0, 0]])
    size = np.repeat([1.0, 5.0], 3)  # rotations are measured with a lever of 0.2 m
    n = 200_000
    loads, b = 0.01 * rng.normal(size=(n, 1)), 30e-6 * rng.normal(size=(n, 6)) * size
    cycles = np.zeros((n, 6))
    for _ in range(3):
        white = rng.normal(size=(3, n, 6)) * 12e-6
        cycles += (white[0] - (white[1] + white[2]) / 2 + 15e-6 * rng.normal(size=(n, 6))) * size / 3
    found = np.cov((true * (1 + loads) + b + cycles).T)
    expected = noise.covariance(true)[0] + noise.shared()
    # 200,000 draws give a variance to 0.3 %, and a covariance to the same share of both standard deviations
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 0.015
    assert noise.reading == pytest.approx(np.sqrt(1.5 * 12**2 + 15**2 + 30**2) * 1e-6)
