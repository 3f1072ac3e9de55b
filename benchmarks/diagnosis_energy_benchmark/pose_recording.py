"""Measured poses: the arm without process load, read by a tracker that stands somewhere or was set to the base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import body_compliance
import dual_quaternions as dq
import elastic_arm
import gear_models
import numpy as np
from dual_quaternions import Array
from effect_strength import Effect, Named, NoiseFreeRecord
from instrument_noise import Instrument, errors, rounded
from loading_rig import joint_columns
from recording_tables import Table
from rival_columns import PAIRS, beam_parts, through
from robot_models import SPREAD, Robot

ARCMIN = np.pi / 10800
MASS, COM = 1.0, 0.1  # kg, m: one unit of payload


@dataclass(frozen=True)
class PoseLab:
    """Habits: how many poses and days, whose frame, what is read."""

    name: str
    poses: int = 60
    sessions: int = 2
    fit: bool = True
    turning: bool = False
    reading: Instrument = Instrument(0.025)  # noqa: RUF009 - frozen; mm, the arm's return included
    rotation: float = 0.03  # mrad
    temperature: bool = True
    stated: bool = True
    reflectors: int = 0  # nests on the flange, read one after the other at each arrival; none: a ball at the TCP
    stands: int = 1  # of the tracker, one session after the other


POSE_LABS = {
    lab.name: lab
    for lab in (
        PoseLab("fit"),
        PoseLab("fixed", fit=False),
        PoseLab("fit_6d", turning=True, poses=45),
        PoseLab("fixed_once", fit=False, sessions=1, poses=110, temperature=False),
        PoseLab("fit_crude", poses=90, reading=Instrument(0.045, tails=4.0, step=0.01), stated=False),
        PoseLab("fixed_few", fit=False, poses=14, sessions=3),
        PoseLab("reflectors", poses=40, reflectors=3),
        PoseLab("reflectors_moved", poses=40, reflectors=4, stands=2),
    )
}


class PoseSet:
    """One set of poses; ``clean`` reads it again with other things concealed."""

    channel = "position"
    unit = "mm"

    def __init__(self, nominal: Robot, built: Robot, lab: PoseLab, rng: np.random.Generator) -> None:
        self.nominal, self.built, self.lab = nominal, built, lab
        spread = 1.2 * np.radians(SPREAD)
        poses = np.round(nominal.home + rng.uniform(-1, 1, (lab.poses, 6)) * spread, 6)
        order = np.concatenate([rng.permutation(lab.poses) for _ in range(lab.sessions)])
        each = max(lab.reflectors, 1)
        order = np.repeat(order, each)
        n = len(order)
        session = np.repeat(np.arange(lab.sessions), lab.poses * each)
        self.target = np.tile(np.arange(each), n // each)
        self.arrival = np.repeat(np.arange(n // each), each)
        time = 40.0 * np.arange(n) * rng.uniform(0.95, 1.05, n) + 60000.0 * session
        self.pose = order
        self.script = elastic_arm.Script(poses[order], np.zeros((n, 6)), time, np.arange(n), np.arange(n), session)
        self.rigid = elastic_arm.chain(elastic_arm.ElasticArm(nominal), self.script.q, {"joints": np.zeros((n, 6))})
        # the lab's own refit of the springs is exact: everything is counted from the arm with nothing concealed
        self.quiet, self.torque = elastic_arm.solve_rest_states(elastic_arm.ElasticArm(built), self.script)
        # where the tracker stands, and where its reflector really sits: 0.4 mm from the drawing
        self.tracker = dq.twist(np.r_[rng.uniform(-3, 3, 3), rng.normal(0, 0.6, 3)])
        self.nest = rng.normal(0, 2.5e-4, 3) if lab.fit else np.zeros(3)
        self.stand = session % lab.stands
        self.trackers = [self.tracker]
        if (
            lab.reflectors
        ):  # a tracker somewhere in the hall, in its own axes; nests on a plate, 0.3 mm from the drawing
            self.trackers = [
                dq.twist(np.r_[rng.uniform(-4, 4, 3), rng.uniform(0.5, 3.0) * _unit(rng)]) for _ in range(lab.stands)
            ]
            turn = 2 * np.pi * (np.arange(each) + rng.uniform(-0.2, 0.2, each)) / each
            radius = rng.uniform(0.08, 0.2, each)
            self.drawn = np.stack([radius * np.cos(turn), radius * np.sin(turn), rng.uniform(0.01, 0.08, each)], axis=1)
            self.nests = self.drawn + rng.normal(0, 3e-4, (each, 3))

    def seen(self, frames: dict[str, Array]) -> Array:
        """(N, 3) where what is read is, in base axes."""
        if not self.lab.reflectors:
            return _seen(frames, self.nest)
        return dq.place(frames["flange"]) + np.einsum(
            "nij,nj->ni", dq.matrix(frames["flange"]), self.nests[self.target]
        )

    def axes(self) -> tuple[Array, Array]:
        """(N, 3, 3) axes and (N, 3) places of the tracker that each row's base stands in."""
        R, p = (np.stack([f(t) for t in self.trackers]) for f in (dq.matrix, dq.place))
        return R[self.stand], p[self.stand]

    def clean(self, effects: list[Effect]) -> NoiseFreeRecord:
        build = elastic_arm.ElasticArm(self.built)
        for e in effects:
            _put(e, build, self)
        frames, _ = elastic_arm.solve_rest_states(build, self.script)
        R = dq.matrix(self.rigid["tcp"])
        at = self.seen(frames)
        turned = dq.turning(frames["tcp"], self.quiet["tcp"])
        for e in effects:
            at = _read(e, at, self)
        y = at - self.seen(self.quiet)
        motion, sight = joint_columns(self.nominal, self.rigid)
        if self.lab.reflectors:
            motion = motion + np.cross(sight, (self.seen(self.rigid) - dq.place(self.rigid["tcp"]))[:, None])
        J = np.concatenate([motion, sight], axis=2)
        columns = [J[:, j] * self.torque[:, j, None] for j in range(6)]
        if self.lab.reflectors:
            none, F = np.zeros_like(y), dq.matrix(self.rigid["flange"])
            for k in range(self.lab.stands):
                for e_ in np.eye(3):
                    axis = np.where((self.stand == k)[:, None], e_, 0.0)
                    columns.append(np.concatenate([axis, none], axis=1))
                    columns.append(np.concatenate([np.cross(axis, self.seen(self.rigid)), axis], axis=1))
            for k in range(self.lab.reflectors):
                for e_ in np.eye(3):
                    columns.append(np.concatenate([(self.target == k)[:, None] * (F @ e_), none], axis=1))
        elif self.lab.fit:
            n, none = len(y), np.zeros_like(y)
            for e_ in np.eye(3):
                axis = np.broadcast_to(e_, (n, 3))
                columns.append(np.concatenate([axis, none], axis=1))
                columns.append(np.concatenate([np.cross(e_, dq.place(self.rigid["tcp"])), axis], axis=1))
                columns.append(np.concatenate([R @ e_, none], axis=1))
                if self.lab.turning:
                    columns.append(np.concatenate([none, R @ e_], axis=1))
        width = 6 if self.lab.turning else 3
        base = np.stack(columns, axis=2)[:, :width]
        sigma = np.full((len(y), width), 1e-3 * self.lab.reading.reading)
        sigma[:, 3:] = 1e-3 * self.lab.rotation
        both = np.concatenate([y, turned], axis=1)[:, :width]
        info = {"q": self.script.q, "at": at, "R": dq.matrix(frames["tcp"])}
        return NoiseFreeRecord(info, both, base, sigma, np.zeros_like(sigma), np.arange(len(y)))

    def rivals(self, clean: NoiseFreeRecord) -> dict[Named, Array]:
        """First-order columns of geometry, weights, bodies, coupling, angles."""
        robot, rigid, q, torque = self.nominal, self.rigid, self.script.q, self.torque
        motion, sight = joint_columns(robot, rigid)
        J = np.concatenate([motion, sight], axis=2)
        tip, n = self.seen(rigid) if self.lab.reflectors else dq.place(rigid["tcp"]), len(q)
        if self.lab.reflectors:
            J[:, :, :3] += np.cross(sight, (tip - dq.place(rigid["tcp"]))[:, None])
        out: dict[Named, list[Array]] = {}

        def add(effect: str, where: str, *columns: Array) -> None:
            out.setdefault((effect, where), []).extend(columns)

        def twist(name: str, R: Array, at: Array) -> None:
            for e in np.eye(3):
                axis = np.broadcast_to(R @ e, (n, 3))
                add("geometry", name, np.concatenate([axis, np.zeros((n, 3))], axis=1))
                add("geometry", name, np.concatenate([np.cross(axis, tip - at), axis], axis=1))

        load = np.zeros((n, 6))
        load[:, 2] = -elastic_arm.GRAVITY * (robot.tool_mass + 0.5 * float(robot.masses[4:].sum()))
        for j in range(6):
            R, at = dq.matrix(rigid[f"link{j}"]), dq.place(rigid[f"link{j}"])
            twist(f"joint:{j + 1}", R, at)
            add("joint_zero_offset", f"joint:{j + 1}", J[:, j])
            soft = J[:, j] * torque[:, j, None]
            angle = q[:, j, None]
            for k in (1, 2):
                add(
                    "joint_pose_dependent_stiffness",
                    f"joint:{j + 1}",
                    np.cos(k * angle) * soft,
                    np.sin(k * angle) * soft,
                )
                if j == 1:
                    add("gravity_compensator", "joint:2", np.cos(k * angle) * J[:, j], np.sin(k * angle) * J[:, j])
            end = at + R @ robot.ends()[j, :3]
            if np.linalg.norm(robot.ends()[j, :3]) > 1e-6:
                for C in beam_parts(robot.ends()[j, :3]):
                    add("link_compliance", f"link:{j + 1}", through(C, R, end, tip, load))
        twist("tool", dq.matrix(rigid["mounted"]), tip)
        twist("base", np.eye(3), np.zeros(3))
        if not self.lab.fit and not self.lab.reflectors:  # in a frame that is taken for known: the tracker's stand
            out["displacement_frame", "sensor:displacement"] = list(out["geometry", "base"])
        for a, b in PAIRS:
            add("joint_coupling", f"joint:{a + 1}-{b + 1}", J[:, b] * q[:, a, None])
        T = dq.matrix(rigid["flange"])
        down = np.array([0, 0, -elastic_arm.GRAVITY])
        flange = dq.place(rigid["flange"])
        for arm_ in (None, *np.eye(3)):
            at = flange + (T @ robot.tool_centre if arm_ is None else 0.0)
            moment = np.cross(at, down) if arm_ is None else np.cross(T @ arm_, down)
            f = np.broadcast_to(down, (n, 3)) if arm_ is None else np.zeros((n, 3))
            sag = np.zeros((n, 6))
            for j in range(6):
                axis, p = sight[:, j], dq.place(rigid[f"link{j}"])
                t = np.sum(axis * (moment - np.cross(p, f)), axis=1)
                sag += J[:, j] * t[:, None] / robot.stiffness[j]
            add("payload", "tool", sag)
        width = clean.y.shape[1]
        return {name: np.stack(c, axis=2)[:, :width] for name, c in out.items()}


def draw(name: str, scene: PoseSet, rng: np.random.Generator, loud: float) -> list[Effect]:
    """Candidates at their places, in random order."""
    order = [int(j) for j in rng.permutation(6)]
    out: list[Effect] = []
    if name == "joint_zero_offset":
        for j in order:
            same = (("geometry", f"joint:{j + 1}"),)
            one = Effect(name, f"joint:{j + 1}", 5e-4, 0.02, "arcmin", 1 / ARCMIN, "offset", same, {"joint": j})
            out.append(one)
    elif name == "transmission_error":
        for j in order:
            n = int(rng.choice([2, 3, 6, 12, 30]))
            detail = {"joint": j, "order": n, "phase": rng.uniform(0, 6.28, 3)}
            unit = ("arcsec", 648000 / np.pi, "amplitude")
            out.append(Effect(name, f"joint:{j + 1}", 1e-4, 1e-3, *unit, detail=detail))
    elif name == "joint_coupling":
        for a, b in ((3, 4), (4, 5), (3, 5)):
            detail = {"joints": (a, b)}
            out.append(Effect(name, f"joint:{a + 1}-{b + 1}", 3e-4, 5e-3, "1", 1.0, "ratio", detail=detail))
    elif name == "geometry":
        for j in order[:5]:
            way = rng.normal(size=6) * np.r_[[5e-4] * 3, [6e-4] * 3]
            # a twist of six numbers turns about the joint's own axis too, which is its zero offset
            same = (("joint_zero_offset", f"joint:{j + 1}"),)
            out.append(Effect(name, f"joint:{j + 1}", 1.0, 4.0, accepted=same, detail={"joint": j, "way": way}))
    elif name == "payload":
        out.append(Effect(name, "tool", 0.2 * scene.built.tool_mass, 60.0, "kg", 1.0, "mass"))
    elif name == "gravity_compensator":
        out.append(Effect(name, "joint:2", 0.3, 1.2, detail={"at": rng.uniform(-1, 1)}))
    elif name == "link_compliance":
        for i in rng.permutation([0, 1, 2, 3]):
            if np.linalg.norm(scene.built.ends()[i, :3]) <= 1e-6:
                continue  # two joints in one place: nothing between them bends
            out.append(Effect(name, f"link:{i + 1}", 0.3, 1.5, detail={"link": int(i), "taper": 0.7}))
    elif name == "base_compliance":
        out.append(Effect(name, "base", 0.3, 1.5, accepted=()))
    elif name == "joint_pose_dependent_stiffness":
        for j in (1, 2):
            detail = {"joint": j, "centre": float(scene.nominal.home[j]), "narrow": 6.0}
            out.append(Effect(name, f"joint:{j + 1}", 0.4, 1.5, detail=detail))
    elif name == "joint_backlash":
        for j in order:
            if min(np.mean(scene.torque[:, j] > 0), np.mean(scene.torque[:, j] < 0)) > 0.12:
                detail = {"joint": j, "drag": 0.02 * float(np.ptp(scene.torque[:, j]))}
                unit = ("arcmin", 1 / ARCMIN, "width")
                out.append(Effect(name, f"joint:{j + 1}", ARCMIN, 5 * ARCMIN, *unit, detail=detail))
    elif name == "thermal_drift":
        out.append(Effect(name, "environment", 3e-4, 3e-3, detail={"way": rng.normal(size=3)}))
    elif name == "displacement_frame":
        same = (("geometry", "base"),)
        out.append(
            Effect(name, "sensor:displacement", 2e-4, 2e-2, "deg", 180 / np.pi, "angle", same, {"way": _unit(rng)})
        )
    elif name == "bearing_wobble":  # an axis that nods twice a turn
        for j in (0, 1, 2):
            same = (("geometry", f"joint:{j + 1}"), ("transmission_error", f"joint:{j + 1}"))
            out.append(Effect("unnamed", f"joint:{j + 1}", 1e-4, 2e-3, accepted=same, detail={"wobble": j}))
    elif name == "warm_air":  # the tracker's ray bends with the square of the distance
        out.append(Effect("unnamed", "sensor:displacement", 1e-4, 2e-3, detail={"air": 1}))
    elif name == "slack_cable":  # a joint's encoder jumps between two values at one angle
        for j in order:
            same = (("joint_zero_offset", f"joint:{j + 1}"), ("transmission_error", f"joint:{j + 1}"))
            out.append(Effect("unnamed", f"joint:{j + 1}", 2e-4, 3e-3, accepted=same, detail={"jump": j}))
    else:
        raise ValueError(f"{name}: no such effect of a set of poses")
    for one in out:
        one.loudness = loud
    return out


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _put(e: Effect, build: elastic_arm.ElasticArm, scene: PoseSet) -> None:
    """Into the arm."""
    a, d, soft = e.amplitude, e.detail, 1.0 / scene.built.stiffness
    if e.effect == "joint_zero_offset":
        build.angles.append(lambda q: np.eye(6)[d["joint"]] * a + 0 * q)
    elif e.effect == "transmission_error":
        j, n, phase = d["joint"], d["order"], d["phase"]

        def wave(q: Array) -> Array:
            x = q[:, j]
            out = np.zeros_like(q)
            # the tooth, its first overtone and a runout of the ring
            out[:, j] = np.sin(n * x + phase[0]) + 0.35 * np.sin(2 * n * x + phase[1]) + 0.15 * np.sin(x + phase[2])
            return a * out

        build.angles.append(wave)
    elif e.effect == "joint_coupling":
        p, r = d["joints"]
        build.angles.append(lambda q: a * q[:, [p]] * np.eye(6)[r])
    elif e.effect == "geometry":
        build.twists = build.twists.copy()
        build.twists[d["joint"]] += a * d["way"]
    elif e.effect == "payload":
        build.hung.append((a, scene.built.tool_centre))
    elif e.effect == "gravity_compensator":
        build.parallel.append((1, lambda q: a * linkage(q - scene.nominal.home[1] + d["at"], scene)))
    elif e.effect == "link_compliance":
        span = scene.built.ends()[d["link"], :3]
        EI = float(np.linalg.norm(span)) * float(scene.built.stiffness[max(d["link"], 1)]) / a
        build.links[d["link"]] = body_compliance.beam(span, EI, d["taper"], flat=1.3)
    elif e.effect == "base_compliance":
        radius = 0.16 * scene.built.reach()
        at, k = body_compliance.feet(
            radius, float(scene.built.stiffness[1]) / (a * 1.5 * radius**2), 1e9, (0.7, 1.0, 1.4)
        )
        C = np.linalg.inv(body_compliance.plate(at, k))
        build.base = lambda w: w @ C.T
    elif e.effect == "joint_pose_dependent_stiffness":
        j = d["joint"]
        build.gears.append((j, gear_models.sector(a * soft[j], d["centre"], d["narrow"], j)))
    elif e.effect == "joint_backlash":
        build.gears.append((d["joint"], gear_models.clearance(a, d["drag"])))
    elif "jump" in d:
        j = d["jump"]
        home = scene.nominal.home[j]
        build.angles.append(lambda q: a * (q[:, [j]] > home + 0.1) * np.eye(6)[j])
    elif "wobble" in d:
        j = d["wobble"]

        def nod(q: Array) -> Array:  # seen at the next joint, whose axis nods with it
            out = np.zeros_like(q)
            out[:, j + 1] = a * np.sin(2 * q[:, j])
            out[:, j + 2] = -0.6 * a * np.cos(2 * q[:, j])
            return out

        build.angles.append(nod)


def linkage(angle: Array, scene: PoseSet) -> Array:
    """(N,) torque that holds about a third of what the weights ask of joint 2."""
    return linkage_torque(angle, float(np.max(np.abs(scene.torque[:, 1]))))


def linkage_torque(angle: Array, most: float) -> Array:
    """(N,) torque of a spring between a crank and the column: s² = r² + L² + 2 r L cos, F = F0 + k (s - s0).

    About a third of ``most`` N·m where the crank stands across.
    """
    r, L = 0.12, 0.9
    s = np.sqrt(r**2 + L**2 + 2 * r * L * np.cos(angle))
    pull = 0.6 + 4.0 * (s - (L - r))
    return np.asarray(0.33 * most * pull * L * np.sin(angle) / s)


def _read(e: Effect, at: Array, scene: PoseSet) -> Array:
    """By the instrument and the hall."""
    a, d = e.amplitude, e.detail
    if e.effect == "thermal_drift":
        t = scene.script.time - 60000.0 * scene.script.session
        warm = 1 - (4000.0 * np.exp(-t / 4000.0) - 700.0 * np.exp(-t / 700.0)) / 3300.0
        # links grow outwards, the pedestal upwards
        return np.asarray(at + a * warm[:, None] * (0.7 * at / scene.nominal.reach() + 0.5 * d["way"]))
    if e.effect == "displacement_frame":
        return np.asarray(at @ dq.matrix(dq.turned(a * d["way"])).T)
    if "air" in d:
        far = at - np.array([-2.5, 2.0, 0.5])
        return np.asarray(at - a * np.array([0, 0, 1.0]) * (np.sum(far**2, axis=1, keepdims=True) / 9.0) ** 1.5)
    return at


def pose_table(scene: PoseSet, clean: NoiseFreeRecord, rng: np.random.Generator) -> Table:
    """The recording with its noise."""
    lab, n = scene.lab, len(clean.y)
    noise = 1e-3 * errors(lab.reading, np.arange(n), 3, rng)
    at = clean.columns["at"] + noise
    R = clean.columns["R"] @ dq.matrix(dq.turned(1e-3 * lab.rotation * rng.normal(size=(n, 3))))
    if lab.reflectors:
        axes, stood = scene.axes()
        at = stood + np.einsum("nij,nj->ni", axes, at)
    elif lab.fit:
        at = dq.place(scene.tracker) + at @ dq.matrix(scene.tracker).T
        R = dq.matrix(scene.tracker) @ R
    s = scene.script
    out: dict[str, Array] = {"pose": scene.pose + 1, "cycle": scene.arrival + 1, "session": s.session + 1}
    if lab.reflectors:
        out["target"] = scene.target + 1
    if lab.stands > 1:
        out["frame"] = scene.stand + 1
    out["time_s"] = np.round(s.time - s.time[0], 1)
    if lab.temperature:
        out["temperature_C"] = np.round(21.0 + rng.normal(0, 0.2, n), 2)
    out |= {f"q{j + 1}_deg": np.round(np.degrees(s.q[:, j]), 4) for j in range(6)}
    mm = rounded(1e3 * at, lab.reading.step)
    out |= {f"{a}_mm": np.round(mm[:, k], 4) for k, a in enumerate("xyz")}
    if lab.turning:
        w = _quaternions(R)
        out |= {name: np.round(w[:, k], 8) for k, name in enumerate(("qw", "qx", "qy", "qz"))}
    about: dict[str, Any] = {"machopt_recording": 1, "kind": "absolute", "data": "data.csv"}
    about["registration"] = "fit" if lab.fit else "fixed"
    if lab.reflectors:
        about["targets_mm"] = {k + 1: np.round(1e3 * p, 2).tolist() for k, p in enumerate(scene.drawn)}
    if lab.stated:
        stated = {"displacement_mm": lab.reading.reading, "joint_deg": 0.0005}
        if lab.turning:
            stated["rotation_mrad"] = lab.rotation
        about["standard_uncertainty"] = stated
    return Table(out, about, [], lab.reading.reading)


def _quaternions(R: Array) -> Array:
    """(N, 4) w first, from matrices, by the eigenvector of Bar-Itzhack's 4 x 4."""
    K = np.zeros((len(R), 4, 4))
    r = R
    K[:, 0, 0] = r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2]
    for i, (j, k) in enumerate(((2, 1), (0, 2), (1, 0))):
        K[:, 0, i + 1] = K[:, i + 1, 0] = r[:, j, k] - r[:, k, j]
    for i in range(3):
        for j in range(3):
            K[:, i + 1, j + 1] = r[:, i, j] + r[:, j, i] - (r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2]) * (i == j)
    v = np.linalg.eigh(K)[1][:, :, -1]
    return np.asarray(v * np.where(v[:, :1] < 0, -1.0, 1.0))


def pose_measured(scene: PoseSet, table: Table) -> Array:
    """(N, 3) position read minus that of the arm with nothing concealed, in base axes, m."""
    at = 1e-3 * np.stack([table.columns[f"{a}_mm"] for a in "xyz"], axis=1)
    if scene.lab.reflectors:
        axes, stood = scene.axes()
        at = np.einsum("nji,nj->ni", axes, at - stood)
    elif scene.lab.fit:
        at = (at - dq.place(scene.tracker)) @ dq.matrix(scene.tracker)
    return np.asarray(at - scene.seen(scene.quiet))


def _seen(frames: dict[str, Array], nest: Array) -> Array:
    """(N, 3) where the reflector is."""
    return np.asarray(dq.place(frames["tcp"]) + dq.matrix(frames["tcp"]) @ nest)
