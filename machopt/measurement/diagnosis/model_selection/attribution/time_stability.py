"""Check that effects which must be constant in time are constant.

A frame, a zero offset and the position of a tracker do not change during the measurement. Solar heating or a shock
has a mean that a frame fits, but the remainder varies with time.
"""

from __future__ import annotations

import numpy as np

from machopt.effects.joint import joint_angle_errors
from machopt.effects.recording import sensor_errors
from machopt.effects.structure import as_built_joint_frames
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.numerics.array_types import Array, Ints

TIME_CONSTANT_EFFECTS = (
    as_built_joint_frames.EFFECT.name,
    joint_angle_errors.ZERO.name,
    sensor_errors.DISPLACEMENT.name,
)


def is_time_constant(h: EffectHypothesis) -> bool:
    """Return whether a law describes something that does not change with time.

    Args:
        h: Hypothesis.

    Returns:
        True for frames, zero offsets and tracker positions.
    """
    return h.effect in TIME_CONSTANT_EFFECTS


def is_time_varying(state: SearchState, c: SelectedEffect) -> bool:
    """Return whether the strength of a law in measured poses varies with time by a large part of its gain.

    Args:
        state: State of the search.
        c: One of the selected effects.

    Returns:
        True if it varies significantly.
    """
    problem = state.problem
    if problem.channel != "position" or problem.time is None or not is_time_constant(c.whitened.hypothesis):
        return False
    hours = _build_slow_time_functions(problem.time[state.whitening.reading], problem.session[state.whitening.reading])
    whole = add_selected_effects(state.base, state.chosen)
    varying = np.concatenate([c.columns * b[:, None] for b in hours.T], axis=1)
    gain = whole.rss - whole.with_columns(varying).rss - whole.residual_variance * varying.shape[1]
    least = thresholds.LEVELS.min_gain + thresholds.LEVELS.gain_two_sigma * (varying.shape[1] - 1)
    return bool(gain > max(least * whole.residual_variance, thresholds.SHARES.minority * c.scored.gain))


def _build_slow_time_functions(time: Array, session: Ints) -> Array:
    """Return slow functions (M, 3) of the session time of each row, each with zero mean."""
    share = np.zeros(len(time))
    for s in np.unique(session):
        own = session == s
        share[own] = (time[own] - time[own].min()) / max(float(np.ptp(time[own])), 1e-9)
    slow = np.stack([share, np.cos(2.0 * np.pi * share), np.sin(2.0 * np.pi * share)], axis=1)
    return np.asarray(slow - slow.mean(axis=0))
