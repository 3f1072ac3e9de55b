"""What is refitted in any case and is no part of any file: told where it is surely there, though it is no finding.

A rotor behind its gear, seals that turn over gradually: every arm has them, and no URDF has a word for them. They leave
nothing that comes back, so the verdict does not say that the model as it is stated lacks them.
"""

from __future__ import annotations

from collections.abc import Sequence

from machopt.effects.effect_wording import format_place
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import BaseCoefficient


def describe_refitted_values(coefficients: Sequence[BaseCoefficient]) -> tuple[str, ...]:
    """Notes for the reader."""
    there = describe_unstated_values(coefficients)
    nowhere = (f"refitted in any case, and stated nowhere: {there}",) if there else ()
    return nowhere + describe_deviating_values(coefficients)


def describe_unstated_values(coefficients: Sequence[BaseCoefficient]) -> str:
    """What is surely there and neither URDF nor cell states, with its place; empty: nothing is."""
    there = [c for c in coefficients if c.unknown.description_if_unstated and _is_significant(c.value, c.sigma)]
    return "; ".join(
        f"{c.unknown.description_if_unstated} {c.value:.3g} {c.unknown.unit} ({format_place(c.unknown.location)})"
        for c in there
    )


def describe_deviating_values(coefficients: Sequence[BaseCoefficient]) -> tuple[str, ...]:
    """Numbers that are held near what is stated, and yet came out far from it."""
    far = [(c, abs(c.value) / c.unknown.prior) for c in coefficients if c.unknown.prior is not None]
    told = [
        f"{c.unknown.name} {c.value:+.2g}, {off:.1f} times what it may be off by"
        for c, off in far
        if off**2 >= thresholds.DETECTION.as_good
    ]
    if not told:
        return ()
    return (
        "far from what is stated, and not far enough to say that nothing else is: " + "; ".join(told) + ". What hangs "
        "on the arm and nobody stated may be taken up by that; the same motion with a known load more tells",
    )


def _is_significant(value: float, sigma: float) -> bool:
    return value**2 >= thresholds.DETECTION.gain * sigma**2 and sigma > 0.0
