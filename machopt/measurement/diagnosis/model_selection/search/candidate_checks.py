"""Checks that an effect must pass before it may enter the selected model, or stay there.

:data:`CANDIDATE_CHECKS` is the table, in the order of its cost: each check sees only what the ones before it passed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.effects import registry
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    FittedHypothesis,
    ScoredHypothesis,
)
from machopt.measurement.diagnosis.model_selection.screening.session_transfer import is_consistent_between_sessions
from machopt.measurement.diagnosis.model_selection.screening.significance_check import (
    find_insignificant_laws,
    project_to_plausible_coefficients,
)
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis

BETWEEN_SESSIONS = "sessions"  # name of the check that compares sessions


@dataclass(frozen=True, kw_only=True)
class CandidateCheck(SelectionStage):
    """Check of one scored hypothesis together with the model that it was scored with."""

    is_passed: Callable[[WhitenedModel, ScoredHypothesis], bool]


def is_supported(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a hypothesis passes every check.

    Args:
        model: Whitened base model.
        s: Scored hypothesis.

    Returns:
        True if supported.
    """
    return all(check.is_passed(model, s) for check in CANDIDATE_CHECKS)


def is_supported_without_session_check(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a hypothesis passes every check except the comparison between sessions.

    Args:
        model: Whitened base model.
        s: Scored hypothesis.

    Returns:
        True if supported.
    """
    return all(check.is_passed(model, s) for check in CANDIDATE_CHECKS if check.name != BETWEEN_SESSIONS)


def compute_least_gain(model: WhitenedModel, t: WhitenedHypothesis) -> float:
    """Compute the gain that a hypothesis must reach, relative to the residual variance.

    Args:
        model: Whitened base model.
        t: Whitened hypothesis.

    Returns:
        Required gain.
    """
    p = t.X.shape[2]
    least: float = thresholds.LEVELS.min_gain + thresholds.LEVELS.gain_two_sigma * (p - 1) + t.hypothesis.penalty
    return max(least, thresholds.SHARES.min_gain_per_row * len(model.y))


def has_plausible_sizes(s: FittedHypothesis) -> bool:
    """Return whether the size of a fitted law is one that its effect can have.

    Args:
        s: Hypothesis fitted to all readings.

    Returns:
        True if it can.
    """
    h = s.whitened.hypothesis
    size = next(iter(h.quantities(s.x * s.whitened.unit[s.shape], s.whitened.shapes[s.shape]).values()))
    known = registry.find_effect(h.effect)
    if abs(size.value) < h.least_size:
        return False
    return known is None or abs(size.value) <= known.plausible_sizes.get(size.unit, np.inf)


def is_large_enough(model: WhitenedModel, s: FittedHypothesis) -> bool:
    """Return whether a law gains enough with sizes that its effect can have; both need no cross-validation.

    Args:
        model: Whitened base model.
        s: Hypothesis fitted to all readings.

    Returns:
        True if so.
    """
    return _gains_enough(model, s) and has_plausible_sizes(s)


def _gains_enough(model: WhitenedModel, s: FittedHypothesis) -> bool:
    return s.gain / model.residual_variance >= compute_least_gain(model, s.whitened)


def _predicts_unseen_groups(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    return s.total > thresholds.SHARES.min_transfer * s.gain


def _keeps_gain_at_plausible_coefficients(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    loss = project_to_plausible_coefficients(model, s.whitened, s.shape, s.x)[1]
    return loss <= (1.0 - thresholds.SHARES.half_power_amplitude) * s.gain


def _is_supported_by_several_groups(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Return whether a law does not depend on a single group: the others contribute their share or suffice alone."""
    others = s.total - float(s.heldout.max())
    return others > thresholds.SHARES.minority * s.total or others / model.residual_variance >= compute_least_gain(
        model, s.whitened
    )


def _has_significant_coefficient(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    return not find_insignificant_laws(model.with_law(s.whitened, s.shape), [(s.whitened, s.shape)])


CANDIDATE_CHECKS: tuple[CandidateCheck, ...] = (
    CandidateCheck(
        name="gain",
        statistic="reduction of the whitened sum of squares: squared noncentrality",
        levels=("levels.min_gain", "levels.gain_two_sigma", "shares.min_gain_per_row"),
        reference="likelihood ratio; 30 is 5.5 standard deviations",
        rejects="an effect too small to matter, or with too many coefficients for its gain",
        is_passed=_gains_enough,
    ),
    CandidateCheck(
        name="size",
        statistic="fitted size against the largest that is physically possible (effects/*.plausible_sizes)",
        levels=(),
        reference="physical bounds of the catalogue",
        rejects="an effect of an impossible size",
        is_passed=lambda model, s: has_plausible_sizes(s),
    ),
    CandidateCheck(
        name="unseen groups",
        statistic="gain on poses or cycles without which the coefficients were fitted, per gain",
        levels=("shares.min_transfer",),
        reference="cross-validation by groups (Stone 1974)",
        rejects="an effect that fits, and does not predict",
        is_passed=_predicts_unseen_groups,
    ),
    CandidateCheck(
        name="possible coefficients",
        statistic="gain that is left at the nearest coefficients that are physically possible",
        levels=("shares.half_power_amplitude",),
        reference="positive semidefinite compliance, inertia",
        rejects="a body that would have to be of negative stiffness",
        is_passed=_keeps_gain_at_plausible_coefficients,
    ),
    CandidateCheck(
        name="several groups",
        statistic="cross-validated gain without the best group",
        levels=("shares.minority",),
        reference="leave-one-group-out influence",
        rejects="an effect that one pose or one cycle alone shows",
        is_passed=_is_supported_by_several_groups,
    ),
    CandidateCheck(
        name="significance",
        statistic="95 % interval of each coefficient and size from a covariance that is robust to correlated groups",
        levels=(),
        reference="cluster-robust covariance (Liang & Zeger 1986), t quantile",
        rejects="an effect none of whose sizes differs from zero",
        is_passed=_has_significant_coefficient,
    ),
    CandidateCheck(
        name=BETWEEN_SESSIONS,
        statistic="gain on each session with the coefficients of the other sessions, per gain",
        levels=("shares.min_transfer",),
        reference="cross-validation by sessions",
        rejects="an effect of the robot that another session contradicts",
        is_passed=is_consistent_between_sessions,
    ),
)
