"""Comparison of sets of effects in measured poses by description length (Bayesian evidence).

Forward selection takes the largest gain at each step. A frame with six coefficients gains as much as the two zero
offsets that it contains and is selected first, and no later step corrects this. Therefore one, two or three of the
selected effects are exchanged for other sets: several laws with one coefficient each, or one law with six.

The description length of a set is −2 log of its evidence. It contains the residual, the prior penalty of the
coefficients, and log(1 + λ) for each direction that the readings determine λ times better than the prior (Occam
factor). Coefficients without a prior get a unit-information prior, which gives the BIC. Source: MacKay 1992 (Occam
factors); Kass & Wasserman 1995 (unit information); Kass & Raftery 1995 (the scale).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, islice

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    compute_chance_probability,
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.screening.normal_equation_sums import (
    CachedSums,
    NormalEquationSums,
    compute_gains_beside,
)
from machopt.measurement.diagnosis.model_selection.search.candidate_checks import (
    is_supported,
    is_supported_without_session_check,
)
from machopt.measurement.diagnosis.model_selection.search.law_error import compute_law_error
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    BODY,
    SelectedEffect,
    add_selected_effects,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, invert_with_ridge
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, select_shape
from machopt.numerics.array_types import Ints

MAX_EXCHANGED = 3  # most effects exchanged at once
MAX_CANDIDATES = 8  # laws with the largest gains whose description length is computed per step
MAX_COEFFICIENTS = 2  # most coefficients of a law in a set that replaces a frame
FAMILY = "kinematic"  # effects without load: frames, offsets, harmonics, couplings
WEIGHT_FAMILIES = ("joint", "compensator", "body")

GroupIndices = tuple[int, ...]  # indices of column groups


def find_shortest_description(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], tried: CachedSums, most: int
) -> list[SelectedEffect]:
    """Find a set of effects with a clearly shorter description than the selected one.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        tried: Sums of all laws; the load-independent laws of measured poses are considered.
        most: Largest number of effects.

    Returns:
        The selected effects, or the shorter set.
    """
    if not any(len(c.scored.x) > 1 for c in chosen if _is_exchangeable(c.whitened)):
        return list(chosen)
    # including a harmonic and its double: sets are identified by group indices
    sums = tried.select_groups([(c.whitened, c.scored.shape) for c in chosen], _is_exchangeable)
    start = tuple(range(len(chosen)))
    view = _DescriptionSearch(sums, len(chosen), add_selected_effects(model, chosen).residual_variance, most)
    best = view.shortest(start)
    if best == start:
        return list(chosen)
    chance = max(c.p_value for c in chosen)  # p-value of the search that found the longer description
    while True:
        parts = []
        for g in best:
            if g < len(chosen):
                parts.append(_DescriptionPart(chosen[g].whitened, chosen[g].scored.shape, chosen[g].p_value))
            else:
                parts.append(_DescriptionPart(sums.groups[g].law, sums.groups[g].shape, chance, is_new=True))
        found = _score_together(model, parts)
        if found is None:
            return list(chosen)
        weak = [k for k, part in enumerate(parts) if part.is_new and _is_covered_by_compliance(found, k)]
        if not weak:
            return sorted(found, key=lambda c: -c.scored.total)
        least = min(weak, key=lambda k: found[k].scored.gain)
        best = (*best[:least], *best[least + 1 :])
        if view.length(best) >= view.length(start) - thresholds.LEVELS.min_evidence:
            return list(chosen)


def _compute_length(scored: ScoredHypothesis, *, spread: float, count: int) -> float:
    """Return −2 log evidence of one effect up to a constant: numbers · log(count) − gain / spread."""
    numbers = len(scored.x) + len(scored.whitened.shapes[scored.shape])
    return numbers * float(np.log(count)) - scored.gain / spread


def exchange_for_weight_laws(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], laws: Sequence[WhitenedHypothesis], rng: np.random.Generator
) -> list[SelectedEffect]:
    """Replace an offset, frame or harmonic by a weight-dependent law if the description becomes clearly shorter.

    The previous comparison covers load-independent laws only; it would leave a compensator torque as a zero offset.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.
        laws: All whitened hypotheses.
        rng: Random generator of the sign flips.

    Returns:
        The effects.
    """
    out = list(chosen)
    for k, c in enumerate(out):
        others = [o for o in out if o is not c]
        names = {o.whitened.hypothesis.name for o in others}
        near = [t for t in laws if t.hypothesis.location == c.whitened.hypothesis.location]
        near = [t for t in near if t.hypothesis.name not in names and _is_weight_law(t)]
        if not _is_exchangeable(c.whitened) or not near:
            continue
        spread, model_without = add_selected_effects(model, out).residual_variance, add_selected_effects(model, others)
        length = partial(_compute_length, spread=spread, count=len(model.y))
        own = score_hypotheses(model_without, [select_shape(c.whitened, c.scored.shape)])[0]
        most = length(own) - thresholds.LEVELS.min_evidence
        better = [
            s for s in score_hypotheses(model_without, near) if length(s) < most and is_supported(model_without, s)
        ]
        if better:
            best = min(better, key=length)
            residual = add_selected_effects(model, [*others, SelectedEffect(best, 1.0)]).residual
            among = fit_hypotheses(model_without, [t for t in laws if t.hypothesis.name not in names])
            chance = float(compute_chance_probability(model_without, [best, *among], residual, rng)[0])
            out[k] = SelectedEffect(best, chance) if chance <= thresholds.LEVELS.significance_level else c
    return sorted(out, key=lambda c: -c.scored.total)


def _is_covered_by_compliance(found: Sequence[SelectedEffect], k: int) -> bool:
    """Return whether the k-th effect gains no more than the model error of a compliant body."""
    bodies = [c for n, c in enumerate(found) if n != k and c.whitened.hypothesis.family == BODY]
    return found[k].scored.gain <= compute_law_error(found[k].scored, bodies, thresholds.SHARES.body_law_error)


def _is_weight_law(t: WhitenedHypothesis) -> bool:
    return t.hypothesis.is_in_catalogue and t.hypothesis.family in WEIGHT_FAMILIES


def _is_exchangeable(t: WhitenedHypothesis) -> bool:
    return t.hypothesis.family == FAMILY and t.hypothesis.is_in_catalogue


@dataclass(frozen=True)
class _DescriptionPart:
    """One law of a set."""

    law: WhitenedHypothesis
    shape: int
    p_value: float
    is_new: bool = False


@dataclass(frozen=True)
class _DescriptionSearch:
    """Comparison of sets of laws by description length, based on precomputed sums."""

    sums: NormalEquationSums
    found_count: int  # number of selected groups, which come first
    residual_variance: float  # whitened residual variance, common to all sets
    max_effects: int  # most effects in a set
    lengths: dict[GroupIndices, float] = field(default_factory=dict)  # of sets computed so far, by sorted indices

    def shortest(self, group_indices: GroupIndices) -> GroupIndices:
        """Exchange groups as long as the description becomes clearly shorter.

        Args:
            group_indices: Indices of the initial groups.

        Returns:
            Indices of the final groups.
        """
        while True:
            now = self.length(group_indices)
            each = [(self.length(s), s) for s in self._exchanges(group_indices)]
            least = min(each, default=(now, group_indices))
            if now - least[0] <= thresholds.LEVELS.min_evidence:
                return group_indices
            group_indices = least[1]

    def length(self, some: GroupIndices) -> float:
        """Compute the description length in addition to the base: −2 log evidence up to a constant.

        Args:
            some: Indices of the groups of a set.

        Returns:
            Description length.
        """
        key = tuple(sorted(some))
        if key not in self.lengths:
            self.lengths[key] = self._compute_length(key)
        return self.lengths[key]

    def _compute_length(self, some: GroupIndices) -> float:
        at = self._list_columns(some)
        H, n = self.sums.beside_base, self.sums.rows
        if not len(at):
            return float(H[-1, -1]) / self.residual_variance
        left = H[np.ix_(at, at)]
        fit = float(H[-1, -1] - H[-1, at] @ invert_with_ridge(left, self.sums.sizes[at]) @ H[at, -1])
        precision = np.concatenate([self.sums.groups[g].law.precision(self.sums.groups[g].shape) for g in some])
        size = 1.0 / np.sqrt(np.where(precision > 0.0, precision, np.diag(self.sums.total)[at] / n))
        known = np.linalg.eigvalsh(
            np.eye(len(at)) + (left - np.diag(precision)) * np.outer(size, size) / self.residual_variance
        )
        shapes = sum(self._orders(g) for g in some)
        return fit / self.residual_variance + float(np.sum(np.log(np.maximum(known, 1.0)))) + shapes * float(np.log(n))

    def _list_columns(self, some: GroupIndices) -> Ints:
        return np.array([c for g in some for c in self._columns(g)], np.int64)

    def _columns(self, g: int) -> range:
        return range(self.sums.groups[g].columns.start, self.sums.groups[g].columns.stop)

    def _orders(self, g: int) -> int:
        """Return the number of harmonic orders that the shape of a group contains."""
        law = self.sums.groups[g].law
        return len(law.shapes[self.sums.groups[g].shape])

    def _name(self, g: int) -> tuple[str, str]:
        return self.sums.groups[g].law.hypothesis.name

    def _kinematic(self, g: int) -> bool:
        return _is_exchangeable(self.sums.groups[g].law)

    def _exchanges(self, group_indices: GroupIndices) -> Iterator[GroupIndices]:
        """Yield sets in which other laws replace some groups: single laws, or several with few coefficients."""
        parts = [g for g in group_indices if self._kinematic(g)]
        for n in range(1, min(MAX_EXCHANGED, len(parts)) + 1):
            for some in combinations(parts, n):
                remaining = tuple(g for g in group_indices if g not in some)
                for most in (MAX_COEFFICIENTS, 6):
                    new = self._find_small_law_set(remaining, most)
                    if set(new) != set(group_indices) and len(new) <= self.max_effects:
                        yield new

    def _find_small_law_set(self, required: GroupIndices, most: int) -> GroupIndices:
        """Add laws with few coefficients while the description becomes shorter; drop nearly unnecessary ones."""
        out, now = required, self.length(required)
        wide = np.array([len(self._columns(g)) > most for g in range(len(self.sums.groups))])
        while True:
            gained = compute_gains_beside(self.sums, self._list_columns(out))
            taken = {self._name(g) for g in out}
            gained[wide] = 0.0
            gained[: self.found_count] = 0.0
            ranked = (g for g in np.argsort(-gained, kind="stable").tolist() if self._name(g) not in taken)
            each = [(self.length((*out, g)), g) for g in islice(ranked, MAX_CANDIDATES) if gained[g] > 0.0]
            if not each or min(each)[0] >= now:
                break
            now, out = min(each)[0], (*out, min(each)[1])
        return self._drop_unneeded(required, out)

    def _drop_unneeded(self, required: GroupIndices, some: GroupIndices) -> GroupIndices:
        """Drop groups whose removal hardly changes the description length."""
        while len(some) > len(required) + 1:
            each = [(self.length(w), w) for w in (tuple(o for o in some if o != g) for g in some if g not in required)]
            if min(each)[0] >= self.length(some) + thresholds.LEVELS.min_evidence:
                break
            some = min(each)[1]
        return some


def _score_together(model: WhitenedModel, parts: Sequence[_DescriptionPart]) -> list[SelectedEffect] | None:
    """Return each law scored together with the others, in order; None if a new one is not supported."""
    out = []
    for part in parts:
        others = [o for o in parts if o is not part]
        model_without = model
        for o in others:
            model_without = model_without.with_law(o.law, o.shape, with_prior=True)
        s = score_hypotheses(model_without, [select_shape(part.law, part.shape)])[0]
        if part.is_new and not is_supported_without_session_check(model_without, s):
            return None
        out.append(SelectedEffect(replace(s, whitened=part.law, shape=part.shape), part.p_value))
    return out
