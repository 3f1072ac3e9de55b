"""Log predictive score of a set of effects on poses or cycles that its fit did not see; zero offsets selected by it.

For each fold, coefficients are fitted to the other folds. The score of the fold is the log density of its whitened
readings, with the uncertainty of the coefficients in it (Gneiting & Raftery 2007, J. Am. Stat. Assoc. 102, 359)::

    p = y − X x₋,   S = σ² (1 + X N₋⁻¹ Xᵀ),   score = −½ (pᵀ S⁻¹ p + log|S|)

N₋ is the normal matrix with priors of the other folds, and N = N₋ + XᵀX. So S⁻¹ = (1 − X N⁻¹ Xᵀ)/σ² and
|S| = σ²ⁿ |N| / |N₋|: the sums by fold are sufficient. An unnecessary coefficient lowers the score by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machopt.effects.joint import joint_angle_errors
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import has_plausible_sizes
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, invert_with_ridge
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, select_shape
from machopt.numerics.array_types import Array, Ints


def get_required_gain() -> float:
    """Return by how much a score (log density) has to be larger: half of the limit for −2 log evidence."""
    return 0.5 * thresholds.LEVELS.min_evidence


@dataclass(frozen=True, kw_only=True)
class FoldSums:
    """Normal equations by fold of P columns."""

    normal: Array  # (P, P) of all folds, with priors
    XX: Array  # (F, P, P)
    Xy: Array  # (F, P)
    yy: Array  # (F,)
    rows: Ints  # (F,)


def compute_set_score(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> float:
    """Compute the log predictive score of a set of effects over the folds.

    The folds do not search the shapes, such as an order of a gear. Each number of a shape counts ½ log(rows) (BIC).
    Coefficients with a prior count ½ (x / σ)² (log prior density): a frame 40 tolerances off is less likely than a
    zero offset, however well it predicts.

    Args:
        model: Whitened base model.
        chosen: Selected effects.

    Returns:
        The score, up to a constant of the readings.
    """
    whole = add_selected_effects(model, chosen)
    shapes = sum(len(c.whitened.shapes[c.scored.shape]) for c in chosen)
    x, prior = whole.coefficients[model.count :], whole.prior[model.count :]
    penalty = float(prior @ x**2) + shapes * float(np.log(len(model.y)))
    return _score_columns(whole, np.arange(whole.count)) - 0.5 * penalty


def select_zero_offsets(model: WhitenedModel, laws: Sequence[WhitenedHypothesis]) -> list[SelectedEffect]:
    """Select zero offsets among all subsets of the joints by the log predictive score.

    A frame with six coefficients contains the zero offset of its joint, and frames of other joints imitate it. In a
    search that adds one law after the other a frame therefore wins where several zero offsets are the cause.

    Args:
        model: Whitened base model.
        laws: All whitened hypotheses.

    Returns:
        The offsets, scored together; the smallest subset that no larger one beats clearly.
    """
    offsets = [t for t in laws if t.hypothesis.effect == joint_angle_errors.ZERO.file_word]
    whole = model
    for t in offsets:
        whole = whole.with_law(t, 0, with_prior=True)
    base = np.arange(model.count)
    best: tuple[int, ...] = ()
    most = _score_columns(whole, base)
    for size in range(1, len(offsets) + 1):
        each = [
            (_score_columns(whole, np.concatenate([base, model.count + np.array(some)])), some)
            for some in combinations(range(len(offsets)), size)
        ]
        score, some = max(each)
        if score > most + get_required_gain():
            best, most = some, score
    found = [SelectedEffect(s, 1.0) for s in score_hypotheses(model, [offsets[k] for k in best])]
    return [c for c in score_together(model, found) if has_plausible_sizes(c.scored)]


def score_together(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> list[SelectedEffect]:
    """Score each effect at its shape together with the others.

    Args:
        model: Whitened base model.
        chosen: Selected effects.

    Returns:
        The effects in the same order, with new coefficients.
    """
    out = []
    for k, c in enumerate(chosen):
        beside = add_selected_effects(model, [*chosen[:k], *chosen[k + 1 :]])
        s = score_hypotheses(beside, [select_shape(c.whitened, c.scored.shape)])[0]
        out.append(replace(c, scored=replace(s, whitened=c.whitened, shape=c.scored.shape)))
    return out


def drop_unpredictive_effects(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> list[SelectedEffect]:
    """Drop effects without which unseen readings are predicted as well.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.

    Returns:
        The remaining effects, scored together, the largest first.
    """
    out = list(chosen)
    while out:
        now = compute_set_score(model, out)
        without = [compute_set_score(model, [o for o in out if o is not c]) for c in out]
        least = int(np.argmax(without))
        if without[least] < now - get_required_gain():
            break
        del out[least]
    return sorted(score_together(model, out), key=lambda c: -c.scored.total)


def _score_columns(model: WhitenedModel, columns: Ints) -> float:
    """Return the log predictive score with some of a model's columns."""
    at = columns[:, None], columns
    sums = FoldSums(
        normal=model.normal[at],
        XX=model.XX[:, at[0], at[1]],
        Xy=model.Xy[:, columns],
        yy=model.yy,
        rows=np.array([len(r) for r in model.rows]),
    )
    return compute_predictive_score(sums)


def compute_predictive_score(sums: FoldSums) -> float:
    """Compute the log predictive score over the folds.

    Args:
        sums: Normal equations by fold.

    Returns:
        The score, up to a constant of the readings.
    """
    XX, Xy, N, rows = sums.XX, sums.Xy, sums.normal, sums.rows
    h = Xy.sum(axis=0)
    inverse, rest = invert_with_ridge(N), N - XX
    others = invert_with_ridge(rest)
    x = np.einsum("fij,fj->fi", others, h - Xy)
    Xx = np.einsum("fij,fj->fi", XX, x)
    squares = sums.yy - 2.0 * np.einsum("fi,fi->f", x, Xy) + np.einsum("fi,fi->f", x, Xx)
    u = Xy - Xx  # Xᵀ p
    squares = squares - np.einsum("fi,ij,fj->f", u, inverse, u)
    freedom = max(int(rows.sum()) - len(N), 1)
    variance = max(float(sums.yy.sum() - h @ inverse @ h) / freedom, np.finfo(float).tiny)
    logs = np.linalg.slogdet(others)[1] - np.linalg.slogdet(inverse)[1] + rows * np.log(variance)
    return float(-0.5 * np.sum(squares / variance + logs))
