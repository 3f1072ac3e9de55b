"""Effects of the structure: links, pedestal, tool, weights and heat."""

from __future__ import annotations

import numpy as np

from simulator.arm_model import Beam, Hinge, Plate, tip_softness
from simulator.gear_torque_laws import Spring
from simulator.hidden_effect import HiddenEffect
from simulator.measurement_setup import MeasurementSetup
from simulator.thermal_model import Heat


def link(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    i = int(place.split(":")[1])
    length = float(np.linalg.norm(world.nominal.joints[i].t if i < 6 else world.nominal.flange.t))
    reach = 1.5
    k = float(np.median(world.nominal.stiffness[:3]))
    # as soft in turning its end as a third of a main gear
    EI = 3.0 * k * length / s * reach / 1.5
    world.arm.beams[i] = Beam(EI * rng.uniform(0.8, 1.6), EI, EI * rng.uniform(0.5, 0.9), taper=rng.uniform(0.0, 0.7))
    accepted = [("tool_compliance", "tool")] if i == 6 else []
    return HiddenEffect(
        "link_compliance",
        place,
        "ten hinged pieces, tapered",
        {"EI": (EI, "N·m²"), "length": (length, "m")},
        (1.0 / EI, "1/(N·m²)"),
        accepted,
    )


def base(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    half = rng.uniform(0.30, 0.42)
    tilt = 3.0 * float(np.median(world.nominal.stiffness[:3])) / s  # N·m/rad about x and y
    vertical = tilt / (4 * half**2) * rng.uniform(0.85, 1.15, 4)
    world.arm.plate = Plate(half, vertical, vertical, 3.0 * tilt / (4 * half**2))
    return HiddenEffect(
        "base_compliance",
        "base",
        "a plate on four bolts",
        {"tilt_stiffness": (tilt, "N·m/rad")},
        (1.0 / tilt, "rad/(N·m)"),
    )


def tool(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    length = float(np.linalg.norm(world.nominal.tcp.t))
    # N/m at the tip, were it of one section
    even = 1.2e7 * (float(np.median(world.nominal.stiffness[3:])) / 3.5e5) / s
    EI = even * length**3 / 3.0
    world.arm.shank = Beam(EI, EI, 0.7 * EI, taper=0.6)
    lateral = 1.0 / tip_softness(world.arm.shank, length)
    return HiddenEffect(
        "tool_compliance",
        "tool",
        "a tapered shank from the flange to the tip",
        {"lateral_stiffness": (lateral / 1e6, "N/µm")},
        (1e6 / lateral, "µm/N"),
        [("link_compliance", "link:6")],
    )


def payload(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    mass = 0.25 * s * world.nominal.tool_mass
    where = world.nominal.tool_com + rng.uniform(-0.06, 0.06, 3)
    arm = world.arm
    arm.tool_com = (arm.tool_mass * arm.tool_com + mass * where) / (arm.tool_mass + mass)
    arm.tool_mass += mass
    world.motion.loose_mass = (mass, where)
    return HiddenEffect(
        "payload",
        "tool",
        "a mass at the flange that the cell does not know",
        {"mass": (mass, "kg"), "moment_x": (mass * where[0], "kg·m"), "moment_z": (mass * where[2], "kg·m")},
        (mass, "kg"),
    )


def thermal(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    length = np.array([np.linalg.norm(p.t) for p in (*world.nominal.joints[1:], world.nominal.flange)])
    world.heat = Heat(
        (1, 2, 3, 4), length, 12.0, rng.uniform(500, 900), rng.uniform(2500, 4500), rng.uniform(0.5, 2.0), gain=s
    )
    return HiddenEffect(
        "thermal_drift",
        "environment",
        "motors heat gear boxes, gear boxes heat links, the hall has its day",
        {"rise": (12.0 * s, "K")},
        (12.0 * s, "K"),
    )


def soft_everywhere(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    """The same shift along all axes wherever it is: base, link and tool cannot be told apart."""
    body = {"base": 0, "tool": 6}.get(place, int(place[-1]) if place[-1].isdigit() else 0)
    k = 3.0e7 * world.full / 300.0 / s
    for axis in np.eye(3):
        world.arm.hinges.append(Hinge(body, False, axis, Spring(k)))
    everywhere = [
        ("base_compliance", "base"),
        ("tool_compliance", "tool"),
        *(("link_compliance", f"link:{n}") for n in range(1, 7)),
    ]
    effect = "base_compliance" if place == "base" else "tool_compliance" if place == "tool" else "link_compliance"
    return HiddenEffect(
        effect,
        place,
        "gives way alike in all directions",
        {"stiffness": (k / 1e6, "N/µm")},
        (1e6 / k, "µm/N"),
        everywhere,
    )


def base_spin(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    k = 2.0 * float(world.nominal.stiffness[0]) / s
    world.arm.plate = Plate(0.35, np.full(4, 1e12), np.full(4, 1e12), k / (8 * 0.35**2), only="spin")
    return HiddenEffect(
        "base_compliance",
        "base",
        "the pedestal twists about z only",
        {"torsion": (k, "N·m/rad")},
        (1.0 / k, "rad/(N·m)"),
    )


def forearm_twist(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    k = 2.0 * float(world.nominal.stiffness[3]) / s
    length = float(np.linalg.norm(world.nominal.joints[4].t))
    world.arm.beams[4] = Beam(1.0, 1.0, k * length, only="torsion")
    return HiddenEffect(
        "link_compliance",
        "link:4",
        "the forearm twists about its own axis",
        {"torsion": (k, "N·m/rad")},
        (1.0 / k, "rad/(N·m)"),
    )


def end_turn(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    k = 2.0 * float(world.nominal.stiffness[2]) / s
    world.arm.hinges.append(Hinge(2, True, world.nominal.axes[2], Spring(k)))
    return HiddenEffect(
        "link_compliance",
        "link:2",
        "the end of link 2 turns about joint 3's axis",
        {"rotation": (k, "N·m/rad")},
        (1.0 / k, "rad/(N·m)"),
    )


def flange_twist(world: MeasurementSetup, place: str, s: float, rng: np.random.Generator) -> HiddenEffect:
    k = 2.0 * float(world.nominal.stiffness[5]) / s
    world.arm.hinges.append(Hinge(5, True, world.nominal.axes[5], Spring(k)))
    return HiddenEffect(
        "tool_compliance", "tool", "the flange twists about axis 6", {"torsion": (k, "N·m/rad")}, (1.0 / k, "rad/(N·m)")
    )
