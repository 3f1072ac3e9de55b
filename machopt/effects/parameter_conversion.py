"""From the parameters of a file to the numbers of a law and back, by what the law declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import MEMORIES, BodyLaw, CompliantBody, Effect, JointLaw, LawParameter, LawParameterSet
from machopt.numerics.array_types import Array


def find_law(effect: Effect, given: ParameterReader) -> JointLaw:
    """Which law a file means: the word that it states, else the effect's default.

    Raises:
        InputError: a word that is no law of the effect, or none where it has several.
    """
    words = effect.law_words
    if not words:
        return effect.find_law("", given.keys)
    default = effect.default_law or (words[0] if given.is_empty else "")
    word = given.read_choice("law", words, default)
    if not word:
        raise given.build_error("law", f"is missing; valid: {', '.join(words)}")
    return effect.find_law(word, given.keys)


def find_body_law(
    effect: Effect, given: ParameterReader, body: CompliantBody
) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    """Law, coefficients and shape that a file means of a body, and the body as the file has it.

    Raises:
        InputError: a word that is no law of the effect, or numbers that cannot be.
    """
    if effect.file_reader is not None:
        return effect.file_reader(given, body)
    words = tuple(dict.fromkeys(law.word for law in effect.body_laws if law.word))
    word = given.read_choice("law", words, words[0]) if words else ""
    known = [law for law in effect.body_laws if law.word == word]
    keys = [{p.key for p in (*law.coefficients, *law.shape)} for law in known]
    law = next((law for law, own in zip(known, keys, strict=True) if given.keys <= own), known[-1])
    values, shape, _ = read_law_parameters(law, given)
    return law, values, shape, body


def read_law_parameters(law: LawParameterSet, given: ParameterReader) -> tuple[Array, Array, str]:
    """Values (P,) and shape (S,) in SI, NaN for what a file does not state, and what the law remembers ("": unsaid).

    Raises:
        InputError: a number that cannot be, or rows of different lengths.
    """
    groups = [[(p, _read_parameter_row(p, given)) for p in group] for group in (law.coefficients, law.shape)]
    rows = [(p, row) for group in groups for p, row in group if p.is_list]
    branches = max((len(row) for _, row in rows), default=1) or 1
    for p, row in rows:
        if len(row) not in (0, branches):
            longest = next(other.key for other, values in rows if len(values) == branches)
            raise given.build_error(p.key, f"found {len(row)} numbers; expected {branches}, one for each of {longest}")
    values, shape = (_join_branches(group, branches) for group in groups)
    memory = given.read_choice("memory", MEMORIES, "") if law.has_memory else ""
    return values, shape, memory


def write_law_parameters(law: LawParameterSet, values: Array, shape: Array, memory: str = "") -> dict[str, Any]:
    """The parameters as a file states them; what is NaN is left out."""
    out: dict[str, Any] = {"law": law.word} if law.word else {}
    for group, numbers in ((law.coefficients, values), (law.shape, shape)):
        rows = _split_by_parameter(group, np.asarray(numbers, float))
        for p, of in zip(group, rows, strict=True):
            with np.errstate(divide="ignore"):
                row = 1.0 / (of * p.factor) if p.inverse else of / p.factor
            if np.isfinite(row).all() and len(row):
                single = not p.is_list or (p.is_scalar_for_one_branch and len(row) == 1)
                out[p.key] = float(row[0]) if single else [float(v) for v in row]
    return out | ({"memory": memory} if memory else {})


def list_coefficient_names(law: LawParameterSet, count: int) -> tuple[tuple[str, str, float], ...]:
    """Name, SI unit and lower bound in SI of each of ``count`` coefficients."""
    rows = [
        (p, row)
        for p, row in zip(law.coefficients, _split_by_parameter(law.coefficients, np.arange(count)), strict=True)
    ]
    out: dict[int, tuple[str, str, float]] = {}
    for p, places in rows:
        for n, at in enumerate(places):
            name = (
                f"{p.report_key}[{n}]"
                if p.is_list and not (p.is_scalar_for_one_branch and len(places) == 1)
                else p.report_key
            )
            out[int(at)] = (name, p.unit, p.lower_limit * p.factor)
    return tuple(out[n] for n in range(count))


def add_law_parameters(law: LawParameterSet, one: Mapping[str, Any], two: Mapping[str, Any]) -> dict[str, Any]:
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


def _split_by_parameter(group: tuple[LawParameter, ...], numbers: NDArray[Any]) -> list[NDArray[Any]]:
    """The numbers of each parameter; those of one branch stand side by side, single ones before them."""
    single = sum(not p.is_list for p in group)
    many = numbers[single:].reshape(-1, max(len(group) - single, 1)).T
    lone, rows = iter(range(single)), iter(many)
    return [next(rows) if p.is_list else numbers[(n := next(lone)) : n + 1] for p in group]


def _join_branches(group: list[tuple[LawParameter, Array]], branches: int) -> Array:
    """The other way round; NaN for what is not stated."""
    rows = [(p, row if len(row) else np.full(branches if p.is_list else 1, np.nan)) for p, row in group]
    single, many = ([row for p, row in rows if p.is_list is of] for of in (False, True))
    return np.concatenate([*single, *([np.stack(many, axis=1).ravel()] if many else []), np.empty(0)])


def _read_parameter_row(p: LawParameter, given: ParameterReader) -> Array:
    """Numbers of one key in SI; empty where it is not stated."""
    if p.is_list and not (p.is_scalar_for_one_branch and given.read_single_key(p.key)):
        row = given.read_row(p.key, least=p.lower_limit)
        if p.positive and not (row > 0.0).all():
            what = "torques" if p.unit == "N·m" else "numbers"
            raise given.build_error(p.key, f"found {row[row <= 0.0][0]:g}; expected {what} above zero")
        return row * p.factor
    if not given.has_key(p.key) and not p.required:
        return np.empty(0)
    value = given.read_number(p.key, positive=p.positive)
    if value < p.lower_limit:
        raise given.build_error(p.key, f"found {value:g}; expected at least {_format_bound(p.lower_limit)}")
    return np.array([1.0 / (value * p.factor) if p.inverse else value * p.factor])


def _format_bound(least: float) -> str:
    return f"{least:g}" if least else "zero"
