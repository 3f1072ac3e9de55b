"""Template language: fields and optional sections, without executable code.

::

    @{name}            a field as it is            @{name:.3f}   with a format: d, .3f, .6g, 4d, s …
    @[name|text@]      text where ``name`` has a value      @[!name|text@]  … where it has none

A field has no value where it is NaN, empty or false. Sections do not nest. ``@{`` is taken by no robot language,
so braces, dollar signs and percent signs of KRL, RAPID or XML stand for themselves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.errors import PostError, suggest_nearest_word
from machopt.programs.writing.post_errors import MissingFieldValueError

TemplateValue = object
TemplateColumn = Sequence[object] | NDArray[Any]

_TOKEN = re.compile(r"@\{([^}\n]*)\}|@\[(!?)([a-z0-9_]+)\||@\]")
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_SPEC = re.compile(r"[ 0-]?[0-9]{0,3}(?:\.([0-9]{1,2}))?[dfgs]")


@dataclass(frozen=True)
class TemplateField:
    """One ``@{name:spec}``, with its section."""

    name: str
    spec: str
    decimals: int | None

    def text(self, value: TemplateValue) -> str:
        """Format a value, without negative zero.

        Args:
            value: Value of the field.

        Returns:
            The text.
        """
        if not self.spec:
            return str(value)
        if self.spec[-1] == "s":
            return f"%{self.spec}" % str(value)
        number = float(value)  # type: ignore[arg-type]
        if self.spec[-1] == "d":
            return f"%{self.spec}" % round(number)
        if self.decimals is not None and self.spec[-1] == "f":
            number = round(number, self.decimals) + 0.0
        return f"%{self.spec}" % (number + 0.0)


@dataclass(frozen=True)
class TemplateSection:
    """Consecutive parts that are printed together: always, or where ``needs`` has (or lacks) a value."""

    parts: tuple[str | TemplateField, ...]
    needs: str = ""
    lacking: bool = False


@dataclass(frozen=True)
class TextTemplate:
    """A compiled text."""

    sections: tuple[TemplateSection, ...]
    where: str  # key of the post file, for messages

    @property
    def names(self) -> frozenset[str]:
        """Every field and condition it uses."""
        fields = {p.name for s in self.sections for p in s.parts if isinstance(p, TemplateField)}
        return frozenset(fields | {s.needs for s in self.sections if s.needs})

    def one(self, values: Mapping[str, TemplateValue]) -> str:
        """Fill the template with one set of values.

        Args:
            values: Field → value.

        Returns:
            The text.

        Raises:
            MissingFieldValueError: a field outside a section has no value.
        """
        out = []
        for section in self.sections:
            if section.needs and is_present(values[section.needs]) == section.lacking:
                continue
            for part in section.parts:
                if isinstance(part, str):
                    out.append(part)
                    continue
                value = values[part.name]
                if not is_present(value) and value != "" and value is not False:
                    raise self.missing(part.name)
                out.append(part.text(value))
        return "".join(out)

    def rows(self, columns: Mapping[str, TemplateColumn], rows: Sequence[int]) -> list[str]:
        """Fill the template for many rows: column by column, several times faster than :meth:`one`.

        Args:
            columns: Field → values of all rows.
            rows: Indices of the rows.

        Returns:
            One text per row.
        """
        pieces: list[list[str]] = []
        for section in self.sections:
            chosen = None
            if section.needs:
                condition = columns[section.needs]
                chosen = [is_present(condition[k]) != section.lacking for k in rows]
                if not any(chosen):
                    continue
            for part in section.parts:
                if isinstance(part, str):
                    piece = [part] * len(rows)
                else:
                    piece = self._format_column(part, columns[part.name], rows, chosen)
                pieces.append(piece if chosen is None else [t if c else "" for t, c in zip(piece, chosen, strict=True)])
        return ["".join(texts) for texts in zip(*pieces, strict=True)] if pieces else [""] * len(rows)

    def _format_column(
        self, part: TemplateField, column: TemplateColumn, rows: Sequence[int], chosen: list[bool] | None
    ) -> list[str]:
        if isinstance(column, np.ndarray) and column.dtype.kind in "fiu" and part.spec and part.spec[-1] in "fd":
            values = np.asarray(column, float)[np.asarray(rows, dtype=np.intp)]
            absent = np.isnan(values)
            if chosen is not None:
                absent &= np.asarray(chosen)
            if absent.any():
                raise self.missing(part.name)
            values = np.where(np.isnan(values), 0.0, values)
            if part.spec[-1] == "d":
                return [f"%{part.spec}" % v for v in np.round(values).astype(np.int64).tolist()]
            decimals = 6 if part.decimals is None else part.decimals
            fmt = f"%{part.spec}"
            return [fmt % v for v in (np.round(values, decimals) + 0.0).tolist()]
        out = []
        for i, k in enumerate(rows):
            if chosen is not None and not chosen[i]:
                out.append("")
                continue
            value = column[k]
            if not is_present(value) and value != "":
                raise self.missing(part.name)
            out.append(part.text(value))
        return out

    def missing(self, name: str) -> MissingFieldValueError:
        """Build the error of a field without a value.

        Args:
            name: Name of the field.

        Returns:
            The error, not raised.
        """
        return MissingFieldValueError(name, self.where)


def is_present(value: TemplateValue) -> bool:
    """Return whether a value counts as present: not None, NaN, the empty text or False.

    Args:
        value: Value of the field.
    """
    if value is None or value is False or value == "":
        return False
    if isinstance(value, np.bool_):
        return bool(value)
    return not (isinstance(value, float | np.floating) and math.isnan(value))


def compile_template(text: str, where: str) -> TextTemplate:
    """Read a template.

    Args:
        text: the template.
        where: its key, for messages.

    Raises:
        InputError: a field or section that is not of the language.
    """
    sections: list[TemplateSection] = []
    parts: list[str | TemplateField] = []
    needs, lacking, at = "", False, 0
    for token in _TOKEN.finditer(text):
        if token.start() > at:
            parts.append(text[at : token.start()])
        at = token.end()
        if token.group(1) is not None:
            parts.append(_parse_field(token.group(1), where))
            continue
        opens = token.group(0) != "@]"
        if opens == bool(needs):
            raise PostError(
                f"{token.group(0)!r} "
                + ("inside another section; sections do not nest" if opens else "without a section before it"),
                where=where,
            )
        sections.append(TemplateSection(tuple(parts), needs, lacking))
        parts, needs, lacking = [], token.group(3) or "", bool(token.group(2))
    if needs:
        raise PostError(f"the section @[{needs}| is not closed by @]", where=where)
    sections.append(TemplateSection((*parts, text[at:]) if at < len(text) else tuple(parts)))
    for section in sections:
        for part in section.parts:
            if isinstance(part, str) and ("@{" in part or "@[" in part):
                raise PostError(
                    f"{part.strip()[:40]!r}: expected @{{name}}, @{{name:.3f}} or @[name|text@]", where=where
                )
    return TextTemplate(tuple(s for s in sections if s.parts), where)


def check_names(template: TextTemplate, known: Sequence[str]) -> None:
    """Refuse fields that do not exist.

    Args:
        template: The template.
        known: Names of the existing fields.

    Raises:
        PostError: names the field and the nearest existing one.
    """
    for name in sorted(template.names):
        if name not in known:
            raise PostError(
                f"no field is named {name!r}; {suggest_nearest_word(name, sorted(known))}", where=template.where
            )


def _parse_field(inner: str, where: str) -> TemplateField:
    name, colon, spec = inner.partition(":")
    found = _SPEC.fullmatch(spec) if colon else None
    if not _NAME.fullmatch(name) or (colon and found is None):
        raise PostError(
            f"@{{{inner}}} is no field; expected @{{name}} or @{{name:.3f}} (formats d, f, g, s)", where=where
        )
    return TemplateField(name, spec, int(found.group(1)) if found and found.group(1) else None)
