"""Heidenhain's drilling cycles as stroke plans: 1, 2, 17, 200 to 209, 240 and 241.

Heights are in mm over the program's z = 0. Pecks and chip breaks are those of Heidenhain's manual of cycles (TNC 640,
"Cycles for drilling"): 203 and 205 with decrement Q212, 205 with chip breaks Q257 and a pre-drilled hole Q379, 209 with
chip breaks Q257.
"""

from __future__ import annotations

import math
from typing import Any

from machopt.path_building.back_boring import BackBoringCycle
from machopt.path_building.drilling_cycles import DrillingCycle, DrillingCycleError

_RAPID = 99999.0  # MAX or FMAX as a feed
_SIDES = {1: (-1.0, 0.0, 0.0), 2: (0.0, -1.0, 0.0), 3: (1.0, 0.0, 0.0), 4: (0.0, 1.0, 0.0)}  # Q214
SUPPORTED = (1, 2, 17, 200, 201, 202, 203, 204, 205, 206, 207, 209, 240, 241)
_NOT_NEGATIVE = {  # the control takes no negative number for them
    200: "set-up clearance",
    202: "plunging depth",
    204: "second set-up clearance",
    205: "least plunging depth",
    206: "feed",
    208: "feed of the way out",
    210: "dwell at the top",
    211: "dwell at depth",
    212: "decrement",
    213: "number of chip breaks",
    253: "feed of the way to the start",
    256: "retraction for a chip break",
    257: "depth between chip breaks",
    258: "upper advanced stop distance",
    259: "lower advanced stop distance",
    379: "depth of the start",
    403: "factor of the speed of the way out",
}
_PECKING = (200, 203, 205)  # cycles with Q202
_OLD_WORDS = {
    "DIST": "SETUP",
    "SETUP": "SETUP",
    "DEPTH": "DEPTH",
    "PLNGNG": "PECK",
    "PECKG": "PECK",
    "PECKING": "PECK",
    "DWELL": "DWELL",
    "F": "F",
    "PITCH": "PITCH",
}
OLD_WORD = r"(DIST|SET ?UP|DEPTH|PLNGNG|PECKG|PECKING|DWELL|PITCH|F)"


def normalise_old_cycle_word(text: str) -> str:
    """Return the standard name of a line of cycles 1, 2 and 17, independent of the software version.

    Args:
        text: Word of the line.

    Returns:
        The standard name.
    """
    return _OLD_WORDS[text.replace(" ", "")]


def build_old_cycle(number: int, words: dict[str, float], height: float, scale: float, rpm: float) -> DrillingCycle:
    """Cycles 1 (pecking), 2 (tapping) and 17 (rigid tapping): the tool is at the set-up clearance when called.

    Args:
        number: of the cycle.
        words: its lines, see :func:`normalise_old_cycle_word`, in the program's unit.
        height: Height of the tool, mm.
        scale: mm per program unit.
        rpm: 1/min of the spindle.
    Raises:
        DrillingCycleError: clearance or depth is missing.
    """
    if "SETUP" not in words or "DEPTH" not in words:
        raise DrillingCycleError(f"cycle {number} without set-up clearance or depth")
    if words["DEPTH"] > 0.0:
        raise DrillingCycleError(_is_upward_depth("DEPTH", words["DEPTH"]))
    top = height - abs(words["SETUP"]) * scale
    feed = words.get("F", math.nan) if number != 17 else abs(words.get("PITCH", math.nan)) * rpm
    return DrillingCycle(
        name=f"CYCL {number}",
        bottom=top - abs(words["DEPTH"]) * scale,
        surface=top,
        clear=height,
        retract=height,
        feed=feed * scale,
        first_peck=abs(words.get("PECK", 0.0)) * scale if number == 1 else 0.0,
        feed_out=number in (2, 17),
        dwell=words.get("DWELL", 0.0),
        peck_from=top,
    )


def build_q_cycle(number: int, q: dict[int, float], scale: float, rpm: float) -> DrillingCycle:
    """Build cycles 200 … 209, 240 and 241 from their Q parameters (lengths in program units).

    Args:
        number: Number of the cycle.
        q: Q number → value.
        scale: mm per unit of the program.
        rpm: Spindle speed, 1/min.

    Returns:
        The drilling cycle, heights over z = 0 in mm.

    Raises:
        DrillingCycleError: a parameter is missing, or the depth depends on a diameter.
    """
    if number == 204:
        return _build_back_boring(q, scale)
    if number == 240 and q.get(343, 0.0) == 1.0:
        raise DrillingCycleError("cycle 240 with Q343=1 takes its depth from the tool's point angle: not in the file")
    if 201 not in q or 200 not in q:
        raise DrillingCycleError(f"cycle {number} without Q200 (clearance) or Q201 (depth)")
    _check_signs(number, q)
    if q[201] > 0.0:
        raise DrillingCycleError(_is_upward_depth("Q201", q[201]))
    top = q.get(203, 0.0) * scale
    clear = top + q[200] * scale
    feed = q.get(206, math.nan)
    if number in (207, 209):
        feed = abs(q.get(239, math.nan)) * rpm
    if not feed > 0.0:
        feed = math.nan  # none, or a pitch of zero: the default feed is required
    if q.get(395, 0.0) != 0.0:
        raise DrillingCycleError(
            f"cycle {number} with Q395=1 counts its depth without the tool's point, whose length is not in the file"
        )
    pitch = abs(q.get(239, 0.0))
    back_feed = q.get(208)
    feed_out = number in (201, 202, 206, 207, 209) or (number in (203, 205, 241) and back_feed is not None)
    if back_feed is not None and back_feed >= _RAPID:
        feed_out, back_feed = number in (206, 207, 209), None
    return DrillingCycle(
        name=f"CYCL {number}",
        bottom=top - abs(q[201]) * scale,
        surface=top,
        clear=clear,
        retract=max(top + q.get(204, q[200]) * scale, clear),
        feed=feed * scale,
        feed_out=feed_out,
        feed_back=_compute_feed_back(number, feed, back_feed, q) * scale,
        dwell=q.get(211, 0.0),
        synchronous=number == 209,
        **_list_pecks(number, q, scale, top),
        gap=q.get(258 if number == 205 else 256, 0.0) * (pitch if number == 209 else 1.0) * scale or 1.0,
        gap_last=q[259] * scale if number == 205 and q.get(259) and q.get(258) else None,
    )


def _check_signs(number: int, q: dict[int, float]) -> None:
    """Refuse what the control refuses: a negative distance, time or feed, and a plunging depth of zero.

    Source: Heidenhain, TNC 426/430, User's Manual, 8.3 "Cycles for Drilling": Q202, Q256, Q257 and Q258 are incremental
    distances; one movement goes to depth where Q202 equals or exceeds it, and Q257=0 breaks no chips.
    """
    for name, meaning in _NOT_NEGATIVE.items():
        if q.get(name, 0.0) < 0.0:
            raise DrillingCycleError(f"cycle {number} with Q{name}={q[name]:g} ({meaning}): expected 0 or more")
    if number in _PECKING and q.get(202) == 0.0:
        raise DrillingCycleError(
            f"cycle {number} with Q202=0 (plunging depth): expected a number above zero, {abs(q[201]):g} for one stroke"
        )


def _compute_feed_back(number: int, feed: float, back_feed: float | None, q: dict[int, float]) -> float:
    """Feed of the way out, units/min; NaN: that of the way in."""
    if number in (201, 202, 203, 205, 241) and back_feed is not None and back_feed > 0.0:
        return back_feed
    if number == 209 and q.get(403, 0.0) > 0.0:  # a factor for the speed of the way out
        return feed * q[403]
    return math.nan


def _list_pecks(number: int, q: dict[int, float], scale: float, top: float) -> dict[str, Any]:
    """Fields of the drilling cycle that say where it stops on its way down."""
    fields: dict[str, Any] = {"peck_from": top}
    if number in (205, 241) and q.get(379, 0.0) != 0.0:
        start_feed = q.get(253, math.nan)
        fields["start"] = fields["peck_from"] = top - q[379] * scale
        fields["start_feed"] = start_feed * scale if 0.0 < start_feed < _RAPID else math.nan
    if number in (200, 203, 205):
        fields["first_peck"] = q.get(202, 0.0) * scale
    if number in (203, 205):
        fields["decrement"] = q.get(212, 0.0) * scale
        fields["least_peck"] = q.get(205, 0.0) * scale
    if number == 203 and q.get(213, 0.0) > 0.0:
        fields["chip_break"], fields["breaks_before_out"] = True, round(q[213])
    if number == 205 and q.get(257, 0.0) > 0.0:
        fields["break_every"] = q[257] * scale
        fields["break_gap"] = q.get(256, 0.0) * scale
    if number == 209 and q.get(257, 0.0) > 0.0:
        fields["first_peck"], fields["chip_break"] = q[257] * scale, q.get(256, 0.0) != 0.0
    return fields


def _is_upward_depth(word: str, depth: float) -> str:
    """Its sign says which way a cycle drills; controls stop at a positive one, or turn the hole upwards."""
    return (
        f"{word}={depth:g}: a positive depth drills upwards, where the control does not stop at it; expected {-depth:g}"
    )


def _build_back_boring(q: dict[int, float], scale: float) -> BackBoringCycle:
    """Cycle 204: Q249 depth, Q250 thickness of the part, Q251 off-centre distance, Q252 height of the edge.

    The tool length counts to the lower end of the bar, Q252 below the edge.
    """
    missing = [f"Q{n}" for n in (200, 249, 250, 251, 252, 214) if n not in q]
    if missing:
        raise DrillingCycleError(f"cycle 204 without {', '.join(missing)}")
    for name in (200, 250, 251, 252, 253, 254, 255):
        if q.get(name, 0.0) < 0.0:
            raise DrillingCycleError(f"cycle 204 with Q{name}={q[name]:g}: expected 0 or more")
    if not q[249] > 0.0:
        raise DrillingCycleError(f"Q249={q[249]:g}: expected a depth above zero, which is bored upwards")
    side = _SIDES.get(round(q[214]))
    if side is None:
        raise DrillingCycleError(f"Q214={q[214]:g}: expected 1 to 4, the direction off the axis")
    top = q.get(203, 0.0) * scale
    clear = top + q[200] * scale
    lower = top - (abs(q[250]) + abs(q[252])) * scale  # of the bar while its edge is at the lower side of the part
    feed, position = q.get(254, math.nan), q.get(253, math.nan)
    return BackBoringCycle(
        name="CYCL 204",
        bottom=lower - q[200] * scale,
        top=lower + q[249] * scale,
        sideways=(side[0] * q[251] * scale, side[1] * q[251] * scale, 0.0),
        clear=clear,
        retract=max(top + q.get(204, q[200]) * scale, clear),
        feed=feed * scale if feed > 0.0 else math.nan,
        position_feed=position * scale if 0.0 < position < _RAPID else math.nan,
        dwell=q.get(255, 0.0),
    )
