"""The least size of each effect that this recording would have shown, and what it could not be told from.

An effect is named from a gain of ``least_gain`` on; noncentrality √gain + 1.28 reaches that in nine of ten repeats. The
design decides how large an effect that takes: its columns, with the base refitted beside them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import NOTHING, Model, Tried, ridged_inverse
from machopt.diagnose.nouns.result import Limit, Name, Standing
from machopt.diagnose.search.screen import bounded

DIRECTIONS = 8
MOST_SHAPES = 6


def limits(model: Model, tried: Sequence[Tried], rng: np.random.Generator, of: Collection[Name]) -> list[Limit]:
    """One limit per effect and place, of its first law.

    Args:
        model: the base (with what was found).
        tried: every hypothesis.
        rng: directions of laws with several coefficients.
        of: effects and places that limits are wanted for; the others are what they may be confused with.
    """
    M = ridged_inverse(model.normal)
    first: dict[Name, tuple[Tried, int]] = {}
    values: dict[Name, float] = {}
    units: dict[Name, str] = {}
    signals: dict[Name, Array] = {}
    out: list[Limit] = []
    for t in tried:
        name = t.hypothesis.name
        if name in first or name not in of:
            continue
        first[name] = (t, 0)
        p = t.X.shape[2]
        need = np.sqrt(
            max(
                calibrated.DETECTION.gain + calibrated.DETECTION.per_coefficient * (p - 1) + t.hypothesis.penalty,
                calibrated.DETECTION.share * len(model.y),
            )
            * model.spread
        )
        need += calibrated.DETECTION.nine_of_ten * np.sqrt(model.spread)
        sizes: list[float] = []
        for s in _some(len(t.shapes)):
            C = t.against(model)[s]
            rest = t.at(s) - model.X @ (M @ C.T)
            own = t.XX[:, s].sum(axis=0)
            S, whole = own - C @ M @ C.T, np.diag(own)  # as a search sees it: what is held near a statement gives less
            if np.all(np.diag(S) < calibrated.DETECTION.absorbed * whole):
                continue
            for x in _directions(t, s, rng):
                n = float(np.sqrt(max(x @ S @ x, 0.0)))
                if n <= 1e-9 * float(np.sqrt(whole.max())):
                    continue
                least = x * need / n
                quantity = next(iter(t.hypothesis.quantities(least * t.unit[s], t.shapes[s]).values()))
                sizes.append(abs(quantity.value))
                units[name] = quantity.unit
                if name not in signals or len(sizes) == 1:
                    signals[name] = rest @ least
                    first[name] = (t, s)
        if sizes and np.isfinite(np.median(sizes)):
            values[name] = float(np.median(sizes))
        else:
            unit = next(iter(t.hypothesis.quantities(np.ones(p), t.shapes[0]).values())).unit
            effect, location = name
            out.append(Limit(effect=effect, location=location, value=float("nan"), unit=unit, standing="not testable"))
    if signals:
        sets = _confused(model, M, tried, signals)
        for name, value in values.items():
            (effect, location), one_of = name, tuple(sets[name])
            standing: Standing = "only as a set" if one_of else "testable"
            out.append(
                Limit(effect=effect, location=location, value=value, unit=units[name], standing=standing, one_of=one_of)
            )
    return out


def _confused(model: Model, M: Array, tried: Sequence[Tried], signals: dict[Name, Array]) -> dict[Name, list[Name]]:
    """For each effect at twice its limit, the others that leave nothing of it."""
    names = list(signals)
    V = 2.0 * np.stack([signals[n] for n in names], axis=1)  # (M, K), orthogonal to the base
    whole = np.einsum("mk,mk->k", V, V)
    best: dict[Name, Array] = {}
    for t in tried:
        taken = np.zeros(len(names))
        for s in _some(len(t.shapes)):
            XX, C = t.XX[:, s].sum(axis=0), t.against(model)[s]
            S = XX - C @ M @ C.T + np.diag(1e-6 * np.diag(XX) + NOTHING)
            U = t.at(s).T @ V
            _, gain = bounded(np.broadcast_to(S, (len(names), *S.shape)), U.T, t.hypothesis.lower)
            _, other = bounded(np.broadcast_to(S, (len(names), *S.shape)), -U.T, t.hypothesis.lower)
            taken = np.maximum(taken, np.maximum(gain, other))
        name = t.hypothesis.name
        best[name] = np.maximum(best.get(name, np.zeros(len(names))), taken)
    return {
        n: [o for o in best if o != n and whole[k] - best[o][k] < calibrated.DETECTION.apart * model.spread]
        for k, n in enumerate(names)
    }


def _some(count: int) -> list[int]:
    return list(range(count)) if count <= MOST_SHAPES else np.linspace(0, count - 1, MOST_SHAPES).astype(int).tolist()


def _directions(t: Tried, shape: int, rng: np.random.Generator) -> Array:
    """(K, p) coefficients that limits are stated of: as such a thing mostly has them, else any."""
    p, lower = t.X.shape[2], t.hypothesis.lower
    if p == 1:
        return np.ones((1, 1))
    if t.hypothesis.usual is not None:
        return np.asarray(t.hypothesis.usual / t.unit[shape])
    x = rng.normal(size=(DIRECTIONS, p))
    if lower:
        x = np.where(np.isfinite(np.array(lower)), np.abs(x), x)
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))
