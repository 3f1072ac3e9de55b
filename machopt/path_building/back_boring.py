"""Back boring: a bar with one edge goes through a hole beside its axis and cuts upwards from below the part."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.path_building.drilling_cycles import DrillingCycle, DrillingCycleError, go_over_hole
from machopt.path_building.point_collector import PathBuilder, Vector


@dataclass(frozen=True, kw_only=True)
class BackBoringCycle(DrillingCycle):
    """Heights of the lower end of the bar, mm; ``bottom`` is the lowest one, ``feed`` that of the cut upwards."""

    top: float  # where the cut upwards ends
    sideways: Vector  # the shift off the axis in the program's coordinates, mm
    position_feed: float  # mm/min of the ways through the hole; NaN: rapid


def append_back_boring_moves(
    builder: PathBuilder,
    cycle: BackBoringCycle,
    places: tuple[Vector, Vector],
    axis: Vector,
    line: int,
    before: Vector | None,
) -> float:
    """Append the moves of one back-boring cycle.

    To the side, through the hole, onto its axis, the cut upwards, and the same way back.

    Args:
        builder: Path builder that takes the moves.
        cycle: The cycle.
        places: Reference point of the hole, and that point shifted to the side, mm.
        axis: Tool axis, unit vector.
        line: Line number in the file (1-based).
        before: Tool tip before the hole in mm, None where not known.

    Returns:
        Height of the tip over the reference point afterwards, mm.

    Raises:
        DrillingCycleError: the cut does not lead upwards, or it starts above the clearance height.
    """
    if not cycle.bottom < cycle.top or not cycle.bottom < cycle.clear:
        raise DrillingCycleError(f"{cycle.name}: the cut from {cycle.bottom:g} to {cycle.top:g} mm leads not upwards")
    go_over_hole(builder, cycle, places[0], axis, line, before)
    nan, slow = math.nan, cycle.position_feed
    for aside, height, move, feed in (
        (1, cycle.clear, MoveKind.RAPID, nan),
        (1, cycle.bottom, MoveKind.APPROACH, slow),
        (0, cycle.bottom, MoveKind.APPROACH, slow),
        (0, cycle.top, MoveKind.CUT, cycle.feed),
        (0, cycle.bottom, MoveKind.RETRACT, slow),
        (1, cycle.bottom, MoveKind.RETRACT, slow),
        (1, cycle.clear, MoveKind.RETRACT, slow),
        (0, cycle.clear, MoveKind.RAPID, nan),
    ):
        x, y, z = (np.array(places[aside]) + height * np.array(axis)).tolist()
        builder.add((x, y, z), axis, move, feed, line, cycle=True)
        if move == MoveKind.CUT and not cycle.dwell <= 0.0:
            builder.event("dwell", cycle.name, cycle.dwell)
    if cycle.retract is None or cycle.retract <= cycle.clear:
        return cycle.clear
    x, y, z = (np.array(places[0]) + cycle.retract * np.array(axis)).tolist()
    builder.add((x, y, z), axis, MoveKind.RAPID, nan, line, cycle=True)
    return cycle.retract
