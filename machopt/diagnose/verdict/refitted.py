"""What is refitted in any case and is no part of any file: told where it is surely there, though it is no finding.

A rotor behind its gear, seals that turn over gradually: every arm has them, and no URDF has a word for them. They leave
nothing that comes back, so the verdict does not say that the model as it is stated lacks them.
"""

from __future__ import annotations

from collections.abc import Sequence

from machopt.diagnose import calibrated
from machopt.diagnose.nouns.result import Coefficient
from machopt.effects.words import place


def said(coefficients: Sequence[Coefficient]) -> tuple[str, ...]:
    """Notes for the reader."""
    there = stated_nowhere(coefficients)
    nowhere = (f"refitted in any case, and stated nowhere: {there}",) if there else ()
    return nowhere + far_from_stated(coefficients)


def stated_nowhere(coefficients: Sequence[Coefficient]) -> str:
    """What is surely there and neither URDF nor cell states, with its place; empty: nothing is."""
    there = [c for c in coefficients if c.unknown.unstated and _sure(c.value, c.sigma)]
    return "; ".join(
        f"{c.unknown.unstated} {c.value:.3g} {c.unknown.unit} ({place(c.unknown.location)})" for c in there
    )


def far_from_stated(coefficients: Sequence[Coefficient]) -> tuple[str, ...]:
    """Numbers that are held near what is stated, and yet came out far from it."""
    far = [(c, abs(c.value) / c.unknown.prior) for c in coefficients if c.unknown.prior is not None]
    told = [
        f"{c.unknown.name} {c.value:+.2g}, {off:.1f} times what it may be off by"
        for c, off in far
        if off**2 >= calibrated.DETECTION.as_good
    ]
    if not told:
        return ()
    return (
        "far from what is stated, and not far enough to say that nothing else is: " + "; ".join(told) + ". What hangs "
        "on the arm and nobody stated may be taken up by that; the same motion with a known load more tells",
    )


def _sure(value: float, sigma: float) -> bool:
    return value**2 >= calibrated.DETECTION.gain * sigma**2 and sigma > 0.0
