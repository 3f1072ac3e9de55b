"""Laws of a user's own, tried beside the catalogue: from a Python file, or from an installed package.

A file or entry point (group ``machopt.diagnose``) offers ``hypotheses(readings)``, a function that takes the
:class:`~machopt.diagnose.nouns.readings.Readings` of a load test or of poses and yields
:class:`~machopt.diagnose.nouns.problem.Hypothesis` objects. docs/diagnose.md has one in twenty lines.

A file may offer ``EFFECTS`` instead or beside it (:mod:`machopt.effects.own`): laws of joints, which every
channel then tries and stiffness.yaml holds.

Either is code: loading it runs it, with all the rights of whoever started machopt. A package offers its laws by being
installed; a file is run only where ``--terms`` names it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from machopt.diagnose.nouns.problem import Hypothesis
from machopt.diagnose.nouns.readings import Readings
from machopt.effects.own import BROKEN, Own, installed
from machopt.errors import InputError

GROUP = "machopt.diagnose"
Offer = Callable[[Readings], Iterable[Hypothesis]]


def load(own: Sequence[Own] = ()) -> list[tuple[str, Offer]]:
    """Functions that offer laws, with where they come from.

    Args:
        own: files of the user's; what installed packages offer comes first.

    Raises:
        InputError: a file that has neither a function ``hypotheses`` nor effects.
    """
    out: list[tuple[str, Offer]] = list(installed(GROUP))
    for o in own:
        offer = getattr(o.module, "hypotheses", None)
        if callable(offer):
            out.append((str(o.file), offer))
        elif not o.has_effects:
            raise InputError(
                "has no function hypotheses(readings); one that yields Hypothesis objects, or EFFECTS, a list of "
                "effects, would work",
                file=o.file,
            )
    return out


def offered(sources: Sequence[tuple[str, Offer]], readings: Readings) -> list[Hypothesis]:
    """The laws themselves, checked.

    Raises:
        InputError: something that is no Hypothesis, or columns of the wrong shape or with NaN.
    """
    out: list[Hypothesis] = []
    for source, offer in sources:
        try:
            laws = list(offer(readings))
            for h in laws:
                _check(h, readings, source)
        except BROKEN as problem:
            raise InputError(
                f"hypotheses() does not run: {type(problem).__name__}: {problem}", file=source
            ) from problem
        out += laws
    return out


def _check(h: object, readings: Readings, source: str) -> None:
    if not isinstance(h, Hypothesis):
        raise InputError(f"hypotheses() gave {type(h).__name__}; Hypothesis objects would work", file=source)
    wanted = (len(readings), readings.dimensions)
    for shape in h.shapes:
        columns = np.asarray(h.columns(shape), float)
        if columns.ndim != 3 or columns.shape[:2] != wanted or not np.isfinite(columns).all():
            raise InputError(
                f"columns of {h.effect} at {h.location} have the shape {columns.shape} (or NaN); finite "
                f"({wanted[0]}, {wanted[1]}, p) would work",
                file=source,
            )
        if not h.quantities(np.ones(columns.shape[2]), shape):
            raise InputError(
                f"quantities of {h.effect} at {h.location} are empty; the size of the effect as the first would work",
                file=source,
            )
