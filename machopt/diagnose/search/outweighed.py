"""A name only for a law that explains more than what nothing explains.

The best of a catalogue is the nearest shape to whatever is there, and takes much of it. Where the noise is known, so is
what the whole sum leaves beyond it; a law that takes little more than that may well be one more side of the very thing
that is not understood. So may a law whose numbers nothing built has, or whose size may be none. Each stays in the fit,
so that no other takes its place, and is said with its place, not named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence import heldout
from machopt.diagnose.evidence.grams import Tried, tried
from machopt.diagnose.nouns.problem import UNNAMED, Hypothesis
from machopt.diagnose.search import mismatch, steady
from machopt.diagnose.search.anotherday import BY_DAY, comes_again
from machopt.diagnose.search.findings import sure_of_size
from machopt.diagnose.search.screen import Scored, score
from machopt.diagnose.search.select import Chosen, stands, with_chosen
from machopt.diagnose.search.state import State
from machopt.effects import geometry, registry
from machopt.effects.words import spoken

LITTLE = "explains little more than what is left beside it"
NOT_BUILT = "would need numbers that nothing built has"
NO_SIZE = "may as well be of no size at all"
AS_LIKE = "is no better than a form without a name"
FEWEST = 4  # numbers of a form of measured poses
NOT_STEADY = "comes and goes with the hours"


def withheld(state: State, rng: np.random.Generator) -> State:
    """The state, with the laws that what is left outweighs as things without a name.

    Args:
        state: of the search.
        rng: of the sign flips that judge what is left.
    """
    state = replace(state, chosen=tuple(c if _buildable(c) else _nameless(c, NOT_BUILT) for c in state.chosen))
    if state.problem.channel == "deflection":
        state = replace(state, chosen=tuple(_sized(state, k) for k in range(len(state.chosen))))
        state = replace(state, chosen=tuple(_likened(state, k) for k in range(len(state.chosen))))
        if any(c.tried.hypothesis.named for c in state.chosen):
            forms = tried(state.base, state.catalogue.nameless)
            state = replace(state, chosen=tuple(_likened(state, k, forms) for k in range(len(state.chosen))))
    if state.problem.channel == "position" and not _crowded(state):
        state = replace(state, chosen=tuple(_likened(state, k, few) for k, few in enumerate(_as_few(state))))
    if state.problem.channel == "torque":
        state = replace(state, chosen=tuple(_likened(state, k, _by_angle(state, k)) for k in range(len(state.chosen))))
    if not any(_judged(c) for c in state.chosen) or _crowded(state):
        return state
    unsteady = [c.tried.hypothesis.named and steady.comes_and_goes(state, c) for c in state.chosen]
    steadily = (_nameless(c, NOT_STEADY) if u else c for c, u in zip(state.chosen, unsteady, strict=True))
    chosen = _of_days(state, tuple(steadily))
    fit = state.fitted(chosen)
    whole = fit.heldout()
    left = _left(state, whole, fit.residual, rng)
    if left <= 0.0:
        return replace(state, chosen=chosen)
    out = list(chosen)
    for k, c in enumerate(chosen):
        if not _judged(c):
            continue
        without = state.fitted([o for o in chosen if o is not c]).heldout()
        taken = _power(state, without) - _power(state, whole)
        # a frame leaves nothing of itself: what is left is something else, and has to be clearly more
        frame = c.tried.hypothesis.effect == geometry.EFFECT.name
        most = calibrated.PROOF.outweighs_exact if frame else calibrated.PROOF.outweighs
        if left > most * taken:
            out[k] = _nameless(c, LITTLE)
    return replace(state, chosen=tuple(out))


def contradicted(state: State) -> Scored | None:
    """The effect that would be named by one session and that another contradicts: the best of them, if any."""
    model = with_chosen(state.base, state.chosen)
    taken = {c.tried.hypothesis.name for c in state.chosen}
    scored = score(model, [t for t in state.named if t.hypothesis.name not in taken])
    for s in sorted(scored, key=lambda s: -s.total):
        if stands(model, s) and not comes_again(model, s):
            return s
    return None


def _of_days(state: State, chosen: tuple[Chosen, ...]) -> tuple[Chosen, ...]:
    """What may be another each day is no name where the days of a load test differ by more of something else.

    Twins then differ by that, too, and what is left hides in what passes for their noise.
    """
    if state.problem.channel != "deflection" or not any(c.tried.hypothesis.family in BY_DAY for c in chosen):
        return chosen
    other = contradicted(state)
    if other is None:
        return chosen
    return tuple(
        _nameless(c, LITTLE)
        if c.tried.hypothesis.family in BY_DAY and other.gain > calibrated.PROOF.outweighs * c.scored.gain
        else c
        for c in chosen
    )


def _judged(c: Chosen) -> bool:
    """A clock or a lag is what it is, however much else is there; a frame takes in whatever moves with its joint."""
    h = c.tried.hypothesis
    return h.named and (not h.exact or h.family == "kinematic")


def _crowded(state: State) -> bool:
    """Whether poses show so many waves and frames that each of them is a small part of the whole."""
    return state.problem.channel == "position" and len(state.chosen) > calibrated.RESTING.crowded


def _left(state: State, residual: Array, fitted: Array, rng: np.random.Generator) -> float:
    """What comes back of held-out residuals (N, D) and lies above the noise, SI² per coordinate; 0: nothing for sure.

    The one needs no level of noise, the other no repeats of the same thing; a name is kept back where both say so.
    Unseen groups err by as much more than noise, for the coefficients' own error, as ``fitted`` ones (N, D) do by less.
    """
    problem = state.problem
    rest = mismatch.repeatable(problem, residual, state.used, state.noise, rng)
    if rest.p_value > calibrated.PROOF.certain:  # not a number where nothing was repeated
        return 0.0
    if rest.lasting:  # it comes and goes, so that visits differ by it, and hides in what passes for their noise
        return rest.power
    floor = heldout.floor(problem, state.noise, state.used) / problem.families[0].factor
    power = 0.5 * (_power(state, residual) + _power(state, fitted))
    return max(min(rest.power, power - floor**2), 0.0)


def _power(state: State, residual: Array) -> float:
    problem = state.problem
    return (heldout.rmse(problem, residual, state.used) / problem.families[0].factor) ** 2


def _buildable(c: Chosen) -> bool:
    h, s = c.tried.hypothesis, c.scored
    return not h.named or h.buildable(s.x * c.tried.unit[s.shape], c.tried.shapes[s.shape])


def _sized(state: State, k: int) -> Chosen:
    """The k-th, without a name where the interval of its size holds zero: one number of a law is sure, not the law."""
    c = state.chosen[k]
    sure = not c.tried.hypothesis.named or sure_of_size(state.base, state.chosen, k)
    return c if sure else _nameless(c, NO_SIZE)


def _as_few(state: State) -> list[tuple[Tried, ...]]:
    """Forms without a name that have no more numbers than each law: one law of many is any of several things."""
    laws = [c.tried for c in state.chosen]
    most = [t.X.shape[2] + len(t.shapes[0]) if t.hypothesis.named else 0 for t in laws]
    most = [m if m >= FEWEST else 0 for m in most]
    if not any(most):
        return [()] * len(laws)
    few = [n for n in state.catalogue.nameless if n.columns(n.shapes[0]).shape[2] + len(n.shapes[0]) <= max(most)]
    forms = tried(state.base, few)
    return [tuple(t for t in forms if t.X.shape[2] + len(t.shapes[0]) <= m) for m in most]


def _by_angle(state: State, k: int) -> tuple[Tried, ...]:
    """Forms without a name at the joint of a torque by angle alone, which many things are that pull at a joint."""
    h = state.chosen[k].tried.hypothesis
    if h.effect not in {e.called for e in registry.of_beside()}:
        return ()
    return tuple(tried(state.base, [n for n in state.catalogue.nameless if n.location == h.location]))


def _likened(state: State, k: int, more: Sequence[Tried] = ()) -> Chosen:
    """The k-th, without a name where what is only like something without one says as much in no more numbers.

    A hose between column and forearm is nearly a balancer. The true law is beaten by no likeness.
    """
    c = state.chosen[k]
    rough = [*(t for t in state.tried if t.hypothesis.rough), *more]
    if not c.tried.hypothesis.named or not rough:
        return c
    beside = with_chosen(state.base, [o for i, o in enumerate(state.chosen) if i != k])
    own = score(beside, [c.tried])[0]

    def worth(s: Scored) -> float:
        numbers = s.tried.X.shape[2] + len(s.tried.shapes[s.shape])
        return float(s.gain / beside.spread - calibrated.DETECTION.per_coefficient * numbers)

    # those that are tried for this alone are dozens, and the best of so many is good by chance
    most = worth(own) + (calibrated.DETECTION.shorter if more else 0.0)
    better = [s for s in score(beside, rough) if worth(s) > most]
    return c if not better else _nameless(c, f"{AS_LIKE}, of something {_told(max(better, key=worth))}")


def _told(s: Scored) -> str:
    return f"at {s.tried.hypothesis.location} that {s.tried.hypothesis.law}"


def _nameless(c: Chosen, why: str) -> Chosen:
    h = c.tried.hypothesis
    note = f"looks like {spoken(*h.name)} ({h.law}) and {why}"
    unnamed: Hypothesis = replace(h, family=UNNAMED, note=note)
    return replace(c, scored=replace(c.scored, tried=replace(c.tried, hypothesis=unnamed)))
