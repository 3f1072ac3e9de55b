"""Effects inside the gears and on their shafts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.gear_torque_laws import Balancer, BoucWen, Bumpy, Clearance, Creeping, Law, Pins, Screw, iwan, twist_at
from simulator.hidden_effect import ARCMIN, ARCSEC, HiddenEffect, gear_twist, joint_of, stiffness_of
from simulator.measurement_setup import MeasurementSetup

Array = NDArray[np.float64]


def nonlinear(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    k = stiffness_of(world.arm.laws[i])
    total = np.abs(world.total[:, i])
    low, high = np.quantile(total, 0.05), np.quantile(total, 0.97)
    at = np.linspace(0.05, 0.85, 6) + 0.02 * rng.random(6)
    gap = (low + (high - low) * at) / k
    share = 0.12 * s
    world.arm.laws[i] = Pins(k / (1.0 + 2.0 * share), np.full(6, k * share), gap, 0.06 * float(np.ptp(gap)))
    ratio = (1.0 + 2.0 * share) * (1.0 / (1.0 + 2.0 * share) + 6 * share)
    return HiddenEffect(
        "joint_nonlinear_stiffness",
        place,
        "six pins meeting one after the other",
        {"stiffness_ratio": (ratio, "1"), "low_torque": (low, "N·m"), "high_torque": (high, "N·m")},
        (ratio - 1.0, "1"),
    )


def backlash(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    b = s * 0.25 * ARCMIN
    world.arm.laws[i] = Clearance(stiffness_of(world.arm.laws[i]), b, 0.03)
    gap = 2.0 * b / ARCMIN
    return HiddenEffect(
        "joint_backlash",
        place,
        "tooth clearance with seal drag inside it, contact on total torque",
        {"width": (gap, "arcmin")},
        (gap, "arcmin"),
    )


def hysteresis(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    k = stiffness_of(world.arm.laws[i])
    twist = gear_twist(world, i)
    law: Law
    if rng.random() < 0.5:
        law, words = iwan(k, min(0.4 * s, 6.0), 0.9 * twist), "24 slipping elements (Iwan)"
    else:
        law, words = BoucWen(k, 0.16 * s * world.load[i], 0.35 * twist), "Bouc–Wen, exponent 1.3"
    world.arm.laws[i] = law
    width = loop_width(law, world.swing[i]) / ARCMIN
    return HiddenEffect("joint_hysteresis", place, words, {"width": (width, "arcmin")}, (width, "arcmin"))


def loop_width(law: Law, torque: float) -> float:
    """rad between the branches at zero torque after cycling to ±``torque``."""
    memory, hold, q, x = law.start(1), np.array([1e9]), np.zeros(1), np.zeros(1)
    at = []
    for wanted in np.concatenate([np.linspace(0, 1, 9), np.linspace(1, -1, 17)[1:], np.linspace(-1, 1, 17)[1:]]):
        x = twist_at(law, np.array([wanted * torque]), q, memory, 1e9, x)
        memory = law.commit(x, q, memory, hold)
        at.append(float(x[0]))
    return abs(at[16] - at[32])


def creep(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    tau = np.array([4.0, 15.0, 60.0, 200.0]) * rng.uniform(0.8, 1.25)
    share = np.array([0.30, 0.30, 0.25, 0.15]) * 0.06 * s
    world.arm.laws[i] = Creeping(stiffness_of(world.arm.laws[i]), share, tau)
    total = 100.0 * float(share.sum())
    return HiddenEffect(
        "joint_creep",
        place,
        "four Kelvin–Voigt elements from 4 to 200 s",
        {"share": (total, "%"), "slowest": (float(tau[-1]), "s")},
        (total, "%"),
    )


def pose_dependent(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    k = stiffness_of(world.arm.laws[i])
    low, high = np.quantile(world.q[:, i], [0.05, 0.95])
    law: Law
    if rng.random() < 0.5:
        depth = min(0.25 * s, 0.85)
        law = Bumpy(k, depth, rng.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high), 0.25 * (high - low))
        words = "a sector of the gear that carries less"
    else:
        a, b = 0.5, 0.28
        r = 0.25
        law = Screw(k, 0.5 * s * k / r**2, a, b, float(rng.uniform(0.3, 0.9) - low))
        words = "a screw between two pivots beside the gear"
    world.arm.laws[i] = law
    angle = np.quantile(world.q[:, i], np.linspace(0.02, 0.98, 60))
    _, local = law.torque(np.zeros(60), angle, np.zeros((60, 0)), np.zeros(60))
    variation = 100.0 * float(np.ptp(local) / local.mean() / 2.0)
    accepted = [("gravity_compensator", place)] if i == 1 else []
    return HiddenEffect(
        "joint_pose_dependent_stiffness", place, words, {"variation": (variation, "%")}, (variation, "%"), accepted
    )


def coupling(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    first, second = (int(n) - 1 for n in place.removeprefix("joint:").split("-"))
    if world.kind == "absolute":
        kappa = float(4e-4 * s * rng.choice([-1, 1]))
        world.arm.misread.append((second, lambda q, k=kappa, j=first: k * q[:, j]))
        return HiddenEffect(
            "joint_coupling",
            place,
            "the shaft of one wrist joint runs through the other",
            {"ratio": (kappa, "rad/rad")},
            (abs(kappa), "rad/rad"),
        )
    kappa = float(0.35 * s * rng.choice([-1, 1]))
    # the motor that moves the later joint sits before the earlier one: twist there turns both
    world.arm.mix = world.arm.mix.copy()
    world.arm.mix[second, first] += kappa
    c = kappa / stiffness_of(world.arm.laws[first])
    return HiddenEffect(
        "joint_coupling",
        place,
        "gear twists add through a hollow shaft",
        {"compliance": (c, "rad/(N·m)")},
        (abs(c), "rad/(N·m)"),
        # bending of link 2 turns its end and shifts it: the two axes are parallel
        [("link_compliance", "link:2")] if place == "joint:2-3" else [],
    )


def compensator(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = 1
    k = world.nominal.stiffness[i]
    axis = world.nominal.axes[i]
    side = np.cross(axis, [0.0, 0.0, 1.0])
    home = world.nominal.home[i]
    lever, far = 0.20, 0.70
    # the moving anchor stands off the line to the fixed one at home, so that the lever changes sign in range
    moving = -lever * (np.cos(-home) * np.array([0.0, 0.0, 1.0]) + np.sin(-home) * np.cross(axis, [0.0, 0.0, 1.0]))
    fixed = -far * (0.55 * side + 0.83 * np.array([0.0, 0.0, 1.0])) * rng.uniform(0.9, 1.1)
    gas, gear = bool(rng.random() < 0.5), stiffness_of(world.arm.laws[i])
    if world.kind == "deflection":
        rate = 0.12 * s * k / lever**2
    else:
        # as strong as a share of what gravity asks of the joint
        rate = 0.3 * s * float(np.quantile(np.abs(world.total[:, i]), 0.95)) / (lever * 0.35)
    preload = rate * (0.6 / 1.3 if gas else 0.10)  # gas: 0.6 m of stroke would press it to nothing
    law = Balancer(world.arm.laws[i], axis, fixed, moving, preload, rate, float(np.linalg.norm(fixed)) - lever, gas)
    world.arm.laws[i] = law
    angle = np.quantile(world.q[:, i], np.linspace(0.0, 1.0, 40))
    pull, slope = law.pull(angle)
    local = gear - slope  # of the joint as it was built
    variation, peak = 100.0 * float(np.ptp(local) / local.mean() / 2.0), float(np.abs(pull).max())
    accepted = [("joint_pose_dependent_stiffness", "joint:2")] if world.kind == "deflection" else []
    return HiddenEffect(
        "gravity_compensator",
        "joint:2",
        "gas cylinder between two pins" if gas else "coil spring between two pins",
        {"variation": (variation, "%"), "rate": (rate, "N/m"), "peak_torque": (peak, "N·m")},
        (variation, "%") if world.kind == "deflection" else (peak, "N·m"),
        accepted,
    )


def zero_offset(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    off = float(60.0 * ARCSEC * s * rng.choice([-1, 1]))
    world.arm.zero = world.arm.zero.copy()
    world.arm.zero[i] += off
    value = float(np.degrees(off))
    return HiddenEffect("joint_zero_offset", place, "mastering error", {"offset": (value, "deg")}, (abs(value), "deg"))


def transmission(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = joint_of(place)
    order = int(rng.choice([2, 3, 4, 6] if world.kind == "absolute" else [12, 24, 36, 50]))
    first, second = 20.0 * ARCSEC * s, 8.0 * ARCSEC * s
    phi, psi = rng.uniform(0, 2 * np.pi, 2)

    def error(q: Array) -> Array:
        return np.asarray(first * np.sin(order * q[:, i] + phi) + second * np.sin(2 * order * q[:, i] + psi))

    world.arm.misread.append((i, error))
    return HiddenEffect(
        "transmission_error",
        place,
        "two harmonics of a gear order",
        {"amplitude": (first / ARCSEC, "arcsec"), "order": (order, "1/rev")},
        (first / ARCSEC, "arcsec"),
    )
