"""Identification at the loaded equilibrium, compared with an independently simulated arm, and its limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_arm import Noise, SmoothField, SpringInBody, TrueArm, random_loads, record, scattered_poses

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.errors import InputError
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.identification.fitting.loaded_equilibrium import (
    LoadedEquilibriumModel,
    compute_nonlinear_share,
    fit_unweighted_compliances,
    refine_at_equilibrium,
)
from machopt.measurement.identification.fitting.weighted_fit import fit_stiffness
from machopt.stiffness.kinetostatic_indices import compute_geometric_influence, compute_geometric_stiffness
from machopt.stiffness.terms import build_fitted_term
from machopt.stiffness.terms.body_spring import BodySpring

CELLS = Path(__file__).resolve().parents[1] / "cells"


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(CELLS / "kr500_milling")


@pytest.fixture(scope="module")
def robot(cell: Cell) -> Robot:
    return load_robot(cell)


@pytest.fixture(scope="module")
def masses(cell: Cell) -> RobotMasses:
    return load_masses(cell)


def constant(cell: Cell) -> np.ndarray:
    assert cell.stiffness is not None
    return 1.0 / cell.stiffness.joints


def poses(cell: Cell, robot: Robot, rng: np.random.Generator, count: int = 30) -> np.ndarray:
    return scattered_poses(robot, rng, count, cell.home + np.array([0, 0, 0, 0.4, 0, 0]), 0.5)


def soft_test(
    cell: Cell, robot: Robot, masses: RobotMasses | None, soft: float = 10.0, noise: Noise | None = None
) -> tuple[LoadTestExperiment, np.ndarray]:
    """Loads of 2 kN on an arm ten times softer than the KR 500: deflections of centimetres."""
    rng = np.random.default_rng(3)
    c = soft * constant(cell)
    arm = TrueArm(robot, cell.tool.T_flange_tcp, c, masses=masses)
    made = record(
        arm,
        poses(cell, robot, rng),
        random_loads(rng, 30, 4, 2000, 300),
        rng,
        rotations=True,
        noise=Noise.none() if noise is None else noise,
    )
    return build_load_test_experiment(made.recording, robot, cell.tool.T_flange_tcp), c


# ------------------------------------------------------------------------------------------------------- gravity


def test_gravity_torques_equal_pinocchio(cell: Cell, robot: Robot, masses: RobotMasses) -> None:
    import pinocchio as pin

    links = len(masses.mass) - 1  # the last mass is the tool, which the URDF does not contain
    bare = RobotMasses(masses.body[:links], masses.mass[:links], masses.com[:links], masses.gravity)
    q = np.random.default_rng(0).uniform(-2, 2, (6, 6))
    torque, slope = compute_gravity_torque(robot, bare, robot.compute_state(q, None, bodies=True))
    model = pin.buildModelFromUrdf(str(cell.urdf))
    model.gravity.linear = masses.gravity
    for row, expected in zip(q, torque, strict=True):
        # pinocchio returns the motor torque, the opposite of the torque of the weight; rounding: 10 µN·m of 9 kN·m
        np.testing.assert_allclose(pin.computeGeneralizedGravity(model, model.createData(), row), -expected, atol=1e-5)
    h = 1e-5  # rad; central differences of torques of 10 kN·m have an error of about 1e-5 N·m/rad
    for j in range(6):
        d = h * np.eye(6)[j]
        ends = [
            compute_gravity_torque(robot, bare, robot.compute_state(q + s * d, None, bodies=True))[0] for s in (1, -1)
        ]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), slope[..., j], atol=1e-4)


def test_tool_counts_as_a_mass_of_the_last_link(cell: Cell, robot: Robot, masses: RobotMasses) -> None:
    assert masses.body[-1] == 6
    assert masses.mass[-1] == cell.tool.mass
    expected = robot.T_base_flange_zero[:3, :3] @ cell.tool.com + robot.T_base_flange_zero[:3, 3]
    np.testing.assert_allclose(masses.com[-1], expected, atol=1e-12)
    heavier = load_masses(replace(cell, tool=replace(cell.tool, mass=0.0)))
    assert len(heavier.mass) == len(masses.mass) - 1


# ------------------------------------------------------------------------------------------------------ simulator


def test_simulated_arm_converges_to_the_linear_law_for_small_loads(cell: Cell, robot: Robot) -> None:
    """Joints, a link, base and tool springs: the difference from the linear law is proportional to the load."""
    rng = np.random.default_rng(0)
    T = cell.tool.T_flange_tcp
    terms = [
        build_fitted_term("link_compliance", "link:2", robot, T, EI_Nm2=2e7, GJ_Nm2=1.6e7),
        build_fitted_term("base_compliance", "base", robot, T, compliance_diagonal=[1e-9] * 6),
        build_fitted_term("tool_compliance", "tool", robot, T, compliance_diagonal=[1e-8] * 6),
    ]
    springs = []
    for t in terms:
        assert isinstance(t, BodySpring)
        springs.append(SpringInBody(t.body, t.T_base_spring, np.einsum("p,pij->ij", t.values, t.basis)))
    arm = TrueArm(robot, T, constant(cell), springs=tuple(springs))
    q, loads = poses(cell, robot, rng), random_loads(rng, 30, 2, 1000, 200)
    x = np.concatenate([constant(cell), *(t.values for t in terms)])
    off = []
    for share in (1.0, 0.1):
        made = record(arm, q, share * loads, rng, rotations=True, noise=Noise.none())
        e = build_load_test_experiment(made.recording, robot, T)
        off.append(np.abs(e.response(terms) @ x - e.measured).max() / np.abs(e.measured).max())
    assert off[0] < 0.01  # for a KR 500, 1 kN is a small load
    np.testing.assert_allclose(off[0] / off[1], 10.0, rtol=0.02)  # the error is of first order in the load


def test_noise_of_a_recording_has_the_requested_size(cell: Cell, robot: Robot) -> None:
    rng = np.random.default_rng(1)
    arm = TrueArm(robot, cell.tool.T_flange_tcp, constant(cell))
    q = poses(cell, robot, rng, 400)
    noise = Noise(outliers=0.02)
    made = record(arm, q, random_loads(rng, 400, 4, 500), rng, repeats=2, loads_per_cycle=2, noise=noise)
    r = made.recording
    assert r.displacement is not None
    assert r.wrench is not None
    assert len(r) == 400 * 2 * 4
    assert len(np.unique(np.stack([r.pose, r.cycle]), axis=1).T) == 400 * 4
    error = (r.displacement - made.displacement[:, :3])[~made.outlier]
    label = r.pose[~made.outlier]
    means = np.stack([np.bincount(label, error[:, a]) / np.bincount(label) for a in range(3)], axis=1)
    # variance of a pose mean: pose + cycle/4 + white/8 (with a few outliers); 1,200 values have a standard error of 2
    # %; 3 sigma allowed
    expected = np.sqrt(noise.pose**2 + noise.cycle**2 / 4 + noise.white**2 / 8)
    assert np.std(means) == pytest.approx(expected, rel=0.07)
    assert made.outlier.mean() == pytest.approx(0.02, abs=0.008)  # standard error of 3,200 readings: 0.0025
    # relative force error; 9,600 values have a standard error of 0.7 %
    share = (r.wrench[:, :3] / made.wrench[:, :3] - 1).std()
    assert share == pytest.approx(noise.force, rel=0.03)
    again = record(arm, q, random_loads(np.random.default_rng(9), 400, 4, 500), np.random.default_rng(2))
    same = record(arm, q, random_loads(np.random.default_rng(9), 400, 4, 500), np.random.default_rng(2))
    np.testing.assert_array_equal(again.recording.displacement, same.recording.displacement)


def test_smooth_field_stays_within_its_amplitude_and_varies(cell: Cell) -> None:
    rng = np.random.default_rng(0)
    field = SmoothField.draw(constant(cell), rng, amplitude=0.3, scale=0.5)
    p = rng.uniform(-1, 1, (4000, 3))
    stiffer = constant(cell) / field(np.zeros((4000, 6)), p)
    assert stiffer.min() >= 0.7 - 1e-12
    assert stiffer.max() <= 1.3 + 1e-12
    assert (stiffer.std(axis=0) > 0.05).all()
    step = np.abs(field(np.zeros((4000, 6)), p + np.array([0.01, 0, 0])) / field(np.zeros((4000, 6)), p) - 1)
    assert step.max() < 0.05  # a distance of 1 cm in a field that varies over 50 cm
    with pytest.raises(ValueError, match="no rest"):
        TrueArm(*_tiny_arm(cell), 1e4 * constant(cell)).rest(cell.home[None], np.array([[0, 0, -5000.0, 0, 0, 0]]))


def _tiny_arm(cell: Cell) -> tuple[Robot, np.ndarray]:
    return load_robot(cell), cell.tool.T_flange_tcp


# ---------------------------------------------------------------------------------------------------- prediction


@pytest.mark.parametrize("weight", [False, True])
def test_prediction_equals_the_simulated_arm(cell: Cell, robot: Robot, masses: RobotMasses, weight: bool) -> None:
    """The prediction uses Newton's method on joint angles;
    the reference is a chain of bodies iterated to equilibrium."""
    e, c = soft_test(cell, robot, masses if weight else None)
    assert np.abs(e.measured[:, :3]).max() > 0.01  # deflections of centimetres: a small-angle approximation would fail
    predicted, _ = LoadedEquilibriumModel(e, robot, cell.tool.T_flange_tcp, masses if weight else None).predict(c)
    np.testing.assert_allclose(predicted, e.measured, atol=1e-11)  # tolerance: rounding of 3 m in two iterations


def test_sensitivities_agree_with_finite_differences(cell: Cell, robot: Robot, masses: RobotMasses) -> None:
    e, c = soft_test(cell, robot, masses)
    eq = LoadedEquilibriumModel(e, robot, cell.tool.T_flange_tcp, masses)
    _, S = eq.predict(c)
    for j in range(6):
        h = 1e-3 * c[j] * np.eye(6)[j]
        slope = (eq.predict(c + h)[0] - eq.predict(c - h)[0]) / (2 * h[j])
        # tolerance from third derivatives: about (1 % of 1 %)² of the sensitivity
        np.testing.assert_allclose(slope, S[..., j], atol=1e-7 * np.abs(S[..., j]).max())


def test_rigid_joint_is_allowed(cell: Cell, robot: Robot) -> None:
    e, c = soft_test(cell, robot, None)
    d, S = LoadedEquilibriumModel(e, robot, cell.tool.T_flange_tcp).predict(np.where(np.arange(6) == 3, 0.0, c))
    assert np.isfinite(d).all()
    assert np.abs(S[..., 3]).max() > 0


# ------------------------------------------------------------------------------------------------------------ fit


def test_equilibrium_fit_finds_the_truth_where_the_linear_fit_is_biased(
    cell: Cell, robot: Robot, masses: RobotMasses
) -> None:
    e, c = soft_test(cell, robot, masses)
    linear = fit_unweighted_compliances(e)
    assert np.abs(linear / c - 1).max() > 0.1  # the linear fit has errors of tens of percent at the soft joints
    found = refine_at_equilibrium(LoadedEquilibriumModel(e, robot, cell.tool.T_flange_tcp, masses), linear)
    # data without noise: only the convergence tolerance remains
    np.testing.assert_allclose(found.compliance, c, rtol=1e-8)
    assert found.rounds <= 5  # Gauss–Newton converges quadratically because the residuals vanish at the solution
    assert found.influence.max() > 0.1


def test_neglected_weight_biases_the_fit(cell: Cell, robot: Robot, masses: RobotMasses) -> None:
    """1.8 t of links and tool on springs: K_C from the load alone is not sufficient."""
    e, c = soft_test(cell, robot, masses, soft=1.0)
    T = cell.tool.T_flange_tcp
    start = fit_unweighted_compliances(e)
    without = refine_at_equilibrium(LoadedEquilibriumModel(e, robot, T), start).compliance / c - 1
    with_weight = refine_at_equilibrium(LoadedEquilibriumModel(e, robot, T, masses), start).compliance / c - 1
    assert np.abs(without).max() > 0.005
    assert np.abs(with_weight).max() < 1e-8


def test_weighted_robust_fit_works_at_the_equilibrium(cell: Cell, robot: Robot, masses: RobotMasses) -> None:
    """Same noise and same method as in the linear fit; only the equations differ."""
    e, c = soft_test(cell, robot, masses, noise=Noise())
    linear = fit_stiffness(e)
    found = refine_at_equilibrium(
        LoadedEquilibriumModel(e, robot, cell.tool.T_flange_tcp, masses),
        linear.compliance,
        lambda at: fit_stiffness(at).compliance,
    )
    assert np.abs(linear.compliance / c - 1).max() > 0.05
    assert np.abs(found.compliance / c - 1).max() < 0.02  # noise of 35 µm and 0.75 % of the force, deflections of 10 mm
    one = found.linear.select_readings(np.arange(len(e)) < 8)
    assert one.response().shape == (8, 6, 6)
    np.testing.assert_array_equal(one.response(), found.linear.response()[:8])


def test_small_loads_give_the_linear_result(cell: Cell, robot: Robot) -> None:
    """The difference is proportional to the load, so K_C and finite rotations alone cause it."""
    rng = np.random.default_rng(5)
    T, c = cell.tool.T_flange_tcp, constant(cell)
    q, loads = poses(cell, robot, rng), random_loads(rng, 30, 4, 1000, 200)
    off = []
    for share in (1.0, 0.1, 0.01):
        e = build_load_test_experiment(
            record(TrueArm(robot, T, c), q, share * loads, rng, noise=Noise.none()).recording, robot, T
        )
        linear = fit_unweighted_compliances(e)
        found = refine_at_equilibrium(LoadedEquilibriumModel(e, robot, T), linear)
        off.append(np.abs(linear / found.compliance - 1).max())
    assert off[0] < 0.01
    np.testing.assert_allclose(np.array(off[:-1]) / np.array(off[1:]), 10.0, rtol=0.1)


def test_terms_beside_the_joints_remain_linear(cell: Cell, robot: Robot) -> None:
    e, c = soft_test(cell, robot, None)
    T = cell.tool.T_flange_tcp
    base = build_fitted_term("base_compliance", "base", robot, T)
    at = LoadedEquilibriumModel(e, robot, T).linearise(c)
    np.testing.assert_array_equal(at.response([base])[..., 6:], e.response([base])[..., 6:])
    # at the true values the linearised readings equal the product of sensitivities and compliances
    np.testing.assert_allclose(at.response() @ c, at.measured, atol=1e-11)


def test_size_of_the_load_effect_on_the_kr240() -> None:
    """dumas2011 section 3.2 gives ν_p ≤ 0.016 for the wrench [0, 0, −2000 N, 200, 200 N·m, 0], wrist at 45°.

    Over the ranges of joints 2 and 3 (every 5°): ν_p is 0.0159 by its linear formula and 0.0154 at the computed
    equilibrium. The weight of the links, which the paper omits, changes a displacement by up to 0.086, median 0.022
    (the masses in the URDF are our estimate).
    """
    cell = load_cell(CELLS / "kr240_drilling")
    assert cell.stiffness is not None
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    q2, q3 = np.meshgrid(np.radians(np.arange(-140, -5, 5)), np.radians(np.arange(-100, 140, 5)))
    q = np.stack([np.zeros(q2.size), q2.ravel(), q3.ravel(), *[np.full(q2.size, np.pi / 4)] * 3], axis=1)
    w = np.tile([0, 0, -2000.0, 200, 200, 0], (len(q), 1))
    state, zero, number = robot.compute_state(q, T, bodies=True), np.zeros(len(q), int), np.arange(len(q))
    e = LoadTestExperiment(
        source="joint space",
        state=state,
        T_base_tcp=state.T_base_tool,
        wrench=w,
        measured=np.zeros((len(q), 6)),
        pose=number,
        cycle=number,
        session=zero,
        line=zero,
    )
    k = np.broadcast_to(cell.stiffness.joints, q.shape)
    nu = compute_geometric_influence(state.J, k, compute_geometric_stiffness(state.J, w), w).nu_p
    settled = compute_nonlinear_share(LoadedEquilibriumModel(e, robot, T), 1 / cell.stiffness.joints)
    weighed = compute_nonlinear_share(LoadedEquilibriumModel(e, robot, T, load_masses(cell)), 1 / cell.stiffness.joints)
    assert nu.max() == pytest.approx(0.0159, abs=2e-4)  # the paper's value to its printed digit
    assert settled.max() == pytest.approx(0.0154, abs=2e-4)
    assert settled.max() < weighed.max() < 0.1


def test_springs_without_an_equilibrium_are_named(cell: Cell, robot: Robot) -> None:
    e, c = soft_test(cell, robot, None)
    with pytest.raises(InputError, match=r"do not hold the load of the reading on line \d+"):
        LoadedEquilibriumModel(e, robot, cell.tool.T_flange_tcp).predict(1e4 * c)
