"""Columns of points.csv about the cutting process: force, predicted error, probability, stability."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np

from machopt.numerics.array_types import Array

Outcome = Literal["", "pass", "marginal", "fail", "unknown"]
OUTCOMES = ("pass", "marginal", "fail", "unknown")


@dataclass(frozen=True, kw_only=True)
class ProcessColumns:
    """One row for each toolpath point, SI; NaN or empty where there is nothing to say."""

    force: Array  # (N, 3) N on the tool along travel, normal (axis × travel) and axis
    moment: Array  # (N,) N·m about the axis, tip to shank
    peak_force: Array  # (N,) N, largest resultant within a revolution
    ae: Array  # (N,) m
    ap: Array  # (N,) m
    entry_angle: Array  # (N,) rad, start of the engagement
    exit_angle: Array  # (N,) rad
    errors: Mapping[str, Array] = field(default_factory=dict)  # along, across, normal (m), axis (rad): (N,) nominal
    lower: Mapping[str, Array] = field(default_factory=dict)  # (N,) 5 % of all draws
    upper: Mapping[str, Array] = field(default_factory=dict)  # (N,) 95 %
    tolerance: Array  # (N,) m, the tightest limit of a length; NaN without one
    p_in: Array  # (N,) probability that all tolerances are met
    p_in_deflection_only: Array  # (N,) the same of the deflection alone, where p_in is unknown
    outcome: tuple[str, ...]  # (N,)
    cause: tuple[str, ...]  # (N,) "joint:2 0.61"
    f1: Array  # (N,) Hz, lowest mode of the arm
    depth_limit: Array  # (N,) m, axial depth at which the cut becomes unstable
    chatter: tuple[str, ...]  # (N,)
    feed_max: Array  # (N,) m/s, largest feed that stays in tolerance

    def compute_stability_ratios(self) -> Array:
        """Return (N,) the stable depth of cut over the planned one; inf without a limit, NaN where it is not known."""
        words = np.array(self.chatter, dtype=object)
        known = (words != "") & (words != "unknown")
        ratio = np.where(np.isfinite(self.depth_limit), self.depth_limit, np.inf) / self.ap
        return np.where(known, ratio, np.nan)

    def compute_deciding_errors(self) -> Array:
        """Return (N,) m the size of the nominal error of holes and points with an outcome; NaN elsewhere.

        It is that normal to the surface of milled points, and that across the axis of holes.
        """
        normal, across = (np.abs(self.errors[name]) for name in ("normal", "across"))
        has_outcome = np.array(self.outcome, dtype=object) != ""
        return np.where(has_outcome, np.where(np.isfinite(normal), normal, across), np.nan)

    def count_outcomes(self) -> dict[str, int]:
        """Return how many points have each outcome."""
        return count_outcomes(self.outcome)


def count_outcomes(outcomes: Sequence[str]) -> dict[str, int]:
    """Count how many points have each outcome.

    Args:
        outcomes: Outcome of each point; empty where the point has no tolerance.

    Returns:
        Number by outcome, zeros included.
    """
    words = np.array(outcomes, dtype=object)
    return {word: int(np.sum(words == word)) for word in OUTCOMES}


ERROR_NAMES = ("along", "across", "normal", "axis")


@dataclass(frozen=True, kw_only=True)
class ToleranceSummary:
    """Outcome of one operation with a tolerance."""

    operation: str  # its label in process.yaml
    is_hole: bool
    limits: Mapping[str, float]  # position_mm, axis_deg, depth_mm, surface_mm
    reference: str
    counts: Mapping[str, int]  # of each outcome
    worst_point: int  # toolpath point; −1 without any
    worst_number: int  # from 1, of the hole or milled point within the job (of one tool: within its part)
    worst_error: float  # m, across or along a hole or normal to a surface, nominal; rad where only the axis counts
    worst_p_in: float
    worst_cause: str
    is_angle: bool = False  # the worst error is that of the axis


def find_worst_tolerance(rows: Sequence[ToleranceSummary]) -> ToleranceSummary | None:
    """Return the operation whose worst hole or point has the lowest probability; of equal ones the larger error.

    Args:
        rows: Operations with a tolerance.
    """

    def rank(row: ToleranceSummary) -> tuple[float, float]:
        probability = row.worst_p_in if math.isfinite(row.worst_p_in) else 1.0
        return (probability, -row.worst_error if math.isfinite(row.worst_error) else 0.0)

    return min(rows, key=rank, default=None)


@dataclass(frozen=True, kw_only=True)
class ProcessSummary:
    """Tolerances of a job or of one tool's part of it."""

    before: Mapping[str, Mapping[str, int]]  # cam_default, jiao2022: counts of each outcome
    after: Mapping[str, int]
    tolerances: tuple[ToleranceSummary, ...]
    variance_shares: Mapping[str, float]  # stiffness, force, position; empty where nothing scatters
    sources: Mapping[str, str]  # where each number comes from
    validity: tuple[str, ...]  # limits of what was computed


def merge_process_summaries(parts: Sequence[ProcessSummary]) -> ProcessSummary | None:
    """Return the summary of a job from those of its tools; None without any.

    Args:
        parts: Summaries in the order of the job.
    """
    if not parts:
        return None
    shares = [(sum(p.after.values()), p.variance_shares) for p in parts if p.variance_shares]
    total = sum(count for count, _ in shares)
    names = list(shares[0][1]) if shares else []
    return ProcessSummary(
        before={name: _add_counts([p.before[name] for p in parts]) for name in parts[0].before},
        after=_add_counts([p.after for p in parts]),
        tolerances=_renumber_for_job(parts),
        variance_shares={n: sum(count * one[n] for count, one in shares) / total for n in names} if total else {},
        sources={key: text for p in parts for key, text in p.sources.items()},
        validity=tuple(dict.fromkeys(text for p in parts for text in p.validity)),
    )


def _renumber_for_job(parts: Sequence[ProcessSummary]) -> tuple[ToleranceSummary, ...]:
    """Return the operations of all parts; worst holes and points are numbered through the job."""
    before, out = {True: 0, False: 0}, []
    for part in parts:
        out += [replace(row, worst_number=row.worst_number + before[row.is_hole]) for row in part.tolerances]
        for row in part.tolerances:
            before[row.is_hole] += sum(row.counts.values())
    return tuple(out)


def _add_counts(parts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    return {word: sum(part.get(word, 0) for part in parts) for word in OUTCOMES}


def join_process_columns(parts: Sequence[ProcessColumns | None]) -> ProcessColumns | None:
    """Return the columns of a job from those of its tools; None where one tool has none.

    Args:
        parts: Columns in the order of the job.
    """
    known = [part for part in parts if part is not None]
    if not known or len(known) < len(parts):
        return None
    columns: dict[str, Any] = {}
    for f in fields(ProcessColumns):
        values = [getattr(part, f.name) for part in known]
        if isinstance(values[0], Mapping):
            columns[f.name] = {key: np.concatenate([one[key] for one in values]) for key in values[0]}
        elif isinstance(values[0], tuple):
            columns[f.name] = tuple(word for one in values for word in one)
        else:
            columns[f.name] = np.concatenate(values)
    return ProcessColumns(**columns)


def shift_summary(summary: ProcessSummary, first: int) -> ProcessSummary:
    """Return a summary whose points count from the first point of the job.

    Args:
        summary: Summary of one tool's part.
        first: First point of that part in the job.
    """
    moved = (replace(row, worst_point=row.worst_point + first) for row in summary.tolerances)
    return replace(summary, tolerances=tuple(moved))
