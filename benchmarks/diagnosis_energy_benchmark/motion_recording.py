"""Motions: joint torques by Newton and Euler in base axes, bristles by an exponential step, link-side encoders."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import coupled_drives
import dual_quaternions as dq
import elastic_arm
import gear_models
import numpy as np
from dual_quaternions import Array
from effect_strength import Effect, Named, NoiseFreeRecord
from instrument_noise import Instrument, errors
from pose_recording import linkage_torque
from recording_tables import Table
from robot_models import Robot

ARCMIN = np.pi / 10800
STEP = 0.02  # s
SHARP = 3e-4  # rad/s over which dry friction turns over: at once, for any sampled record


@dataclass(frozen=True)
class MotionLab:
    """Habits: what is recorded, how noisy."""

    name: str
    link: bool = False  # link-side encoders instead of torques
    amps: bool = False  # the drives' currents, and nobody knows what an ampere makes
    period: float = 16.0  # s of one cycle
    cycles: int = 3
    wander: float = 0.0
    tails: float = 8.0


MOTION_LABS = {
    lab.name: lab
    for lab in (
        MotionLab("torque"),
        MotionLab("torque_restless", wander=0.5, tails=4.0),
        MotionLab("link", link=True),
        MotionLab("amps", amps=True),
    )
}


class Motion:
    """The same smooth motion several times over."""

    channel = "torque"

    def __init__(self, nominal: Robot, built: Robot, lab: MotionLab, rng: np.random.Generator) -> None:
        self.nominal, self.built, self.lab = nominal, built, lab
        self.unit = "mrad" if lab.link else "N·m"
        t = STEP * np.arange(round(lab.period * lab.cycles / STEP))
        w = 2 * np.pi / lab.period
        q, qd, qdd = (np.zeros((len(t), 6)) for _ in range(3))
        for j in range(6):
            for k in range(1, 6):
                a = np.radians(32.0 if j in (0, 3, 5) else 16.0) / k * rng.normal()
                phase = rng.uniform(0, 2 * np.pi)
                q[:, j] += a * np.sin(k * w * t + phase)
                qd[:, j] += a * k * w * np.cos(k * w * t + phase)
                qdd[:, j] -= a * (k * w) ** 2 * np.sin(k * w * t + phase)
        self.t, self.q, self.qd, self.qdd = t, nominal.home + q, qd, qdd
        self.cycle = np.minimum((t / lab.period).astype(int), lab.cycles - 1)
        self.dynamic = newton_euler(nominal, self.q, qd, qdd)
        size = np.sqrt(np.mean(self.dynamic**2, axis=0))
        self.coulomb = 0.06 * np.max(size) * np.array([1, 1, 0.8, 0.3, 0.25, 0.2]) * rng.uniform(0.8, 1.2, 6)
        self.viscous = 0.6 * self.coulomb * rng.uniform(0.7, 1.3, 6)
        self.noise = 0.02 * size + 0.004 * np.max(size)
        self.per_ampere = np.ones(6)
        if lab.amps:  # N·m at the joint: the motor's constant times its gear
            self.per_ampere = rng.uniform(0.4, 1.6, 6) * rng.uniform(80, 260, 6)
        if lab.link:
            self.noise = np.full(6, 1.5e-5)  # rad, a good encoder
        none = np.zeros(len(t), dtype=int)
        self.script = elastic_arm.Script(self.q, np.zeros((len(t), 6)), t, none, none, none)

    def clean(self, effects: list[Effect]) -> NoiseFreeRecord:
        robot, q = self.built, self.q
        for e in effects:
            if e.effect == "payload":
                robot = _heavier(robot, e.amplitude)
        torque = self.dynamic if robot is self.built else newton_euler(robot, q, self.qd, self.qdd)
        y, base = self._link(effects, torque) if self.lab.link else self._torque(effects, torque)
        for e in effects:
            if e.effect == "time_skew":
                late = np.interp(self.t - e.amplitude, self.t, np.arange(len(self.t)))
                lower = np.clip(late.astype(int), 0, len(self.t) - 2)
                part = (late - lower)[:, None]
                own = q if self.lab.link else self.dynamic
                whole = y + own
                y = (1 - part) * whole[lower] + part * whole[lower + 1] - own
        sigma = np.broadcast_to(self.noise, y.shape).copy()
        return NoiseFreeRecord({}, y, base, sigma, np.zeros_like(sigma), np.arange(len(y)))

    def _torque(self, effects: list[Effect], torque: Array) -> tuple[Array, Array]:
        y = torque - self.dynamic
        slip = np.tanh(self.qd / SHARP)
        y = y + self.coulomb * slip + self.viscous * self.qd
        for e in effects:
            j = e.detail.get("joint", 1)
            if e.effect == "joint_friction":
                fc = self.coulomb[j] * (1 + 1.2 * e.amplitude * np.abs(torque[:, j]) / np.max(np.abs(torque[:, j])))
                own = bristles(self.qd[:, j], fc, 1 + e.amplitude, 0.06)
                y[:, j] += own - self.coulomb[j] * slip[:, j]
            elif e.effect == "gravity_compensator":
                angle = self.q[:, 1] - self.nominal.home[1] + e.detail["at"]
                y[:, 1] -= e.amplitude * linkage_torque(angle, float(np.max(np.abs(self.dynamic[:, 1]))))
            elif "shaft" in e.detail:
                i = e.detail["runs_through"]
                drive = (self.coulomb[j], self.viscous[j], e.detail["rotor"], SHARP)
                ratio = e.detail["sign"] * e.amplitude
                y += coupled_drives.compute_coupling_torque(
                    self.qd, self.qdd, torque, i, j, ratio, drive, by_motors=e.detail["by_motors"]
                )
            elif e.effect == "units":
                y[:, j] += e.detail["sign"] * e.amplitude * (y[:, j] + self.dynamic[:, j])
            elif "soft" in e.detail:  # every seal drags like honey at first
                y += self.coulomb * (np.tanh(self.qd / (0.005 * e.amplitude)) - slip)
            elif "rotor" in e.detail:
                y[:, j] += e.amplitude * self.noise[j] * self.qdd[:, j] / np.sqrt(np.mean(self.qdd[:, j] ** 2))
            elif "hose" in e.detail:
                x = self.q[:, j] - self.nominal.home[j]
                y[:, j] += (
                    e.amplitude * self.noise[j] * (np.maximum(x - 0.1, 0) ** 1.5 - np.maximum(-x - 0.2, 0) ** 2) * 8
                )
        # what an ampere makes is refitted where nobody knows it, and takes up much
        base = np.zeros((len(y), 6, 24 if self.lab.amps else 18))
        for j in range(6):
            base[:, j, j], base[:, j, 6 + j], base[:, j, 12 + j] = 1.0, slip[:, j], self.qd[:, j]
            if self.lab.amps:
                base[:, j, 18 + j] = self.dynamic[:, j]
        return y, base

    def _link(self, effects: list[Effect], torque: Array) -> tuple[Array, Array]:
        """Link side minus motor side, rad."""
        load = -torque
        y = load / self.built.stiffness
        for e in effects:
            j, d = e.detail.get("joint", 0), e.detail
            if e.effect == "joint_backlash":
                y[:, j] += gear_models.clearance(e.amplitude, d["drag"])(load[:, j], self.script)
            elif e.effect == "joint_hysteresis":
                y[:, j] += gear_models.dahl(e.amplitude, d["reach"], "kept")(load[:, j], self.script)
            elif e.effect == "joint_nonlinear_stiffness":
                soft = e.amplitude / self.built.stiffness[j]
                y[:, j] += gear_models.soft_start(soft, d["knee"])(load[:, j], self.script)
            elif e.effect == "transmission_error":
                x, n, phase = self.q[:, j], d["order"], d["phase"]
                y[:, j] += e.amplitude * (np.sin(n * x + phase) + 0.3 * np.sin(2 * n * x) + 0.15 * np.sin(x))
        base = np.zeros((len(y), 6, 12))
        for j in range(6):
            base[:, j, j], base[:, j, 6 + j] = load[:, j], 1.0
        return y, base

    def rivals(self, clean: NoiseFreeRecord) -> dict[Named, Array]:
        """None beyond the identities: joints are read one by one."""
        return {}


def draw(name: str, scene: Motion, rng: np.random.Generator, loud: float) -> list[Effect]:
    """Candidates at their places."""
    joints = [int(j) for j in rng.permutation([1, 2] if scene.lab.link else range(6))]
    out: list[Effect] = []
    swing = np.ptp(scene.dynamic, axis=0)
    for j in joints:
        where, width = f"joint:{j + 1}", ("arcmin", 1 / ARCMIN, "width")
        crosses = min(np.mean(scene.dynamic[:, j] > 0), np.mean(scene.dynamic[:, j] < 0)) > 0.1
        if name == "joint_friction":
            out.append(Effect(name, where, 0.4, 1.5, detail={"joint": j}))
        elif name == "joint_backlash" and (crosses or not scene.lab.link):
            out.append(Effect(name, where, 1e-4, 1e-3, *width, detail={"joint": j, "drag": 0.02 * swing[j]}))
        elif name == "joint_hysteresis":
            out.append(Effect(name, where, 1e-4, 1e-3, *width, detail={"joint": j, "reach": 0.25 * swing[j]}))
        elif name == "joint_nonlinear_stiffness":
            out.append(Effect(name, where, 0.4, 2.0, detail={"joint": j, "knee": 0.2 * swing[j]}))
        elif name == "transmission_error":
            detail = {"joint": j, "order": int(rng.choice([4, 12, 30])), "phase": rng.uniform(0, 6.28)}
            out.append(Effect(name, where, 5e-5, 1e-3, "arcsec", 648000 / np.pi, "amplitude", detail=detail))
        elif name == "torque_gain":
            sign = float(rng.choice([-1, 1]))
            column = f"column:tau{j + 1}_Nm"
            out.append(Effect("units", column, 0.1, 0.5, "%", 100.0, "gain", detail={"joint": j, "sign": sign}))
        elif name in ("rotor", "hose"):
            same = (("joint_elasticity", where),) if name == "rotor" else ()
            out.append(Effect("unnamed", where, 1.0, 20.0, accepted=same, detail={"joint": j, name: 1}))
    if name == "wrist":
        out = coupled_drives.wrists(scene.qdd, scene.coulomb, rng)
    if name == "soft_reversal":
        same = tuple(("joint_friction", f"joint:{j}") for j in range(1, 7))
        out = [Effect("unnamed", "arm", 1.0, 8.0, accepted=same, detail={"soft": 1})]
    elif name == "payload":
        out = [Effect(name, "tool", 0.2 * scene.built.tool_mass, 200.0, "kg", 1.0, "mass")]
    elif name == "gravity_compensator":
        out = [Effect(name, "joint:2", 0.2, 1.0, detail={"at": rng.uniform(-1, 1)})]
    elif name == "time_skew":
        sensor = "sensor:qse" if scene.lab.link else "sensor:tau"
        out = [Effect(name, sensor, 0.004, 0.1, "ms", 1e3, "late")]
    elif not out and name not in ("joint_backlash", "wrist"):  # play: none where weight keeps every gear on one side
        raise ValueError(f"{name}: no such effect of a motion")
    for one in out:
        one.loudness = loud
    return out


def newton_euler(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """(N, 6) N·m the joints must give, weights included; all vectors in base axes, bodies taken one by one."""
    frames = elastic_arm.chain(elastic_arm.ElasticArm(robot), q, {"joints": np.zeros_like(q)})
    n = len(q)
    omega, alpha, acceleration = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    acceleration[:, 2] = elastic_arm.GRAVITY  # the base is lifted instead of weights put on
    last = np.zeros((n, 3))
    pushes: list[tuple[Array, Array, Array]] = []  # place, force, moment of each body
    axes, places = [], []
    for i in range(6):
        R, p = dq.matrix(frames[f"link{i}"]), dq.place(frames[f"link{i}"])
        r = p - last
        acceleration = acceleration + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
        z = R @ robot.axes[i]
        alpha = alpha + z * qdd[:, [i]] + np.cross(omega, z * qd[:, [i]])
        omega = omega + z * qd[:, [i]]
        last = p
        bodies = [(robot.masses[i], R @ robot.centres[i], R @ robot.inertias[i] @ np.swapaxes(R, 1, 2))]
        if i == 5:
            F = dq.matrix(frames["flange"])
            tool = dq.place(frames["flange"]) - p + F @ robot.tool_centre
            bodies.append((robot.tool_mass, tool, np.zeros((n, 3, 3))))
        for mass, c, I in bodies:  # noqa: E741 - the inertia's own letter
            force = mass * (acceleration + np.cross(alpha, c) + np.cross(omega, np.cross(omega, c)))
            spin = np.einsum("nij,nj->ni", I, omega)
            pushes.append((p + c, force, np.einsum("nij,nj->ni", I, alpha) + np.cross(omega, spin)))
        axes.append((z, len(pushes) - len(bodies)))
        places.append(p)
    out = np.zeros((n, 6))
    for j, (z, first) in enumerate(axes):
        total = sum((np.cross(at - places[j], f) + m for at, f, m in pushes[first:]), np.zeros((n, 3)))
        out[:, j] = np.sum(z * total, axis=1)
    return out


def bristles(speed: Array, slide: Array, stick: float, stribeck: float) -> Array:
    """(N,) LuGre friction without its damping: z' = v - |v| z / g, exact over a step of constant speed.

    ``slide`` (N,) N·m sliding friction, ``stick`` times it at rest, fading over ``stribeck`` rad/s. Source: Canudas de
    Wit et al., IEEE Trans. Automatic Control 40 (1995) 419.
    """
    g = slide * (1 + (stick - 1) * np.exp(-((speed / stribeck) ** 2)))
    rigid = float(np.mean(slide)) / 3e-4  # N·m/rad: presliding over a third of a milliradian
    out, z = np.zeros_like(speed), 0.0
    for k, v in enumerate(speed):
        goal = np.sign(v) * g[k] / rigid
        z = goal + (z - goal) * np.exp(-abs(v) * STEP * rigid / g[k])
        out[k] = rigid * z
    return out


def _heavier(robot: Robot, mass: float) -> Robot:
    return replace(robot, tool_mass=robot.tool_mass + mass)


def motion_table(scene: Motion, clean: NoiseFreeRecord, rng: np.random.Generator) -> Table:
    """The recording with its noise."""
    lab, n = scene.lab, len(clean.y)
    kind = Instrument(1.0, tails=lab.tails, wander=lab.wander, memory=4.0)
    read = clean.y + scene.noise * errors(kind, np.arange(n), 6, rng)
    out: dict[str, Array] = {"cycle": scene.cycle + 1, "session": np.ones(n, dtype=int), "time_s": np.round(scene.t, 3)}
    out |= {f"q{j + 1}_deg": np.round(np.degrees(scene.q[:, j]), 5) for j in range(6)}
    out |= {f"qd{j + 1}_deg_s": np.round(np.degrees(scene.qd[:, j]), 5) for j in range(6)}
    if lab.link:
        out |= {f"qse{j + 1}_deg": np.round(np.degrees(scene.q[:, j] + read[:, j]), 6) for j in range(6)}
    else:
        whole = (scene.dynamic + read) / scene.per_ampere
        out |= {f"current{j + 1}_A" if lab.amps else f"tau{j + 1}_Nm": np.round(whole[:, j], 4) for j in range(6)}
    about: dict[str, Any] = {"machopt_recording": 1, "kind": "motion", "data": "data.csv"}
    scale = 1e3 if lab.link else 1.0
    return Table(out, about, [], scale * float(np.sqrt(np.mean(scene.noise**2))))


def motion_measured(scene: Motion, table: Table) -> Array:
    """(N, 6) as ``y`` of the clean record."""
    if scene.lab.link:
        return np.stack([np.radians(table.columns[f"qse{j + 1}_deg"]) for j in range(6)], axis=1) - scene.q
    name = "current{}_A" if scene.lab.amps else "tau{}_Nm"
    whole = np.stack([table.columns[name.format(j + 1)] for j in range(6)], axis=1)
    return whole * scene.per_ampere - scene.dynamic
