"""The steps of a diagnosis in order, the same for every channel.

::

    base, robust ─► noise from twins ─► whiten ─► search ─► once more about what was found ─► findings, limits, proof
                         ▲                                        │
                         └────────── outliers, noise, known physics again ──────────┘
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence import heldout, instruments
from machopt.diagnose.evidence.grams import sandwich
from machopt.diagnose.evidence.heldout import Fitted
from machopt.diagnose.nouns.problem import Catalogue, Problem
from machopt.diagnose.nouns.result import Coefficient, Diagnosis, Errors, Finding, Limit, Share, Verdict
from machopt.diagnose.search import balanced, further, limiting, limits, mismatch, outweighed, unnamed
from machopt.diagnose.search.findings import estimates, rivals
from machopt.diagnose.search.known import Known, geometric_finding
from machopt.diagnose.search.proof import prove
from machopt.diagnose.search.rounds import Rebuild, in_rounds
from machopt.diagnose.search.screen import score
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.diagnose.search.state import State
from machopt.diagnose.verdict import refitted, words


@dataclass(frozen=True)
class Options:
    """How a diagnosis is made."""

    most: int = 3  # effects
    predicted: str = ""  # the channel in words
    progress: Callable[[str], None] = lambda _: None


def diagnose(
    problem: Problem, catalogue: Catalogue, options: Options, rng: np.random.Generator, rebuild: Rebuild | None = None
) -> Diagnosis:
    """Find what a model leaves out of a recording.

    Args:
        problem: what was measured, and what is refitted in any case.
        catalogue: what may explain the rest.
        options: how many effects at most.
        rng: of sign flips, folds and directions.
        rebuild: problem and catalogue once more about base coefficients (P,) SI that were found, without unknowns of
            these numbers that no such thing can have, and about the corrections without load that were found (which
            makes the rounds of the search Gauss-Newton steps); None: they stand.
    """
    seed = int(rng.integers(2**31))
    # not kept here: most of the memory is the columns of all laws, which the proof does without
    return _assembled(
        outweighed.withheld(
            limiting.named(
                balanced.named(in_rounds(problem, catalogue, options.most, seed, rebuild, options.progress))
            ),
            np.random.default_rng([seed, 4]),
        ),
        options,
        np.random.default_rng([seed, 1]),
    )


@dataclass(frozen=True, kw_only=True)
class _Held:
    """What was found, held against readings that no fit saw; residuals (N, D) in SI."""

    findings: tuple[Finding, ...]  # with K_C, where the recording shows it
    withdrawn: tuple[Finding, ...]  # they predict what no fit saw no better
    known: Known | None
    nameless: tuple[Chosen, ...]  # chosen, and no effect has the form
    before: Array  # of unseen readings, without findings
    after: Array  # with them
    final: Fitted  # with what stayed
    there: mismatch.Repeatable  # of ``before``
    rest: mismatch.Repeatable  # of ``after``
    power: float  # of ``there``, at least zero
    real: bool  # there is something that comes back, and it matters

    @property
    def explained(self) -> float:
        """The share of what comes back that the findings take."""
        if self.withdrawn or not self.power > 0:
            return 0.0
        return float(np.clip(1.0 - max(self.rest.power, 0.0) / self.power, 0.0, 1.0))


@dataclass(frozen=True)
class _Judged:
    """The verdict, and what made it less than it would be."""

    verdict: Verdict
    left: instruments.Beyond | None  # beyond what the instruments may make
    another_day: tuple[tuple[str, str], ...]  # what only one day's readings say


def _assembled(state: State, options: Options, rng: np.random.Generator) -> Diagnosis:
    """What a finished search leads to; its columns of all laws, most of the memory, are let go before the proof."""
    options.progress("rivals and intervals")
    held = _held(state, rng)
    judged = _judged(state, held, rng)
    shares = _places(state, held, judged.verdict)
    options.progress("detection limits")
    kept = held.nameless if held.withdrawn else state.chosen
    seen = _limits(state, kept, rng)
    coefficients, shapes = tuple(_coefficients(state, kept)), sum(len(t.shapes) for t in state.tried)
    state = replace(state, tried=())
    options.progress("proof on readings that no step saw")
    proof = prove(state, options.most, rng) if held.findings or held.withdrawn else None
    result = _result(state, held, judged, options.predicted)
    result = replace(
        result,
        mismatch=tuple(shares),
        limits=tuple(seen),
        coefficients=coefficients,
        tried=shapes,
        proof=proof,
    )
    more = refitted.said(coefficients)
    result = replace(result, notes=(*result.notes, *more))
    return replace(result, sentence=words.sentence(result), next_experiment=words.next_experiment(result))


def _result(state: State, held: _Held, judged: _Judged, predicted: str) -> Diagnosis:
    """Findings, verdict and the sizes of what is left; places, limits and proof are yet to come."""
    problem, used, before, after = state.problem, state.used, held.before, held.after
    factor = problem.families[0].factor
    by_group, groups = heldout.by_group(problem, (before, after), used)
    return Diagnosis(
        channel=problem.channel,
        predicted=predicted,
        verdict=judged.verdict,
        sentence="",
        unit=problem.families[0].unit,
        heldout_before=heldout.rmse(problem, before, used),
        noise_floor=heldout.floor(problem, state.noise, used),
        repeatable=factor * float(np.sqrt(held.power)),
        mismatch_p=held.there.p_value,
        heldout_after=heldout.rmse(problem, after, used),
        explained=held.explained,
        repeatable_after=factor * float(np.sqrt(max(held.rest.power, 0.0))),
        findings=held.findings,
        mismatch=(),
        limits=(),
        untestable=state.catalogue.untestable,
        coefficients=(),
        errors=Errors(problem.blanked(before), problem.blanked(after), by_group, groups),
        proof=None,
        used=used,
        outliers=problem.row[~used],
        axes=state.catalogue.axes,
        notes=tuple(words.withdrawn(held.withdrawn))
        + words.noise_note(state.noise)
        + heldout.said(problem, before, after, state.noise, used)
        + (() if judged.left is None else (judged.left.words,))
        + words.one_day(judged.another_day)
        + unnamed.said([c.tried.hypothesis for c in held.nameless]),
    )


def _held(state: State, rng: np.random.Generator) -> _Held:
    """Findings that predict what no fit saw, those that do not, and how much of the misfit comes back."""
    problem, used = state.problem, state.used
    named = [k for k, c in enumerate(state.chosen) if c.tried.hypothesis.named]
    nameless = tuple(c for c in state.chosen if not c.tried.hypothesis.named)
    plain, final = state.fitted(()), state.fitted([state.chosen[k] for k in named])
    before, after = plain.heldout(), final.heldout()
    known = geometric_finding(state)
    if known is not None:  # K_C was counted from the start: without it the mismatch would have been larger
        before = known.residual_without
    there = mismatch.repeatable(problem, before, used, state.noise, rng, plain.own_error())
    rest = mismatch.repeatable(problem, after, used, state.noise, rng, final.own_error())
    power = max(there.power, 0.0)
    real = _matters(state, there, power)
    findings, withdrawn = [_finding(state, k) for k in named], list[Finding]()
    beside = (before, after)
    if nameless:
        beside = (state.fitted(nameless).heldout(), state.fitted(state.chosen).heldout())
    if findings and real and not heldout.better(problem, *beside, used):
        findings, withdrawn = [], findings
        after, final, rest = before, plain, there
    if known is not None:
        findings.append(known.finding)
    return _Held(
        findings=tuple(findings),
        withdrawn=tuple(withdrawn),
        known=known,
        nameless=nameless,
        before=before,
        after=after,
        final=final,
        there=there,
        rest=rest,
        power=power,
        real=real,
    )


def _matters(state: State, there: mismatch.Repeatable, power: float) -> bool:
    """Whether what comes back is surely there, and large enough beside the noise."""
    sure = (
        np.isnan(there.p_value)
        or there.p_value <= calibrated.PROOF.certain
        or state.base.spread > 1.0 + further.restless(state.base)
    )
    return bool(sure and np.sqrt(power) > calibrated.PROOF.matters * state.noise.together(0))


def _judged(state: State, held: _Held, rng: np.random.Generator) -> _Judged:
    problem, used, noise = state.problem, state.used, state.noise
    verdict: Verdict
    if held.findings:
        verdict = "explained" if _nothing_left(state, held.rest, held.after) else "partly_explained"
    else:
        verdict = "unexplained" if held.real or held.withdrawn else "consistent"
    if mismatch.comes_back_beside(problem, held.after, used, noise, rng, held.final.own_error()):
        verdict = instruments.less(verdict)
    few = len(np.unique(problem.group)) < calibrated.PROOF.fewest_groups  # predicting one from the rest goes too far
    left = instruments.beyond(problem, held.final.residual if few else held.after, noise, used)
    if left is not None:
        verdict = left.verdict(verdict)
    other_day = outweighed.contradicted(state)
    apart = () if other_day is None else (other_day.tried.hypothesis.name,)
    if apart or held.nameless:
        verdict = instruments.less(verdict)
    return _Judged(verdict, left, apart)


def _places(state: State, held: _Held, verdict: Verdict) -> list[Share]:
    """Where the misfit is: what was found, other places in the machine, then what of the recording it goes with."""
    problem, used = state.problem, state.used
    machine: list[Share] = []
    data: list[Share] = []
    if verdict != "consistent":
        beyond = max(state.base.rss - len(state.base.y) + state.base.count, 1.0)
        machine = mismatch.in_the_machine(score(state.base, state.tried), beyond)
        data = mismatch.in_the_data(problem, held.before, used, state.noise, state.catalogue.axes)
    if held.there.lasting and held.real:
        lasts = Share("environment", 1.0, "what one visit shows, the next one shows too, at another pose: it lasts")
        machine = [lasts, *(s for s in machine if s.axis != "environment")]
    shares = _shares(state, held.findings, machine)
    if held.known is not None:
        shares = held.known.among(shares, heldout.floor(problem, state.noise, used))
    return shares + data[:3]


def _nothing_left(state: State, rest: mismatch.Repeatable, after: Array) -> bool:
    """Whether findings leave no repeatable part, or no more than noise may make."""
    noise_floor = heldout.floor(state.problem, state.noise, state.used)
    if heldout.rmse(state.problem, after, state.used) <= calibrated.PROOF.as_noise * noise_floor:
        return True
    return rest.p_value > calibrated.PROOF.certain  # nothing was repeated: not a number, and not known


def _limits(state: State, chosen: Sequence[Chosen], rng: np.random.Generator) -> list[Limit]:
    """Limits beside what was found; of what was found, beside the rest of it."""
    found = {c.tried.hypothesis.name for c in chosen}
    rest = {t.hypothesis.name for t in state.named} - found
    others = [t for t in state.named if t.hypothesis.name in rest]
    out = limits.limits(with_chosen(state.base, chosen), others, rng, rest)
    for c in chosen:
        beside = with_chosen(state.base, [o for o in chosen if o is not c])
        out += limits.limits(beside, state.named, rng, {c.tried.hypothesis.name})
    return out


def _finding(state: State, k: int) -> Finding:
    c = state.chosen[k]
    h, shape = c.tried.hypothesis, c.tried.shapes[c.scored.shape]
    x = c.scored.x * c.tried.unit[c.scored.shape]
    without = state.fitted([o for i, o in enumerate(state.chosen) if i != k]).heldout()
    full = state.fitted(state.chosen)
    others, names = rivals(state.base, state.chosen, k, state.named)
    names = [*names, *(u.name for u in state.catalogue.untestable if u.same_as in names)]
    curve = None if h.curve is None else h.curve(x, shape)
    left = None if curve is None else _along(full.residual, h.columns(shape), x, curve.per_reading)
    return Finding(
        effect=h.effect,
        location=h.location,
        law=h.law,
        equation=h.equation,
        note=h.note,
        one_of=tuple(names),
        parameters=estimates(state.base, state.chosen, k, state.named),
        before=heldout.rmse(state.problem, without, state.used),
        after=heldout.rmse(state.problem, full.heldout(), state.used),
        p_value=c.p_value,
        rivals=tuple(others),
        correction=h.correction(x, shape),
        curve=curve,
        curve_residual=left,
        record=h.family == "sensor",
    )


def _along(residual: Array, columns: Array, x: Array, law: Array) -> Array:
    """(N,) residual along what the law does to each reading, in the law's own unit."""
    moved = columns @ x  # (N, D)
    power = np.einsum("nd,nd->n", moved, moved)
    share = np.einsum("nd,nd->n", moved, residual) / np.maximum(power, 1e-300)
    return np.where(power > 1e-4 * np.quantile(power, 0.9), share * law, np.nan)


def _shares(state: State, findings: Sequence[Finding], machine: list[Share]) -> list[Share]:
    """What was found first, by what it explains; then the other places that explain some of it alone."""
    total = {c.tried.hypothesis.location: max(c.scored.total, 0.0) for c in state.chosen}
    whole = sum(total.values())
    beyond = max(state.base.rss - len(state.base.y) + state.base.count, whole, 1e-9)
    out = [Share(f.location, float(np.clip(total.get(f.location, 0.0) / beyond, 0.0, 1.0)), f.note) for f in findings]
    for h in (c.tried.hypothesis for c in state.chosen if not c.tried.hypothesis.named):
        out.append(Share(h.location, float(np.clip(total[h.location] / beyond, 0.0, 1.0)), h.note))
    named = {s.axis for s in out}
    return out + [s for s in machine if s.axis not in named][:6]


def _coefficients(state: State, chosen: Sequence[Chosen]) -> list[Coefficient]:
    _, covariance, _ = sandwich(with_chosen(state.base, chosen))
    P = len(state.unit)
    m, X = state.base, state.base.X
    held = m.Xy.sum(axis=0)  # beside the effects as they are said, which bounds may have moved
    for c in chosen:
        held = held - X.T @ (c.columns @ c.scored.x)
    x = m.inverse @ held
    before = state.base.coefficients * state.unit
    sigma = np.sqrt(np.maximum(np.diag(covariance)[:P], 0.0)) * state.unit
    return [
        Coefficient(u, float(b), float(v), float(s))
        for u, b, v, s in zip(state.problem.unknowns, before, x[:P] * state.unit, sigma, strict=True)
    ]
