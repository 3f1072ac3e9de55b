"""Shapes of what was chosen, settled more finely than the grid that was searched: an order, a speed, a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried, tried
from machopt.diagnose.nouns.problem import Finer, Shape
from machopt.diagnose.search.screen import profile, score
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.diagnose.search.state import State

BETWEEN = 6  # shapes between one of a grid and its neighbour
NARROWER = 5.0  # times, where few of these are as likely as the best
NARROW = 1e-3  # of the way between neighbours
FEW = 4


def between(grid: Sequence[Shape]) -> Finer | None:
    """Of one positive number: in even ratios towards the neighbours of the grid, and as far beyond its ends."""
    values = np.array(sorted({s[0] for s in grid})) if all(len(s) == 1 for s in grid) else np.zeros(0)
    if len(values) < 2 or values[0] <= 0.0:
        return None
    ratio = float(np.exp(np.diff(np.log(values)).max()))

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        part = shape[0] * ratio ** (share * np.linspace(-1.0, 1.0, 2 * BETWEEN + 1))
        return tuple((float(v),) for v in part)

    return Finer(about)


def settled(state: State) -> State:
    """The state with every chosen law at its best shape between those of the grid, profiled shapes kept with it."""
    chosen, laws = list(state.chosen), list(state.tried)
    for k, c in enumerate(chosen):
        if c.tried.hypothesis.finer is None:
            continue
        beside = with_chosen(state.base, [o for n, o in enumerate(chosen) if n != k])
        chosen[k] = closest(state.base, beside, c, c.tried.hypothesis.finer)
        laws[next(n for n, t in enumerate(laws) if t is c.tried)] = chosen[k].tried
    return replace(state, tried=tuple(laws), chosen=tuple(chosen))


def closest(base: Model, beside: Model, c: Chosen, finer: Finer) -> Chosen:
    """A law at its best shape near the one it has, with all shapes that are as likely.

    Args:
        base: the base.
        beside: with what else was chosen.
        c: the law.
        finer: how its shapes are looked through.
    """
    h, best, share = c.tried.hypothesis, c.tried.shapes[c.scored.shape], 1.0
    while True:
        shapes = tuple(dict.fromkeys((best, *finer.about(best, share))))
        fine: Tried = tried(base, [replace(h, shapes=shapes)])[0]
        gain = profile(beside, fine)
        rest = (beside.rss - float(gain.max())) / max(len(beside.y) - beside.count - fine.X.shape[2], 1)
        near = np.flatnonzero(gain.max() - gain < calibrated.DETECTION.near_shape * max(rest, 1.0))
        best = shapes[int(np.argmax(gain))]
        share /= NARROWER
        if len(near) >= FEW or share < NARROW:
            break
    plain = [n for n in near.tolist() if finer.plain(shapes[n])]
    at = max(plain or near.tolist(), key=lambda n: float(gain[n]))
    more = finer.said([shapes[n] for n in near])
    # intervals are taken over the shapes that are as likely: no other is asked for again
    noted = replace(h, shapes=tuple(shapes[n] for n in near), note=f"{h.note}; {more}" if more else h.note)
    kept = replace(tried(base, [noted])[0], index=c.tried.index)
    own = score(beside, tried(base, [replace(h, shapes=(shapes[at],))]))[0]
    return replace(c, scored=replace(own, tried=kept, shape=near.tolist().index(at)))
