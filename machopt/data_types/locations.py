"""Where something sits: ``joint:3``, ``joint:4-5``, ``link:2``, ``base``, ``tool``, ``sensor:force``, ``rows:7,9`` …

Files, results and keys hold the text; who needs its parts asks here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

JOINT, LINK, SENSOR, ROWS, COLUMN = "joint", "link", "sensor", "rows", "column"
BASE, TOOL, ARM = "base", "tool", "arm"


@dataclass(frozen=True)
class NamedLocation:
    """A place's parts."""

    kind: str  # one of this module's words; of a machine's own axes and of a user's own their word; empty: no place
    which: str = ""  # behind the colon: "3", "4-5", "force", "7,9"

    def __str__(self) -> str:
        return f"{self.kind}:{self.which}" if self.which else self.kind

    @property
    def numbers(self) -> tuple[int, ...]:
        """1-based numbers of a joint, a pair of joints or a link; of other places none."""
        words = self.which.split("-")
        return tuple(map(int, words)) if self.kind in (JOINT, LINK) and all(map(str.isdecimal, words)) else ()

    @property
    def is_joint_location(self) -> bool:
        """A joint or a pair of joints."""
        return self.kind == JOINT

    @property
    def is_row_location(self) -> bool:
        """A part of the recording's table: rows or columns."""
        return self.kind in (ROWS, COLUMN)


@lru_cache(maxsize=1024)
def parse_location(text: str) -> NamedLocation:
    """The parts of a location as files and results write it."""
    kind, _, which = text.partition(":")
    return NamedLocation(kind, which)


def parse_joint_location(text: str) -> tuple[int, int]:
    """0-based, of ``joint:4-5``: the joint that drives and the one that is moved; of ``joint:3`` itself twice.

    Raises:
        ValueError: another place.
    """
    place = parse_location(text)
    if not place.is_joint_location or not place.numbers:
        raise ValueError(f"{text} is neither a joint nor a pair of joints")
    return place.numbers[0] - 1, place.numbers[-1] - 1


def parse_link_location(text: str) -> int:
    """1-based, of ``link:3``.

    Raises:
        ValueError: another place.
    """
    place = parse_location(text)
    if place.kind != LINK or len(place.numbers) != 1:
        raise ValueError(f"{text} is no link")
    return place.numbers[0]


def format_joint_location(number: int) -> str:
    """``joint:3`` of a number from 1."""
    return str(NamedLocation(JOINT, str(number)))


def format_joint_pair_location(drives: int, moved: int) -> str:
    """``joint:4-5`` of numbers from 1."""
    return str(NamedLocation(JOINT, f"{drives}-{moved}"))


def format_link_location(number: int) -> str:
    """``link:3`` of a number from 1."""
    return str(NamedLocation(LINK, str(number)))


def format_sensor_location(channel: str) -> str:
    """``sensor:force``."""
    return str(NamedLocation(SENSOR, channel))


def format_rows_location(numbers: Iterable[int]) -> str:
    """``rows:7,9`` of data rows from 1."""
    return f"{ROWS}:{','.join(str(n) for n in numbers)}"


def format_column_location(name: str) -> str:
    """``column:fx_N``."""
    return f"{COLUMN}:{name}"
