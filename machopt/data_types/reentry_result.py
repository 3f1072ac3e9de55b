"""Re-entries of a plan, and what they change."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReentryResult:
    """What the search for re-entries of one tool found (option ``max_reentries``)."""

    reason: str  # why there are fewer than permitted; empty: there are not
    objective_without: float  # J of the plan without re-entries, before corners are rounded
    objective: float  # J of the plan with them, likewise
    mean_percent: float  # change of the mean index, NaN where there is none
    worst_percent: float  # change of the worst index
