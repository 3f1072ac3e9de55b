"""Coverage of intervals, unidentified joints, and errors on unseen poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, sqrtm
from simulated_load_tests import TRUE_K, WHITE, add_measurement_errors, cell, draw_load_tests, plan_load_tests

from machopt.data_types.measurements.recording import StandardUncertainty
from machopt.data_types.stiffness import LEAST_STIFFNESS, ArmStiffness, StiffnessTerm
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.identification.assessment.coefficient_uncertainty import (
    compute_cluster_robust_covariance,
    compute_coefficient_uncertainty,
)
from machopt.measurement.identification.assessment.holdout_errors import (
    build_folds,
    compute_holdout_residuals,
    summarise_residuals,
)
from machopt.measurement.identification.assessment.identifiability import settle_coefficients
from machopt.measurement.identification.assessment.leverage_and_outliers import compute_influence, list_outliers
from machopt.measurement.identification.assessment.subset_and_monte_carlo_studies import (
    run_monte_carlo,
    run_subset_study,
)
from machopt.measurement.identification.fitting.weighted_fit import fit_stiffness
from machopt.measurement.identification.identification_pipeline import identify_stiffness
from machopt.measurement.identification.options import IdentifyOptions
from machopt.stiffness.terms import build_fitted_term

C = 1.0 / TRUE_K
DESIGNS, DRAWS = 5, 40


@pytest.mark.proof
@pytest.mark.parametrize(
    ("rotations", "loads", "repeats"), [(False, 4, 2), (True, 1, 1)], ids=["replicates", "rotations"]
)
def test_ninety_percent_intervals_cover(rotations: bool, loads: int, repeats: int) -> None:
    rng = np.random.default_rng(100 + loads + 10 * rotations)
    _, robot, T = cell()
    hits = []
    for _ in range(DESIGNS):
        made = plan_load_tests(rng, poses=14 if loads > 1 else 30, loads=loads, repeats=repeats)
        for _ in range(DRAWS):
            e = build_load_test_experiment(add_measurement_errors(made, rng, rotations=rotations), robot, T)
            low, high = compute_coefficient_uncertainty(fit_stiffness(e)).interval[:6].T
            hits.append((low <= C) & (high >= C))
    assert 0.86 <= np.mean(hits) <= 0.94
    # standard error of the coverage of one joint from 200 draws: 2.1 %; three of them on either side of 86 … 94 %
    assert (np.mean(hits, axis=0) > 0.80).all()


@pytest.mark.proof
def test_intervals_cover_with_few_poses_and_without_labels() -> None:
    rng = np.random.default_rng(120)
    _, robot, T = cell()
    hits = []
    for _ in range(10):
        made = plan_load_tests(rng, poses=8, loads=4, repeats=2)
        for _ in range(20):
            e = build_load_test_experiment(add_measurement_errors(made, rng, labels=False, stated=False), robot, T)
            low, high = compute_coefficient_uncertainty(fit_stiffness(e)).interval[:6].T
            hits.append((low <= C) & (high >= C))
    assert 0.86 <= np.mean(hits) <= 0.95  # Satterthwaite's degrees of freedom (3 to 5 here) give conservative intervals


def test_cluster_robust_covariance_equals_cr2() -> None:
    rng = np.random.default_rng(21)
    sizes, P = [4, 7, 3, 9, 5], 3
    X = [rng.standard_normal((n, P)) * rng.uniform(0.2, 3) for n in sizes]
    V = [np.cov(rng.standard_normal((n, 2 * n))) + 0.3 * np.eye(n) for n in sizes]
    y = [rng.standard_normal(n) for n in sizes]
    W = [np.linalg.inv(v) for v in V]
    H = np.array([x.T @ w @ x for x, w in zip(X, W, strict=True)])
    h = np.array([x.T @ w @ v for x, w, v in zip(X, W, y, strict=True)])
    M = np.linalg.inv(H.sum(axis=0))
    covariance, freedom = compute_cluster_robust_covariance(H, h, M)
    # Bell & McCaffrey: residuals of each cluster, whitened, times (I − leverage)^(−½)
    roots = [np.real(sqrtm(w)) for w in W]
    Z = [r @ x for r, x in zip(roots, X, strict=True)]
    b = M @ h.sum(axis=0)
    adjust = [np.linalg.inv(np.real(sqrtm(np.eye(len(z)) - z @ M @ z.T))) for z in Z]
    scores = np.array([M @ z.T @ a @ (r @ v - z @ b) for z, a, r, v in zip(Z, adjust, roots, y, strict=True)])
    np.testing.assert_allclose(covariance, scores.T @ scores, rtol=1e-9)
    stacked = np.vstack(Z)
    residual_maker = np.eye(len(stacked)) - stacked @ M @ stacked.T
    edges = np.concatenate([[0], np.cumsum(sizes)])
    for p in range(P):
        rows = block_diag(*[(M @ z.T @ a)[p] for z, a in zip(Z, adjust, strict=True)])
        G = rows @ residual_maker
        omega = G @ G.T
        assert len(edges) == len(rows) + 1
        assert freedom[p] == pytest.approx(np.trace(omega) ** 2 / np.sum(omega**2), rel=1e-9)


def axial(rng: np.random.Generator) -> LoadTestExperiment:
    """Loads along axis 6 only: joint 6 has no torque."""
    _, robot, T = cell()
    made = plan_load_tests(rng, poses=20, loads=1, repeats=1)
    z = robot.compute_fk(made.q)[:, :3, 2]
    size = rng.uniform(400, 1500, (20, 3, 1))
    wrench = np.concatenate([size * z[:, None], np.zeros((20, 3, 3))], axis=-1)
    made = plan_load_tests(rng, q=made.q, wrench=wrench)
    return build_load_test_experiment(
        replace(add_measurement_errors(made, rng, outliers=0.0), wrench=made.wrench), robot, T
    )


def test_joint_without_torque_keeps_the_value_of_the_cell() -> None:
    _, robot, T = cell()
    e = axial(np.random.default_rng(22))
    given = np.full(6, 7e5)
    found = identify_stiffness(e, robot, T, ArmStiffness(joints=given), IdentifyOptions(), np.random.default_rng(0))
    last = found.joints[5]
    assert (last.identified, last.k) == (False, pytest.approx(7e5))
    assert last.reason == "no reading puts any torque on joint 6"
    assert last.interval == (0.0, np.inf)
    assert found.condition_number == np.inf
    assert any("singular design" in w for w in found.warnings)
    assert all(j.identified for j in found.joints[:3])
    assert np.abs(found.stiffness.joints[:3] / TRUE_K[:3] - 1).max() < 0.2
    sure = np.sqrt(np.diag(found.stiffness.covariance))  # the relative standard deviation of an unidentified joint is 1
    assert sure[5] == pytest.approx(1 / 7e5)
    assert np.isnan(found.monte_carlo.spread[5])
    alone = identify_stiffness(e, robot, T, None, IdentifyOptions(studies=False), np.random.default_rng(0))
    assert alone.joints[5].k == pytest.approx(LEAST_STIFFNESS)
    np.testing.assert_allclose(alone.stiffness.joints[:3], found.stiffness.joints[:3], rtol=0.02)


def test_inseparable_joints_are_named_with_their_sum() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(23), rotations=True)
    base = build_fitted_term("base_compliance", "base", robot, T)
    found = fit_stiffness(e, terms=(base,))
    sure = compute_coefficient_uncertainty(found)
    settled = settle_coefficients(found, sure, TRUE_K)
    names = [u.name for u in found.unknowns]
    turn = names.index("base_compliance at base rz")
    assert not settled.status[0].identified
    assert settled.status[0].reason.startswith("cannot be distinguished from base_compliance at base rz")
    assert not settled.status[turn].identified
    # the sum equals that of a fit without base; the base's other five coefficients change it by less than the tolerance
    assert settled.x[0] + settled.x[turn] == pytest.approx(fit_stiffness(e).x[0], rel=0.02)
    # for any division between the two, neither exceeds the sum
    assert sure.interval[0, 1] < 1.1 * fit_stiffness(e).x[0]
    assert sure.interval[0, 0] == 0.0


def test_joint_hidden_by_noise_gets_a_bound_only() -> None:
    rng = np.random.default_rng(24)
    _, robot, T = cell()
    stiff = TRUE_K.copy()
    stiff[5] = 1e9  # far stiffer than the cell's value: not distinguishable from rigid
    e = build_load_test_experiment(
        add_measurement_errors(plan_load_tests(rng, force=300.0, moment=30.0, k=stiff), rng), robot, T
    )
    found = identify_stiffness(
        e, robot, T, ArmStiffness(joints=TRUE_K), IdentifyOptions(studies=False), np.random.default_rng(0)
    )
    last = found.joints[5]
    assert not last.identified
    assert "reaches zero compliance" in last.reason
    assert last.interval[1] == np.inf
    assert last.interval[0] <= last.k <= 1e10
    assert last.interval[0] < 1e9


def test_errors_on_unseen_poses_equal_those_of_a_refit() -> None:
    e = draw_load_tests(np.random.default_rng(25), poses=8, loads=3, repeats=1)
    found = fit_stiffness(e, robust=False, weighted=False, bounded=False)
    left_out = compute_holdout_residuals(
        found, settle_coefficients(found, compute_coefficient_uncertainty(found), TRUE_K), np.random.default_rng(0)
    )
    B = e.response()
    for p in range(8):
        out = e.pose == p
        x = np.linalg.lstsq(B[~out].reshape(-1, 6), e.measured[~out].reshape(-1), rcond=None)[0]
        np.testing.assert_allclose(left_out[out], e.measured[out] - B[out] @ x, atol=1e-12)  # m; tolerance: rounding
    together = summarise_residuals(found, left_out)
    assert together.rmse == pytest.approx(np.sqrt(np.mean(left_out**2)))
    assert together.rmse > summarise_residuals(found, found.residual).rmse
    assert together.explained == pytest.approx(1 - np.sum(left_out**2) / np.sum(e.measured**2))


def test_every_pose_is_left_out_once() -> None:
    for poses in (2, 60, 61, 500):
        groups = build_folds(poses, np.random.default_rng(0))
        assert len(groups) == (poses if poses <= 60 else 20)
        np.testing.assert_array_equal(np.sort(np.concatenate(groups)), np.arange(poses))
    assert build_folds(1, np.random.default_rng(0)) == []


def test_leverages_sum_to_the_unknowns_and_the_wrong_pose_has_the_largest_residual() -> None:
    rng = np.random.default_rng(26)
    _, robot, T = cell()
    record = add_measurement_errors(plan_load_tests(rng), rng, outliers=0.0)
    d = record.displacement.copy()
    d[record.pose == 7] *= 1.4
    d[11] += 2e-3
    found = fit_stiffness(build_load_test_experiment(replace(record, displacement=d), robot, T), robust=False)
    settled = settle_coefficients(found, compute_coefficient_uncertainty(found), TRUE_K)
    felt = compute_influence(found, settled)
    assert felt.leverage.sum() == pytest.approx(6, rel=1e-6)
    assert felt.pose_leverage.sum() == pytest.approx(6, rel=1e-6)
    assert felt.pose[np.argmax(felt.pose_cook)] in (7, record.pose[11])
    one = found.clusters.readings(3)[:1]  # first-order formula compared with a refit without the reading
    rest = np.setdiff1d(np.arange(len(d)), one)
    less = fit_stiffness(found.experiment.select_readings(rest), robust=False, weighting=None)
    assert np.isfinite(less.x).all()
    robust = fit_stiffness(build_load_test_experiment(replace(record, displacement=d), robot, T))
    worst = list_outliers(robust)[0]
    assert (worst.reading, worst.place) == (11, "line 13")
    assert worst.sigmas > 20


def test_scatter_decreases_with_the_number_of_tests() -> None:
    found = fit_stiffness(draw_load_tests(np.random.default_rng(27), poses=15))
    settled = settle_coefficients(found, compute_coefficient_uncertainty(found), TRUE_K)
    for of, most in (("readings", len(found.y)), ("poses", 15)):
        study = run_subset_study(found, settled, np.random.default_rng(0), of=of)
        assert study.tests[-1] == most
        np.testing.assert_allclose(study.spread[-1], 0.0, atol=1e-9)
        half = int(np.searchsorted(study.tests, most / 2))
        few = int(np.searchsorted(study.tests, most / 5))
        assert (study.spread[half] < study.spread[few]).all()
        again = run_subset_study(found, settled, np.random.default_rng(0), of=of)
        np.testing.assert_array_equal(study.k, again.k)
    np.testing.assert_allclose(study.k[-1, 0], 1 / settled.x[:6], rtol=1e-9)


def test_monte_carlo_agrees_with_error_propagation() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(28), poses=12, loads=3, repeats=1)
    found = fit_stiffness(e, robust=False, weighted=False, bounded=False)
    settled = settle_coefficients(found, compute_coefficient_uncertainty(found), TRUE_K)
    only = StandardUncertainty(displacement=WHITE)
    study = run_monte_carlo(found, settled, robot, T, np.random.default_rng(0), uncertainty=only, draws=400)
    B = e.response().reshape(-1, 6)
    expected = WHITE * np.sqrt(np.diag(np.linalg.inv(B.T @ B)))
    # standard error of a standard deviation from 400 draws: 3.5 %; four of them allowed
    np.testing.assert_allclose(study.compliance.std(axis=0, ddof=1), expected, rtol=0.15)
    everything = replace(only, force=10.0, moment=3.0, joint=np.radians(0.01))
    more = run_monte_carlo(found, settled, robot, T, np.random.default_rng(0), uncertainty=everything, draws=100)
    assert (more.spread > study.spread).all()
    unstated = replace(e, uncertainty=StandardUncertainty())
    found = fit_stiffness(unstated)
    assert run_monte_carlo(found, settled, robot, T, np.random.default_rng(0), draws=20).assumed == ("displacement",)


def test_scatter_of_few_tests_agrees_with_dumas2011_table_2() -> None:
    """10 tests of 6 coordinates, 0.03 mm, 0.1 kg, 0.01°: the paper prints 8, 8, 9, 2, 2, 5 % (section 5.2)."""
    _, robot, T = cell()
    rng = np.random.default_rng(29)
    sigma = StandardUncertainty(displacement=3e-5, rotation=3e-5 / 0.4, force=0.981, joint=np.radians(0.01))
    spread = []
    for _ in range(5):
        made = plan_load_tests(rng, poses=10, loads=1, repeats=1, force=1000.0, moment=200.0)
        e = build_load_test_experiment(
            add_measurement_errors(made, rng, rotations=True, noise=0.0, outliers=0.0), robot, T
        )
        found = fit_stiffness(e, robust=False, weighted=False, bounded=False)
        settled = settle_coefficients(found, compute_coefficient_uncertainty(found), TRUE_K)
        spread.append(run_monte_carlo(found, settled, robot, T, rng, uncertainty=sigma, draws=100).spread)
    typical = np.median(spread, axis=0)
    # the paper does not print its poses and loads: only the order of magnitude is compared
    assert (typical < 0.15).all()
    assert (typical > 0.003).all()


def test_reasons_and_results_of_the_whole_pipeline() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(30), rotations=True)
    runs = [
        identify_stiffness(e, robot, T, ArmStiffness(joints=TRUE_K), IdentifyOptions(seed=1), np.random.default_rng(1))
        for _ in range(2)
    ]
    found = runs[0]
    assert [j.identified for j in found.joints] == [True] * 6
    assert found.heldout is not None
    assert found.errors.rmse < found.heldout.rmse < 1.5 * found.errors.rmse
    assert found.errors.explained > 0.99
    assert found.condition_plain == pytest.approx(np.linalg.cond(e.response().reshape(-1, 6)))
    for j, k in zip(found.joints, TRUE_K, strict=True):
        assert j.interval[0] < j.k < j.interval[1]
        assert j.k == pytest.approx(k, rel=0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(found.stiffness.covariance)), [j.sigma for j in found.joints], rtol=1e-9)
    np.testing.assert_array_equal(runs[1].stiffness.joints, found.stiffness.joints)
    np.testing.assert_array_equal(runs[1].monte_carlo.compliance, found.monte_carlo.compliance)
    np.testing.assert_allclose(found.table.residual + found.table.predicted, e.measured, atol=1e-18)


def test_terms_are_found_with_their_interval_and_written() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(31), rotations=True, poses=25)
    law = build_fitted_term("joint_coupling", "joint:4-5", robot, T, compliance_rad_per_Nm=3e-7)
    e = replace(e, measured=e.measured + law.compute_response(e.state, e.wrench) @ law.values)
    options = IdentifyOptions(terms=(StiffnessTerm("joint_coupling", "joint:4-5"),), studies=False)
    found = identify_stiffness(e, robot, T, ArmStiffness(joints=TRUE_K), options, np.random.default_rng(0))
    term = found.terms[0]
    assert term.identified
    assert term.interval[0] < 3e-7 < term.interval[1]
    assert found.stiffness.terms[0].parameters["compliance_rad_per_Nm"] == term.value
    # known terms of the cell are subtracted and written unchanged
    known = ArmStiffness(joints=TRUE_K, terms=(law.to_file(),))
    with_known = identify_stiffness(e, robot, T, known, IdentifyOptions(studies=False), np.random.default_rng(0))
    assert with_known.stiffness.terms == (law.to_file(),)
    assert with_known.errors.rmse == pytest.approx(found.errors.rmse, rel=0.02)
