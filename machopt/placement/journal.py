"""Journal of a search: results line by line next to the output folder, so that another run can continue.

The first line has a hash of the request; a journal of another request is restarted. A line that a killed run
left incomplete is skipped. The file is removed when the run has ended normally.
"""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from typing import Any, TypeVar

from machopt.errors import InputError
from machopt.placement.search_options import PlacementShift
from machopt.placement.search_result import PlacementCandidate, PlannedPlacement

_FIRST_LINE = 4096  # bytes; that of a journal is shorter
JournalEntry = TypeVar("JournalEntry", PlacementCandidate, PlannedPlacement)


def refuse_foreign_journal(path: Path, *, force: bool) -> None:
    """Refuse a file of another origin at the path of the journal, which would be overwritten.

    Args:
        path: path of the journal.
        force: overwrite any plain file.

    Raises:
        InputError: it is no plain file, or its first line is not that of a journal.
    """
    if not path.is_symlink() and not path.exists():
        return
    first: object = None
    if path.is_file() and not path.is_symlink():
        if force:
            return
        with path.open("rb") as data:
            line = data.readline(_FIRST_LINE)
        first = _parse_line(line.decode("utf-8", errors="replace")) if line else {"placement": ""}
    if not (isinstance(first, dict) and set(first) == {"placement"}):
        raise InputError(
            "is the progress file of the search, but machopt did not write it; move it, name another output "
            "folder, or give --force",
            file=path,
        )


class SearchJournal:
    """Results by number of the place; ``path`` None: not stored.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, path: Path | None, key: str) -> None:
        self.path = path
        self._places: dict[int, PlacementCandidate] = {}
        self._planned: dict[int, PlannedPlacement] = {}
        if path is None:
            return
        if not self._read(path, key):
            self._places, self._planned = {}, {}
            self._write("w", {"placement": key})

    @property
    def known_count(self) -> int:
        """Number of places that an earlier run has assessed."""
        return len(self._places)

    def find_candidate(self, number: int, shift: PlacementShift) -> PlacementCandidate | None:
        """Return the stored result of a place; None where there is none.

        Args:
            number: number of the place.
            shift: its shift, which must be equal.
        """
        found = self._places.get(number)
        return found if found is not None and found.shift == shift else None

    def find_planned(self, place: PlacementCandidate) -> PlannedPlacement | None:
        """Return the stored plan result of a place; None where there is none.

        Args:
            place: assessed place.
        """
        return self._planned.get(place.number)

    def append(self, one: JournalEntry) -> JournalEntry:
        """Store a result and return it.

        Args:
            one: result of a place.
        """
        kind = "place" if isinstance(one, PlacementCandidate) else "planned"
        self._write("a", {kind: _to_json_types(one)})
        return one

    def remove(self) -> None:
        """Remove the file after a normal end."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    def _read(self, path: Path, key: str) -> bool:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return False
        lines = text.splitlines()
        if not lines or _parse_line(lines[0]) != {"placement": key}:
            return False
        if not text.endswith("\n"):  # a killed run left half a line: the next entry starts a new one
            with path.open("a", encoding="utf-8") as file:
                file.write("\n")
        for line in lines[1:]:
            with contextlib.suppress(TypeError, KeyError, ValueError):
                ((kind, value),) = _parse_line(line).items()
                if kind == "place":
                    place = _parse_candidate(value)
                    self._places[place.number] = place
                elif kind == "planned":
                    whole = {"place": _parse_candidate(value["place"])}
                    one = PlannedPlacement(**{**_from_json_types(value), **whole})
                    self._planned[one.place.number] = one
        return True

    def _write(self, mode: str, value: dict[str, Any]) -> None:
        if self.path is None:
            return
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open(mode, encoding="utf-8", newline="\n") as file:
                file.write(json.dumps(value) + "\n")
        except OSError as problem:
            raise InputError(f"cannot be written: {problem.strerror}", file=self.path) from None


def _parse_line(line: str) -> dict[str, Any]:
    try:
        value = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return value if isinstance(value, dict) else {}


def _to_json_types(one: Any) -> Any:
    """Return the fields as JSON types; values that are not finite become text."""
    if isinstance(one, PlacementCandidate | PlannedPlacement | PlacementShift):
        return {name: _to_json_types(value) for name, value in vars(one).items()}
    return repr(one) if isinstance(one, float) and not math.isfinite(one) else one


def _from_json_types(value: dict[str, Any]) -> dict[str, Any]:
    return {name: _from_json_type(v) for name, v in value.items()}


def _from_json_type(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(value)
    return float(value) if value in ("inf", "-inf", "nan") else value


def _parse_candidate(value: dict[str, Any]) -> PlacementCandidate:
    return PlacementCandidate(**{**_from_json_types(value), "shift": PlacementShift(**value["shift"])})
