"""Stability of milling in messages and in section ``process`` of result.json."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.documents.optimize_document import BestStabilityEntry
from machopt.data_types.documents.process_entries import StabilitySection
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.process_columns import ProcessColumns
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.candidate_enumeration import solve_station


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


def build_best_stability_entry(plan: Plan, point: int) -> BestStabilityEntry | None:
    """Return the most stable configuration at a point; None where no configuration there is too unstable.

    Args:
        plan: plan of a job or of one tool.
        point: planning point without a configuration.
    """
    plan, point = plan.at(point)
    station = min(int(np.searchsorted(plan.path.stations, point)), len(plan.path.stations) - 1)
    if not (plan.candidates.reason[station] == InfeasibilityReason.UNSTABLE).any():
        return None
    found = find_best_ratio(plan, station)
    return None if found is None else BestStabilityEntry(ratio=found[0], gamma_deg=float(np.degrees(found[1])))


def describe_best_ratio(plan: Plan, station: int) -> str:
    """Return the largest ratio of stability at a station and where it is, in words.

    Args:
        plan: plan of one tool.
        station: index of the station.
    """
    found = find_best_ratio(plan, station)
    if found is None:
        return ""
    return f" (largest ratio of stable to planned depth: {found[0]:.4g} at gamma {np.degrees(found[1]):.0f}°)"


def build_stability_section(
    columns: ProcessColumns | None, min_stability_ratio: float | None, status: Sequence[str]
) -> StabilitySection | None:
    """Return the section; None where nothing is milled.

    Args:
        columns: Process columns of the job.
        min_stability_ratio: As requested; None: no limit.
        status: Status of each point: one without a posture is not listed as unknown.
    """
    if columns is None or not any(columns.chatter):
        return None
    ratio = columns.compute_stability_ratios()
    limited = np.flatnonzero(np.isfinite(ratio))
    least = int(limited[np.argmin(ratio[limited])]) if len(limited) else None
    stable, unknown = (sum(word == name for word in columns.chatter) for name in ("stable", "unknown"))
    reached = [n for n, word in enumerate(columns.chatter) if word == "unknown" and status[n] == "ok"]
    return StabilitySection(
        min_stability_ratio=min_stability_ratio,
        least_ratio=None if least is None else float(ratio[least]),
        least_point=least,
        stable=stable,
        unstable=sum(word != "" for word in columns.chatter) - stable - unknown,
        unknown=unknown,
        unknown_points=tuple(_list_ranges(reached)),
    )


def _list_ranges(points: list[int]) -> list[tuple[int, int]]:
    """Return first and last of each row of neighbouring points."""
    starts = [p for n, p in enumerate(points) if n == 0 or p != points[n - 1] + 1]
    ends = [p for n, p in enumerate(points) if n == len(points) - 1 or p != points[n + 1] - 1]
    return list(zip(starts, ends, strict=True))


def list_unchecked_stability(columns: ProcessColumns | None, least: float | None, status: Sequence[str]) -> list[str]:
    """Return a warning where ``min_stability_ratio`` does not count at some milled points.

    Args:
        columns: Process columns of the job.
        least: ``min_stability_ratio``; None: not requested.
        status: Status of each point.
    """
    found = build_stability_section(columns, least, status)
    return [found.describe_unchecked()] if least is not None and found is not None and found.unknown_points else []
