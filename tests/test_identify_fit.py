"""Compliances from load tests, compared with NumPy least squares, dense matrices, explicit likelihoods, true values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_arm import TrueArm
from simulated_load_tests import (
    CYCLE,
    POSE,
    TRUE_K,
    WHITE,
    add_measurement_errors,
    cell,
    draw_load_tests,
    plan_load_tests,
)

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.errors import InputError
from machopt.measurement.estimation.bounded_least_squares import compute_profile_bound, minimise_bounded_quadratic
from machopt.measurement.estimation.error_clusters import (
    ErrorClusters,
    VarianceComponents,
    build_error_clusters,
    build_normal_equations,
    predict_cluster_shifts,
    sum_channel_equations,
)
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.estimation.reading_covariance import compute_joint_sensitivity, compute_reading_covariance
from machopt.measurement.estimation.variance_components import estimate_variance_components
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit, fit_stiffness
from machopt.measurement.identification.identification_pipeline import identify_stiffness
from machopt.measurement.identification.options import IdentifyOptions
from machopt.stiffness.terms import build_fitted_term

C = 1.0 / TRUE_K


def dumas(e: LoadTestExperiment) -> tuple[np.ndarray, np.ndarray]:
    """Compute B and c of dumas2011 eqs. 21–24, element by element."""
    rows, right = [], []
    for n in range(len(e)):
        J, w = e.state.J[n], e.wrench[n]
        rows += [[J[i, j] * sum(J[k, j] * w[k] for k in range(6)) for j in range(6)] for i in range(e.dimensions)]
        right += list(e.measured[n])
    return np.array(rows), np.array(right)


def dense(e: LoadTestExperiment, groups: ErrorClusters, V: np.ndarray, share: VarianceComponents) -> np.ndarray:
    """Return the (3N, 3N) covariance matrix of one channel as a dense matrix."""
    same_cycle = groups.cycle[:, None] == groups.cycle
    visit = groups.visit_of_cycle[groups.cycle]
    same_visit = visit[:, None] == visit
    out = np.kron(share.cycle * same_cycle + share.visit * same_visit, np.eye(3))
    for n, own in enumerate(V):
        out[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += own
    return share.scale * out


@pytest.mark.parametrize("rotations", [False, True])
def test_plain_fit_equals_eq_26_of_dumas2011(rotations: bool) -> None:
    e = draw_load_tests(np.random.default_rng(1), rotations=rotations)
    B, c = dumas(e)
    plain = fit_stiffness(e, robust=False, weighted=False, bounded=False)
    # both solve the same equations in double precision; the condition number of B is below 100
    np.testing.assert_allclose(plain.x, np.linalg.lstsq(B, c, rcond=None)[0], rtol=1e-10)


def test_truth_is_found_without_noise() -> None:
    e = draw_load_tests(np.random.default_rng(2), rotations=True, noise=0.0)
    # the rotation c τ is finite in the simulated data: relative error of the order of the rotation itself, 1e-3 rad,
    # which mostly cancels
    np.testing.assert_allclose(fit_stiffness(e).compliance, C, rtol=1e-3)


def test_gross_errors_do_not_move_the_result() -> None:
    rng = np.random.default_rng(3)
    _, robot, T = cell()
    record = add_measurement_errors(plan_load_tests(rng), rng, outliers=0.0)
    clean = fit_stiffness(build_load_test_experiment(record, robot, T))
    d, w = record.displacement.copy(), record.wrench.copy()
    bad = rng.choice(len(d), 8, replace=False)  # 5 %
    d[bad[:4]] *= 10.0
    w[bad[4:]] *= 10.0  # high leverage: a test of the residuals alone does not find these
    spoilt = fit_stiffness(build_load_test_experiment(replace(record, displacement=d, wrench=w), robot, T))
    error = np.sqrt(np.diag(np.linalg.inv(clean.normal.total()[0]))) * clean.column
    assert np.abs(spoilt.x - clean.x).max() < 10 * error.max()
    assert (np.abs(spoilt.x - clean.x) < 1.5 * error).all()  # the effect of 5 % missing data at most
    assert spoilt.outlier[bad].all()
    assert spoilt.outlier.sum() <= len(bad) + 2
    squares = fit_stiffness(
        build_load_test_experiment(replace(record, displacement=d, wrench=w), robot, T), robust=False
    )
    assert (np.abs(squares.x - clean.x) > 5 * error).any()


def test_weights_by_group_equal_the_dense_inverse() -> None:
    rng = np.random.default_rng(4)
    e = draw_load_tests(rng, poses=5, loads=3, repeats=2)
    groups = build_error_clusters(e)
    assert (groups.has_cycle, groups.has_visit) == (True, True)
    V = np.array([np.cov(rng.standard_normal((3, 9))) for _ in range(len(e))]) * 1e-10
    share = VarianceComponents(1.7, 2e-10, 5e-10)
    A, y = e.response(), e.measured
    S = dense(e, groups, V, share)
    W = np.linalg.inv(S)
    X = A.reshape(-1, 6)
    found = build_normal_equations(groups, sum_channel_equations(groups, np.linalg.inv(V), A, y, float(y.size)), share)
    H, h = found.total()
    np.testing.assert_allclose(H, X.T @ W @ X, rtol=1e-8)  # double precision; condition number of the blocks below 1e4
    np.testing.assert_allclose(h, X.T @ W @ y.reshape(-1), rtol=1e-8)
    assert found.yy == pytest.approx(y.reshape(-1) @ W @ y.reshape(-1), rel=1e-8)
    other = build_normal_equations(
        groups,
        sum_channel_equations(groups, np.linalg.inv(V), A, y, float(y.size)),
        VarianceComponents(1.0, 1e-10, 3e-10),
    )
    dense_other = dense(e, groups, V, VarianceComponents(1.0, 1e-10, 3e-10))
    difference = np.linalg.slogdet(S)[1] - np.linalg.slogdet(dense_other)[1]
    assert found.logdet - other.logdet == pytest.approx(difference, rel=1e-8)
    own = np.zeros_like(S)
    for n in range(len(e)):
        own[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] = share.scale * V[n]
    expected = (S - own) @ W @ y.reshape(-1)  # E[shift | y]
    np.testing.assert_allclose(
        predict_cluster_shifts(groups, np.linalg.inv(V), y, share).reshape(-1), expected, rtol=1e-7, atol=1e-12
    )


def test_variance_components_maximise_the_restricted_likelihood() -> None:
    rng = np.random.default_rng(5)
    e = draw_load_tests(rng, poses=12, loads=3, repeats=3)
    groups = build_error_clusters(e)
    V = np.broadcast_to(WHITE**2 * np.eye(3), (len(e), 3, 3))
    A, y, X = e.response(), e.measured, e.response().reshape(-1, 6)
    found = estimate_variance_components(
        groups, sum_channel_equations(groups, np.linalg.inv(V), A, y, float(y.size)), WHITE**2, stated=False
    )

    def deviance(share: VarianceComponents) -> float:
        S = dense(e, groups, V, share)
        W = np.linalg.inv(S)
        H = X.T @ W @ X
        r = y.reshape(-1) - X @ np.linalg.solve(H, X.T @ W @ y.reshape(-1))
        return float(
            np.linalg.slogdet(S)[1]
            + np.linalg.slogdet(H / np.outer(*[np.sqrt(np.diag(H))] * 2))[1]
            + 2 * np.log(np.sqrt(np.diag(H))).sum()
            + r @ W @ r
        )

    least = deviance(found)
    for field in ("scale", "cycle", "visit"):
        for factor in (0.9, 1.1):
            moved = replace(found, **{field: getattr(found, field) * factor})
            assert deviance(moved) > least - 1e-3  # the search ends within 1e-7 of a deviance of several thousand


def test_noise_of_reading_cycle_and_pose_is_found() -> None:
    e = draw_load_tests(np.random.default_rng(6), poses=60, loads=4, repeats=3)
    scatter = fit_stiffness(e).weighting.scatter(build_error_clusters(e))[0]
    # 60 poses × 3 axes: 5 % standard error of the pose component, less of the others; about four of them allowed
    assert scatter.visit == pytest.approx(POSE, rel=0.22)
    assert scatter.cycle == pytest.approx(CYCLE, rel=0.22)
    # the reading component is white noise plus the force error, 0.7 % of about 1 mm
    assert WHITE < scatter.reading < 1.4 * WHITE


def test_levels_without_replicates_are_not_estimated() -> None:
    rng = np.random.default_rng(7)
    one_each = build_error_clusters(draw_load_tests(rng, poses=12, loads=1, repeats=1))
    assert (one_each.has_cycle, one_each.has_visit) == (False, False)
    one_cycle = build_error_clusters(draw_load_tests(rng, poses=12, loads=4, repeats=1))
    assert (one_cycle.has_cycle, one_cycle.has_visit) == (False, True)
    _, robot, T = cell()
    unlabelled = build_error_clusters(
        build_load_test_experiment(add_measurement_errors(plan_load_tests(rng), rng, labels=False), robot, T)
    )
    assert (unlabelled.has_cycle, unlabelled.has_visit) == (False, True)


def test_stated_uncertainties_are_propagated_to_the_displacement() -> None:
    rng = np.random.default_rng(8)
    _, robot, T = cell()
    e = draw_load_tests(rng, poses=3, loads=1, repeats=1, rotations=True)
    sigma = StandardUncertainty(displacement=1e-5, rotation=2e-5, force=20.0, moment=5.0, joint=1e-4)
    V = compute_reading_covariance(e, C, (), sigma, np.zeros(2))
    draws, n = 20000, 1
    q = e.state.q[n] + sigma.joint * rng.standard_normal((draws, 6))
    w = e.wrench[n] + np.repeat([sigma.force, sigma.moment], 3) * rng.standard_normal((draws, 6))
    J = robot.compute_state(q, T).J
    d = np.einsum("nci,ni->nc", J, np.einsum("nci,nc->ni", J, w) * C)
    for c, own in enumerate((1e-5, 2e-5)):
        sample = np.cov(d[:, 3 * c : 3 * c + 3].T) + own**2 * np.eye(3)
        size = np.sqrt(np.outer(np.diag(sample), np.diag(sample)))
        # sampling error of a covariance from 20,000 draws: 0.7 to 1 % of the product of the standard deviations
        np.testing.assert_allclose(V[c, n] / size, sample / size, atol=0.04)


def test_displacement_sensitivity_agrees_with_finite_differences() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(9), poses=4, loads=1, repeats=1)
    step = 1e-5

    def moved(q: np.ndarray) -> np.ndarray:
        J = robot.compute_state(q, T).J
        return np.einsum("nci,ni->nc", J, np.einsum("nci,nc->ni", J, e.wrench) * C)

    slope = np.stack(
        [(moved(e.state.q + step * axis) - moved(e.state.q - step * axis)) / (2 * step) for axis in np.eye(6)], axis=-1
    )
    # central differences of displacements of 1e-3: truncation error step² = 1e-10, rounding error 1e-16/1e-5 = 1e-11
    np.testing.assert_allclose(compute_joint_sensitivity(e.state.J, e.wrench, C), slope, atol=1e-10)


def test_known_terms_are_subtracted_and_unknown_ones_found() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(10), poses=25, rotations=True)
    known = build_fitted_term("link_compliance", "link:2", robot, T, EI_Nm2=4e7, GJ_Nm2=3e7)
    bent = e.measured + known.compute_response(e.state, e.wrench) @ known.values
    e = replace(e, measured=bent)
    with_it = fit_stiffness(e, fixed=(known,))
    found = fit_stiffness(e, terms=(build_fitted_term("link_compliance", "link:2", robot, T),))
    without = fit_stiffness(e)
    assert [u.name for u in found.unknowns[6:]] == ["link_compliance at link:2 1/EI", "link_compliance at link:2 1/GJ"]
    error = np.sqrt(np.diag(np.linalg.inv(found.normal.total()[0]))) * found.column
    assert (np.abs(found.x[6:] - known.values) < 4 * error[6:]).all()
    assert np.abs(with_it.compliance / C - 1).max() < 0.03
    assert np.abs(without.compliance / C - 1).max() > 0.05  # the joint compliances absorb the omitted term


def test_bounded_minimum_satisfies_the_optimality_conditions() -> None:
    rng = np.random.default_rng(11)
    for _ in range(50):
        X = rng.standard_normal((12, 6)) * 10.0 ** rng.uniform(-3, 3, 6)
        H, h = X.T @ X, X.T @ rng.standard_normal(12)
        lower = np.where(rng.random(6) < 0.3, -np.inf, 0.0)
        x = minimise_bounded_quadratic(H, h, lower)
        gradient = (H @ x - h) / np.sqrt(np.diag(H))  # scaled to comparable units for all coefficients
        assert (x >= lower).all()
        at_bound = x <= lower + 1e-12 * np.abs(x).max()
        np.testing.assert_allclose(gradient[~at_bound], 0.0, atol=1e-8)
        assert (gradient[at_bound] > -1e-8).all()


def test_profile_of_an_unbounded_quadratic_is_the_symmetric_interval() -> None:
    rng = np.random.default_rng(12)
    X = rng.standard_normal((20, 4))
    H, h = X.T @ X, X.T @ rng.standard_normal(20)
    sigma = np.sqrt(np.linalg.inv(H)[1, 1])
    best = np.linalg.solve(H, h)[1]
    for sign in (-1, 1):
        assert compute_profile_bound(H, h, np.full(4, -np.inf), 1, 2.5**2, sign) == pytest.approx(
            best + sign * 2.5 * sigma, rel=1e-5
        )


def test_unobserved_coefficient_stays_at_its_bound_without_an_upper_end() -> None:
    free, none = -np.inf, np.zeros((3, 3))
    np.testing.assert_allclose(
        minimise_bounded_quadratic(np.diag([4.0, 0.0]), np.array([2.0, 0.0]), np.array([free, 0.3])), [0.5, 0.3]
    )
    np.testing.assert_allclose(
        minimise_bounded_quadratic(none, np.zeros(3), np.array([free, 0.0, 2.0])), [0.0, 0.0, 2.0]
    )
    alike = np.ones((2, 2))  # only the sum of both is observed: each of them is unbounded
    for sign in (-1, 1):
        assert (
            compute_profile_bound(np.diag([4.0, 0.0]), np.array([2.0, 0.0]), np.full(2, free), 1, 1.0, sign)
            == sign * np.inf
        )
        assert compute_profile_bound(alike, np.ones(2), np.full(2, free), 0, 1.0, sign) == sign * np.inf


def test_profile_of_a_bounded_coefficient_ends_at_its_bound() -> None:
    """(x − 1)² rises by 1 at x = 0 and x = 2, and by 4 at x = −1 and x = 3;
    at the lower side the bound 0 is reached first."""
    H, h, lower = np.eye(1), np.ones(1), np.zeros(1)
    assert compute_profile_bound(H, h, lower, 0, 4.0, -1) == 0.0
    assert compute_profile_bound(H, h, lower, 0, 0.25, -1) == pytest.approx(0.5, rel=1e-5)
    assert compute_profile_bound(H, h, lower, 0, 4.0, 1) == pytest.approx(3.0, rel=1e-5)


def test_noise_is_not_estimated_without_redundancy() -> None:
    """Six coordinates for six compliances leave no residual: the stated noise is used unchanged."""
    e = draw_load_tests(np.random.default_rng(15), poses=2, loads=1, repeats=1)
    groups, V = build_error_clusters(e), np.broadcast_to(WHITE**2 * np.eye(3), (2, 3, 3))
    channel_equations = sum_channel_equations(groups, np.linalg.inv(V), e.response(), e.measured, 6.0)
    assert estimate_variance_components(groups, channel_equations, WHITE**2, stated=False) == VarianceComponents()


def test_only_loads_and_displacements_become_equations() -> None:
    record, _ = tilted_record()
    _, robot, T = cell()
    for wrong in ({"kind": "pose"}, {"wrench": None}, {"displacement": None}):
        with pytest.raises(InputError, match="stiffness is identified from kind 'deflection'"):
            build_load_test_experiment(replace(record, **wrong), robot, T)


def test_too_few_readings_and_zero_load_are_refused() -> None:
    e = draw_load_tests(np.random.default_rng(13), poses=1, loads=1, repeats=1)
    with pytest.raises(InputError, match=r"3 equations for 6 unknowns; at least 3 readings"):
        fit_stiffness(e)
    with pytest.raises(InputError, match="no reading carries a load"):
        fit_stiffness(replace(draw_load_tests(np.random.default_rng(13)), wrench=np.zeros((160, 6))))


def tilted_record() -> tuple[Recording, StiffnessFit]:
    rng = np.random.default_rng(14)
    _, robot, T = cell()
    record = add_measurement_errors(plan_load_tests(rng), rng)
    return record, fit_stiffness(build_load_test_experiment(record, robot, T))


def test_wrench_and_displacement_in_tool_axes_give_the_same_result() -> None:
    record, base = tilted_record()
    _, robot, T = cell()
    R = robot.compute_fk(record.q, T)[:, :3, :3]
    turned = replace(
        record,
        wrench_frame="tool",
        displacement_frame="tool",
        wrench=np.einsum("nji,nbj->nbi", R, record.wrench.reshape(-1, 2, 3)).reshape(-1, 6),
        displacement=np.einsum("nji,nj->ni", R, record.displacement),
    )
    # weights and coefficients converge to 1/1000 of a standard error; the standard error is 3 % of joint 6
    np.testing.assert_allclose(fit_stiffness(build_load_test_experiment(turned, robot, T)).x, base.x, rtol=3e-5)


def test_same_input_same_result() -> None:
    record, once = tilted_record()
    _, robot, T = cell()
    again = fit_stiffness(build_load_test_experiment(record, robot, T))
    np.testing.assert_array_equal(again.x, once.x)


def test_pipeline_at_the_loaded_equilibrium_finds_what_the_linear_law_misses() -> None:
    rng = np.random.default_rng(15)
    _, robot, T = cell()
    soft = TRUE_K / 6.0  # rotations of 10 mrad: a linear law has an error of some tenths of a percent
    made = plan_load_tests(rng, force=2500.0, k=soft)
    exact = TrueArm(robot, T, 1.0 / soft).displacement(made.q, made.wrench)
    e = build_load_test_experiment(
        add_measurement_errors(replace(made, exact=exact), rng, noise=0.0, outliers=0.0), robot, T
    )
    wrong = {}
    for geometric in (False, True):
        options = IdentifyOptions(geometric=geometric, studies=False)
        found = identify_stiffness(e, robot, T, ArmStiffness(joints=soft), options, np.random.default_rng(0))
        wrong[geometric] = np.abs(found.stiffness.joints / soft - 1).max()
        assert ("geometric_stiffness" in [t.effect for t in found.stiffness.terms]) == geometric
    assert wrong[False] > 1e-3
    assert wrong[True] < 1e-6  # the compliances converge to 1e-9


def test_pipeline_gives_terms_grid_and_model_choice() -> None:
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(16), poses=16, loads=3, repeats=1)
    options = IdentifyOptions(
        model="auto", terms=(StiffnessTerm("joint_coupling", "joint:4-5"),), grid_cell=0.8, studies=False
    )
    found = identify_stiffness(e, robot, T, ArmStiffness(joints=TRUE_K), options, np.random.default_rng(0))
    assert found.model == "constant"  # the true stiffness does not vary
    assert found.why_model.startswith("constant: ")
    assert found.stiffness.terms == ()  # the data contain no coupling: the term is not significant and is omitted
    assert not found.terms[0].identified
    grid = identify_stiffness(
        e, robot, T, ArmStiffness(joints=TRUE_K), replace(options, model="grid"), np.random.default_rng(0)
    )
    assert grid.model == "grid"
    assert grid.stiffness.grid is not None
    assert grid.table.predicted.shape == e.measured.shape
    assert grid.errors.rmse == pytest.approx(found.errors.rmse, rel=0.2)  # same true values, same noise
