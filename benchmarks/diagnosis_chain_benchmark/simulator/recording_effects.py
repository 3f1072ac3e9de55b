"""Effects of sensors, load frames, clocks and clerks."""

from __future__ import annotations

import numpy as np

from simulator.hidden_effect import HiddenEffect
from simulator.measurement_setup import MeasurementSetup, random_unit, turned


def force_offset(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    b = 0.03 * s * world.full * random_unit(rng)
    world.faults.force_offset = np.concatenate([b, np.zeros(3)])
    value = float(np.linalg.norm(b))
    return HiddenEffect(
        "force_sensor_offset", "sensor:force", "the zero of the sensor", {"offset": (value, "N")}, (value, "N")
    )


def force_gain(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    axis = int(rng.integers(3))
    gain = np.ones(3)
    gain[axis] += 0.04 * s * rng.choice([-1, 1])
    world.faults.force_gain = gain
    off = 100.0 * abs(gain[axis] - 1.0)
    return HiddenEffect("force_sensor_gain", "sensor:force", "one axis of the sensor", {"gain": (off, "%")}, (off, "%"))


def force_frame(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    angle = np.radians(1.5 * s)
    world.faults.force_frame = turned(random_unit(rng), angle)
    value = float(np.degrees(angle))
    return HiddenEffect(
        "force_sensor_frame",
        "sensor:force",
        "the sensor is bolted on turned",
        {"angle": (value, "deg")},
        (value, "deg"),
        [("load_geometry", "sensor:force")],
    )


def common_gain(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    world.faults.force_gain = np.full(3, 1.0 + 0.05 * s)
    return HiddenEffect(
        "force_sensor_gain", "sensor:force", "all axes of the sensor alike", {"gain": (5.0 * s, "%")}, (5.0 * s, "%")
    )


def displacement_frame(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    angle = np.radians(1.5 * s)
    world.faults.displacement_frame = turned(random_unit(rng), angle)
    value = float(np.degrees(angle))
    return HiddenEffect(
        "displacement_frame",
        "sensor:displacement",
        "the tracker's base frame is turned",
        {"angle": (value, "deg")},
        (value, "deg"),
    )


def load_geometry(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    if rng.random() < 0.5:
        lever = 0.03 * s * random_unit(rng)
        world.faults.lever = lever
        value, words, unit = 1e3 * float(np.linalg.norm(lever)), "the hook sits beside the tip", "mm"
        accepted = []
    else:
        world.faults.pulley = 0.04 * s * random_unit(rng)
        value, unit = float(np.degrees(np.linalg.norm(world.faults.pulley))), "deg"
        words, accepted = "the pulley stands askew", [("force_sensor_frame", "sensor:force")]
    return HiddenEffect("load_geometry", "sensor:force", words, {"offset": (value, unit)}, (value, unit), accepted)


def skew(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    channel = place.split(":")[1]
    late = float(0.012 * s * rng.choice([-1, 1]))
    world.faults.skew[channel] = late
    return HiddenEffect(
        "time_skew", place, "a channel with its own clock", {"late": (1e3 * late, "ms")}, (1e3 * abs(late), "ms")
    )


def units(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    first = place.split(":")[1]
    factor = {"q1_deg": np.pi / 180.0}.get(first, 1000.0 if first == "mx_Nm" else 1e-3)
    world.faults.units[first] = float(factor)
    return HiddenEffect(
        "units", place, "a group of columns in another unit", {"factor": (float(factor), "1")}, (1.0, "1")
    )


def slipped(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    world.faults.slipped, world.faults.repeated = 12, 8
    return HiddenEffect(
        "outliers", "rows", "slipped decimals and rows copied twice", {"rows": (20.0, "1")}, (20.0, "1")
    )


def geometric(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    return HiddenEffect(
        "geometric_stiffness", "arm", "nothing is added: the loads are large", {"load": (s, "1")}, (s, "1")
    )
