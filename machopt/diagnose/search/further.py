"""A second look where what was found leaves more than noise, or says in several parts what one law says in few numbers.

First among laws of more shapes than noise lets be tried, then among forms that have no name. What was found stands
where none of these is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried, tried
from machopt.diagnose.nouns.problem import Catalogue, Hypothesis
from machopt.diagnose.search import orders, together
from machopt.diagnose.search.select import Chosen, with_chosen

Found = tuple[tuple[Tried, ...], tuple[Chosen, ...]]  # laws that rivals are taken from, what was found


def searched(base: Model, catalogue: Catalogue, found: Found, most: int, seed: int, fits: float) -> Found:
    """What was found, or what the same search finds among further laws, too.

    Args:
        base: the base.
        catalogue: with further laws, and forms without a name.
        found: what a search among the others found.
        most: effects at most.
        seed: of the sign flips.
        fits: whitened variance of what noise alone would leave; NaN: nobody measured it.
    """
    if _wanting(base, found[1], fits):
        found = _again(base, catalogue.further, found, most, np.random.default_rng([seed, 5]), fits)
    several = orders.parts(found[1]) > 1 and len(found[1]) <= calibrated.RESTING.crowded
    if several or _wanting(base, found[1], fits):
        again = _again(base, catalogue.nameless, found, most, np.random.default_rng([seed, 6]), fits)
        if _shorter(base, again[1], found[1]):
            found = again
    return found


def restless(base: Model) -> float:
    """Variance of whitened residuals beyond 1 from which on there is a mismatch; more where visits are few."""
    error = float(np.sqrt(2.0 / len(base.w.group_of_visit)))
    return max(calibrated.PROOF.restless, calibrated.PROOF.restless_errors * error)


def _wanting(base: Model, chosen: Sequence[Chosen], fits: float) -> bool:
    """Whether what was found one by one leaves more than noise."""
    few = len(chosen) <= calibrated.RESTING.crowded
    return few and np.isfinite(fits) and with_chosen(base, chosen).spread > fits + restless(base)


def _again(
    base: Model, laws: Sequence[Hypothesis], found: Found, most: int, rng: np.random.Generator, fits: float
) -> Found:
    """What the search finds once more among further laws, too; ``found`` where none of these is taken."""
    more = tried(base, laws)
    if not more:
        return found
    again = together.searched(base, (*found[0], *more), most, rng, fits)
    return again if any(any(c.tried is t for t in more) for c in again[1]) else found


def _shorter(base: Model, new: Sequence[Chosen], old: Sequence[Chosen]) -> bool:
    """Whether what was found anew says as much in clearly fewer numbers, or clearly more: by the BIC of both."""
    models = [with_chosen(base, c) for c in (new, old)]
    spread = min(m.spread for m in models)
    numbers = [sum(len(c.scored.x) + len(c.tried.shapes[c.scored.shape]) for c in some) for some in (new, old)]
    lengths = [m.rss / spread + n * float(np.log(len(m.y))) for m, n in zip(models, numbers, strict=True)]
    return lengths[0] < lengths[1] - calibrated.DETECTION.shorter
