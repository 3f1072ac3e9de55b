"""Load tests and measured poses of a simulated arm with effects that the catalogue implements differently or lacks.

The arm is read from its URDF here. Its pose is the nonlinear equilibrium under load and weight (fixed point of twists
and torques), and its links bend at hinges. Gears slip element by element (Iwan), creep with the logarithm of time, and
stiffen along a sine.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from machopt.data_types.measurements.recording import Recording, StandardUncertainty

CELLS = Path(__file__).resolve().parent.parent / "cells"
ARCMIN = np.pi / 10800
GRAVITY = np.array([0.0, 0.0, -9.80665])
SETTLED = 8  # iterations; each reduces the error by a factor of about 100, from 5 mm to zero
Array = np.ndarray
Twist = Callable[
    [Array, Array, Array], Array
]  # torque (T,), own angle (T,), time (T,) in order → rad in addition to the spring


@dataclass(frozen=True)
class Arm:
    """Six revolute joints between base_link and flange."""

    origin: Array  # (6, 4, 4) of each joint in the preceding body
    axis: Array  # (6, 3)
    flange: Array  # (4, 4) in the last body
    tcp: Array  # (4, 4) in the flange
    mass: Array  # (7,) kg, bodies 1…6 and tool
    com: Array  # (7, 3) m in body or flange
    lower: Array  # (6,) rad
    upper: Array
    nominal: Array  # (6,) N·m/rad
    home: Array  # (6,) rad


@dataclass(frozen=True)
class HiddenEffects:
    """Effects that the nominal model lacks; none by default."""

    stiffness: Array  # (6,) N·m/rad
    twist: dict[int, Twist] = field(default_factory=dict)  # 0-based joint → law
    coupled: Array = field(default_factory=lambda: np.zeros((6, 6)))  # rad/(N·m) between joints
    hinges: dict[int, Array] = field(default_factory=dict)  # 0 base, 1…6 link, 7 tool → (3, 3) rad/(N·m) in its axes
    zero: Array = field(default_factory=lambda: np.zeros(6))  # rad, not shown by the encoders
    tool_mass: float = 0.0  # kg in addition to the stated mass
    recorded: Array = field(default_factory=lambda: np.eye(6))  # matrix from the true to the recorded wrench
    hook: Array = field(default_factory=lambda: np.zeros(3))  # m in the flange: offset of the load point from the TCP
    shown: Array = field(default_factory=lambda: np.eye(3))  # matrix from the true to the recorded displacement


@dataclass(frozen=True)
class NoiseLevels:
    """Noise levels, 1 sigma."""

    white: float = 15e-6  # m
    cycle: float = 10e-6
    visit: float = 12e-6
    gain_session: float = 0.007
    gain_cycle: float = 0.004
    outliers: float = 0.01  # share
    per_metre: float = 2.0  # rad of rotation noise per m of translation noise


@dataclass(frozen=True)
class Plan:
    """States in the order of measurement; the first of each cycle is unloaded."""

    q: Array  # (T, 6)
    wrench: Array  # (T, 6) base axes at the TCP
    pose: Array  # (T,)
    session: Array
    cycle: Array  # (T,) numbered over all visits
    time: Array  # (T,) s
    loaded: Array  # (T,) bool
    rising: Array  # (T,) bool


@cache
def arm(cell: str | Path = "kr240_drilling") -> Arm:
    """Read a cell folder."""
    folder = CELLS / cell
    words = YAML(typ="safe", pure=True).load(folder / "cell.yaml")
    stiffness = YAML(typ="safe", pure=True).load(folder / words["stiffness"])
    root = ET.parse(folder / words["robot"]["urdf"]).getroot()
    joints = {j.find("child").get("link"): j for j in root.iter("joint")}
    links = {x.get("name"): x for x in root.iter("link")}
    chain, at = [], words["robot"].get("flange_link", "flange")
    while at != words["robot"].get("base_link", "base_link"):
        chain.append(joints[at])
        at = joints[at].find("parent").get("link")
    origin, axis, lower, upper, mass, com = [], [], [], [], [], []
    T = np.eye(4)
    for j in reversed(chain):
        o = j.find("origin")
        T = T @ _frame(_numbers(o.get("xyz", "0 0 0")), _numbers(o.get("rpy", "0 0 0")))
        if j.get("type") == "fixed":
            continue
        origin.append(T)
        axis.append(_numbers(j.find("axis").get("xyz")))
        lower.append(float(j.find("limit").get("lower")))
        upper.append(float(j.find("limit").get("upper")))
        inertial = links[j.find("child").get("link")].find("inertial")
        mass.append(0.0 if inertial is None else float(inertial.find("mass").get("value")))
        com.append(np.zeros(3) if inertial is None else _numbers(inertial.find("origin").get("xyz")))
        T = np.eye(4)
    tool = words["tool"]
    tcp = _frame(np.array(tool["tcp"]["xyz_mm"]) / 1e3, np.radians(tool["tcp"]["rpy_deg"]))
    return Arm(
        np.array(origin),
        np.array(axis) / np.linalg.norm(axis, axis=1)[:, None],
        T,
        tcp,
        np.array([*mass, tool["mass_kg"]]),
        np.array([*com, np.array(tool["com_mm"]) / 1e3]),
        np.array(lower),
        np.array(upper),
        np.array(stiffness["joints_Nm_per_rad"], float),
        np.radians(words["robot"]["home_deg"]),
    )


def plan_load_tests(
    a: Arm,
    rng: np.random.Generator,
    *,
    poses: int = 16,
    sessions: int = 2,
    loads: int = 4,
    directions: int = 2,
    force: float = 1500.0,
    moment: float = 0.0,
    spread: float = 1.0,
) -> Plan:
    """Plan postures around home; at each, cycles in random directions with equal loading and unloading steps; poses
    in random order."""
    reach = spread * np.radians([60, 28, 35, 90, 45, 120])
    q = np.clip(a.home + rng.uniform(-1, 1, (poses, 6)) * reach, a.lower + 0.05, a.upper - 0.05)
    way = rng.standard_normal((poses, directions, 6))
    for part, size in ((slice(0, 3), force), (slice(3, 6), moment)):
        way[..., part] *= size / np.linalg.norm(way[..., part], axis=-1, keepdims=True)
    up = np.arange(1, loads + 1) / loads
    steps = np.concatenate([[0.0], up, up[-2::-1]])
    rows: list[tuple[int, int, int, float, bool, bool]] = []
    wrench, cycle, clock = [], 0, 0.0
    for s in range(sessions):
        clock += 20 * 3600.0
        for p in rng.permutation(poses):
            clock += rng.uniform(60, 150)
            for k in range(directions):
                clock += rng.uniform(20, 40)
                for n, step in enumerate(steps):
                    clock += rng.uniform(8, 20)
                    rows.append((p, s, cycle, clock, n > 0, n <= loads))
                    wrench.append(step * way[p, k])
                cycle += 1
    pose, session, label, time, loaded, rising = (np.array(c) for c in zip(*rows, strict=True))
    return Plan(q[pose], np.array(wrench), pose, session, label, time, loaded, rising)


def solve_equilibrium(a: Arm, truth: HiddenEffects, plan: Plan) -> tuple[Array, Array, Array, Array]:
    """Return TCP (T, 3) and its rotation (T, 3, 3) in equilibrium with load and weight, Jacobian (T, 6, 6) and
    torques (T, 6)."""
    T = len(plan.q)
    theta = plan.q + truth.zero
    bend = {k: np.zeros((T, 3)) for k in truth.hinges}
    mass = a.mass.copy()
    mass[6] += truth.tool_mass
    for _ in range(SETTLED):
        R, p, tcp, turn, heavy, hinge = _chain(a, theta, bend)
        along = np.einsum("tjik,jk->tji", R, a.axis)
        at = tcp + np.einsum("tij,j->ti", turn @ a.tcp[:3, :3].T, truth.hook)

        def moment(point: Array, first: int, at: Array = at, heavy: Array = heavy) -> Array:
            out = plan.wrench[:, 3:] + np.cross(at - point, plan.wrench[:, :3])
            for b in range(first, 7):
                out = out + mass[b] * np.cross(heavy[:, b] - point, GRAVITY)
            return out

        tau = np.stack([np.sum(along[:, j] * moment(p[:, j], j), axis=1) for j in range(6)], axis=1)
        theta = plan.q + truth.zero + tau / truth.stiffness + tau @ truth.coupled
        for j, law in truth.twist.items():
            theta[:, j] += law(tau[:, j], plan.q[:, j], plan.time)
        for k, C in truth.hinges.items():
            turned, point = hinge[k]
            here = np.einsum("tji,tj->ti", turned, moment(point, max(k - 1, 0)))
            bend[k] = here @ C.T
    J = np.concatenate([np.cross(along, tcp[:, None] - p), along], axis=2)
    return tcp, turn, np.swapaxes(J, 1, 2), tau


def load_tests(
    a: Arm,
    truth: HiddenEffects,
    plan: Plan,
    rng: np.random.Generator,
    dirt: NoiseLevels = NoiseLevels(),
    *,
    rotations: bool = False,
    frame: str = "base",
) -> Recording:
    """Return the recording of a tracker and a force sensor."""
    exact = compute_displacements(a, truth, plan, rotations=rotations)
    rows = np.flatnonzero(plan.loaded)
    N, D = len(rows), exact.shape[1]
    size = np.array([1, 1, 1, dirt.per_metre, dirt.per_metre, dirt.per_metre])[:D]
    visit = np.unique(np.stack([plan.session, plan.pose]), axis=1, return_inverse=True)[1].reshape(-1)
    d = exact @ np.kron(np.eye(D // 3), truth.shown).T + dirt.white * size * rng.standard_normal((N, D))
    d += (dirt.cycle * size * rng.standard_normal((plan.cycle.max() + 1, D)))[plan.cycle[rows]]
    d += (dirt.visit * size * rng.standard_normal((visit.max() + 1, D)))[visit[rows]]
    gain = dirt.gain_session * rng.standard_normal(plan.session.max() + 1)[plan.session[rows]]
    gain = gain + dirt.gain_cycle * rng.standard_normal(plan.cycle.max() + 1)[plan.cycle[rows]]
    _, turn, _, _ = solve_equilibrium(a, HiddenEffects(truth.stiffness), plan)
    to_tool = np.swapaxes(turn[rows], 1, 2)
    w = _blocks(to_tool, plan.wrench[rows]) @ truth.recorded.T  # the sensor rotates with the tool
    w = w * (1.0 + gain[:, None])
    w = w if frame == "tool" else _blocks(turn[rows], w)
    w[:, 3:] *= np.abs(plan.wrench[:, 3:]).max() > 0  # zero if no moment is applied
    for n in np.flatnonzero(rng.random(N) < dirt.outliers):
        d[n, :3] += 0.4e-3 * rng.standard_normal(3)
    return Recording(
        kind="deflection",
        source="made up",
        q=plan.q[rows],
        pose=plan.pose[rows],
        cycle=plan.cycle[rows],
        session=plan.session[rows],
        line=np.arange(2, N + 2),
        wrench=w,
        wrench_frame=frame,  # type: ignore[arg-type]
        displacement=d,
        time=plan.time[rows],
        branch=np.where(plan.rising[rows], 1, -1).astype(np.int8),
        stated_labels=frozenset({"pose", "cycle", "session"}),
        uncertainty=StandardUncertainty(
            displacement=dirt.white, rotation=dirt.per_metre * dirt.white if rotations else None
        ),
    )


def compute_displacements(a: Arm, truth: HiddenEffects, plan: Plan, *, rotations: bool = False) -> Array:
    """Return the displacements (N, D) in m and rad of the loaded states relative to the unloaded state of their
    cycle, without errors."""
    p, R, _, _ = solve_equilibrium(a, truth, plan)
    first = np.maximum.accumulate(np.where(plan.loaded, 0, np.arange(len(p))))
    rows = np.flatnonzero(plan.loaded)
    d = p[rows] - p[first[rows]]
    if not rotations:
        return d
    return np.concatenate([d, _vector(R[rows] @ np.swapaxes(R[first[rows]], 1, 2))], axis=1)


def compute_unmodelled_rms(a: Arm, truth: HiddenEffects, plan: Plan) -> float:
    """Return the r.m.s. residual per coordinate (m) that an ideal refit of the six springs leaves of the hidden
    effects."""
    plain = HiddenEffects(truth.stiffness)
    base = compute_displacements(a, plain, plan)
    _, turn, J, _ = solve_equilibrium(a, plain, plan)
    turn, J, w = turn[plan.loaded], J[plan.loaded], plan.wrench[plan.loaded]
    sensed = _blocks(turn, _blocks(np.swapaxes(turn, 1, 2), w) @ truth.recorded.T)
    more = compute_displacements(a, truth, plan) - base + base @ (truth.shown - np.eye(3)).T
    more = more - np.einsum("tci,tki,tk->tc", J[:, :3] / truth.stiffness, J, sensed - w)
    A = (J[:, :3] * np.einsum("tki,tk->ti", J, w)[:, None, :]).reshape(-1, 6)
    A = A / np.linalg.norm(A, axis=0)
    return float(np.sqrt(np.mean((more.reshape(-1) - A @ np.linalg.lstsq(A, more.reshape(-1), rcond=None)[0]) ** 2)))


def build_iwan_law(c: float, largest: float, elements: int = 14) -> Twist:
    """Return an Iwan law: parallel springs with sliders; c rad/(N·m) is their additional compliance when all slide."""
    force = largest * np.linspace(0.06, 0.9, elements) / elements
    stiff = 6.0 / (c * elements)

    def law(tau: Array, q: Array, time: Array) -> Array:
        at, slid, out = 0.0, np.zeros(elements), np.empty(len(tau))
        for n, t in enumerate(tau):
            for _ in range(30):  # Newton iteration on an increasing, piecewise linear torque
                pull = stiff * (at - slid)
                f = np.clip(pull, -force, force).sum() + at / (2.0 * c) - t
                slope = stiff * np.sum(np.abs(pull) < force) + 1.0 / (2.0 * c)
                at -= f / slope
                if abs(f) < 1e-9 * largest:
                    break
            pull = stiff * (at - slid)
            slid = np.where(pull > force, at - force / stiff, np.where(pull < -force, at + force / stiff, slid))
            out[n] = at
        return out

    return law


def sine_knee(c: float, knee: float) -> Twist:
    """Return a law that is compliant at zero torque; its additional compliance falls along a cosine to zero at the
    knee torque."""
    return lambda tau, q, time: np.where(
        np.abs(tau) < knee, 0.5 * c * (tau + knee / np.pi * np.sin(np.pi * tau / knee)), 0.5 * c * knee * np.sign(tau)
    )


def build_rough_backlash(width: float, rough: float) -> Twist:
    """Return a law of backlash with rough flanks: half the width to either side, approached as τ/√(τ² + rough²)."""
    return lambda tau, q, time: 0.5 * width * tau / np.sqrt(tau**2 + rough**2)


def build_triangle_wave_compliance(c: float, slope: float, phase: float) -> Twist:
    """Return a compliance that varies along a triangle wave of the joint's own angle."""
    return lambda tau, q, time: c * tau * (2 / np.pi) * np.arcsin(0.999 * np.sin(slope * q + phase))


def build_logarithmic_creep(c: float, start: float = 5.0) -> Twist:
    """Return a law of creep with the logarithm of time since each change of load; changes older than an hour are
    ignored."""

    def law(tau: Array, q: Array, time: Array) -> Array:
        age = time[:, None] - time[None, :] + 8.0
        step = np.diff(tau, prepend=tau[0])
        there = (age > 0) & (age < 3600.0)
        return c * np.where(there, np.log1p(np.maximum(age, 0.0) / start), 0.0) @ step / np.log1p(60.0 / start)

    return law


def _chain(a: Arm, theta: Array, bend: dict[int, Array]) -> tuple[Array, Array, Array, Array, Array, dict[int, tuple]]:
    """Return joint frames R (T, 6, 3, 3) and points p (T, 6, 3), TCP, its rotation, centres of mass (T, 7, 3) and
    hinges."""
    T = len(theta)
    R, p = np.broadcast_to(np.eye(3), (T, 3, 3)), np.zeros((T, 3))
    frames, points, heavy, hinge = [], [], [], {}

    def bent(k: int, R: Array, point: Array) -> Array:
        if k not in bend:
            return R
        hinge[k] = (R, point)
        return R @ _build_rotations(bend[k])

    R = bent(0, R, p)
    for j in range(6):
        p = p + R @ a.origin[j, :3, 3]
        R = R @ a.origin[j, :3, :3]
        frames.append(R)
        points.append(p)
        R = R @ _build_rotations(theta[:, j, None] * a.axis[j])
        heavy.append(p + R @ a.com[j])
        onward = a.origin[j + 1] if j < 5 else a.flange
        middle = p + R @ (0.6 * onward[:3, 3])
        after = bent(j + 1, R, middle)
        p, R = middle - after @ (0.6 * onward[:3, 3]), after
    p, R = p + R @ a.flange[:3, 3], R @ a.flange[:3, :3]
    R = bent(7, R, p)
    heavy.append(p + R @ a.com[6])
    tcp, turn = p + R @ a.tcp[:3, 3], R @ a.tcp[:3, :3]
    return np.stack(frames, 1), np.stack(points, 1), tcp, turn, np.stack(heavy, 1), hinge


def _build_rotations(v: Array) -> Array:
    """Return the rotation matrices (T, 3, 3) of rotation vectors (Rodrigues)."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    K = np.zeros((len(v), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    K -= np.swapaxes(K, 1, 2)
    safe = np.where(angle > 1e-9, angle, 1.0)
    return (
        np.eye(3)
        + np.where(angle > 1e-9, np.sin(angle) / safe, 1.0) * K
        + np.where(angle > 1e-9, (1 - np.cos(angle)) / safe**2, 0.5) * (K @ K)
    )


def _vector(R: Array) -> Array:
    """Return the rotation vectors (T, 3) of small rotations."""
    return 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)


def _blocks(R: Array, v: Array) -> Array:
    return np.concatenate([np.einsum("tij,tj->ti", R, v[:, k : k + 3]) for k in (0, 3)], axis=1)


def _numbers(text: str) -> Array:
    return np.array([float(x) for x in text.split()])


def _frame(xyz: Array, rpy: Array) -> Array:
    T = np.eye(4)
    for axis in (2, 1, 0):  # yaw, pitch, roll: fixed axes
        T[:3, :3] = T[:3, :3] @ _build_rotations(rpy[axis] * np.eye(3)[None, axis])[0]
    T[:3, 3] = xyz
    return T
