"""What concealed cases say of each threshold: ``rooms.json``, written by ``benchmarks/thresholds.py --room``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Room:
    """Of one threshold: what it was held against in the cases, and what changes when it is moved by a quarter."""

    value: float  # that it had
    cases: int = 0  # in which it was read
    asked: int = 0  # numbers that it was held against; none where it is only computed with
    below: float | None = (
        None  # between these none of the comparisons comes out otherwise; None: on that side none ever does
    )
    above: float | None = None
    tried: int = 0  # cases diagnosed again with it, and others, moved by a quarter
    less: tuple[int, int, int] = (0, 0, 0)  # of these: answers that become better, worse, otherwise with a quarter less
    more: tuple[int, int, int] = (0, 0, 0)
    tests: tuple[str, ...] = ()  # that ask it, where no case does

    @classmethod
    def of(cls, row: Sequence[Any]) -> Room:
        """From a row of the file: the fields in their order."""
        kept = [tuple(v) if isinstance(v, list) else v for v in row]
        named: dict[str, Any] = dict(zip((f.name for f in fields(cls)), kept, strict=True))
        return cls(**named)

    def told(self) -> str:
        """In words."""
        if not self.cases:
            tests = f"; asked by {', '.join(self.tests)}" if self.tests else ""
            return f"no case asks for it{tests}"
        said = f"in {self.cases} case{'s' * (self.cases > 1)}"
        if not self.asked:
            said += " computed with"
        else:
            low, high = (
                "−∞" if self.below is None else f"{self.below:.3g}",
                "∞" if self.above is None else f"{self.above:.3g}",
            )
            said += (
                f" asked {self.asked:,} time{'s' * (self.asked > 1)}, no answer to it changes between {low} and {high}"
            )
        if not self.tried:
            return said
        ways = [f"{w} {_changes(c)}" for w, c in (("less", self.less), ("more", self.more)) if any(c)]
        return f"{said}; a quarter less or more in {self.tried}: " + (", ".join(ways) or "no diagnosis changes")


def _changes(counts: tuple[int, int, int]) -> str:
    words = zip(counts, ("better", "worse", "otherwise"), strict=True)
    return "/".join(f"{n} {word}" for n, word in words if n)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The whole table, and what it was measured on."""

    script: str
    date: str
    sets: tuple[str, ...]  # commands that draw the cases, each with how many
    together: tuple[
        int, int, int
    ]  # cases with all thresholds moved at once; of these, answers changed by less, by more
    rooms: dict[str, Room]


@cache
def measured() -> Measured:
    """The table that is shipped."""
    said = json.loads((files(__package__) / "rooms.json").read_text(encoding="utf-8"))
    return Measured(
        script=said["script"],
        date=said["date"],
        sets=tuple(said["sets"]),
        together=(said["together"][0], said["together"][1], said["together"][2]),
        rooms={k: Room.of(row) for k, row in said["rooms"].items()},
    )
