"""Refinement of rotation and external joints with steering rules."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from external_axis_cells import external_cell
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from test_continuous_refinement import by_grids
from test_external_axes import OPTIONS, UP, K
from test_planning_path import Rows, toolpath

from machopt.data_types.plan_options import ExternalJointOptions, ExternalMode, SteeringRule
from machopt.data_types.steering_rules import is_inside_zone
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.baseline_comparison import is_assignment_allowed
from machopt.planning.pipeline.plan_data_types import Plan

E_PIN = SteeringRule(points=(4, 6), joint="rail", at=0.35, unit="mm")
E_ZONE = SteeringRule(points=(9, 16), joint="rail", away=(-0.05, 0.15), unit="mm")
PIN, ZONE = SteeringRule(points=(10, 10), gamma=0.4), SteeringRule(points=(12, 17), forbid=(-0.4, 0.8))


def build_weaving_path() -> Toolpath:
    y = np.linspace(-0.6, 0.6, 20)
    rows: Rows = [((0.0, y[0], 0.05), UP, MoveKind.RAPID)]
    rows += [((0.25 * float(np.sin(7.0 * v)), float(v), 0.0), UP, MoveKind.CUT) for v in y]
    return toolpath(rows, feed=0.05)


def before_and_after(folder: FilePath, wishes: tuple[SteeringRule, ...], mode: ExternalMode) -> tuple[Plan, Plan]:
    """Return the plan of the grid search and the exported plan."""
    cell, path = replace(external_cell(folder, rail=True), stiffness=K), build_weaving_path()
    options = replace(
        OPTIONS,
        rotation_step=np.radians(15.0),
        steer=wishes,
        external=(ExternalJointOptions(joint="rail", mode=mode, weight=2.0),),
    )
    first = by_grids(cell, path, options)
    return first, find_best_plan(cell, path, options)


def compute_gain(first: Plan, best: Plan) -> float:
    worth = AxisPlanRanking.build(first.setup, resolve_axis_options(first.setup.cell, first.options))
    return 1.0 - worth.plan(best) / worth.plan(first)


@pytest.mark.slow
def test_plan_with_steering_is_refined_and_respects_it(tmp_path: FilePath) -> None:
    first, best = before_and_after(tmp_path, (E_PIN, E_ZONE, PIN, ZONE), "moving")
    assert compute_gain(first, best) > 1e-3
    index, rail = best.path.index, best.path.external[:, 0]
    # equal to the last bit: the curves of the refinement have no offset there
    assert (rail[(index >= 4) & (index <= 6)] == 0.35).all()
    there = rail[(index >= 9) & (index <= 16)]
    assert (there <= -0.05).all() or (there >= 0.15).all()
    gamma = np.asarray(wrap_angle(best.chosen.assignment.phi + best.path.offset))
    assert gamma[index == 10] == pytest.approx(0.4, abs=1e-6)
    assert not is_inside_zone(gamma[(index >= 12) & (index <= 17)], (-0.4, 0.8)).any()


@pytest.mark.slow
@given(
    st.lists(
        st.sampled_from([E_PIN, E_ZONE, PIN, ZONE, SteeringRule(prefer=0.7, weight=0.3)]), unique=True, min_size=1
    ),
    st.sampled_from(["moving", "operation"]),
)
@settings(
    max_examples=scale_example_count(2), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_refinement_with_steering_makes_no_plan_worse(
    tmp_path: FilePath, wishes: list[SteeringRule], mode: ExternalMode
) -> None:
    if mode == "operation":
        # with one rail position both rules would fix it, and nothing would be left to refine
        wishes = [w for w in wishes if w is not E_PIN]
    first, best = before_and_after(tmp_path, tuple(wishes), mode)
    assert compute_gain(first, best) >= -1e-12
    assert len(best.missing) <= len(first.missing)
    if not len(best.missing):
        assert is_assignment_allowed(best.chosen.assignment, best.path, best.options)
    rows = (best.path.index >= 9) & (best.path.index <= 16)
    if E_ZONE in wishes:
        assert not ((best.path.external[rows, 0] > -0.05) & (best.path.external[rows, 0] < 0.15)).any()
