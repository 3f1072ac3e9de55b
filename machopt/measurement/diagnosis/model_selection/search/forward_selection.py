"""Which effects together: forward by the gain on unseen groups, each step judged against the whole search by chance.

After every step what was chosen before may be exchanged or dropped, and pairs among the leading hypotheses are tried
exhaustively, because one effect can stand in for two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machopt.data_types.locations import format_link_location, parse_location
from machopt.effects import registry
from machopt.effects.structure import link_geometry
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    ScoredHypothesis,
    compute_chance_probability,
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.screening.session_transfer import is_consistent_between_sessions
from machopt.measurement.diagnosis.model_selection.screening.significance_check import (
    find_insignificant_laws,
    project_to_plausible_coefficients,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedHypothesis, WhitenedModel
from machopt.numerics.array_types import Array

PAIR_CANDIDATES = 6
BODY = "body"  # family of what gives way
SENSOR = "sensor"  # of what is wrong in the record
RELATIVE_UNITS = {"%": 0.01, "deg": np.pi / 180.0}  # relative size of a gain, of an angle
JOINTS_BEFORE_WRIST = 3  # joints before the wrist


@dataclass(frozen=True)
class SelectedEffect:
    """One effect in the final model."""

    scored: ScoredHypothesis  # beside the others
    p_value: float

    @property
    def whitened(self) -> WhitenedHypothesis:
        return self.scored.whitened

    @property
    def columns(self) -> Array:
        return self.scored.whitened.columns_at(self.scored.shape)


def compute_least_gain(model: WhitenedModel, s: ScoredHypothesis) -> float:
    """Gain that a hypothesis has to reach, per unit of the residual's variance."""
    h = s.whitened.hypothesis
    p = s.whitened.X.shape[2]
    least: float = thresholds.DETECTION.gain + thresholds.DETECTION.per_coefficient * (p - 1) + h.penalty
    return max(least, thresholds.DETECTION.share * len(model.y))


def is_supported(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Whether a hypothesis is large enough, on readings that did not choose it, not in one group or session alone."""
    return is_supported_without_session_check(model, s) and is_consistent_between_sessions(model, s)


def is_supported_without_session_check(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """The same, whatever the sessions say of each other."""
    if s.gain / model.residual_variance < compute_least_gain(model, s) or not _has_plausible_sizes(s):
        return False
    return (
        s.total > thresholds.DETECTION.generalises * s.gain
        and project_to_plausible_coefficients(model, s.whitened, s.shape, s.x)[1]
        <= (1.0 - thresholds.DETECTION.possible) * s.gain
        and _is_supported_by_several_groups(model, s)
        and not find_insignificant_laws(model.with_law(s.whitened, s.shape), [(s.whitened, s.shape)])
    )


def _is_supported_by_several_groups(model: WhitenedModel, s: ScoredHypothesis) -> bool:
    """Whether a law does not hang on one group: the others bear their share, or would be enough by themselves."""
    others = s.total - float(s.heldout.max())
    return (
        others > thresholds.DETECTION.without_best * s.total
        or others / model.residual_variance >= compute_least_gain(model, s)
    )


def _has_plausible_sizes(s: ScoredHypothesis) -> bool:
    h = s.whitened.hypothesis
    size = next(iter(h.quantities(s.x * s.whitened.unit[s.shape], s.whitened.shapes[s.shape]).values()))
    known = registry.find_effect(h.effect)
    return known is None or abs(size.value) <= known.plausible_sizes.get(size.unit, np.inf)


def select_effects(
    model: WhitenedModel,
    tried: Sequence[WhitenedHypothesis],
    most: int,
    rng: np.random.Generator,
    grown: Callable[[list[SelectedEffect]], list[SelectedEffect]] = lambda chosen: chosen,
) -> list[SelectedEffect]:
    """Choose up to ``most`` effects.

    Args:
        model: the base.
        tried: all hypotheses.
        most: effects at most.
        rng: of the sign flips.
        grown: what was chosen with more of the same at each place, after every step.
    """
    search = _SelectionStep(
        tuple(tried), _select_greedily(model, tried, most).residual, rng, compute_body_error_share(tried)
    )
    chosen: list[SelectedEffect] = []
    first: list[SelectedEffect] = []
    while len(chosen) < most:
        step = search.find_next_effect(add_selected_effects(model, chosen), chosen)
        if step is None:
            break
        chosen.append(step)
        if len(chosen) == 2:
            chosen = _search_pairs(model, tried, chosen)
        chosen = grown(search.exchange(model, chosen))
        first = first or list(chosen)
    # of two that half explain the same neither may hold beside the other: then the one that was found alone stands
    return _eliminate_backward(model, chosen) or _eliminate_backward(model, first)


def _select_greedily(model: WhitenedModel, tried: Sequence[WhitenedHypothesis], most: int) -> WhitenedModel:
    """The model with the best hypotheses that hold, whatever chance may say of them."""
    taken: set[tuple[str, str]] = set()
    for _ in range(most):
        scored = [
            s
            for s in score_hypotheses(model, [t for t in tried if t.hypothesis.name not in taken])
            if is_supported(model, s)
        ]
        if not scored:
            break
        best = select_simplest_law(model, scored)
        taken.add(best.whitened.hypothesis.name)
        model = model.with_law(best.whitened, best.shape)
    return model


def prune_joint_effects(
    model: WhitenedModel,
    laws: Sequence[WhitenedHypothesis],
    tried: Sequence[WhitenedHypothesis],
    rng: np.random.Generator,
) -> list[SelectedEffect]:
    """Effects that were found together, each beside the others, without those that the others can do without.

    Where the noise was taken from residuals of a poorer model it says nothing yet of what is needed: then all stay
    that chance does not find, in a search among all laws beside the whole sum.

    Args:
        model: the base.
        laws: what was found, of one shape each.
        tried: all that was looked among.
        rng: of the sign flips.
    """
    chosen = [SelectedEffect(score_hypotheses(model, [t])[0], 1.0) for t in laws]
    known = add_selected_effects(model, chosen).rss > thresholds.RESTING.noise_known * len(model.y)
    while True:
        beside = [add_selected_effects(model, [o for o in chosen if o is not c]) for c in chosen]
        chosen = [replace(c, scored=score_hypotheses(m, [c.whitened])[0]) for m, c in zip(beside, chosen, strict=True)]
        needed = [
            s.gain / m.residual_variance - compute_least_gain(m, s)
            for m, s in zip(beside, [c.scored for c in chosen], strict=True)
        ]
        if known and chosen and min(needed) < 0.0:
            del chosen[int(np.argmin(needed))]
            continue
        chosen = _compute_chances(model, chosen, tried, rng)
        weak = [k for k, c in enumerate(chosen) if c.p_value > thresholds.DETECTION.chance]
        if not weak:
            return sorted(_refit_together(model, chosen), key=lambda c: -c.scored.total)
        del chosen[min(weak, key=lambda k: chosen[k].scored.gain)]


def _refit_together(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> list[SelectedEffect]:
    """Each with its coefficients in the fit of the whole sum, which is what the error on unseen readings is of.

    Scored beside the others a direction that a neighbour nearly holds too counts as absorbed and comes out as nothing;
    the sum needs it at one of them. Laws with bounds keep the coefficients that respect these.
    """
    x, at, out = add_selected_effects(model, chosen).coefficients, model.count, []
    for c in chosen:
        p = len(c.scored.x)
        own = c.scored.x if c.whitened.hypothesis.lower else x[at : at + p]
        out.append(replace(c, scored=replace(c.scored, x=own)))
        at += p
    return out


def _compute_chances(
    model: WhitenedModel,
    chosen: Sequence[SelectedEffect],
    tried: Sequence[WhitenedHypothesis],
    rng: np.random.Generator,
) -> list[SelectedEffect]:
    """Each with the chance that the largest gain among all laws beside the whole sum reaches its own."""
    whole = add_selected_effects(model, chosen)
    chance = compute_chance_probability(
        whole, [*(c.scored for c in chosen), *fit_hypotheses(whole, tried)], whole.residual, rng
    )
    return [replace(c, p_value=float(p)) for c, p in zip(chosen, chance, strict=False)]


def add_selected_effects(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> WhitenedModel:
    """The model with the columns of what was chosen."""
    for c in chosen:
        model = model.with_law(c.whitened, c.scored.shape, held=True)
    return model


@dataclass(frozen=True)
class _SelectionStep:
    """What every step of the search shares."""

    whitened_hypotheses: tuple[WhitenedHypothesis, ...]
    residual: Array  # (M,) whitened, of a model with everything that may be there
    rng: np.random.Generator
    body_error_share: float  # see law_error

    def find_next_effect(self, model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> SelectedEffect | None:
        """The best further effect beside what was chosen; None where nothing holds."""
        taken = {c.whitened.hypothesis.name for c in chosen}
        scored = score_hypotheses(model, [t for t in self.whitened_hypotheses if t.hypothesis.name not in taken])
        chance = compute_chance_probability(model, scored, self.residual, self.rng)
        good = [
            k
            for k, s in enumerate(scored)
            if chance[k] <= thresholds.DETECTION.chance
            and s.gain > compute_law_error(s, chosen, self.body_error_share)
            and is_supported(model, s)
        ]
        if not good:
            return None
        best = select_simplest_law(model, [scored[k] for k in good])
        return SelectedEffect(best, float(chance[[s is best for s in scored].index(True)]))

    def exchange(self, model: WhitenedModel, chosen: list[SelectedEffect]) -> list[SelectedEffect]:
        """Each effect once more beside the others: another may take its place."""
        out = list(chosen)
        for k in range(len(out) if len(out) > 1 else 0):
            if not any(t is out[k].whitened for t in self.whitened_hypotheses):
                continue  # grown out of several, any of which would take its place
            others = out[:k] + out[k + 1 :]
            again = self.find_next_effect(add_selected_effects(model, others), others)
            if again is not None:
                out[k] = again
        return out


def compute_law_error(s: ScoredHypothesis, chosen: Sequence[SelectedEffect], of_body: float = 0.0) -> float:
    """Gain that the laws chosen so far may leave because they are not quite the true ones.

    Args:
        s: a further law.
        chosen: what stands beside it.
        of_body: share of the gain of what gives way under weight that its law leaves at least.
    """

    def share(c: SelectedEffect) -> float:
        h = c.whitened.hypothesis
        if h.is_exact:
            return thresholds.DETECTION.beside_exact
        if h.is_approximate or _is_neighbour(h, s.whitened.hypothesis):
            return thresholds.DETECTION.beside_here
        if h.family == SENSOR:
            return min(thresholds.DETECTION.beside, _compute_second_order_share(c))
        bends = h.family == BODY and not _is_behind_body(s.whitened.hypothesis, h)
        return max(thresholds.DETECTION.beside, of_body if bends else 0.0)

    return max((c.scored.gain * share(c) for c in chosen), default=0.0)


def _compute_second_order_share(c: SelectedEffect) -> float:
    """Share of its power that the column of a gain or of turned axes leaves: the square of its size; others: all.

    A load cell that reads 7 % too much is loud, and its law leaves 0.5 % of that, not what gears and bodies leave.
    """
    h, s = c.whitened.hypothesis, c.scored
    size = next(iter(h.quantities(s.x * c.whitened.unit[s.shape], c.whitened.shapes[s.shape]).values()))
    return float((size.value * RELATIVE_UNITS[size.unit]) ** 2) if size.unit in RELATIVE_UNITS else 1.0


def compute_body_error_share(tried: Sequence[WhitenedHypothesis]) -> float:
    """Share of the gain of a body that its law leaves at least, in the channel whose laws these are."""
    poses = any(t.hypothesis.effect == link_geometry.EFFECT.name for t in tried)
    return thresholds.DETECTION.beside_body if poses else 0.0


def _is_behind_body(a: EffectHypothesis, body: EffectHypothesis) -> bool:
    """Whether a law stands at a joint behind a body and the arm's first three, which turn with the body's weight."""
    place, of = parse_location(a.location), parse_location(body.location)
    return place.is_joint_location and min(place.numbers, default=0) > max(
        n + 1 for n in (JOINTS_BEFORE_WRIST - 1, *of.numbers)
    )


def _is_neighbour(a: EffectHypothesis, b: EffectHypothesis) -> bool:
    """Whether what one law leaves of its effect looks like the other: the same place, or the next body."""
    if a.location == b.location:
        return True
    bodies = {"base": 0, "tool": 6} | {format_link_location(i): i for i in range(1, 7)}
    both = [bodies.get(h.location) for h in (a, b)]
    return both[0] is not None and both[1] is not None and abs(both[0] - both[1]) <= 1


def select_simplest_law(model: WhitenedModel, scored: Sequence[ScoredHypothesis]) -> ScoredHypothesis:
    """The best on unseen groups, or a law with fewer coefficients that is hardly worse.

    A loud effect is itself most of what the model leaves: measured by that, a coefficient that is there for sure seems
    worth nothing. So none costs more than what excludes a rival, measured by what the best of the laws leaves.
    """
    left = model.rss - max(s.gain for s in scored)
    quiet = max(1.0, left / max(len(model.y) - model.count, 1))

    def worth(s: ScoredHypothesis) -> float:
        more, d = s.whitened.X.shape[2] - 1, thresholds.DETECTION
        own = s.whitened.hypothesis.penalty
        cost = min((own + d.simpler * more) * model.residual_variance, (own + d.as_good * more) * quiet)
        return float(s.total - cost)

    return max(scored, key=worth)


def _search_pairs(
    model: WhitenedModel, tried: Sequence[WhitenedHypothesis], chosen: list[SelectedEffect]
) -> list[SelectedEffect]:
    """All pairs among the leading hypotheses; taken where they beat what was found one by one."""
    scored = sorted(score_hypotheses(model, tried), key=lambda s: -s.total)
    leading: list[ScoredHypothesis] = []
    for s in scored:
        if s.whitened.hypothesis.name not in {o.whitened.hypothesis.name for o in leading}:
            leading.append(s)
        if len(leading) == PAIR_CANDIDATES:
            break
    best, pair = _compute_joint_gain(model, chosen), chosen
    for a, b in combinations(leading, 2):
        for one, two in ((a, b), (b, a)):
            m = model.with_law(one.whitened, one.shape)
            second = score_hypotheses(m, [two.whitened])[0]
            if one.total + second.total <= best + thresholds.DETECTION.pair_must_win * model.residual_variance:
                continue
            first = score_hypotheses(model.with_law(second.whitened, second.shape), [one.whitened])[0]
            both = [SelectedEffect(first, chosen[0].p_value), SelectedEffect(second, chosen[1].p_value)]
            if (
                is_supported(m, second)
                and _compute_joint_gain(model, both)
                > best + thresholds.DETECTION.pair_must_win * model.residual_variance
            ):
                best, pair = _compute_joint_gain(model, both), both
    return pair


def _compute_joint_gain(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> float:
    """Gain of several effects on unseen groups, one after the other."""
    total = 0.0
    for c in chosen:
        total += score_hypotheses(model, [c.whitened])[0].total
        model = model.with_law(c.whitened, c.scored.shape)
    return total


def _eliminate_backward(model: WhitenedModel, chosen: list[SelectedEffect]) -> list[SelectedEffect]:
    """Leave out what is not needed beside the others; the rest with their gains beside each other."""
    out = list(chosen)
    while True:
        again = []
        for k, c in enumerate(out):
            beside = add_selected_effects(model, out[:k] + out[k + 1 :])
            again.append((beside, score_hypotheses(beside, [c.whitened])[0]))
        weak = [k for k, (m, s) in enumerate(again) if not is_supported(m, s)] or find_insignificant_laws(
            add_selected_effects(model, out), [(c.whitened, c.scored.shape) for c in out]
        )
        if not weak:
            kept = [
                SelectedEffect(
                    replace(s, x=project_to_plausible_coefficients(m, s.whitened, s.shape, s.x)[0]), c.p_value
                )
                for c, (m, s) in zip(out, again, strict=True)
            ]
            return sorted(kept, key=lambda c: -c.scored.total)
        worst = min(weak, key=lambda k: again[k][1].total)
        out = out[:worst] + out[worst + 1 :]
