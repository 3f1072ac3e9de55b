"""Conversion between the parameters of a file and the numbers of a law, by the definitions that the law declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import MEMORIES, BodyLaw, CompliantBody, Effect, JointLaw, LawParameter, LawParameterSet
from machopt.numerics.array_types import Array


def find_law(effect: Effect, reader: ParameterReader) -> JointLaw:
    """Find the joint law that a file means: the stated word, otherwise the effect's default.

    Args:
        effect: Effect of the entry.
        reader: Reader of the entry's parameters.

    Returns:
        The law.

    Raises:
        InputError: An unknown word, or no word although the effect has several laws.
    """
    words = effect.law_words
    if not words:
        return effect.find_law("", reader.keys)
    default = effect.default_law or (words[0] if reader.is_empty else "")
    word = reader.read_choice("law", words, default)
    if not word:
        raise reader.build_error("law", f"is missing; valid: {', '.join(words)}")
    return effect.find_law(word, reader.keys)


def find_body_law(
    effect: Effect, reader: ParameterReader, body: CompliantBody
) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    """Find the law of a compliant body that a file means, with its numbers.

    Args:
        effect: Effect of the entry.
        reader: Reader of the entry's parameters.
        body: Geometry of the compliant body, all joints at zero.

    Returns:
        The law, its coefficients (P,) and shape (S,) in SI, and the body with stated properties.

    Raises:
        InputError: An unknown word, or impossible numbers.
    """
    if effect.file_reader is not None:
        return effect.file_reader(reader, body)
    words = tuple(dict.fromkeys(law.word for law in effect.body_laws if law.word))
    word = reader.read_choice("law", words, words[0]) if words else ""
    known = [law for law in effect.body_laws if law.word == word]
    keys = [{p.key for p in (*law.coefficients, *law.shape)} for law in known]
    law = next((law for law, own in zip(known, keys, strict=True) if reader.keys <= own), known[-1])
    values, shape, _ = read_law_parameters(law, reader)
    return law, values, shape, body


def read_law_parameters(law: LawParameterSet, reader: ParameterReader) -> tuple[Array, Array, str]:
    """Read the numbers of a law in SI.

    Args:
        law: Law that defines the parameters.
        reader: Reader of the entry's parameters.

    Returns:
        Coefficients (P,), shape (S,) with NaN for unstated numbers, and the kind of load history (empty if
        unstated).

    Raises:
        InputError: An impossible number, or lists of different lengths.
    """
    groups = [[(p, _read_parameter_row(p, reader)) for p in group] for group in (law.coefficients, law.shape)]
    rows = [(p, row) for group in groups for p, row in group if p.is_list]
    branches = max((len(row) for _, row in rows), default=1) or 1
    for p, row in rows:
        if len(row) not in (0, branches):
            longest = next(other.key for other, values in rows if len(values) == branches)
            raise reader.build_error(p.key, f"found {len(row)} numbers; expected {branches}, one for each of {longest}")
    values, shape = (_join_branches(group, branches) for group in groups)
    memory = reader.read_choice("memory", MEMORIES, "") if law.has_memory else ""
    return values, shape, memory


def write_law_parameters(law: LawParameterSet, values: Array, shape: Array, memory: str = "") -> dict[str, Any]:
    """Return the parameters as a file states them. NaN entries are left out.

    Args:
        law: Law that defines the parameters.
        values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
        shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
        memory: Kind of load history; empty to leave it out.

    Returns:
        Keys and values in the units of the keys.
    """
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
    """List the coefficients of a law with units and bounds.

    Args:
        law: Law that defines the parameters.
        count: Number of coefficients P.

    Returns:
        For each coefficient: name, SI unit, lower bound in SI.
    """
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
    """Combine two entries of the same law at one place.

    Coefficients with equal shape add up; others are listed side by side. The sum is formed in the file's units, so
    that unchanged numbers keep all their digits.

    Args:
        law: Law that defines the parameters.
        one: Parameters of the first entry.
        two: Parameters of the second entry.

    Returns:
        Parameters of the combined entry.
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
    """Return the numbers of each parameter. Numbers of one branch are adjacent; scalar parameters come first."""
    single = sum(not p.is_list for p in group)
    many = numbers[single:].reshape(-1, max(len(group) - single, 1)).T
    lone, rows = iter(range(single)), iter(many)
    return [next(rows) if p.is_list else numbers[(n := next(lone)) : n + 1] for p in group]


def _join_branches(group: list[tuple[LawParameter, Array]], branches: int) -> Array:
    """Invert :func:`_split_by_parameter`; unstated numbers become NaN."""
    rows = [(p, row if len(row) else np.full(branches if p.is_list else 1, np.nan)) for p, row in group]
    single, many = ([row for p, row in rows if p.is_list is of] for of in (False, True))
    return np.concatenate([*single, *([np.stack(many, axis=1).ravel()] if many else []), np.empty(0)])


def _read_parameter_row(p: LawParameter, reader: ParameterReader) -> Array:
    """Return the numbers of one key in SI; empty if it is not stated."""
    if p.is_list and not (p.is_scalar_for_one_branch and reader.read_single_key(p.key)):
        row = reader.read_row(p.key, least=p.lower_limit)
        if p.positive and not (row > 0.0).all():
            what = "torques" if p.unit == "N·m" else "numbers"
            raise reader.build_error(p.key, f"found {row[row <= 0.0][0]:g}; expected {what} above zero")
        return row * p.factor
    if not reader.has_key(p.key) and not p.required:
        return np.empty(0)
    value = reader.read_number(p.key, positive=p.positive)
    if value < p.lower_limit:
        raise reader.build_error(p.key, f"found {value:g}; expected at least {_format_bound(p.lower_limit)}")
    return np.array([1.0 / (value * p.factor) if p.inverse else value * p.factor])


def _format_bound(least: float) -> str:
    return f"{least:g}" if least else "zero"
