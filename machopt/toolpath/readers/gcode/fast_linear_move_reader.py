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

_NUMBER = r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))\s*"
_POINT = rf"(?:X{_NUMBER})?(?:Y{_NUMBER})?(?:Z{_NUMBER})?"
_ANGLES = rf"(?:A{_NUMBER})?(?:B{_NUMBER})?(?:C{_NUMBER})?"
_G = r"\s*(?:N[0-9]+\s*)?(?:G0?([01])(?![0-9.])\s*)?"
_FEED = rf"(?:F{_NUMBER})?"
# groups: G (0 or 1), X, Y, Z, A, B, C, three of the tool vector, F
PLAIN = re.compile(_G + _POINT + _ANGLES + rf"(?:I{_NUMBER})?(?:J{_NUMBER})?(?:K{_NUMBER})?" + _FEED, re.ASCII)
SIEMENS = re.compile(_G + _POINT + _ANGLES + rf"(?:A3\s*={_NUMBER}B3\s*={_NUMBER}C3\s*={_NUMBER})?" + _FEED, re.ASCII)
HEIDENHAIN = re.compile(
    rf"\s*(?:[0-9]+\s+)?()LN?\s+{_POINT}{_ANGLES}(?:NX[-+.0-9]+\s+NY[-+.0-9]+\s+NZ[-+.0-9]+\s*)?"
    rf"(?:TX{_NUMBER}TY{_NUMBER}TZ{_NUMBER})?(?:R0\s*)?{_FEED}",
    re.ASCII,
)
_COLUMNS = 7  # numbers of a point: x, y, z, tool axis, feed
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
    (x, y, z), (i, j, k) = r.p, r.axis
    motion, feed, fed_at, angles = r.motion or 0, r.feed, r.fed_at, r.setup.angles
    with_tcp, machine, vector = r.setup.tcp is not None, r.setup.machine, r.setup.vector
    takes_vectors = r.setup.tcp == "vector" or (with_tcp and pattern is not PLAIN)
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
        rate, fed_at = (feed, fed_at) if f is None else (float(f), at + 1)
        if new == 1 and not 0.0 < rate < math.inf:
            break
        if a is not None or b is not None or c is not None:
            turning = machine if with_tcp and vector is None else None
            turned = None if turning is None else _turn_axes(turning, angles, (a, b, c), cuts=bool(new))
            if turning is None or turned is None:
                break
            angles = turned
            i, j, k = turning.tool_axis(angles)
        if u is not None or v is not None or w is not None:
            tool_axis = _normalise_vector(u, v, w) if takes_vectors else None
            if tool_axis is None:
                break
            vector = i, j, k = tool_axis
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
    _add_last_points(r, numbers, places, has_corner=motion == 1 and not with_tcp)
    r.p, r.axis, r.motion, r.feed, r.fed_at = [x, y, z], (i, j, k), motion, feed, fed_at
    if angles is not r.setup.angles or vector is not r.setup.vector:
        r.setup = r.setup.with_changes(angles=angles, vector=vector)
    return at


def _normalise_vector(u: str | None, v: str | None, w: str | None) -> tuple[float, float, float] | None:
    """Return the unit vector of three numbers, None where it has no usable length."""
    x, y, z = float(u or 0.0), float(v or 0.0), float(w or 0.0)
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length) if _SHORTEST < length < _LONGEST else None


def _add_last_points(
    r: BlockMotionReader, numbers: list[float], places: list[tuple[int, int]], *, has_corner: bool
) -> None:
    """Add the collected points, and keep the last move where a corner may follow it."""
    r.out.add_many(numbers, places)
    if not places:
        return
    r.segment = None
    if has_corner:
        start = numbers[-2 * _COLUMNS :][:3] if len(places) > 1 else list(r.p)
        end, feed = numbers[-_COLUMNS:][:3], numbers[-1]
        r.segment = ContourSegment(start=np.array(start), end=np.array(end), first=len(r.out) - 1, feed=feed)
