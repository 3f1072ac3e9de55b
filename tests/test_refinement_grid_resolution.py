"""Plans with external joints on finer rotation grids, from other starts and with jumps are never worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from external_axis_cells import external_cell
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from test_continuous_refinement import MOVING, build_weaving_slot, plan_by_grids
from test_external_axes import OPTIONS, UP, K
from test_planning_path import Rows, toolpath

from machopt.data_types.plan_options import ExternalJointOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.planning.continuous_refinement.refinement import PlanRefinement
from machopt.planning.continuous_refinement.starting_point import RefinementStart
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.external_axis_optimization import refinement_restarts
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.plan_data_types import Plan

ROUNDED = 1e-9  # of J


def holes(y: float, apart: float) -> Toolpath:
    rows: Rows = []
    for k in range(4):
        x, at = 0.1 * (-1.0) ** k, y + k * apart
        rows += [
            ((x, at, 0.06), UP, MoveKind.RAPID),
            ((x, at, -0.01), UP, MoveKind.CUT),
            ((x, at, 0.06), UP, MoveKind.RETRACT),
        ]
    return toolpath(rows)


def worth(plan: Plan) -> float:
    return AxisPlanRanking.build(plan.setup, resolve_axis_options(plan.setup.cell, plan.options)).plan(plan)


@pytest.mark.proof
@given(
    st.sampled_from([{"rail": True}, {"table": True}, {"rail": True, "table": True}]),
    st.sampled_from(["moving", "operation"]),
    st.booleans(),
    st.floats(-0.15, 0.15),
)
@settings(
    max_examples=scale_example_count(3), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_finer_grid_makes_no_plan_worse(
    tmp_path: FilePath, kind: dict[str, bool], mode: str, drilled: bool, y: float
) -> None:
    cell = replace(external_cell(tmp_path, **kind), stiffness=K)
    names = [n for n in ("rail", "turn") if {"rail": "rail", "turn": "table"}[n] in kind]
    axes = tuple(ExternalJointOptions(joint=n, mode=mode, range=(-0.5, 0.5)) for n in names)  # type: ignore[arg-type]
    rows: Rows = [((0.0, y - 0.1, 0.05), UP, MoveKind.RAPID)]
    rows += [((0.08 * float(np.sin(30 * v)), y + float(v), 0.0), UP, MoveKind.CUT) for v in np.linspace(-0.1, 0.1, 6)]
    path = holes(y, 0.05) if drilled else toolpath(rows)
    plans = [
        find_best_plan(cell, path, replace(OPTIONS, external=axes, rotation_step=np.radians(step)))
        for step in (15.0, 10.0, 5.0)
    ]
    assert len({plan.scores.scale for plan in plans}) == 1
    assert [len(plan.candidates.phi) for plan in plans] == [24, 36, 72]
    values = [worth(plan) for plan in plans]
    assert values[2] <= values[1] * (1 + ROUNDED)
    assert values[1] <= values[0] * (1 + ROUNDED)
    for plan in plans:
        assert plan.over_external is None or plan.over_external.gap is not None or plan.over_external.why


@pytest.mark.slow
def test_jumps_make_no_plan_worse(tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    found = []
    for leaps in (0, 0), refinement_restarts.LEAPS:
        monkeypatch.setattr(refinement_restarts, "LEAPS", leaps)
        monkeypatch.setattr(refinement_restarts, "WORTH_IT", 1e-4)
        found.append(worth(find_best_plan(cell, build_weaving_slot(), MOVING)))
    assert found[1] <= found[0] * (1 + ROUNDED)


@pytest.mark.slow
def test_refinement_begins_on_its_own_curves(tmp_path: FilePath) -> None:
    """The start is projected onto the curves of the refinement: a zigzag is removed, and a curve does not change."""
    plan, groups, axes = plan_by_grids(tmp_path, build_weaving_slot(), MOVING, rail=True)
    refinement = PlanRefinement(plan, groups, AxisPlanRanking.build(plan.setup, axes))
    a = plan.chosen.assignment
    ragged = RefinementStart(a.phi + 1e-3 * (-1.0) ** np.arange(len(a.phi)), plan.path.external, a.q)
    begun = refinement._build_start_state(ragged)
    assert begun is not None
    state, phi, e = begun
    assert state.phi == pytest.approx(phi[refinement.rows], abs=1e-12)
    again = refinement._build_start_state(RefinementStart(phi, e, a.q))
    assert again is not None
    assert again[1] == pytest.approx(phi, abs=1e-6)
    assert again[2] == pytest.approx(e, abs=1e-6)
