"""Whether what is named as standing somewhere stands there all the time.

A frame, a zero offset and the place of a tracker are numbers that do not change while poses are measured. What the sun
or a knock does to an arm has a mean that is as good a frame as any, and the rest of it comes and goes.
"""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array, Ints
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.problem import Hypothesis
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.diagnose.search.state import State
from machopt.effects import geometry, kinematic, sensor

STANDS = (geometry.EFFECT.name, kinematic.ZERO.name, sensor.DISPLACEMENT.name)


def stands(h: Hypothesis) -> bool:
    """Whether the law is one of a thing that stands where it stands."""
    return h.effect in STANDS


def comes_and_goes(state: State, c: Chosen) -> bool:
    """Whether a law of measured poses is there at some hours more than at others, by a large part of what it takes.

    Args:
        state: of the search, with ``c`` among what was chosen.
        c: one law.
    """
    problem = state.problem
    if problem.channel != "position" or problem.time is None or not stands(c.tried.hypothesis):
        return False
    hours = _hours(problem.time[state.w.reading], problem.session[state.w.reading])
    whole = with_chosen(state.base, state.chosen)
    varying = np.concatenate([c.columns * b[:, None] for b in hours.T], axis=1)
    gain = whole.rss - whole.with_columns(varying).rss - whole.spread * varying.shape[1]
    d = calibrated.DETECTION
    least = d.gain + d.per_coefficient * (varying.shape[1] - 1)
    return bool(gain > max(least * whole.spread, calibrated.PROOF.steady * c.scored.gain))


def _hours(time: Array, session: Ints) -> Array:
    """(M, 3) slow functions of the time in a row's session, each of which is zero on average."""
    share = np.zeros(len(time))
    for s in np.unique(session):
        own = session == s
        share[own] = (time[own] - time[own].min()) / max(float(np.ptp(time[own])), 1e-9)
    slow = np.stack([share, np.cos(2.0 * np.pi * share), np.sin(2.0 * np.pi * share)], axis=1)
    return np.asarray(slow - slow.mean(axis=0))
