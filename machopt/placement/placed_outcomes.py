"""Holes and points of all jobs by outcome at one place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

from machopt.data_types.process_columns import OUTCOMES, ToleranceSummary, find_worst_tolerance


class PlacedOutcomes(TypedDict):
    """Fields of :class:`machopt.placement.search_result.PlannedPlacement`."""

    outcomes: tuple[int, ...]
    tolerance_job: int
    tolerance_point: int
    tolerance_error: float
    tolerance_p_in: float


def add_outcomes(parts: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the sum of counts in the order of ``OUTCOMES``; empty where no part has any.

    Args:
        parts: Counts of tools or jobs, empty where they have no tolerance.
    """
    return tuple(sum(column) for column in zip(*(one for one in parts if one), strict=True))


def summarise_outcomes(jobs: Sequence[Sequence[ToleranceSummary]]) -> PlacedOutcomes:
    """Return the counts of all jobs, and the hole or point with the lowest probability.

    Args:
        jobs: Operations with a tolerance, by job.
    """
    rows = [(k, row) for k, job in enumerate(jobs) for row in job]
    worst = find_worst_tolerance([row for _, row in rows])
    job = next((k for k, row in rows if row is worst), 0)
    return PlacedOutcomes(
        outcomes=add_outcomes([tuple(row.counts[word] for word in OUTCOMES) for _, row in rows]),
        tolerance_job=job,
        tolerance_point=-1 if worst is None else worst.worst_point,
        tolerance_error=float("nan") if worst is None or worst.is_angle else worst.worst_error,
        tolerance_p_in=float("nan") if worst is None else worst.worst_p_in,
    )
