"""From the parameters of a file to the numbers of a law and back, by what the law declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.effects.given import Parameters
from machopt.effects.protocol import MEMORIES, Body, BodyLaw, Effect, Law, Parameter, Stated


def law_of(effect: Effect, given: Parameters) -> Law:
    """Which law a file means: the word that it states, else the effect's default.

    Raises:
        InputError: a word that is no law of the effect, or none where it has several.
    """
    words = effect.words
    if not words:
        return effect.law("", given.keys)
    default = effect.default or (words[0] if given.empty else "")
    word = given.choice("law", words, default)
    if not word:
        raise given.error("law", f"is missing; valid: {', '.join(words)}")
    return effect.law(word, given.keys)


def body_law_of(effect: Effect, given: Parameters, body: Body) -> tuple[BodyLaw, Array, Array, Body]:
    """Law, coefficients and shape that a file means of a body, and the body as the file has it.

    Raises:
        InputError: a word that is no law of the effect, or numbers that cannot be.
    """
    if effect.reads is not None:
        return effect.reads(given, body)
    words = tuple(dict.fromkeys(law.word for law in effect.gives if law.word))
    word = given.choice("law", words, words[0]) if words else ""
    known = [law for law in effect.gives if law.word == word]
    keys = [{p.key for p in (*law.coefficients, *law.shape)} for law in known]
    law = next((law for law, own in zip(known, keys, strict=True) if given.keys <= own), known[-1])
    values, shape, _ = read(law, given)
    return law, values, shape, body


def read(law: Stated, given: Parameters) -> tuple[Array, Array, str]:
    """Values (P,) and shape (S,) in SI, NaN for what a file does not state, and what the law remembers ("": unsaid).

    Raises:
        InputError: a number that cannot be, or rows of different lengths.
    """
    groups = [[(p, _row(p, given)) for p in group] for group in (law.coefficients, law.shape)]
    rows = [(p, row) for group in groups for p, row in group if p.many]
    branches = max((len(row) for _, row in rows), default=1) or 1
    for p, row in rows:
        if len(row) not in (0, branches):
            longest = next(other.key for other, values in rows if len(values) == branches)
            raise given.error(p.key, f"found {len(row)} numbers; expected {branches}, one for each of {longest}")
    values, shape = (_joined(group, branches) for group in groups)
    memory = given.choice("memory", MEMORIES, "") if law.remembers else ""
    return values, shape, memory


def write(law: Stated, values: Array, shape: Array, memory: str = "") -> dict[str, Any]:
    """The parameters as a file states them; what is NaN is left out."""
    out: dict[str, Any] = {"law": law.word} if law.word else {}
    for group, numbers in ((law.coefficients, values), (law.shape, shape)):
        rows = _parted(group, np.asarray(numbers, float))
        for p, of in zip(group, rows, strict=True):
            with np.errstate(divide="ignore"):
                row = 1.0 / (of * p.factor) if p.inverse else of / p.factor
            if np.isfinite(row).all() and len(row):
                single = not p.many or (p.bare and len(row) == 1)
                out[p.key] = float(row[0]) if single else [float(v) for v in row]
    return out | ({"memory": memory} if memory else {})


def named(law: Stated, count: int) -> tuple[tuple[str, str, float], ...]:
    """Name, SI unit and lower bound in SI of each of ``count`` coefficients."""
    rows = [(p, row) for p, row in zip(law.coefficients, _parted(law.coefficients, np.arange(count)), strict=True)]
    out: dict[int, tuple[str, str, float]] = {}
    for p, places in rows:
        for n, at in enumerate(places):
            name = f"{p.called}[{n}]" if p.many and not (p.bare and len(places) == 1) else p.called
            out[int(at)] = (name, p.unit, p.least * p.factor)
    return tuple(out[n] for n in range(count))


def summed(law: Stated, one: Mapping[str, Any], two: Mapping[str, Any]) -> dict[str, Any]:
    """Two statements of a law at one place as one: numbers of the same shape add up, others stand side by side.

    In the file's own units, so that what is not touched stays as it was to the last digit.
    """
    keys, own = [p.key for p in (*law.shape, *law.coefficients)], len(law.shape)
    total: dict[tuple[float, ...], list[float]] = {}
    for stated in (one, two):
        columns = [v if isinstance(v, list | tuple) else [v] for v in (stated[key] for key in keys)]
        for row in zip(*columns, strict=True):
            form, sizes = tuple(float(v) for v in row[:own]), [float(v) for v in row[own:]]
            total[form] = [a + b for a, b in zip(total.get(form, [0.0] * len(sizes)), sizes, strict=True)]
    rows = [(*form, *total[form]) for form in sorted(total)]
    lists = dict(zip(keys, map(list, zip(*rows, strict=True)), strict=True))
    return {key: value[0] if len(rows) == 1 else value for key, value in lists.items()}


def _parted(group: tuple[Parameter, ...], numbers: NDArray[Any]) -> list[NDArray[Any]]:
    """The numbers of each parameter; those of one branch stand side by side, single ones before them."""
    single = sum(not p.many for p in group)
    many = numbers[single:].reshape(-1, max(len(group) - single, 1)).T
    lone, rows = iter(range(single)), iter(many)
    return [next(rows) if p.many else numbers[(n := next(lone)) : n + 1] for p in group]


def _joined(group: list[tuple[Parameter, Array]], branches: int) -> Array:
    """The other way round; NaN for what is not stated."""
    rows = [(p, row if len(row) else np.full(branches if p.many else 1, np.nan)) for p, row in group]
    single, many = ([row for p, row in rows if p.many is of] for of in (False, True))
    return np.concatenate([*single, *([np.stack(many, axis=1).ravel()] if many else []), np.empty(0)])


def _row(p: Parameter, given: Parameters) -> Array:
    """Numbers of one key in SI; empty where it is not stated."""
    if p.many and not (p.bare and given.single(p.key)):
        row = given.row(p.key, least=p.least)
        if p.positive and not (row > 0.0).all():
            what = "torques" if p.unit == "N·m" else "numbers"
            raise given.error(p.key, f"found {row[row <= 0.0][0]:g}; expected {what} above zero")
        return row * p.factor
    if not given.has(p.key) and not p.required:
        return np.empty(0)
    value = given.number(p.key, positive=p.positive)
    if value < p.least:
        raise given.error(p.key, f"found {value:g}; expected at least {_bound(p.least)}")
    return np.array([1.0 / (value * p.factor) if p.inverse else value * p.factor])


def _bound(least: float) -> str:
    return f"{least:g}" if least else "zero"
