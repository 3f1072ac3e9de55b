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

from machopt.effects.structure import link_geometry
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.screening.normal_equation_sums import (
    CachedSums,
    LawColumnGroup,
    NormalEquationSums,
    compute_group_gains,
    eliminate_columns,
)
from machopt.measurement.diagnosis.model_selection.search import harmonic_orders
from machopt.measurement.diagnosis.model_selection.search.description_length import (
    exchange_for_weight_laws,
    find_shortest_description,
)
from machopt.measurement.diagnosis.model_selection.search.forward_selection import (
    SelectedEffect,
    prune_joint_effects,
    select_effects,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    WhitenedHypothesis,
    WhitenedModel,
    invert_with_ridge,
    whiten_hypotheses,
)

DEFAULT_MAX_EFFECTS = 3  # effects that a search one by one is asked for as a rule
MAX_RIVAL_SHAPES = 24  # shapes of a law that is held against what was found together
MOST = 96  # groups, a safety
LEADING_GROUPS = 3  # groups whose gain on unseen folds is looked at in each step
UNLOADED_FAMILIES = (
    "kinematic",
    "sensor",
)  # families of what is there without any weight: frames, waves, the tracker's stand


def search_effects(
    model: WhitenedModel, laws: Sequence[WhitenedHypothesis], most: int, rng: np.random.Generator, fits: float
) -> tuple[tuple[WhitenedHypothesis, ...], tuple[SelectedEffect, ...]]:
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
    sums = CachedSums(model, laws)
    found = select_many_effects(model, laws, fits, sums) if most >= DEFAULT_MAX_EFFECTS else []
    if not found:
        if _has_frame_laws(laws):
            few = find_shortest_description(model, select_effects(model, laws, most, rng), sums, most)
            return tuple(laws), tuple(exchange_for_weight_laws(model, few, laws, rng))
        chosen = select_effects(
            model, laws, most, rng, lambda so_far: harmonic_orders.add_harmonic_orders(model, so_far, laws, rng)
        )
        grown = [c.whitened for c in chosen if not any(c.whitened is t for t in laws)]
        return (*laws, *grown), tuple(chosen)
    names = {t.hypothesis.name for t in found}
    rest = [t for t in laws if t.hypothesis.name not in names and len(t.shapes) <= MAX_RIVAL_SHAPES]
    return (*rest, *found), tuple(prune_joint_effects(model, found, laws, rng))


def _has_frame_laws(laws: Sequence[WhitenedHypothesis]) -> bool:
    """Whether laws of frames are among them, which measured poses alone have."""
    return any(t.hypothesis.effect == link_geometry.EFFECT.name for t in laws)


def select_many_effects(
    model: WhitenedModel, laws: Sequence[WhitenedHypothesis], fits: float, sums: CachedSums | None = None
) -> list[WhitenedHypothesis]:
    """The effects of a crowded recording, each as one law of one shape: a joint's waves are one effect.

    Args:
        model: the base.
        laws: all that is tried.
        fits: whitened variance of what noise alone would leave; NaN: nobody measured it.
        sums: of base and laws, where they are needed elsewhere, too.

    Returns:
        Empty where few effects, or none, are there.
    """
    if not _has_frame_laws(laws):
        return []
    if len(model.y) < thresholds.RESTING.per_column * (model.count + thresholds.RESTING.crowded * 2):
        return []
    picked = _select_groups_greedily((sums or CachedSums(model, laws)).sum_all, fits)
    places = {g.law.hypothesis.name for g in picked}
    if len(places) <= thresholds.RESTING.crowded:
        return []
    return whiten_hypotheses(model, [*_combine_joint_waves(picked), *_list_other_laws(picked)])


def _select_groups_greedily(sums: NormalEquationSums, fits: float) -> list[LawColumnGroup]:
    """Groups in the order in which they were taken."""
    taken: list[LawColumnGroup] = []
    columns = list(range(sums.base))
    left = eliminate_columns(sums.total, np.array(columns, int))
    largest = 0.0
    loss = _compute_holdout_squares(sums, columns)
    refused: set[int] = set()
    unloaded = np.array([g.law.hypothesis.family in UNLOADED_FAMILIES for g in sums.groups], bool)
    while len(taken) < MOST and sums.rows > thresholds.RESTING.per_column * len(columns):
        rss = float(left[-1, -1])
        spread = max(rss / sums.rows, fits) if np.isfinite(fits) else rss / sums.rows
        gained = compute_group_gains(left, sums)
        gained[list(refused)] = 0.0
        kinematics = float(gained[unloaded].max(initial=0.0))
        gained[~unloaded & (gained < thresholds.RESTING.clearer * kinematics)] = (
            0.0  # before the leading ones are taken: they take no place
        )
        best = None
        for n in np.argsort(-gained, kind="stable")[:LEADING_GROUPS].tolist():
            g = sums.groups[n]
            if gained[n] / spread < max(_compute_least_gain(g, sums.rows), largest / spread):
                refused.add(n)
                continue
            after = _compute_holdout_squares(sums, [*columns, *range(g.columns.start, g.columns.stop)])
            if loss - after < thresholds.DETECTION.generalises * gained[n]:
                refused.add(n)
                continue
            cost = thresholds.DETECTION.simpler * (g.columns.stop - g.columns.start) + g.law.hypothesis.penalty
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
        left = eliminate_columns(left, np.array(own))
        exact = g.law.hypothesis.is_exact or bool(g.law.hypothesis.sum_name)  # a sum of waves is any wave
        share = thresholds.DETECTION.beside_exact if exact else thresholds.DETECTION.beside
        largest = max(largest, share * gained[n])
    return taken


def _compute_least_gain(g: LawColumnGroup, rows: int) -> float:
    p = g.columns.stop - g.columns.start
    d = thresholds.DETECTION
    return float(max(d.gain + d.per_coefficient * (p - 1) + g.law.hypothesis.penalty, d.share * rows))


def _compute_holdout_squares(sums: NormalEquationSums, columns: Sequence[int]) -> float:
    """Sum of squares left on folds that no fit saw."""
    at, out = np.array(columns, int), 0.0
    of = np.append(at, -1)
    whole = sums.total[np.ix_(at, of)]
    for part in sums.folds:
        own = part[np.ix_(of, of)]
        rest = whole - own[:-1]
        x = np.append(-invert_with_ridge(rest[:, :-1]) @ rest[:, -1], 1.0)
        out += float(x @ own @ x)
    return out


def _combine_joint_waves(picked: Sequence[LawColumnGroup]) -> list[EffectHypothesis]:
    """One law a joint, with all the orders that were taken there."""
    orders: dict[tuple[str, str], list[float]] = {}
    laws: dict[tuple[str, str], EffectHypothesis] = {}
    for g in picked:
        h = g.law.hypothesis
        if h.sum_name:
            orders.setdefault(h.name, []).extend(h.shapes[g.shape])
            laws[h.name] = h
    return [
        replace(laws[name], law=f"{len(n)} {laws[name].sum_name}" if len(n) > 1 else laws[name].law, shapes=(tuple(n),))
        for name, n in orders.items()
    ]


def _list_other_laws(picked: Sequence[LawColumnGroup]) -> list[EffectHypothesis]:
    out: dict[tuple[str, str], EffectHypothesis] = {}
    for g in picked:
        h = g.law.hypothesis
        if not h.sum_name:
            out.setdefault(h.name, replace(h, shapes=(h.shapes[g.shape],)))
    return list(out.values())
