"""Simulator of benchmarks/diagnosis_chain_benchmark: physics against closed forms, files against the reader, score.

The simulator serves to test machopt's models, so it is not compared with them here.
"""

from __future__ import annotations

import ast
import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.measurement.recording import load_recording

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks" / "diagnosis_chain_benchmark"))

import case_list
import generate_cases
import score_diagnoses
from simulator import motion_simulation
from simulator.arm_model import Beam, Nominal, Plate, add_beam, arm_of, read_nominal, tip_softness
from simulator.case_simulation import Part, Scene
from simulator.gear_effects import loop_width
from simulator.gear_torque_laws import Balancer, BoucWen, Clearance, Creeping, Law, Pins, Spring, iwan
from simulator.serial_chain import Chain, Loads, shift, turn_rpy
from simulator.static_equilibrium import Setting, Statics
from simulator.thermal_model import Heat

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[1]
CONCEALED, CELLS = ROOT / "benchmarks" / "diagnosis_chain_benchmark", ROOT / "cells"
ROBOTS = (*case_list.ROBOTS, case_list.ODD)
RIGID = 1e11  # N·m/rad


@pytest.fixture(scope="module")
def kr240() -> Nominal:
    return read_nominal(CELLS / "kr240_drilling")


def pinocchio_jacobian(nominal: Nominal, q: Array) -> tuple[Array, Array]:
    """Compute J (6, 6) at the TCP and the TCP position with pinocchio."""
    model = pin.buildModelFromUrdf(str(nominal.urdf))
    data = model.createData()
    frame = model.getFrameId("flange")
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED).copy()
    pin.framesForwardKinematics(model, data, q)
    tip = data.oMf[frame] * pin.SE3(nominal.tcp.R, nominal.tcp.t)
    J[:3] -= pin.skew(tip.translation - data.oMf[frame].translation) @ J[3:]
    return J, tip.translation


@pytest.mark.parametrize("name", ROBOTS)
def test_small_load_agrees_with_j_c_jt(name: str) -> None:
    nominal, rng = read_nominal(CELLS / name), np.random.default_rng(1)
    q = nominal.home + rng.uniform(-0.3, 0.3, (5, 6))
    w = rng.normal(size=(5, 6)) * [10, 10, 10, 3, 3, 3]
    statics = Statics(arm_of(nominal))
    empty = statics.settle(Setting(q, 0.0 * w, gravity=0.0))
    loaded = statics.settle(Setting(q, 1e-3 * w, gravity=0.0))
    for k in range(5):
        J, tip = pinocchio_jacobian(nominal, q[k])
        assert empty.position[k] == pytest.approx(tip, abs=1e-12)
        expected = J @ (J.T @ (1e-3 * w[k]) / nominal.stiffness)
        # displacements of at most 0.1 µm: the remainder is of second order and rounding of the positions
        assert loaded.position[k] - empty.position[k] == pytest.approx(expected[:3], abs=1e-12, rel=1e-4)


def test_gear_torques_under_weight_equal_pinocchio(kr240: Nominal) -> None:
    model = pin.buildModelFromUrdf(str(kr240.urdf))
    at = pin.SE3(kr240.flange.R, kr240.flange.t)
    tool = pin.Inertia(kr240.tool_mass, kr240.tool_com, np.zeros((3, 3)))
    model.inertias[6] = model.inertias[6] + at.act(tool)
    model.gravity.linear = np.array([0, 0, -9.80665])
    arm = arm_of(kr240)
    arm.laws = [Spring(RIGID)] * 6
    q = kr240.home + np.random.default_rng(2).uniform(-0.4, 0.4, (4, 6))
    torque = Statics(arm).settle(Setting(q, np.zeros((4, 6)))).torque
    for k in range(4):
        fixed = pin.computeGeneralizedGravity(model, model.createData(), q[k])
        assert torque[k] == pytest.approx(-fixed, abs=5e-3)  # of up to 8 kN·m; the springs deflect by 1e-7 rad


def test_curvature_of_the_potential_is_the_slope_of_the_forces() -> None:
    rng, chain = np.random.default_rng(3), Chain()
    for d in range(7):
        axis = rng.normal(size=3)
        chain.step(shift(rng.normal(size=3)))
        chain.add(bool(d % 3), axis / np.linalg.norm(axis))
        chain.weigh(10.0, rng.normal(size=3))
    x, force = rng.normal(size=(1, 7)), rng.normal(size=(1, 3)) * 100

    def forces(x: Array) -> tuple[Array, Array]:
        posture = chain.forward(x)
        loads: Loads = posture.gravity()
        loads.add(7, posture.tip()[0], force)
        return posture.generalised(loads)

    _, H = forces(x)
    h = 1e-6
    steps = h * np.eye(7)
    slope = np.stack([(forces(x + s)[0] - forces(x - s)[0])[0] / (2 * h) for s in steps], axis=1)
    # central differences of values of some hundreds: 1e-13 · 1e3 / 1e-6
    assert H[0] == pytest.approx(slope, abs=2e-4)


def test_clamped_beam_agrees_with_closed_forms() -> None:
    chain, stiff, length, EI, GJ = Chain(), {}, 1.2, 3e6, 2e6
    add_beam(chain, stiff, Beam(EI, EI, GJ), np.array([length, 0, 0]), 0.0, np.zeros(3))
    k = np.array([stiff[d] for d in range(len(chain))])
    J = chain.forward(np.zeros((1, len(chain)))).jacobian()[0]
    C = (J / k) @ J.T
    hinged = 1.0 / (4 * 10**2)  # discretization error of L³/3EI with ten pieces
    assert C[2, 2] == pytest.approx(length**3 / (3 * EI), rel=1.01 * hinged)
    assert C[2, 2] != pytest.approx(length**3 / (3 * EI), rel=0.5 * hinged)
    assert C[2, 4] == pytest.approx(-(length**2) / (2 * EI), rel=1e-12)
    assert C[4, 4] == pytest.approx(length / EI, rel=1e-12)
    assert C[3, 3] == pytest.approx(length / GJ, rel=1e-12)


def test_tapered_shank_deflects_like_the_sum_of_its_pieces() -> None:
    length, EI = 0.4, 2e4
    beam = Beam(EI, EI, 0.7 * EI, taper=0.6)
    chain, stiff = Chain(), {}
    add_beam(chain, stiff, beam, np.array([length, 0, 0]), 0.0, np.zeros(3))
    k = np.array([stiff[d] for d in range(len(chain))])
    J = chain.forward(np.zeros((1, len(chain)))).jacobian()[0]
    assert tip_softness(beam, length) == pytest.approx(((J / k) @ J.T)[1, 1], rel=1e-12)
    # stiffer at the root, where a load at the tip causes the largest bending
    assert tip_softness(beam, length) < 0.9 * length**3 / (3 * EI)


def test_hysteresis_width_follows_from_the_recorded_loads() -> None:
    """Joint 2 carries weight in the motion: the loop width follows from half the range of its torque, not from the
    largest torque."""
    case = next(c for c in case_list.cases() if c.key == "motion/joint_hysteresis.6/large")
    scene = Scene(replace(case, parts=(Part("joint_hysteresis", ("joint:2",), "large"),)), (1, 2, 3), CELLS, True)
    world, found = scene.world([1.0])
    assert scene.swing[1] == pytest.approx(0.5 * (scene.load[:, 1].max() - scene.load[:, 1].min()), rel=1e-12)
    assert scene.swing[1] < 0.9 * scene.load95[1]
    width = loop_width(world.arm.laws[1], scene.swing[1])
    assert np.radians(found[0].parameters["width"][0] / 60.0) == pytest.approx(width, rel=1e-9)


def test_plate_on_four_bolts_tilts_by_its_moment_and_opens_on_one_side() -> None:
    half, k = 0.35, 3e8
    even, loose = np.full(4, k), np.array([k, k, 0.1 * k, 0.1 * k])
    x = np.zeros((2, 6))
    x[:, 4] = [1e-4, -1e-4]  # about y: corners at −x move up, or down
    f, K = Plate(half, even, even, k).force(x)
    assert f[:, 4] == pytest.approx(4 * k * half**2 * x[:, 4], rel=1e-9)
    assert K[0, 4, 4] == pytest.approx(4 * k * half**2, rel=1e-9)
    f, _ = Plate(half, even, loose, k).force(x)
    assert f[0, 4] == pytest.approx(2.2 * k * half**2 * 1e-4, rel=1e-6)  # the two corners that move up are loose
    assert f[1, 4] == pytest.approx(-4 * k * half**2 * 1e-4, rel=1e-6)


def test_backlash_shows_only_without_preload_by_weight(kr240: Nominal) -> None:
    arm = arm_of(kr240)
    plain = Statics(arm_of(kr240))
    b = 3e-4
    arm.laws[2] = Clearance(kr240.stiffness[2], b, 0.01)
    statics = Statics(arm)
    q = np.repeat(kr240.home[None], 2, axis=0)
    w = np.zeros((2, 6))
    w[:, 2] = [150.0, -150.0]

    def twist(gravity: float, which: Statics) -> float:
        x = which.settle(Setting(q, w, gravity=gravity)).x
        return float(abs(x[0, 2] - x[1, 2]))

    # seal drag inside the gap: 1 % of k
    assert twist(0.0, statics) - twist(0.0, plain) == pytest.approx(2 * b, rel=0.02)
    # weight keeps one flank in contact: the contact roughness and K_C of another posture remain
    assert abs(twist(1.0, statics) - twist(1.0, plain)) < 0.01 * 2 * b


@pytest.mark.parametrize("law", [iwan(1e6, 0.7, 4e-4), BoucWen(1e6, 80.0, 1e-4)], ids=["iwan", "bouc-wen"])
def test_dry_friction_hysteresis_is_rate_independent(law: Law) -> None:
    def area(steps: int, seconds: float) -> float:
        path = 5e-4 * np.sin(np.linspace(0, 4 * np.pi, 2 * steps + 1))
        memory, q, hold, tau = law.start(1), np.zeros(1), np.array([seconds]), []
        for x in path:
            tau.append(law.torque(np.array([x]), q, memory, hold)[0][0])
            memory = law.commit(np.array([x]), q, memory, hold)
        return float(np.trapezoid(tau[steps:], path[steps:]))

    slow, fast = area(400, 1000.0), area(400, 1e-3)
    assert slow == fast > 0
    assert area(1600, 1.0) == pytest.approx(slow, rel=0.01)  # error of the trapezoidal rule at the corners


def test_creep_ends_after_its_slowest_element() -> None:
    law = Creeping(1e6, np.array([0.02, 0.03]), np.array([5.0, 60.0]))

    def compliance(seconds: float) -> float:
        tau, _ = law.torque(np.array([1e-4]), np.zeros(1), law.start(1), np.array([seconds]))
        return float(1e-4 / tau[0] * 1e6)

    assert compliance(1e-9) == pytest.approx(1.0, abs=1e-9)
    assert compliance(1e6) == pytest.approx(1.05, abs=1e-9)
    assert compliance(60.0) == pytest.approx(1 + 0.02 * (1 - np.exp(-12)) + 0.03 * (1 - np.exp(-1)), abs=1e-12)


def test_hysteresis_width_of_one_slipping_element() -> None:
    """τ = k δ + drag that has slipped to ±f: at zero torque the branches are 2 f/k apart."""
    law = BoucWen(1e6, 20.0, 1e-6)  # immediate build-up: a Coulomb element
    assert loop_width(law, 500.0) == pytest.approx(2 * 20.0 / 1e6, rel=0.02)


def test_pins_stiffen_to_the_sum_of_their_springs() -> None:
    law = Pins(1e5, np.full(4, 1e5), np.linspace(1e-4, 4e-4, 4), 1e-6)
    hold = np.zeros(1)
    _, soft = law.torque(np.zeros(1), np.zeros(1), law.start(1), hold)
    _, hard = law.torque(np.array([5e-3]), np.zeros(1), law.start(1), hold)
    tau = [law.torque(np.array([s * 3e-4]), np.zeros(1), law.start(1), hold)[0][0] for s in (1, -1)]
    assert soft[0] == pytest.approx(1e5, rel=1e-3)  # the contact roughness is a hundredth of the first gap
    assert hard[0] == pytest.approx(5e5, rel=1e-6)
    assert tau[0] == pytest.approx(-tau[1], rel=1e-12)


def test_compensator_torque_is_force_times_lever_at_two_poses() -> None:
    """s² = a² + L² − 2 a L cos(φ): torque F a L sin φ / s by the law of cosines."""
    a, L, F0, rate = 0.2, 0.7, 4000.0, 2e5
    law = Balancer(Spring(1e6), np.array([0.0, 1, 0]), np.array([0, 0, L]), np.array([0, 0, a]), F0, rate, L - a)
    for q in (0.5, -1.2):
        s = np.sqrt(a**2 + L**2 - 2 * a * L * np.cos(q))
        expected = -(F0 + rate * (s - (L - a))) * a * L * np.sin(q) / s
        pull, slope = law.pull(np.array([q]))
        assert pull[0] == pytest.approx(expected, rel=1e-12)
        h = 1e-6
        ahead, behind = law.pull(np.array([q + h]))[0][0], law.pull(np.array([q - h]))[0][0]
        assert slope[0] == pytest.approx((ahead - behind) / (2 * h), rel=1e-6)


def test_warming_has_the_given_time_constants() -> None:
    fast, slow = 600.0, 3000.0
    heat = Heat((2,), np.ones(6), 10.0, fast, slow, 0.0, work=1e9)
    t = np.array([300.0, 1500.0, 9000.0])
    expected = 10.0 * (1 - (slow * np.exp(-t / slow) - fast * np.exp(-t / fast)) / (slow - fast))
    rise, hall = heat.temperatures(t)
    assert rise == pytest.approx(expected, abs=0.03)  # Euler steps of 5 s with a time constant of 600 s
    assert hall == pytest.approx([21.0] * 3)
    assert heat.growth(t)[2][0] == pytest.approx(1.2e-5 * expected, rel=0.02)


@pytest.mark.parametrize("dry", [False, True], ids=["elastic", "with slip"])
def test_closed_load_cycle_returns_its_energy_or_dissipates_slip(kr240: Nominal, dry: bool) -> None:
    arm = arm_of(kr240)
    arm.beams[2] = Beam(3e6, 3e6, 2e6)
    k = kr240.stiffness[2]
    arm.laws[2] = iwan(k, 0.5, 3e-4) if dry else Pins(0.5 * k, np.full(3, 0.3 * k), np.array([1e-3, 2e-3, 3e-3]), 1e-4)
    statics = Statics(arm)
    shares = np.sin(np.linspace(0, 4 * np.pi, 97))
    q, memory, x = kr240.home[None], statics.start(1), None
    tip, gear, twist = [], [], []
    force = np.array([60.0, 40.0, -120.0])
    for share in shares:
        setting = Setting(q, np.concatenate([share * force, np.zeros(3)])[None])
        e = statics.settle(setting, memory, x)
        memory, x = statics.commit(e.x, setting, memory), e.x
        tip.append(e.position[0])
        gear.append(e.torque[0, 2])
        twist.append(e.x[0, statics.model.joint[2]] - q[0, 2])
    again = slice(48, None)  # the second cycle is closed
    work = np.trapezoid(shares[again], np.array(tip)[again] @ force)
    stored = 0.5 * abs(np.ptp(shares) * np.ptp(np.array(tip) @ force)) / 4
    if not dry:
        assert abs(work) < 1e-6 * stored  # same path in both directions, so the integration error cancels
    else:
        lost = np.trapezoid(np.array(gear)[again], np.array(twist)[again])
        assert lost > 1e-3 * stored
        assert work == pytest.approx(lost, rel=0.02)  # trapezoidal rule with 48 steps


def test_link_on_its_spring_vibrates_at_its_natural_frequency() -> None:
    k, m = 4e5, 250.0
    load = np.zeros(4000)
    load[:1] = 1000.0  # released after the first sample
    x, _ = motion_simulation._swing(load, np.full(4000, m), k, 0.0)
    crossings = np.flatnonzero(np.diff(np.sign(x)) > 0)
    period = np.diff(crossings).mean() / motion_simulation.FINE
    assert period == pytest.approx(2 * np.pi * np.sqrt(m / k), rel=2e-3)  # resolution of 1 ms over many periods
    assert np.abs(x[-200:]).max() == pytest.approx(np.abs(x[:200]).max(), rel=0.02)  # no damping


def test_lagging_servo_follows_a_ramp_with_lag_and_dead_time() -> None:
    t = np.arange(3000) / motion_simulation.FINE
    late = motion_simulation._lagged(2.0 * t, 0.020, 0.006)
    # a sampled lag may be delayed by one additional sample
    assert (2.0 * t - late)[-1] / 2.0 == pytest.approx(0.026, abs=0.001)


def test_axes_follow_roll_pitch_yaw_of_the_urdf() -> None:
    rpy = np.array([0.3, -0.7, 1.1])
    assert turn_rpy(rpy) == pytest.approx(pin.rpy.rpyToMatrix(rpy), abs=1e-15)


def test_simulator_does_not_import_the_package() -> None:
    for file in CONCEALED.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] == "machopt"], file


def test_case_list_is_complete() -> None:
    listed = case_list.cases()
    keys = [c.key for c in listed]
    assert len(set(keys)) == len(keys)
    groups = Counter(c.group for c in listed)
    assert groups["null"] * 3 >= len(listed)
    assert sum(c.ugly for c in listed) * 3 >= groups["null"]
    singles = Counter(c.parts[0].effect for c in listed if c.group == "single")
    vocabulary = {
        "joint_nonlinear_stiffness",
        "joint_backlash",
        "joint_hysteresis",
        "joint_creep",
        "joint_pose_dependent_stiffness",
        "joint_zero_offset",
        "transmission_error",
        "joint_friction",
        "joint_coupling",
        "gravity_compensator",
        "link_compliance",
        "base_compliance",
        "tool_compliance",
        "payload",
        "geometric_stiffness",
        "force_sensor_offset",
        "force_sensor_gain",
        "force_sensor_frame",
        "displacement_frame",
        "load_geometry",
        "time_skew",
        "thermal_drift",
        "servo_lag",
        "joint_elasticity",
    }
    assert set(singles) == vocabulary  # units and outliers are in the group of corrupted records
    for effect in vocabulary:
        levels = {c.parts[0].level for c in listed if c.group == "single" and c.parts[0].effect == effect}
        assert levels == {"small", "medium", "large"}
    assert {c.parts[0].effect for c in listed if c.group == "record"} >= {"units", "outliers"}
    for name, case, _ in case_list.numbered("sealed"):
        assert name.startswith("case_")
        assert case.parts == () or case.parts[0].effect not in name
    dev, sealed = ({c[1].key: c[2] for c in case_list.numbered(which)} for which in ("dev", "sealed"))
    assert all(dev[key] != sealed[key] for key in keys)


CHOSEN = (
    "deflection/joint_hysteresis.2/large",
    "deflection/tool_compliance.9/large",
    "absolute/thermal_drift.3/medium",
    "motion/joint_friction.0/large",
    "motion/transmission_error.5/large",
    "motion/servo_lag.9/medium",
    "null/deflection.3",
    "null/absolute.0",
    "record/units.0",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("concealed")
    listed = generate_cases.chosen("dev", list(CHOSEN), False, 1)
    assert len(listed) == len(CHOSEN)
    for name, case, seed in listed:
        generate_cases.generate((name, case, seed, "dev", out, True))
    return out


def test_reader_accepts_every_kind_of_recording(folder: Path) -> None:
    for path in folder.glob("*.truth.json"):
        truth = json.loads(path.read_text(encoding="utf-8"))
        case = folder / truth["case"]
        recording = load_recording(case / "recording")
        assert recording.kind == truth["kind"]
        assert len(recording) == truth["readings"]
        cell = load_cell(case / "cell")
        assert cell.stiffness.joints == pytest.approx(truth["nominal_stiffness_Nm_per_rad"])
        off = np.array(truth["true_stiffness_Nm_per_rad"]) / cell.stiffness.joints
        assert np.abs(np.log(off)).max() > 0.02  # the true stiffnesses differ from those of the cell
        fixed = {p.relative_to(case).parts[0] for p in case.rglob("*")}
        assert fixed == {"cell", "recording"}
        written = "".join(p.read_text(encoding="utf-8") for p in case.rglob("*.yaml"))
        for effect in truth["effects"]:
            assert effect["effect"] not in written


def test_truth_contains_the_requested_size(folder: Path) -> None:
    observed = 0
    for path in folder.glob("*.truth.json"):
        truth = json.loads(path.read_text(encoding="utf-8"))
        for effect in truth["effects"]:
            if effect["visible"] is None or effect["effect"] == "servo_lag":
                continue
            observed += 1
            assert effect["visible"]["before"] > 0
            assert 0.0 < effect["visible"]["ratio_to_noise"] < 2.0
            if effect["level"] == "large" and truth["kind"] == "motion":
                assert effect["visible"]["ratio_to_noise"] == pytest.approx(1.2, rel=0.25)
        if truth["group"] == "null":
            assert truth["verdicts"] == ["consistent"]
            # the systematic errors of a null case are less than a third of the noise of one reading
            assert truth["dirt"]["ratio_to_noise"] < 0.35
        assert truth["oracle"]["rmse"] <= truth["oracle"]["rmse_with_outliers"]
    assert observed >= 4


def test_same_seed_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    for key in ("deflection/joint_hysteresis.2/large", "null/absolute.0"):
        ((name, case, seed),) = generate_cases.chosen("dev", [key], False, 1)
        generate_cases.generate((name, case, seed, "dev", tmp_path, True))
        for part in ("data.csv", "recording.yaml"):
            one, two = (root / name / "recording" / part for root in (folder, tmp_path))
            assert one.read_bytes() == two.read_bytes()
        other = Scene(case, (seed[0] + 1, *seed[1:]), CELLS, True)
        assert not np.array_equal(other.q, Scene(case, seed, CELLS, True).q)


def answer(folder: Path, findings: dict[str, list[dict[str, object]]], verdict: str = "explained") -> None:
    for path in folder.glob("*.truth.json"):
        name = path.name.split(".")[0]
        expected = {
            "machopt_diagnosis": 1,
            "verdict": verdict,
            "findings": findings.get(name, []),
            "mismatch": [],
            "rmse_unit": "mm",
            "final": {"heldout_rmse": 0.02},
            "detection_limits": [],
        }
        (folder / name / "out").mkdir(exist_ok=True)
        (folder / name / "out" / "diagnosis.json").write_text(json.dumps(expected))


def figures(folder: Path) -> tuple[dict[str, tuple[float, int]], list[str]]:
    lines, misses = score_diagnoses.table(score_diagnoses.read(folder))
    return {line.what.strip(): (line.hits, line.of) for line in lines}, misses


def test_score_judges_intervals_by_their_own_level() -> None:
    """If both intervals are given, those of 90 % were scored as if they were 95 % intervals."""
    size = {"value": 1.0, "unit": "arcmin"}
    truth = {"effects": [{"effect": "joint_backlash", "location": "joint:2", "parameters": {"width": size}}]}
    width = {"value": 0.9, "unit": "arcmin", "ci95": [0.75, 1.05], "ci90": [0.8, 0.98]}
    finding = {"effect": "joint_backlash", "location": "joint:2", "parameters": {"width": width}}
    (one,) = [score_diagnoses.Answer(truth, {}, findings=[finding])]
    assert score_diagnoses.intervals([one]) == (1, 1)
    assert score_diagnoses.intervals([one], 90) == (0, 1)


def test_score_separates_correct_names_silence_and_guesses(folder: Path) -> None:
    truths = [json.loads(p.read_text(encoding="utf-8")) for p in folder.glob("*.truth.json")]
    names = {
        t["case"]: [{"effect": e["effect"], "location": e["location"], "one_of": []} for e in t["effects"]]
        for t in truths
    }
    answer(folder, names)
    message, misses = figures(folder)
    assert not misses
    assert message["null: something named"] == (0, 2)
    for row in ("recall of single effects", "place first named is right", "the set covers the truth"):
        hits, of = message[row]
        assert hits == of > 0
    answer(folder, {}, "consistent")
    message, misses = figures(folder)
    assert message["recall of single effects"][0] == 0
    assert message["null: something named"] == (0, 2)
    assert len(misses) == message["recall of single effects"][1]
    guess = [{"effect": "joint_backlash", "location": "joint:6", "one_of": [], "parameters": {}}]
    answer(folder, {t["case"]: guess for t in truths})
    message, _ = figures(folder)
    assert message["null: something named"] == (2, 2)
    assert message["precision of a named effect"] == (0, len(truths) - 2)
