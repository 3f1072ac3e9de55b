"""Objective J: equal in grid search, smoothing and finished plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_planning_path import Rows, toolpath
from test_rotation_smoothing import valley
from test_sequence_search import VELOCITY, random_problem

from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.cost.objective import (
    NEAR,
    AssignmentCosts,
    ObjectiveTerms,
    PlanObjective,
    compute_crowding,
    compute_objective,
)
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.smoothing.corridor import REACH, SmoothingStretch, StretchEnds
from machopt.planning.smoothing.cost_interpolation import CostInterpolation
from machopt.planning.smoothing.cubic_curves import CubicSpline
from machopt.planning.smoothing.newton_solver import SplineBasis, SplineObjective
from machopt.planning.smoothing.rotation_angle_spline import build_spline_solutions
from machopt.planning.smoothing.rotation_smoothing import follow_grid_rotation
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path

UP = (0.0, 0.0, 1.0)
OPTIONS = PlanOptions(
    weights=ObjectiveWeights(mean=0.8, worst=0.7, travel=0.3, rotation=0.4, feed=3.0, clearance=0.6),
    preferred_rotation=0.5,
    preferred_weight=0.3,
)
SAME = 1e-12  # relative to J: rounding of some hundred sums


def build_finished_objective(
    path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, choice: SequenceChoice
) -> PlanObjective:
    """Return J of the grid's sequence as a finished plan; every planning point is a station."""
    assert len(path.stations) == len(path.index)
    plain = follow_grid_rotation(path, candidates, choice)
    cost = scores.cost[np.arange(len(path.index)), choice.rotation, choice.branch]
    crowded = None if scores.crowded is None else scores.crowded[np.arange(len(cost)), choice.rotation, choice.branch]
    costs = AssignmentCosts(cost=cost, q=choice.q, phi=plain.phi, crowded=crowded)
    return compute_objective(path, costs, scores.scale, VELOCITY, OPTIONS)


def by_stretches(
    path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, choice: SequenceChoice
) -> float:
    """Return J of the grid's sequence as the smoothing computes it, run by run."""
    terms = ObjectiveTerms.at_stations(path, VELOCITY, OPTIONS)
    total, worst, before = 0.0, 0.0, None
    for first, last in path.runs:
        part = SmoothingStretch.build(path, candidates, scores, choice, np.arange(first, last + 1), terms)
        joints = part.joints()
        total += float(part.price(part.band.cost[:, REACH], part.offset))
        total += part.price_of_flights(joints[0], joints[-1], StretchEnds(before))
        worst, before = max(worst, part.worst()), joints[-1]
    return total + OPTIONS.weights.worst * worst


@pytest.mark.parametrize("rapid", [(0, 3), (0,), (0, 2, 4)])
def test_search_smoothing_and_finished_plan_agree_on_random_sequences(rapid: tuple[int, ...]) -> None:
    """Each example has other costs and therefore another best sequence."""
    found = 0
    for seed in range(40):
        path, candidates, scores = random_problem(seed, rapid)
        if seed % 2:
            scores = replace(scores, crowded=np.random.default_rng(seed).random(scores.cost.shape))
        choice = choose_sequence(path, candidates, scores, VELOCITY, OPTIONS)
        if choice.broken or choice.dropped.any():
            continue
        whole = build_finished_objective(path, candidates, scores, choice)
        assert choice.total == pytest.approx(whole.total, rel=SAME)
        assert by_stretches(path, candidates, scores, choice) == pytest.approx(whole.total, rel=SAME)
        found += 1
    assert found >= 15


def test_fixed_rotations_off_the_grid_rotate_exactly() -> None:
    path, candidates, scores = random_problem(1, (0,))
    rng = np.random.default_rng(0)
    nudged = replace(candidates, nudge=rng.uniform(-0.5, 0.5, len(path.stations)))
    free = replace(nudged, feasible=np.ones_like(candidates.feasible))
    scores = replace(scores, cost=np.where(np.isfinite(scores.cost), scores.cost, 1.0))
    choice = choose_sequence(path, free, scores, VELOCITY, OPTIONS)
    assert not choice.broken
    assert choice.total == pytest.approx(build_finished_objective(path, free, scores, choice).total, rel=SAME)


def stretch(crowds: bool) -> tuple[PlanningPath, SmoothingStretch, StretchEnds]:
    """Return a straight cut whose best rotation oscillates along the path, with rapid moves before and after."""
    rows: Rows = [((0, 0, 0), UP, MoveKind.RAPID)] + [
        ((x, 0, 0), UP, MoveKind.CUT) for x in np.linspace(0, 0.3, 61)[1:]
    ]
    path = build_planning_path(toolpath(rows, feed=0.2))  # fast enough for rotation to cost time
    target = 0.3 + 0.4 * np.sin(4 * path.s / path.s[-1])
    candidates, scores = valley(path, target)
    away = np.abs(np.asarray(wrap_angle(candidates.phi_at() - target[path.stations][:, None]))) / np.pi
    scores = replace(scores, crowded=np.broadcast_to(away[:, :, None], scores.cost.shape) if crowds else None)
    choice = choose_sequence(path, candidates, scores, VELOCITY, OPTIONS)
    terms = ObjectiveTerms.at_stations(path, VELOCITY, OPTIONS)
    part = SmoothingStretch.build(path, candidates, scores, choice, np.arange(len(path.stations)), terms)
    part.x = path.s[path.stations]
    return path, part, StretchEnds(np.full(6, 0.1), np.full(6, -0.2), 0.07)


def programme_of(part: SmoothingStretch, knots: np.ndarray, ends: StretchEnds, bending: float = 0.0) -> SplineObjective:
    return SplineObjective(
        part, CostInterpolation(part.band.cost, part.band.step), SplineBasis(knots, part.x), bending, ends, 0.0
    )


@pytest.mark.parametrize("crowds", [False, True])
def test_smoothing_cost_equals_the_objective_along_a_curve(crowds: bool) -> None:
    """Where joints are linear in phi, merit and J are equal.

    The rounded J differs from J by less than a multiple of the rounding width.
    """
    path, part, ends = stretch(crowds)
    answers, merit = build_spline_solutions(path, part, 0.0, ends)
    table, basis = CostInterpolation(part.band.cost, part.band.step), SplineBasis(answers[0].knots, part.x)
    nlp = programme_of(part, answers[0].knots, ends)
    rng = np.random.default_rng(1)
    for answer in (*answers, *(CubicSpline(a.knots, a.c + rng.uniform(-0.05, 0.05, len(a.c))) for a in answers[:3])):
        phi = basis.values(answer.c)
        np.testing.assert_allclose(phi, answer(part.x), atol=1e-12)
        cost = table.at(phi - part.band.phi)[0]
        q = np.zeros((len(phi), 6))
        q[:, 5] = phi
        table_ = part.band.crowded
        crowded = None if table_ is None else part._interpolate_table(table_, phi - part.band.phi)
        costs = AssignmentCosts(cost=cost, q=q, phi=phi, crowded=crowded)
        whole = compute_objective(path, costs, 1.0, VELOCITY, OPTIONS)
        assert crowds or whole.feed > 0 or np.ptp(phi) < 0.1
        assert (whole.clearance > 0) == crowds
        flown = part.price_of_flights(q[0], q[-1], ends)
        assert merit(answer, ends, 0.0) == pytest.approx(whole.total + flown, rel=SAME)
        exact = whole.total + flown
        if crowds and nlp.crowded is not None:  # the nonlinear programme has a cubic where J is piecewise linear
            near = nlp.crowded.at(phi - part.band.phi)[0]
            exact += OPTIONS.weights.clearance * float(part.terms.share @ (near - crowded))
        for width in (1e-9, 1e-6, 1e-3):
            assert 0 <= nlp.model(answer.c, width, 0.0).value - exact + 1e-12 < 100 * width


@pytest.mark.parametrize("width", [0.1, 0.003])
def test_gradient_and_hessian_agree_with_finite_differences(width: float) -> None:
    path, part, ends = stretch(crowds=False)
    answers, _ = build_spline_solutions(path, part, 0.0, ends)
    knots, rng = answers[0].knots, np.random.default_rng(2)
    nlp, basis, h = programme_of(part, knots, ends), SplineBasis(knots, part.x), 1e-6
    for answer in answers[:2]:
        c = answer.c + rng.uniform(-0.03, 0.03, len(answer.c))
        here = nlp.model(c, width, 50.0)
        gradient = basis.transposed(here.gradient)
        curved = here.price * (1.0 - here.slope**2) / here.size
        diagonal, additional = nlp.hessian(here, curved)
        band, dyad = basis.hessian(diagonal, additional), basis.transposed(here.dyad)
        H = sum(np.diag(row[: len(c) - k], -k) for k, row in enumerate(band))
        H = H + np.tril(H, -1).T - np.outer(dyad, dyad)
        for i in rng.permutation(len(c))[:12]:
            e = h * np.eye(len(c))[i]
            up, down = nlp.model(c + e, width, 50.0), nlp.model(c - e, width, 50.0)
            assert gradient[i] == pytest.approx((up.value - down.value) / (2 * h), rel=1e-5, abs=1e-7)
            slopes = basis.transposed(up.gradient - down.gradient) / (2 * h)
            np.testing.assert_allclose(H[i], slopes, rtol=1e-3, atol=1e-3 * np.abs(H).max())


def test_no_perturbation_of_the_smoothed_curve_is_better() -> None:
    """In the exact J plus the bending cost, for random changes of one coefficient, of adjacent ones and of all."""
    path, part, ends = stretch(crowds=False)
    answers, merit = build_spline_solutions(path, part, 0.0, ends)
    knots, rng = answers[0].knots, np.random.default_rng(3)
    bending = 1e-4
    c = programme_of(part, knots, ends, bending).solve(answers[-2].c)

    def exact(c: np.ndarray) -> float:
        return merit(CubicSpline(knots, c), ends, 0.0) + bending * float(np.sum(np.diff(c, 2) ** 2))

    best = exact(c)
    assert np.isfinite(best)
    for size in (0.1, 0.01, 1e-3, 1e-4):
        for width in (1, 4, len(c)):
            for _ in range(20):
                trial, at = c.copy(), rng.integers(0, len(c) - width + 1)
                trial[at : at + width] += size * rng.normal(size=width)
                assert exact(trial) > best - 1e-6 * best


def test_short_rapid_moves_cost_more_travel() -> None:
    """The cost per rad is a·b/π with b = 1 + NEAR/(d + NEAR/10): by hand for one short and one long move."""
    rows: Rows = [
        ((0, 0, 0), UP, MoveKind.RAPID),
        ((0.01, 0, 0), UP, MoveKind.CUT),
        ((0.06, 0, 0), UP, MoveKind.RAPID),
        ((0.07, 0, 0), UP, MoveKind.CUT),
        ((2.07, 0, 0), UP, MoveKind.RAPID),
        ((2.08, 0, 0), UP, MoveKind.CUT),
    ]
    path = build_planning_path(toolpath(rows))
    terms = ObjectiveTerms.build(path, VELOCITY, PlanOptions())
    assert terms.travel[2] == pytest.approx(1 / 3 / np.pi * (1 + NEAR / (0.05 + NEAR / 10)))
    assert terms.travel[4] == pytest.approx(1 / 3 / np.pi * (1 + NEAR / (2.0 + NEAR / 10)))
    assert terms.travel[1] == pytest.approx(1 / 3 / np.pi)
    assert terms.rotation[[0, 2, 4]].tolist() == [0.0, 0.0, 0.0]


def test_clearance_counts_from_contact_to_the_stated_distance() -> None:
    np.testing.assert_allclose(
        compute_crowding(np.array([-0.01, 0.0, 0.02, 0.05, 0.3]), 0.05), [1.0, 1.0, 0.6, 0.0, 0.0]
    )
    path, candidates, scores = random_problem(1, (0,))
    choice = choose_sequence(path, candidates, scores, VELOCITY, OPTIONS)
    near = replace(scores, crowded=np.full(scores.cost.shape, 0.25))
    without, with_ = (build_finished_objective(path, candidates, s, choice) for s in (scores, near))
    assert (without.clearance, with_.clearance) == (0.0, pytest.approx(0.25))
    assert with_.total == pytest.approx(without.total + 0.6 * 0.25)
