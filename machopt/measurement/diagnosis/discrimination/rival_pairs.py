"""Pairs of laws that a plan of measurements separates, and the plan."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.measurement.design.measurement_plan import (
    MeasurementPlan,
)
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.diagnosis.discrimination.open_hypotheses import (
    CandidateLaw,
)
from machopt.measurement.diagnosis.discrimination.separation_advice import format_hypothesis_name


@dataclass(frozen=True, kw_only=True)
class RivalPair:
    """Two laws and how well the plan separates them."""

    first: CandidateLaw
    second: CandidateLaw
    reason: str  # the finding concerned
    per_cycle: float  # noncentrality of one round over all poses, the smaller of both directions
    planned: float  # noncentrality of all rounds
    cycles: int | None  # rounds for 90 % power at the 1 % level; None: more than 50
    required_cycles: int | None  # rounds until diagnose rejects the wrong law; None: rounds do not suffice
    random: float  # median noncentrality of one round at random poses and loads
    advice: str  # a measurement that separates them if this plan cannot
    is_separated: bool = False  # all rounds separate them with 90 % power by the test of diagnose


@dataclass(frozen=True, kw_only=True)
class DiscriminationPlan:
    """Plan that discriminates between explanations."""

    plan: MeasurementPlan
    noise: ReadingNoise  # with the plan's cycles
    steps: tuple[float, ...]
    pairs: tuple[RivalPair, ...]
    least_separation: float  # noncentrality per round of the worst separable pair
    random_separation: float
    notes: tuple[str, ...]


def format_pair(pair: RivalPair) -> str:
    """Return the names of a pair: ``link compliance of link 3 | link compliance of link 4``.

    Args:
        pair: The pair.

    Returns:
        Text.
    """
    return f"{format_hypothesis_name(pair.first)} | {format_hypothesis_name(pair.second)}"
