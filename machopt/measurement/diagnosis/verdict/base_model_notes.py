"""Notes on significant base unknowns that no file can state, such as motor inertia or gradually reversing seal
friction.

Every arm has them and no URDF states them. They leave no repeatable mismatch, so they are no findings.
"""

from __future__ import annotations

from collections.abc import Sequence

from machopt.effects.effect_wording import format_place
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import BaseCoefficient


def describe_refitted_values(coefficients: Sequence[BaseCoefficient]) -> tuple[str, ...]:
    """Describe significant base unknowns that are unstated or deviate from their prior.

    Args:
        coefficients: Fitted base coefficients.

    Returns:
        Notes.
    """
    there = describe_unstated_values(coefficients)
    nowhere = (f"refitted in any case, and stated nowhere: {there}",) if there else ()
    return nowhere + describe_deviating_values(coefficients)


def describe_unstated_values(coefficients: Sequence[BaseCoefficient]) -> str:
    """Describe significant base unknowns that neither URDF nor cell states, with their location.

    Args:
        coefficients: Fitted base coefficients.

    Returns:
        Text; empty if there are none.
    """
    there = [c for c in coefficients if c.unknown.description_if_unstated and _is_significant(c.value, c.sigma)]
    return "; ".join(
        f"{c.unknown.description_if_unstated} {c.value:.3g} {c.unknown.unit} ({format_place(c.unknown.location)})"
        for c in there
    )


def describe_deviating_values(coefficients: Sequence[BaseCoefficient]) -> tuple[str, ...]:
    """Describe base unknowns that deviate strongly from their prior.

    Args:
        coefficients: Fitted base coefficients.

    Returns:
        Notes.
    """
    deviations = [(c, abs(c.value) / c.unknown.prior) for c in coefficients if c.unknown.prior is not None]
    descriptions = [
        f"{c.unknown.name} {c.value:+.2g}, {deviation:.1f} times what it may be off by"
        for c, deviation in deviations
        if deviation**2 >= thresholds.LEVELS.gain_three_sigma
    ]
    if not descriptions:
        return ()
    return (
        "far from what is stated, and not far enough to say that nothing else is: "
        + "; ".join(descriptions)
        + ". What hangs "
        "on the arm and nobody stated may be taken up by that; the same motion with an additional known load shows it",
    )


def _is_significant(value: float, sigma: float) -> bool:
    return value**2 >= thresholds.LEVELS.min_gain * sigma**2 and sigma > 0.0
