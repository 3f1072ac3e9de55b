"""Joint selection of many effects: a sparse sum over harmonics of every joint, every frame and every other law.

A calibrated arm with a laser tracker shows more effects than forward selection can handle: harmonics of several
orders in each gear, and frames that are 0.1 mm off. The normal equations of all laws are computed once. Column groups
are selected one by one, each refitted with all before it (group orthogonal matching pursuit, Lozano, Swirszcz & Abe
2009), as long as the next one improves the cross-validated error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.effects.structure import as_built_joint_frames
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.screening.normal_equation_sums import (
    CachedSums,
    LawColumnGroup,
    NormalEquationSums,
    compute_group_gains,
    eliminate_columns,
)
from machopt.measurement.diagnosis.model_selection.search.predictive_score import (
    FoldSums,
    compute_predictive_score,
    get_required_gain,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, invert_with_ridge
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.numerics.array_types import Array, Ints

MOST = 96  # most groups, as a safeguard
LEADING_GROUPS = 3  # groups that are cross-validated in each step
UNLOADED_FAMILIES = (
    "kinematic",
    "sensor",
)  # load-independent families: frames, harmonics, tracker frames


def whiten_picked_groups(model: WhitenedModel, picked: Sequence[LawColumnGroup]) -> list[WhitenedHypothesis]:
    """Return one law for each effect of jointly selected groups; the waves of a joint become one law.

    Args:
        model: Whitened base model.
        picked: Selected groups of columns.

    Returns:
        Laws with one shape each.
    """
    return whiten_hypotheses(model, [*_combine_joint_waves(picked), *_list_other_laws(picked)])


def add_predictive_groups(
    sums: NormalEquationSums, start: Sequence[tuple[str, str]], most: int
) -> list[LawColumnGroup]:
    """Add up to ``most`` groups to the given laws while unseen readings are predicted clearly better.

    Laws of weight need their physical bounds, which :func:`select_effects` checks, and are not added here.
    The choice of one group among many costs the logarithm of their number (description length).
    """
    taken = [g for g in sums.groups if g.law.hypothesis.name in start]
    least = get_required_gain() + float(np.log(len(sums.groups)))
    unloaded = _mark_unloaded(sums)
    now = _score_groups(sums, taken)
    left = eliminate_columns(sums.total, _list_columns(sums, taken))
    for _ in range(most):
        gained = compute_group_gains(left, sums)
        gained[[any(g is t for t in taken) for g in sums.groups]] = 0.0
        gained[~unloaded] = 0.0
        each = [
            (_score_groups(sums, [*taken, sums.groups[n]]), n)
            for n in np.argsort(-gained, kind="stable")[:LEADING_GROUPS].tolist()
        ]
        if max(each)[0] <= now + least:
            break
        now, best = max(each)
        taken.append(sums.groups[best])
        left = eliminate_columns(left, np.arange(taken[-1].columns.start, taken[-1].columns.stop))
    return taken


def _list_columns(sums: NormalEquationSums, taken: Sequence[LawColumnGroup]) -> Ints:
    return np.array([*range(sums.base), *(c for g in taken for c in range(g.columns.start, g.columns.stop))], np.int64)


def _mark_unloaded(sums: NormalEquationSums) -> NDArray[np.bool_]:
    return np.array([g.law.hypothesis.family in UNLOADED_FAMILIES for g in sums.groups], bool)


def _clear_stand_ins(gained: Array, unloaded: NDArray[np.bool_]) -> None:
    """Set the gain of weight laws to zero that do not clearly exceed the best frame or wave."""
    kinematics = float(gained[unloaded].max(initial=0.0))
    gained[~unloaded & (gained < thresholds.RATIOS.larger * kinematics)] = 0.0


def _score_groups(sums: NormalEquationSums, taken: Sequence[LawColumnGroup]) -> float:
    at = _list_columns(sums, taken)
    return compute_predictive_score(
        FoldSums(
            normal=sums.total[np.ix_(at, at)],
            XX=np.stack([part[np.ix_(at, at)] for part in sums.folds]),
            Xy=np.stack([part[at, -1] for part in sums.folds]),
            yy=np.array([part[-1, -1] for part in sums.folds]),
            rows=np.array(sums.fold_rows),
        )
    )


def has_frame_laws(laws: Sequence[WhitenedHypothesis]) -> bool:
    """Return whether frame laws are among the hypotheses, as in measured poses only.

    Args:
        laws: All whitened hypotheses.

    Returns:
        True if so.
    """
    return any(t.hypothesis.effect == as_built_joint_frames.EFFECT.name for t in laws)


def select_many_effects(
    model: WhitenedModel,
    laws: Sequence[WhitenedHypothesis],
    fits: float,
    sums: CachedSums | None = None,
    offsets: Sequence[tuple[str, str]] = (),
) -> list[WhitenedHypothesis]:
    """Select the effects of a recording with many effects jointly; the harmonics of a joint are one effect.

    Args:
        model: Whitened base model.
        laws: All whitened hypotheses.
        fits: Whitened residual variance that noise alone would leave; NaN if the noise was not measured.
        sums: Sums of base and laws if they already exist.
        offsets: Zero offsets that are selected at first.

    Returns:
        One law with one shape for each effect; empty if there are few effects or none.
    """
    if not has_frame_laws(laws):
        return []
    if len(model.y) < thresholds.COUNTS.min_rows_per_column * (
        model.count + thresholds.COUNTS.max_stepwise_effects * 2
    ):
        return []
    picked = _select_groups_greedily((sums or CachedSums(model, laws)).sum_all, fits, offsets)
    places = {g.law.hypothesis.name for g in picked}
    if len(places) <= thresholds.COUNTS.max_stepwise_effects:
        return []
    return whiten_picked_groups(model, picked)


def _select_groups_greedily(
    sums: NormalEquationSums, fits: float, start: Sequence[tuple[str, str]] = ()
) -> list[LawColumnGroup]:
    """Return groups in the order of their selection, after those of the given laws."""
    taken = [g for g in sums.groups if g.law.hypothesis.name in start]
    columns = _list_columns(sums, taken).tolist()
    left = eliminate_columns(sums.total, np.array(columns, int))
    largest = 0.0
    loss = _compute_holdout_squares(sums, columns)
    refused = {n for n, g in enumerate(sums.groups) if any(g is t for t in taken)}
    unloaded = _mark_unloaded(sums)
    while len(taken) < MOST and sums.rows > thresholds.COUNTS.min_rows_per_column * len(columns):
        rss = float(left[-1, -1])
        spread = max(rss / sums.rows, fits) if np.isfinite(fits) else rss / sums.rows
        gained = compute_group_gains(left, sums)
        gained[list(refused)] = 0.0
        _clear_stand_ins(gained, unloaded)
        best = None
        for n in np.argsort(-gained, kind="stable")[:LEADING_GROUPS].tolist():
            g = sums.groups[n]
            if gained[n] / spread < max(_compute_least_gain(g, sums.rows), largest / spread):
                refused.add(n)
                continue
            after = _compute_holdout_squares(sums, [*columns, *range(g.columns.start, g.columns.stop)])
            if loss - after < thresholds.SHARES.min_transfer * gained[n]:
                refused.add(n)
                continue
            cost = thresholds.LEVELS.gain_two_sigma * (g.columns.stop - g.columns.start) + g.law.hypothesis.penalty
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
        share = thresholds.SHARES.exact_law_error if exact else thresholds.SHARES.law_error
        largest = max(largest, share * gained[n])
    return taken


def _compute_least_gain(g: LawColumnGroup, rows: int) -> float:
    p = g.columns.stop - g.columns.start
    return float(
        max(
            thresholds.LEVELS.min_gain + thresholds.LEVELS.gain_two_sigma * (p - 1) + g.law.hypothesis.penalty,
            thresholds.SHARES.min_gain_per_row * rows,
        )
    )


def _compute_holdout_squares(sums: NormalEquationSums, columns: Sequence[int]) -> float:
    """Return the cross-validated residual sum of squares."""
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
    """Return one law per joint with all orders selected there."""
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
