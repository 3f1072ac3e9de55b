"""The cases: which robot, which hidden effects at which ratio to the noise, which fault of the record."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from bushing_simulator.effect_draws import LOAD_EFFECTS, POSE_EFFECTS
from bushing_simulator.record_faults import LOAD_FAULTS, POSE_FAULTS
from bushing_simulator.robot_descriptions import ROBOTS

SMALL, LARGE = (2.0, 6.0, 20.0), (60.0, 120.0, 250.0)
GROUPS = ("null", "single", "large", "several", "outside", "faults")


@dataclass(frozen=True)
class CasePlan:
    """One case before it is drawn; everything random follows from ``key`` and the draw's seed."""

    key: str
    group: str
    kind: str
    robot: str
    effects: tuple[tuple[str, float], ...] = ()  # effect, wanted ratio to σ of a reading
    fault: str = ""
    draw: int = 0

    @property
    def seed(self) -> int:
        """Return the seed of the case's generator."""
        return zlib.crc32(f"{self.key}/{self.draw}".encode())


def list_cases(draw: int = 0, repeats: int = 3) -> list[CasePlan]:
    """Return all cases of a draw, ordered so that every prefix of a group is spread over its effects.

    Args:
        draw: which draw; another one has other robots, places, sizes and noise.
        repeats: cases per effect and size class (each takes another size of the class).
    """
    robots = list(ROBOTS)
    cases = [
        CasePlan(f"null/{kind}/{n}", "null", kind, robots[n % 3])
        for n in range(24)
        for kind in ("deflection", "absolute")
    ]
    for group, sizes in (("single", SMALL), ("large", LARGE)):
        for n in range(repeats):
            for kind, effects in (("deflection", LOAD_EFFECTS), ("absolute", POSE_EFFECTS)):
                for k, effect in enumerate(effects):
                    size = sizes[(n + k) % 3]
                    key = f"{group}/{kind}/{effect}/{size:.0f}/{n}"
                    cases.append(CasePlan(key, group, kind, robots[(n + k) % 3], ((effect, size),)))
    cases += _list_several(robots)
    for n in range(3):
        for kind in ("deflection", "absolute"):
            for k in range(5):
                key = f"outside/{kind}/{k}/{n}"
                ratio = (6.0, 20.0, 60.0)[(n + k) % 3]
                cases.append(CasePlan(key, "outside", kind, robots[(n + k) % 3], ((f"outside:{k}", ratio),)))
    for n in range(2):
        for kind, faults in (("deflection", LOAD_FAULTS), ("absolute", POSE_FAULTS)):
            for k, fault in enumerate(faults):
                cases.append(CasePlan(f"faults/{kind}/{fault}/{n}", "faults", kind, robots[(n + k) % 3], fault=fault))
    return [CasePlan(c.key, c.group, c.kind, c.robot, c.effects, c.fault, draw) for c in _mix_kinds(cases)]


def _mix_kinds(cases: list[CasePlan]) -> list[CasePlan]:
    """Return the cases with load tests and pose sets spread evenly over each round of a group."""
    rounds: dict[tuple[str, str, str], list[CasePlan]] = {}
    for case in cases:
        number = "" if case.group in ("null", "several") else case.key.rpartition("/")[2]
        rounds.setdefault((case.group, number, case.kind), []).append(case)
    placed = [(g, n, (k + 0.5) / len(r), c) for (g, n, _), r in rounds.items() for k, c in enumerate(r)]
    return [c for *_, c in sorted(placed, key=lambda x: x[:3])]


def _list_several(robots: list[str]) -> list[CasePlan]:
    pairs = [
        ("deflection", (("joint_backlash", 8.0), ("link_compliance", 20.0))),
        ("absolute", (("joint_zero_offset", 20.0), ("transmission_error", 8.0))),
        ("deflection", (("joint_hysteresis", 15.0), ("base_compliance", 20.0))),
        ("absolute", (("geometry", 30.0), ("thermal_drift", 8.0))),
        ("deflection", (("joint_nonlinear_stiffness", 20.0), ("joint_creep", 6.0), ("force_sensor_offset", 6.0))),
        ("absolute", (("joint_zero_offset", 30.0), ("joint_coupling", 10.0), ("payload", 10.0))),
        ("deflection", (("joint_pose_dependent_stiffness", 20.0), ("joint_backlash", 8.0))),
        ("deflection", (("tool_compliance", 20.0), ("joint_hysteresis", 10.0), ("displacement_frame", 10.0))),
        ("absolute", (("transmission_error", 15.0), ("transmission_error", 10.0))),
        ("deflection", (("link_compliance", 30.0), ("joint_coupling", 15.0))),
        ("absolute", (("gravity_compensator", 15.0), ("joint_zero_offset", 15.0))),
        ("deflection", (("gravity_compensator", 20.0), ("joint_creep", 8.0))),
    ]
    return [
        CasePlan(f"several/{kind}/{n}", "several", kind, robots[n % 3], effects)
        for n, (kind, effects) in enumerate(pairs)
    ]
