"""Uncertainty of deflections and of the gain, compared with finite differences and random stiffness values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from mean_cost_std import compute_mean_cost_std
from test_planning_pipeline import plan_case

from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cli.objective_lines import format_gain_lines
from machopt.data_types.documents.optimize_document import MeanGainEntry, OptimizeDocument
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import StiffnessIndex
from machopt.data_types.stiffness import ArmStiffness, StiffnessGrid, StiffnessTerm
from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.point_table import build_point_table
from machopt.planning.uncertainty.stiffness_uncertainty import (
    NINETY,
    ComplianceCovariance,
    IndexGain,
    compute_cost_gradient,
    compute_gains,
)
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.joint_stiffness import compute_joint_stiffness
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = FilePath(__file__).resolve().parent.parent
TERMS = (
    StiffnessTerm("link_compliance", "link:4", {"EI_Nm2": 3e6, "GJ_Nm2": 2e6}),
    StiffnessTerm("geometric_stiffness", "arm"),
)
CORRELATED = np.array(
    [
        [1.0, 0.5, 0, 0, 0, 0],
        [0.5, 1, -0.3, 0, 0, 0],
        [0, -0.3, 1, 0, 0, 0.2],
        [0, 0, 0, 1, 0.6, 0],
        [0, 0, 0, 0.6, 1, 0],
        [0, 0, 0.2, 0, 0, 1],
    ]
)


def with_stiffness(p: Plan, stiffness: ArmStiffness) -> Plan:
    """Return the same motions with costs by another stiffness, without a new choice of configurations."""
    arm, path = p.setup.arm, p.path
    elasticity = ArmElasticity(p.setup.robot, arm.T_flange_tcp, stiffness)
    at = path.position @ arm.machine.T_base_workpiece_zero[:3, :3].T + arm.machine.T_base_workpiece_zero[:3, 3]
    joint = compute_joint_stiffness(stiffness, at)
    d = replace(p.directions, k=joint.k, in_grid=joint.is_in_grid)
    out = replace(p, setup=replace(p.setup, elasticity=elasticity), directions=d)

    def again(scored):  # type: ignore[no-untyped-def]
        cost = np.full(len(path.index), np.nan)
        ok = np.flatnonzero(scored.assignment.reason == InfeasibilityReason.OK)
        cost[ok] = compute_configuration_cost(elasticity, d, ok, scored.assignment.q[ok], p.scores.index)
        return replace(scored, cost=cost)

    return replace(out, chosen=again(p.chosen), jiao2022=again(p.jiao2022), cam_default=again(p.cam_default))


def gain_over_jiao(p: Plan) -> float:
    w = p.path.weight[p.path.counted]
    a, b = (float(w @ s.cost[p.path.counted]) for s in (p.chosen, p.jiao2022))
    return 1.0 - a / b


def select_gain(p: Plan, name: str = "jiao2022") -> IndexGain:
    return next(g for g in compute_gains(p) if g.over == name)


def covariance(k: np.ndarray, share: float) -> np.ndarray:
    return CORRELATED * np.outer(share / k, share / k)


# --- gradients -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", ["deflection", "stiffness", "jiao2022"])
@pytest.mark.parametrize("terms", [(), TERMS])
def test_gradient_equals_the_finite_difference_of_the_cost(
    index: StiffnessIndex, terms: tuple[StiffnessTerm, ...]
) -> None:
    p = plan_case("kr500 force")
    rows = np.flatnonzero(p.path.counted)[::17]
    q, k = p.chosen.assignment.q[rows], p.setup.elasticity.stiffness.joints
    elasticity = ArmElasticity(p.setup.robot, p.setup.arm.T_flange_tcp, ArmStiffness(joints=k, terms=terms))
    g = compute_cost_gradient(elasticity, p.directions, rows, q, index)
    for j in range(6):
        h = 1e-4 / k[j]  # central difference: relative error 1e-8
        sides = []
        for sign in (1.0, -1.0):
            c = 1.0 / p.directions.k
            c[:, j] += sign * h
            sides.append(compute_configuration_cost(elasticity, replace(p.directions, k=1.0 / c), rows, q, index))
        slope = (sides[0] - sides[1]) / (2 * h)
        np.testing.assert_allclose(g[:, j], slope, rtol=2e-6, atol=1e-6 * np.abs(slope).max())


def test_point_on_a_cell_face_shares_both_cells() -> None:
    k = np.array([[1.0, 2, 3, 4, 5, 6], [3.0, 3, 3, 2, 2, 2]]) * 1e5
    grid = StiffnessGrid(np.zeros(3), 1.0, (2, 1, 1), k, 0.1 * k)
    stiffness = ArmStiffness(joints=np.full(6, 7e5), grid=grid)
    position = np.array([[0.5, 0.5, 0.5], [1.0, 0.5, 0.5], [1.5, 0.5, 0.5], [5.0, 0, 0]])
    spread = ComplianceCovariance.build(stiffness, position)
    g = np.arange(1.0, 7)
    for n in range(2):
        for j in range(6):
            c = 1.0 / k
            h = 1e-5 * c[n, j]
            value = []
            for sign in (1, -1):
                moved = c.copy()
                moved[n, j] += sign * h
                other = ArmStiffness(joints=stiffness.joints, grid=replace(grid, joints=1.0 / moved))
                value.append(float(g @ (1.0 / compute_joint_stiffness(other, position[1]).k)))
            found = spread.gradient(np.array([0.0, 1, 0, 0]), np.tile(g, (4, 1)))[n + 1, j]
            assert found == pytest.approx((value[0] - value[1]) / (2 * h), rel=1e-6)
    std = spread.point_std(np.tile(g, (4, 1)))
    assert std[0] == pytest.approx(np.sqrt(np.sum((g * 0.1 / k[0]) ** 2)))
    assert std[2] == pytest.approx(np.sqrt(np.sum((g * 0.1 / k[1]) ** 2)))
    assert np.isnan(std[3])  # outside the grid the file states no uncertainty
    known = ComplianceCovariance.build(replace(stiffness, covariance=np.diag((0.1 / stiffness.joints) ** 2)), position)
    assert known.point_std(np.tile(g, (4, 1)))[3] == pytest.approx(np.linalg.norm(g) * 0.1 / 7e5)
    np.testing.assert_array_equal(known.point_std(np.tile(g, (4, 1)))[:3], std[:3])


# --- the gain ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["kr500 force", "irb6700 holes"])
def test_gain_interval_agrees_with_drawn_stiffnesses(case: str) -> None:
    """2,000 correlated draws of the six compliances; each draw evaluates both motions."""
    p, share = plan_case(case), 0.05
    k = p.setup.elasticity.stiffness.joints
    judged = with_stiffness(p, ArmStiffness(joints=k, covariance=covariance(k, share)))
    found = select_gain(judged)
    assert found.mean == pytest.approx(gain_over_jiao(judged), rel=1e-9)
    rng = np.random.default_rng(3)
    draws = 1.0 / k + rng.multivariate_normal(np.zeros(6), covariance(k, share), 2000)
    w, rows = p.path.weight[p.path.counted], np.flatnonzero(p.path.counted)
    means = np.empty((len(draws), 2))
    for n, c in enumerate(draws):
        d = replace(judged.directions, k=np.broadcast_to(1.0 / c, judged.directions.k.shape))
        means[n] = [
            w @ compute_configuration_cost(judged.setup.elasticity, d, rows, s.assignment.q[rows], p.scores.index)
            for s in (p.chosen, p.jiao2022)
        ]
    ratio = 1.0 - means[:, 0] / means[:, 1]
    # standard error of a standard deviation from 2,000 draws: 1.6 %; second order in 5 % adds as much; 5 % is three
    # sigma
    assert found.std == pytest.approx(ratio.std(), rel=0.05)
    assert np.mean(np.abs(ratio - found.mean) < NINETY * found.std) == pytest.approx(0.90, abs=0.02)
    # treated as two independent motions, the uncertainty would be much larger
    apart = (1.0 - found.mean) * np.linalg.norm(means.std(axis=0) / means.mean(axis=0))
    assert found.std < 0.75 * apart


def test_common_factor_cancels_in_the_gain_but_not_in_the_deflection() -> None:
    """All compliances have the same error of 20 %: this changes every deflection but not the gain."""
    p = plan_case("kr500 force")
    k = p.setup.elasticity.stiffness.joints
    judged = with_stiffness(p, ArmStiffness(joints=k, covariance=np.outer(0.2 / k, 0.2 / k)))
    assert select_gain(judged).std < 1e-6  # square root of rounding in Σ
    assert select_gain(judged).distinguishable
    table = build_point_table(judged, read_toolpath(ROOT / "toolpaths" / "plain.csv")).table
    assert table.deflection_std is not None
    assert table.k_axial_std is not None
    np.testing.assert_allclose(table.deflection_std, 0.2 * table.deflection, rtol=1e-6)
    np.testing.assert_allclose(table.k_axial_std, 0.2 * table.k_axial, rtol=1e-6)


def test_grid_cells_have_independent_and_common_errors() -> None:
    """The stiffness is drawn cell by cell; the path crosses both cells.

    If a part of the path is outside the grid, where the uncertainty is unknown, the uncertainty of the gain is unknown.
    """
    p = plan_case("kr500 force")
    grid = load_stiffness(ROOT / "cells" / "kr500_milling" / "stiffness_two_grid.yaml").grid
    assert grid is not None
    stated = replace(grid, std=0.05 * grid.joints)
    judged = with_stiffness(p, ArmStiffness(joints=p.setup.elasticity.stiffness.joints, grid=stated))
    assert judged.directions.in_grid[p.path.counted].all()
    found, rng = select_gain(judged), np.random.default_rng(5)
    w, rows = p.path.weight[p.path.counted], np.flatnonzero(p.path.counted)
    ratio = np.empty(1500)
    for n in range(len(ratio)):
        c = (1.0 + 0.05 * rng.normal(size=grid.joints.shape)) / grid.joints
        other = with_k(
            judged, ArmStiffness(joints=judged.setup.elasticity.stiffness.joints, grid=replace(grid, joints=1.0 / c))
        )
        mean = [
            w @ compute_configuration_cost(judged.setup.elasticity, other, rows, s.assignment.q[rows], p.scores.index)
            for s in (p.chosen, p.jiao2022)
        ]
        ratio[n] = 1.0 - mean[0] / mean[1]
    assert found.std == pytest.approx(ratio.std(), rel=0.06)  # 1.8 % sampling error, plus second order
    # part of the path is now outside the grid
    moved = replace(stated, origin=stated.origin + np.array([0.0, 0.9, 0.0]))
    outside = with_stiffness(p, ArmStiffness(joints=p.setup.elasticity.stiffness.joints, grid=moved))
    assert np.isnan(select_gain(outside).std)
    assert select_gain(outside).distinguishable
    table = build_point_table(outside, read_toolpath(ROOT / "toolpaths" / "plain.csv")).table
    assert table.deflection_std is not None
    np.testing.assert_array_equal(np.isfinite(table.deflection_std), table.in_grid)


def with_k(p: Plan, stiffness: ArmStiffness):  # type: ignore[no-untyped-def]
    T = p.setup.arm.machine.T_base_workpiece_zero
    joint = compute_joint_stiffness(stiffness, p.path.position @ T[:3, :3].T + T[:3, 3])
    return replace(p.directions, k=joint.k)


def test_no_uncertainty_without_a_covariance() -> None:
    p = plan_case("kr500 force")
    found = select_gain(p)
    assert found.mean == pytest.approx(gain_over_jiao(p), rel=1e-9)
    assert np.isnan(found.std)
    table = build_point_table(p, read_toolpath(ROOT / "toolpaths" / "plain.csv")).table
    assert table.deflection_std is None
    assert table.k_axial_std is None
    assert np.isnan(select_gain(p, "cam default").mean)  # the baseline is not feasible there, so it has no gain


def test_gain_below_its_uncertainty_is_reported_as_none() -> None:
    p = plan_case("irb6700 holes")
    k = p.setup.elasticity.stiffness.joints
    sure, unsure = (
        select_gain(with_stiffness(p, ArmStiffness(joints=k, covariance=covariance(k, s)))) for s in (0.01, 3.0)
    )
    assert sure.distinguishable
    assert not unsure.distinguishable
    assert unsure.interval[0] < 0 < unsure.interval[1]
    assert unsure.std == pytest.approx(300 * sure.std, rel=1e-9)

    def lines(g: IndexGain) -> str:
        low, high = (100 * v for v in g.interval)
        entry = MeanGainEntry(
            over=g.over,
            mean_percent=100 * g.mean,
            std_percent=100 * g.std,
            ci90=(low, high),
            distinguishable=g.distinguishable,
        )
        stub = SimpleNamespace(index="deflection", chosen_from="smooth", objective=SimpleNamespace(gain=(entry,)))
        return "\n".join(format_gain_lines(cast(OptimizeDocument, stub)))

    assert "not significant" in lines(unsure)
    assert "not significant" not in lines(sure)
    assert lines(IndexGain("jiao2022", 0.18, 0.06)).startswith(
        "  gain over jiao2022: mean deflection 18 % ± 6 % less (90 %: 8 to 28 %)"
    )
    assert "5.0 % ± 0.4 % more (90 %: 4.3 to 5.7 %)" in lines(IndexGain("jiao2022", -0.05, 0.004))


def test_rounding_difference_is_no_gain() -> None:
    assert not IndexGain("jiao2022", -4e-16, 7e-19).distinguishable
    assert not IndexGain("jiao2022", 5e-5, float("nan")).distinguishable
    assert IndexGain("jiao2022", 0.02, float("nan")).distinguishable


@pytest.mark.parametrize("index", ["deflection", "stiffness", "jiao2022"])
def test_principal_spring_errors_change_the_cost_as_refits_do(index: StiffnessIndex) -> None:
    """One standard deviation along each principal axis of the covariance; the mean does not change."""
    p = plan_case("kr500 force")
    rows = np.flatnonzero(p.path.counted)[::29]
    q, k = p.chosen.assignment.q[rows], p.setup.elasticity.stiffness.joints
    elasticity = ArmElasticity(
        p.setup.robot, p.setup.arm.T_flange_tcp, ArmStiffness(joints=k, covariance=covariance(k, 0.1))
    )
    doubt = DiscrepancyModel.of_springs(elasticity)
    assert doubt is not None
    changed = doubt.cost(elasticity, p.directions, rows, q, index)
    values, vectors = np.linalg.eigh(covariance(k, 0.1))
    assert not changed[:, 0].any()
    for n in range(6):
        h, away = 1e-4, np.sqrt(values[n]) * vectors[:, n]
        sides = [
            compute_configuration_cost(
                elasticity, replace(p.directions, k=1.0 / (1.0 / p.directions.k + s * h * away)), rows, q, index
            )
            for s in (1.0, -1.0)
        ]
        slope = (sides[0] - sides[1]) / (2 * h)
        np.testing.assert_allclose(changed[:, 1 + n], slope, rtol=1e-5, atol=1e-6 * np.abs(changed).max())
    assert (doubt.own(p.directions, rows, index) == 0.0).all()  # a covariance contains no pose-specific part
    assert DiscrepancyModel.of_springs(replace_stiffness(elasticity, ArmStiffness(joints=k))) is None


def replace_stiffness(e: ArmElasticity, stiffness: ArmStiffness) -> ArmElasticity:
    return ArmElasticity(e.robot, e.T_flange_tcp, stiffness)


def test_deflection_uncertainty_follows_the_file() -> None:
    """NaN without a covariance; if all springs scale equally,
    the mean and each point have the same relative uncertainty."""
    p = plan_case("kr500 force")
    k = p.setup.elasticity.stiffness.joints
    mean, each = compute_mean_cost_std(with_stiffness(p, ArmStiffness(joints=k)))
    assert np.isnan(mean)
    assert np.isnan(each).all()
    judged = with_stiffness(p, ArmStiffness(joints=k, covariance=np.outer(0.2 / k, 0.2 / k)))
    mean, each = compute_mean_cost_std(judged)
    rows = p.path.counted
    assert mean == pytest.approx(0.2 * float(p.path.weight[rows] @ judged.chosen.cost[rows]), rel=1e-6)
    np.testing.assert_allclose(each[rows], 0.2 * judged.chosen.cost[rows], rtol=1e-6)
