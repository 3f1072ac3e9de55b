"""From a chosen law to a finding: its numbers with intervals, its rivals, and what these data cannot tell it from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import stdtr, stdtrit

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried, sandwich
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, Shape
from machopt.diagnose.nouns.result import Estimate, LawFit, Name, Rival
from machopt.diagnose.search.finer import worse
from machopt.diagnose.search.screen import Scored, score
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.effects import registry
from machopt.effects.protocol import FORM

SHOWN = 10
UNTOLD = 1000  # times a size of a body, from which on the end of its interval says no more than infinity


def rivals(model: Model, chosen: Sequence[Chosen], k: int, tried: Sequence[Tried]) -> tuple[list[Rival], list[Name]]:
    """What else could stand in place of the k-th effect, the others being there.

    Returns:
        rivals, the closest first; names not excluded, the chosen one first.
    """
    others = [c for i, c in enumerate(chosen) if i != k]
    beside = with_chosen(model, others)
    taken = {c.tried.hypothesis.name for c in others}
    mine = chosen[k].tried.hypothesis
    scored = score(beside, [t for t in tried if t.hypothesis.name not in taken])
    best: dict[Name, Scored] = {}
    for s in scored:
        name = s.tried.hypothesis.name
        if name not in best or s.total > best[name].total:
            best[name] = s
    own = next(s for s in scored if s.tried is chosen[k].tried)

    def fit(s: Scored) -> LawFit:
        x, shape = s.x * s.tried.unit[s.shape], s.tried.shapes[s.shape]
        return LawFit(tuple(float(v) for v in x), tuple(shape), s.tried.hypothesis.correction(x, shape))

    named = fit(chosen[k].scored)
    spread = with_chosen(model, chosen).spread
    out: list[Rival] = []
    names: list[Name] = [mine.name]
    for name, s in sorted(best.items(), key=lambda item: -item[1].total):
        if name == mine.name:
            continue
        h = s.tried.hypothesis
        d = own.heldout - s.heldout
        p = _paired(d)
        close = (
            float(d.sum()) / spread < calibrated.DETECTION.as_good
            or (own.gain - s.gain) / spread < calibrated.DETECTION.as_good
        )
        maybe = s.total > 0 and (
            close or (p > calibrated.DETECTION.paired and s.total > calibrated.DETECTION.most_of * own.total)
        )
        if maybe:
            names.append(name)
        out.append(
            Rival(
                effect=h.effect,
                location=h.location,
                law=h.law,
                closed=float(np.clip(s.total / max(own.total, 1e-12), -1.0, 2.0)),
                standing="not excluded" if maybe else "rejected",
                p_value=p,
                placebo=h.effect == mine.effect,
                fit=fit(s),
                named=named,
            )
        )
    return [r for n, r in enumerate(out) if n < SHOWN or r.standing == "not excluded"], names


def estimates(model: Model, chosen: Sequence[Chosen], k: int, tried: Sequence[Tried]) -> dict[str, Estimate]:
    """The parameters of the k-th effect with 90 and 95 % intervals, over the shapes and laws of it that are as likely.

    Args:
        model: the base.
        chosen: all effects.
        k: which of them.
        tried: every law, among them those of the same effect at the same place.
    """
    c = chosen[k]
    beside = with_chosen(model, [o for i, o in enumerate(chosen) if i != k])
    h = c.tried.hypothesis
    value: Mapping[str, Quantity] = h.quantities(
        c.scored.x * c.tried.unit[c.scored.shape], c.tried.shapes[c.scored.shape]
    )
    ends: dict[str, list[Array]] = {name: [] for name in value}
    own: dict[str, Array] = {}
    doubt = _doubt(chosen, k)
    best = _rss(beside, c)
    most = best + _as_likely(beside, c, best)
    for t in [o for o in tried if o.hypothesis.name == h.name and o is not c.tried] + [c.tried]:
        p = t.X.shape[2]
        for s in range(len(t.shapes)):
            m = beside.with_law(t, s, held=True)
            if m.rss > most and (t is not c.tried or s != c.scored.shape):
                continue
            x, covariance, freedom = sandwich(m)
            intervals = _quantity_intervals(t, s, x[-p:], covariance[-p:, -p:], freedom, doubt)
            if t is c.tried and s == c.scored.shape:
                if h.family == "body":
                    value, intervals = _as_held(
                        t, s, (x[-p:], covariance[-p:, -p:], freedom, doubt), (value, intervals)
                    )
                own = intervals
            for name in ends.keys() & intervals.keys():
                ends[name].append(intervals[name])
    out = {}
    for name in _surest_first(own, list(value)):
        q = value[name]
        if name in own and _sure(own[name]):  # a form with coefficients that nothing holds does not say otherwise
            ends[name] = [i for i in ends[name] if _sure(i)]
        both = np.array(ends[name]) if ends[name] else np.full((1, 2, 2), q.value)
        low, high = both[:, :, 0].min(axis=0), both[:, :, 1].max(axis=0)
        if h.family == "body":  # a size: nothing gives way against its load
            low = np.maximum(low, 0.0)
            high = np.where((high > UNTOLD * q.value) & (q.value > 0.0), np.inf, high)
        out[name] = Estimate(
            q.value,
            q.unit,
            (min(float(low[0]), q.value), max(float(high[0]), q.value)),
            (min(float(low[1]), q.value), max(float(high[1]), q.value)),
        )
    return out


def sure_of_size(model: Model, chosen: Sequence[Chosen], k: int) -> bool:
    """Whether a size of the k-th effect, at its own law and shape beside the others, has zero outside of its 95 %."""
    c = chosen[k]
    beside = with_chosen(model, [o for i, o in enumerate(chosen) if i != k])
    x, covariance, freedom = sandwich(beside.with_columns(c.columns, c.tried.precision(c.scored.shape)))
    p, at, h = len(c.scored.x), c.scored.shape, c.tried.hypothesis
    x, covariance = x[-p:], covariance[-p:, -p:]
    doubt = _doubt(chosen, k)
    own = _quantity_intervals(c.tried, at, x, covariance, freedom, doubt)
    if h.family == "body":
        value = h.quantities(x * c.tried.unit[at], c.tried.shapes[at])
        own = _as_held(c.tried, at, (x, covariance, freedom, doubt), (value, own))[1]
    return bool(_sizes(own))


def _surest_first(intervals: Mapping[str, Array], names: list[str]) -> list[str]:
    """The names with a size first that is sure, where the first is not and another is."""
    sure = _sizes(intervals)
    if not sure or names[0] in sure:
        return names
    return [*sure, *(n for n in names if n not in sure)]


def _sizes(intervals: Mapping[str, Array]) -> list[str]:
    """Those that are sure; numbers of a shape are none."""
    return [n for n, i in intervals.items() if i[1, 0] < i[1, 1] and _sure(i)]


def _sure(interval: Array) -> bool:
    """Whether zero is outside of its 95 %."""
    return not bool(interval[1, 0] <= 0.0 <= interval[1, 1])


def _as_held(
    law: Tried, at: int, fit: tuple[Array, Array, float, float], told: tuple[Mapping[str, Quantity], dict[str, Array]]
) -> tuple[Mapping[str, Quantity], dict[str, Array]]:
    """Sizes of a body and their intervals; one that may be none is what the coefficients that are held make of it.

    The largest of several ways to give way is otherwise the one that no reading holds, and its interval says nothing.
    """
    (x, covariance, freedom, doubt), (value, intervals) = fit, told
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    held = np.where(np.abs(x) > float(stdtrit(freedom, 0.975)) * sigma, x, 0.0)
    again = _quantity_intervals(law, at, held, covariance, freedom, doubt)
    sizes = law.hypothesis.quantities(held * law.unit[at], law.shapes[at])
    taken = [n for n, i in intervals.items() if not _sure(i) and _sure(again[n]) and sizes[n].value != 0.0]
    return {**value, **{n: sizes[n] for n in taken}}, {**intervals, **{n: again[n] for n in taken}}


def _as_likely(beside: Model, c: Chosen, best: float) -> float:
    """Whitened sum of squares by which another shape may be worse.

    Where the noise was measured and the law leaves more than noise its form is not quite the true one: then a form
    that is worse by no more than that, or by what laws are held to leave of an effect, may be as near to the truth.
    """
    m = beside.with_law(c.tried, c.scored.shape, held=True)
    freedom = len(m.y) - m.count
    beyond = best - freedom - 2.0 * np.sqrt(2.0 * freedom)  # than noise by chance
    form = 0.0 if c.tried.hypothesis.exact else min(beyond, calibrated.DETECTION.beside * c.scored.gain)
    return max(worse(c.tried.hypothesis) * m.spread, form)


def _form(effect: str) -> float:
    known = registry.known(effect)
    return FORM if known is None else known.form


def _doubt(chosen: Sequence[Chosen], k: int) -> float:
    """Relative 1 sigma of the k-th effect for the forms of the others: what their laws leave, an exact one takes up.

    Beside bodies and gears a zero and a frame came out 11 and 13 % off, of which their own noise told 3.
    """
    others = (o.tried.hypothesis.effect for i, o in enumerate(chosen) if i != k)
    return FORM if any(_form(e) >= FORM for e in others) else 0.0


def _quantity_intervals(
    law: Tried, at: int, x: Array, covariance: Array, freedom: float, doubt: float = 0.0
) -> dict[str, Array]:
    """(2, 2) ends of the 90 and 95 % intervals of each quantity, by its slope and its bend in the coefficients.

    Args:
        law: of the effect.
        at: which of its shapes.
        x, covariance, freedom: fitted coefficients.
        doubt: least relative 1 sigma of its form.
    """
    h, shape, unit = law.hypothesis, law.shapes[at], law.unit[at]
    centre = h.quantities(x * unit, shape)
    slopes: dict[str, list[float]] = {name: [] for name in centre}
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-3 * max(float(np.sqrt(max(covariance[i, i], 0.0))), abs(float(x[i])), 1e-12)
        up, down = h.quantities((x + step) * unit, shape), h.quantities((x - step) * unit, shape)
        for name in centre:
            slopes[name].append((up[name].value - down[name].value) / (2 * step[i]))
    bends = _bends(h, x, covariance, (unit, shape)) if len(x) > 1 else {}
    out = {}
    form = max(_form(h.effect), doubt)
    for name, q in centre.items():
        if not np.isfinite(q.value):  # a share of a compliance that was found to be zero
            out[name] = np.full((2, 2), q.value)
            continue
        g = np.nan_to_num(np.array(slopes[name]), posinf=0.0, neginf=0.0)
        noise = float(np.sqrt(max(g @ covariance @ g, 0.0)))
        more = float(np.clip(bends.get(name, 0.0), -noise, noise))
        sigma = float(np.hypot(noise, form * q.value if g.any() else 0.0))
        t = stdtrit(freedom, np.array([0.95, 0.975]))
        out[name] = np.stack([q.value - more - t * sigma, q.value - more + t * sigma], axis=1)
    return out


def _bends(h: Hypothesis, x: Array, covariance: Array, at: tuple[Array, Shape]) -> dict[str, float]:
    """What noise adds to each quantity in the mean: a length of several coefficients grows by what lies across it."""
    unit, shape = at
    power, axes = np.linalg.eigh(covariance)
    middle = h.quantities(x * unit, shape)
    out = dict.fromkeys(middle, 0.0)
    for step in (axes * np.sqrt(np.maximum(power, 0.0))).T:
        up, down = h.quantities((x + step) * unit, shape), h.quantities((x - step) * unit, shape)
        for name, q in middle.items():
            more = 0.5 * (up[name].value + down[name].value) - q.value
            out[name] += more if np.isfinite(more) else 0.0
    return out


def _rss(beside: Model, c: Chosen) -> float:
    return beside.with_law(c.tried, c.scored.shape, held=True).rss


def _paired(d: Array) -> float:
    """One-sided chance of a mean difference so large, Student's t over folds."""
    n = len(d)
    error = float(d.std(ddof=1)) / np.sqrt(n) if n > 1 else 0.0
    return float(stdtr(n - 1, -float(d.mean()) / error)) if error > 0 else float(d.mean() <= 0)
