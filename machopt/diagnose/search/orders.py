"""Several orders of one gear: a joint's waves as one law, order by order, each refined with all others beside it.

A search names one law a place; a gear runs ahead and behind in the orders of its input, its cam and its output at once.
Once a wave stands, further ones of the same place are taken as long as they hold beside everything chosen (orthogonal
matching pursuit), and orders that the others make needless leave again: what was named first may have stood for two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried, tried
from machopt.diagnose.nouns.problem import Finer, Hypothesis, Shape
from machopt.diagnose.search.screen import by_chance, fitted, profile, score
from machopt.diagnose.search.select import Chosen, holds, least_gain, with_chosen

MOST = 6  # orders of a joint, a safety
NARROWER = (1.0, 0.2, 0.04)  # of the way to neighbouring orders, in turn


def grown(model: Model, chosen: Sequence[Chosen], laws: Sequence[Tried], rng: np.random.Generator) -> list[Chosen]:
    """What was chosen, with all orders of each joint that has a wave.

    Args:
        model: the base.
        chosen: one law a place.
        laws: all that is tried; single waves among them have a word for their sum and are settled finely.
        rng: of the sign flips.
    """
    out = list(chosen)
    for k, c in enumerate(chosen):
        single = [t for t in laws if t.hypothesis.name == c.tried.hypothesis.name and _wave(t.hypothesis)]
        if single and _waves(c):
            out[k] = _joint(model, out, k, single, rng)
    return out


def parts(chosen: Sequence[Chosen]) -> int:
    """How many parts explanations say a thing in: each order of a motion's waves is one."""
    return sum(len(c.tried.shapes[c.scored.shape]) if c.tried.hypothesis.finer and _waves(c) else 1 for c in chosen)


def _waves(c: Chosen) -> bool:
    """Whether a law has a cosine and a sine of each of its orders."""
    return bool(2 * len(c.tried.shapes[c.scored.shape]) == c.tried.X.shape[2])


def _wave(h: Hypothesis) -> bool:
    """Whether a law is one wave, whose order a motion settles."""
    return bool(h.summed) and h.finer is not None


def _joint(model: Model, chosen: list[Chosen], k: int, single: Sequence[Tried], rng: np.random.Generator) -> Chosen:
    """The k-th effect with all its orders."""
    first = chosen[k]
    beside = with_chosen(model, [c for n, c in enumerate(chosen) if n != k])
    law = single[0].hypothesis
    assert law.finer is not None  # of a wave
    orders = tuple(first.tried.shapes[first.scored.shape])
    added = False
    while len(orders) < MOST:
        refined = _refined(model, beside, law, orders)
        one = _further(beside.with_columns(_columns(model, law, refined).at(0)), single, rng)
        if one is None:
            break
        orders, added = (*refined, one), True
    if not added:
        return first
    orders = _needed(model, beside, law, _resolved(model, beside, law, _refined(model, beside, law, orders)))
    own = score(beside, [_columns(model, _sum(law, orders), orders)])[0]
    return replace(first, scored=own)


def _further(model: Model, single: Sequence[Tried], rng: np.random.Generator) -> float | None:
    """The order of one more wave that holds beside the others; None: there is none."""
    scored = [s for s in score(model, single) if holds(model, s)]
    if not scored:
        return None
    best = max(scored, key=lambda s: s.total - s.tried.hypothesis.penalty * model.spread)
    left = model.with_law(best.tried, best.shape).residual
    each = [best, *(f for f in fitted(model, single) if f.tried is not best.tried)]
    if float(by_chance(model, each, left, rng)[0]) > calibrated.DETECTION.chance:
        return None
    return float(best.tried.shapes[best.shape][0])


def _refined(model: Model, beside: Model, law: Hypothesis, orders: Shape) -> Shape:
    """Each order where the others want it; a whole one where it is no worse."""
    assert law.finer is not None  # of a wave
    out = list(orders)
    for share in NARROWER:
        for n, order in enumerate(out):
            m = beside
            if len(out) > 1:
                m = beside.with_columns(_columns(model, law, tuple(v for i, v in enumerate(out) if i != n)).at(0))
            about = tuple(dict.fromkeys(((order,), *law.finer.about((order,), share))))
            gain = profile(m, tried(model, [replace(law, shapes=about)])[0])
            near = np.flatnonzero(gain.max() - gain < calibrated.DETECTION.near_shape * m.spread)
            plain = [i for i in near.tolist() if law.finer.plain(about[i])]
            out[n] = about[max(plain or near.tolist(), key=lambda i: float(gain[i]))][0]
    return tuple(dict.fromkeys(out))


def _resolved(model: Model, beside: Model, law: Hypothesis, orders: Shape) -> Shape:
    """Orders of which the range of the joint tells each from the next, each of the rest refined again.

    Two that beat less often over the range than that are one wave to these data, whatever their amplitudes: such come
    out large and cancel, for the sake of a wave that swells or of noise.
    """
    assert law.finer is not None  # of a wave
    while len(orders) > 1:
        row = np.argsort(orders)
        k = int(np.argmin(np.diff(np.array(orders)[row])))
        pair = row[k : k + 2].tolist()
        if orders[pair[1]] - orders[pair[0]] >= law.finer.apart:
            break
        ways = [orders[:n] + orders[n + 1 :] for n in pair]
        kept = min(ways, key=lambda way: beside.with_columns(_columns(model, law, way).at(0)).rss)
        orders = _refined(model, beside, law, kept)
    return orders


def _needed(model: Model, beside: Model, law: Hypothesis, orders: Shape) -> Shape:
    """Orders without those that the others can do without, each of the rest refined again."""
    while len(orders) > 1:
        need = []
        for n in range(len(orders)):
            rest = beside.with_columns(_columns(model, law, orders[:n] + orders[n + 1 :]).at(0))
            s = score(rest, [_columns(model, law, (orders[n],))])[0]
            need.append(s.gain / rest.spread - least_gain(rest, s))
        worst = int(np.argmin(need))
        if need[worst] >= 0.0:
            break
        orders = _refined(model, beside, law, orders[:worst] + orders[worst + 1 :])
    return orders


def _columns(model: Model, law: Hypothesis, orders: Shape) -> Tried:
    return tried(model, [replace(law, shapes=(orders,))])[0]


def _sum(law: Hypothesis, orders: Shape) -> Hypothesis:
    """Several waves as one law, whose orders are settled each by itself."""
    assert law.finer is not None  # of a wave
    if len(orders) == 1:
        return law
    return replace(law, law=f"{len(orders)} {law.summed}", finer=_each(law.finer), penalty=0.0)


def _each(one: Finer) -> Finer:
    """Of several orders: about each of them in turn, the others as they are."""

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        out = []
        for n, order in enumerate(shape):
            out += [(*shape[:n], *v, *shape[n + 1 :]) for v in one.about((order,), share)]
        return tuple(out)

    def said(shapes: Sequence[Shape]) -> str:
        best: Array = np.array(shapes)
        return "; ".join(filter(None, (one.said([(float(v),) for v in own]) for own in best.T)))

    return Finer(about=about, plain=lambda s: all(one.plain((v,)) for v in s), said=said, apart=one.apart)
