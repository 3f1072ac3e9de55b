"""The foreign lab's cases: what is concealed, in which channel, by which habits. Robots, places, noise come by seed."""

from __future__ import annotations

import fnmatch
import zlib
from dataclasses import dataclass

import recording_faults
from loading_rig import LABS

SETS = {"dev": 41, "sealed": 97}  # first word of every seed


@dataclass(frozen=True)
class Case:
    """One recording. ``effects`` are names with the loudness wanted (sigmas left after a refit of the base)."""

    group: str  # null single pair outside record
    channel: str  # load poses motion
    lab: str
    effects: tuple[tuple[str, float], ...] = ()
    fault: str = ""
    number: int = 0

    @property
    def key(self) -> str:
        what = self.fault or "+".join(f"{n}~{loud:g}" for n, loud in self.effects) or "none"
        return f"{self.group}/{self.channel}/{self.lab}/{what}/{self.number}"

    @property
    def name(self) -> str:
        """A folder that says nothing of what is in it."""
        return f"f{zlib.crc32(self.key.encode()):08x}"

    def seed(self, which: str, draw: int = 0) -> list[int]:
        """Of the case in one draw of a set: each draw has other robots, places, sizes and noise."""
        return [SETS[which], zlib.crc32(self.key.encode()), *([draw] if draw else [])]


LOAD_EFFECTS = (
    "joint_nonlinear_stiffness",
    "joint_backlash",
    "joint_hysteresis",
    "joint_creep",
    "joint_pose_dependent_stiffness",
    "joint_coupling",
    "link_compliance",
    "base_compliance",
    "tool_compliance",
    "force_sensor_offset",
    "force_sensor_gain",
    "force_sensor_frame",
    "load_geometry",
    "displacement_frame",
    "thermal_drift",
)
LOAD_OUTSIDE = ("loose_foot", "nested_reflector", "hose", "bent_amplifier", "slipping_flange", "leaning_floor")
LOAD_SETS = (
    ("link_compliance", "joint_backlash"),
    ("base_compliance", "joint_hysteresis"),
    ("tool_compliance", "joint_nonlinear_stiffness"),
    ("joint_hysteresis", "force_sensor_offset"),
    ("joint_coupling", "base_compliance"),
    ("joint_backlash", "force_sensor_frame"),
    ("joint_creep", "link_compliance"),
    ("thermal_drift", "joint_hysteresis"),
    ("joint_pose_dependent_stiffness", "tool_compliance"),
    ("load_geometry", "joint_backlash"),
    ("link_compliance", "base_compliance", "joint_hysteresis"),
    ("joint_backlash", "tool_compliance", "thermal_drift"),
    ("joint_nonlinear_stiffness", "base_compliance", "force_sensor_offset"),
    ("joint_coupling", "joint_hysteresis", "link_compliance", "displacement_frame"),
    ("base_compliance", "tool_compliance", "joint_backlash", "joint_hysteresis"),
)
# habits under which an effect has no fair chance or no meaning
UNFIT = {
    "joint_hysteresis": ("no_repeats",),
    "thermal_drift": ("one_day", "wandering"),  # no clock; its own wandering noise
    "force_sensor_frame": ("weights",),
}
LOAD_LABS = tuple(n for n in LABS if n != "mirrored")  # where nothing repeats, nothing is due: nulls only
LOUDNESS = (0.4, 1.0, 2.5)


def _lab(names: tuple[str, ...], k: int) -> str:
    """The k-th habit that suits all of ``names``."""
    fit = [lab for lab in LOAD_LABS if all(lab not in UNFIT.get(n, ()) for n in names)]
    return fit[k % len(fit)]


def load_cases() -> list[Case]:
    out = [Case("null", "load", lab, number=k) for lab in LABS for k in range(3)]
    for k, name in enumerate(LOAD_EFFECTS):
        for m, loud in enumerate(LOUDNESS):
            out.append(Case("single", "load", _lab((name,), 5 * m + k), ((name, loud),)))
    for k, names in enumerate(LOAD_SETS):
        out.append(Case("pair", "load", _lab(names, 7 * k + 1), tuple((n, 1.6) for n in names)))
    for k, name in enumerate(LOAD_OUTSIDE):
        for m, loud in enumerate((0.8, 2.0)):
            out.append(Case("outside", "load", LOAD_LABS[(3 * k + 5 * m) % 4], ((name, loud),)))
    out.append(Case("record", "load", "full", fault="tcp_length"))
    habits = ("plain", "full", "crude", "one_day", "twelve", "through_tcp")
    for k, fault in enumerate(recording_faults.LOAD_FAULTS):
        lab = habits[k % 6]
        if lab == "one_day" and "session" in fault.name:
            lab = "plain"
        out.append(Case("record", "load", lab, fault=fault.name))
    return out


POSE_EFFECTS = {  # and the labs where they can be told from the registration
    "joint_zero_offset": ("fixed", "fit"),
    "transmission_error": ("fit", "fixed"),
    "geometry": ("fit", "fixed"),
    "geometry ": ("fit_6d", "fixed_once"),
    "joint_coupling": ("fixed", "fit"),
    "payload": ("fixed", "fit"),
    "gravity_compensator": ("fit", "fixed_once"),
    "link_compliance": ("fixed", "fit_6d"),
    "base_compliance": ("fixed", "fixed_once"),
    "joint_pose_dependent_stiffness": ("fixed", "fit"),
    "joint_backlash": ("fixed", "fit"),
    "thermal_drift": ("fixed", "fit"),
    "displacement_frame": ("fixed",),
}
POSE_SETS = (
    ("geometry", "transmission_error"),
    ("geometry", "joint_zero_offset", "transmission_error"),
    ("payload", "joint_coupling"),
    ("transmission_error", "thermal_drift"),
    ("geometry", "link_compliance", "joint_zero_offset"),
    ("gravity_compensator", "joint_zero_offset"),
)


def pose_cases() -> list[Case]:
    labs = ("fit", "fixed", "fit_6d", "fixed_once", "fit_crude", "fixed_few")
    out = [Case("null", "poses", lab, number=k) for lab in labs for k in range(4)]
    for name, fit in POSE_EFFECTS.items():
        for m, loud in enumerate((1.0, 3.0)):
            out.append(Case("single", "poses", fit[m % len(fit)], ((name.strip(), loud),)))
    for k, names in enumerate(POSE_SETS):
        out.append(Case("pair", "poses", ("fixed", "fit")[k % 2], tuple((n, 2.0) for n in names)))
    for k, name in enumerate(("bearing_wobble", "warm_air", "slack_cable")):
        for m, loud in enumerate((1.0, 2.5)):
            out.append(Case("outside", "poses", ("fixed", "fit")[(k + m) % 2], ((name, loud),)))
    for fault in recording_faults.POSE_FAULTS:
        # the registration would take in what the whole record shares
        lab = "fixed" if fault.name in ("pose_tracker_reseated", "pose_swapped_yz") else ("fixed", "fit")[len(out) % 2]
        out.append(Case("record", "poses", lab, fault=fault.name))
    return out + reflector_cases()


def reflector_cases() -> list[Case]:
    """Several nests on the flange, a tracker anywhere in the hall, moved or not."""
    labs = ("reflectors", "reflectors_moved")
    out = [Case("null", "poses", lab, number=k) for lab in labs for k in range(4)]
    names = ("geometry", "joint_zero_offset", "transmission_error", "payload", "link_compliance")
    for k, name in enumerate(names):
        out += [Case("single", "poses", labs[(k + m) % 2], ((name, loud),)) for m, loud in enumerate((1.0, 3.0))]
    out.append(Case("pair", "poses", "reflectors", (("geometry", 2.0), ("transmission_error", 2.0))))
    return out + [Case("record", "poses", lab, fault=f.name) for lab in labs for f in recording_faults.NEST_FAULTS]


MOTION_EFFECTS = {
    "torque": ("joint_friction", "payload", "gravity_compensator", "time_skew", "torque_gain", "wrist"),
    "amps": ("joint_friction", "gravity_compensator"),
    "link": ("joint_backlash", "joint_hysteresis", "joint_nonlinear_stiffness", "transmission_error", "time_skew"),
}


def motion_cases() -> list[Case]:
    labs = ("torque", "torque_restless", "link", "amps")
    out = [Case("null", "motion", lab, number=k) for lab in labs for k in range(6)]
    for lab, names in MOTION_EFFECTS.items():
        for name in names:
            out += [Case("single", "motion", lab, ((name, loud),)) for loud in (0.5, 1.5)]
    out.append(Case("pair", "motion", "torque", (("payload", 1.5), ("time_skew", 1.0))))
    out.append(Case("pair", "motion", "torque", (("payload", 1.5), ("torque_gain", 1.5))))
    out.append(Case("pair", "motion", "torque", (("wrist", 1.5), ("joint_friction", 1.5))))
    out.append(Case("pair", "motion", "link", (("joint_hysteresis", 2.0), ("transmission_error", 1.5))))
    out += [
        Case("outside", "motion", "torque", ((n, loud),))
        for n in ("rotor", "hose", "soft_reversal")
        for loud in (0.6, 1.5)
    ]
    out += [Case("record", "motion", "torque", fault=f.name) for f in recording_faults.MOTION_FAULTS]
    return out


LARGE = (60.0, 120.0, 250.0)  # r.m.s. that an effect adds before the refit, in sigmas of a reading
LARGE_SETS = {
    "load": (
        ("joint_backlash", "tool_compliance"),
        ("joint_hysteresis", "link_compliance"),
        ("base_compliance", "joint_nonlinear_stiffness"),
        ("joint_coupling", "joint_backlash"),
        ("joint_pose_dependent_stiffness", "force_sensor_frame"),
        ("joint_creep", "tool_compliance"),
        ("joint_hysteresis", "joint_backlash", "tool_compliance"),
        ("base_compliance", "joint_nonlinear_stiffness", "displacement_frame"),
    ),
    "poses": (
        ("joint_zero_offset", "transmission_error"),
        ("geometry", "joint_backlash"),
        ("payload", "joint_zero_offset"),
        ("joint_zero_offset", "link_compliance", "transmission_error"),
    ),
}


def large_cases() -> list[Case]:
    """Effects of 60 to 250 sigmas, alone and in twos and threes (of 60 to 120)."""
    out = []
    for k, name in enumerate(LOAD_EFFECTS):
        out += [
            Case("large", "load", _lab((name,), 3 * k + m), ((name, LARGE[(k + m) % 3]),), number=m) for m in (0, 1)
        ]
    for k, (name, fit) in enumerate(POSE_EFFECTS.items()):
        out.append(Case("large", "poses", fit[k % len(fit)], ((name.strip(), LARGE[k % 3]),)))
    for channel, sets in LARGE_SETS.items():
        for k, names in enumerate(sets):
            lab = _lab(names, 5 * k + 2) if channel == "load" else ("fixed", "fit")[k % 2]
            out.append(Case("large_sets", channel, lab, tuple((n, LARGE[(k + m) % 2]) for m, n in enumerate(names))))
    return out


def mass_cases() -> list[Case]:
    """Links whose masses are 5 % off the URDF's, alone and with a payload or a gravity compensator."""
    out = [
        Case("mass_null", "poses", lab, number=k) for lab in ("fixed", "fit", "fit_6d", "fixed_once") for k in range(5)
    ]
    out += [Case("mass_null", "motion", "torque", number=k) for k in range(5)]
    for name in ("payload", "gravity_compensator"):
        for k in range(3):
            out += [Case("mass_single", "poses", lab, ((name, 3.0 + 3.0 * k),)) for lab in ("fixed", "fit")]
        out += [Case("mass_single", "motion", "torque", ((name, 1.5),), number=k) for k in range(2)]
    return out


def cases() -> list[Case]:
    """One set."""
    return load_cases() + pose_cases() + motion_cases()


FAST = (
    "null/load/plain/none/0",
    "null/load/through_tcp/none/0",
    "null/load/through_tcp_6/none/0",
    "null/load/no_repeats/none/0",
    "null/load/crude/none/0",
    "null/load/wandering/none/0",
    "null/load/weights/none/0",
    "single/load/*/joint_backlash~1/0",
    "single/load/*/joint_hysteresis~1/0",
    "single/load/*/joint_nonlinear_stiffness~2.5/0",
    "single/load/*/link_compliance~1/0",
    "single/load/*/base_compliance~1/0",
    "single/load/*/force_sensor_offset~1/0",
    "single/load/*/thermal_drift~1/0",
    "pair/load/*/link_compliance~1.6+joint_backlash*",
    "pair/load/*/base_compliance~1.6+joint_hysteresis*",
    "outside/load/*/nested_reflector~2/0",
    "outside/load/*/slipping_flange~2/0",
    "record/load/*/inch_one_session/*",
    "record/load/*/swapped_yz_one_session/*",
    "record/load/*/rows_one_late_one_session/*",
    "record/load/*/tracker_reseated/*",
    "record/load/*/sign_q5/*",
    "null/poses/fit/none/0",
    "null/poses/fixed/none/0",
    "single/poses/*/geometry~3/0",
    "single/poses/*/transmission_error~3/0",
    "single/poses/*/payload~3/0",
    "record/poses/*/pose_sign_q4/*",
    "null/motion/torque/none/0",
    "single/motion/*/joint_friction~1.5/0",
    "single/motion/*/joint_hysteresis~1.5/0",
)


def chosen(only: list[str], fast: bool, share: float = 1.0) -> list[Case]:
    """Cases whose key or folder matches a pattern; ``share`` takes an even part of every group, fixed by name."""
    listed = cases() + (large_cases() if any(p.startswith("large") for p in only) else [])
    listed += mass_cases() if any(p.startswith("mass") for p in only) else []
    if fast:
        listed = [c for c in listed if any(fnmatch.fnmatch(c.key, p) for p in FAST)]
    if only:
        listed = [c for c in listed if any(fnmatch.fnmatch(c.key, p) or c.name == p for p in only)]
    if share < 1.0:
        listed = [c for c in listed if int(c.name[1:], 16) % 1000 < 1000 * share]
    return listed
