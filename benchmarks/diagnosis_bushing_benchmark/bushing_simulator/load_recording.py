"""A load test: pulls at the TCP, up and down, the displacement from the unloaded state of the same cycle.

The laboratory applies the force at a hook of the tool; a force sensor and a tracker measure with their own errors.
Gears keep
their history from the arrival at the pose through all load steps of a cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bushing_simulator.bushing_bodies import PointLoad
from bushing_simulator.gear_laws import Drive
from bushing_simulator.reference_kinematics import compute_frames, compute_tool_axes
from bushing_simulator.robot_assembly import HiddenPhysics, assemble_arm
from bushing_simulator.robot_descriptions import RobotDescription
from bushing_simulator.rotations import compute_rotation

LEVELS = np.array([0.3, 0.65, 1.0, 0.65, 0.3, 0.0])  # of the largest load
TRACKER_FOOT = np.array([3.1, -2.2, 0.4])  # m, in the base


@dataclass(frozen=True)
class LoadPlan:
    """What the laboratory intends; one entry per load cycle."""

    q: np.ndarray  # (C, 6) rad
    pose: np.ndarray  # (C,)
    session: np.ndarray  # (C,)
    pull: np.ndarray  # (C, 3) N at level 1
    durations: np.ndarray  # (C, L) s of each step
    arrival: np.ndarray  # (C, 6) ±1
    rotations: bool  # whether rotations are read, too


@dataclass(frozen=True)
class SensorErrors:
    """Systematic errors of the instruments; zero in a sound laboratory."""

    force_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))  # N, sensor axes
    force_gain: np.ndarray = field(default_factory=lambda: np.eye(3))  # cross-talk and gain, sensor axes
    force_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))  # rad, sensor mount
    hook: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m, where the load acts, in the flange, from the TCP
    pulley: float = 0.0  # rad, the rope runs askew, sense differs by cycle
    tracker_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))  # rad, tracker axes to base
    tracker_drift: float = 0.0  # rad, turn of the tracker about its foot over a session
    floor_tilt: float = 0.0  # rad/(N·m), turn of the tracker with the overturning moment on the floor
    gauge_drift: float = 0.0  # share of the gain that the amplifier gains over a session


@dataclass(frozen=True)
class NoiseLevels:
    """Random errors, 1 sigma."""

    white: float = 10e-6  # m
    cycle: float = 10e-6  # m, shared by a cycle
    rotation: float = 2.5e-5  # rad
    force: float = 2.0  # N
    force_share: float = 0.004
    outlier_share: float = 0.0


def draw_load_plan(robot: RobotDescription, rng: np.random.Generator, poses: int, rotations: bool) -> LoadPlan:
    """Return poses inside the limits and above the floor, three pulls each, two sessions."""
    angles = []
    while len(angles) < poses:
        share = rng.uniform(0.1, 0.9, 6)
        q = np.deg2rad(robot.limits_deg[:, 0] + share * np.diff(robot.limits_deg)[:, 0])
        q[0], q[3], q[5] = rng.uniform(-1.4, 1.4), rng.uniform(-2.6, 2.6), rng.uniform(-2.6, 2.6)
        places, _, tcp, _ = compute_frames(robot, q[None])
        reach = np.hypot(*tcp[0, :2])
        if tcp[0, 2] > 0.35 and places[0, 4:, 2].min() > 0.4 and reach > 0.7 and abs(np.sin(q[4])) > 0.25:
            angles.append(q)
    rows: list[tuple] = []
    for pose, q in enumerate(angles):
        turn = rng.normal(size=3)
        basis = compute_rotation(turn)
        for k in range(3):
            sign = rng.choice([-1.0, 1.0])
            for session in (0, 1):
                size = robot.pull * rng.uniform(0.75, 1.0)
                rows.append((q, pose, session, size * sign * basis[:, k], rng.uniform(5.0, 45.0, len(LEVELS))))
    rows.sort(key=lambda r: r[2])
    arrival = rng.choice([-1.0, 1.0], (len(rows), 6))
    q, pose, session, pull, durations = (np.array(x) for x in zip(*rows, strict=True))
    return LoadPlan(q, pose, session, pull, durations, arrival, rotations)


def compute_load_response(
    robot: RobotDescription, hidden: HiddenPhysics, plan: LoadPlan, sensors: SensorErrors
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return true displacements (C, L, 6) and forces (C, L, 3) at the hook, and the largest residual in N."""
    arm = assemble_arm(robot, hidden)
    count = len(plan.q)
    arm.reset(count)
    drive = Drive(np.zeros((count, 6)), plan.q, np.full(count, 1e4), plan.arrival)
    state = arm.solve_step(drive, [])
    arm.advance(drive)
    # the arrival leaves torque in the gears: settle the unloaded state with that history
    drive = Drive(state.torque, plan.q, np.zeros(count), plan.arrival)
    state = arm.solve_step(drive, [], state.posture)
    start, R_start = arm.find_tcp(state.posture)
    side = np.cross(plan.pull, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side, axis=1)[:, None]
    askew = compute_rotation(sensors.pulley * np.where(plan.pose % 2 == 0, 1.0, 0.6)[:, None] * side)
    direction = np.einsum("nij,nj->ni", askew, plan.pull)
    moved, forces, worst = [], [], 0.0
    for step, level in enumerate(LEVELS):
        drive = Drive(state.torque, plan.q, plan.durations[:, step], plan.arrival)
        load = PointLoad(arm.tool_body, robot.tcp + sensors.hook, level * direction)
        state = arm.solve_step(drive, [load], state.posture)
        arm.advance(drive)
        place, R = arm.find_tcp(state.posture)
        turn = 0.5 * _vee(R @ np.swapaxes(R_start, 1, 2))
        moved.append(np.concatenate([place - start, turn], 1))
        forces.append(load.force)
        worst = max(worst, state.residual)
    return np.stack(moved, 1), np.stack(forces, 1), worst


def _vee(R: np.ndarray) -> np.ndarray:
    return np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)


def observe_loads(
    robot: RobotDescription, plan: LoadPlan, moved: np.ndarray, forces: np.ndarray, sensors: SensorErrors
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement (C, L, 6) and force (C, L, 3) as instruments without noise show them.

    The sensor sits at the tool: its axes are the TCP's. The tracker's axes are the base's, turned by ``tracker_turn``.
    """
    axes = compute_tool_axes(robot, plan.q)
    local = np.einsum("nji,nlj->nli", axes, forces)
    mount = compute_rotation(sensors.force_turn)
    local = np.einsum("ij,nlj->nli", sensors.force_gain @ mount, local) + sensors.force_offset
    progress = _compute_progress(plan)
    local = local * (1.0 + sensors.gauge_drift * progress)[:, None, None]
    seen_force = np.einsum("nij,nlj->nli", axes, local)
    view = compute_rotation(sensors.tracker_turn)
    seen = np.concatenate([moved[..., :3] @ view.T, moved[..., 3:] @ view.T], axis=2)
    if sensors.tracker_drift:
        seen = seen + _list_tracker_drift(robot, plan, sensors.tracker_drift)
    if sensors.floor_tilt:
        tcp = compute_frames(robot, plan.q)[2][:, None]
        moment = np.cross(tcp, forces) * [1.0, 1.0, 0.0]
        turn = sensors.floor_tilt * moment
        seen = seen - np.concatenate([np.cross(turn, tcp - TRACKER_FOOT), turn], axis=2)
    return seen, seen_force


def _list_tracker_drift(robot: RobotDescription, plan: LoadPlan, drift: float) -> np.ndarray:
    """Return shifts (C, L, 6): the tracker turns during a cycle, faster in the morning and back after a knock."""
    tcp = compute_frames(robot, plan.q)[2]
    progress = _compute_progress(plan)
    rate = np.sin(7.0 * progress + 1.3 * plan.session)  # per cycle
    angle = drift * rate[:, None] * np.linspace(0.15, 1.0, len(LEVELS))
    shift = np.cross(np.array([0.2, 0.3, 0.93]), tcp - TRACKER_FOOT)[:, None, :] * angle[..., None]
    return np.concatenate([shift, np.zeros_like(shift)], axis=2)


def _compute_progress(plan: LoadPlan) -> np.ndarray:
    order = np.arange(len(plan.q), dtype=float)
    for session in (0, 1):
        rows = plan.session == session
        order[rows] = np.linspace(0.0, 1.0, int(rows.sum()))
    return order


def add_load_noise(
    robot: RobotDescription,
    plan: LoadPlan,
    seen: np.ndarray,
    force: np.ndarray,
    noise: NoiseLevels,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """Return noisy readings and the places (cycle, level) of gross outliers.

    Each pose is a tracker station with its own covariance: along the beam half as noisy as across it.
    """
    tcp = compute_frames(robot, plan.q)[2]
    beam = tcp - TRACKER_FOOT
    beam /= np.linalg.norm(beam, axis=1)[:, None]

    def draw(sigma: float, shape: tuple[int, ...], n: np.ndarray) -> np.ndarray:
        e = rng.normal(0.0, 1.155 * sigma, (*shape, 3))
        return e - 0.5 * np.sum(e * n, axis=-1, keepdims=True) * n  # r.m.s. a coordinate stays sigma within 1 %

    cycles, levels = force.shape[:2]
    out = seen.copy()
    out[..., :3] += draw(noise.white, (cycles, levels), beam[:, None]) + draw(noise.cycle, (cycles, 1), beam[:, None])
    out[..., 3:] += rng.normal(0.0, noise.rotation, (cycles, levels, 3))
    measured = force + rng.normal(0.0, 1.0, force.shape) * noise.force
    measured = measured * (1.0 + noise.force_share * rng.normal(size=(cycles, 1, 1)))
    wrong = [(int(c), int(k)) for c, k in np.argwhere(rng.random((cycles, levels)) < noise.outlier_share)]
    for c, k in wrong:
        out[c, k, :3] += rng.normal(0.0, 40.0 * noise.white, 3)
    return out, measured, wrong
