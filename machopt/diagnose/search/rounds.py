"""The search, and the search again: about what was found, without outliers, by the noise that is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence import aside, noise
from machopt.diagnose.evidence.grams import base_model, tried
from machopt.diagnose.evidence.whitening import whitening
from machopt.diagnose.nouns.problem import Catalogue, Correction, Problem
from machopt.diagnose.search import further
from machopt.diagnose.search.finer import settled
from machopt.diagnose.search.rate import Rate
from machopt.diagnose.search.select import BODY, Chosen
from machopt.diagnose.search.state import State
from machopt.diagnose.search.together import searched
from machopt.domain.kinematics import KinematicCorrection
from machopt.domain.stiffness import Term

Flags = NDArray[np.bool_]
ROUNDS = 3
MENDED = 2  # further ones, while the base is fitted to what nothing built has
CLIPS = 4


@dataclass(frozen=True)
class About:
    """What was found and what the next search is about, beside its base."""

    unloaded: tuple[KinematicCorrection, ...] = ()  # needs no load
    bodies: tuple[Term, ...] = ()  # give way beside the springs


Rebuild = Callable[[Array, frozenset[int], About], tuple[Problem, Catalogue]]


def in_rounds(
    problem: Problem,
    catalogue: Catalogue,
    most: int,
    seed: int,
    rebuild: Rebuild | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> State:
    """Search, and search again with noise, outliers and known physics about what was found."""
    residual, used = _robust(problem)
    before: list[tuple[str, str, str]] | None = None
    number = 0
    while True:
        number += 1
        words = f"search, round {number}"
        progress(words)
        rate = Rate(progress, words, len(catalogue.hypotheses), "laws")
        state = _round(problem, catalogue, most, seed, residual, used, rate)
        fitted = state.fitted(state.chosen)
        residual = fitted.residual
        again = aside.good(problem, residual) & _allowed(problem)
        same = before == _names(state.chosen) and np.array_equal(again, used)
        x = fitted.x[: problem.base.shape[2]]
        doubted = _doubted(problem, x, state.chosen)
        settles = (rebuild is None or not doubted) and (same or number >= ROUNDS)
        if settles or number == ROUNDS + MENDED:
            return settled(state)
        used, before, found = again, _names(state.chosen), _about(state.chosen)
        del state, fitted  # the columns of all laws are most of the memory
        if rebuild is not None:
            problem, catalogue = rebuild(x, doubted, found)


def _round(
    problem: Problem,
    catalogue: Catalogue,
    most: int,
    seed: int,
    residual: Array,
    used: Flags,
    rate: Callable[[int], None] = lambda _: None,
) -> State:
    """One search, by the noise that the residuals (N, D) of the last fit show."""
    found = noise.estimate(problem, residual, used)
    w = whitening(problem, found, used)
    base, unit = base_model(problem, w, np.random.default_rng([seed, 2]))
    fits = 1.0 if found.replicated else np.nan
    laws = tried(base, catalogue.hypotheses, rate)
    each, chosen = searched(base, laws, most, np.random.default_rng([seed, 3]), fits)
    each, chosen = further.searched(base, catalogue, (each, chosen), most, seed, fits)
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


def _about(chosen: Sequence[Chosen]) -> About:
    """Corrections without load and bodies that give way among what was chosen, where it is not a crowd.

    Of a crowd of waves and frames each leans on the others, and the next round about all of them found fewer: on a
    public UR10 (series D, benchmarks/real/poses.py) unseen poses were then predicted worse, 0.107 mm for 0.087.
    """
    if len(chosen) > calibrated.RESTING.crowded:
        return About()
    named = [(c.tried.hypothesis.family, _correction(c)) for c in chosen if c.tried.hypothesis.named]
    return About(
        tuple(c for _, c in named if isinstance(c, KinematicCorrection)),
        tuple(c for family, c in named if family == BODY and isinstance(c, Term)),
    )


def _correction(c: Chosen) -> Correction | None:
    at = c.scored.shape
    return c.tried.hypothesis.correction(c.scored.x * c.tried.unit[at], c.tried.hypothesis.shapes[at])


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
