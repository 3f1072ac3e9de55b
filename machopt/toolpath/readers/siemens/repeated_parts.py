"""REPEAT and REPEATB of Sinumerik programs: the part of the program that is carried out again."""

from __future__ import annotations

import re
from dataclasses import dataclass

REPEAT = re.compile(
    r"REPEAT(B?)\s+([A-Z_]\w*)(?:\s+(?!P\s*=|P\s*[0-9])([A-Z_]\w*))?(?:\s+P\s*(?:=\s*(.+?)|([0-9]+)))?\s*"
)
MAX_REPEATS = 9999


@dataclass
class RepeatedPart:
    """A part that is being repeated."""

    first: int  # places
    last: int
    left: int  # repeats after this one
    back: int  # place to go on at
    depth: int  # number of calls under way


def find_part(block: bool, begins: list[int], ends: list[int], marks: list[int], at: int) -> tuple[int, int] | str:
    """Find the part that a REPEAT means.

    The first label is looked for backwards, then forwards. Without a second label the part ends at the next ENDLABEL,
    else in front of the REPEAT itself (Siemens, Programming Manual Job Planning: program part repetition).

    Args:
        block: REPEATB: one block.
        begins: Places of the first label in this program.
        ends: Places of the second label; empty where there is none.
        marks: Places of ENDLABEL.
        at: Place of the REPEAT.

    Returns:
        First and last place of the part; a text that says why there is none.
    """
    order = [k for k in reversed(begins) if k < at] + [k for k in begins if k > at]
    if not order:
        return "its label is not in this program"
    first = order[0]
    if block:
        return first, first
    stop = next((k for k in (ends or marks) if k >= first), None)
    if ends and stop is None:
        return "its second label does not follow the first one"
    last = at - 1 if stop is None or (not ends and first < at < stop) else stop
    if stop is None and first > at:
        return "its label lies ahead, so the part needs an end: expected a second label, or ENDLABEL: behind the label"
    if last < first or first <= at <= last:
        return "the part between its two labels contains the REPEAT itself; expected an end before or behind it"
    return first, last
