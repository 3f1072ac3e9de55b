"""Fast path for long cutter location files: reads many plain ``GOTO/x,y,z[,i,j,k]`` lines at a time."""

from __future__ import annotations

import math

from machopt.data_types.toolpath import MoveKind
from machopt.file_formats.plain_decimals import LARGEST, is_plain
from machopt.toolpath.readers.apt.motion_statements import AptMotionReader

_AT_ONCE = 50_000  # points collected before they are added


def is_plain_goto_mode(r: AptMotionReader) -> bool:
    """Return whether only position and tool axis change from one GOTO to the next.

    Args:
        r: The reader, whose state is updated.
    """
    return (
        not r.ended
        and not r.rapid
        and r.cycle is None
        and r.curves.pending is None
        and not r.curves.spline_open
        and r.transfer is None
        and not r.away
        and not r.rotations
        and r.cut_rotation is None
        and r.feed_mm_min() > 0.0
    )


def read_plain_gotos(r: AptMotionReader, at: int) -> int:
    """Carry out plain GOTO lines.

    Args:
        r: The reader, whose state is updated.
        at: Index of the first line.

    Returns:
        Index of the first line that is no plain GOTO.
    """
    lines, scale, feed, cut = r.source.lines, r.scale, r.feed_mm_min(), MoveKind.CUT.value
    i, j, k = r.axis
    x, y, z = r.position or (math.nan, math.nan, math.nan)
    numbers: list[float] = []
    places: list[tuple[int, int]] = []
    extend, append = numbers.extend, places.append
    first, end = at, len(lines)
    while at < end:
        text = lines[at]
        if not text.startswith("GOTO"):
            break
        parts = text[5:].split(",") if text[4:5] == "/" else text.partition("/")[2].split(",")
        if not is_plain(text) or (text[4:5] != "/" and text[4 : text.find("/")].strip()):
            break
        try:
            if len(parts) == 3:
                a, b, c = float(parts[0]), float(parts[1]), float(parts[2])
                ni, nj, nk = i, j, k
            elif len(parts) == 6:
                a, b, c, ni, nj, nk = map(float, parts)
            else:
                break
        except ValueError:
            break
        if not abs(a) + abs(b) + abs(c) + abs(ni) + abs(nj) + abs(nk) < LARGEST:
            break
        x, y, z, i, j, k = a * scale, b * scale, c * scale, ni, nj, nk
        at += 1
        extend((x, y, z, i, j, k, feed))
        append((cut, at))
        if len(places) >= _AT_ONCE:
            r.out.add_many(numbers, places)
            numbers.clear()
            places.clear()
    r.out.add_many(numbers, places)
    if at > first:
        r.position, r.axis = (x, y, z), (i, j, k)
    return at
