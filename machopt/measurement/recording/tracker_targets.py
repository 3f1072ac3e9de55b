"""Reflector (``targets_mm``) and tracker station of each reading of measured poses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from machopt.data_types.measurements.recording import Recording, RecordingKind, TrackerTarget
from machopt.file_formats.strict_yaml import YamlDocument, format_found_value
from machopt.measurement.recording.recording_columns import read_labels
from machopt.measurement.recording.recording_table import RecordingTable
from machopt.numerics.array_types import Ints

KEY = "targets_mm"
FARTHEST = 1e4  # mm, largest distance of a reflector from the flange
_WHOLE = re.compile(r"[-+]?[0-9]+(?:\.0*)?", re.ASCII)


def parse_targets(document: YamlDocument, given: object, kind: RecordingKind) -> dict[str, TrackerTarget]:
    """Parse the reflectors listed in recording.yaml.

    Args:
        document: The file recording.yaml, for error messages.
        given: Mapping of name → [x, y, z] in mm in the flange frame, or a list of positions, named 1, 2, ….
        kind: Kind of the recording.

    Returns:
        Reflectors by name.

    Raises:
        InputError: Another kind of recording, an invalid position, or a duplicate name.
    """
    if given is None:
        return {}
    if kind != "absolute":
        raise document.build_error(
            (KEY,), f"belongs to recordings of kind absolute, where a tracker measures; found {kind}"
        )
    if isinstance(given, Mapping):
        items = [(k, _normalise_name(str(k)), v) for k, v in given.items()]
    elif isinstance(given, Sequence) and not isinstance(given, str):
        items = [(n, str(n + 1), v) for n, v in enumerate(given)]
    else:
        items = []
    if not items:
        raise document.build_error(
            (KEY,),
            f"found {format_found_value(given)}; expected the place of each target in flange, e.g. {{1: [0, 60, 15]}}",
        )
    out: dict[str, TrackerTarget] = {}
    for key, name, value in items:
        numbers = value if isinstance(value, Sequence) and not isinstance(value, str) else ()
        right = len(numbers) == 3 and all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers)
        if not right or not all(np.isfinite(float(v)) and abs(float(v)) <= FARTHEST for v in numbers):
            raise document.build_error(
                (KEY, key),
                f"found {format_found_value(value)}; expected x, y, z in flange, three numbers within ±{FARTHEST:g} mm",
            )
        if not name or name in out:
            raise document.build_error(
                (KEY, key), f"target {name!r} is given twice" if name else "a target needs a name"
            )
        x, y, z = (1e-3 * float(v) for v in numbers)
        out[name] = TrackerTarget(name, (x, y, z))
    return out


def match_targets(
    table: RecordingTable, known: Mapping[str, TrackerTarget], numbered: bool
) -> tuple[tuple[TrackerTarget, ...], Ints | None]:
    """Match the rows of a table to the listed reflectors.

    Args:
        table: Table with or without a column ``target``.
        known: Reflectors by name, see :func:`parse_targets`.
        numbered: Whether ``targets_mm`` is a list; then a column that counts from 0 is accepted.

    Returns:
        The reflectors, and the reflector index (N,) of each row, or None.

    Raises:
        InputError: An unknown target, or several reflectors without a column ``target``.
    """
    if "target" not in table.words:
        if len(known) > 1:
            raise table.build_error(
                f"column target is missing; recording.yaml lists {len(known)} targets under {KEY}, and a row is of one"
            )
        return tuple(known.values()), None
    words = [_normalise_name(w) for w in table.words["target"]]
    if not known:
        raise table.build_error(
            f"column target needs {KEY} in recording.yaml, the nominal place of each in flange: "
            f"{{{words[0] or 1}: [x, y, z]}}"
        )
    order = list(known)
    if numbered and "0" in words and str(len(order)) not in words:
        order = [str(n) for n in range(len(order))]
    at = {name: n for n, name in enumerate(order)}
    for row, word in enumerate(words):
        if word not in at:
            raise table.build_error(
                f"found {word!r}; expected a target of {KEY} in recording.yaml: {', '.join(order)}", row, "target"
            )
    targets = tuple(TrackerTarget(name, t.place) for name, t in zip(order, known.values(), strict=True))
    return targets, np.array([at[w] for w in words], dtype=np.int64)


def read_tracker_stations(table: RecordingTable) -> Ints | None:
    """Read the labels of the column ``frame``.

    Args:
        table: Table of one data file.

    Returns:
        (N,) labels; None without the column.
    """
    return read_labels(table, "frame") if "frame" in table.numbers else None


def find_unmeasured_targets(recording: Recording) -> list[str]:
    """Warn about listed reflectors that were never measured.

    Args:
        recording: Recording.

    Returns:
        Warnings.
    """
    if recording.target is None:
        return []
    never = [t.name for n, t in enumerate(recording.targets) if not (recording.target == n).any()]
    if not never:
        return []
    return [f"{recording.source}: no row is of target {', '.join(never)} of {KEY}"]


def _normalise_name(word: str) -> str:
    """Return ``1`` for ``1``, `` 1`` and ``1.0``; other words unchanged."""
    word = word.strip()
    return str(int(float(word))) if _WHOLE.fullmatch(word) else word
