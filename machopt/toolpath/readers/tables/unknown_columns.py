"""Unknown columns of a point table: detection of those that may move points or frames.

A length, an angle or a frame in a row may shift or rotate its point. Labels, counts and process data cannot.
"""

from __future__ import annotations

import re

_PROCESS = "a size of the tool, the hole or the stack"
_RESULT = "a result of a plan, written beside its points"
_PLACE_ON_PATH = "how far along the path the point is"

REVIEWED: dict[str, str] = {  # columns with a unit that move nothing, without the unit
    **dict.fromkeys(
        ("diameter", "tool_diameter", "cutter_diameter", "corner_radius", "tool_length", "thickness", "stack", "grip"),
        _PROCESS,
    ),
    **dict.fromkeys(("countersink", "countersink_depth", "pitch", "stickout", "ae", "ap", "point_angle"), _PROCESS),
    **dict.fromkeys(("s", "length", "distance", "arc_length", "station"), _PLACE_ON_PATH),
    **dict.fromkeys(
        (
            "gamma",
            "deflection",
            "clearance",
            "limit_margin",
            "singularity",
            "error_along",
            "error_across",
            "error_axis",
        ),
        _RESULT,
    ),
}
_JOINT = re.compile(r"[qe][0-9]+")  # joint values of a result
_UNIT_WORD = re.compile(r"(.+)_(?:mm|inch|in|cm|m|deg|rad)")
_FRAME = re.compile(
    r"(?:^|_)(?:u?frame|wcs|csys|base|origin|shift|offset|mirror|scale|rotation|rotate|transform|matrix|wobj|plane|datum|"
    r"tilt|incremental)(?:_|[0-9]|$)"
)


def is_point_moving_column(column: str) -> bool:
    """Return whether an unknown column may shift, turn or scale the points of its row.

    Args:
        column: Name of the column.
    """
    name = column.strip().lower()
    found = _UNIT_WORD.fullmatch(name)
    plain = found.group(1) if found else name
    if plain in REVIEWED or _JOINT.fullmatch(plain):
        return False
    return found is not None or _FRAME.search(name) is not None
