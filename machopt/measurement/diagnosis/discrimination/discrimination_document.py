"""Section of plan.json on the competing explanations."""

from __future__ import annotations

from machopt.data_types.documents.pose_plan_document import (
    CandidateLawEntry,
    DiscriminationSection,
    LawPairEntry,
    NoiseSection,
)
from machopt.measurement.design.maximin_discrimination import LEVEL, POWER, compute_required_noncentrality
from machopt.measurement.design.reading_noise import UNLOADED_TWICE
from machopt.measurement.diagnosis.discrimination.open_hypotheses import CandidateLaw
from machopt.measurement.diagnosis.discrimination.rival_pairs import DiscriminationPlan, format_pair


def build_discrimination_document(a: DiscriminationPlan) -> DiscriminationSection:
    """Build the section of plan.json on the competing explanations.

    Args:
        a: Discrimination plan.

    Returns:
        The section.
    """
    enough = compute_required_noncentrality()
    own = a.noise.displacement * UNLOADED_TWICE**0.5
    return DiscriminationSection(
        level=LEVEL,
        power=POWER,
        noncentrality_needed=enough,
        noise_mm=NoiseSection(own=own * 1e3, pose=a.noise.pose * 1e3),
        steps=tuple(a.steps),
        cycles=a.noise.cycles,
        least_noncentrality_per_cycle=a.least_separation,
        random_least_noncentrality_per_cycle=a.random_separation,
        pairs=tuple(
            LawPairEntry(
                one=_build_law_entry(p.first),
                two=_build_law_entry(p.second),
                words=format_pair(p),
                why=p.reason,
                noncentrality_per_cycle=p.per_cycle,
                noncentrality_planned=p.planned,
                cycles_for_power=p.cycles,
                cycles_until_diagnose_excludes=p.required_cycles,
                random_noncentrality_per_cycle=p.random,
                told_apart=p.is_separated,
                otherwise=p.advice or None,
            )
            for p in a.pairs
        ),
    )


def _build_law_entry(s: CandidateLaw) -> CandidateLawEntry:
    return CandidateLawEntry(effect=s.effect, location=s.location, law=s.law)
