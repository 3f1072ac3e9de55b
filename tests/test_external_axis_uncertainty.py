"""Stiffness uncertainty of rails and positioners in deflection and gain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from mean_cost_std import compute_mean_cost_std
from test_external_axes import OPTIONS, slots
from test_planning_path import toolpath

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, ProcessForce, StiffnessIndex
from machopt.data_types.stiffness import ArmStiffness, ExternalJointSpring
from machopt.planning.cost.stiffness_index import compute_configuration_cost, compute_load_directions
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, fix_external_axes, prepare_planning
from machopt.planning.stations.planning_path import PlanningPath as Planned
from machopt.planning.stations.planning_path import build_planning_path
from machopt.planning.uncertainty.stiffness_uncertainty import (
    compute_carrier_sensitivity,
    compute_gains,
)
from machopt.stiffness.arm_stiffness import ArmElasticity

RIGID = np.zeros((6, 6))
SPRINGS = (
    ExternalJointSpring(joint="rail", stiffness=5e6, slides=True, compliance=RIGID, at=np.zeros(3), std=1e6),
    ExternalJointSpring(joint="turn", stiffness=6e5, slides=False, compliance=RIGID, at=np.zeros(3), std=9e4),
)
# a rail is compliant in its direction of travel
ASKED = replace(OPTIONS, force=ProcessForce(travel=150.0, normal=200.0, axial=100.0))
STEP = 1e-3  # relative step of a compliance for central differences: error 1e-6


def with_springs(cell: Cell, count: int = 2) -> Cell:
    """Return the cell with almost certain springs of the arm."""
    k = np.array([1.4e6, 4e5, 9e5, 3.6e5, 3.7e5, 3.8e5])
    return replace(
        cell, stiffness=ArmStiffness(joints=k, covariance=np.diag((1e-9 / k) ** 2), external=SPRINGS[:count])
    )


def cost(
    setup: PlanningSetup, path: Planned, q: np.ndarray, index: StiffnessIndex, softer: int, share: float
) -> np.ndarray:
    """Return the cost of all points with the compliance of one spring increased by a share."""
    known = setup.elasticity
    springs = list(known.stiffness.external)
    springs[softer] = replace(springs[softer], stiffness=springs[softer].stiffness / (1.0 + share))
    stiffness = replace(known.stiffness, external=tuple(springs))
    elasticity = ArmElasticity(known.robot, setup.arm.T_flange_tcp, stiffness)
    d = compute_load_directions(path, setup.arm, elasticity, ASKED.force)
    return compute_configuration_cost(elasticity, d, np.arange(len(q)), q, index)


@pytest.mark.parametrize("index", ["deflection", "stiffness", "jiao2022"])
def test_cost_sensitivity_agrees_with_finite_differences(tmp_path: Path, index: StiffnessIndex) -> None:
    setup = prepare_planning(with_springs(external_cell(tmp_path, rail=True, table=True)), ASKED)
    path = fix_external_axes(build_planning_path(toolpath(slots(0.0, 0.2))), np.array([0.3, 0.7]))
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (len(path.index), 6))
    d = compute_load_directions(path, setup.arm, setup.elasticity, ASKED.force)
    found = compute_carrier_sensitivity(setup.elasticity, d, np.arange(len(q)), q, index)
    assert found.any()
    for n, spring in enumerate(SPRINGS):
        more, less = (cost(setup, path, q, index, n, share) for share in (STEP, -STEP))
        by_share = (more - less) / (2.0 * STEP)  # ∂cost/∂ ln c
        np.testing.assert_allclose(found[:, n], by_share * spring.std / spring.stiffness, rtol=1e-4, atol=1e-16)


@pytest.fixture(scope="module")
def on_rail(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    cell = with_springs(external_cell(tmp_path_factory.mktemp("unsure"), rail=True), 1)
    axis = ExternalJointOptions(joint="rail", mode="operation")
    return find_best_plan(cell, toolpath(slots(0.4)), replace(ASKED, external=(axis,)))


def test_gain_uncertainty_includes_the_rail(on_rail: Plan) -> None:
    """The baseline is at home, the plan at another rail position."""
    p, w = on_rail, on_rail.path.weight
    home = fix_external_axes(p.path, p.setup.cell.external_home)
    assert not np.array_equal(home.external, p.path.external)

    def gain(share: float) -> float:
        index = p.scores.index
        a, b = (
            float(w[w > 0] @ cost(p.setup, path, s.assignment.q, index, 0, share)[w > 0])
            for path, s in ((p.path, p.chosen), (home, p.cam_default))
        )
        return 1.0 - a / b

    found = next(g for g in compute_gains(p) if g.over == "cam default")
    by_share = (gain(STEP) - gain(-STEP)) / (2.0 * STEP)
    assert found.std == pytest.approx(abs(by_share) * SPRINGS[0].std / SPRINGS[0].stiffness, rel=1e-3)
    assert found.std > 0.0


def test_deflection_uncertainty_includes_the_rail(on_rail: Plan) -> None:
    sure = replace(on_rail, directions=replace(on_rail.directions, unsure=None))
    cut = on_rail.path.counted
    (mean, each), (less, fewer) = compute_mean_cost_std(on_rail), compute_mean_cost_std(sure)
    assert mean > 100.0 * less
    assert (each[cut] > 100.0 * fewer[cut]).all()
