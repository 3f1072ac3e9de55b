"""A balancer is no wave of its gear.

Where a joint with a spring beside it turns little, waves of which it shows less than a turn fit any smooth curve, and a
loud balancer falls between the few lengths of springs that are searched: the wave is better by that alone. There the
spring is settled by its own lengths, and has the name unless these data exclude it; what was named beside the wave
at the same joint goes with it. Poses over more of the joint's range tell them apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried, tried
from machopt.diagnose.nouns.problem import Hypothesis, Shape
from machopt.diagnose.search.finer import closest
from machopt.diagnose.search.screen import profile, score
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.diagnose.search.state import State
from machopt.domain.location import joints_of
from machopt.effects import registry
from machopt.effects.kinematic import WAVES

RATIOS = (0.1, 0.15, 0.2, 0.28, 0.35, 0.45, 0.55, 0.7, 0.85)  # of a spring's levers
ANGLES = np.radians(np.arange(0.0, 360.0, 4.0))
SIDE, MOST = 0.08, 150  # of a simplex, by ratio and rad, and how often it asks
NONE = 1e-9  # of the largest singular value: a direction that no reading shows
FEW = 3000  # readings, up to which there is the time for it


def named(state: State) -> State:
    """The state, with springs beside joints in place of what is a part of a wave there."""
    if state.problem.channel != "position":
        return state
    for place in dict.fromkeys(place for e in registry.of_beside() for place in e.places):
        state = _at(state, place)
    return state


def _at(state: State, place: str) -> State:
    mine = [c for c in state.chosen if c.tried.hypothesis.location == place and _unloaded(c)]
    springs = [t for t in state.named if t.hypothesis.location == place and t.hypothesis.finer and _beside(t)]
    if not springs or len(state.problem) > FEW or not any(_in_part(state, c) for c in mine):
        return state
    others = [c for c in state.chosen if c not in mine]
    whole = with_chosen(state.base, state.chosen)
    found, least = min((_settled(state, others, t) for t in springs), key=lambda f: f[1])
    quiet = max(1.0, whole.rss / max(len(whole.y) - whole.count, 1))
    if least - whole.rss - sum(_unusual(c) for c in mine) > calibrated.DETECTION.as_good * quiet:
        return state
    laws = [found.tried if t.index == found.tried.index else t for t in state.tried]
    kept = [replace(found, p_value=min(c.p_value for c in mine)) if c is mine[0] else c for c in state.chosen]
    return replace(state, tried=tuple(laws), chosen=tuple(c for c in kept if c not in mine[1:]))


def _unloaded(c: Chosen) -> bool:
    return c.tried.hypothesis.family == "kinematic" and c.tried.hypothesis.named


def _beside(t: Tried) -> bool:
    return any(t.hypothesis.effect == e.called for e in registry.of_beside())


def _in_part(state: State, c: Chosen) -> bool:
    """A wave of which the joint's angles show less than a turn."""
    h = c.tried.hypothesis
    angle = state.catalogue.axes.get(f"q{joints_of(h.location)[0] + 1}")
    if h.name[0] != WAVES.called or angle is None:
        return False
    return float(min(c.tried.shapes[c.scored.shape]) * np.ptp(angle)) < 2.0 * np.pi


def _unusual(c: Chosen) -> float:
    """How far waves are beyond those of gears, as a gain."""
    return float(c.tried.precision(c.scored.shape) @ c.scored.x**2)


def _settled(state: State, others: Sequence[Chosen], law: Tried) -> tuple[Chosen, float]:
    """A spring by its own lengths, and the whitened squares that it leaves; valleys between lengths are narrow."""
    h, beside = law.hypothesis, with_chosen(state.base, others)
    assert h.finer is not None  # _at asks

    def at(*shapes: Shape) -> Tried:
        return replace(tried(state.base, [replace(h, shapes=shapes)])[0], index=law.index)

    left = _left(state, beside, h)
    found: list[tuple[float, Shape]] = []
    for ratio in RATIOS:
        each = at(*((ratio, float(a)) for a in ANGLES))
        shape = _nearest(left, each.shapes[int(np.argmax(profile(beside, each)))])
        found.append((left(shape), shape))
    least, best = min(found)
    c = closest(state.base, beside, Chosen(score(beside, [at(best)])[0], 1.0), h.finer)
    return c, min(least, beside.with_law(c.tried, c.scored.shape).rss)


def _left(state: State, beside: Model, h: Hypothesis) -> Callable[[Shape], float]:
    """The whitened sum of squares that a shape leaves beside a model, by one projection of the model's own columns."""
    X = np.concatenate([beside.X, np.diag(np.sqrt(beside.prior))])
    size = np.linalg.norm(X, axis=0)
    U, s, _ = np.linalg.svd(X[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    Q, none = U[:, s > NONE * s[0]], np.zeros(beside.count)
    y = np.concatenate([beside.y, none])
    y = y - Q @ (Q.T @ y)

    def left(shape: Shape) -> float:
        A = state.w.apply(h.columns(shape))
        A = np.concatenate([A / np.linalg.norm(A, axis=0), np.zeros((beside.count, A.shape[1]))])
        A = A - Q @ (Q.T @ A)
        return float(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))

    return left


def _nearest(left: Callable[[Shape], float], start: Shape) -> Shape:
    """The shape that leaves least near one, by a simplex: ratio and angle lean on each other along a valley."""
    from scipy.optimize import minimize  # takes a second to load, and few need it

    def lost(x: Array) -> float:
        return left((float(np.exp(x[0])), float(x[1])))

    first = np.array([np.log(start[0]), start[1]])
    simplex = first + np.array([[0.0, 0.0], [SIDE, 0.0], [0.0, SIDE]])
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 0.1, "maxfev": MOST}
    x = minimize(lost, first, method="Nelder-Mead", options=options).x
    return float(np.exp(x[0])), float(x[1])
