"""Continuous refinement of rotation and external joints: order of the model, minimum, never a worse plan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from external_axis_cells import external_cell, external_folder
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from scipy import sparse
from test_external_axes import OPTIONS, UP, K, separate_operations, slots
from test_planning_path import Rows, toolpath

from machopt.cli import main
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.planning.continuous_refinement.bordered_system import BorderedSystem
from machopt.planning.continuous_refinement.offset_curves import OffsetCurves
from machopt.planning.continuous_refinement.plan_improvement import RefinementJob, refine_plan
from machopt.planning.continuous_refinement.quadratic_model import (
    LocalModel,
    OffsetBounds,
    QuadraticModel,
    TransitionTerms,
    minimize_quadratic_model,
)
from machopt.planning.continuous_refinement.refinement import PlanRefinement
from machopt.planning.cost.objective import AssignmentCosts, compute_objective
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.external_axis_optimization import coarse_to_fine_search, refinement_restarts
from machopt.planning.external_axis_optimization.refinement_starts import SearchRequest, find_refinement_starts
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.sampling.joint_path import JointAssignment

MOVING = replace(OPTIONS, rotation_step=np.radians(15.0))


def by_grids(cell: Cell, path: Toolpath, options: PlanOptions) -> Plan:
    """Return the result of the grid search."""
    axes = resolve_axis_options(cell, options)
    request = SearchRequest(
        cell=cell, toolpath=path, options=options, axes=axes, clock=StageTimings(), before=None, scale=None
    )
    return find_refinement_starts(request).best


def plan_by_grids(
    folder: FilePath, path: Toolpath, options: PlanOptions, **kind: bool
) -> tuple[Plan, list[OperationGroup], tuple[ExternalJointOptions, ...]]:
    """Return the result of the grid search, the operation groups and the external axis options."""
    cell = replace(external_cell(folder, **kind), stiffness=K)
    axes = resolve_axis_options(cell, options)
    plan = by_grids(cell, path, options)
    return plan, build_operation_groups(cell, path, plan.path, axes), axes


def build_weaving_slot() -> Toolpath:
    """Return a slot along the rail with a lateral oscillation."""
    y = np.linspace(-0.6, 0.6, 20)
    rows: Rows = [((0.0, y[0], 0.05), UP, MoveKind.RAPID)]
    rows += [((0.25 * float(np.sin(7.0 * v)), float(v), 0.0), UP, MoveKind.CUT) for v in y]
    return toolpath(rows, feed=0.05)


@pytest.fixture(scope="module")
def along(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Plan, list[OperationGroup], tuple[ExternalJointOptions, ...], Toolpath]:
    """An oscillating slot, planned with a moving rail."""
    path = build_weaving_slot()
    return (*plan_by_grids(tmp_path_factory.mktemp("rail"), path, MOVING, rail=True), path)


def test_model_agrees_with_j_to_second_order(
    along: tuple[Plan, list[OperationGroup], tuple[ExternalJointOptions, ...], Toolpath],
) -> None:
    """Half the step gives a quarter of the error: the joints are linear in z, and the step terms have no kink
    nearby."""
    plan, groups, axes, _ = along
    r = PlanRefinement(plan, groups, AxisPlanRanking.build(plan.setup, axes))
    rows = r.rows
    here = r._state(plan.chosen.assignment.phi[rows], plan.path.external[rows], plan.chosen.assignment.q[rows])
    assert here is not None
    a, x = plan.chosen.assignment, plan.setup.in_rad(plan.path, plan.chosen.assignment.q)
    velocity, scale = plan.setup.velocity, plan.scores.scale
    costs = AssignmentCosts(cost=plan.chosen.cost, q=x, phi=a.phi)  # its own terms only
    own = compute_objective(plan.path, costs, scale, velocity, plan.options)
    assert here.merit == pytest.approx(own.total, rel=1e-9)  # every planning point is a station
    local = r._build_local_model(here)
    assert local.known.all()
    trust = np.full((len(rows), 2), 0.2)
    model = QuadraticModel(local, r._build_transition_terms(here, local), r._build_bounds(here, local, trust), r.tied)
    rng = np.random.default_rng(2)
    c = rng.uniform(-1.0, 1.0, r.curves.at_stations.shape[1])
    wrong = []
    for size in (0.04, 0.02):
        z = (r.curves.at_stations @ (size * c)).reshape(trust.shape)
        found, cost = r._solve_stations(here.phi + z[:, 0], here.e + z[:, 1:] / r.per, here.q)
        values = model.value(size * c) - model.value(0.0 * c)
        merit = r._compute_merit(here.phi + z[:, 0], here.e + z[:, 1:] / r.per, found.q, cost)
        wrong.append(abs(values - (merit - here.merit)))
    assert wrong[0] < 0.05 * abs(merit - here.merit) + 1e-4
    assert wrong[1] < 0.45 * wrong[0] + 1e-7


def test_infinite_margins_leave_the_model_unchanged(
    along: tuple[Plan, list[OperationGroup], tuple[ExternalJointOptions, ...], Toolpath],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Arms with an offset wrist have an infinite margin; all of their stations stayed at their initial values."""
    plan, groups, axes, _ = along
    r = PlanRefinement(plan, groups, AxisPlanRanking.build(plan.setup, axes))
    rows = r.rows
    start = plan.chosen.assignment.phi[rows], plan.path.external[rows], plan.chosen.assignment.q[rows]
    solved = r._solve_stations

    def without(*state: np.ndarray) -> tuple[JointAssignment, np.ndarray]:
        found, cost = solved(*state)
        none = np.full(len(rows), np.inf)
        return replace(found, shoulder=none, elbow=none), cost

    here = r._state(*start)
    assert here is not None
    plain = r._build_local_model(here)
    monkeypatch.setattr(r, "_solve_stations", without)
    here = r._state(*start)
    assert here is not None
    local = r._build_local_model(here)
    assert local.known.all()
    np.testing.assert_array_equal(local.hessian, plain.hessian)
    assert np.isfinite(r._build_bounds(here, local, np.full((len(rows), 2), 0.2)).under).all()


def small_problem(seed: int) -> tuple[LocalModel, TransitionTerms, OffsetBounds]:
    """Build three stations with two offsets each; the problem is convex."""
    rng = np.random.default_rng(seed)
    n, d, k = 3, 2, 3
    half = rng.normal(size=(2, n, d, d))
    H, B = 0.3 * half @ np.swapaxes(half, -1, -2)
    local = LocalModel(
        q=np.zeros((n, 6, d)),
        margins=np.zeros((n, 3, d)),
        known=np.ones(n, bool),
        gradient=0.3 * rng.normal(size=(n, d)),
        hessian=H,
        cost=rng.uniform(0.5, 1.0, n),
        slope=rng.normal(size=(n, d)),
        bend=B,
        counted=rng.uniform(size=n) < 0.8,
        worst=0.5,
    )
    steps = TransitionTerms(
        jump=0.2 * rng.normal(size=(n - 1, k)),
        lean=rng.normal(size=(n, k, d)),
        price=rng.uniform(0.0, 0.2, (n - 1, k)),
        lost=rng.uniform(0.0, 0.5, n - 1),
        seconds=rng.uniform(0.0, 0.3, n - 1),
        slowness=rng.uniform(0.0, 1.0, k),
    )
    box = rng.uniform(0.05, 0.5, (2, n, d))
    lean = rng.normal(size=(n, 1, d))
    room = rng.uniform(0.02, 0.3, (n, 1))
    return local, steps, OffsetBounds(-box[0], box[1], lean, -room, np.full((n, 1), np.inf))


@given(st.integers(0, 10**6))
@example(35)  # its worst-case index becomes negative, where an evaluation of the model value was flat
@settings(max_examples=scale_example_count(12), deadline=None)
def test_minimum_of_the_model_against_many_others(seed: int) -> None:
    local, steps, bounds = small_problem(seed)
    n, d = local.gradient.shape
    curves = BorderedSystem(sparse.identity(n * d, format="csr"), d, np.zeros(n * d, bool))
    c = minimize_quadratic_model(local, steps, bounds, curves)
    model = QuadraticModel(local, steps, bounds, curves)

    z = c.reshape(n, d)
    beyond = max(float((bounds.low - z).max()), float((z - bounds.high).max()))
    assert max(beyond, float((bounds.under - np.einsum("nij,nj->ni", bounds.lean, z)).max())) < 1e-4
    rng = np.random.default_rng(seed)
    others = [c * rng.uniform(0.0, 1.0) + s * rng.normal(size=n * d) for s in (0.001, 0.01, 0.1) for _ in range(40)]
    for other in [0.0 * c, *others]:
        y = np.clip(other.reshape(n, d), bounds.low, bounds.high)
        if (np.einsum("nij,nj->ni", bounds.lean, y) >= bounds.under).all():
            assert model.value(c) <= model.value(y.ravel()) + 1e-4


@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(0, 3))
@settings(max_examples=scale_example_count(12), deadline=None)
def test_bordered_band_matrix_is_solved_like_the_dense_one(seed: int, d: int, shared: int) -> None:
    """Reference: the dense matrix MᵀKM, with coefficients in any order and zero to three of them in every station."""
    rng = np.random.default_rng(seed)
    n, own = 7, 5 * d
    M = np.zeros((n * d, own + shared))
    for k in range(own):  # each coefficient affects two consecutive stations
        first = int(rng.integers(n - 1)) * d
        M[first : first + 2 * d, k] = rng.normal(size=2 * d)
    M[:, own:] = rng.normal(size=(n * d, shared))
    half = rng.normal(size=(n - 1, 2 * d, 2 * d))
    K, blocks, on = np.zeros((n * d, n * d)), np.zeros((n, d, d)), np.zeros((n - 1, d, d))
    for k, one in enumerate(half @ np.swapaxes(half, 1, 2)):
        K[k * d : (k + 2) * d, k * d : (k + 2) * d] += one
        blocks[k] += one[:d, :d]
        blocks[k + 1] += one[d:, d:]
        on[k] = one[d:, :d]
    mixed = rng.permutation(own + shared)
    curves = BorderedSystem(sparse.csr_matrix(M[:, mixed]), d, mixed >= own)
    right = rng.normal(size=(own + shared, 2))
    found = curves.solved(blocks, on, 1e-3, 0.0, right)
    assert found is not None
    H = M[:, mixed].T @ K @ M[:, mixed] + 1e-3 * np.eye(own + shared)
    np.testing.assert_allclose(H @ found, right, atol=1e-7 * np.abs(H).max())
    assert curves.border == shared


def test_fixed_joints_have_one_coefficient_per_operation(tmp_path: FilePath) -> None:
    """The external joint moves in a slot and not in a hole; a joint that is constant in an operation has one
    coefficient for it."""
    cell = replace(external_cell(tmp_path, rail=True, table=True), stiffness=K)
    path_in = separate_operations(toolpath([*slots(0.0), *slots(0.3)]))
    options = replace(
        OPTIONS,
        external=(
            ExternalJointOptions(joint="rail", mode="moving"),
            ExternalJointOptions(joint="turn", mode="operation"),
        ),
    )
    plan = by_grids(cell, path_in, replace(options, rotation_step=np.radians(45.0)))
    groups = build_operation_groups(cell, path_in, plan.path, resolve_axis_options(cell, options))
    curves = OffsetCurves.build(plan.path, groups)
    c = np.random.default_rng(0).normal(size=curves.at_points.shape[1])
    z = (curves.at_points @ c).reshape(len(plan.path.index), 3)
    for first, last in plan.path.runs:
        assert np.ptp(z[first : last + 1, 2]) == 0.0
    assert len(np.unique(z[:, 2])) == 2


def job_of(path: Toolpath, groups: list[OperationGroup], worth: AxisPlanRanking) -> RefinementJob:
    return RefinementJob(toolpath=path, groups=groups, worth=worth, clock=StageTimings())


@pytest.mark.slow
def test_moving_rail_is_refined(
    along: tuple[Plan, list[OperationGroup], tuple[ExternalJointOptions, ...], Toolpath],
) -> None:
    plan, groups, axes, path = along
    better = refine_plan(plan, job_of(path, groups, AxisPlanRanking.build(plan.setup, axes)))
    assert better.chosen.objective.total < 0.999 * plan.chosen.objective.total
    low, high = plan.setup.cell.limits.lower[6], plan.setup.cell.limits.upper[6]
    assert low <= better.path.external.min() <= better.path.external.max() <= high
    assert not len(better.missing)


@pytest.mark.slow
@given(st.floats(-0.4, 0.4), st.floats(0.05, 0.4), st.sampled_from(["moving", "operation", "mixed"]))
@settings(
    max_examples=scale_example_count(3), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_refinement_never_makes_a_plan_worse(tmp_path: FilePath, y: float, half: float, mode: str) -> None:
    modes = {"mixed": ("moving", "operation")}.get(mode, (mode, mode))
    axes = tuple(
        ExternalJointOptions(joint=n, mode=m, weight=2.0) for n, m in zip(("rail", "turn"), modes, strict=True)
    )  # type: ignore[arg-type]
    options = replace(OPTIONS, external=axes)
    path = toolpath(slots(y, y + half))
    plan, groups, own = plan_by_grids(tmp_path, path, options, rail=True, table=True)
    worth = AxisPlanRanking.build(plan.setup, own)
    better = refine_plan(plan, job_of(path, groups, worth))
    assert better is plan or worth.plan(better) < worth.plan(plan)
    assert len(better.missing) <= len(plan.missing)


@pytest.mark.slow
@given(st.floats(-0.3, 0.3), st.floats(0.1, 0.4))
@settings(
    max_examples=scale_example_count(3), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_refined_moving_plan_is_no_worse_than_a_standing_one(tmp_path: FilePath, y: float, half: float) -> None:
    """Both plans are refined and exported; the travel weight of 3 makes the standing plan competitive."""
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    path = toolpath(slots(y, y + half))
    plans = [
        find_best_plan(
            cell, path, replace(OPTIONS, external=(ExternalJointOptions(joint="rail", mode=mode, weight=3.0),))
        )  # type: ignore[arg-type]
        for mode in ("moving", "operation")
    ]
    assert plans[0].scores.scale == plans[1].scores.scale
    worth = AxisPlanRanking.build(plans[0].setup, resolve_axis_options(cell, plans[0].options))
    assert worth.plan(plans[0]) <= worth.plan(plans[1]) * (1.0 + 1e-9)


@pytest.mark.slow
def test_second_trust_region_makes_no_plan_worse(tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, path = replace(external_cell(tmp_path, rail=True), stiffness=K), build_weaving_slot()
    monkeypatch.setattr(
        refinement_restarts, "LEAPS", (0, 0)
    )  # a perturbation from the better of two plans may give a smaller improvement
    found, scales = [], set()
    for widths in coarse_to_fine_search.TRUSTS, coarse_to_fine_search.TRUSTS[:1], ():
        monkeypatch.setattr(coarse_to_fine_search, "TRUSTS", widths)
        plan = find_best_plan(cell, path, MOVING)
        found.append(AxisPlanRanking.build(plan.setup, resolve_axis_options(cell, plan.options)).plan(plan))
        scales.add(plan.scores.scale)
    assert len(scales) == 1
    assert found[0] <= found[1] < found[2]


@pytest.mark.slow
def test_plan_far_from_the_best_is_not_planned_again(
    along: tuple[Plan, list[OperationGroup], tuple[ExternalJointOptions, ...], Toolpath],
) -> None:
    plan, groups, axes, path = along
    worth = AxisPlanRanking.build(plan.setup, axes)
    assert refine_plan(plan, job_of(path, groups, worth), below=0.5 * worth.plan(plan)) is plan


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "joint", "values"),
    [({"rail": True}, "rail", (-400.0, 500.0)), ({"table": True}, "turn", (0.0, 90.0))],
)
def test_written_plan_is_no_worse_than_any_with_a_fixed_external_joint(
    tmp_path: FilePath, kind: dict[str, bool], joint: str, values: tuple[float, ...]
) -> None:
    """With the files of the command: each J has its own unit, so the indices are converted to the unit of the first."""
    folder = external_folder(tmp_path, **kind)
    slot = [f"{x},{y},-1,0,0,1,cut,2000" for x, y in zip((0, 30, -20, 40, 10), range(-150, 151, 75), strict=True)]
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min", "0,-150,60,0,0,1,rapid,", *slot, "10,150,60,0,0,1,retract,3000"]
    (folder / "job.csv").write_text("\n".join(rows) + "\n")

    def written(name: str, *more: str) -> dict[str, Any]:
        arguments = ["optimize", str(folder), str(folder / "job.csv"), "-o", str(tmp_path / name), "--quiet"]
        assert main([*arguments, *(word for one in more for word in ("--set", one))]) == 0
        return dict(json.loads((tmp_path / name / "result.json").read_text()))

    free = written("free")
    weights = free["options"]["weights"]
    for value in values:
        unit = "mm" if joint == "rail" else "deg"
        one = written(f"at {value}", f"external.{joint}.mode=locked", f"external.{joint}.at_{unit}={value}")
        o = one["objective"]["chosen"]
        index = weights["mean"] * o["mean"] + weights["worst"] * o["worst"]
        result = o["total"] + index * (one["index_scale"] / free["index_scale"] - 1.0)
        assert free["objective"]["chosen"]["total"] <= result * (1.0 + 1e-9), value
