"""User-defined hypotheses in addition to the catalogue, from a Python file or an installed package.

A file or entry point (group ``machopt.measurement.diagnosis``) provides ``hypotheses(readings)``. It takes the
:class:`~machopt.measurement.diagnosis.data_types.static_readings.StaticReadings` of a load test or of poses and
yields :class:`~machopt.measurement.diagnosis.data_types.diagnosis_problem.EffectHypothesis` objects. docs/diagnose.md
has an example of twenty lines.

A file may also define ``EFFECTS`` (:mod:`machopt.effects.user_effects`): joint laws that every channel tries and that
stiffness.yaml can state.

Both are code that runs with the user's rights when it is loaded. A package is active when it is installed. A file is
run only if ``--effects`` names it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from machopt.effects.user_effects import USER_CODE_ERRORS, UserModule, find_entry_points
from machopt.errors import RecordingError
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings

GROUP = "machopt.diagnose"
HypothesisSource = Callable[[StaticReadings], Iterable[EffectHypothesis]]


def load_hypothesis_sources(own: Sequence[UserModule] = ()) -> list[tuple[str, HypothesisSource]]:
    """Load the functions that provide hypotheses, with their sources.

    Args:
        own: Loaded modules of the user; those of installed packages come first.

    Returns:
        Pairs of source and function.

    Raises:
        InputError: A file defines neither a function ``hypotheses`` nor effects.
    """
    out: list[tuple[str, HypothesisSource]] = list(find_entry_points(GROUP))
    for o in own:
        offer = getattr(o.module, "hypotheses", None)
        if callable(offer):
            out.append((str(o.file), offer))
        elif not o.has_effects:
            raise RecordingError(
                "has no function hypotheses(readings); one that yields Hypothesis objects, or EFFECTS, a list of "
                "effects, would work",
                file=o.file,
            )
    return out


def build_user_hypotheses(
    sources: Sequence[tuple[str, HypothesisSource]], readings: StaticReadings
) -> list[EffectHypothesis]:
    """Build and check the user-defined hypotheses.

    Args:
        sources: Pairs of source and function.
        readings: Static readings.

    Returns:
        The hypotheses.

    Raises:
        InputError: An object is no hypothesis, or columns have a wrong shape or NaN.
    """
    out: list[EffectHypothesis] = []
    for source, offer in sources:
        try:
            laws = list(offer(readings))
            for h in laws:
                _check_user_hypothesis(h, readings, source)
        except USER_CODE_ERRORS as problem:
            raise RecordingError(
                f"hypotheses() does not run: {type(problem).__name__}: {problem}", file=source
            ) from problem
        out += laws
    return out


def _check_user_hypothesis(h: object, readings: StaticReadings, source: str) -> None:
    if not isinstance(h, EffectHypothesis):
        raise RecordingError(f"hypotheses() gave {type(h).__name__}; Hypothesis objects would work", file=source)
    wanted = (len(readings), readings.dimensions)
    for shape in h.shapes:
        columns = np.asarray(h.columns(shape), float)
        if columns.ndim != 3 or columns.shape[:2] != wanted or not np.isfinite(columns).all():
            raise RecordingError(
                f"columns of {h.effect} at {h.location} have the shape {columns.shape} (or NaN); finite "
                f"({wanted[0]}, {wanted[1]}, p) would work",
                file=source,
            )
        if not h.quantities(np.ones(columns.shape[2]), shape):
            raise RecordingError(
                f"quantities of {h.effect} at {h.location} are empty; the size of the effect as the first would work",
                file=source,
            )
