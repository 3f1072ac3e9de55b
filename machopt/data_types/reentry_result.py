"""Re-entries of a plan, and the objective of the plan without them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReentryResult:
    """What the search for re-entries of one tool found (option ``max_reentries``)."""

    reason: str  # why there are fewer than permitted; empty: there are not
    objective_without: float  # J of the plan without them, before its corners are rounded
    mean_without: float  # mean index, in units of the scale, likewise
    worst_without: float  # worst index, likewise
