"""A law at the end of its grid where it turns into another law: that one has the name, unless these data exclude it.

A gear that is softer up to a knee below every load is a gear with backlash; creep of which nothing fades for as long
as anything was watched is a twist that stays, whatever the time: hysteresis. The plainer name is given, the other stays
in ``one_of``; smaller loads, or longer rests, tell them apart. What a law turns into says nearly all that it said:
where a further slope takes much more than play does, the slopes are what is there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from machopt.diagnose import calibrated
from machopt.diagnose.search.findings import rivals
from machopt.diagnose.search.screen import Scored, score
from machopt.diagnose.search.select import Chosen, holds, with_chosen
from machopt.diagnose.search.state import State
from machopt.effects import backlash, creep, hardening, hysteresis


def named(state: State) -> State:
    """The state, with laws at such an end under the name of what they turn into there."""
    out = list(state.chosen)
    for k, c in enumerate(out):
        other = _turns_into(c)
        if other is None:
            continue
        _, open_ = rivals(state.base, out, k, state.named)
        if (other, c.tried.hypothesis.location) in open_:
            there = _best(state, out, k, other)
            out[k] = c if there is None else replace(c, scored=there)
    return replace(state, chosen=tuple(out))


def _turns_into(c: Chosen) -> str | None:
    end = ENDS.get(c.tried.hypothesis.effect)
    return end[0] if end is not None and end[1](c) else None


def _best(state: State, chosen: list[Chosen], k: int, effect: str) -> Scored | None:
    """The best law of an effect in place of the k-th; None where none holds by itself and says as much."""
    beside = with_chosen(state.base, chosen[:k] + chosen[k + 1 :])
    place = chosen[k].tried.hypothesis.location
    least = (1.0 - calibrated.DETECTION.beside) * score(beside, [chosen[k].tried])[0].gain
    laws = [t for t in state.named if t.hypothesis.name == (effect, place)]
    found = [s for s in score(beside, laws) if holds(beside, s) and s.gain >= least]
    return max(found, key=lambda s: s.total) if found else None


def _knee_below_loads(c: Chosen) -> bool:
    """Softer below the least knee that is tried."""
    shapes, shape = c.tried.shapes, c.tried.shapes[c.scored.shape]
    return bool(shape and c.scored.x[0] > 0.0 and shape[0] <= min(s[0] for s in shapes))


def _never_fades(c: Chosen) -> bool:
    """One time constant, and the longest that is tried."""
    shapes, shape = c.tried.shapes, c.tried.shapes[c.scored.shape]
    return len(c.scored.x) == 1 and shape[0] >= max(s[0] for s in shapes)


ENDS: Mapping[str, tuple[str, Callable[[Chosen], bool]]] = {
    hardening.EFFECT.name: (backlash.EFFECT.name, _knee_below_loads),
    creep.EFFECT.name: (hysteresis.EFFECT.name, _never_fades),
}
