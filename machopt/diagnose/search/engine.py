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
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence import aside, heldout, instruments, noise
from machopt.diagnose.evidence.grams import base_model, sandwich, tried
from machopt.diagnose.evidence.whitening import whitening
from machopt.diagnose.nouns.problem import Catalogue, Problem
from machopt.diagnose.nouns.result import Coefficient, Diagnosis, Errors, Finding, Limit, Share, Verdict
from machopt.diagnose.search import further, limiting, limits, mismatch, outweighed, unnamed
from machopt.diagnose.search.findings import estimates, rivals
from machopt.diagnose.search.finer import settled
from machopt.diagnose.search.known import geometric_finding
from machopt.diagnose.search.proof import prove
from machopt.diagnose.search.screen import score
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.diagnose.search.state import State
from machopt.diagnose.search.together import searched
from machopt.diagnose.verdict import words
from machopt.domain.kinematics import KinematicCorrection

Flags = NDArray[np.bool_]
ROUNDS = 3
MENDED = 2  # further ones, while the base is fitted to what nothing built has
CLIPS = 4

Unloaded = tuple[KinematicCorrection, ...]  # what was found that needs no load
Rebuild = Callable[[Array, frozenset[int], Unloaded], tuple[Problem, Catalogue]]


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
    return _assemble(
        outweighed.withheld(
            limiting.named(_search(problem, catalogue, options, seed, rebuild)), np.random.default_rng([seed, 4])
        ),
        options,
        np.random.default_rng([seed, 1]),
    )


def _search(problem: Problem, catalogue: Catalogue, options: Options, seed: int, rebuild: Rebuild | None) -> State:
    """Search, and search again with noise, outliers and known physics about what was found."""
    residual, used = _robust(problem)
    before: list[tuple[str, str, str]] | None = None
    number = 0
    while True:
        number += 1
        options.progress(f"search, round {number}")
        state = _round(problem, catalogue, options, seed, residual, used)
        fitted = state.fitted(state.chosen)
        residual = fitted.residual
        again = aside.good(problem, residual) & _allowed(problem)
        same = before == _names(state.chosen) and np.array_equal(again, used)
        x = fitted.x[: problem.base.shape[2]]
        doubted = _doubted(problem, x, state.chosen)
        settles = (rebuild is None or not doubted) and (same or number >= ROUNDS)
        if settles or number == ROUNDS + MENDED:
            return settled(state)
        used, before, found = again, _names(state.chosen), _unloaded(state.chosen)
        del state, fitted  # the columns of all laws are most of the memory
        if rebuild is not None:
            problem, catalogue = rebuild(x, doubted, found)


def _round(problem: Problem, catalogue: Catalogue, options: Options, seed: int, residual: Array, used: Flags) -> State:
    """One search, by the noise that the residuals (N, D) of the last fit show."""
    found = noise.estimate(problem, residual, used)
    w = whitening(problem, found, used)
    base, unit = base_model(problem, w, np.random.default_rng([seed, 2]))
    fits = 1.0 if found.replicated else np.nan
    laws = tried(base, catalogue.hypotheses)
    each, chosen = searched(base, laws, options.most, np.random.default_rng([seed, 3]), fits)
    each, chosen = further.searched(base, catalogue, (each, chosen), options.most, seed, fits)
    return State(
        problem=problem,
        catalogue=catalogue,
        used=used,
        noise=found,
        w=w,
        base=base,
        unit=unit,
        tried=each,
        chosen=chosen,
    )


def _unloaded(chosen: Sequence[Chosen]) -> Unloaded:
    """Corrections without load among what was chosen, where it is not a crowd.

    Of a crowd of waves and frames each leans on the others, and the next round about all of them found fewer: on a
    public UR10 (series D, benchmarks/real/poses.py) unseen poses were then predicted worse, 0.107 mm for 0.087.
    """
    if len(chosen) > calibrated.RESTING.crowded:
        return ()
    named = [c for c in chosen if c.tried.hypothesis.named]
    each = [
        c.tried.hypothesis.correction(
            c.scored.x * c.tried.unit[c.scored.shape], c.tried.hypothesis.shapes[c.scored.shape]
        )
        for c in named
    ]
    return tuple(c for c in each if isinstance(c, KinematicCorrection))


def _doubted(problem: Problem, x: Array, chosen: Sequence[Chosen]) -> frozenset[int]:
    """Base unknowns, by number, fitted to what nothing built has for the sake of what was found without load.

    Where nothing such was found the cell may well be wrong by any factor, and the misfit is the unknown's alone.
    """
    if not any(c.tried.hypothesis.family == "kinematic" for c in chosen):
        return frozenset()
    return frozenset(n for n, u in enumerate(problem.unknowns) if not u.possible(float(x[n])))


def _names(chosen: Sequence[Chosen]) -> list[tuple[str, str, str]]:
    return [(*c.tried.hypothesis.name, c.tried.hypothesis.law) for c in chosen]


def _allowed(problem: Problem) -> Flags:
    return np.ones(len(problem), bool) if problem.excluded is None else ~problem.excluded


def _robust(problem: Problem) -> tuple[Array, Flags]:
    """Residuals (N, D) of the base by least squares with gross errors put aside, and which readings remain."""
    used = _allowed(problem)
    scale = np.ones(problem.dimensions)
    for family in problem.families:
        columns = list(family.columns)
        scale[columns] = 1.0 / max(noise.robust_sigma(problem.y[used & problem.measured(family)][:, columns]), 1e-12)
    prior = np.array([0.0 if u.prior is None else 1.0 / u.prior for u in problem.unknowns])
    residual = problem.y
    for _ in range(CLIPS):
        A = (problem.base[used] * scale[:, None]).reshape(problem.y[used].size, problem.base.shape[2])
        size = np.sqrt(np.mean(A**2, axis=0))
        size = np.where(size > 0, size, 1.0)
        held = np.diag(prior / size)
        b = np.concatenate([(problem.y[used] * scale).reshape(-1), np.zeros(len(prior))])
        x = np.linalg.lstsq(np.concatenate([A / size, held]), b, rcond=1e-10)[0] / size
        residual = problem.y - problem.base @ x
        good = aside.good(problem, residual) & _allowed(problem)
        if np.array_equal(good, used):
            break
        used = good
    return residual, used


def _assemble(state: State, options: Options, rng: np.random.Generator) -> Diagnosis:
    options.progress("rivals and intervals")
    problem, used, floor_noise = state.problem, state.used, state.noise
    named = [k for k, c in enumerate(state.chosen) if c.tried.hypothesis.named]
    nameless = [c for c in state.chosen if not c.tried.hypothesis.named]
    plain, final = state.fitted(()), state.fitted([state.chosen[k] for k in named])
    before, after = plain.heldout(), final.heldout()
    known = geometric_finding(state)
    if known is not None:  # K_C was counted from the start: without it the mismatch would have been larger
        before = known.residual_without
    there = mismatch.repeatable(problem, before, used, floor_noise, rng, plain.own_error())
    rest = mismatch.repeatable(problem, after, used, floor_noise, rng, final.own_error())
    unit_noise = floor_noise.together(0)
    power = max(there.power, 0.0)
    explained = float(np.clip(1.0 - max(rest.power, 0.0) / power, 0.0, 1.0)) if power > 0 else 0.0
    sure = (
        np.isnan(there.p_value)
        or there.p_value <= calibrated.PROOF.certain
        or state.base.spread > 1.0 + further.restless(state.base)
    )
    real = bool(sure and np.sqrt(power) > calibrated.PROOF.matters * unit_noise)
    findings = [_finding(state, k) for k in named]
    withdrawn: list[Finding] = []
    both = (before, after)
    if nameless:  # beside what has no name
        both = (state.fitted(nameless).heldout(), state.fitted(state.chosen).heldout())
    if findings and real and not heldout.better(problem, *both, used):
        findings, withdrawn = [], findings
        after, final, explained = before, plain, 0.0
        rest = there
    if known is not None:
        findings.append(known.finding)
    verdict: Verdict
    if findings:
        verdict = "explained" if _nothing_left(state, rest, after) else "partly_explained"
    else:
        verdict = "unexplained" if real or withdrawn else "consistent"
    if mismatch.comes_back_beside(problem, after, used, floor_noise, rng, final.own_error()):
        verdict = instruments.less(verdict)
    few = len(np.unique(problem.group)) < calibrated.PROOF.fewest_groups  # predicting one from the rest goes too far
    left = instruments.beyond(problem, final.residual if few else after, floor_noise, used)
    if left is not None:
        verdict = left.verdict(verdict)
    other_day = outweighed.contradicted(state)
    apart = () if other_day is None else (other_day.tried.hypothesis.name,)
    if apart or nameless:
        verdict = instruments.less(verdict)
    scored = score(state.base, state.tried)
    beyond = max(state.base.rss - len(state.base.y) + state.base.count, 1.0)
    machine = mismatch.in_the_machine(scored, beyond) if verdict != "consistent" else []
    data = (
        mismatch.in_the_data(problem, before, used, floor_noise, state.catalogue.axes)
        if verdict != "consistent"
        else []
    )
    if there.lasting and real:
        lasts = Share("environment", 1.0, "what one visit shows, the next one shows too, at another pose: it lasts")
        machine = [lasts, *(s for s in machine if s.axis != "environment")]
    shares = _shares(state, findings, machine)
    if known is not None:
        shares = known.among(shares, heldout.floor(problem, floor_noise, used))
    shares += data[:3]
    options.progress("detection limits")
    kept = nameless if withdrawn else state.chosen
    seen = _limits(state, kept, rng)
    coefficients, shapes = tuple(_coefficients(state, kept)), sum(len(t.shapes) for t in state.tried)
    del scored
    state = replace(state, tried=())
    options.progress("proof on readings that no step saw")
    proof = prove(state, options.most, rng) if findings or withdrawn else None
    by_group, groups = heldout.by_group(problem, (before, after), used)
    factor = problem.families[0].factor
    rows = problem.row[~used]
    result = Diagnosis(
        channel=problem.channel,
        predicted=options.predicted,
        verdict=verdict,
        sentence="",
        unit=problem.families[0].unit,
        heldout_before=heldout.rmse(problem, before, used),
        noise_floor=heldout.floor(problem, floor_noise, used),
        repeatable=factor * float(np.sqrt(power)),
        mismatch_p=there.p_value,
        heldout_after=heldout.rmse(problem, after, used),
        explained=explained,
        repeatable_after=factor * float(np.sqrt(max(rest.power, 0.0))),
        findings=tuple(findings),
        mismatch=tuple(shares),
        limits=tuple(seen),
        untestable=state.catalogue.untestable,
        coefficients=coefficients,
        errors=Errors(problem.blanked(before), problem.blanked(after), by_group, groups),
        proof=proof,
        used=used,
        outliers=rows,
        axes=state.catalogue.axes,
        tried=shapes,
        notes=tuple(words.withdrawn(withdrawn))
        + words.noise_note(floor_noise)
        + heldout.said(problem, before, after, floor_noise, used)
        + (() if left is None else (left.words,))
        + words.one_day(apart)
        + unnamed.said([c.tried.hypothesis for c in nameless]),
    )
    return replace(result, sentence=words.sentence(result), next_experiment=words.next_experiment(result))


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
