"""Heidenhain's drilling cycles as stroke plans: 1, 2, 17, 200 to 209, 240 and 241.

Heights are in mm over the program's z = 0.
"""

from __future__ import annotations

import math

from machopt.path_building.drilling_cycles import DrillingCycle, DrillingCycleError

_IGNORED = {203: (212,), 205: (212, 257, 379), 209: (257,), 204: (254,)}  # shorter pecks, chip breaking, recessed start
SUPPORTED = (1, 2, 17, 200, 201, 202, 203, 204, 205, 206, 207, 209, 240, 241)
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
    if q[201] > 0.0:
        raise DrillingCycleError(_is_upward_depth("Q201", q[201]))
    top = q.get(203, 0.0) * scale
    clear = top + q[200] * scale
    feed = q.get(206, math.nan)
    if number in (207, 209):
        feed = abs(q.get(239, math.nan)) * rpm
    if not feed > 0.0:
        feed = math.nan  # none, or a pitch of zero: the default feed is required
    peck = q.get(202, 0.0) if number in (200, 203, 205) else 0.0
    return DrillingCycle(
        name=f"CYCL {number}",
        bottom=top - abs(q[201]) * scale,
        surface=top,
        clear=clear,
        retract=max(top + q.get(204, q[200]) * scale, clear),
        feed=feed * scale,
        first_peck=max(peck, 0.0) * scale,
        chip_break=(number == 203 and q.get(213, 0.0) > 0.0) or number == 209,
        gap=abs(q.get(256, 0.0)) * scale or 1.0,
        feed_out=number in (201, 202, 206, 207, 209),
        feed_back=q[208] * scale if number in (201, 202) and q.get(208, 0.0) > 0.0 else math.nan,
        dwell=q.get(211, 0.0),
        peck_from=top,
    )


def list_ignored_parameters(number: int, q: dict[int, float]) -> list[str]:
    """Return the Q parameters of a cycle that are stated, change its strokes, and are not carried out.

    Args:
        number: Number of the cycle.
        q: Q number → value.
    """
    return [f"Q{name}" for name in _IGNORED.get(number, ()) if q.get(name, 0.0) != 0.0]


def _is_upward_depth(word: str, depth: float) -> str:
    """Its sign says which way a cycle drills; controls stop at a positive one, or turn the hole upwards."""
    return (
        f"{word}={depth:g}: a positive depth drills upwards, where the control does not stop at it; expected {-depth:g}"
    )


def _build_back_boring(q: dict[int, float], scale: float) -> DrillingCycle:
    """Cycle 204 as the stroke down to below the part and the cut upwards; the lateral step is left out."""
    if 200 not in q or 249 not in q:
        raise DrillingCycleError("cycle 204 without Q200 (clearance) or Q249 (depth of the counterbore)")
    top = q.get(203, 0.0) * scale
    clear = top + q[200] * scale
    below = top - (abs(q.get(250, 0.0)) + abs(q.get(252, 0.0)) + q[200]) * scale
    return DrillingCycle(
        name="CYCL 204",
        bottom=below,
        clear=clear,
        retract=max(top + q.get(204, q[200]) * scale, clear),
        feed=(q.get(253, 0.0) or q.get(254, 0.0) or math.nan) * scale,
        feed_out=True,
        dwell=q.get(255, 0.0),
        peck_from=top,
    )
