"""One case from its seed: draws the shop, puts the effects in at the wanted size, simulates, and knows the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator import measurement_design, motion_simulation
from simulator.arm_model import Nominal, arm_of, read_nominal
from simulator.detectability import Base, deflection_base, jacobians, pose_base, rms
from simulator.effect_registry import EFFECTS, HiddenEffect
from simulator.measurement_setup import MeasurementSetup, build_ideal_setup
from simulator.rival_explanations import rivals
from simulator.sensor_readings import Table, acting_wrench, deflection_table, pose_table, recorded_wrench
from simulator.static_equilibrium import Setting, Statics
from simulator.static_simulation import simulate_load_tests, simulate_poses

Array = NDArray[np.float64]
# r.m.s. that is left after the refit, over the noise of one reading
LEVELS = {"small": 0.15, "medium": 0.45, "large": 1.2}
# these do not come small: one strength per level
FIXED = {
    "units": (1.0, 1.0, 1.0),
    "outliers": (1.0, 1.0, 1.0),
    "servo_lag": (0.25, 1.0, 3.0),
    "time_skew": (0.25, 0.67, 1.4),
}
STRENGTH = (0.004, 12.0)
REACH = {
    "joint_backlash": 6.0,
    "joint_hysteresis": 4.0,
    "joint_nonlinear_stiffness": 3.5,
    "joint_creep": 4.0,
    "joint_coupling": 5.0,
    "joint_pose_dependent_stiffness": 4.0,
    "gravity_compensator": 6.0,
    "link_compliance": 20.0,
    "geometric_stiffness": 3.0,
    "force_sensor_gain": 5.0,
    "force_sensor_frame": 5.0,
    "displacement_frame": 5.0,
    "load_geometry": 4.0,
}


@dataclass(frozen=True)
class Part:
    """An effect that a case asks for."""

    effect: str
    places: tuple[str, ...]  # one is drawn
    level: str = "medium"


@dataclass(frozen=True)
class Case:
    """What a case is, before its seed is known."""

    key: str
    group: str  # null | single | pair | outside | set | record
    kind: str  # deflection | absolute | motion
    channel: str  # 3d | 6d | torque | link | tip
    robots: tuple[str, ...]
    parts: tuple[Part, ...] = ()
    ugly: bool = False
    wrench_frame: str = "base"
    weights: int = 0
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class Simulated:
    """Noise-free outcome."""

    y: Array  # (N, C) measured channel
    wrench: Array  # (N, 6) as recorded, base axes
    world: MeasurementSetup
    found: list[HiddenEffect]
    raw: Any


class Scene:
    """Everything random about a case is drawn here, in an order that does not depend on the strengths."""

    def __init__(self, case: Case, seed: Sequence[int], cells: Path, fast: bool = False) -> None:
        self.case, self.seed, self.fast = case, tuple(seed), fast
        streams = np.random.SeedSequence(self.seed).spawn(5)
        self._streams = streams
        pick = np.random.default_rng(streams[0])
        self.nominal: Nominal = read_nominal(cells / str(pick.choice(case.robots)))
        self.places = [str(pick.choice(part.places)) for part in case.parts]
        self.strengths = [1.0] * len(case.parts)
        self.programme: Any = None
        self._design(1.0)

    def _design(self, load: float) -> None:
        case, rng = self.case, np.random.default_rng(self._streams[1])
        if case.kind == "deflection":
            poses = case.options.get("poses", 9 if self.fast else 18)
            self.programme = measurement_design.draw_load_tests(
                self.nominal,
                rng,
                poses=poses,
                cycles=2 if self.fast else 3,
                sessions=2,
                moments=case.channel == "6d",
                deflection=2.5e-3 * load,
            )
            self.q = self.programme.poses
            wrench = self.programme.wrench.reshape(-1, 6)
            encoder = np.repeat(self.programme.encoder, self.programme.wrench.shape[1], axis=0)
            self.load, self.total = measurement_design.torque_range(self.nominal, encoder, wrench)
        elif case.kind == "absolute":
            poses, visits = (24, 2) if self.fast else (54, 6)
            sweep = None
            for part, place in zip(case.parts, self.places, strict=True):
                if part.effect in ("transmission_error", "gear_wear"):
                    sweep = int(place[-1]) - 1
            self.programme = measurement_design.draw_pose_sequence(
                self.nominal, rng, poses=poses, visits=visits, weights=case.weights, sweep=sweep
            )
            self.q = self.programme.poses
            wrench = self.programme.wrench.reshape(-1, 6)
            encoder = np.repeat(self.programme.encoder, self.programme.wrench.shape[1], axis=0)
            _, self.total = measurement_design.torque_range(self.nominal, encoder, wrench)
            self.load = self.total
        else:
            rate = case.options.get("rate", 100.0 if self.fast else 125.0)
            self.programme = motion_simulation.excitation(
                self.nominal, rng, sessions=1 if self.fast else 2, periods=2 if self.fast else 3, rate=rate
            )
            flat = [a[:, :: 4 * self.programme.sample].reshape(-1, 6) for a in self._signals()]
            self.q = flat[0]
            still = self._world_of(np.zeros(6), np.zeros(6), np.zeros((1, 6)))
            self.total = motion_simulation.Bodies(still, true=False).torque(*flat)
            self.load = self.total
        self.load95 = np.quantile(np.abs(self.load), 0.95, axis=0)
        self.swing = 0.5 * np.ptp(self.load, axis=0)

    def _signals(self) -> tuple[Array, Array, Array]:
        return self.programme.q, self.programme.v, self.programme.a

    def _world_of(self, load: Array, swing: Array, total: Array) -> MeasurementSetup:
        full = getattr(self.programme, "full", 0.0)
        world = build_ideal_setup(
            self.nominal,
            np.random.default_rng(self._streams[2]),
            kind=self.case.kind,
            six=self.case.channel == "6d",
            ugly=self.case.ugly,
            wrench_frame=self.case.wrench_frame,
            load=load,
            swing=swing,
            total=total,
            q=self.q,
            full=full,
        )
        if self.case.kind == "motion":
            m, rng = world.motion, np.random.default_rng([*self.seed, 5])
            m.motor_side = bool(self.case.options.get("motor_side", self.case.channel == "torque"))
            if m.motor_side and len(total) > 1:
                scale = np.quantile(np.abs(total), 0.95, axis=0) + 5.0
                m.coulomb = scale * rng.uniform(0.03, 0.07, 6)
                m.viscous = scale * rng.uniform(0.01, 0.04, 6)
        return world

    def world(self, strengths: Sequence[float]) -> tuple[MeasurementSetup, list[HiddenEffect]]:
        """The shop with every effect whose strength is above zero."""
        world = self._world_of(self.load95, self.swing, self.total)
        found = []
        for k, (part, place, s) in enumerate(zip(self.case.parts, self.places, strengths, strict=True)):
            if s > 0:
                rng = np.random.default_rng([*self.seed, 77, k])
                found.append(EFFECTS[part.effect](world, place, float(s), rng))
        return world, found

    def simulate(self, strengths: Sequence[float]) -> Simulated:
        """Noise-free channel and recorded wrench."""
        world, found = self.world(strengths)
        rng = np.random.default_rng(self._streams[3])
        case = self.case
        if case.kind == "motion":
            moved = motion_simulation.simulate_motion(world, self.programme)
            table = motion_simulation.motion_table(world, self.programme, moved, case.channel, rng)
            return Simulated(table.clean, table.recorded_wrench, world, found, moved)
        B = len(self.programme.pose)
        error = world.noise.pose_return / 2.2 * rng.normal(size=(B, 6))  # rad; levers are a metre or so
        approach = np.concatenate([rng.normal(size=(B, 3)), 0.3 * rng.normal(size=(B, 3))], axis=1)
        if case.kind == "deflection":
            approach *= 0.4 * self.programme.full
            acting = replace(self.programme, wrench=acting_wrench(world, self.programme.wrench))
            run = simulate_load_tests(world.arm, acting, error, approach, world.faults.lever)
            keep = np.nonzero(np.broadcast_to(~self.programme.zero, self.programme.hold.shape))
            wide = 6 if world.six else 3
            frame = world.faults.displacement_frame
            d = run.displacement[keep]
            y = np.concatenate([d[:, :3] @ frame, d[:, 3:] @ frame], axis=1)[:, :wide]
            rec = recorded_wrench(world, self.programme.wrench[keep], run.rotation[keep])
            return Simulated(y, rec, world, found, run)
        approach *= 300.0
        run_ = simulate_poses(world.arm, self.programme, error, approach, world.heat)
        still = simulate_poses(world.arm, self.programme, 0.0 * error, approach, world.heat)
        table = pose_table(world, self.programme, run_, still, rng, fit=True)
        return Simulated(table.clean, table.recorded_wrench, world, found, (run_, still))

    def rows(self) -> tuple[Array, NDArray[np.int64]]:
        """Encoder angles (N, 6) and noise clusters (N,) of the noise-free rows."""
        p = self.programme
        if self.case.kind == "deflection":
            b, s = np.nonzero(np.broadcast_to(~p.zero, p.hold.shape))
            return p.encoder[b], b * (int(p.cycle.max()) + 1) + p.cycle[s]
        b = np.repeat(np.arange(len(p.pose)), p.wrench.shape[1])
        return p.encoder[b], b

    def base(self, out: Simulated) -> Base:
        """Columns a refit may use."""
        if self.case.kind == "motion":
            return self._motion_base(out)
        encoder, cluster = self.rows()
        if self.case.kind == "deflection":
            return deflection_base(out.world, encoder, out.wrench, cluster)
        return pose_base(out.world, encoder, out.wrench, cluster, True)

    def contribution(self, out: Simulated, without: Simulated) -> Array:
        """(N, C): what the effects add to measured minus predicted, the base at its true values."""
        e = out.y - without.y
        if self.case.kind == "deflection":
            encoder, _ = self.rows()
            J, _, _ = jacobians(out.world, encoder)
            soft = 1.0 / self.true_stiffness()
            e = e - np.einsum("nci,i,ndi,nd->nc", J, soft, J, out.wrench - without.wrench)[:, : e.shape[1]]
        return np.asarray(e)

    def true_stiffness(self) -> Array:
        """(6,) N·m/rad."""
        world, _ = self.world([0.0] * len(self.case.parts))
        return np.array([law.k for law in world.arm.laws])  # type: ignore[attr-defined]

    def unit(self, world: MeasurementSetup) -> tuple[float, str, Array]:
        """Noise of one reading, its unit, and what one row's coordinates are divided by to compare them."""
        n = world.noise
        if self.case.kind == "deflection":
            return n.displacement, "mm", np.ones(1)
        if self.case.kind == "absolute":
            return float(np.sqrt(n.reading**2 + (0.5 * n.cycle) ** 2 + n.pose_return**2 / 3.0)), "mm", np.ones(1)
        if self.case.channel == "tip":
            return float(np.hypot(n.reading, n.cycle)), "mm", np.ones(1)
        if self.case.channel == "link":
            return motion_simulation.BEHIND, "mrad", np.ones(1)
        scale = 0.0067 * (np.quantile(np.abs(self.total), 0.98, axis=0) + 5.0)
        return 1.0, "noise", scale

    def calibrate(self) -> None:
        """Scale each effect, alone, until it shows as its level asks; bounded by what is physically met."""
        n = len(self.case.parts)
        if not n:
            return
        without = self.simulate([0.0] * n)
        for k, part in enumerate(self.case.parts):
            if part.effect in FIXED:
                self.strengths[k] = FIXED[part.effect][list(LEVELS).index(part.level)]
                continue
            s, best = 1.0, 1.0
            top = REACH.get(part.effect, STRENGTH[1])
            for _ in range(8):
                alone = [s if j == k else 0.0 for j in range(n)]
                try:
                    shown, noise, before = self._shown(alone, without, part)
                except RuntimeError:
                    top, s = 0.6 * s, 0.4 * s  # no equilibrium: beyond what such an arm could bear
                    continue
                best = s
                wanted = LEVELS[part.level] * noise
                if shown < 0.05 * before and self.case.group == "set":
                    break  # the refit absorbs it: an ordinary size is as good as any
                ratio = wanted / max(shown, 1e-12)
                if 0.85 < ratio < 1.18:
                    break
                new = float(np.clip(s * np.clip(ratio, 0.08, 8.0), STRENGTH[0], top))
                if abs(new / s - 1.0) < 0.02:
                    break
                s = best = new
            self.strengths[k] = best
        if any(p.effect == "geometric_stiffness" for p in self.case.parts):
            self._design(self.strengths[0])

    def _shown(self, alone: list[float], without: Simulated, part: Part) -> tuple[float, float, float]:
        if part.effect == "geometric_stiffness":
            self._design(max(alone))
            out = self.simulate(alone)
            e = self.curvature(out)
        else:
            out = self.simulate(alone)
            e = self.contribution(out, without)
        noise, _, scale = self.unit(out.world)
        left, _ = self.base(out).left(e)
        C = 3 if self.case.kind != "motion" or self.case.channel == "tip" else 6
        if self.case.kind == "motion":
            step = self._thin(len(e))
            e = e[::step]
        return rms(left[:, :C] / scale), noise, rms(e[:, :C] / scale)

    def curvature(self, out: Simulated) -> Array:
        """(N, C): nonlinear displacement minus J C Jᵀ w at the commanded posture."""
        encoder, _ = self.rows()
        J, _, _ = jacobians(out.world, encoder)
        linear = np.einsum("nci,i,ndi,nd->nc", J, 1.0 / self.true_stiffness(), J, out.wrench)
        return np.asarray(out.y - linear[:, : out.y.shape[1]])

    def leftover_of_null(self, without: Simulated) -> tuple[float, float]:
        """What a refit of the base leaves of the clean shop: r.m.s. in noises of one reading, and noncentrality."""
        noise, _, scale = self.unit(without.world)
        if self.case.kind == "deflection":
            e = self.curvature(without)
        elif self.case.kind == "absolute":
            encoder, _ = self.rows()
            arm = arm_of(self.nominal)
            factor = self.true_stiffness() / self.nominal.stiffness
            arm.laws = [law.scaled(float(f)) for law, f in zip(arm.laws, factor, strict=True)]
            e = without.y - Statics(arm).settle(Setting(encoder, without.wrench)).position
        elif self.case.channel == "tip":
            run = self.programme
            centre = np.arange(run.sample // 2, run.q.shape[1], run.sample)
            e = without.y - jacobians(without.world, run.q[:, centre].reshape(-1, 6))[1]
        elif self.case.channel == "torque":
            run = self.programme
            centre = np.arange(run.sample // 2, run.q.shape[1], run.sample)
            nominal = motion_simulation.Bodies(without.world, true=False)
            e = without.y - nominal.torque(*(x[:, centre].reshape(-1, 6) for x in self._signals()))
        else:
            e = without.y
        left, z = self.base(without).left(e)
        wide = 6 if self.case.kind == "motion" and self.case.channel != "tip" else 3
        return rms(left[:, :wide] / scale) / noise, z

    def accepted(self, out: Simulated, left: Array) -> list[tuple[str, str]]:
        """Explanations this very design cannot rule out."""
        if self.case.kind != "deflection":
            return []
        encoder, _ = self.rows()
        return rivals(out.world, self.base(out), left, encoder, out.wrench)

    def table(self) -> tuple[Table, MeasurementSetup, list[HiddenEffect], Simulated]:
        """The file's columns, with noise."""
        out = self.simulate(self.strengths)
        rng = np.random.default_rng(self._streams[4])
        if self.case.kind == "deflection":
            table = deflection_table(out.world, self.programme, out.raw, rng)
        elif self.case.kind == "absolute":
            table = pose_table(out.world, self.programme, *out.raw, rng, fit=True)
        else:
            table = motion_simulation.motion_table(out.world, self.programme, out.raw, self.case.channel, rng)
        return table, out.world, out.found, out

    def _thin(self, n: int) -> int:
        return max(1, n // 600)

    def _motion_base(self, out: Simulated) -> Base:
        run, moved = self.programme, out.raw
        E, T, _ = run.q.shape
        centre = np.arange(run.sample // 2, T, run.sample)
        q, v, a, tau = (x[:, centre].reshape(-1, 6) for x in (run.q, run.v, run.a, moved.torque))
        step = self._thin(len(q))
        q, v, a, tau = q[::step], v[::step], a[::step], tau[::step]
        cluster = (
            np.repeat(np.arange(E), len(centre))[::step] * 100
            + np.tile(run.time[centre] // run.period, E).astype(int)[::step]
        )
        eye = np.eye(6)
        if self.case.channel == "link":
            columns = np.concatenate([tau[:, :, None] * eye, np.broadcast_to(eye, (len(q), 6, 6))], axis=2)
            return Base(
                columns,
                cluster,
                np.full(6, 0.8 * motion_simulation.BEHIND),
                np.full(6, 0.6 * motion_simulation.BEHIND),
                step,
            )
        if self.case.channel == "tip":
            J, tip, R = jacobians(out.world, q)
            turn = np.cross(np.eye(3)[None], tip[:, None, :]).swapaxes(1, 2)
            columns = np.concatenate(
                [J[:, :3] * tau[:, None, :], np.broadcast_to(np.eye(3), (len(q), 3, 3)), turn, R], axis=2
            )
            return Base(columns, cluster, np.full(3, out.world.noise.reading), np.full(3, out.world.noise.cycle), step)
        # inertias are those of the URDF and the cell: not refitted, or a payload could never show
        columns = [np.broadcast_to(eye, (len(q), 6, 6))]
        if out.world.motion.motor_side:
            columns += [np.sign(v)[:, :, None] * eye, v[:, :, None] * eye]
        scale = np.quantile(np.abs(self.total), 0.98, axis=0) + 5.0
        return Base(np.concatenate(columns, axis=2), cluster, 0.006 * scale, 0.003 * scale, step)
