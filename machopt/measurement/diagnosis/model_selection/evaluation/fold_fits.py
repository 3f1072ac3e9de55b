"""Fits of the selected model without one fold each, and the part of the readings that belongs to the recording.

Every fold's fit becomes files of its own, so that the held-out error is that of written models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.data_types.diagnosis_result import FoldFit, RecordChange
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import minimise_bounded_quadratics
from machopt.measurement.diagnosis.model_selection.screening.significance_check import (
    project_to_plausible_coefficients,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.numerics.array_types import Array

FIXED = 1e9  # prior precision of an unknown at zero, relative to that of the readings
RECORD_FAMILIES = ("sensor", "environment")  # families of laws that change the reading and not the arm


def is_stated_by_files(c: SelectedEffect) -> bool:
    """Return whether model files or corrected readings can state an effect of readings at rest.

    Args:
        c: Selected effect.

    Returns:
        False for laws that have no entry in a file: those of a user, for example.
    """
    h, shape = _get_law(c)
    x = c.scored.x * c.whitened.unit[c.scored.shape]
    return h.family in RECORD_FAMILIES or h.correction(x, shape) is not None


def fit_every_fold(state: SearchState, chosen: Sequence[SelectedEffect]) -> tuple[FoldFit, ...]:
    """Fit base and effects without each fold, with the bounds of base unknowns and laws.

    Args:
        state: State of the search.
        chosen: Effects of the final model.

    Returns:
        One fit per fold; none for a single fold.
    """
    fitted = state.fit_effects(chosen)
    m, P = fitted.model, len(state.base_units)
    if m.folds < 2:
        return ()
    lower = _list_lower_bounds(state, chosen)
    x, _ = minimise_bounded_quadratics(m.normal - m.XX + _build_ridge(m.normal), m.Xy.sum(axis=0) - m.Xy, lower)
    x = x * fitted.unit
    out = []
    for f, of in enumerate(m.rows):
        rows = np.unique(m.w.reading[of])
        at, corrections = P, []
        for c in chosen:
            p = len(c.scored.x)
            h, shape = _get_law(c)
            corrections.append(h.correction(x[f, at : at + p], shape))
            at += p
        out.append(
            FoldFit(
                groups=np.unique(state.problem.group[rows]),
                rows=rows.astype(np.int64),
                coefficients=tuple(x[f, :P].tolist()),
                corrections=tuple(corrections),
            )
        )
    return tuple(out)


def fix_unstated_unknowns(state: SearchState) -> SearchState:
    """Return the state with base unknowns at zero that no file states, such as an error of K_C.

    Args:
        state: State of the search.

    Returns:
        The state; unchanged if files state all base unknowns.
    """
    unstated = np.array([not u.is_stated for u in state.problem.unknowns], bool)
    if not unstated.any():
        return state
    fixing_precision = np.where(unstated, FIXED * np.diag(state.base.XX.sum(axis=0)) + FIXED, 0.0)
    return replace(state, base=replace(state.base, prior=state.base.prior + fixing_precision))


def refit_at_shapes(state: SearchState, chosen: Sequence[SelectedEffect]) -> tuple[SelectedEffect, ...]:
    """Fit effects together at their shapes, within their bounds.

    Forms that no file can state are fitted together with the named effects during the search. The files are written
    without these forms, so the named effects are fitted again without them.

    Args:
        state: State of the search.
        chosen: Effects of the final model.

    Returns:
        The effects with new coefficients.
    """
    m, at = state.fit_effects(chosen).model, len(state.base_units)
    whole = m.normal + _build_ridge(m.normal)
    x = minimise_bounded_quadratics(whole[None], m.Xy.sum(axis=0)[None], _list_lower_bounds(state, chosen))[0][0]
    out = []
    for k, c in enumerate(chosen):
        p = len(c.scored.x)
        others = add_selected_effects(state.base, [o for n, o in enumerate(chosen) if n != k])
        own, _ = project_to_plausible_coefficients(others, c.whitened, c.scored.shape, x[at : at + p])
        out.append(replace(c, scored=replace(c.scored, x=own)))
        at += p
    return tuple(out)


def compute_record_change(state: SearchState, chosen: Sequence[SelectedEffect]) -> RecordChange:
    """Compute what sensor errors and drift change in the readings.

    Args:
        state: State of the search.
        chosen: Effects of the final model.

    Returns:
        The change.
    """
    N, D = state.problem.y.shape
    measured, wrench = np.zeros((N, D)), np.zeros((N, 6))
    for c in chosen:
        h, shape = _get_law(c)
        if h.family not in RECORD_FAMILIES:
            continue
        x = c.scored.x * c.whitened.unit[c.scored.shape]
        if h.wrench_change is None:
            measured += h.columns(shape) @ x
        else:
            wrench += h.wrench_change(shape) @ x
    return RecordChange(measured=measured, wrench=wrench)


def _get_law(c: SelectedEffect) -> tuple[EffectHypothesis, tuple[float, ...]]:
    return c.whitened.hypothesis, c.whitened.shapes[c.scored.shape]


def _list_lower_bounds(state: SearchState, chosen: Sequence[SelectedEffect]) -> tuple[float, ...]:
    lower = [u.lower for u in state.problem.unknowns]
    for c in chosen:
        lower += c.whitened.hypothesis.lower or [-np.inf] * len(c.scored.x)
    return tuple(lower)


def _build_ridge(normal: Array) -> Array:
    """Return a small ridge, so that directions that no reading determines stay at zero."""
    return np.diag(1e-9 * np.maximum(np.diag(normal), 1e-3))
