"""Model discrepancy of a stiffness: found if hidden, absent if the springs explain all readings, used in a plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated_load_tests as made
from mean_cost_std import compute_mean_cost_std
from scipy.stats import norm
from test_compensation import corner
from test_planning_path import toolpath as made_path
from test_planning_pipeline import FORCE, FREE, K, small_job

from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.stiffness import ArmStiffness, ModelDiscrepancy, StiffnessTerm
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_masses
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.assessment.model_discrepancy import (
    estimate_identification_discrepancy,
    select_significant_modes,
)
from machopt.measurement.identification.assessment.unmodelled_pose_variance import estimate_pose_variance
from machopt.measurement.identification.fitting.weighted_fit import fit_stiffness
from machopt.planning.compensation.expected_deflection_reduction import predict_removals
from machopt.planning.compensation.plan_compensation import compensate_plan
from machopt.planning.error_probability.model_discrepancy import (
    NINETY,
    DiscrepancyModel,
    compute_half_width,
    compute_reported_std,
)
from machopt.planning.plan_output.plan_remarks import list_hints
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.discrepancy_columns import (
    CURVE_SMOOTHING,
    TYPICAL_PLAY_RAD,
    DiscrepancyColumns,
    list_elastic_columns,
    list_gear_columns,
)
from machopt.stiffness.terms.term_builder import compile_terms

BASE = StiffnessTerm("base_compliance", "base", {"compliance_diagonal": [1e-9, 1e-9, 1e-9, 2e-7, 2e-7, 1e-7]})


def readings(terms: tuple[StiffnessTerm, ...], seed: int = 1) -> tuple[LoadTestExperiment, np.ndarray]:
    """Return load tests of an arm with true springs and terms, and their poses."""
    rng = np.random.default_rng(seed)
    tests = made.draw_load_tests(rng, poses=16, loads=3, repeats=2)
    _, robot, T = made.cell()
    true = (
        ArmElasticity(robot, T, ArmStiffness(joints=made.TRUE_K, terms=terms))
        .evaluate(tests.state.q)
        .compute_twist(tests.wrench)
    )
    noise = rng.normal(0.0, made.WHITE, tests.measured.shape)
    return replace(tests, measured=true[:, : tests.dimensions] + noise), tests.state.q


def doubt_of(tests: LoadTestExperiment) -> tuple[ArmStiffness, ModelDiscrepancy]:
    _, robot, T = made.cell()
    found = fit_stiffness(tests)
    stiffness = ArmStiffness(joints=1.0 / found.x[:6])
    return stiffness, estimate_identification_discrepancy(found, tests, robot, T, stiffness, None)


def test_springs_alone_have_no_discrepancy() -> None:
    _, doubt = doubt_of(readings(())[0])
    assert doubt.parts == tuple(f"{word} {j}" for word in ("joint", "play") for j in range(1, 7))
    assert not doubt.misfit
    assert doubt.local == 0.0


def test_backlash_not_crossed_in_load_tests_may_occur_in_a_job() -> None:
    """Only readings with the weight of gear 2 above twice the load are used: backlash of gear 2 is never crossed.

    Gear 1 carries no weight, so its backlash is crossed.
    """
    tests, _ = readings(())
    found, robot, T = made.cell()
    masses = load_masses(found)
    weight = compute_weight_torque(robot, masses, tests.state)[:, 1]
    load = np.einsum("nc,nc->n", tests.state.J[:, :, 1], tests.wrench)
    retained = np.flatnonzero(np.abs(weight) > 2.0 * np.abs(load))
    assert 40 < len(retained) < len(weight)
    some = tests.select_readings(retained)
    fitted = fit_stiffness(some)
    stiffness = ArmStiffness(joints=1.0 / fitted.x[:6])
    doubt = estimate_identification_discrepancy(fitted, some, robot, T, stiffness, masses)
    assert not doubt.misfit
    half = {j: float(np.linalg.norm(doubt.modes[:, doubt.parts.index(f"play {j}")])) for j in (1, 2)}
    assert half[2] > 0.4 * TYPICAL_PLAY_RAD  # one gear in four has backlash
    assert half[1] < 0.1 * half[2]


def test_concealed_discrepancy_is_predicted_at_other_poses_with_coverage() -> None:
    tests, _ = readings((BASE,))
    stiffness, doubt = doubt_of(tests)
    assert doubt is not None
    assert doubt.misfit
    assert doubt.left > 2.0 * doubt.noise
    _, robot, T = made.cell()
    rng = np.random.default_rng(7)
    q = made.CENTRE + made.SPREAD * rng.uniform(-1, 1, (60, 6))
    force = rng.normal(0.0, 600.0, (60, 3))
    arm = ArmElasticity(robot, T, replace(stiffness, discrepancy=doubt))
    deflection = arm.evaluate(q).compute_deflection(force)
    true = (
        ArmElasticity(robot, T, ArmStiffness(joints=made.TRUE_K, terms=(BASE,))).evaluate(q).compute_deflection(force)
    )
    known = DiscrepancyModel.build(arm)
    assert known is not None
    moves = known.moves(arm.evaluate(q), q, force)
    off = np.linalg.norm(true - deflection, axis=1)
    # most of the error is predicted
    assert np.median(np.linalg.norm(true - deflection - moves[:, :, 0], axis=1) / off) < 0.3
    along = deflection / np.linalg.norm(deflection, axis=1, keepdims=True)
    ways = np.einsum("mc,mcr->mr", along, moves)
    own = known.local * np.linalg.norm(force, axis=1)
    error = np.abs(np.einsum("mc,mc->m", along, true - deflection))
    assert np.mean(error <= NINETY * compute_reported_std(ways, own**2)) > 0.75


def test_one_soft_place_does_not_soften_the_others() -> None:
    """With a soft base, the uncertainty of each link and of the tool is below a tenth of that of the base."""
    _, doubt = doubt_of(readings((BASE,))[0])
    size = np.sqrt(doubt.shift**2 + np.sum(doubt.modes**2, axis=0))
    by_body = {
        body: max(
            (size[n] for n, part in enumerate(doubt.parts) if part.startswith(body) and " r" in part), default=0.0
        )
        for body in ("base", "link:2", "link:3", "link:4", "tool")
    }
    assert by_body["base"] > 10.0 * max(v for name, v in by_body.items() if name != "base")


def test_weakly_observed_spread_is_kept_for_a_job_that_depends_on_it() -> None:
    """Six tenths of a job's variance are in a direction with 1/10,000 of the information of the others."""
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 3.0]])
    modes = select_significant_modes(covariance, np.diag([1.0, 1.0, 1e-4]))
    np.testing.assert_allclose(modes.T @ modes, covariance, rtol=1e-6, atol=1e-9)


def test_pose_specific_discrepancy_accounts_for_few_regions() -> None:
    """Over repeated simulated recordings, the mean estimate is not below the true value, even if that is near zero."""
    rng = np.random.default_rng(3)
    expected, force = np.array([1.0, 1.3, 0.8, 40.0, 1.0, 0.9, 1.1, 1.2]), np.full(8, 2.0)
    for true in (0.0, 0.1, 3.0):
        drawn = (expected + true * force) * rng.chisquare(6.0, (300, 8)) / 6.0
        values = np.array([estimate_pose_variance(left, expected, force) for left in drawn])
        assert (values >= 0.0).all()
        assert true <= values.mean() < 1.3 * true + 0.25
    assert estimate_pose_variance(expected + 5.0 * force, expected, force) == pytest.approx(
        5.0
    )  # all regions agree, so there is no uncertainty


@pytest.mark.parametrize("at", [0.09, 0.2, 0.6])
def test_gear_between_known_laws_is_near_their_sum(at: float) -> None:
    """The candidate laws approximate a soft start (arc tangent with any knee) within 2 % of its maximum."""
    torque = np.linspace(-1.2, 1.2, 201)
    laws = np.stack([torque, *(np.tanh(torque / s) for s in CURVE_SMOOTHING.values())], axis=1)
    law = np.arctan(torque / at)
    rest = law - laws @ np.linalg.lstsq(laws, law, rcond=None)[0]
    assert np.abs(rest).max() < 0.02 * np.abs(law).max()


def test_candidate_columns_are_derivatives_of_the_model() -> None:
    """The column of a joint is the derivative of the displacement by its compliance;
    that of a base by a base spring."""
    _, robot, T = made.cell()
    rng = np.random.default_rng(2)
    q, force = made.CENTRE + rng.normal(0, 0.4, (5, 6)), rng.normal(0, 500.0, (5, 3))
    wrench = np.hstack([force, rng.normal(0, 50.0, (5, 3))])
    names = ("joint 3", "base x", "base rz")
    s = DiscrepancyColumns(robot=robot, T_flange_tcp=T, names=names, torque=np.ones(6))
    state = robot.compute_state(q, T, bodies=True)
    columns = s.compute_columns(state, np.tile(made.TRUE_K, (5, 1)), wrench)

    def twist(c3: float = 0.0, base: tuple[float, ...] = ()) -> np.ndarray:
        k = made.TRUE_K.copy()
        k[2] = 1.0 / (1.0 / k[2] + c3)
        terms = (StiffnessTerm("base_compliance", "base", {"compliance_diagonal": list(base)}),) if base else ()
        return ArmElasticity(robot, T, ArmStiffness(joints=k, terms=terms)).evaluate(q).compute_twist(wrench)

    soft = (2e-9, 1e-30, 1e-30, 1e-30, 1e-30, 3e-8)
    np.testing.assert_allclose(columns[:, :, 0] * 1e-8, twist(c3=1e-8) - twist(), rtol=1e-6, atol=1e-13)
    both = columns[:, :, 1] * soft[0] + columns[:, :, 2] * soft[5]
    np.testing.assert_allclose(both, twist(base=soft) - twist(), rtol=1e-6, atol=1e-13)


def test_small_load_gives_the_tangent() -> None:
    _, robot, T = made.cell()
    q, w = made.CENTRE[None], np.array([[1e-3, -2e-3, 1e-3, 0.0, 0.0, 0.0]])
    names = (*(f"joint {j}" for j in range(1, 7)), *list_elastic_columns(), *list_gear_columns())
    s = DiscrepancyColumns(robot=robot, T_flange_tcp=T, names=names, torque=np.full(6, 800.0))
    state, k = robot.compute_state(q, T, bodies=True), made.TRUE_K[None]
    np.testing.assert_allclose(
        s.compute_columns(state, k, w, small=True), s.compute_columns(state, k, w), rtol=1e-6, atol=1e-18
    )


def test_half_width_covers_ninety_percent_around_a_biased_value() -> None:
    shift, sigma = np.array([0.0, 0.3, 1.0, 5.0, -5.0]), np.array([1.0, 1.0, 1.0, 1.0, 0.1])
    h = compute_half_width(shift, sigma)
    np.testing.assert_allclose(norm.cdf((h - shift) / sigma) - norm.cdf((-h - shift) / sigma), 0.9, atol=1e-9)
    assert h[0] == pytest.approx(NINETY)


def test_file_stores_it_and_refuses_rows_of_another_length(tmp_path: Path) -> None:
    doubt = ModelDiscrepancy(
        parts=("joint 1", "base rx"),
        torque=np.arange(1.0, 7.0),
        shift=np.array([1e-9, 2e-8]),
        modes=np.eye(2) * 1e-8,
        left=1e-4,
        noise=2e-5,
    )
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, ArmStiffness(joints=made.TRUE_K, discrepancy=doubt))
    again = load_stiffness(file).discrepancy
    assert again is not None
    assert again.parts == doubt.parts
    np.testing.assert_allclose(again.modes, doubt.modes)
    np.testing.assert_allclose([again.left, again.noise, *again.shift], [doubt.left, doubt.noise, *doubt.shift])
    file.write_text(file.read_text(encoding="utf-8").replace("joint 1, base rx", "joint 1"), encoding="utf-8")
    with pytest.raises(InputError, match="one for each of parts"):
        load_stiffness(file)


def test_unknown_part_is_refused() -> None:
    _, robot, T = made.cell()
    with pytest.raises(InputError, match="link:9 rx"):
        DiscrepancyColumns(robot=robot, T_flange_tcp=T, names=("link:9 rx",), torque=np.ones(6))


def test_misfit_is_reported_and_widens_deflection_and_compensation(tmp_path: Path) -> None:
    options = replace(FREE, force=FORCE, rotation_step=np.radians(15.0), compensation_max=0.01)
    covariance = np.diag((0.01 / np.asarray(K)) ** 2)
    plain = ArmStiffness(joints=np.asarray(K), covariance=covariance)
    modes = np.zeros((7, 7))
    modes[:6, :6], modes[6, 6] = np.sqrt(covariance), 1e-8
    names = (*(f"joint {j}" for j in range(1, 7)), "base ry")
    doubt = ModelDiscrepancy(
        parts=names, torque=np.full(6, 500.0), shift=np.r_[np.zeros(6), 5e-8], modes=modes, left=3e-4, noise=3e-5
    )
    toolpath, before, after = made_path(corner()), None, None
    for stiffness in (plain, replace(plain, discrepancy=doubt)):
        p = small_job(tmp_path, corner(), options, stiffness=stiffness)
        c = compensate_plan(p, toolpath)
        whole, *operations = predict_removals(c, toolpath.operation, tuple(o.label for o in toolpath.operations))
        assert operations
        assert whole.left90 is not None
        assert whole.removed90 is not None
        found = compute_mean_cost_std(p)[0], whole, any("times their noise" in h for h in list_hints(p))
        before, after = after, found
    assert before is not None
    assert after is not None
    assert (before[2], after[2]) == (False, True)
    assert after[0] > before[0]
    assert after[1].left90[1] > before[1].left90[1] > before[1].left
    assert after[1].removed90[0] < before[1].removed90[0]


def test_compensator_is_evaluated_only_within_the_joint_limits() -> None:
    """It was evaluated over the full circle: load tests of a strong one ended
    as invalid input although a finding existed."""
    tests, _ = readings(())
    _, robot, T = made.cell()
    found = fit_stiffness(tests)
    k, turn = 1.0 / found.x[:6], np.linspace(-np.pi, np.pi, 361)

    def balanced(size: float) -> StiffnessTerm:
        keys = {"ratio": 0.7, "angle_deg": 60.0, "force_times_length_Nm": -4.0 * size, "rate_times_length2_Nm": size}
        return StiffnessTerm("gravity_compensator", "joint:2", keys)

    def added(size: float) -> np.ndarray:
        (term,), _ = compile_terms((balanced(size),), robot, T)
        return term.compute_parallel_stiffness(turn)

    size = 1.2 * k[1] / -float(added(1.0).min())
    stiffness = ArmStiffness(joints=k, terms=(balanced(size),))
    q2 = turn[int(added(size).argmax())]
    limits = (np.array([-3.0, q2 - 0.2, *[-3.0] * 4]), np.array([3.0, q2 + 0.2, *[3.0] * 4]))
    assert estimate_identification_discrepancy(found, tests, robot, T, stiffness, None, limits).noise > 0.0
    with pytest.raises(InputError, match="less than that would work"):
        estimate_identification_discrepancy(found, tests, robot, T, stiffness, None)
