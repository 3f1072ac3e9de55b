"""Drilling cycles as single strokes along the tool axis, shared by APT and G-code."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.path_building.point_collector import MAX_POINTS, PathBuilder, Vector

MAX_PECKS = 10_000
SAME_HEIGHT = 1e-9  # mm
MAX_DWELL_S = 60.0  # at the bottom of a hole: a few turns of the spindle are usual, some seconds the most


class DrillingCycleError(ValueError):
    """The numbers of a cycle do not describe a hole; the reader adds file and line."""


@dataclass(frozen=True, kw_only=True)
class DrillingCycle:
    """One drilling cycle. Heights in mm along the tool axis from the hole's reference point, up positive."""

    name: str  # the source's word, e.g. DRILL or G83
    bottom: float
    clear: float  # rapid down to here, feed from here
    retract: float | None  # rapid up to here after the hole; None: to the height before the cycle, not known yet
    feed: float  # mm/min; NaN: the one in force at the hole
    first_peck: float = 0.0  # mm; 0: one stroke
    next_peck: float = 0.0  # mm; 0: as the first
    chip_break: bool = False  # back off a little instead of all the way
    gap: float = 1.0  # mm, distance from the last depth when re-entering the hole
    feed_out: bool = False  # bore, ream, tap: out at the feed
    feed_back: float = math.nan  # mm/min of the way out at a feed; NaN: that of the way in
    dwell: float = 0.0  # s at the bottom; NaN: some, of a unit that is not known
    peck_from: float = 0.0  # height the first peck is measured from
    less: float = 0.0  # mm by which each peck is shorter than the one before (degression); down to this length itself
    share: float = 1.0  # of the peck before, which each one is, down to ``least_peck``
    least_peck: float = 0.0  # mm
    first_feed: float = 1.0  # share of the feed in the first stroke
    surface: float | None = None  # height of the surface that is drilled; None: the source does not state it
    decrement: float = 0.0  # mm by which each peck is shorter than the one before, down to ``least_peck``
    break_every: float = 0.0  # mm; the chip is broken as often within a peck; 0: not
    break_gap: float = 0.0  # mm, how far it backs off there
    breaks_before_out: int = 0  # pecks that only break the chip before one that leaves the hole; 0: all of them
    gap_last: float | None = None  # mm, ``gap`` of the last peck; it changes evenly from the first one to it
    start: float | None = None  # height down to which the hole is there already, reached at ``start_feed``
    start_feed: float = math.nan  # mm/min; NaN: rapid
    synchronous: bool = False  # a thread: every way in the hole is at the feed

    def strokes(self) -> Iterator[tuple[float, MoveKind]]:
        """Heights to go to, one after the other, beginning at the clearance height; none twice in succession.

        Raises:
            DrillingCycleError: an absurd dwell, the bottom is above the clearance height, or more than MAX_PECKS pecks.
        """
        before = self.clear
        for height, move in self._list_strokes():
            if move == MoveKind.CUT or abs(height - before) > SAME_HEIGHT:
                yield height, move
                before = height

    def _list_strokes(self) -> Iterator[tuple[float, MoveKind]]:
        """The strokes; one that re-enters the hole may end where it begins, at the clearance height."""
        if self.dwell > MAX_DWELL_S:
            raise DrillingCycleError(
                f"{self.name} waits {self.dwell:g} s at the bottom; expected at most {MAX_DWELL_S:g} s. Is the dwell "
                "meant in milliseconds? Write it in seconds, with a decimal point"
            )
        if not self.bottom < self.clear:
            raise DrillingCycleError(
                f"bottom at {self.bottom:g} mm is not below the clearance height {self.clear:g} mm: the cycle would "
                "drill upwards; post it again with its depth below its clearance (R, clearance plane)"
            )
        if self.start is not None:
            if not self.bottom < self.start <= self.clear:
                raise DrillingCycleError(
                    f"{self.name} starts at {self.start:g} mm; expected a height above its bottom {self.bottom:g} mm"
                )
            yield self.start, MoveKind.APPROACH
        for depth, gap, broken in self._iterate_stops():
            yield depth, MoveKind.CUT
            if broken:
                yield min(depth + gap, self.clear), MoveKind.RETRACT
                continue
            yield self.clear, MoveKind.RETRACT
            if not self.synchronous:
                yield min(depth + gap, self.clear), MoveKind.APPROACH
        yield self.bottom, MoveKind.CUT
        back = self.clear if self.retract is None else self.retract
        yield max(back, self.clear) if not self.feed_out else self.clear, MoveKind.RETRACT
        if self.feed_out and back > self.clear:
            yield back, MoveKind.RAPID

    def _iterate_stops(self) -> Iterator[tuple[float, float, bool]]:
        """Heights above the bottom where the tool stops, the gap behind, and whether it only breaks the chip there.

        Raises:
            DrillingCycleError: more than MAX_PECKS.
        """
        pecks = list(self._iterate_pecks())
        last = self.gap if self.gap_last is None else self.gap_last
        begin = self.peck_from
        for n, depth in enumerate([*pecks, self.bottom]):
            if self.break_every > 0.0:
                count = (begin - depth) / self.break_every
                if count > MAX_PECKS:
                    raise DrillingCycleError(f"more than {MAX_PECKS} chip breaks, each after {self.break_every:g} mm")
                for k in range(1, math.ceil(count - 1e-6)):
                    yield begin - k * self.break_every, self.break_gap or self.gap, True
            if n < len(pecks):
                out = self.breaks_before_out and (n + 1) % (self.breaks_before_out + 1) == 0
                share = n / (len(pecks) - 1) if len(pecks) > 1 else 0.0
                yield depth, self.gap + (last - self.gap) * share, self.chip_break and not out
            begin = depth

    def _iterate_pecks(self) -> Iterator[float]:
        """Heights above the bottom down to which a peck goes.

        With ``less`` the last two are alike, once no more than twice that is left (Siemens, Measuring and technology
        cycles: CYCLE83, DAM).

        Raises:
            DrillingCycleError: more than MAX_PECKS.
        """
        if not self.first_peck > 0.0:
            return
        step, depth = self.first_peck, self.peck_from - self.first_peck
        for _ in range(MAX_PECKS):
            if depth <= self.bottom + 1e-6:
                return
            yield depth
            left = depth - self.bottom
            if self.less > 0.0:
                step = max(step - self.less, self.less)
                step = left / 2.0 if step == self.less and step < left <= 2.0 * step else step
            elif self.decrement > 0.0:
                step = max(step - self.decrement, self.least_peck)
                if not step > 0.0:
                    raise DrillingCycleError(
                        f"{self.name}: pecks that get {self.decrement:g} mm shorter come to nothing above the bottom; "
                        "expected a least peck above zero"
                    )
            else:
                step = max((self.next_peck or step) * self.share, self.least_peck)
            depth -= step
        raise DrillingCycleError(f"more than {MAX_PECKS} pecks, the last of {step:g} mm")


def append_hole_moves(
    builder: PathBuilder, cycle: DrillingCycle, hole: Vector, axis: Vector, line: int, before: Vector | None
) -> float:
    """Append all moves of one hole.

    Rapid sideways at the present height (first raised to the clearance height if lower), rapid down, then the strokes.

    Args:
        builder: Path builder that takes the moves.
        cycle: Strokes and heights of the cycle, mm.
        hole: Reference point of the hole, mm.
        axis: Tool axis, unit vector.
        line: Line number in the file (1-based).
        before: Tool tip before the hole in mm, None where not known.

    Returns:
        Height of the tip over ``hole`` afterwards, mm.

    Raises:
        DrillingCycleError: the cycles have more than MAX_POINTS points.
    """
    h, n = np.array(hole), np.array(axis)
    go_over_hole(builder, cycle, hole, axis, line, before)
    last, begun = cycle.clear, False
    for height, move in cycle.strokes():
        if move == MoveKind.RETRACT and not cycle.dwell <= 0.0 and abs(last - cycle.bottom) < 1e-9:
            builder.event("dwell", cycle.name, cycle.dwell)
        feed = cycle.feed if move == MoveKind.CUT or (cycle.feed_out and move == MoveKind.RETRACT) else math.nan
        if cycle.feed_out and move == MoveKind.RETRACT and math.isfinite(cycle.feed_back):
            feed = cycle.feed_back
        if move == MoveKind.APPROACH and height == cycle.start and not begun:
            feed = cycle.start_feed
        feed *= 1.0 if begun else cycle.first_feed
        begun = begun or move == MoveKind.CUT
        x, y, z = (h + height * n).tolist()
        builder.add((x, y, z), axis, move, feed, line, cycle=True)
        last = height
        if move == MoveKind.CUT and height == cycle.bottom and cycle.surface is not None:
            builder.state_hole_depth(cycle.surface - cycle.bottom)
    return last


def go_over_hole(
    builder: PathBuilder, cycle: DrillingCycle, hole: Vector, axis: Vector, line: int, before: Vector | None
) -> None:
    """Append the rapid moves to the clearance height over the hole.

    Args:
        builder: Path builder that takes the moves.
        cycle: Strokes and heights of the cycle, mm.
        hole: Reference point of the hole, mm.
        axis: Tool axis, unit vector.
        line: Line number in the file (1-based).
        before: Tool tip before the hole in mm, None where not known.

    Raises:
        DrillingCycleError: the cycles have more than MAX_POINTS points.
    """
    if len(builder) > MAX_POINTS:
        raise DrillingCycleError(f"more than {MAX_POINTS} points of drilling cycles")
    h, n = np.array(hole), np.array(axis)

    def at(height: float) -> Vector:
        x, y, z = (h + height * n).tolist()
        return x, y, z

    nan = math.nan
    if before is not None:
        height = float((np.array(before) - h) @ n)
        if height < cycle.clear - 1e-9:
            lifted = np.array(before) + (cycle.clear - height) * n
            x, y, z = lifted.tolist()
            builder.add((x, y, z), axis, MoveKind.RAPID, nan, line)
            height = cycle.clear
        if height > cycle.clear + 1e-9 and not np.allclose(at(height), before, atol=1e-6):
            builder.add(at(height), axis, MoveKind.RAPID, nan, line)
    builder.add(at(cycle.clear), axis, MoveKind.RAPID, nan, line)
