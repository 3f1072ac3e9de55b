"""Locations of effects and faults: ``joint:3``, ``joint:4-5``, ``link:2``, ``base``, ``tool``, ``sensor:force``,
``rows:7,9`` ….

Files, results and keys hold the text; this module parses and formats it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

JOINT, LINK, SENSOR, ROWS, COLUMN = "joint", "link", "sensor", "rows", "column"
BASE, TOOL, ARM = "base", "tool", "arm"
MOST_JOINTS = 12  # most joints of an arm whose readings are diagnosed; six where it is planned for


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
    """Return the parts of a location.

    Args:
        text: The location as files and results write it.
    """
    kind, _, which = text.partition(":")
    return NamedLocation(kind, which)


def parse_joint_location(text: str) -> tuple[int, int]:
    """Return the 0-based joints of ``joint:4-5``: the driving and the driven one; of ``joint:3`` the same joint
    twice.

    Args:
        text: The location.

    Raises:
        ValueError: the location is no joint.
    """
    place = parse_location(text)
    if not place.is_joint_location or not place.numbers:
        raise ValueError(f"{text} is neither a joint nor a pair of joints")
    return place.numbers[0] - 1, place.numbers[-1] - 1


def parse_link_location(text: str) -> int:
    """Return the 1-based link of ``link:3``.

    Args:
        text: The location.

    Raises:
        ValueError: the location is no link.
    """
    place = parse_location(text)
    if place.kind != LINK or len(place.numbers) != 1:
        raise ValueError(f"{text} is no link")
    return place.numbers[0]


def is_on_arm(text: str, joints: int) -> bool:
    """Return whether an arm with a number of joints has a place; True for places without a number.

    Args:
        text: The location.
        joints: Number of joints of the arm.
    """
    return max(parse_location(text).numbers, default=0) <= joints


def format_joint_location(number: int) -> str:
    """Return ``joint:3``.

    Args:
        number: The joint, counted from 1.
    """
    return str(NamedLocation(JOINT, str(number)))


def format_joint_pair_location(drives: int, moved: int) -> str:
    """Return ``joint:4-5``.

    Args:
        drives: The driving joint, counted from 1.
        moved: The driven joint, counted from 1.
    """
    return str(NamedLocation(JOINT, f"{drives}-{moved}"))


def format_link_location(number: int) -> str:
    """Return ``link:3``.

    Args:
        number: The link, counted from 1.
    """
    return str(NamedLocation(LINK, str(number)))


def format_sensor_location(channel: str) -> str:
    """Return ``sensor:force``.

    Args:
        channel: Name of the channel.
    """
    return str(NamedLocation(SENSOR, channel))


def format_rows_location(numbers: Iterable[int]) -> str:
    """Return ``rows:7,9``.

    Args:
        numbers: Data rows, counted from 1.
    """
    return f"{ROWS}:{','.join(str(n) for n in numbers)}"


def format_column_location(name: str) -> str:
    """Return ``column:fx_N``.

    Args:
        name: Name of the column.
    """
    return f"{COLUMN}:{name}"
