"""What concealed cases say of each threshold: ``rooms.json``, written by ``benchmarks/thresholds.py --room``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any


@dataclass(frozen=True, kw_only=True)
class ThresholdSensitivity:
    """Of one threshold: what it was held against in the cases, and what changes when it is moved by a quarter."""

    value: float  # that it had
    cases: int = 0  # in which it was read
    comparisons: int = 0  # numbers that it was held against; none where it is only computed with
    lower_limit: float | None = (
        None  # between these none of the comparisons comes out otherwise; None: on that side none ever does
    )
    upper_limit: float | None = None
    perturbed_cases: int = 0  # cases diagnosed again with it, and others, moved by a quarter
    changes_when_reduced: tuple[int, int, int] = (
        0,
        0,
        0,
    )  # of these: answers that become better, worse, otherwise with a quarter less
    changes_when_increased: tuple[int, int, int] = (0, 0, 0)
    tests: tuple[str, ...] = ()  # that ask it, where no case does

    @classmethod
    def from_row(cls, row: Sequence[Any]) -> ThresholdSensitivity:
        """From a row of the file: the fields in their order."""
        kept = [tuple(v) if isinstance(v, list) else v for v in row]
        named: dict[str, Any] = dict(zip((f.name for f in fields(cls)), kept, strict=True))
        return cls(**named)

    def describe(self) -> str:
        """In words."""
        if not self.cases:
            tests = f"; asked by {', '.join(self.tests)}" if self.tests else ""
            return f"no case asks for it{tests}"
        said = f"in {self.cases} case{'s' * (self.cases > 1)}"
        if not self.comparisons:
            said += " computed with"
        else:
            low, high = (
                "−∞" if self.lower_limit is None else f"{self.lower_limit:.3g}",
                "∞" if self.upper_limit is None else f"{self.upper_limit:.3g}",
            )
            said += (
                f" asked {self.comparisons:,} time{'s' * (self.comparisons > 1)}, no answer to it changes "
                f"between {low} and {high}"
            )
        if not self.perturbed_cases:
            return said
        ways = [
            f"{w} {_format_change_counts(c)}"
            for w, c in (("less", self.changes_when_reduced), ("more", self.changes_when_increased))
            if any(c)
        ]
        return f"{said}; a quarter less or more in {self.perturbed_cases}: " + (
            ", ".join(ways) or "no diagnosis changes"
        )


def _format_change_counts(counts: tuple[int, int, int]) -> str:
    words = zip(counts, ("better", "worse", "otherwise"), strict=True)
    return "/".join(f"{n} {word}" for n, word in words if n)


@dataclass(frozen=True, kw_only=True)
class SensitivityTable:
    """The whole table, and what it was measured on."""

    script: str
    date: str
    case_sets: tuple[str, ...]  # commands that draw the cases, each with how many
    changes_when_all_perturbed: tuple[
        int, int, int
    ]  # cases with all thresholds moved at once; of these, answers changed by less, by more
    thresholds: dict[str, ThresholdSensitivity]


@cache
def read_sensitivity_table() -> SensitivityTable:
    """The table that is shipped."""
    said = json.loads((files(__package__) / "rooms.json").read_text(encoding="utf-8"))
    return SensitivityTable(
        script=said["script"],
        date=said["date"],
        case_sets=tuple(said["sets"]),
        changes_when_all_perturbed=(said["together"][0], said["together"][1], said["together"][2]),
        thresholds={k: ThresholdSensitivity.from_row(row) for k, row in said["rooms"].items()},
    )
