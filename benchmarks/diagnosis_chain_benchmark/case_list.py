"""The list of cases. What a case conceals is in its key, which the diagnosing process never sees: folders are numbered.

Places, robots, sizes within a level, poses, noise and faults come from the seed: ``dev`` seeds are for building and
setting thresholds, ``sealed`` seeds for the figures that are reported.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np
from simulator.case_simulation import Case, Part

SETS = {"dev": 20240, "sealed": 77031}
ROBOTS = ("kr240_drilling", "irb6700_drilling", "kr500_milling")
STIFF = ("irb6700_drilling", "kr500_milling")
# where the effect can be seen at all beside the springs
SHOWS = {
    "geometric_stiffness": ("kr240_drilling",),
    "gravity_compensator": ("kr240_drilling",),
    "tool_compliance": STIFF,
}
ODD = "cutting_cobot"  # no spherical wrist
SIZES = ("small", "medium", "large")
# for a quick look: fewer cases, fewer readings
FAST = (
    "null/deflection.[0-9]",
    "null/absolute.[0-3]",
    "null/motion.[0-2]",
    "deflection/joint_hysteresis.2/large",
    "deflection/link_compliance.6/large",
    "deflection/joint_backlash.1/large",
    "deflection/force_sensor_gain.14/large",
    "deflection/base_compliance.8/large",
    "absolute/joint_zero_offset.0/large",
    "absolute/thermal_drift.3/large",
    "motion/joint_friction.0/large",
    "motion/time_skew.4/medium",
    "pair/joint_hysteresis+link_compliance.0",
    "outside/loose_bolt.0",
    "outside/tracker_kick.8",
    "set/base_spin.1",
    "record/units.0",
    "record/outliers.4",
)


def joints(*numbers: int) -> tuple[str, ...]:
    return tuple(f"joint:{n}" for n in numbers)


def links(*numbers: int) -> tuple[str, ...]:
    return tuple(f"link:{n}" for n in numbers)


# effect, places, channels
DEFLECTION = (
    ("joint_nonlinear_stiffness", joints(1, 2, 3, 4, 5, 6), ("3d", "6d", "3d")),
    ("joint_backlash", joints(1, 4, 5, 6), ("3d", "3d", "6d")),
    ("joint_hysteresis", joints(1, 2, 3, 4, 5, 6), ("3d", "6d", "3d")),
    ("joint_hysteresis", joints(1, 2, 3), ("6d", "3d", "3d")),
    ("joint_creep", joints(1, 2, 3), ("3d", "3d", "6d")),
    ("joint_pose_dependent_stiffness", joints(1, 2, 3, 4, 5), ("3d", "6d", "3d")),
    ("link_compliance", links(2, 3, 4), ("6d", "3d", "3d")),
    ("link_compliance", links(1, 2, 4), ("3d", "3d", "6d")),
    ("base_compliance", ("base",), ("3d", "6d", "3d")),
    ("tool_compliance", ("tool",), ("6d", "6d", "3d")),
    ("joint_coupling", ("joint:4-5", "joint:5-6", "joint:4-6"), ("6d", "3d", "3d")),
    ("gravity_compensator", joints(2), ("3d", "3d", "6d")),
    ("geometric_stiffness", ("arm",), ("3d", "6d", "3d")),
    ("force_sensor_offset", ("sensor:force",), ("3d", "3d", "6d")),
    ("force_sensor_gain", ("sensor:force",), ("3d", "6d", "3d")),
    ("force_sensor_frame", ("sensor:force",), ("3d", "3d", "6d")),
    ("displacement_frame", ("sensor:displacement",), ("3d", "6d", "3d")),
    ("load_geometry", ("sensor:force",), ("3d", "6d", "3d")),
)
ABSOLUTE = (
    ("joint_zero_offset", joints(2, 3, 4, 5)),
    ("transmission_error", joints(1, 2, 3, 4, 5)),
    ("payload", ("tool",)),
    ("thermal_drift", ("environment",)),
    ("gravity_compensator", joints(2)),
    ("link_compliance", links(1, 2, 4)),
    ("joint_coupling", ("joint:4-5", "joint:5-6")),
)
MOTION = (
    ("joint_friction", joints(1, 2, 3, 4, 5, 6), "torque"),
    ("payload", ("tool",), "torque"),
    ("gravity_compensator", joints(2), "torque"),
    ("time_skew", ("sensor:tau",), "torque"),
    ("time_skew", ("sensor:qse",), "link"),
    ("transmission_error", joints(1, 2, 3, 4), "link"),
    ("joint_hysteresis", joints(1, 2, 3), "link"),
    ("joint_backlash", joints(1, 4, 5), "link"),
    ("joint_elasticity", joints(1, 2, 3), "link"),
    ("servo_lag", ("controller",), "tip"),
)
PAIRS = (
    ("deflection", "3d", ("joint_hysteresis", joints(2, 3)), ("link_compliance", links(2, 4))),
    ("deflection", "3d", ("joint_backlash", joints(1, 4)), ("joint_pose_dependent_stiffness", joints(2, 3))),
    ("deflection", "6d", ("base_compliance", ("base",)), ("joint_hysteresis", joints(1, 3))),
    ("deflection", "3d", ("force_sensor_gain", ("sensor:force",)), ("joint_hysteresis", joints(2))),
    ("deflection", "6d", ("tool_compliance", ("tool",)), ("joint_nonlinear_stiffness", joints(1, 3))),
    ("deflection", "3d", ("joint_backlash", joints(6, 5)), ("base_compliance", ("base",))),
    ("deflection", "6d", ("force_sensor_offset", ("sensor:force",)), ("link_compliance", links(2, 3))),
    ("deflection", "3d", ("joint_creep", joints(1, 3)), ("joint_coupling", ("joint:4-5",))),
    ("deflection", "3d", ("displacement_frame", ("sensor:displacement",)), ("joint_hysteresis", joints(1, 4))),
    ("deflection", "3d", ("gravity_compensator", joints(2)), ("joint_backlash", joints(1, 4))),
    ("absolute", "3d", ("joint_zero_offset", joints(3, 4)), ("thermal_drift", ("environment",))),
    ("absolute", "6d", ("payload", ("tool",)), ("transmission_error", joints(1, 2))),
    ("absolute", "3d", ("joint_coupling", ("joint:4-5",)), ("joint_zero_offset", joints(2, 3))),
    ("motion", "torque", ("joint_friction", joints(1, 3)), ("payload", ("tool",))),
    ("motion", "link", ("joint_hysteresis", joints(2)), ("transmission_error", joints(1, 3))),
    ("motion", "link", ("joint_backlash", joints(1)), ("time_skew", ("sensor:qse",))),
)
OUTSIDE = (
    ("deflection", "3d", "loose_bolt", ("base",)),
    ("deflection", "6d", "loose_bolt", ("base",)),
    ("deflection", "3d", "bearing_play", joints(1, 2, 3)),
    ("deflection", "6d", "bearing_play", joints(1, 2, 3)),
    ("deflection", "3d", "hose_spring", ("link:4",)),
    ("deflection", "3d", "bent_amplifier", ("sensor:force",)),
    ("absolute", "3d", "sun_bow", ("link:2",)),
    ("absolute", "6d", "sun_bow", ("link:2",)),
    ("absolute", "3d", "tracker_kick", ("tracker",)),
    ("absolute", "3d", "gear_wear", joints(1, 2, 3)),
    ("absolute", "3d", "hose_spring", ("link:4",)),
    ("motion", "torque", "cable_drag", joints(4, 5, 6)),
    ("motion", "torque", "gear_wear", joints(1, 2, 3)),
    ("motion", "link", "gear_wear", joints(1, 3, 4)),
    ("motion", "torque", "rotor_inertia", joints(1, 2, 3)),
)
INSEPARABLE = (
    ("soft_everywhere", ("base", "link:2", "link:4", "tool"), "3d"),
    ("base_spin", ("base",), "6d"),
    ("forearm_twist", ("link:4",), "6d"),
    ("end_turn", ("link:2",), "3d"),
    ("flange_twist", ("tool",), "3d"),
    ("common_gain", ("sensor:force",), "3d"),
    ("gravity_compensator", joints(2), "3d"),
    ("joint_coupling", ("joint:2-3",), "3d"),
    ("tool_compliance", ("tool",), "3d"),
    ("joint_backlash", joints(2, 3), "3d"),
)
BROKEN = (
    ("deflection", "3d", "units", ("column:dx_mm",)),
    ("deflection", "3d", "units", ("column:q1_deg",)),
    ("deflection", "6d", "units", ("column:mx_Nm",)),
    ("deflection", "6d", "units", ("column:rx_mrad",)),
    ("deflection", "3d", "outliers", ("rows",)),
    ("deflection", "6d", "outliers", ("rows",)),
    ("absolute", "3d", "units", ("column:x_mm",)),
    ("absolute", "3d", "outliers", ("rows",)),
    ("deflection", "3d", "force_sensor_frame", ("sensor:force",)),
    ("deflection", "3d", "load_geometry", ("sensor:force",)),
)


def cases() -> list[Case]:
    """All cases in a fixed order."""
    out: list[Case] = []
    for n, (effect, places, channels) in enumerate(DEFLECTION):
        for level, channel in zip(SIZES, channels, strict=True):
            robots = SHOWS.get(effect, ROBOTS)
            frame = "tool" if effect.startswith("force_") and level != "medium" else "base"
            part = Part(effect, places, level)
            out.append(
                Case(
                    f"deflection/{effect}.{n}/{level}",
                    "single",
                    "deflection",
                    channel,
                    robots,
                    (part,),
                    wrench_frame=frame,
                )
            )
    for n, (effect, places) in enumerate(ABSOLUTE):
        for level in SIZES:
            channel, weights = ("6d", 0) if (n + len(level)) % 3 == 0 else ("3d", 1 if level == "large" else 0)
            out.append(
                Case(
                    f"absolute/{effect}.{n}/{level}",
                    "single",
                    "absolute",
                    channel,
                    STIFF,
                    (Part(effect, places, level),),
                    weights=weights,
                )
            )
    for n, (effect, places, channel) in enumerate(MOTION):
        for level in SIZES:
            # the small ones are looked for with sensors behind the gears, where no friction hides them
            options = {"motor_side": channel == "torque" and (level != "small" or effect == "joint_friction")}
            out.append(
                Case(
                    f"motion/{effect}.{n}/{level}",
                    "single",
                    "motion",
                    channel,
                    ROBOTS,
                    (Part(effect, places, level),),
                    options=options,
                )
            )
    for n, (kind, channel, one, two) in enumerate(PAIRS):
        parts = (Part(*one, "large"), Part(*two, "large"))
        robots = STIFF if kind == "absolute" else SHOWS.get(one[0], ROBOTS)
        out.append(Case(f"pair/{one[0]}+{two[0]}.{n}", "pair", kind, channel, robots, parts))
    for n, (kind, channel, effect, places) in enumerate(OUTSIDE):
        robots = STIFF if kind == "absolute" else ROBOTS
        out.append(Case(f"outside/{effect}.{n}", "outside", kind, channel, robots, (Part(effect, places, "large"),)))
    for n, (effect, places, channel) in enumerate(INSEPARABLE):
        robots = SHOWS.get(effect, ROBOTS)
        out.append(Case(f"set/{effect}.{n}", "set", "deflection", channel, robots, (Part(effect, places, "large"),)))
    for n, (kind, channel, effect, places) in enumerate(BROKEN):
        robots = STIFF if kind == "absolute" else ROBOTS
        level = "large"
        out.append(Case(f"record/{effect}.{n}", "record", kind, channel, robots, (Part(effect, places, level),)))
    return [*out, *nulls()]


def nulls() -> Iterator[Case]:
    """Nothing is concealed; half of them are ugly."""
    for n in range(48):
        ugly, channel = n % 2 == 1, "6d" if n % 3 == 0 else "3d"
        robots = (ODD,) if n % 12 == 11 else ROBOTS
        frame = "tool" if n % 5 == 4 else "base"
        yield Case(f"null/deflection.{n}", "null", "deflection", channel, robots, ugly=ugly, wrench_frame=frame)
    for n in range(24):
        channel = "6d" if n % 4 == 0 else "3d"
        yield Case(f"null/absolute.{n}", "null", "absolute", channel, STIFF, ugly=n % 2 == 1, weights=n % 3 % 2)
    for n in range(18):
        channel = ("torque", "link", "tip")[n % 3]
        options = {"motor_side": channel == "torque" and n % 2 == 0}
        yield Case(f"null/motion.{n}", "null", "motion", channel, ROBOTS, options=options)


def numbered(which: str, rounds: int = 1, draw: int = 0) -> list[tuple[str, Case, tuple[int, ...]]]:
    """Folder name, case and seed; the order is shuffled so that a number tells nothing.

    Args:
        which: dev or sealed.
        rounds: every case so many times, with a new seed each, for more statistics.
        draw: which draw of the set; 0 is the first, every other one has seeds and numbers of its own.
    """
    listed = [(case, r) for r in range(rounds) for case in cases()]
    drawn = (draw,) if draw else ()  # the first draw keeps the seeds it had before there were others
    order = np.random.default_rng([SETS[which], rounds, *drawn]).permutation(len(listed))
    return [
        (f"case_{n:03d}", listed[k][0], (SETS[which], zlib.crc32(listed[k][0].key.encode()), listed[k][1], *drawn))
        for n, k in enumerate(order.tolist())
    ]
