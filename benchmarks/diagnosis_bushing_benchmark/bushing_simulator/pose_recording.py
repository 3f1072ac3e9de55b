"""A set of measured poses: reflectors on the flange seen by a tracker, with weight, arrival history and heat.

Each pose is visited once in each of two sessions, in another order, from another direction.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bushing_simulator.gear_laws import Drive
from bushing_simulator.reference_kinematics import compute_frames
from bushing_simulator.robot_assembly import HiddenPhysics, assemble_arm
from bushing_simulator.robot_descriptions import RobotDescription
from bushing_simulator.rotations import compute_rpy_rotation


@dataclass(frozen=True)
class PosePlan:
    """Visits in the order of time."""

    q: np.ndarray  # (V, 6) rad
    pose: np.ndarray  # (V,)
    session: np.ndarray  # (V,)
    time: np.ndarray  # (V,) s from the start of the session
    arrival: np.ndarray  # (V, 6) ±1
    targets: np.ndarray  # (T, 3) m, nominal places in the flange
    fit: bool  # registration: fit
    tracker: tuple[np.ndarray, np.ndarray]  # rotation (3, 3) and place (3,) of the tracker in the base


@dataclass(frozen=True)
class PoseErrors:
    """Systematic errors that the cell does not state."""

    heat: float = 0.0  # scale of thermal growth
    target_shift: np.ndarray | None = None  # (T, 3) m, true minus nominal
    tracker_knock: float = 0.0  # m, the tracker is knocked twice
    air: float = 0.0  # m, refraction by a warm plume, in part of the hall
    cable: float = 0.0  # m, dragged cable pulls the wrist, depends on the previous pose
    worn_seat: float = 0.0  # m, the flange bolts slip when the wrist turns over


@dataclass(frozen=True)
class PoseNoise:
    """Random errors, 1 sigma."""

    white: float = 10e-6  # m
    visit: float = 18e-6  # m, return to a pose, shared by the reflectors
    session: float = 4e-6  # m, base frame between sessions
    outlier_share: float = 0.0


@dataclass(frozen=True)
class HeatModel:
    """Two time constants a link: motor heat and casting."""

    times: tuple[float, float] = (900.0, 5400.0)  # s
    rise: np.ndarray = field(default_factory=lambda: np.array([6.0, 9.0, 8.0, 12.0, 9.0, 5.0]))  # K of each link
    expansion: float = 1.2e-5  # 1/K


def draw_pose_plan(robot: RobotDescription, rng: np.random.Generator, poses: int, fit: bool) -> PosePlan:
    """Return random poses inside the limits, three reflectors where the registration is fitted, else the TCP."""
    angles = []
    while len(angles) < poses:
        share = rng.uniform(0.08, 0.92, 6)
        q = np.deg2rad(robot.limits_deg[:, 0] + share * np.diff(robot.limits_deg)[:, 0])
        q[0], q[3], q[5] = rng.uniform(-2.2, 2.2), rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0)
        places, _, tcp, _ = compute_frames(robot, q[None])
        if tcp[0, 2] > 0.2 and places[0, 4:, 2].min() > 0.3 and np.hypot(*tcp[0, :2]) > 0.5:
            angles.append(q)
    order = np.concatenate([rng.permutation(poses), rng.permutation(poses)])
    q = np.array(angles)[order]
    before = np.concatenate([q[:1] * 0.5, q[:-1]])
    arrival = np.where(q - before >= 0, 1.0, -1.0)
    time = np.concatenate([np.cumsum(rng.uniform(25, 70, poses)), np.cumsum(rng.uniform(25, 70, poses))])
    targets = np.array([[0.15, 0.02, 0.2], [-0.11, 0.12, 0.1], [0.02, -0.14, 0.28]]) if fit else robot.tcp[None]
    turn = compute_rpy_rotation(np.array([0.01, -0.02, rng.uniform(-3, 3)]))
    place = np.array([rng.uniform(2.5, 4.0), rng.uniform(-3.0, 3.0), rng.uniform(0.5, 1.5)])
    return PosePlan(q, order, np.repeat([0, 1], poses), time, arrival, targets, fit, (turn, place))


def compute_growth(
    robot: RobotDescription, plan: PosePlan, arm_bodies: list, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return growth of marker positions (V, B, 3) in m and the air-side temperature (V,) that a gauge shows."""
    heat = HeatModel()
    growth = np.zeros((len(plan.q), len(arm_bodies), 3))
    fast, slow = (1.0 - np.exp(-plan.time / t) for t in heat.times)
    for index, body in enumerate(arm_bodies):
        if index < 2:
            continue
        link = max(b.joint for b in arm_bodies[:index])
        share = 0.35 + 0.08 * link
        rise = scale * heat.rise[link] * (share * fast + (1.0 - share) * slow)
        growth[:, index] = heat.expansion * rise[:, None] * body.marker_position
    gauge = 22.0 + (scale > 0) * min(scale, 2.0) * 6.0 * (0.5 * fast + 0.5 * slow)
    return growth, gauge


def compute_pose_response(
    robot: RobotDescription, hidden: HiddenPhysics, plan: PosePlan, errors: PoseErrors
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return true places (V, T, 3) of the reflectors in the base, the gauge (V,) in °C, and the residual in N."""
    arm = assemble_arm(robot, hidden)
    count = len(plan.q)
    arm.reset(count)
    growth, gauge = compute_growth(robot, plan, arm.chain.bodies, errors.heat)
    growth_used = growth if errors.heat else None
    drive = Drive(np.zeros((count, 6)), plan.q, np.full(count, 1e4), plan.arrival)
    state = arm.solve_step(drive, [], None, growth_used)
    arm.advance(drive)
    drive = Drive(state.torque, plan.q, np.zeros(count), plan.arrival)
    state = arm.solve_step(drive, [], state.posture, growth_used)
    shift = errors.target_shift if errors.target_shift is not None else np.zeros_like(plan.targets)
    seen = np.stack([arm.find_tcp(state.posture, t)[0] for t in plan.targets + shift], axis=1)
    return seen + _list_outside_shifts(plan, errors, seen), gauge, state.residual


def _list_outside_shifts(plan: PosePlan, errors: PoseErrors, seen: np.ndarray) -> np.ndarray:
    """Return shifts (V, T, 3) of effects that no catalogue has."""
    shift = np.zeros_like(seen)
    center = seen.mean(axis=1, keepdims=True)
    if errors.tracker_knock:
        late = plan.time / plan.time.max()
        for when, turn in ((0.35, [0.4, -0.7, 0.5]), (0.7, [-0.6, 0.1, -0.9])):
            shift += errors.tracker_knock * (late > when)[:, None, None] * np.cross(turn, seen - [2.0, 1.0, 0.0])
    if errors.air:
        plume = np.exp(-np.sum(((center - np.array([1.1, 0.8, 1.4])) / [0.5, 0.5, 0.7]) ** 2, axis=2, keepdims=True))
        shift += errors.air * plume * np.array([0.2, 0.5, 0.84])
    if errors.cable:
        before = np.concatenate([center[:1], center[:-1]])
        drag = before - center
        shift += errors.cable * drag / (0.4 + np.linalg.norm(drag, axis=2, keepdims=True))
    if errors.worn_seat:
        over = np.tanh(4.0 * np.sin(plan.q[:, 3] + 0.6) * np.cos(plan.q[:, 4]))
        shift += errors.worn_seat * over[:, None, None] * np.array([0.5, -0.6, 0.62])
    return shift


def observe_poses(plan: PosePlan, places: np.ndarray) -> np.ndarray:
    """Return places (V, T, 3) in the frame in which they are recorded: the tracker's own, or the base."""
    if not plan.fit:
        return places
    R, p = plan.tracker
    return (places - p) @ R


def add_pose_noise(
    plan: PosePlan, seen: np.ndarray, noise: PoseNoise, rng: np.random.Generator
) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Return noisy places and the outliers (visit, reflector). Each station has its own covariance along the beam."""
    place = seen if plan.fit else seen - plan.tracker[1]
    beam = place / np.linalg.norm(place, axis=2, keepdims=True)
    e = rng.normal(0.0, 1.155 * noise.white, seen.shape)
    e -= 0.5 * np.sum(e * beam, axis=2, keepdims=True) * beam
    back = rng.normal(0.0, noise.visit, (len(seen), 1, 3))
    drift = rng.normal(0.0, noise.session, (2, 1, 3))[plan.session]
    wrong = [(int(v), int(t)) for v, t in np.argwhere(rng.random(seen.shape[:2]) < noise.outlier_share)]
    out = seen + e + back + drift
    for v, t in wrong:
        out[v, t] += rng.normal(0.0, 60.0 * noise.white, 3)
    return out, wrong


def list_rotation_columns(places: np.ndarray) -> np.ndarray:
    """Return the six columns (V, T, 3, 6) of a frame: shift and small rotation."""
    columns = np.zeros((*places.shape, 6))
    columns[..., :3] = np.eye(3)
    for k in range(3):
        columns[..., 3 + k] = np.cross(np.eye(3)[k], places)
    return columns
