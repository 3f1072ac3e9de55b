"""Stages between the search and the findings: which of the selected effects may be named, and by which law.

:data:`NAMING_STAGES` is the table, in the order of execution. An effect that loses its name stays in the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.measurement.diagnosis.model_selection.attribution import (
    attribution_guard,
    compensator_or_harmonics,
    limiting_case_laws,
    uncatalogued_form_guard,
)
from machopt.measurement.diagnosis.model_selection.evaluation import uncertain_inputs
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage

DEFLECTION, POSITION, TORQUE = "deflection", "position", "torque"


@dataclass(frozen=True, kw_only=True)
class NamingStage(SelectionStage):
    """Stage after the search: (state, random generator of the sign flips) to the new state."""

    channel: str = ""  # the only channel of the stage; empty for all
    change: Callable[[SearchState, np.random.Generator], SearchState]


def apply_naming_stages(state: SearchState, rng: np.random.Generator) -> SearchState:
    """Apply all stages to the result of a search.

    Args:
        state: State of the search.
        rng: Random generator of the sign flips.

    Returns:
        The state with the names that the readings support.
    """
    for stage in NAMING_STAGES:
        if stage.channel in ("", state.problem.channel):
            state = stage.change(state, rng)
    return state


NAMING_STAGES: tuple[NamingStage, ...] = (
    NamingStage(
        name="uncertain inputs",
        statistic="fit with link masses and other uncertain inputs beside the effects, each with its prior",
        levels=("levels.gain_three_sigma", "shares.min_transfer", "levels.min_gain", "counts.max_stepwise_effects"),
        reference="Bayesian least squares; inputs stay within three standard deviations",
        rejects="an effect that the stated uncertainty of an input explains",
        change=lambda state, rng: uncertain_inputs.include_uncertain_inputs(state),
    ),
    NamingStage(
        name="compensator or waves",
        statistic="whitened sum of squares of a compensator with refined geometry against partial waves",
        levels=("levels.gain_three_sigma",),
        reference="likelihood ratio; amplitudes of gears as prior",
        rejects="waves of less than one period where a gravity compensator fits as well",
        channel=POSITION,
        change=lambda state, rng: compensator_or_harmonics.rename_harmonics_as_compensator(state),
    ),
    NamingStage(
        name="limiting case",
        statistic="gain of the limiting law against a law at the end of its grid",
        levels=("shares.law_error",),
        reference="nested laws",
        rejects="a hardening gear with its knee below every load, creep slower than the record",
        change=lambda state, rng: limiting_case_laws.rename_limiting_cases(state),
    ),
    NamingStage(
        name="possible numbers",
        statistic="coefficients against those that are physically possible",
        levels=(),
        reference="physical bounds of the catalogue",
        rejects="a name whose numbers are impossible",
        change=lambda state, rng: attribution_guard.remove_names_with_implausible_coefficients(state),
    ),
    NamingStage(
        name="better impossible law",
        statistic="cross-validated gain of other laws at the place, impossible sizes included",
        levels=("shares.law_error",),
        reference="posterior predictive check",
        rejects="a name at a place where only an impossible size fits well",
        change=lambda state, rng: attribution_guard.remove_names_if_implausible_law_fits(state),
    ),
    NamingStage(
        name="size interval",
        statistic="95 % interval of the size",
        levels=(),
        reference="t quantile, cluster-robust",
        rejects="an effect that may be of no size",
        channel=DEFLECTION,
        change=lambda state, rng: attribution_guard.remove_names_of_uncertain_size(state),
    ),
    NamingStage(
        name="forms in load tests",
        statistic="gain less a cost per coefficient, of every form outside the catalogue",
        levels=("levels.gain_two_sigma", "levels.min_evidence"),
        reference="information criterion; −2 log evidence of 10 (Kass & Raftery 1995)",
        rejects="a name that a hose, a loose seat or a soft bearing explains as well",
        channel=DEFLECTION,
        change=lambda state, rng: uncatalogued_form_guard.remove_names_if_form_fits_displacements(state),
    ),
    NamingStage(
        name="forms in poses",
        statistic="the same, with at most as many coefficients as the effect",
        levels=("levels.gain_two_sigma", "levels.min_evidence", "counts.max_stepwise_effects"),
        reference="the same",
        rejects="a frame that a bent line of sight or a nodding axis explains as well",
        channel=POSITION,
        change=lambda state, rng: uncatalogued_form_guard.remove_names_if_form_fits_positions(state),
    ),
    NamingStage(
        name="forms in torques",
        statistic="the same, at the joint of the effect",
        levels=("levels.gain_two_sigma", "levels.min_evidence"),
        reference="the same",
        rejects="a compensator or ripple where a hose applies the torque",
        channel=TORQUE,
        change=lambda state, rng: uncatalogued_form_guard.remove_names_if_form_fits_torques(state),
    ),
    NamingStage(
        name="constant in time",
        statistic="gain of the effect times slow functions of time",
        levels=("shares.minority", "levels.min_gain", "levels.gain_two_sigma"),
        reference="varying-coefficient model (Hastie & Tibshirani 1993)",
        rejects="a frame or an offset that changes with temperature or after a collision",
        channel=POSITION,
        change=lambda state, rng: attribution_guard.remove_names_of_time_varying_effects(state),
    ),
    NamingStage(
        name="contradicting session",
        statistic="gain of the best effect that one session supports and another contradicts",
        levels=("shares.majority", "shares.min_transfer"),
        reference="cross-validation by sessions",
        rejects="a drift where the sessions differ by another cause",
        channel=DEFLECTION,
        change=lambda state, rng: attribution_guard.remove_names_of_session_dependent_effects(state),
    ),
    NamingStage(
        name="remaining mismatch",
        statistic="repeatable power that is left per power that the effect takes, on unseen groups",
        levels=(
            "levels.mismatch_significance_level",
            "shares.majority",
            "ratios.larger",
            "shares.half_power_amplitude",
        ),
        reference="components of variance of replicates; sign flips of groups",
        rejects="an effect that explains less than what stays unexplained, unless its place is certain",
        change=attribution_guard.remove_names_of_small_gain,
    ),
)
