"""YAML that is written, rows of numbers as text at once: they take most of the time of the library's emitter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

WIDTH = 200  # characters of a line; a row of six stays on one line


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
    rows: list[list[str]] = []
    return _dump(_mark_rows(data, rows), rows)


def _dump(data: object, rows: list[list[str]]) -> str:
    from ruamel.yaml import YAML

    from machopt.file_formats.yaml_row_emitter import RowEmitter

    yaml = YAML(typ="safe", pure=True)
    yaml.Emitter = RowEmitter
    yaml.number_rows = rows  # type: ignore[attr-defined]  # for the emitter
    yaml.representer.add_representer(float, _represent_number)
    yaml.representer.add_representer(_MarkedRow, _represent_row)
    yaml.default_flow_style = None  # lists of numbers on one line
    yaml.width = WIDTH
    yaml.allow_unicode = True
    yaml.representer.sort_base_mapping_type_on_output = False
    out = StringIO()
    yaml.dump(data, out)
    return out.getvalue()


def _mark_rows(value: object, rows: list[list[str]]) -> object:
    """The data with a mark for each row of numbers, whose words are appended to ``rows``."""
    if isinstance(value, Mapping):
        return {key: _mark_rows(v, rows) for key, v in value.items()}
    if not isinstance(value, list | tuple):
        return value
    row = _format_row(value)
    if row is None:
        return [_mark_rows(v, rows) for v in value]
    rows.append(row)
    return _MarkedRow(len(rows) - 1)


def _format_row(values: Sequence[object]) -> list[str] | None:
    words = []
    for value in values:
        if type(value) not in (float, int):
            return None
        words.append(format_number(value))  # type: ignore[arg-type]
    return words or None


def _represent_number(representer: Any, value: float) -> Any:
    return representer.represent_scalar("tag:yaml.org,2002:float", format_number(value))


def _represent_row(representer: Any, row: _MarkedRow) -> Any:
    from machopt.file_formats.yaml_row_emitter import ROW_MARK

    return representer.represent_scalar("tag:yaml.org,2002:str", f"{ROW_MARK}{row.number}{ROW_MARK}", style='"')
