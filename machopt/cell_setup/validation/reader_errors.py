"""Collection of all reader errors of a cell: a wrong value is removed or repaired and reading continues."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from machopt.cell.cell_reader import build_cell, find_cell_file
from machopt.cell.cell_schema import CellKeys
from machopt.cell_setup.validation.value_repairs import find_errors_outside_robot, list_value_repairs
from machopt.data_types.cell import Cell
from machopt.errors import InputError, TooManyArmJointsError
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument, list_schema_errors, read_yaml

_OPTIONAL: tuple[KeyPath, ...] = (
    ("robot", "arm_joints"),
    ("stiffness",),
    ("kinematics",),
    ("ignore_pairs",),
    ("controller",),
    ("plan",),
    ("tool", "cutter"),
    ("tool", "com_mm"),
    ("tool", "mass_kg"),
    ("robot", "limits", "velocity_deg_s"),
    ("robot", "limits", "position_deg"),
    ("robot", "pose"),
)
"""Keys without which a cell can still be read."""
_LISTS: tuple[KeyPath, ...] = (("tool", "geometry"), ("workpiece", "geometry"), ("obstacles",))
_MOST = 50  # problems; a file with more is not a cell with mistakes


@dataclass(frozen=True)
class PartialCell:
    """A cell as far as it can be read."""

    cell: Cell | None  # without the removed keys; None where the rest cannot be read either
    problems: tuple[InputError, ...]
    removed_keys: tuple[str, ...]  # keys


def read_all(path: Path, *, allow_external: bool = False) -> PartialCell:
    """Read a cell and continue after each error as if the wrong value were absent or repaired.

    Where the robot cannot be read, files that are independent of it are read still.

    Args:
        path: Cell folder or cell.yaml.
        allow_external: Whether files outside the cell folder are allowed.

    Returns:
        The parts that could be read, and all errors.
    """
    try:
        document = read_yaml(find_cell_file(path))
    except InputError as problem:
        return PartialCell(None, (problem,), ())
    problems: list[InputError] = []
    aside: list[str] = []
    for loc, message in list_schema_errors(CellKeys, document):
        problems.append(document.build_error(loc, message))
        place = _find_removable_key(document, loc)
        if place is not None:
            document = remove_key(document, place)
            aside.append(".".join(map(str, place)))
    if list_schema_errors(CellKeys, document):
        return PartialCell(None, tuple(problems), tuple(aside))
    while len(problems) < _MOST:
        try:
            return PartialCell(build_cell(document, allow_external=allow_external), tuple(problems), tuple(aside))
        except TooManyArmJointsError as problem:
            return PartialCell(None, (*problems, problem, *_find_other_errors(document, allow_external)), tuple(aside))
        except InputError as problem:
            problems.append(problem)
            problem_text = str(problem)
            tried = ((p, remove_key(document, p)) for p in _list_removable_places(document))
            repairs = ((m.place, m.document) for m in list_value_repairs(document))
            other = (pair for pair in (*tried, *repairs) if _try_reading(pair[1], allow_external) != problem_text)
            guilty = next(other, None)
        if guilty is None:
            return PartialCell(
                None, (*problems, *find_errors_outside_robot(document, {str(p) for p in problems})), tuple(aside)
            )
        place, document = guilty
        aside.append(".".join(map(str, place)))
    return PartialCell(None, tuple(problems), tuple(aside))


def _find_other_errors(document: YamlDocument, allow_external: bool) -> tuple[InputError, ...]:
    """Return what is wrong with a cell of an arm that cannot be planned for, besides its number of joints."""
    try:
        build_cell(document, allow_external=allow_external, any_chain=True)
    except InputError as problem:
        return (problem,)
    return ()


def remove_key(document: YamlDocument, loc: KeyPath) -> YamlDocument:
    """Return the document without a key or list entry; the index of later entries decreases by one.

    Args:
        document: Parsed YAML file, with the line of each key for errors.
        loc: Key path of the value in the document.
    """
    value = copy.deepcopy(document.value)
    at: Any = value
    for part in loc[:-1]:
        at = at[part]
    del at[loc[-1]]
    lines = document.lines
    if isinstance(loc[-1], int):  # later entries move up
        lines = {_shift_key_after_removal(k, loc): line for k, line in lines.items() if k[: len(loc)] != loc}
    return replace(document, value=value, lines=lines)


def _shift_key_after_removal(key: KeyPath, gone: KeyPath) -> KeyPath:
    n = len(gone) - 1
    last, own = gone[-1], key[n] if len(key) > n else None
    if key[:n] == gone[:n] and isinstance(own, int) and isinstance(last, int) and own > last:
        return (*key[:n], own - 1, *key[n + 1 :])
    return key


def _list_removable_places(document: YamlDocument) -> Iterator[KeyPath]:
    """List the keys that can be removed, where present."""
    for loc in _LISTS:
        found = _get_value_at(document, loc)
        if isinstance(found, list):
            yield from ((*loc, n) for n in range(len(found)))
    yield from (loc for loc in _OPTIONAL if _get_value_at(document, loc) is not None)


def _find_removable_key(document: YamlDocument, loc: KeyPath) -> KeyPath | None:
    """Find the key whose removal clears an error: the key itself if unknown, else its parent."""
    for n in range(len(loc), 0, -1):
        part = loc[:n]
        listed = any(part[:-1] == place and isinstance(part[-1], int) for place in _LISTS)
        if listed or part in _OPTIONAL or (n == len(loc) and not _is_schema_key(part)):
            return part if _get_value_at(document, part) is not None else None
    return None


def _is_schema_key(loc: KeyPath) -> bool:
    """A key of the schema: one that is not may go."""
    model: Any = CellKeys
    for part in loc:
        fields = getattr(model, "model_fields", None)
        if fields is None:
            return True
        if part not in fields:
            return isinstance(part, int)
        model = fields[part].annotation
    return True


def _get_value_at(document: YamlDocument, loc: KeyPath) -> Any:
    at: Any = document.value
    for part in loc:
        try:
            at = at[part]
        except (KeyError, IndexError, TypeError):
            return None
    return at


def _try_reading(document: YamlDocument, allow_external: bool) -> str:
    try:
        build_cell(document, allow_external=allow_external)
    except InputError as problem:
        return str(problem)
    return ""
