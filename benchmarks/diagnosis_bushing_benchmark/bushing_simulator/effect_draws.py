"""Hidden effects of the vocabulary: where, with which law, and what the true parameters are.

Each drawn effect changes a ``Laboratory`` by a scale; ``effect_size`` finds the scale that gives the wanted ratio
to the noise.
"""

from __future__ import annotations

import numpy as np

from bushing_simulator import gear_laws as gears
from bushing_simulator.laboratory import DrawnEffect, Laboratory, state_no_parameters
from bushing_simulator.robot_descriptions import RobotDescription

ARCMIN, ARCSEC = np.deg2rad(1 / 60), np.deg2rad(1 / 3600)


def _estimate_reference(robot: RobotDescription, joint: int) -> float:
    return robot.pull * (1.4 if joint < 3 else 0.45)


def draw_gear_effect(
    effect: str, robot: RobotDescription, rng: np.random.Generator, joint: int | None = None
) -> DrawnEffect:
    """Return an effect of one gear (joint 0 … 5; drawn where None)."""
    j = int(rng.integers(0, 6)) if joint is None else joint
    place, ref = f"joint:{j + 1}", _estimate_reference(robot, j)
    windup = ref / robot.springs[j]
    if effect == "joint_nonlinear_stiffness":
        return DrawnEffect(
            effect,
            place,
            "roller contacts, |τ|^0.6",
            lambda lab, s: lab.hidden.laws.append(gears.HertzWindup(j, 0.1 * s * windup, ref)),
            20.0,
            state_no_parameters,
        )
    if effect == "joint_backlash":
        return DrawnEffect(
            effect,
            place,
            "rounded dead band between two flanks",
            lambda lab, s: lab.hidden.laws.append(gears.RoundedPlay(j, s * ARCMIN, lab.hidden.springs[j])),
            8.0,
            lambda s: {"width": (s, "arcmin")},
        )
    if effect == "joint_hysteresis":
        return DrawnEffect(
            effect,
            place,
            "Iwan stack of 24 Jenkins elements",
            lambda lab, s: lab.hidden.laws.append(gears.SlipStack(j, min(0.3 * s, 0.9), lab.hidden.springs[j], ref)),
            3.0,
            state_no_parameters,
        )
    if effect == "joint_creep":
        return DrawnEffect(
            effect,
            place,
            "two Kelvin-Voigt elements, 11 s and 95 s",
            lambda lab, s: lab.hidden.laws.append(gears.CreepPair(j, 0.05 * s, lab.hidden.springs[j])),
            8.0,
            state_no_parameters,
        )
    if effect == "joint_pose_dependent_stiffness":
        center = float(rng.uniform(-1.0, 1.0)) + float(np.deg2rad(robot.limits_deg[j].mean()))
        accepted = (("gravity_compensator", "joint:2"),) if j == 1 else ()
        return DrawnEffect(
            effect,
            place,
            "worn sector, von Mises",
            lambda lab, s: lab.hidden.laws.append(gears.SoftSector(j, 0.3 * s, lab.hidden.springs[j], center)),
            12.0,
            state_no_parameters,
            accepted,
        )
    return _draw_angle_error(effect, j, rng)


def _draw_angle_error(effect: str, j: int, rng: np.random.Generator) -> DrawnEffect:
    """Return an error of a joint angle that does not depend on load."""
    place = f"joint:{j + 1}"
    if effect == "transmission_error":
        order, phase = int(rng.choice([2, 3, 9, 17, 36])), float(rng.uniform(0, 6.28))
        return DrawnEffect(
            effect,
            place,
            f"order {order} modulated, with its second",
            lambda lab, s: lab.hidden.laws.append(gears.GearWaves(j, 20 * s * ARCSEC, order, phase)),
            12.0,
            lambda s: {"amplitude": (20 * s, "arcsec")},
        )
    if effect == "joint_zero_offset":
        j = max(j, 1)
        sign = float(rng.choice([-1, 1]))
        return DrawnEffect(
            effect,
            f"joint:{j + 1}",
            "encoder zero",
            lambda lab, s: lab.hidden.laws.append(gears.AngleOffset(j, sign * np.deg2rad(0.01 * s))),
            100.0,
            lambda s: {"offset": (sign * 0.01 * s, "deg")},
        )
    raise ValueError(effect)


def draw_coupling(robot: RobotDescription, rng: np.random.Generator, kind: str) -> DrawnEffect:
    """Return a wrist coupling: elastic (shaft in shaft) for load tests, kinematic for pose sets."""
    i, j = [(3, 4), (4, 5), (3, 5)][int(rng.integers(0, 3))]
    place = f"joint:{i + 1}-{j + 1}"
    if kind == "absolute":
        i, j = [(3, 4), (4, 5)][int(rng.integers(0, 2))]
        return DrawnEffect(
            "joint_coupling",
            f"joint:{i + 1}-{j + 1}",
            "Δq_j = κ q_i",
            lambda lab, s: lab.hidden.laws.append(gears.AngleCoupling(j, i, 2e-4 * s)),
            40.0,
            lambda s: {"ratio": (2e-4 * s, "1")},
        )
    softness = 0.25 / robot.springs[j]

    def apply(lab: Laboratory, s: float) -> None:
        lab.hidden.laws.append(gears.HollowShaft(i, j, 0.6, softness * s))
        lab.hidden.laws.append(gears.HollowShaft(j, i, 0.6, softness * s, own=True))

    return DrawnEffect("joint_coupling", place, "hollow shafts", apply, 20.0, state_no_parameters)


def draw_body_effect(effect: str, robot: RobotDescription, rng: np.random.Generator) -> DrawnEffect:
    """Return a soft link, base or tool, a compensator, a wrong payload or as-built geometry."""
    if effect == "link_compliance":
        lengths = np.linalg.norm(np.vstack([robot.origins[1:], robot.flange]), axis=1)
        link = int(rng.choice(np.flatnonzero(lengths > 0.15) + 1))
        return DrawnEffect(
            effect,
            f"link:{link}",
            "four pieces of a tapered box",
            lambda lab, s: lab.hidden.link_softness.__setitem__(link, s),
            60.0,
            state_no_parameters,
        )
    if effect == "base_compliance":
        return DrawnEffect(
            effect,
            "base",
            "plate on four bolts",
            lambda lab, s: setattr(lab.hidden, "base_softness", s),
            60.0,
            state_no_parameters,
        )
    if effect == "tool_compliance":
        return DrawnEffect(
            effect,
            "tool",
            "flange plate and shank",
            lambda lab, s: setattr(lab.hidden, "tool_softness", s),
            60.0,
            state_no_parameters,
        )
    if effect == "gravity_compensator":
        return DrawnEffect(
            effect,
            "joint:2",
            "spring cylinder between two pivots",
            lambda lab, s: setattr(lab.hidden, "compensator", s),
            80.0,
            state_no_parameters,
            (("joint_pose_dependent_stiffness", "joint:2"),),
        )
    return _draw_nominal_error(effect, robot, rng)


def _draw_nominal_error(effect: str, robot: RobotDescription, rng: np.random.Generator) -> DrawnEffect:
    """Return a wrong payload or as-built geometry."""
    if effect == "payload":
        sign = float(rng.choice([-1, 1]))

        def add_mass(lab: Laboratory, s: float) -> None:
            lab.hidden.tool_mass = max(lab.hidden.tool_mass + sign * 5.0 * s, 1.0)

        return DrawnEffect(
            effect, "tool", "heavier or lighter tool", add_mass, 10.0, lambda s: {"mass": (sign * 5.0 * s, "kg")}
        )
    if effect == "geometry":
        joint, axis = int(rng.integers(2, 6)), int(rng.integers(0, 3))
        shift = np.zeros(6)
        shift[axis], shift[3:] = 1e-4, rng.normal(0, 3e-5, 3)
        return DrawnEffect(
            effect,
            f"joint:{joint}",
            "as-built link length and twist",
            lambda lab, s: lab.hidden.marker_shift.__setitem__(joint, s * shift),
            60.0,
            state_no_parameters,
        )
    raise ValueError(effect)


def draw_laboratory_effect(effect: str, robot: RobotDescription, rng: np.random.Generator) -> DrawnEffect:
    """Return an error of an instrument or of the environment."""
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    if effect == "force_sensor_offset":
        return DrawnEffect(
            effect,
            "sensor:force",
            "constant in sensor axes",
            lambda lab, s: lab.sensors.update(force_offset=5.0 * s * n),
            100.0,
            lambda s: {"offset": (5.0 * s, "N")},
        )
    if effect == "force_sensor_gain":
        axis = int(rng.integers(0, 3))
        cross = rng.normal(0, 0.15, (3, 3))

        def set_gain(lab: Laboratory, s: float) -> None:
            gain = 0.02 * s * (np.outer(np.eye(3)[axis], np.eye(3)[axis]) + cross)
            lab.sensors.update(force_gain=np.eye(3) + gain)

        return DrawnEffect(
            effect,
            "sensor:force",
            "one channel and cross-talk",
            set_gain,
            25.0,
            state_no_parameters,
            (("force_sensor_frame", "sensor:force"),),
        )
    if effect == "force_sensor_frame":
        return DrawnEffect(
            effect,
            "sensor:force",
            "turned mount",
            lambda lab, s: lab.sensors.update(force_turn=np.deg2rad(0.5 * s) * n),
            30.0,
            lambda s: {"angle": (0.5 * s, "deg")},
            (("load_geometry", "sensor:force"),),
        )
    if effect == "load_geometry":
        return DrawnEffect(
            effect,
            "sensor:force",
            "hook beside the TCP",
            lambda lab, s: lab.sensors.update(hook=5e-3 * s * n),
            60.0,
            lambda s: {"offset": (5.0 * s, "mm")},
        )
    return _draw_place_error(effect, n)


def _draw_place_error(effect: str, n: np.ndarray) -> DrawnEffect:
    """Return a turned tracker or the growth of links; ``n`` is a unit vector (3,)."""
    if effect == "displacement_frame":
        return DrawnEffect(
            effect,
            "sensor:displacement",
            "turned tracker frame",
            lambda lab, s: lab.sensors.update(tracker_turn=np.deg2rad(0.3 * s) * n),
            40.0,
            lambda s: {"angle": (0.3 * s, "deg")},
        )
    if effect == "thermal_drift":
        return DrawnEffect(
            effect,
            "environment",
            "growth of links, two time constants",
            lambda lab, s: lab.errors.update(heat=s),
            15.0,
            state_no_parameters,
        )
    raise ValueError(effect)


GEAR_EFFECTS = (
    "joint_nonlinear_stiffness", "joint_backlash", "joint_hysteresis", "joint_creep", "joint_pose_dependent_stiffness",
    "transmission_error", "joint_zero_offset",
)  # fmt: skip
BODY_EFFECTS = ("link_compliance", "base_compliance", "tool_compliance", "gravity_compensator", "payload", "geometry")
LOAD_EFFECTS = (*GEAR_EFFECTS[:5], "joint_coupling", *BODY_EFFECTS[:4], "force_sensor_offset", "force_sensor_gain",
                "force_sensor_frame", "load_geometry", "displacement_frame")  # fmt: skip
POSE_EFFECTS = ("joint_zero_offset", "transmission_error", "joint_coupling", "geometry", "payload",
"gravity_compensator",
                "link_compliance", "joint_backlash", "thermal_drift")  # fmt: skip


def draw_effect(effect: str, robot: RobotDescription, rng: np.random.Generator, kind: str) -> DrawnEffect:
    """Return one effect of the vocabulary with its place and its unit magnitude."""
    if effect == "joint_coupling":
        return draw_coupling(robot, rng, kind)
    if effect in GEAR_EFFECTS:
        loaded = int(rng.choice([1, 2, 4])) if kind == "absolute" and effect == "joint_backlash" else None
        return draw_gear_effect(effect, robot, rng, loaded)
    if effect in BODY_EFFECTS:
        return draw_body_effect(effect, robot, rng)
    return draw_laboratory_effect(effect, robot, rng)
