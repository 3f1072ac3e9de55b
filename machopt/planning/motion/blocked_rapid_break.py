"""Break of the sequence where a rapid move between two rest poses is blocked."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.numerics.array_types import Array
from machopt.planning.motion.rapid_moves import UNDER, BlockedRapid
from machopt.planning.motion.search_budget import EXTENSIONS, is_used_up
from machopt.planning.pipeline.sequence_breaks import SequenceBreak, describe_place


@dataclass(frozen=True)
class RestPose:
    """Pose of the machine at rest between two stretches."""

    x: Array  # (6 + E,) rad or m, true angles
    index: float  # along the toolpath, NaN at home
    row: int  # planning point, −1 at home
    change: bool = False  # tools are changed there

    @property
    def name(self) -> str:
        """Description of the place."""
        return "the tool change" if self.change else describe_place(self.index)


def build_blocked_break(move: BlockedRapid, a: RestPose, b: RestPose) -> SequenceBreak:
    """Build the break of a sequence at a rapid move that is blocked.

    Args:
        move: The blocked rapid move.
        a: Rest pose before it.
        b: Rest pose behind it.

    Returns:
        The break, with reason and advice.
    """
    at = a if move.reason == "start" else b
    name, key = ("tool change", "robot.tool_change_deg") if at.change else ("home", "robot.home_deg")
    if move.reason != "way" and at.row < 0:
        return SequenceBreak(
            before=a.index,
            after=b.index,
            code="home_collides",
            text=f"{move.pair} touch or come nearer than the clearance at the {name} pose",
            help=f"another {name} pose ({key}), or moving what is there, would help",
            pair=move.pair,
        )
    if move.reason != "way":
        return SequenceBreak(
            before=a.index,
            after=b.index,
            code="rapid_collides",
            text=f"{move.pair} touch or come nearer than the clearance at the "
            f"{move.reason} of the rapid move, at {describe_place(at.index)}",
            help="an approach or retract to a place clear of the part, or a smaller clearance_mm, would help",
            pair=move.pair,
        )
    under = move.pair == UNDER
    if is_used_up() and not under:
        return SequenceBreak(
            before=a.index,
            after=b.index,
            code="rapid_search_cut_short",
            text=f"the search for a free path past {move.pair} was stopped: its budget of "
            f"{EXTENSIONS} tree extensions in vain is used up",
            help="locking an external joint (external.NAME.mode=locked), a retract to a place clear of everything, or "
            "another seed would help",
            pair=move.pair,
        )
    return SequenceBreak(
        before=a.index,
        after=b.index,
        code="rapid_blocked",
        text="the tool would pass under places that are cut, and the cell does not state where the part's material is"
        if under
        else f"no collision-free path was found past {move.pair}",
        help="workpiece.geometry, or a retract in the CAM file that is clear of the part, would help"
        if under
        else "a retract to a place "
        "clear of everything, another home pose, another seed, or moving what is in the way would help",
        pair=move.pair,
    )
