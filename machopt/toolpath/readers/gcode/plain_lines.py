"""Fast path for long programs: reads many plain ``G1 X Y Z A B C F`` lines at a time.

Only lines that change nothing but coordinates and feed are read here. All other lines go to the general reader.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.path_building.rotary_axes import RotaryMachine
from machopt.path_building.rotary_moves import SMALL_TURN_DEG
from machopt.toolpath.readers.gcode.block_motion import BlockMotionReader
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourSegment
from machopt.toolpath.readers.gcode.geometry.coordinate_setup import list_turned_angles

_NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*"
_POINT = rf"(?:X{_NUMBER})?(?:Y{_NUMBER})?(?:Z{_NUMBER})?"
_ANGLES = rf"(?:A{_NUMBER})?(?:B{_NUMBER})?(?:C{_NUMBER})?"
_G = r"\s*(?:N\d+\s*)?(?:G0?([01])(?![\d.])\s*)?"
_FEED = rf"(?:F{_NUMBER})?"
# groups: G (0 or 1), X, Y, Z, A, B, C, three of the tool vector, F
PLAIN = re.compile(_G + _POINT + _ANGLES + rf"(?:I{_NUMBER})?(?:J{_NUMBER})?(?:K{_NUMBER})?" + _FEED, re.ASCII)
SIEMENS = re.compile(_G + _POINT + _ANGLES + rf"(?:A3\s*={_NUMBER}B3\s*={_NUMBER}C3\s*={_NUMBER})?" + _FEED, re.ASCII)
HEIDENHAIN = re.compile(
    rf"\s*(?:\d+\s+)?()LN?\s+{_POINT}{_ANGLES}(?:NX[-+.\d]+\s+NY[-+.\d]+\s+NZ[-+.\d]+\s*)?"
    rf"(?:TX{_NUMBER}TY{_NUMBER}TZ{_NUMBER})?(?:R0\s*)?{_FEED}",
    re.ASCII,
)
_AT_ONCE = 50_000  # points collected before they are added
_SHORTEST, _LONGEST = 1e-6, 1e9  # tool vectors


def is_plain_line_mode(r: BlockMotionReader) -> bool:
    """Return whether the modes let plain lines be carried out by :func:`read_plain_lines`.

    Args:
        r: The reader, whose modes are checked.
    """
    s = r.setup
    return bool(
        r.motion in (0, 1)
        and (r.unit_used_at or not r.unit_by_words)
        and r.canned is None
        and r.modal_call is None
        and not r.incremental
        and r.corner is None
        and r.modal_corner is None
        and not r.polar.on
        and r.feed_mode == "minute"
        and not r.feed_outlives_its_unit()
        and s.transfer is None
        and not s.tilted
        and s.tcp != "spatial"
        and not s.missing_place_reason
        and not s.left_tilted_plane
        and (s.tcp is not None or not list_turned_angles(s.angles))
        and not any(map(math.isnan, r.p))
    )


def _turn_axes(
    machine: RotaryMachine, angles: Mapping[str, float], texts: tuple[str | None, str | None, str | None], *, cuts: bool
) -> dict[str, float] | None:
    """Return the angles in deg with the words A, B and C of a line; None where the general reader has to read it."""
    given = {n: float(v) for n, v in zip("ABC", texts, strict=True) if v is not None}
    if not given.keys() <= set(machine.letters):
        return None
    if cuts and sum(abs(v - angles.get(n, 0.0)) for n, v in given.items()) > SMALL_TURN_DEG:
        return None  # divided along the path of the rotary axes
    return {**angles, **given}


def read_plain_lines(r: BlockMotionReader, at: int, pattern: re.Pattern[str] = PLAIN, *, linear: bool = False) -> int:
    """Carry out plain lines from index ``at`` on; returns the index of the first one that is not.

    Args:
        r: the reader, whose modes :func:`is_plain_line_mode` has checked.
        at: index of a line.
        pattern: what a plain line is, one of those above.
        linear: lines without a G word are feed moves, whatever the one before was.
    """
    lines, match, scale = r.source.lines, pattern.fullmatch, r.scale
    per_feed, same_feed_unit = r.feed_scale, r.feed_scale == r.feed_unit
    x, y, z = r.p
    motion, feed, fed_at, angles = r.motion or 0, r.feed, r.fed_at, r.setup.angles
    with_tcp, machine, vector = r.setup.tcp is not None, r.setup.machine, r.setup.vector
    takes_vectors = r.setup.tcp == "vector" or (with_tcp and pattern is not PLAIN)
    i, j, k = r.axis
    numbers: list[float] = []
    places: list[tuple[int, int]] = []
    extend, append = numbers.extend, places.append
    while at < len(lines):
        found = match(lines[at])
        if found is None:
            break
        g, xs, ys, zs, a, b, c, u, v, w, f = found.groups()
        new = int(g) if g else (1 if linear else motion)
        if with_tcp and new != motion:
            break  # plunges after a rapid are kept for the check of the rotary signs
        if (xs is None and ys is None and zs is None) or (f is not None and (new == 0 or not same_feed_unit)):
            break
        rate = feed
        if f is not None:
            rate, fed_at = float(f), at + 1
        if new == 1 and not 0.0 < rate < math.inf:
            break
        if a is not None or b is not None or c is not None:
            if not with_tcp or machine is None or vector is not None:
                break
            turned = _turn_axes(machine, angles, (a, b, c), cuts=bool(new))
            if turned is None:
                break
            angles = turned
            i, j, k = machine.tool_axis(angles)
        if u is not None or v is not None or w is not None:
            x1, y1, z1 = float(u or 0.0), float(v or 0.0), float(w or 0.0)
            length = math.sqrt(x1 * x1 + y1 * y1 + z1 * z1)
            if not takes_vectors or not _SHORTEST < length < _LONGEST:
                break
            vector = i, j, k = x1 / length, y1 / length, z1 / length
        x = x if xs is None else float(xs) * scale
        y = y if ys is None else float(ys) * scale
        z = z if zs is None else float(zs) * scale
        motion, feed = new, rate
        at += 1
        extend((x, y, z, i, j, k, feed * per_feed if new else math.nan))
        append((MoveKind.CUT.value if new else MoveKind.RAPID.value, at))
        if len(places) >= _AT_ONCE:
            r.out.add_many(numbers, places)
            numbers.clear()
            places.clear()
    r.out.add_many(numbers, places)
    if places:
        before = numbers[-14:-11] if len(places) > 1 else list(r.p)
        has_corner = motion == 1 and not with_tcp  # a corner may follow
        r.segment = _build_last_segment(r, before, [x, y, z], feed * per_feed) if has_corner else None
    r.p, r.axis, r.motion, r.feed, r.fed_at = [x, y, z], (i, j, k), motion, feed, fed_at
    if angles is not r.setup.angles or vector is not r.setup.vector:
        r.setup = r.setup.with_changes(angles=angles, vector=vector)
    return at


def _build_last_segment(r: BlockMotionReader, start: list[float], end: list[float], feed: float) -> ContourSegment:
    return ContourSegment(start=np.array(start), end=np.array(end), first=len(r.out) - 1, feed=feed)
