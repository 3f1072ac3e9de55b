"""Attributes of a move that a program reader hands over, and the end of a program."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from machopt.file_formats.plain_decimals import is_plain

NO_TIME = math.nan


@dataclass(frozen=True, kw_only=True)
class MoveAttributes:
    """What a program states of a move beside its target."""

    feed: float = math.nan  # m/s; NaN where not given
    blend: float = 0.0  # m, blend distance at the end of the move; 0 for an exact stop
    time: float = NO_TIME  # s, time of the target
    external: Sequence[float] = ()  # values of the external axes as in the file; NaN for unused ones
    configuration: Mapping[str, object] | None = None  # names and values of the arm configuration; None: not given


NOTHING_GIVEN = MoveAttributes()


class ProgramEnd(Exception):  # noqa: N818  (no error: the program is over)
    """A statement ended the program."""


def parse_number(text: str) -> float | None:
    """Parse a finite number.

    Args:
        text: Text of the number.

    Returns:
        The number, None where the text is none.
    """
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and is_plain(text.strip()) else None
