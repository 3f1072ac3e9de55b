"""The same with fewer numbers: explanations of measured poses exchanged as sets, by description length.

A search one by one takes what gains most at each step. A frame of six numbers gains as much as the two zero offsets
that it holds among its directions, and is taken first; no later step would miss a number. So what was found is held
against other sets in place of one, two or three of its parts: several laws of a number each, or one law of six.

The length of a set is −2 log of its evidence: what it leaves, what its numbers cost by what makers hold of them, and
log(1 + λ) for each direction that the readings tell λ times better than was known before (the Occam factor). Of numbers
of which nothing is known beforehand one reading's worth is (the unit information prior), which makes it the BIC.

Source: MacKay 1992 (Occam factors); Kass & Wasserman 1995 (unit information); Kass & Raftery 1995 (the scale).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    compute_chance_probability,
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.screening.normal_equation_sums import (
    CachedSums,
    NormalEquationSums,
    compute_group_gains,
    eliminate_columns,
)
from machopt.measurement.diagnosis.model_selection.search.forward_selection import (
    BODY,
    SelectedEffect,
    add_selected_effects,
    compute_law_error,
    is_supported,
    is_supported_without_session_check,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    WhitenedHypothesis,
    WhitenedModel,
    invert_with_ridge,
)

MAX_EXCHANGED = 3  # of what was found, exchanged at once
MAX_CANDIDATES = 8  # laws whose description length is worked out in each step: those that gain most
MAX_COEFFICIENTS = 2  # coefficients of a law that is one of several in place of a frame
FAMILY = "kinematic"  # what stands without weight: frames, offsets, waves, couplings
WEIGHT_FAMILIES = ("joint", "compensator", "body")

GroupIndices = tuple[int, ...]  # numbers of groups


def find_shortest_description(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], tried: CachedSums, most: int
) -> list[SelectedEffect]:
    """What was found, or what says as much in clearly fewer numbers.

    Args:
        model: the base.
        chosen: what a search found, each beside the others.
        tried: sums of all laws; those of measured poses that need no weight take part.
        most: effects at most.
    """
    if not any(len(c.scored.x) > 1 for c in chosen if _is_exchangeable(c.whitened)):
        return list(chosen)
    # a wave and its double, too: sets are told by the groups' numbers
    sums = tried.select_groups([(c.whitened, c.scored.shape) for c in chosen], _is_exchangeable)
    start = tuple(range(len(chosen)))
    view = _DescriptionSearch(sums, len(chosen), add_selected_effects(model, chosen).residual_variance, most)
    best = view.shortest(start)
    if best == start:
        return list(chosen)
    chance = max(c.p_value for c in chosen)  # of the search that found the same in more numbers
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
        if view.length(best) >= view.length(start) - thresholds.DETECTION.shorter:
            return list(chosen)


def exchange_for_weight_laws(
    model: WhitenedModel, chosen: Sequence[SelectedEffect], laws: Sequence[WhitenedHypothesis], rng: np.random.Generator
) -> list[SelectedEffect]:
    """What was found, with a law of weight in place of an offset, a frame or a wave where it is clearly shorter.

    Sets of what stands without weight were held against each other alone: a balancer's torque was left as an offset of
    its joint.

    Args:
        model: the base.
        chosen: what was found, each beside the others.
        laws: all that was tried.
        rng: of the sign flips that judge a law in the place of another.
    """
    out = list(chosen)
    for k, c in enumerate(out):
        others = [o for o in out if o is not c]
        names = {o.whitened.hypothesis.name for o in others}
        near = [t for t in laws if t.hypothesis.location == c.whitened.hypothesis.location]
        near = [t for t in near if t.hypothesis.name not in names and _is_weight_law(t)]
        if not _is_exchangeable(c.whitened) or not near:
            continue
        spread, beside = add_selected_effects(model, out).residual_variance, add_selected_effects(model, others)

        def length(s: ScoredHypothesis, spread: float = spread) -> float:
            numbers = len(s.x) + len(s.whitened.shapes[s.shape])
            return numbers * float(np.log(len(model.y))) - s.gain / spread

        own = score_hypotheses(beside, [_select_shape(c.whitened, c.scored.shape)])[0]
        most = length(own) - thresholds.DETECTION.shorter
        better = [s for s in score_hypotheses(beside, near) if length(s) < most and is_supported(beside, s)]
        if better:
            best = min(better, key=length)
            residual = add_selected_effects(model, [*others, SelectedEffect(best, 1.0)]).residual
            among = fit_hypotheses(beside, [t for t in laws if t.hypothesis.name not in names])
            chance = float(compute_chance_probability(beside, [best, *among], residual, rng)[0])
            out[k] = SelectedEffect(best, chance) if chance <= thresholds.DETECTION.chance else c
    return sorted(out, key=lambda c: -c.scored.total)


def _is_covered_by_compliance(found: Sequence[SelectedEffect], k: int) -> bool:
    """Whether the k-th takes no more than the law of what gives way leaves of that."""
    bodies = [c for n, c in enumerate(found) if n != k and c.whitened.hypothesis.family == BODY]
    return found[k].scored.gain <= compute_law_error(found[k].scored, bodies, thresholds.DETECTION.beside_body)


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
    """All laws as sums; sets of them are compared by description length."""

    sums: NormalEquationSums
    found_count: int  # groups that were found; the same laws stand among the others again
    residual_variance: float  # variance of a whitened residual, the same for all sets
    max_effects: int  # effects in a set

    def shortest(self, found: GroupIndices) -> GroupIndices:
        """The set that exchanges lead to, each for a clearly shorter one."""
        while True:
            now = self.length(found)
            each = [(self.length(s), s) for s in self._exchanges(found)]
            least = min(each, default=(now, found))
            if now - least[0] <= thresholds.DETECTION.shorter:
                return found
            found = least[1]

    def length(self, some: GroupIndices) -> float:
        """Description length beside the base: −2 log evidence, up to what all sets share."""
        base, n = np.arange(self.sums.base), self.sums.rows
        at = np.array([c for g in some for c in self._columns(g)], int)
        H = self.sums.total
        of = np.concatenate([base, at])
        fit = float(H[-1, -1] - H[-1, of] @ invert_with_ridge(H[np.ix_(of, of)]) @ H[of, -1])
        if not len(at):
            return fit / self.residual_variance
        C = H[np.ix_(base, at)]
        left = H[np.ix_(at, at)] - C.T @ invert_with_ridge(H[np.ix_(base, base)]) @ C
        held = np.concatenate([self.sums.groups[g].law.precision(self.sums.groups[g].shape) for g in some])
        size = 1.0 / np.sqrt(np.where(held > 0.0, held, np.diag(H)[at] / n))
        told = np.linalg.eigvalsh(
            np.eye(len(at)) + (left - np.diag(held)) * np.outer(size, size) / self.residual_variance
        )
        shapes = sum(self._orders(g) for g in some)
        return fit / self.residual_variance + float(np.sum(np.log(np.maximum(told, 1.0)))) + shapes * float(np.log(n))

    def _columns(self, g: int) -> range:
        return range(self.sums.groups[g].columns.start, self.sums.groups[g].columns.stop)

    def _orders(self, g: int) -> int:
        """Numbers of a law that its shape holds: the order of a wave."""
        law = self.sums.groups[g].law
        return len(law.shapes[self.sums.groups[g].shape])

    def _name(self, g: int) -> tuple[str, str]:
        return self.sums.groups[g].law.hypothesis.name

    def _kinematic(self, g: int) -> bool:
        return _is_exchangeable(self.sums.groups[g].law)

    def _exchanges(self, found: GroupIndices) -> Iterator[GroupIndices]:
        """Sets with other laws in place of some parts: any laws, or several of few numbers each."""
        parts = [g for g in found if self._kinematic(g)]
        for n in range(1, min(MAX_EXCHANGED, len(parts)) + 1):
            for some in combinations(parts, n):
                kept = tuple(g for g in found if g not in some)
                for most in (MAX_COEFFICIENTS, 6):
                    new = self._find_small_law_set(kept, most)
                    if set(new) != set(found) and len(new) <= self.max_effects:
                        yield new

    def _find_small_law_set(self, kept: GroupIndices, most: int) -> GroupIndices:
        """Laws of so many numbers at most, while the description gets shorter; none that it can nearly do without."""
        out, now = kept, self.length(kept)
        wide = np.array([len(self._columns(g)) > most for g in range(len(self.sums.groups))])
        while True:
            left = eliminate_columns(
                self.sums.total, np.array([*range(self.sums.base), *(c for g in out for c in self._columns(g))])
            )
            gained = compute_group_gains(left, self.sums)
            taken = {self._name(g) for g in out}
            gained[wide] = 0.0
            gained[: self.found_count] = 0.0
            near = [g for g in np.argsort(-gained, kind="stable").tolist() if self._name(g) not in taken][
                :MAX_CANDIDATES
            ]
            each = [(self.length((*out, g)), g) for g in near if gained[g] > 0.0]
            if not each or min(each)[0] >= now:
                break
            now, out = min(each)[0], (*out, min(each)[1])
        return self._drop_unneeded(kept, out)

    def _drop_unneeded(self, kept: GroupIndices, some: GroupIndices) -> GroupIndices:
        """Without what makes the set longer by next to nothing when it is left out: no name for that."""
        while len(some) > len(kept) + 1:
            each = [(self.length(w), w) for w in (tuple(o for o in some if o != g) for g in some if g not in kept)]
            if min(each)[0] >= self.length(some) + thresholds.DETECTION.shorter:
                break
            some = min(each)[1]
        return some


def _score_together(model: WhitenedModel, parts: Sequence[_DescriptionPart]) -> list[SelectedEffect] | None:
    """Each scored beside the others, in their order; None where a new one would not stand by itself."""
    out = []
    for part in parts:
        others = [o for o in parts if o is not part]
        beside = model
        for o in others:
            beside = beside.with_law(o.law, o.shape, held=True)
        s = score_hypotheses(beside, [_select_shape(part.law, part.shape)])[0]
        if part.is_new and not is_supported_without_session_check(beside, s):
            return None
        out.append(SelectedEffect(replace(s, whitened=part.law, shape=part.shape), part.p_value))
    return out


def _select_shape(t: WhitenedHypothesis, shape: int) -> WhitenedHypothesis:
    k = slice(shape, shape + 1)
    h = replace(t.hypothesis, shapes=(t.shapes[shape],))
    return replace(t, hypothesis=h, X=t.X[:, k], unit=t.unit[k], XX=t.XX[:, k], Xy=t.Xy[:, k])
