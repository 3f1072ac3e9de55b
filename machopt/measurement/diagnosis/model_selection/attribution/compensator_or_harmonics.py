"""Distinction between a gravity compensator and gear harmonics at a joint with a small angle range.

Harmonics with less than one period in the range fit any smooth curve. A strong compensator lies between the few
spring geometries of the search grid, so that the harmonic fits better. Here the spring geometry is refined. The
compensator is reported unless the data exclude it, and harmonics found in addition at the same joint are removed.
Poses over a larger range of the joint separate both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location
from machopt.effects import registry
from machopt.effects.joint.joint_angle_errors import WAVES
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    compute_gain_by_shape,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import refine_law_shape
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array

RATIOS = (0.1, 0.15, 0.2, 0.28, 0.35, 0.45, 0.55, 0.7, 0.85)  # lever ratios a/L that are tried
ANGLES = np.radians(np.arange(0.0, 360.0, 4.0))
SIDE, MOST = 0.08, 150  # size of the initial simplex (ratio, rad), and most evaluations
ZERO_SINGULAR_VALUE = 1e-9  # relative to the largest singular value: unobservable direction
MAX_READINGS = 3000  # most readings for which the refinement is affordable


def rename_harmonics_as_compensator(state: SearchState) -> SearchState:
    """Replace partial waves by gravity compensators where the data allow it.

    Args:
        state: State of the search.

    Returns:
        The state with the replaced effects.
    """
    if state.problem.channel != "position":
        return state
    for place in dict.fromkeys(place for e in registry.select_parallel_torque_effects() for place in e.places):
        state = _resolve_place(state, place)
    return state


def _resolve_place(state: SearchState, place: str) -> SearchState:
    mine = [c for c in state.chosen if c.whitened.hypothesis.location == place and _is_angle_law(c)]
    springs = [
        t
        for t in state.catalogue_hypotheses
        if t.hypothesis.location == place and t.hypothesis.refinement and _is_parallel_torque(t)
    ]
    if not springs or len(state.problem) > MAX_READINGS or not any(_is_partial_wave(state, c) for c in mine):
        return state
    others = [c for c in state.chosen if c not in mine]
    whole = add_selected_effects(state.base, state.chosen)
    found, least = min((_fit_spring_geometry(state, others, t) for t in springs), key=lambda f: f[1])
    quiet = max(1.0, whole.rss / max(len(whole.y) - whole.count, 1))
    if least - whole.rss - sum(_compute_amplitude_excess(c) for c in mine) > thresholds.LEVELS.gain_three_sigma * quiet:
        return state
    laws = [found.whitened if t.index == found.whitened.index else t for t in state.whitened_hypotheses]
    chosen = [replace(found, p_value=min(c.p_value for c in mine)) if c is mine[0] else c for c in state.chosen]
    return replace(state, whitened_hypotheses=tuple(laws), chosen=tuple(c for c in chosen if c not in mine[1:]))


def _is_angle_law(c: SelectedEffect) -> bool:
    return c.whitened.hypothesis.family == "kinematic" and c.whitened.hypothesis.is_in_catalogue


def _is_parallel_torque(t: WhitenedHypothesis) -> bool:
    return any(t.hypothesis.effect == e.file_word for e in registry.select_parallel_torque_effects())


def _is_partial_wave(state: SearchState, c: SelectedEffect) -> bool:
    """Return whether the joint's range covers less than one period of a harmonic."""
    h = c.whitened.hypothesis
    angle = state.catalogue.axes.get(f"q{parse_joint_location(h.location)[0] + 1}")
    if h.name[0] != WAVES.file_word or angle is None:
        return False
    return float(min(c.whitened.shapes[c.scored.shape]) * np.ptp(angle)) < 2.0 * np.pi


def _compute_amplitude_excess(c: SelectedEffect) -> float:
    """Return by how much amplitudes exceed those of gears, as a gain."""
    return float(c.whitened.precision(c.scored.shape) @ c.scored.x**2)


def _fit_spring_geometry(
    state: SearchState, others: Sequence[SelectedEffect], law: WhitenedHypothesis
) -> tuple[SelectedEffect, float]:
    """Return a compensator with refined geometry and its whitened residual sum of squares."""
    h, model_without = law.hypothesis, add_selected_effects(state.base, others)
    assert h.refinement is not None  # checked by the caller

    def at(*shapes: Shape) -> WhitenedHypothesis:
        return replace(whiten_hypotheses(state.base, [replace(h, shapes=shapes)])[0], index=law.index)

    left = _build_residual_function(state, model_without, h)
    found: list[tuple[float, Shape]] = []
    for ratio in RATIOS:
        each = at(*((ratio, float(a)) for a in ANGLES))
        shape = _minimise_by_simplex(left, each.shapes[int(np.argmax(compute_gain_by_shape(model_without, each)))])
        found.append((left(shape), shape))
    least, best = min(found)
    c = refine_law_shape(
        state.base, model_without, SelectedEffect(score_hypotheses(model_without, [at(best)])[0], 1.0), h.refinement
    )
    return c, min(least, model_without.with_law(c.whitened, c.scored.shape).rss)


def _build_residual_function(
    state: SearchState, model_without: WhitenedModel, h: EffectHypothesis
) -> Callable[[Shape], float]:
    """Return a function from a shape to the whitened residual sum of squares together with a model."""
    X = np.concatenate([model_without.X, np.diag(np.sqrt(model_without.prior))])
    size = np.linalg.norm(X, axis=0)
    U, s, _ = np.linalg.svd(X[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    Q, none = U[:, s > ZERO_SINGULAR_VALUE * s[0]], np.zeros(model_without.count)
    y = np.concatenate([model_without.y, none])
    y = y - Q @ (Q.T @ y)

    def left(shape: Shape) -> float:
        A = state.whitening.whiten(h.columns(shape))
        A = np.concatenate([A / np.linalg.norm(A, axis=0), np.zeros((model_without.count, A.shape[1]))])
        A = A - Q @ (Q.T @ A)
        return float(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))

    return left


def _minimise_by_simplex(left: Callable[[Shape], float], start: Shape) -> Shape:
    """Return the best shape near a start by the simplex method; ratio and angle are strongly correlated."""
    from scipy.optimize import minimize  # takes a second to load, and few need it

    def lost(x: Array) -> float:
        return left((float(np.exp(x[0])), float(x[1])))

    first = np.array([np.log(start[0]), start[1]])
    simplex = first + np.array([[0.0, 0.0], [SIDE, 0.0], [0.0, SIDE]])
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 0.1, "maxfev": MOST}
    x = minimize(lost, first, method="Nelder-Mead", options=options).x
    return float(np.exp(x[0])), float(x[1])
