"""Effects that need the arm to move."""

from __future__ import annotations

import numpy as np

from simulator.hidden_effect import HiddenEffect, joint_of
from simulator.measurement_setup import MeasurementSetup


def friction(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i, m = joint_of(place), world.motion
    size = 0.06 * s * float(np.quantile(np.abs(world.total[:, i]), 0.95))
    for name, share in (("stribeck", 1.0), ("load_share", 0.05 * s), ("lopsided", 0.0), ("warm_share", 0.0)):
        values = getattr(m, name).copy()
        values[i] += size if name == "stribeck" else share
        setattr(m, name, values)
    m.lopsided = m.lopsided.copy()
    m.lopsided[i] = float(np.clip(0.25 * s * rng.choice([-1, 1]), -0.8, 0.8))
    m.warm_share = m.warm_share.copy()
    m.warm_share[i] = min(0.2 * s, 0.7)
    return HiddenEffect(
        "joint_friction",
        place,
        "Stribeck peak, load- and temperature-dependent, lopsided",
        {"stribeck": (size, "N·m"), "lopsided": (100 * m.lopsided[i], "%")},
        (size, "N·m"),
    )


def servo_lag(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    lag = 0.008 * s
    world.motion.lag = lag * rng.uniform(0.8, 1.2, 6)
    world.motion.dead_time = 0.3 * lag
    total = 1e3 * float(world.motion.lag.mean() + world.motion.dead_time)
    accepted = [("time_skew", "sensor:q"), ("time_skew", "sensor:qcmd"), ("time_skew", "sensor:q_command")]
    return HiddenEffect(
        "servo_lag",
        "controller",
        "first-order lag and dead time, each joint its own",
        {"delay": (total, "ms")},
        (total, "ms"),
        accepted,
    )


def swinging(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    # an extra soft stage: the lower its frequency the more it shows
    k = world.nominal.stiffness[i] * 0.35 / s
    world.motion.swing[i] = (float(k), float(rng.uniform(0.02, 0.06)))
    return HiddenEffect(
        "joint_elasticity",
        place,
        "link on its spring, integrated in time",
        {"stiffness": (k, "N·m/rad")},
        (1.0 / k, "rad/(N·m)"),
    )
