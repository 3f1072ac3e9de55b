"""Speed of a FANUC move: a feed, a duration (sec, msec) or a turn in time (deg/sec), and the switches behind it."""

from __future__ import annotations

import math
import re

SPEED = re.compile(r"([0-9]*\.?[0-9]+)\s*(%|mm/sec|cm/min|inch/min|in/min|deg/sec|msec|sec)", re.IGNORECASE)
SWITCHES = re.compile(  # an output, a call or a statement at a time or distance before or after the target
    r"\b(?:T[AB]|D[AB]|(?:TIME|DISTANCE)\s+(?:BEFORE|AFTER))\s*-?[0-9]*\.?[0-9]+\s*(?:sec|mm)\s*,?\s*"
    r"(?:[A-Z]+\[[^\]]*\]\s*=\s*[\w.()]+|CALL\s+\w+\s*(?:\([^)]*\))?|P-SPS|POINT_LOGIC|[A-Z_]\w*(?:\[[^\]]*\])?)?",
    re.IGNORECASE,
)
_TO_M_S = {"mm/sec": 1e-3, "cm/min": 1e-2 / 60.0, "inch/min": 0.0254 / 60.0, "in/min": 0.0254 / 60.0}
_TO_S = {"sec": 1.0, "msec": 1e-3}
_STILL = 1e-6  # m: the tip does not move


class MoveSpeedError(ValueError):
    """The speed of a move is not in the file; the reader adds file and line."""


def parse_feed(text: str) -> tuple[float, str]:
    """Parse the speed of a move.

    Args:
        text: Text behind the position, without its switches.

    Returns:
        Feed in m/s, NaN where the speed is no feed; the text without the speed.
    """
    speed = SPEED.search(text)
    if speed is None:
        return math.nan, text
    factor = _TO_M_S.get(speed.group(2).lower(), math.nan)
    return float(speed.group(1)) * factor, text[: speed.start()] + text[speed.end() :]


def compute_feed_of_duration(text: str, way: float | None, before: float) -> float | None:
    """Compute the feed of a straight move whose speed is a duration or a turn in time.

    Args:
        text: Text behind the position.
        way: Distance that the tip moves, m; None where the file does not state its start or its end.
        before: Feed of the move before, m/s; that of a move whose tip is at rest.

    Returns:
        Feed in m/s; NaN where the way is not known; None where the speed is of another kind.

    Raises:
        MoveSpeedError: no duration, or a turn in time while the tip moves.
    """
    speed = SPEED.search(SWITCHES.sub(" ", text))
    unit = "" if speed is None else speed.group(2).lower()
    if speed is None or (unit not in _TO_S and unit != "deg/sec"):
        return None
    if not float(speed.group(1)) > 0.0:
        raise MoveSpeedError(f"{speed.group()}: expected more than zero")
    if way is None:
        return math.nan
    if way <= _STILL:
        return before
    if unit == "deg/sec":
        raise MoveSpeedError(
            f"{speed.group()}: the speed of the turn alone, while the tip moves {way * 1e3:.4g} mm; mm/sec would work"
        )
    return way / (float(speed.group(1)) * _TO_S[unit])


def refuse_duration(text: str) -> None:
    """Refuse a duration as the speed of an arc, whose length follows from three points.

    Args:
        text: Text behind the position.

    Raises:
        MoveSpeedError: the speed is a duration or a turn in time.
    """
    speed = SPEED.search(SWITCHES.sub(" ", text))
    if speed is not None and (speed.group(2).lower() in _TO_S or speed.group(2).lower() == "deg/sec"):
        raise MoveSpeedError(f"{speed.group()} of a circular move is not read; mm/sec, cm/min or inch/min would work")
