"""Diagnosis of motions: rigid-body dynamics, operators with memory, segments, record checks, complete diagnoses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated_long_motion
from scipy.interpolate import CubicSpline

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.data_types.cell import Cell, JointLimits, Tool, Workpiece
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects.joint.creep import filter_first_order
from machopt.effects.joint.joint_vibration import simulate_mass_on_spring
from machopt.effects.joint.play_and_drag_operators import compute_drag, compute_play
from machopt.effects.joint.presliding_direction import compute_presliding_direction
from machopt.errors import InputError
from machopt.kinematics.robot import GRAVITY
from machopt.measurement.diagnosis.dynamic import motion_channels, motion_record_checks, servo_lag
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.motion_data.motion_signals import build_motion_signals
from machopt.measurement.recording import load_recording, write_recording

MASS, LENGTH, INERTIA = 20.0, 0.7, 1.5  # kg, m, kg·m² about the centre of mass
LINK = (
    '<link name="l{i}"><inertial><origin xyz="{c} 0 0"/><mass value="{m}"/>'
    '<inertia ixx="{I}" iyy="{I}" izz="{I}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="a{i}" type="{kind}"><parent link="{parent}"/><child link="l{i}"/><origin xyz="{at} 0 0"/>'
    '<axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="5" effort="0"/></joint>'
)


def arm(folder: Path, joints: int = 1, kind: str = "revolute", tool: float = 0.0) -> Cell:
    """Build a chain with parallel horizontal axes (y), or one prismatic joint along x."""
    axis = "1 0 0" if kind == "prismatic" else "0 -1 0"
    parts, parent = [], "base"
    for i in range(1, joints + 1):
        parts.append(
            LINK.format(
                i=i, c=LENGTH, m=MASS, I=INERTIA, kind=kind, parent=parent, axis=axis, at=0.0 if i == 1 else 1.0
            )
        )
        parent = f"l{i}"
    urdf = folder / "arm.urdf"
    urdf.write_text(f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>', encoding="utf-8")
    one = np.ones(joints)
    return Cell(
        name="bench",
        folder=folder,
        urdf=urdf,
        packages={},
        base_link="base",
        flange_link=parent,
        arm_joints=tuple(f"a{i}" for i in range(1, joints + 1)),
        external_joints=(),
        external_prismatic=(),
        home=np.zeros(joints),
        external_home=np.zeros(0),
        T_world_base=np.eye(4),
        limits=JointLimits(-one, one, one, one, one),
        tool=Tool(T_flange_tcp=np.eye(4), mass=tool, com=np.array([0.2, 0.0, 0.1])),
        workpiece=Workpiece("world", np.eye(4)),
        obstacles=(),
        stiffness=None,
    )


def build_fourier_motion(
    joints: int, rng: np.random.Generator, *, periods: int = 4, rate: float = 100.0, period: float = 6.0
):
    """Return time, q, q̇, q̈ of a periodic Fourier series."""
    t = np.arange(int(periods * period * rate)) / rate
    q, v, a = (np.zeros((len(t), joints)) for _ in range(3))
    for j in range(joints):
        for k in range(1, 5):
            w, phase, size = 2 * np.pi * k / period, rng.uniform(0, 6.28), rng.uniform(0.1, 0.5) / k
            q[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w**2 * np.sin(w * t + phase)
    return t, q, v, a


def build_motion_recording(t, q, v, tau=None, **more) -> Recording:
    zeros = np.zeros(len(t), np.int64)
    return Recording(
        kind="motion",
        source="bench",
        q=q,
        pose=zeros,
        cycle=np.arange(len(t)),
        session=zeros,
        line=np.arange(len(t)) + 2,
        time=t,
        velocity=v,
        torque=tau,
        **more,
    )


def diagnose_recording(recording: Recording, cell: Cell, channel):
    problem, catalogue, notes, first = motion_channels.build_motion_problem(
        recording, cell, channel, np.random.default_rng(0)
    )
    found = selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    return found, notes, first


def test_torque_of_a_pendulum(tmp_path: Path) -> None:
    """τ = (m l² + I) q̈ + m g l cos q; exact to rounding."""
    dynamics = load_dynamics(arm(tmp_path))
    q = np.linspace(-2, 2, 9)[:, None]
    a = np.linspace(3, -1, 9)[:, None]
    expected = (MASS * LENGTH**2 + INERTIA) * a + MASS * GRAVITY * LENGTH * np.cos(q)
    assert dynamics.compute_torque(q, 0 * q, a) == pytest.approx(expected, rel=1e-12, abs=1e-9)
    assert dynamics.compute_own_inertia(q) == pytest.approx(np.full((9, 1), MASS * LENGTH**2 + INERTIA), rel=1e-12)


def test_regressor_columns_equal_changes_of_the_tool(tmp_path: Path) -> None:
    """More mass at the tool's centre of mass changes the torques by the first payload column; the relation is
    exactly linear."""
    rng = np.random.default_rng(1)
    _, q, v, a = build_fourier_motion(3, rng, periods=1, rate=5.0)
    light, heavy = (load_dynamics(arm(tmp_path, 3, tool=m)) for m in (5.0, 7.5))
    P, _, L = light.compute_regressors(q, v, a)
    assert 2.5 * P[:, :, 0] == pytest.approx(
        heavy.compute_torque(q, v, a) - light.compute_torque(q, v, a), rel=1e-9, abs=1e-9
    )
    # scaling all links by the same factor gives the whole torque, including the tool (in the last link)
    assert L.sum(axis=2) == pytest.approx(light.compute_torque(q, v, a), rel=1e-9, abs=1e-9)


def test_gravity_follows_the_mounting_of_the_robot(tmp_path: Path) -> None:
    """With the robot on a wall the axis is vertical and weight causes no torque."""
    turned = np.eye(4)
    turned[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    dynamics = load_dynamics(replace(arm(tmp_path), T_world_base=turned))
    q = np.linspace(-1, 1, 5)[:, None]
    assert dynamics.compute_torque(q, 0 * q, 0 * q) == pytest.approx(0 * q, abs=1e-9)


def test_urdf_without_inertias_is_refused(tmp_path: Path) -> None:
    cell = arm(tmp_path)
    text = cell.urdf.read_text(encoding="utf-8")
    start, end = text.index("<inertial>"), text.index("</inertial>") + len("</inertial>")
    cell.urdf.write_text(text[:start] + text[end:], encoding="utf-8")
    with pytest.raises(InputError, match="inertial"):
        load_dynamics(cell)


def test_backlash_and_presliding_operators() -> None:
    """The play operator lags by half its width at a reversal; presliding friction reverses exponentially with the
    travel."""
    first = np.array([1, 0, 0, 0, 0], np.int64)
    assert compute_play(np.array([0.0, 1.0, 3.0, 2.5, 0.0]), first, 1.0) == pytest.approx([0.0, 0.0, 2.0, 2.0, 1.0])
    v = np.full(101, 1e-3)
    v[0] = -1e-3
    first = np.zeros(101, np.int64)
    first[0] = 1
    z = compute_presliding_direction(v, 0.01, first, 5e-4)
    # the velocity reverses within the first interval: a quarter of it forward, then 49 whole intervals: 4.925e-4 rad
    assert z[50] == pytest.approx(1.0 - 2.0 * np.exp(-0.985), abs=1e-6)


def test_bouc_wen_between_two_loads() -> None:
    """Cycle between 0.2 and 0.5 with β = ½: unloading is linear and loading is exponential; both have a closed form."""
    cycle = np.concatenate([np.linspace(0.5, 0.2, 50), np.linspace(0.2, 0.5, 50)])
    x = np.concatenate([np.linspace(0, 0.5, 50), *[cycle] * 12])
    first = np.zeros(len(x), np.int64)
    first[0] = 1
    # loading from zero with β = ½, γ = ½: dz = (1 − z) dx, z = 1 − exp(−x)
    z = compute_drag(x, first, 1.0, 0.5)
    assert z[49] == pytest.approx(1.0 - np.exp(-0.5), abs=1e-12)
    # linear back to zero, then along the same exponential, in both directions
    expected = z[49]
    for _ in range(12):
        for way in (-0.3, 0.3):
            against = expected * np.sign(way)
            gone = min(max(-against, 0.0), 0.3)
            rest = 1.0 - (1.0 - against - gone) * np.exp(gone - 0.3) if against > -0.3 else against + gone
            expected = np.sign(way) * rest
    assert z[-1] == pytest.approx(expected, abs=1e-12)


def test_lag_and_spring_agree_with_closed_forms() -> None:
    """A step through a first-order lag, and the free vibration of a mass on a spring: both exact for an input that
    is constant over each step."""
    n, h = 400, 0.005
    first = np.zeros(n, np.int64)
    first[0] = 1
    x = np.ones(n)
    x[0] = 0.0
    t = h * np.arange(n)
    assert filter_first_order(x, np.full(n, h), first, 0.3) == pytest.approx(1 - np.exp(-t / 0.3), abs=1e-12)
    load = np.zeros(n)
    load[0] = 100.0
    swing = simulate_mass_on_spring(load, np.full(n, 2.0), np.full(n, h), first, 5000.0, 0.05)
    w = 50.0 * np.sqrt(1 - 0.05**2)
    # the load is assumed to fall over the first step: the phase may be off by half a step, the decay is not
    peak = np.abs(swing[200:]).max() / np.abs(swing[:40]).max()
    assert peak == pytest.approx(np.exp(-0.05 * 50.0 * 1.0), rel=0.15)
    crossings = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    assert np.mean(np.diff(crossings)) * h == pytest.approx(np.pi / w, rel=0.02)


def test_periods_groups_and_replicates_of_a_repeating_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    t, q, v, a = build_fourier_motion(1, rng)
    m = build_motion_signals(build_motion_recording(t, q, v), 1)
    assert m.length == pytest.approx(6.0, abs=0.011)  # one sample
    assert len(np.unique(m.group)) >= 6
    # replicates have the same joint angle in different periods
    label = m.replicate[m.replicate >= 0]
    assert len(label) > 0.9 * len(m)
    position = m.average_blocks(m.q[:, 0])[m.replicate >= 0]
    kind = np.unique(label)[5]
    assert np.ptp(position[label == kind]) < 1e-6
    # replicates are always in the same group, otherwise one would predict the other in cross-validation
    assert all(len(np.unique(m.group[m.replicate == k])) == 1 for k in np.unique(label)[::17])
    # derivative of the filtered velocity: the series is slow relative to the filter; error 0.1 % of its range
    inside = slice(100, -100)
    assert np.abs(m.a[inside] - a[inside]).max() < 2e-3 * np.ptp(a)


def test_offset_in_one_period_is_not_physics(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    t, q, v, _ = build_fourier_motion(1, rng)
    m = build_motion_signals(build_motion_recording(t, q, v), 1)
    x = 3.0 + m.select_block_labels(m.period).astype(float)
    assert m.subtract_period_mean(x[:, None]) == pytest.approx(np.full((len(m), 1), x.mean()), abs=1e-9)


def test_gaps_split_and_short_recordings_are_refused() -> None:
    rng = np.random.default_rng(2)
    t, q, v, _ = build_fourier_motion(1, rng)
    keep = (t < 10.0) | (t > 11.0)
    m = build_motion_signals(build_motion_recording(t[keep], q[keep], v[keep]), 1)
    assert len(m.segments()) == 2
    assert any("gap" in n for n in m.notes)
    with pytest.raises(InputError, match="no stretch"):
        build_motion_signals(build_motion_recording(t[:20], q[:20], v[:20]), 1)
    twice = t.copy()
    twice[7] = twice[6]
    with pytest.raises(InputError, match="time does not advance"):
        build_motion_signals(build_motion_recording(twice, q, v), 1)


def test_speeds_in_radians_are_corrected_and_reported() -> None:
    rng = np.random.default_rng(3)
    t, q, v, _ = build_fourier_motion(2, rng)
    fixed, found = motion_record_checks.correct_motion_units(
        build_motion_recording(t, 20 * q, 20 * v * np.pi / 180.0), 2
    )
    assert [(f.effect, f.location) for f in found] == [("units", "column:qd1_deg_s")]
    assert fixed.velocity == pytest.approx(20 * v, rel=1e-12)
    _, none = motion_record_checks.correct_motion_units(build_motion_recording(t, q, v), 2)
    assert not none
    with pytest.raises(InputError, match="runs against"):
        motion_record_checks.correct_motion_units(build_motion_recording(t, q, -v), 2)


def test_motor_side_torque_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    cell = arm(tmp_path, 2)
    t, q, v, a = build_fourier_motion(2, rng)
    tau = load_dynamics(cell).compute_torque(q, v, a) / np.array([120.0, 90.0])
    with pytest.raises(InputError, match="before their gears"):
        motion_channels.build_motion_problem(build_motion_recording(t, q, v, tau), cell, "torque", rng)


def test_channels_follow_the_recorded_signals(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    cell = arm(tmp_path, 1)
    t, q, v, _ = build_fourier_motion(1, rng)
    assert motion_channels.list_testable_channels(build_motion_recording(t, q, v, q), cell) == ("torque",)
    assert motion_channels.list_testable_channels(build_motion_recording(t, q, v, q, q_secondary=q), cell)[0] == "link"
    assert motion_channels.list_testable_channels(build_motion_recording(t, q, v), cell) == ()


@pytest.mark.parametrize("late", [-0.0043, 0.0, 0.0121])
def test_torque_delay_is_found_to_one_millisecond(tmp_path: Path, late: float) -> None:
    """Friction is delayed together with the rigid-body torque; samples every 10 ms, noise 0.5 N·m on 140 N·m."""
    rng = np.random.default_rng(4)
    cell = arm(tmp_path)
    t, q, v, _ = build_fourier_motion(1, rng)
    fine, qf, vf, af = build_fourier_motion(1, np.random.default_rng(4), rate=2000.0)
    tau = load_dynamics(cell).compute_torque(qf, vf, af)[:, 0] + 8.0 * np.tanh(vf[:, 0] / 0.05) + 3.0 * vf[:, 0]
    observed = np.interp(t - late, fine, tau)[:, None] + 0.5 * rng.normal(size=(len(t), 1))
    _, catalogue, _, _ = motion_channels.build_motion_problem(
        build_motion_recording(t, q, v, observed), cell, "torque", rng
    )
    clock = next(h for h in catalogue.hypotheses if h.effect == "time_skew")
    assert clock.shapes[0][0] == pytest.approx(late, abs=1e-3)


def shaken(tmp_path: Path, joints: int, seed: int):
    rng = np.random.default_rng(seed)
    cell = arm(tmp_path, joints, tool=5.0)
    t, q, v, a = build_fourier_motion(joints, rng, periods=5)
    tau = load_dynamics(cell).compute_torque(q, v, a) + 6.0 * np.sign(v) + 2.0 * v
    return rng, cell, t, q, v, tau


@pytest.mark.parametrize("late", [0.005, 0.0121])
def test_interpolation_of_the_recorder_is_part_of_the_delay(tmp_path: Path, late: float) -> None:
    """The recorder interpolates a friction step between two samples; a delayed ideal step has no such value.

    Estimated delays were 14 to 22 % too long.
    """
    rng = np.random.default_rng(4)
    cell = arm(tmp_path)
    t, q, v, a = build_fourier_motion(1, rng)
    tau = load_dynamics(cell).compute_torque(q, v, a)[:, 0] + 8.0 * np.sign(v[:, 0]) + 3.0 * v[:, 0]
    observed = np.interp(t - late, t, tau)[:, None] + 0.2 * rng.normal(size=(len(t), 1))
    problem, catalogue, _, _ = motion_channels.build_motion_problem(
        build_motion_recording(t, q, v, observed), cell, "torque", rng
    )
    clock = next(h for h in catalogue.hypotheses if h.effect == "time_skew")
    X = np.concatenate([problem.base, clock.columns(clock.shapes[0])], axis=2)[:, 0]
    left, x = fit_least_squares(problem.y[:, 0], X)
    assert x[-1] == pytest.approx(late, rel=0.03)
    assert np.std(left) < 1.1 * 0.2 / np.sqrt(2.0)  # two samples per reading


def test_nothing_is_named_without_an_effect(tmp_path: Path) -> None:
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 5)
    found, notes, first = diagnose_recording(
        build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), cell, "torque"
    )
    assert found.verdict == "consistent"
    assert not found.findings
    assert not first
    assert "low-pass" in notes[0]


def test_stribeck_friction_is_named_at_its_joint(tmp_path: Path) -> None:
    """Stribeck peak of 6 N·m in 1 N·m of noise; simulated as a hyperbola, modelled in the catalogue as an
    exponential."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 6)
    tau[:, 1] += 6.0 * np.sign(v[:, 1]) / (1.0 + (v[:, 1] / 0.06) ** 2)
    found, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), cell, "torque")
    assert [(f.effect, f.location) for f in found.findings] == [("joint_friction", "joint:2")]
    assert found.heldout_after < found.heldout_before
    # within 20 % of the noise of a reading (at most two samples averaged), because simulated and fitted law differ
    assert found.heldout_after < 1.2 * max(found.noise_floor, 0.7)


def test_backlash_is_named_from_link_side_encoders(tmp_path: Path) -> None:
    """Backlash of 0.1 mrad with the sign of the torque, rounded by contact stiffness; noise 20 µrad."""
    rng, cell, t, q, v, _ = shaken(tmp_path, 1, 7)
    upright = np.eye(4)
    upright[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # no weight, otherwise the torque would keep its sign
    cell = replace(cell, T_world_base=upright)
    a = np.gradient(v[:, 0], t)[:, None]
    tau = load_dynamics(cell).compute_torque(q, v, a) + 6.0 * np.sign(v) + 2.0 * v
    load = -(tau - 6.0 * np.sign(v) - 2.0 * v)
    other = q + load / 2e6 + 5e-5 * np.tanh(load / 2.0) + 2e-5 * rng.normal(size=q.shape)
    found, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau, q_secondary=other), cell, "link")
    assert [(f.effect, f.location) for f in found.findings] == [("joint_backlash", "joint:1")]
    width = found.findings[0].parameters["width"]
    # arcmin; the transition is tanh in the simulation and a ramp in the law
    assert width.value == pytest.approx(1e-4 * 10800 / np.pi, rel=0.1)


def test_late_encoder_is_late_with_the_twist_of_its_gear(tmp_path: Path) -> None:
    """The delay must include the gear deflection, otherwise its residual is named creep of the gear (delays of 3 to
    17 ms)."""
    rng, cell, t, q, v, _ = shaken(tmp_path, 1, 7)
    tau = load_dynamics(cell).compute_torque(q, v, np.gradient(v[:, 0], t)[:, None])
    other = CubicSpline(t, q - tau / 2e4)(t - 0.008) + 2e-6 * rng.normal(size=q.shape)
    keep = slice(10, -10)
    found, _, _ = diagnose_recording(
        build_motion_recording(t[keep], q[keep], v[keep], tau[keep], q_secondary=other[keep]), cell, "link"
    )
    assert [(f.effect, f.location) for f in found.findings] == [("time_skew", "sensor:qse")]
    assert found.findings[0].parameters["late"].value == pytest.approx(8.0, abs=0.01)  # ms


def test_encoders_behind_their_command_are_reported(tmp_path: Path) -> None:
    rng, _, t, q, v, tau = shaken(tmp_path, 2, 8)
    commanded = q + 0.012 * v
    late = build_motion_recording(t, q, v, tau, q_command=commanded)
    lags = servo_lag.find_servo_lag(late, build_motion_signals(late, 2))
    assert [(f.effect, f.location) for f in lags] == [("servo_lag", "controller")]
    assert lags[0].parameters["delay"].value == pytest.approx(12.0, abs=0.3)  # ms; the derivative of a delayed command
    assert lags[0].p_value < 1e-6  # better in all 24 segments: the probability by chance is 1 in 17 million
    close = build_motion_recording(t, q, v, tau, q_command=q + 1e-6 * rng.normal(size=q.shape))
    assert not servo_lag.find_servo_lag(close, build_motion_signals(close, 2))


def test_prismatic_joint_is_a_valid_chain(tmp_path: Path) -> None:
    """One prismatic joint: forces replace torques, and six joints are not required."""
    rng = np.random.default_rng(9)
    cell = arm(tmp_path, 1, "prismatic")
    t, q, v, a = build_fourier_motion(1, rng)
    force = MASS * a + 5.0 * np.sign(v) + 0.2 * rng.normal(size=q.shape)
    problem, _, _, _ = motion_channels.build_motion_problem(build_motion_recording(t, q, v, force), cell, "torque", rng)
    assert problem.families[0].unit == "N"
    x = np.linalg.lstsq(problem.base[:, 0], problem.y[:, 0], rcond=None)[0]
    coulomb = next(k for k, u in enumerate(problem.unknowns) if u.name.startswith("Coulomb"))
    assert x[coulomb] == pytest.approx(5.0, abs=0.1)  # noise 0.2 N over a thousand readings


def write_prismatic_bench(folder: Path, data: str, urdf: str) -> tuple[Path, Path]:
    """Write the cell and recording folders of one prismatic joint, without tool, workpiece or stiffness."""
    cell, record = folder / "cell", folder / "rec"
    cell.mkdir()
    record.mkdir()
    (cell / "arm.urdf").write_text(urdf, encoding="utf-8")
    (cell / "cell.yaml").write_text(
        "machopt_cell: 1\nname: bench\nrobot:\n  urdf: arm.urdf\n  base_link: base\n  flange_link: l1\n"
        "  home_deg: [0]\n  limits: {velocity_deg_s: [500], acceleration_deg_s2: [5000], jerk_deg_s3: [9e4]}\n",
        encoding="utf-8",
    )
    (record / "recording.yaml").write_text("machopt_recording: 1\nkind: motion\ndata: data.csv\n", encoding="utf-8")
    (record / "data.csv").write_text(data, encoding="utf-8")
    return cell, record


def slide(folder: Path, force: str = "tau1_N", q: str = "q1_mm") -> tuple[Path, Path]:
    rng = np.random.default_rng(11)
    t, x, v, a = build_fourier_motion(1, rng, periods=3)
    f = MASS * a + 5.0 * np.sign(v) + 0.2 * rng.normal(size=x.shape)
    rows = np.column_stack([t, 1e3 * x, 1e3 * v, f])
    head = f"time_s,{q},{q.replace('q', 'qd')}_s,{force}"
    text = "\n".join([head, *(",".join(f"{n:.9g}" for n in r) for r in rows.tolist()), ""])
    return write_prismatic_bench(folder, text, arm(folder, 1, "prismatic").urdf.read_text(encoding="utf-8"))


@pytest.mark.parametrize("force", ["tau1_N", "tau1_Nm"])
def test_prismatic_joint_goes_through_the_command(tmp_path: Path, force: str) -> None:
    """Input in millimetres and newtons; other commands refuse such a cell."""
    cell, record = slide(tmp_path, force)
    out = tmp_path / "out"
    assert main(["diagnose", str(cell), str(record), "-o", str(out), "--quiet"]) == 0
    output = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert (output["verdict"], output["rmse_unit"], output["model"]) == ("consistent", "N", None)
    coulomb = next(c for c in output["coefficients"] if c["name"] == "Coulomb friction 1")
    assert coulomb["value"] == pytest.approx(5.0, abs=0.1)  # noise 0.2 N over a thousand readings
    assert (out / "report.html").stat().st_size > 1000
    with pytest.raises(InputError, match="home_deg"):
        load_cell(cell)


def test_joints_of_cell_and_recording_must_agree(tmp_path: Path) -> None:
    cell, record = slide(tmp_path, q="q1_deg", force="tau1_Nm")
    loaded = load_cell(cell, any_chain=True)
    with pytest.raises(InputError, match="q1_mm is expected"):
        motion_channels.check_joint_names(load_recording(record), loaded)
    data = (record / "data.csv").read_text(encoding="utf-8")
    (record / "data.csv").write_text(data.replace("q1_deg", "q1_mm", 1), encoding="utf-8")
    with pytest.raises(InputError, match="found column qd1_deg_s; joint 1 slides"):
        load_recording(record)
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(0), periods=1)
    with pytest.raises(InputError, match="has 2 joints, the cell's arm 1"):
        motion_channels.check_joint_names(build_motion_recording(t, q, v, a), loaded)


def test_prismatic_joints_are_written_and_read_back(tmp_path: Path) -> None:
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(1), periods=1)
    before = replace(build_motion_recording(t, q, v, a, q_secondary=q), prismatic=(False, True))
    write_recording(tmp_path / "r", before)
    names = (tmp_path / "r" / "data.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"q1_deg", "q2_mm", "qd2_mm_s", "qse2_mm", "tau1_Nm", "tau2_N"} <= set(names)
    after = load_recording(tmp_path / "r")
    assert after.prismatic == (False, True)
    for name in ("q", "velocity", "q_secondary", "torque"):
        # written to 1e-6 N·m and 1e-8 deg/s
        assert getattr(after, name) == pytest.approx(getattr(before, name), abs=1e-6)


def test_friction_reversal_at_a_sample_is_no_delay() -> None:
    """The direction is that at the sample; a shift by half an interval would be named a delay."""
    v = np.sin(np.linspace(0.1, 20.0, 4000))
    first = np.zeros(len(v), np.int64)
    first[0] = 1
    assert np.array_equal(compute_presliding_direction(v, 0.004, first, 0.0), np.sign(v))


def test_lost_samples_do_not_bias_velocities() -> None:
    """Three in ten samples are missing: filters that assume uniform sampling would have large errors."""
    rng = np.random.default_rng(12)
    t, q, v, a = build_fourier_motion(1, rng, rate=250.0, periods=2)
    keep = np.sort(rng.choice(len(t), int(0.7 * len(t)), replace=False))
    m = build_motion_signals(build_motion_recording(t[keep], q[keep], v[keep]), 1)
    assert any("even grid" in n for n in m.notes)
    inside = slice(100, -100)
    assert np.abs(m.a[inside, 0] - a[keep][m.index][inside, 0]).max() < 0.02 * np.ptp(a)


def test_recordings_without_motion_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    t, q, v, a = build_fourier_motion(2, rng, periods=2)
    cell = arm(tmp_path, 2)
    tau = load_dynamics(cell).compute_torque(q, v, a) + rng.normal(size=q.shape)
    with pytest.raises(InputError, match="no joint moves"):
        motion_channels.build_motion_problem(build_motion_recording(t, 0 * q, 0 * v, tau), cell, "torque", rng)
    with pytest.raises(InputError, match="tau2_Nm never changes"):
        motion_channels.build_motion_problem(build_motion_recording(t, q, v, tau * [1, 0]), cell, "torque", rng)
    with pytest.raises(InputError, match="tau2_Nm runs against"):
        motion_channels.build_motion_problem(build_motion_recording(t, q, v, tau * [1, -1]), cell, "torque", rng)
    fixed, words = motion_record_checks.check_channel_quality(build_motion_recording(t, q, v * [1, 0], tau), 2)
    assert fixed.velocity is None
    assert "qd2_deg_s never changes" in words[0]


def test_clock_in_milliseconds_and_torques_in_kilo_units_are_corrected(tmp_path: Path) -> None:
    rng = np.random.default_rng(14)
    cell = arm(tmp_path, 2)
    t, q, v, a = build_fourier_motion(2, rng)
    tau = load_dynamics(cell).compute_torque(q, v, a) + 6.0 * np.sign(v) + rng.normal(size=q.shape)
    for record, where in (
        (build_motion_recording(100.0 * 1e3 * t, q, 1e-2 * v, tau), "column:time_s"),
        (build_motion_recording(t, q, v, tau / 1e3), "column:tau1_Nm"),
    ):
        _, _, _, found = motion_channels.build_motion_problem(record, cell, "torque", rng)
        assert [(f.effect, f.location) for f in found] == [("units", where)]
        assert found[0].after < found[0].before
        assert found[0].p_value < 1e-6  # better in all 24 segments


@pytest.mark.proof
def test_long_motion_without_an_effect(tmp_path: Path) -> None:
    """10,000 samples, a tenth of the long motion; independent recursive dynamics, and no two equal periods."""
    cell, record = simulated_long_motion.write_long_motion(tmp_path, 10_000, 250.0, 1)
    out = tmp_path / "out"
    assert main(["diagnose", str(cell), str(record), "-o", str(out), "--quiet"]) == 0
    output = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert output["verdict"] == "consistent"
    assert not output["findings"]
