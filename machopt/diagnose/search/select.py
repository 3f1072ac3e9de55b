"""Which effects together: forward by the gain on unseen groups, each step judged against the whole search by chance.

After every step what was chosen before may be exchanged or dropped, and pairs among the leading hypotheses are tried
exhaustively, because one effect can stand in for two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, Tried
from machopt.diagnose.nouns.problem import Hypothesis
from machopt.diagnose.search.anotherday import comes_again
from machopt.diagnose.search.screen import Scored, by_chance, fitted, score
from machopt.diagnose.search.unproven import possible, unproven
from machopt.domain.location import link_at, located
from machopt.effects import geometry, registry

PAIRS_AMONG = 6
BODY = "body"  # family of what gives way
SENSOR = "sensor"  # of what is wrong in the record
SMALL = {"%": 0.01, "deg": np.pi / 180.0}  # relative size of a gain, of an angle
ARM = 3  # joints before the wrist


@dataclass(frozen=True)
class Chosen:
    """One effect in the final model."""

    scored: Scored  # beside the others
    p_value: float

    @property
    def tried(self) -> Tried:
        return self.scored.tried

    @property
    def columns(self) -> Array:
        return self.scored.tried.at(self.scored.shape)


def least_gain(model: Model, s: Scored) -> float:
    """Gain that a hypothesis has to reach, per unit of the residual's variance."""
    h = s.tried.hypothesis
    p = s.tried.X.shape[2]
    least: float = calibrated.DETECTION.gain + calibrated.DETECTION.per_coefficient * (p - 1) + h.penalty
    return max(least, calibrated.DETECTION.share * len(model.y))


def holds(model: Model, s: Scored) -> bool:
    """Whether a hypothesis is large enough, on readings that did not choose it, not in one group or session alone."""
    return stands(model, s) and comes_again(model, s)


def stands(model: Model, s: Scored) -> bool:
    """The same, whatever the sessions say of each other."""
    if s.gain / model.spread < least_gain(model, s) or not _plausible(s):
        return False
    return (
        s.total > calibrated.DETECTION.generalises * s.gain
        and possible(model, s.tried, s.shape, s.x)[1] <= (1.0 - calibrated.DETECTION.possible) * s.gain
        and _not_alone(model, s)
        and not unproven(model.with_law(s.tried, s.shape), [(s.tried, s.shape)])
    )


def _not_alone(model: Model, s: Scored) -> bool:
    """Whether a law does not hang on one group: the others bear their share, or would be enough by themselves."""
    others = s.total - float(s.heldout.max())
    return others > calibrated.DETECTION.without_best * s.total or others / model.spread >= least_gain(model, s)


def _plausible(s: Scored) -> bool:
    h = s.tried.hypothesis
    size = next(iter(h.quantities(s.x * s.tried.unit[s.shape], s.tried.shapes[s.shape]).values()))
    known = registry.known(h.effect)
    return known is None or abs(size.value) <= known.plausible.get(size.unit, np.inf)


def select(
    model: Model,
    tried: Sequence[Tried],
    most: int,
    rng: np.random.Generator,
    grown: Callable[[list[Chosen]], list[Chosen]] = lambda chosen: chosen,
) -> list[Chosen]:
    """Choose up to ``most`` effects.

    Args:
        model: the base.
        tried: all hypotheses.
        most: effects at most.
        rng: of the sign flips.
        grown: what was chosen with more of the same at each place, after every step.
    """
    search = _Search(tuple(tried), _greedy(model, tried, most).residual, rng, of_body(tried))
    chosen: list[Chosen] = []
    first: list[Chosen] = []
    while len(chosen) < most:
        step = search.step(with_chosen(model, chosen), chosen)
        if step is None:
            break
        chosen.append(step)
        if len(chosen) == 2:
            chosen = _pairs(model, tried, chosen)
        chosen = grown(search.exchange(model, chosen))
        first = first or list(chosen)
    # of two that half explain the same neither may hold beside the other: then the one that was found alone stands
    return _backward(model, chosen) or _backward(model, first)


def _greedy(model: Model, tried: Sequence[Tried], most: int) -> Model:
    """The model with the best hypotheses that hold, whatever chance may say of them."""
    taken: set[tuple[str, str]] = set()
    for _ in range(most):
        scored = [s for s in score(model, [t for t in tried if t.hypothesis.name not in taken]) if holds(model, s)]
        if not scored:
            break
        best = simplest(model, scored)
        taken.add(best.tried.hypothesis.name)
        model = model.with_law(best.tried, best.shape)
    return model


def settled(model: Model, laws: Sequence[Tried], tried: Sequence[Tried], rng: np.random.Generator) -> list[Chosen]:
    """Effects that were found together, each beside the others, without those that the others can do without.

    Where the noise was taken from residuals of a poorer model it says nothing yet of what is needed: then all stay
    that chance does not find, in a search among all laws beside the whole sum.

    Args:
        model: the base.
        laws: what was found, of one shape each.
        tried: all that was looked among.
        rng: of the sign flips.
    """
    chosen = [Chosen(score(model, [t])[0], 1.0) for t in laws]
    known = with_chosen(model, chosen).rss > calibrated.RESTING.noise_known * len(model.y)
    while True:
        beside = [with_chosen(model, [o for o in chosen if o is not c]) for c in chosen]
        chosen = [replace(c, scored=score(m, [c.tried])[0]) for m, c in zip(beside, chosen, strict=True)]
        needed = [s.gain / m.spread - least_gain(m, s) for m, s in zip(beside, [c.scored for c in chosen], strict=True)]
        if known and chosen and min(needed) < 0.0:
            del chosen[int(np.argmin(needed))]
            continue
        chosen = _judged(model, chosen, tried, rng)
        weak = [k for k, c in enumerate(chosen) if c.p_value > calibrated.DETECTION.chance]
        if not weak:
            return sorted(_of_the_sum(model, chosen), key=lambda c: -c.scored.total)
        del chosen[min(weak, key=lambda k: chosen[k].scored.gain)]


def _of_the_sum(model: Model, chosen: Sequence[Chosen]) -> list[Chosen]:
    """Each with its coefficients in the fit of the whole sum, which is what the error on unseen readings is of.

    Scored beside the others a direction that a neighbour nearly holds too counts as absorbed and comes out as nothing;
    the sum needs it at one of them. Laws with bounds keep the coefficients that respect these.
    """
    x, at, out = with_chosen(model, chosen).coefficients, model.count, []
    for c in chosen:
        p = len(c.scored.x)
        own = c.scored.x if c.tried.hypothesis.lower else x[at : at + p]
        out.append(replace(c, scored=replace(c.scored, x=own)))
        at += p
    return out


def _judged(model: Model, chosen: Sequence[Chosen], tried: Sequence[Tried], rng: np.random.Generator) -> list[Chosen]:
    """Each with the chance that the largest gain among all laws beside the whole sum reaches its own."""
    whole = with_chosen(model, chosen)
    chance = by_chance(whole, [*(c.scored for c in chosen), *fitted(whole, tried)], whole.residual, rng)
    return [replace(c, p_value=float(p)) for c, p in zip(chosen, chance, strict=False)]


def with_chosen(model: Model, chosen: Sequence[Chosen]) -> Model:
    """The model with the columns of what was chosen."""
    for c in chosen:
        model = model.with_law(c.tried, c.scored.shape, held=True)
    return model


@dataclass(frozen=True)
class _Search:
    """What every step of the search shares."""

    tried: tuple[Tried, ...]
    residual: Array  # (M,) whitened, of a model with everything that may be there
    rng: np.random.Generator
    of_body: float  # see law_error

    def step(self, model: Model, chosen: Sequence[Chosen]) -> Chosen | None:
        """The best further effect beside what was chosen; None where nothing holds."""
        taken = {c.tried.hypothesis.name for c in chosen}
        scored = score(model, [t for t in self.tried if t.hypothesis.name not in taken])
        chance = by_chance(model, scored, self.residual, self.rng)
        good = [
            k
            for k, s in enumerate(scored)
            if chance[k] <= calibrated.DETECTION.chance
            and s.gain > law_error(s, chosen, self.of_body)
            and holds(model, s)
        ]
        if not good:
            return None
        best = simplest(model, [scored[k] for k in good])
        return Chosen(best, float(chance[[s is best for s in scored].index(True)]))

    def exchange(self, model: Model, chosen: list[Chosen]) -> list[Chosen]:
        """Each effect once more beside the others: another may take its place."""
        out = list(chosen)
        for k in range(len(out) if len(out) > 1 else 0):
            if not any(t is out[k].tried for t in self.tried):
                continue  # grown out of several, any of which would take its place
            others = out[:k] + out[k + 1 :]
            again = self.step(with_chosen(model, others), others)
            if again is not None:
                out[k] = again
        return out


def law_error(s: Scored, chosen: Sequence[Chosen], of_body: float = 0.0) -> float:
    """Gain that the laws chosen so far may leave because they are not quite the true ones.

    Args:
        s: a further law.
        chosen: what stands beside it.
        of_body: share of the gain of what gives way under weight that its law leaves at least.
    """

    def share(c: Chosen) -> float:
        h = c.tried.hypothesis
        if h.exact:
            return calibrated.DETECTION.beside_exact
        if h.rough or _near(h, s.tried.hypothesis):
            return calibrated.DETECTION.beside_here
        if h.family == SENSOR:
            return min(calibrated.DETECTION.beside, _second_order(c))
        bends = h.family == BODY and not _behind(s.tried.hypothesis, h)
        return max(calibrated.DETECTION.beside, of_body if bends else 0.0)

    return max((c.scored.gain * share(c) for c in chosen), default=0.0)


def _second_order(c: Chosen) -> float:
    """Share of its power that the column of a gain or of turned axes leaves: the square of its size; others: all.

    A load cell that reads 7 % too much is loud, and its law leaves 0.5 % of that, not what gears and bodies leave.
    """
    h, s = c.tried.hypothesis, c.scored
    size = next(iter(h.quantities(s.x * c.tried.unit[s.shape], c.tried.shapes[s.shape]).values()))
    return float((size.value * SMALL[size.unit]) ** 2) if size.unit in SMALL else 1.0


def of_body(tried: Sequence[Tried]) -> float:
    """Share of the gain of a body that its law leaves at least, in the channel whose laws these are."""
    poses = any(t.hypothesis.effect == geometry.EFFECT.name for t in tried)
    return calibrated.DETECTION.beside_body if poses else 0.0


def _behind(a: Hypothesis, body: Hypothesis) -> bool:
    """Whether a law stands at a joint behind a body and the arm's first three, which turn with the body's weight."""
    place, of = located(a.location), located(body.location)
    return place.of_joints and min(place.numbers, default=0) > max(n + 1 for n in (ARM - 1, *of.numbers))


def _near(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether what one law leaves of its effect looks like the other: the same place, or the next body."""
    if a.location == b.location:
        return True
    bodies = {"base": 0, "tool": 6} | {link_at(i): i for i in range(1, 7)}
    both = [bodies.get(h.location) for h in (a, b)]
    return both[0] is not None and both[1] is not None and abs(both[0] - both[1]) <= 1


def simplest(model: Model, scored: Sequence[Scored]) -> Scored:
    """The best on unseen groups, or a law with fewer coefficients that is hardly worse.

    A loud effect is itself most of what the model leaves: measured by that, a coefficient that is there for sure seems
    worth nothing. So none costs more than what excludes a rival, measured by what the best of the laws leaves.
    """
    left = model.rss - max(s.gain for s in scored)
    quiet = max(1.0, left / max(len(model.y) - model.count, 1))

    def worth(s: Scored) -> float:
        more, d = s.tried.X.shape[2] - 1, calibrated.DETECTION
        own = s.tried.hypothesis.penalty
        cost = min((own + d.simpler * more) * model.spread, (own + d.as_good * more) * quiet)
        return float(s.total - cost)

    return max(scored, key=worth)


def _pairs(model: Model, tried: Sequence[Tried], chosen: list[Chosen]) -> list[Chosen]:
    """All pairs among the leading hypotheses; taken where they beat what was found one by one."""
    scored = sorted(score(model, tried), key=lambda s: -s.total)
    leading: list[Scored] = []
    for s in scored:
        if s.tried.hypothesis.name not in {o.tried.hypothesis.name for o in leading}:
            leading.append(s)
        if len(leading) == PAIRS_AMONG:
            break
    best, pair = _together(model, chosen), chosen
    for a, b in combinations(leading, 2):
        for one, two in ((a, b), (b, a)):
            m = model.with_law(one.tried, one.shape)
            second = score(m, [two.tried])[0]
            if one.total + second.total <= best + calibrated.DETECTION.pair_must_win * model.spread:
                continue
            first = score(model.with_law(second.tried, second.shape), [one.tried])[0]
            both = [Chosen(first, chosen[0].p_value), Chosen(second, chosen[1].p_value)]
            if holds(m, second) and _together(model, both) > best + calibrated.DETECTION.pair_must_win * model.spread:
                best, pair = _together(model, both), both
    return pair


def _together(model: Model, chosen: Sequence[Chosen]) -> float:
    """Gain of several effects on unseen groups, one after the other."""
    total = 0.0
    for c in chosen:
        total += score(model, [c.tried])[0].total
        model = model.with_law(c.tried, c.scored.shape)
    return total


def _backward(model: Model, chosen: list[Chosen]) -> list[Chosen]:
    """Leave out what is not needed beside the others; the rest with their gains beside each other."""
    out = list(chosen)
    while True:
        again = []
        for k, c in enumerate(out):
            beside = with_chosen(model, out[:k] + out[k + 1 :])
            again.append((beside, score(beside, [c.tried])[0]))
        weak = [k for k, (m, s) in enumerate(again) if not holds(m, s)] or unproven(
            with_chosen(model, out), [(c.tried, c.scored.shape) for c in out]
        )
        if not weak:
            kept = [
                Chosen(replace(s, x=possible(m, s.tried, s.shape, s.x)[0]), c.p_value)
                for c, (m, s) in zip(out, again, strict=True)
            ]
            return sorted(kept, key=lambda c: -c.scored.total)
        worst = min(weak, key=lambda k: again[k][1].total)
        out = out[:worst] + out[worst + 1 :]
