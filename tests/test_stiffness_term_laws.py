"""Stiffness terms written by diagnose, in the planner: each law compared with an independent computation.

The reference does not use the Jacobian or gravity of machopt: torques come from pinocchio, displacements from rotating
one joint of the arm by the angle of the law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from test_cli import changed_cell, optimize, result

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness, StiffnessGrid, StiffnessTerm
from machopt.effects import registry
from machopt.effects.joint import gravity_compensator as joint_gravity_compensator
from machopt.errors import InputError
from machopt.kinematics.robot import GRAVITY
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import gravity_compensator, joint_torque, structural_compliance
from machopt.options.plan_option_reader import load_options
from machopt.planning.pipeline.planning_setup import prepare_planning
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import build_fitted_term, compile_terms, list_effects_and_locations

ROOT = Path(__file__).resolve().parent.parent
CELL = load_cell(ROOT / "cells" / "kr240_drilling")
ROBOT, TOOL, MASSES = load_robot(CELL), CELL.tool.T_flange_tcp, load_masses(CELL)
assert CELL.stiffness is not None
K = CELL.stiffness.joints
C = 1.0 / K
ARCMIN = np.pi / 180 / 60
LAWS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "knee": (
        "joint_nonlinear_stiffness",
        "joint:3",
        {"law": "knee", "extra_rad_per_Nm": 0.4 * C[2], "knee_Nm": 2000.0},
    ),
    "harder below the knee": (
        "joint_nonlinear_stiffness",
        "joint:2",
        {"law": "knee", "extra_rad_per_Nm": -0.3 * C[1], "knee_Nm": 1500.0},
    ),
    "knees": (
        "joint_nonlinear_stiffness",
        "joint:5",
        {"law": "knees", "extra_rad_per_Nm": [0.5 * C[4], 0.2 * C[4]], "knees_Nm": [40.0, 160.0]},
    ),
    "cubic": ("joint_nonlinear_stiffness", "joint:3", {"law": "cubic", "cubic_rad_per_Nm3": -1e-8 * C[2]}),
    "softening cubic": ("joint_nonlinear_stiffness", "joint:4", {"law": "cubic", "cubic_rad_per_Nm3": 2e-6 * C[3]}),
    "backlash": ("joint_backlash", "joint:5", {"width_arcmin": 0.6, "transition_Nm": 30.0}),
    "hysteresis": (
        "joint_hysteresis",
        "joint:2",
        {"law": "play", "weights_rad_per_Nm": [0.3 * C[1], 0.2 * C[1]], "thresholds_Nm": [80.0, 400.0]},
    ),
    "creep": ("joint_creep", "joint:3", {"extra_rad_per_Nm": 0.1 * C[2], "time_constant_s": 20.0}),
    "harmonics": (
        "joint_pose_dependent_stiffness",
        "joint:2",
        {
            "cos_rad_per_Nm": 0.1 * C[1],
            "sin_rad_per_Nm": -0.2 * C[1],
            "cos2_rad_per_Nm": 0.15 * C[1],
            "sin2_rad_per_Nm": 0.1 * C[1],
        },
    ),
    "sector": (
        "joint_pose_dependent_stiffness",
        "joint:3",
        {"law": "sector", "extra_rad_per_Nm": 0.5 * C[2], "centre_deg": 100.0, "width_deg": 15.0},
    ),
    "compensator": (
        "gravity_compensator",
        "joint:2",
        {"force_times_length_Nm": -3e5, "rate_times_length2_Nm": 6e4, "ratio": 0.35, "angle_deg": 40.0},
    ),
}


def elasticity(*terms: StiffnessTerm, weight: bool = True, k: np.ndarray = K, **more: Any) -> ArmElasticity:
    limits = CELL.limits.lower[:6], CELL.limits.upper[:6]
    return ArmElasticity(ROBOT, TOOL, ArmStiffness(joints=k, terms=terms, **more), limits, MASSES if weight else None)


def postures(n: int = 6, seed: int = 0) -> np.ndarray:
    spread = np.radians([40, 20, 20, 50, 30, 60])
    return np.radians([0, -90, 100, 0, 60, 0]) + np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * spread


def wrenches(n: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-900, 900, (n, 3)), rng.uniform(-150, 150, (n, 3))], axis=1)


# --- by pinocchio -------------------------------------------------------------------------------------------


def _model() -> tuple[Any, int]:
    model = pin.buildModelFromUrdf(str(CELL.urdf))
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    flange = model.frames[model.getFrameId(CELL.flange_link)]
    payload = pin.Inertia(CELL.tool.mass, np.array(CELL.tool.com), np.zeros((3, 3)))
    model.inertias[6] = model.inertias[6] + flange.placement.act(payload)
    tcp = model.addFrame(pin.Frame("tcp", 6, 0, flange.placement * pin.SE3(TOOL), pin.FrameType.OP_FRAME))
    return model, tcp


MODEL, TCP = _model()


def weight_torque(q: np.ndarray) -> np.ndarray:
    """Return (6,) the joint torques of the weight."""
    return -pin.computeGeneralizedGravity(MODEL, MODEL.createData(), q)


def load_torque(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    J = pin.computeFrameJacobian(MODEL, MODEL.createData(), q, TCP, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return np.asarray(J.T @ w)


def compute_joint_twist(q: np.ndarray, j: int, angle: float) -> np.ndarray:
    """Return (6,) the twist of the TCP for a small rotation of joint j, to first order, by central differences."""
    step, places = 1e-5, []
    for sign in (1.0, -1.0):
        data, there = MODEL.createData(), q.copy()
        there[j] += sign * step
        pin.framesForwardKinematics(MODEL, data, there)
        places.append(data.oMf[TCP])
    shift = places[0].translation - places[1].translation
    turn = pin.log3(places[0].rotation @ places[1].rotation.T)
    return np.concatenate([shift, turn]) * angle / (2 * step)


# --- scalar implementation of each law --------------------------------------------------------------------------


def _step_play_operator(tau: float, threshold: float) -> float:
    """Return the output of a play operator for a torque that increases to τ in small steps."""
    state = 0.0
    for value in np.linspace(0.0, tau, 400):
        state = min(max(state, value - threshold), value + threshold)
    return state


def _crept(tau: float, constant: float) -> float:
    """Integrate T ẋ + x = τ over thirty time constants by the implicit midpoint rule."""
    x, dt = 0.0, constant / 20.0
    for _ in range(600):
        x += dt / constant * (tau - x) / (1.0 + 0.5 * dt / constant)
    return x


def _spring_energy(q2: float, p: dict[str, Any]) -> float:
    """Return F₀ s + ½ k s² of a spring between pivots at 1 and at a/L, as a function of joint 2."""
    angle = q2 + np.radians(p["angle_deg"])
    s = float(np.hypot(1.0 + p["ratio"] * np.cos(angle), p["ratio"] * np.sin(angle)))
    return float(p["force_times_length_Nm"] * s + 0.5 * p["rate_times_length2_Nm"] * s**2)


def _extra(name: str, j: int, q: np.ndarray, w: np.ndarray) -> float:
    """Return the additional rotation of joint j in rad under the wrench; the weight acts before and after."""
    p, tau, g = LAWS[name][2], load_torque(q, w)[j], weight_torque(q)[j]

    def counted(law: Callable[[float], float]) -> float:
        return law(g + tau) - law(g)

    def clip(value: float, t: float) -> float:
        return max(-t, min(t, value))

    if "knee_Nm" in p:
        return counted(lambda t: p["extra_rad_per_Nm"] * clip(t, p["knee_Nm"]))
    if "knees_Nm" in p:
        pairs = list(zip(p["extra_rad_per_Nm"], p["knees_Nm"], strict=True))
        return counted(lambda t: sum(a * clip(t, knee) for a, knee in pairs))
    if "cubic_rad_per_Nm3" in p:
        return counted(lambda t: p["cubic_rad_per_Nm3"] * t**3)
    if name == "backlash":
        return counted(lambda t: 0.5 * p["width_arcmin"] * ARCMIN * clip(t / p["transition_Nm"], 1.0))
    if name == "hysteresis":
        pairs = list(zip(p["weights_rad_per_Nm"], p["thresholds_Nm"], strict=True))
        return sum(a * _step_play_operator(tau, r) for a, r in pairs)
    if name == "creep":
        return float(p["extra_rad_per_Nm"] * _crept(tau, p["time_constant_s"]))
    if name == "harmonics":
        waves = (np.cos(q[j]), np.sin(q[j]), np.cos(2 * q[j]), np.sin(2 * q[j]))
        return float(tau * sum(a * wave for a, wave in zip(p.values(), waves, strict=True)))
    if name == "sector":
        away = (np.degrees(q[j]) - p["centre_deg"]) / p["width_deg"]
        return float(p["extra_rad_per_Nm"] * np.exp(-(away**2) / 2) * tau)
    assert name == "compensator"
    step = 1e-4  # the second difference of the energy is the stiffness of the spring about joint 2
    bend = (_spring_energy(q[1] + step, p) - 2 * _spring_energy(q[1], p) + _spring_energy(q[1] - step, p)) / step**2
    return float(tau / (K[1] + bend) - tau / K[1])


@pytest.mark.parametrize("name", LAWS)
def test_each_law_against_an_independent_computation(name: str) -> None:
    """The difference of the twists with and without the term equals the independent value.

    Tolerance 1e-6: errors of the second difference and of forward kinematics; the rest is exact.
    """
    term = StiffnessTerm(*LAWS[name])
    q, w = postures(), wrenches(6)
    j = int(term.location.removeprefix("joint:")) - 1
    more = elasticity(term).evaluate(q).compute_twist(w) - elasticity().evaluate(q).compute_twist(w)
    expected = np.array([compute_joint_twist(a, j, _extra(name, j, a, b)) for a, b in zip(q, w, strict=True)])
    size = np.abs(expected[:, :3]).max()
    assert size > 2e-6  # m: the term has an effect in each case
    np.testing.assert_allclose(more, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(
        elasticity(term).evaluate(q).compute_deflection(w[:, :3])[0],
        elasticity(term).evaluate(q).compute_twist(w * [1, 1, 1, 0, 0, 0])[0, :3],
        rtol=1e-12,
    )


def test_weight_shifts_the_operating_point_of_a_law() -> None:
    """The same force with and without weight, for laws of the total torque; play and creep do not depend on weight."""
    q, w = postures(), wrenches(6)
    for name, (effect, location, parameters) in LAWS.items():
        term = StiffnessTerm(effect, location, parameters)
        known, unknown = elasticity(term), elasticity(term, weight=False)
        depends = effect in ("joint_nonlinear_stiffness", "joint_backlash")
        same = np.allclose(known.evaluate(q).compute_twist(w), unknown.evaluate(q).compute_twist(w), rtol=1e-12, atol=0)
        assert same != depends, name
        assert not known.warnings
        assert bool(unknown.warnings) == depends, name
        assert all(effect in text and "counts as zero" in text for text in unknown.warnings)
    bare = replace(MASSES, body=MASSES.body[-1:], mass=MASSES.mass[-1:], com=MASSES.com[-1:])  # the tool alone
    stiffness = ArmStiffness(joints=K, terms=(StiffnessTerm(*LAWS["backlash"]),))
    assert ArmElasticity(ROBOT, TOOL, stiffness, None, bare).warnings


def test_small_load_gives_the_tangent_under_weight() -> None:
    """compliance() equals differences of respond() at zero load; for play, the slope after the play is taken up."""
    q = postures(4, seed=3)
    for name, case in LAWS.items():
        term = StiffnessTerm(*case)
        elastic = elasticity(term).evaluate(q)
        found = elastic.compute_compliance()
        if name == "hysteresis":
            soft = np.array(C)
            soft[1] += sum(case[2]["weights_rad_per_Nm"])
            J = elastic.state.J
            expected = np.einsum("mci,i,mdi->mcd", J, soft, J)
        else:
            step = 1e-2  # N, N·m: far from the corners of the curves, which no configuration reaches here
            each = [
                (elastic.compute_twist(np.tile(step * e, (4, 1))) - elastic.compute_twist(np.tile(-step * e, (4, 1))))
                for e in np.eye(6)
            ]
            expected = np.stack(each, axis=-1) / (2 * step)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max(), err_msg=name)
        e = np.array([0.0, 0.6, 0.8])
        np.testing.assert_allclose(
            elastic.compute_compliance_along(np.tile(e, (4, 1))), e @ found[:, :3, :3] @ e, rtol=1e-9
        )
        assert np.isfinite(elastic.compute_jiao_index(np.tile(e, (4, 1)))).all()


# --- the fitted law of diagnose equals that of the planner ------------------------------------------------------


def _readings() -> StaticReadings:
    """Return two increasing load cycles per pose with one hour between states, including unloaded ones.

    Slow effects have reached their final value.
    """
    n, poses = 8, 10
    q = np.repeat(postures(poses, seed=5), n, axis=0)
    direction = np.repeat(wrenches(2 * poses, seed=6), n // 2, axis=0)
    w = direction * np.tile(np.linspace(0.25, 1.0, n // 2), 2 * poses)[:, None]
    pose, cycle = np.repeat(np.arange(poses), n), np.repeat(np.arange(2 * poses), n // 2)
    rows, zero = np.arange(n * poses), np.zeros(n * poses, np.int64)
    recording = Recording(
        kind="deflection",
        source="made up",
        q=q,
        pose=pose,
        cycle=cycle,
        session=zero,
        line=rows,
        wrench=w,
        time=3600.0 * (rows + cycle),
    )
    state = ROBOT.compute_state(q, TOOL, bodies=True)
    return StaticReadings(
        recording=recording,
        robot=ROBOT,
        T_flange_tcp=TOOL,
        masses=MASSES,
        state=state,
        wrench=w,
        dimensions=6,
        is_difference=True,
        compliance=np.array(C),
        session=zero,
        visit=pose,
        cycle=cycle,
    )


def _hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    out = [
        *gravity_compensator.build_load_test_hypotheses(r),
        *joint_torque.build_load_test_couplings(r),
        *structural_compliance.build_structure_hypotheses(r),
    ]
    for j in range(6):
        for effect in registry.select_joint_torque_effects():
            out += joint_torque.build_joint_hypotheses(r, j, effect)[0]
    return out


def test_every_elastic_law_of_diagnose_is_a_term_with_equal_predictions(tmp_path: Path) -> None:
    """With the written file, column · coefficient of the hypothesis equals the twist
    that the term adds in the planner."""
    r = _readings()
    observed = set()
    for h in _hypotheses(r):
        shape = h.shapes[0]  # with memory, each cycle begins relaxed or has reached its final value by the time
        columns = h.columns(shape)
        unit = np.abs(columns[:, :3]).max(axis=(0, 1))
        x = 2e-5 / np.where(unit > 0, unit, np.inf)  # m: each column moves the TCP by this distance
        x = x / len(x) if h.effect != "gravity_compensator" else 0.01 * x
        if h.law.startswith("round") or h.law.startswith("bends about"):
            x[2] = 0.0  # the coupling term may have either sign; without it the matrix is positive
        if h.law == "tilts and sinks":
            x[[1, 2, 4]] *= 0.1  # coupling of sinking and tilt: no plate has all of it at its maximum
        term = h.correction(x, shape)
        assert isinstance(term, StiffnessTerm), h.name
        assert term.location in list_effects_and_locations()[term.effect]
        file = tmp_path / "stiffness.yaml"
        write_stiffness(file, ArmStiffness(joints=np.array(K), terms=(term,)))
        read = load_stiffness(file)
        model = ArmElasticity(ROBOT, TOOL, read, None, MASSES)
        more = model.evaluate(r.state.q).compute_twist(r.wrench) - elasticity().evaluate(r.state.q).compute_twist(
            r.wrench
        )
        predicted = columns @ x
        # minus the motion of the spring without any load; the weight causes a motion, too
        if h.effect == "gravity_compensator":
            bend = joint_gravity_compensator.LINKAGE.slope(np.array(shape), r.state.q[:, 1])
            predicted = r.lift_joint_twist(1, C[1] ** 2 * r.load_torque[:, 1, None] * bend) @ x
        # a compensator is fitted to first order in its ratio to the stiffness of joint 2, here below 1e-3
        tolerance = 1e-3 if h.effect == "gravity_compensator" else 1e-6
        size = np.abs(predicted).max(axis=0)
        assert (np.abs(more - predicted) < tolerance * size + 1e-15).all(), f"{h.name} {h.law}"
        again = model.terms[0].to_file()
        assert (again.effect, again.location) == (term.effect, term.location)
        assert set(term.parameters) <= set(again.parameters)
        observed.add(h.effect)
    elastic = set(list_effects_and_locations()) - {"geometric_stiffness"}
    assert observed == elastic


# --- refused terms ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "location", "parameters", "message", "where"),
    [
        ("joint_nonlinear_stiffness", "joint:1", {"knee_Nm": 3.0}, "is missing; valid: knee, knees, cubic", ".law"),
        ("joint_nonlinear_stiffness", "joint:1", {"law": "kne"}, "found 'kne'; valid: knee, knees, cubic", ".law"),
        (
            "joint_nonlinear_stiffness",
            "joint:1",
            {"law": "knee", "knees_Nm": [1.0]},
            "did you mean 'knee_Nm'",
            "knees_Nm",
        ),
        (
            "joint_nonlinear_stiffness",
            "joint:1",
            {"law": "knee", "knee_Nm": -1.0},
            "expected more than zero",
            "knee_Nm",
        ),
        (
            "joint_nonlinear_stiffness",
            "joint:1",
            {"law": "knees", "extra_rad_per_Nm": [1.0], "knees_Nm": [1.0, 2.0]},
            "found 1 numbers; expected 2",
            "extra_rad_per_Nm",
        ),
        (
            "joint_nonlinear_stiffness",
            "joint:1",
            {"law": "knees", "extra_rad_per_Nm": 1.0, "knees_Nm": [1.0]},
            "found 1.0; expected a list of numbers",
            "extra_rad_per_Nm",
        ),
        ("joint_backlash", "joint:2", {"width_arcmin": -0.1, "transition_Nm": 3.0}, "at least zero", "width_arcmin"),
        ("joint_backlash", "joint:7", {}, "cannot be at 'joint:7'", "terms[0].location"),
        (
            "joint_hysteresis",
            "joint:2",
            {"weights_rad_per_Nm": [-1e-7], "thresholds_Nm": [3.0]},
            "found -1e-07",
            "weights_rad_per_Nm[0]",
        ),
        (
            "joint_hysteresis",
            "joint:2",
            {"weights_rad_per_Nm": [1e-7], "thresholds_Nm": [0.0]},
            "torques above zero",
            "thresholds_Nm",
        ),
        ("joint_hysteresis", "joint:2", {"law": "bouc-wen"}, "valid: play", ".law"),
        ("joint_creep", "joint:2", {"extra_rad_per_Nm": -1e-9}, "at least zero", "extra_rad_per_Nm"),
        ("joint_creep", "joint:2", {"time_constant_s": 0}, "more than zero", "time_constant_s"),
        ("joint_pose_dependent_stiffness", "joint:2", {"law": "sector"}, "centre_deg is needed", "centre_deg"),
        ("joint_pose_dependent_stiffness", "joint:2", {"cos3_rad_per_Nm": 1.0}, "valid: cos", "cos3_rad_per_Nm"),
        ("gravity_compensator", "joint:3", {}, "cannot be at 'joint:3'; valid: joint:2", "location"),
        ("gravity_compensator", "joint:2", {"ratio": 1.0}, "the pivots meet", "ratio"),
    ],
)
def test_invalid_terms_are_reported_with_their_place(
    effect: str, location: str, parameters: dict[str, Any], message: str, where: str
) -> None:
    with pytest.raises(InputError) as caught:
        compile_terms((StiffnessTerm(effect, location, parameters),), ROBOT, TOOL, Path("stiffness.yaml"))
    assert message in str(caught.value)
    assert where in str(caught.value)
    assert "stiffness.yaml" in str(caught.value)


@pytest.mark.parametrize("name", LAWS)
def test_law_without_its_parameters_is_refused_by_planner_and_fit(name: str) -> None:
    effect, location, parameters = LAWS[name]
    for key in parameters:
        if key in ("law", "time_constant_s", "sin2_rad_per_Nm", "centre_deg", "width_deg"):
            continue  # keys with a default, or required when the file is read
        lacking = {k: v for k, v in parameters.items() if k != key}
        with pytest.raises(InputError, match=f"lacks values for {key.removesuffix('_arcmin')}"):
            elasticity(StiffnessTerm(effect, location, lacking))
    if name in ("knee", "backlash", "hysteresis", "compensator"):  # identify requests the term itself
        state = ROBOT.compute_state(postures(1), TOOL, bodies=True)
        with pytest.raises(InputError, match="machopt diagnose"):
            build_fitted_term(effect, location, ROBOT, TOOL).compute_response(state, wrenches(1))


def test_springs_with_negative_stiffness_are_refused() -> None:
    def joint(effect: str, n: int, **parameters: Any) -> StiffnessTerm:
        return StiffnessTerm(effect, f"joint:{n}", parameters)

    knee = joint("joint_nonlinear_stiffness", 3, law="knee", extra_rad_per_Nm=-1.01 * C[2], knee_Nm=300.0)
    with pytest.raises(InputError, match=r"joint_nonlinear_stiffness takes .* from joint 3, which has"):
        elasticity(knee)
    knees = {"law": "knees", "extra_rad_per_Nm": [0.5 * C[2], -0.8 * C[2]], "knees_Nm": [100.0, 300.0]}
    elasticity(joint("joint_nonlinear_stiffness", 3, **knees))  # −0.8 beyond the first knee, −0.3 below it
    swapped = {**knees, "knees_Nm": [300.0, 100.0]}  # −0.3 below the first knee, +0.5 to the second
    elasticity(joint("joint_nonlinear_stiffness", 3, **swapped))
    together = joint(
        "joint_pose_dependent_stiffness", 3, law="sector", extra_rad_per_Nm=-0.3 * C[2], centre_deg=90.0, width_deg=10.0
    )
    with pytest.raises(InputError, match="with the joint's other terms"):
        elasticity(joint("joint_nonlinear_stiffness", 3, **knees), together)
    second = joint(
        "joint_pose_dependent_stiffness",
        2,
        cos_rad_per_Nm=0.0,
        sin_rad_per_Nm=0.0,
        cos2_rad_per_Nm=1.05 * C[1],
        sin2_rad_per_Nm=0.0,
    )
    with pytest.raises(InputError, match=r"takes .* from joint 2 at -90 deg"):
        elasticity(second)
    effect, location, p = LAWS["compensator"]
    with pytest.raises(InputError, match="gravity_compensator takes up to"):
        elasticity(StiffnessTerm(effect, location, {**p, "force_times_length_Nm": 2e6}))


def test_hardening_cubic_remains_a_spring_beyond_its_range() -> None:
    """Torque and twist increase together at any load, and the slope is never below a tenth of the joint's own."""
    term = StiffnessTerm("joint_nonlinear_stiffness", "joint:1", {"law": "cubic", "cubic_rad_per_Nm3": -1e-6 * C[0]})
    model = elasticity(term)
    size = np.linspace(0.0, 5e3, 400)
    q = np.tile(np.radians([0, -90, 90, 0, 90, 0]), (len(size), 1))
    side = np.zeros((len(size), 6))
    side[:, 1] = size  # N perpendicular to the arm
    elastic = model.evaluate(q)
    tau = np.einsum("mci,mc->mi", elastic.state.J, side)[:, 0]
    plain = elasticity().evaluate(q).compute_twist(side)
    own = (elastic.compute_twist(side) - plain)[:, 5] / elastic.state.J[:, 5, 0] + C[0] * tau  # twist of joint 1
    slope = np.diff(own) / np.diff(tau)
    assert slope.max() == pytest.approx(C[0], rel=1e-3)
    assert slope.min() == pytest.approx(0.1 * C[0], rel=1e-6)
    cubic = C[0] * tau - 1e-6 * C[0] * tau**3
    near = np.abs(tau) < np.sqrt(0.9 / 3e-6)
    np.testing.assert_allclose(own[near], cubic[near], rtol=1e-9, atol=1e-18)
    assert 20 < near.sum() < len(near) - 20


def test_compensator_enters_every_use_of_joint_stiffness() -> None:
    """Grid, Jacobian, sensitivity to the compliance of the gear, and the spring itself:
    all compared with differences."""
    effect, location, p = LAWS["compensator"]
    term, q, w = StiffnessTerm(effect, location, p), postures(5), wrenches(5)
    grid = StiffnessGrid(np.array([0.5, -1.5, -0.5]), 1.5, (2, 2, 2), K * np.linspace(0.7, 1.3, 8)[:, None])
    model = elasticity(term, grid=grid)
    elastic, plain = model.evaluate(q), elasticity(grid=grid).evaluate(q)
    assert len(np.unique(plain.k[:, 1])) > 1  # the cells differ
    np.testing.assert_allclose(model.compute_jacobian(q)[1], elastic.k, rtol=1e-12)
    more = model.terms[0].compute_response(elastic.state, w) @ model.terms[0].values
    np.testing.assert_allclose(elastic.compute_twist(w) - plain.compute_twist(w), more, rtol=1e-9, atol=1e-12)
    e, step = np.tile([0.0, 0.6, 0.8], (5, 1)), 1e-4
    for j in range(6):
        ends = []
        for sign in (1.0, -1.0):
            k = K / (1.0 + sign * step * (np.arange(6) == j))
            ends.append(elasticity(term, k=k).evaluate(q))
        along = (ends[0].compute_compliance_along(e) - ends[1].compute_compliance_along(e)) / (2 * step * C[j])
        jiao = (1 / ends[0].compute_jiao_index(e) - 1 / ends[1].compute_jiao_index(e)) / (2 * step * C[j])
        here = elasticity(term).evaluate(q)
        np.testing.assert_allclose(here.compute_sensitivity(e, e, small=True)[:, j], along, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(here.compute_jiao_sensitivity(e)[:, j], jiao, rtol=1e-4, atol=1e-7)


# --- in the planner -----------------------------------------------------------------------------------------


def test_batch_of_candidates_equals_single_ones() -> None:
    names = ("knee", "backlash", "hysteresis", "creep", "harmonics", "compensator", "softening cubic", "sector")
    model = elasticity(*(StiffnessTerm(*LAWS[n]) for n in names))
    q = postures(500, seed=9)
    force = np.tile([0.0, 0.0, 250.0], (len(q), 1))
    together = model.evaluate(q).compute_deflection(force)
    alone = np.concatenate(
        [model.evaluate(q[n : n + 1]).compute_deflection(force[n : n + 1]) for n in range(0, len(q), 50)]
    )
    np.testing.assert_allclose(together[::50], alone, rtol=1e-12)  # the same sums in another order


def test_planner_uses_the_weight_of_the_cell() -> None:
    """With masses of the URDF and the tool: the same twist as with pinocchio's torques above, and no warning."""
    term, q, w = StiffnessTerm(*LAWS["backlash"]), postures(), wrenches(6)
    cell = replace(CELL, stiffness=ArmStiffness(joints=K, terms=(term,)))
    model = prepare_planning(cell, load_options(CELL.plan, None, ["collision=false"])).elasticity
    assert not model.warnings
    np.testing.assert_allclose(
        model.evaluate(q).compute_twist(w), elasticity(term).evaluate(q).compute_twist(w), rtol=1e-12
    )


def test_optimize_applies_the_laws_and_predicts_more_deflection(tmp_path: Path) -> None:
    """Every term softens the arm: the command predicts a larger deflection at every point for the same rotation."""
    names = ("knees", "softening cubic", "hysteresis", "creep", "sector")
    toolpath = tmp_path / "holes.csv"
    rows = [
        f"{40 * k},{60 * (k % 2)},{z},0,0,1,{move},{feed},drill"
        for k in range(3)
        for z, move, feed in ((60, "rapid", ""), (10, "approach", 900), (-5, "cut", 300), (30, "retract", 900))
    ]
    toolpath.write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(rows) + "\n")
    worst = {}
    for case in ("plain", "laws"):
        folder = changed_cell(tmp_path / case, base=ROOT / "cells" / "kr240_drilling")
        if case == "laws":
            stiffness = load_stiffness(folder / "stiffness.yaml")
            write_stiffness(
                folder / "stiffness.yaml", replace(stiffness, terms=tuple(StiffnessTerm(*LAWS[n]) for n in names))
            )
        assert (
            optimize(
                folder, toolpath, tmp_path / case / "out", "--set", "rotation_step_deg=20", "--set", "collision=false"
            )
            == 0
        )
        worst[case] = result(tmp_path / case / "out")["worst_point"]["deflection_mm"]
    assert 1.05 * worst["plain"] < worst["laws"] < 2.5 * worst["plain"]
