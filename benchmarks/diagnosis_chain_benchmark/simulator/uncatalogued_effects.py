"""Physics that no catalogue entry describes; the right answer is that something is there, and where."""

from __future__ import annotations

import numpy as np

from simulator.arm_model import Hinge, Hose, Plate
from simulator.gear_torque_laws import Clearance
from simulator.hidden_effect import ARCMIN, ARCSEC, HiddenEffect, joint_of
from simulator.measurement_setup import MeasurementSetup, random_unit
from simulator.thermal_model import Heat


def loose_bolt(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    half = 0.35
    tilt = 6.0 * float(np.median(world.nominal.stiffness[:3]))
    pressed = np.full(4, tilt / (4 * half**2))
    drawn = pressed.copy()
    for corner in rng.choice(4, 2, replace=False):
        drawn[corner] /= 1.0 + 8.0 * s
    world.arm.plate = Plate(half, pressed, drawn, 3.0 * tilt / (4 * half**2))
    return HiddenEffect(
        "loose_bolt",
        "base",
        "two bolts of the pedestal open under tension only",
        {"tilt_stiffness": (tilt, "N·m/rad")},
        (s, "1"),
        [("base_compliance", "base")],
        catalogue=False,
    )


def bearing_play(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    cross = np.cross(world.nominal.axes[i], random_unit(rng))
    cross /= np.linalg.norm(cross)
    b = 0.35 * ARCMIN * s
    world.arm.hinges.append(
        Hinge(i, True, cross, Clearance(6.0 * float(np.median(world.nominal.stiffness[:3])), b, 0.02))
    )
    return HiddenEffect(
        "bearing_play",
        place,
        "a main bearing tilts freely before it seats",
        {"width": (2 * b / ARCMIN, "arcmin")},
        (2 * b / ARCMIN, "arcmin"),
        catalogue=False,
    )


def hose(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    reach = float(sum(np.linalg.norm(j.t) for j in world.nominal.joints))
    k = float(np.min(world.nominal.stiffness[1:3])) / (0.5 * reach) ** 2
    rate = 0.08 * s * k if world.kind == "deflection" else 0.02 * s * k
    anchor = np.array([0.3 * reach, rng.uniform(-0.5, 0.5) * reach, 1.1 * reach])
    world.arm.hoses.append(Hose(4, world.nominal.joints[4].t, anchor, 0.15 * rate * reach, rate, 0.7 * reach))
    return HiddenEffect(
        "hose_spring",
        "link:4",
        "a hose package on a spring holds the wrist up",
        {"rate": (rate, "N/m")},
        (rate, "N/m"),
        [("payload", "tool")] if world.kind == "absolute" else [],
        catalogue=False,
    )


def bent_amplifier(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    world.faults.force_bend = float(0.06 * s / world.full * rng.choice([-1, 1]))
    return HiddenEffect(
        "force_sensor_nonlinear",
        "sensor:force",
        "the force amplifier is not linear",
        {"bend": (world.faults.force_bend, "1/N")},
        (s, "1"),
        [("force_sensor_gain", "sensor:force")],
        catalogue=False,
    )


def sun_bow(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    length = np.array([np.linalg.norm(p.t) for p in (*world.nominal.joints[1:], world.nominal.flange)])
    bow = 60e-6 * s * random_unit(rng)[:2]
    world.heat = Heat((2,), length, 0.0, 700.0, 3000.0, 0.6, sun=bow)
    return HiddenEffect(
        "sun_bow",
        "link:2",
        "sunlight on one side of the link comes and goes",
        {"turn": (60.0 * s, "µrad")},
        (60.0 * s, "µrad"),
        [("thermal_drift", "environment")],
        catalogue=False,
    )


def tracker_kick(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    for share in rng.uniform(0.15, 0.85, 3):
        world.faults.kicks.append(
            (float(share), s * np.concatenate([60e-6 * rng.normal(size=3), 25e-6 * rng.normal(size=3)]))
        )
    return HiddenEffect(
        "tracker_kick",
        "tracker",
        "the tracker's stand was knocked three times",
        {"shift": (60.0 * s, "µm")},
        (60.0 * s, "µm"),
        [("thermal_drift", "environment")],
        catalogue=False,
    )


def gear_wear(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    low, high = np.quantile(world.q[:, i], [0.1, 0.9])
    centre, width = rng.uniform(low, high), 0.06 * (high - low)
    size = 90.0 * ARCSEC * s
    world.arm.misread.append((i, lambda q: size * np.exp(-0.5 * ((q[:, i] - centre) / width) ** 2)))
    world.motion.wear.append(
        (i, 0.10 * s * float(np.quantile(np.abs(world.total[:, i]), 0.95)), float(centre), float(width))
    )
    return HiddenEffect(
        "gear_wear",
        place,
        "teeth worn at one angle",
        {"depth": (90.0 * s, "arcsec")},
        (90.0 * s, "arcsec"),
        [("transmission_error", place)],
        catalogue=False,
    )


def cable_drag(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    world.motion.cable = world.motion.cable.copy()
    world.motion.cable[i] = 0.08 * s * float(np.quantile(np.abs(world.total[:, i]), 0.95))
    return HiddenEffect(
        "cable_drag",
        place,
        "a hose bundle wound up and dragged along",
        {"torque": (world.motion.cable[i], "N·m")},
        (world.motion.cable[i], "N·m"),
        [("joint_friction", place)],
        catalogue=False,
    )


def rotor_inertia(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    inertia = 0.02 * s * float(np.quantile(np.abs(world.total[:, i]), 0.95))
    world.motion.rotor = world.motion.rotor.copy()
    world.motion.rotor[i] = inertia
    return HiddenEffect(
        "rotor_inertia",
        place,
        "a motor's rotor behind its gear, which no URDF states",
        {"inertia": (inertia, "kg·m²")},
        (inertia, "kg·m²"),
        catalogue=False,
    )
