"""A moving arm: rigid bodies (pinocchio, inertias perturbed), gears with their own laws, drives with friction and lag.

Everything runs on a fine grid of 1 kHz; the file gets averages over the sampling interval as drives log them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.signal import lfilter

from simulator.arm_model import Nominal
from simulator.gear_torque_laws import Balancer, twist_at
from simulator.measurement_setup import MeasurementSetup, Motion
from simulator.sensor_readings import Columns, Table, turned_small
from simulator.serial_chain import GRAVITY
from simulator.static_equilibrium import Statics

Array = NDArray[np.float64]
FINE = 1000.0  # Hz
GEAR_RATE = 125.0  # Hz, of gears that remember
BEHIND = 2.5e-5  # rad, noise of an encoder behind a gear, white and by cycle together


@dataclass(frozen=True)
class Excitation:
    """Joint trajectories of several sessions, each a few periods of the same series."""

    time: Array  # (T,) s, fine grid
    q: Array  # (E, T, 6) rad
    v: Array
    a: Array
    period: float  # s
    sample: int  # fine steps per row


def excitation(nominal: Nominal, rng: np.random.Generator, *, sessions: int, periods: int, rate: float) -> Excitation:
    """Fourier series of five harmonics within 60 % of the speed limits and 35° of a posture near home."""
    period, harmonics = 12.0, 5
    time = np.arange(int(periods * period * FINE)) / FINE
    q, v, a = (np.empty((sessions, len(time), 6)) for _ in range(3))
    for s in range(sessions):
        for j in range(6):
            w = 2 * np.pi * np.arange(1, harmonics + 1) / period
            amp, phase = rng.normal(size=harmonics) / np.arange(1, harmonics + 1) ** 0.6, rng.uniform(0, 2 * np.pi, 5)
            arg = w[:, None] * time + phase[:, None]
            position, speed = amp @ np.sin(arg), (amp * w) @ np.cos(arg)
            scale = min(np.radians(35.0) / np.abs(position).max(), 0.6 * nominal.speed[j] / np.abs(speed).max())
            room = np.radians(40.0)
            centre = np.clip(nominal.home[j], nominal.lower[j] + room, nominal.upper[j] - room)
            q[s, :, j], v[s, :, j] = centre + scale * position, scale * speed
            a[s, :, j] = -scale * ((amp * w**2) @ np.sin(arg))
    return Excitation(time, q, v, a, period, round(FINE / rate))


class Bodies:
    """Rigid-body dynamics of the true or the nominal arm."""

    def __init__(self, world: MeasurementSetup, *, true: bool) -> None:
        nominal = world.nominal
        self.model = pin.buildModelFromUrdf(str(nominal.urdf))
        arm = world.arm
        if true:
            for i in range(6):
                self.model.inertias[i + 1] = _scaled(self.model.inertias[i + 1], float(arm.mass_scale[i + 1]))
        mass, com = (arm.tool_mass, arm.tool_com) if true else (nominal.tool_mass, nominal.tool_com)
        at = pin.SE3(nominal.flange.R, nominal.flange.t)
        # a spindle is roughly a ball of 0.15 m radius of gyration
        body = pin.Inertia(mass, com, 0.15**2 * mass * np.eye(3))
        self.model.inertias[6] = self.model.inertias[6] + at.act(body)
        self.model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
        self.data = self.model.createData()

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """(T, 6) N·m that the joints must give."""
        return np.array([pin.rnea(self.model, self.data, *row).copy() for row in zip(q, v, a, strict=True)])

    def mass_column(self, q: Array, joint: int) -> Array:
        """(T, 6) column of the mass matrix."""
        out = np.empty_like(q)
        for k, row in enumerate(q):
            M = pin.crba(self.model, self.data, row)
            out[k] = np.where(np.arange(6) <= joint, M[:, joint], M[joint])  # crba fills the upper triangle
        return out


def _scaled(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    return pin.Inertia(inertia.mass * factor, inertia.lever, inertia.inertia * factor)


@dataclass(frozen=True)
class SimulatedMotion:
    """Fine-grid signals of every session, (E, T, …)."""

    command: Array  # rad
    motor: Array  # rad, what the encoders see
    speed: Array  # rad/s of the motors
    link: Array  # rad, behind the gears
    torque: Array  # N·m as the drive or the sensor shows it
    gear: Array  # N·m that the gears carry
    warm: Array  # (E, T) 0 … 1


def simulate_motion(world: MeasurementSetup, run: Excitation) -> SimulatedMotion:
    """Simulate all sessions."""
    E, T, _ = run.q.shape
    bodies, motion = Bodies(world, true=True), world.motion
    motor, speed, acceleration = (np.empty_like(run.q) for _ in range(3))
    link, gear, shown, warm = (np.empty_like(run.q) for _ in range(4))
    for e in range(E):
        for j in range(6):
            motor[e, :, j] = _lagged(run.q[e, :, j], motion.lag[j], motion.dead_time)
            speed[e, :, j] = _lagged(run.v[e, :, j], motion.lag[j], motion.dead_time)
            acceleration[e, :, j] = _lagged(run.a[e, :, j], motion.lag[j], motion.dead_time)
        gear[e] = bodies.torque(motor[e], speed[e], acceleration[e])
        rise = (1.0 - np.exp(-run.time / 15.0)) * 0.6 + (1.0 - np.exp(-run.time / 90.0)) * 0.4
        warm[e] = rise[:, None]
    extra = np.zeros_like(run.q)
    wound = np.stack([_cable(motor[e], motion.cable) for e in range(E)])
    gear = gear + wound
    swing = np.zeros_like(run.q)
    for j, (k, damping) in motion.swing.items():
        for e in range(E):
            column = bodies.mass_column(motor[e], j)
            swing[e, :, j], bent = _swing(-gear[e, :, j], column[:, j], k, damping)
            extra[e] += column * bent[:, None]
    gear = gear + extra
    twist = _twists(world, motor, gear, run.sample)
    true = world.arm.true_angles(motor.reshape(-1, 6)).reshape(motor.shape)
    link = true + twist + swing
    shown = gear.copy()
    for j, law in enumerate(world.arm.laws):
        if isinstance(law, Balancer):
            shown[:, :, j] -= law.pull(motor[:, :, j].reshape(-1))[0].reshape(E, T)
    if motion.motor_side:
        for e in range(E):
            shown[e] += motion.rotor * acceleration[e]
            shown[e] += _friction(motion, motor[e], speed[e], gear[e], warm[e, :, 0])
    return SimulatedMotion(run.q, motor, speed, link, shown, gear, warm[:, :, 0])


def _lagged(x: Array, lag: float, dead: float) -> Array:
    """1/(1 + s T) after a dead time, started in the steady state of the periodic motion."""
    if lag <= 0 and dead <= 0:
        return x
    steps = round(dead * FINE)
    late = np.roll(x, steps)
    late[:steps] = x[0]
    if lag <= 0:
        return late
    decay = np.exp(-1.0 / (lag * FINE))
    y, _ = lfilter([1.0 - decay], [1.0, -decay], late, zi=[decay * late[0]])
    return np.asarray(y)


def _swing(load: Array, inertia: Array, k: float, damping: float) -> tuple[Array, Array]:
    """m(t) ẍ + d ẋ + k x = load, trapezoidal rule; x (T,) rad beyond and ẍ (T,) rad/s²."""
    h = 1.0 / FINE
    d = 2.0 * damping * np.sqrt(k * inertia.mean())
    x, v = np.empty_like(load), 0.0
    x[0] = load[0] / k
    acc = np.zeros_like(load)
    now, a = float(x[0]), 0.0
    for n in range(1, len(load)):
        m = float(inertia[n])
        free = now + h * v + 0.25 * h * h * a
        slow = v + 0.5 * h * a
        a = (float(load[n]) - k * free - d * slow) / (m + 0.5 * h * d + 0.25 * h * h * k)
        now, v = free + 0.25 * h * h * a, slow + 0.5 * h * a
        x[n], acc[n] = now, a
    return x, acc


def _twists(world: MeasurementSetup, motor: Array, gear: Array, sample: int) -> Array:
    """(E, T, 6) rad: every gear under its torque, in the order of time."""
    E, T, _ = motor.shape
    skip = round(FINE / GEAR_RATE)
    twist = np.empty_like(motor)
    flat = -gear @ world.arm.mix
    for j, law in enumerate(world.arm.laws):
        if not law.remembers:
            tau = flat[:, :, j].reshape(-1)
            twist[:, :, j] = twist_at(law, tau, motor[:, :, j].reshape(-1), law.start(len(tau)), 1e9).reshape(E, T)
            continue
        memory, at = law.start(E), np.arange(0, T, skip)
        coarse = np.empty((E, len(at)))
        guess = np.zeros(E)
        hold = np.full(E, skip / FINE)
        for n, k in enumerate(at):
            guess = twist_at(law, flat[:, k, j], motor[:, k, j], memory, skip / FINE, guess)
            memory = law.commit(guess, motor[:, k, j], memory, hold)
            coarse[:, n] = guess
        for e in range(E):
            twist[e, :, j] = np.interp(np.arange(T), at, coarse[e])
    return np.asarray(twist @ world.arm.mix.T)


def _friction(motion: Motion, q: Array, v: Array, load: Array, warm: Array) -> Array:
    """Torque (T, 6) N·m that the motors lose; the reversal is a spring that breaks away (Dahl), not a jump."""
    out = np.zeros_like(v)
    for j in range(6):
        peak = motion.coulomb[j] + motion.stribeck[j] * np.exp(-(np.abs(v[:, j] / motion.stribeck_speed) ** 1.2))
        peak = peak + motion.load_share[j] * np.abs(load[:, j])
        side = 1.0 + motion.lopsided[j] * np.sign(v[:, j])
        # Dahl: state goes to the sign of motion over 0.05 mrad
        state = np.empty(len(v))
        z = float(np.sign(v[0, j]))
        moved = np.abs(np.diff(q[:, j], prepend=q[0, j])) / 5e-5
        fade = np.exp(-moved)
        sign = np.sign(v[:, j])
        for n in range(len(v)):
            z = sign[n] + (z - sign[n]) * fade[n]
            state[n] = z
        thick = 1.0 - motion.warm_share[j] * warm
        out[:, j] = state * peak * side * (0.5 + 0.5 * thick) + motion.viscous[j] * thick * v[:, j]
        for joint, size, centre, width in motion.wear:
            if joint == j:
                out[:, j] += size * np.exp(-0.5 * ((q[:, j] - centre) / width) ** 2)
    return out


def _cable(q: Array, size: Array) -> Array:
    """A bundle that is wound and slides in its clips: twelve slipping pieces, driven by the joint angle."""
    out = np.zeros_like(q)
    for j in np.flatnonzero(size):
        limit = size[j] * (np.arange(12) + 1) / 78.0
        stiff = limit / np.radians(np.linspace(2.0, 25.0, 12))
        z = np.full(12, q[0, j])
        for n in range(len(q)):
            pull = np.clip(stiff * (q[n, j] - z), -limit, limit)
            z = q[n, j] - pull / stiff
            out[n, j] = pull.sum()
    return out


def motion_table(
    world: MeasurementSetup, run: Excitation, moved: SimulatedMotion, channel: str, rng: np.random.Generator
) -> Table:
    """Rows at the recording rate; ``channel`` is torque, link or tip."""
    E, T, _ = run.q.shape
    step = run.sample
    centre = np.arange(step // 2, T, step)
    fault = world.faults
    out: Columns = {}
    parts: dict[str, list[Array]] = {}
    clean: list[Array] = []
    added: list[Array] = []
    cluster: list[Array] = []
    statics = Statics(world.arm)
    turn, offset, target = turned_small(4e-4 * rng.normal(size=3)), 1e-3 * rng.normal(size=3), 3e-4 * rng.normal(size=3)
    for e in range(E):
        n = len(centre)
        cycle = np.minimum((run.time[centre] // run.period).astype(int), 10**6)
        cluster.append(1000 * e + cycle)
        late = {name: round(value * FINE) for name, value in fault.skew.items()}

        def at(signal: Array, name: str, late: dict[str, int] = late) -> Array:
            index = np.clip(centre - late.get(name, 0), 0, T - 1)
            smooth = np.cumsum(np.concatenate([np.zeros((1, signal.shape[1])), signal]), axis=0)
            # as many fine steps before as after, or the average would be early
            low, high = np.maximum(index - step // 2, 0), np.minimum(index + step // 2 + 1, T)
            return np.asarray((smooth[high] - smooth[low]) / (high - low)[:, None])

        def put(name: str, values: Array) -> None:
            parts.setdefault(name, []).append(values)

        encoder = at(moved.motor[e], "q") + 1.5e-6 * rng.normal(size=(n, 6))
        put("cycle", cycle[:, None] * 1.0)
        put("session", np.full((n, 1), 1.0 * e))
        put("time_s", run.time[centre][:, None] + e * (run.time[-1] + 60.0))
        put("q{}_deg", np.degrees(np.round(encoder / 2e-6) * 2e-6))
        if channel == "tip":
            put("qcmd{}_deg", np.degrees(at(run.q[e], "qcmd")))
        put("qd{}_deg_s", np.degrees(at(moved.speed[e], "q") + 2e-4 * rng.normal(size=(n, 6))))
        if channel == "link":
            behind = at(moved.link[e], "qse")
            noise = 0.8 * BEHIND * rng.normal(size=(n, 6))
            noise += 0.6 * BEHIND * rng.normal(size=(run_cycles(run), 6))[cycle]
            put("qse{}_deg", np.degrees(np.round((behind + noise) / 5e-6) * 5e-6))
            clean.append(behind - at(moved.motor[e], "q"))
            added.append(noise)
        torque = at(moved.torque[e], "tau")
        scale = np.quantile(np.abs(torque), 0.98, axis=0) + 5.0
        ripple = 0.006 * scale * rng.normal(size=(n, 6)) + 0.003 * scale * rng.normal(size=(run_cycles(run), 6))[cycle]
        quantum = scale / 2000.0
        put("tau{}_Nm", np.round((torque + ripple) / quantum) * quantum)
        if channel == "torque":
            clean.append(torque)
            added.append(ripple)
            if world.motion.motor_side:
                put("temperature_C", (24.0 + 14.0 * moved.warm[e][centre] + 0.2 * rng.normal(size=n))[:, None])
        if channel == "tip":
            x = np.zeros((n, len(statics.model.chain)))
            x[:, statics.model.joint] = at(moved.link[e], "x")
            p, R = statics.model.chain.forward(x).tip()
            noise = world.noise.reading * rng.normal(size=(n, 3))
            noise += world.noise.cycle * rng.normal(size=(run_cycles(run), 3))[cycle]
            measured = (p + np.einsum("nij,j->ni", R, target)) @ turn.T + offset + noise
            put("xyz", measured * 1e3)
            clean.append(p)
            added.append(noise)
    for name, blocks in parts.items():
        block = np.concatenate(blocks)
        if name == "xyz":
            names = ["x_mm", "y_mm", "z_mm"]
        else:
            names = [name.format(i + 1) for i in range(6)] if "{}" in name else [name]
        digits = {"time_s": 6, "tau{}_Nm": 4, "temperature_C": 2, "xyz": 5}.get(name, 7)
        for label, column in zip(names, block.T, strict=True):
            out[label] = np.round(column, digits)
    for first, factor in fault.units.items():
        for label in (
            [first] if first not in ("q1_deg", "tau1_Nm") else [first.replace("1", str(i)) for i in range(1, 7)]
        ):
            out[label] = np.asarray(out[label], float) * factor
    N = len(np.concatenate(clean))
    which = np.repeat(np.arange(E), len(centre)), np.tile(centre, E)
    return Table(
        out,
        np.concatenate(clean),
        np.concatenate(cluster),
        np.concatenate(added),
        np.zeros(0, np.int64),
        np.zeros((N, 6)),
        np.zeros((N, 6)),
        which,
    )


def run_cycles(run: Excitation) -> int:
    return int(run.time[-1] // run.period) + 1
