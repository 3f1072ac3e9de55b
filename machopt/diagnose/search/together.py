"""Many effects at once: a sparse sum over every joint's waves, every frame and every other law.

A calibrated arm with a tracker in front of it shows more than a search one by one gets through: waves of several orders
in each gear, and frames a tenth of a millimetre off. Here the normal equations of all laws are summed up once, and
groups of columns are taken one after the other, each refitted with all before it (group orthogonal matching pursuit,
Lozano, Swirszcz & Abe 2009), as long as the next one predicts folds that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried, ridged_inverse, tried
from machopt.diagnose.nouns.problem import Hypothesis
from machopt.diagnose.search import orders
from machopt.diagnose.search.fewest import at_same_places, shortest
from machopt.diagnose.search.select import Chosen, select, settled
from machopt.diagnose.search.sums import Group, Summed, Sums, gains, swept
from machopt.effects import geometry

FEW = 3  # effects that a search one by one is asked for as a rule
RIVALS = 24  # shapes of a law that is held against what was found together
MOST = 96  # groups, a safety
LEADING = 3  # groups whose gain on unseen folds is looked at in each step
RIGID = ("kinematic", "sensor")  # families of what is there without any weight: frames, waves, the tracker's stand


def searched(
    model: Model, laws: Sequence[Tried], most: int, rng: np.random.Generator, fits: float
) -> tuple[tuple[Tried, ...], tuple[Chosen, ...]]:
    """What may explain a recording and what does: found one by one, or together where there is much.

    Args:
        model: the base.
        laws: all that is tried.
        most: effects of a search one by one; fewer than three are a wish for few.
        rng: of the sign flips.
        fits: whitened variance of what noise alone would leave; NaN: nobody measured it.

    Returns:
        The laws that rivals are taken from, those that were found among them; what was found.
    """
    sums = Summed(model, laws)
    found = many(model, laws, fits, sums) if most >= FEW else []
    if not found:
        if _of_poses(laws):
            few = shortest(model, select(model, laws, most, rng), sums, most)
            return tuple(laws), tuple(at_same_places(model, few, laws, rng))
        chosen = select(model, laws, most, rng, lambda so_far: orders.grown(model, so_far, laws, rng))
        grown = [c.tried for c in chosen if not any(c.tried is t for t in laws)]
        return (*laws, *grown), tuple(chosen)
    names = {t.hypothesis.name for t in found}
    rest = [t for t in laws if t.hypothesis.name not in names and len(t.shapes) <= RIVALS]
    return (*rest, *found), tuple(settled(model, found, laws, rng))


def _of_poses(laws: Sequence[Tried]) -> bool:
    """Whether laws of frames are among them, which measured poses alone have."""
    return any(t.hypothesis.effect == geometry.EFFECT.name for t in laws)


def many(model: Model, laws: Sequence[Tried], fits: float, sums: Summed | None = None) -> list[Tried]:
    """The effects of a crowded recording, each as one law of one shape: a joint's waves are one effect.

    Args:
        model: the base.
        laws: all that is tried.
        fits: whitened variance of what noise alone would leave; NaN: nobody measured it.
        sums: of base and laws, where they are needed elsewhere, too.

    Returns:
        Empty where few effects, or none, are there.
    """
    if not _of_poses(laws):
        return []
    if len(model.y) < calibrated.RESTING.per_column * (model.count + calibrated.RESTING.crowded * 2):
        return []
    picked = _pursue((sums or Summed(model, laws)).whole, fits)
    places = {g.law.hypothesis.name for g in picked}
    if len(places) <= calibrated.RESTING.crowded:
        return []
    return tried(model, [*_waves(picked), *_others(picked)])


def _pursue(sums: Sums, fits: float) -> list[Group]:
    """Groups in the order in which they were taken."""
    taken: list[Group] = []
    columns = list(range(sums.base))
    left = swept(sums.total, np.array(columns, int))
    largest = 0.0
    loss = _heldout(sums, columns)
    refused: set[int] = set()
    unloaded = np.array([g.law.hypothesis.family in RIGID for g in sums.groups], bool)
    while len(taken) < MOST and sums.rows > calibrated.RESTING.per_column * len(columns):
        rss = float(left[-1, -1])
        spread = max(rss / sums.rows, fits) if np.isfinite(fits) else rss / sums.rows
        gained = gains(left, sums)
        gained[list(refused)] = 0.0
        kinematics = float(gained[unloaded].max(initial=0.0))
        gained[~unloaded & (gained < calibrated.RESTING.clearer * kinematics)] = (
            0.0  # before the leading ones are taken: they take no place
        )
        best = None
        for n in np.argsort(-gained, kind="stable")[:LEADING].tolist():
            g = sums.groups[n]
            if gained[n] / spread < max(_least(g, sums.rows), largest / spread):
                refused.add(n)
                continue
            after = _heldout(sums, [*columns, *range(g.columns.start, g.columns.stop)])
            if loss - after < calibrated.DETECTION.generalises * gained[n]:
                refused.add(n)
                continue
            cost = calibrated.DETECTION.simpler * (g.columns.stop - g.columns.start) + g.law.hypothesis.penalty
            worth = (loss - after) / spread - cost
            if best is None or worth > best[0]:
                best = (worth, n, after)
        if best is None:
            break
        _, n, loss = best
        g = sums.groups[n]
        taken.append(g)
        refused.add(n)
        own = list(range(g.columns.start, g.columns.stop))
        columns += own
        left = swept(left, np.array(own))
        exact = g.law.hypothesis.exact or bool(g.law.hypothesis.summed)  # a sum of waves is any wave
        share = calibrated.DETECTION.beside_exact if exact else calibrated.DETECTION.beside
        largest = max(largest, share * gained[n])
    return taken


def _least(g: Group, rows: int) -> float:
    p = g.columns.stop - g.columns.start
    d = calibrated.DETECTION
    return float(max(d.gain + d.per_coefficient * (p - 1) + g.law.hypothesis.penalty, d.share * rows))


def _heldout(sums: Sums, columns: Sequence[int]) -> float:
    """Sum of squares left on folds that no fit saw."""
    at, out = np.array(columns, int), 0.0
    of = np.append(at, -1)
    whole = sums.total[np.ix_(at, of)]
    for part in sums.folds:
        own = part[np.ix_(of, of)]
        rest = whole - own[:-1]
        x = np.append(-ridged_inverse(rest[:, :-1]) @ rest[:, -1], 1.0)
        out += float(x @ own @ x)
    return out


def _waves(picked: Sequence[Group]) -> list[Hypothesis]:
    """One law a joint, with all the orders that were taken there."""
    orders: dict[tuple[str, str], list[float]] = {}
    laws: dict[tuple[str, str], Hypothesis] = {}
    for g in picked:
        h = g.law.hypothesis
        if h.summed:
            orders.setdefault(h.name, []).extend(h.shapes[g.shape])
            laws[h.name] = h
    return [
        replace(laws[name], law=f"{len(n)} {laws[name].summed}" if len(n) > 1 else laws[name].law, shapes=(tuple(n),))
        for name, n in orders.items()
    ]


def _others(picked: Sequence[Group]) -> list[Hypothesis]:
    out: dict[tuple[str, str], Hypothesis] = {}
    for g in picked:
        h = g.law.hypothesis
        if not h.summed:
            out.setdefault(h.name, replace(h, shapes=(h.shapes[g.shape],)))
    return list(out.values())
