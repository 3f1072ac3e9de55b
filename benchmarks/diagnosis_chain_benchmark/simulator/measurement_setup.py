"""One simulated shop: the arm, its sensors with their faults, and the dirt that is always there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulator.arm_model import Arm, Nominal, arm_of
from simulator.thermal_model import Heat

Array = NDArray[np.float64]


@dataclass
class Faults:
    """What is wrong with the record. Nothing, by default."""

    force_offset: Array = field(default_factory=lambda: np.zeros(6))  # N, N·m in sensor axes
    force_gain: Array = field(default_factory=lambda: np.ones(3))  # of each sensor axis
    force_frame: Array = field(default_factory=lambda: np.eye(3))  # sensor axes as mounted
    force_bend: float = 0.0  # 1/N: reading = F + bend·F|F| (an amplifier that is not linear)
    displacement_frame: Array = field(default_factory=lambda: np.eye(3))
    lever: Array | None = None  # (3,) m in the tip frame, where the force really acts
    pulley: Array | None = None  # (3,) share: the real direction is e + pulley, made unit again
    units: dict[str, float] = field(default_factory=dict)  # first column of a group: factor in the file
    skew: dict[str, float] = field(default_factory=dict)  # channel: s by which it is late
    slipped: int = 0  # rows with a slipped decimal
    repeated: int = 0  # rows that repeat the row before
    kicks: list[tuple[float, Array]] = field(default_factory=list)  # tracker stand: after share of time, (6,) m rad
    wander: float = 0.0  # m, r.m.s. of a slow walk of the tracker


@dataclass
class Noise:
    """1 sigma of everything random; SI."""

    reading: float
    cycle: float
    pose_return: float  # m at the tip
    turn_reading: float  # rad
    turn_cycle: float
    force: float  # N
    moment: float  # N·m
    gain_session: float
    gain_cycle: float
    tails: float | None = None  # degrees of freedom of Student's t where the readings are heavy-tailed
    session: float = 0.0  # m, shared by all cycles of a pose in a session
    quantum: float = 1e-7  # m
    outliers: float = 0.01
    missing: float = 0.0

    @property
    def displacement(self) -> float:
        """Per coordinate, of one reading."""
        heavy = 1.0 if self.tails is None else np.sqrt(self.tails / (self.tails - 2.0))
        return float(np.hypot(np.hypot(self.reading * heavy, self.cycle), self.session))


@dataclass
class Motion:
    """What only shows when the arm moves; see :mod:`simulator.run_motion`."""

    motor_side: bool = True  # torque of the motors (with rotors and friction), not of sensors behind the gears
    coulomb: Array = field(default_factory=lambda: np.zeros(6))  # N·m
    viscous: Array = field(default_factory=lambda: np.zeros(6))  # N·m·s/rad
    rotor: Array = field(default_factory=lambda: np.zeros(6))  # kg·m² behind the gear
    stribeck: Array = field(default_factory=lambda: np.zeros(6))  # N·m above Coulomb
    stribeck_speed: float = 0.05  # rad/s
    load_share: Array = field(default_factory=lambda: np.zeros(6))  # friction per load
    lopsided: Array = field(default_factory=lambda: np.zeros(6))  # share by which one direction drags more
    warm_share: Array = field(default_factory=lambda: np.zeros(6))  # of viscous friction lost when warm
    cable: Array = field(default_factory=lambda: np.zeros(6))  # N·m of a hose dragged along, with its own loop
    wear: list[tuple[int, float, float, float]] = field(default_factory=list)  # joint, N·m, centre, width rad
    lag: Array = field(default_factory=lambda: np.zeros(6))  # s, first order
    dead_time: float = 0.0  # s
    loose_mass: tuple[float, Array] = (0.0, np.zeros(3))  # kg beyond the cell's tool, new centre offset m
    swing: dict[int, tuple[float, float]] = field(default_factory=dict)  # joint: stiffness N·m/rad, damping ratio


@dataclass
class MeasurementSetup:
    """Everything a case is made of, before anything is simulated."""

    nominal: Nominal
    arm: Arm
    noise: Noise
    faults: Faults
    motion: Motion
    heat: Heat | None
    wrench_frame: str  # base | tool
    load: Array  # (6,) N·m, 95th percentile of |J_iᵀ w| over the readings, nominal
    swing: Array  # (6,) N·m, half of what J_iᵀ w ranges over
    total: Array  # (N, 6) N·m gear torques over the readings, nominal, gravity included
    q: Array  # (P, 6) rad, poses
    full: float  # N, the largest load
    kind: str
    six: bool


def build_ideal_setup(
    nominal: Nominal,
    rng: np.random.Generator,
    *,
    kind: str,
    six: bool,
    ugly: bool,
    wrench_frame: str,
    load: Array,
    swing: Array,
    total: Array,
    q: Array,
    full: float,
) -> MeasurementSetup:
    """A shop without any of the effects: stiffness ±20 % off (ugly: more), weights a little off, noise of the trade."""
    arm = arm_of(nominal)
    spread = 0.45 if ugly else 0.20
    factor = np.exp(rng.uniform(-1.0, 1.0, 6) * np.log1p(spread))
    arm.laws = [law.scaled(float(f)) for law, f in zip(arm.laws, factor, strict=True)]
    # a deflection does not show the weights but by K_C; poses and torques do, and there the URDF is nearly right
    small = {"deflection": 0.03, "absolute": 0.002, "motion": 0.0005}[kind]
    arm.mass_scale = 1.0 + small * rng.uniform(-1, 1, 7) * np.array([1, 1, 1, 1, 0.3, 0.3, 0.1])
    if kind == "absolute":
        # a calibrated arm: what is left is well below the tracker's noise
        arm.zero = 1.5e-6 * rng.normal(size=6)
        arm.lengthen = 2e-6 * rng.normal(size=(6, 3))
    noise = Noise(
        reading=rng.uniform(8e-6, 15e-6),
        cycle=rng.uniform(10e-6, 25e-6),
        pose_return=rng.uniform(20e-6, 40e-6),
        turn_reading=rng.uniform(15e-6, 30e-6),
        turn_cycle=rng.uniform(15e-6, 30e-6),
        force=max(0.003 * full, 0.3),
        moment=max(0.001 * full, 0.1),
        gain_session=rng.uniform(0.005, 0.010),
        gain_cycle=0.002,
    )
    if ugly:
        noise.tails = float(rng.uniform(2.6, 4.0))
        noise.cycle *= rng.uniform(1.3, 1.8)
        noise.session = rng.uniform(5e-6, 15e-6)
        noise.gain_cycle = rng.uniform(0.003, 0.006)
        noise.quantum = float(rng.choice([1e-7, 1e-6, 1e-5]))
        noise.outliers = rng.uniform(0.01, 0.03)
        noise.missing = rng.uniform(0.0, 0.15)
    return MeasurementSetup(
        nominal, arm, noise, Faults(), Motion(), None, wrench_frame, load, swing, total, q, full, kind, six
    )


def turned(axis: Array, angle: float) -> Array:
    """(3, 3) rotation about a unit axis."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def random_unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))
