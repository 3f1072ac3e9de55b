"""YAML that is written, rows of numbers as text at once: they take most of the time of the library's emitter."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

WIDTH = 200  # characters of a line; a row of six stays on one line
_LONGEST = 150  # characters of a row that is written at once: it fits on a line of WIDTH behind any key
_MARK = "\ue000"  # private use: no text of ours holds it
_WRITTEN = re.compile(f'"{_MARK}([0-9]{{1,9}}){_MARK}"')


@dataclass(frozen=True, eq=False)
class _MarkedRow:
    """A row of numbers in the data that the library writes."""

    number: int


def format_number(value: float) -> str:
    """Return the shortest exact decimal; ``1.0e-07`` and not ``1e-07``, which YAML 1.1 readers take for text.

    Args:
        value: The number.
    """
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def format_yaml(data: Mapping[str, object]) -> str:
    """Return plain data as YAML: keys in their order, lists of numbers on one line.

    Args:
        data: Mappings, lists, words and numbers.
    """
    rows: list[str] = []
    text, found = _WRITTEN.subn(lambda place: rows[int(place[1])], _dump(_mark_rows(data, rows)))
    return text if found == len(rows) else _dump(data)  # a word of the data looks like a mark


def _dump(data: object) -> str:
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.representer.add_representer(float, _represent_number)
    yaml.representer.add_representer(_MarkedRow, _represent_row)
    yaml.default_flow_style = None  # lists of numbers on one line
    yaml.width = WIDTH
    yaml.allow_unicode = True
    yaml.representer.sort_base_mapping_type_on_output = False
    out = StringIO()
    yaml.dump(data, out)
    return out.getvalue()


def _mark_rows(value: object, rows: list[str]) -> object:
    """The data with a mark for each short row, which is appended to ``rows`` as text."""
    if isinstance(value, Mapping):
        return {key: _mark_rows(v, rows) for key, v in value.items()}
    if not isinstance(value, list | tuple):
        return value
    row = _format_row(value)
    if row is None:
        return [_mark_rows(v, rows) for v in value]
    rows.append(row)
    return _MarkedRow(len(rows) - 1)


def _format_row(values: Sequence[object]) -> str | None:
    words = []
    for value in values:
        if type(value) not in (float, int):
            return None
        words.append(format_number(value))  # type: ignore[arg-type]
    text = f"[{', '.join(words)}]"
    return text if words and len(text) <= _LONGEST else None


def _represent_number(representer: Any, value: float) -> Any:
    return representer.represent_scalar("tag:yaml.org,2002:float", format_number(value))


def _represent_row(representer: Any, row: _MarkedRow) -> Any:
    return representer.represent_scalar("tag:yaml.org,2002:str", f"{_MARK}{row.number}{_MARK}", style='"')
