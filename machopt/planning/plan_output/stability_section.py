"""Stability of milling in messages and in section ``process`` of result.json."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan import Plan
from machopt.planning.sampling.configurations import solve_station


def find_best_ratio(plan: Plan, station: int) -> tuple[float, float] | None:
    """Return the largest ratio of stability at a station within limits and margins, and its gamma in rad.

    None where the plan has no limit of stability, or no configuration is there. Collisions are not considered.

    Args:
        plan: plan of one tool.
        station: index of the station.
    """
    arm, path = plan.setup.arm, plan.path
    if arm.stability is None:
        return None
    q, reason = solve_station(path, arm, plan.candidates, station)
    rotation, branch = np.nonzero(reason == InfeasibilityReason.OK)
    if not len(rotation):
        return None
    point = int(path.stations[station])
    ratio = arm.stability.compute_ratios(arm, path, np.full(len(rotation), point), q[rotation, branch])
    best = int(np.argmax(ratio))
    gamma = plan.candidates.phi_at()[station, rotation[best]] + path.offset[point]
    return float(ratio[best]), float(wrap_angle(gamma))


def describe_best_ratio(plan: Plan, station: int) -> str:
    """Return the largest ratio of stability at a station and where it is, in words.

    Args:
        plan: plan of one tool.
        station: index of the station.
    """
    found = find_best_ratio(plan, station)
    if found is None:
        return ""
    return f" (largest ratio of stable to planned depth: {found[0]:.3g} at gamma {np.degrees(found[1]):.0f}°)"
