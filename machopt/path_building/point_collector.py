"""Collector of points, operations and events while a reader processes its source."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathEvent, ToolpathOperation
from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import interpolate_axes
from machopt.path_building.path_checks import (
    ArcSpan,
    check_extent,
    check_feeds,
    check_numbers,
    classify_operations,
    compare_arc_directions,
)
from machopt.path_building.reading_notes import ReadingNotes, format_words

MAX_EVENT_TEXT = 200
USED = "options_used"  # key of ``meta`` between a reader and :mod:`machopt.toolpath.unused_reading_options`
MAX_POINTS = 10_000_000  # 0.7 GB: beyond it a loop or a radius is a fault
Vector = tuple[float, float, float]


@dataclass(kw_only=True)
class PathBuilder(ReadingNotes):
    """One toolpath in the making. Lengths in mm, feeds in mm/min; :meth:`build` turns them into SI."""

    format: str
    _numbers: array[float] = field(default_factory=lambda: array("d"))  # x y z i j k feed of each point
    _codes: array[int] = field(default_factory=lambda: array("i"))  # move operation line from_cycle
    _operations: list[ToolpathOperation] = field(default_factory=list)
    _pending: ToolpathOperation = field(default_factory=lambda: ToolpathOperation("main", "trajectory"))
    _open: bool = False
    _events: list[ToolpathEvent] = field(default_factory=list)
    _arcs: list[ArcSpan] = field(default_factory=list)
    _offsets: list[tuple[int, str]] = field(default_factory=list)
    _hole_depths: dict[int, float] = field(default_factory=dict)  # point → mm, surface to the bottom of the hole

    def __len__(self) -> int:
        return len(self._codes) // 4

    def count_from(self, offset: str, first: int | None = None) -> None:
        """Use another work offset of the cell for the points from an index on.

        Args:
            offset: Name of the work offset.
            first: Index of the first point, None for the next one.
        """
        first = len(self) if first is None else first
        if self._offsets and self._offsets[-1][0] == first:
            self._offsets.pop()
        if not self._offsets or self._offsets[-1][1] != offset:
            self._offsets.append((first, offset))

    def add(self, p: Vector, axis: Vector, move: int, feed: float, line: int, *, cycle: bool = False) -> None:
        """Append one programmed point.

        Args:
            p: Position, mm; NaN where not known.
            axis: Tool axis, unit vector from tip to shank.
            move: Kind of the move.
            feed: Feed, mm/min; NaN for rapid moves.
            line: Line number in the file (1-based).
            cycle: Whether the point belongs to a drilling cycle.
        """
        if not self._open:
            self._start_operation()
        if move == MoveKind.CUT and not feed > 0.0:
            feed = self.feed_fallback(feed, line)
        self._numbers.extend((*p, *axis, feed))
        self._codes.extend((move, len(self._operations) - 1, line, cycle))

    def add_many(self, numbers: list[float], moves_and_lines: list[tuple[int, int]]) -> None:
        """Append plain points; cutting moves must have their feed already (:meth:`feed_fallback`).

        Args:
            numbers: x, y, z, i, j, k, feed of all points in sequence (mm, mm/min).
            moves_and_lines: Kind of move and line number of each point.

        Raises:
            InputError: the file has too many points.
        """
        if not moves_and_lines:
            return
        if not self._open:
            self._start_operation()
        operation = len(self._operations) - 1
        self._numbers.extend(numbers)
        self._codes.extend(code for move, line in moves_and_lines for code in (move, operation, line, 0))
        if len(self) > MAX_POINTS:
            raise self.source.build_error(f"more than {MAX_POINTS} points", moves_and_lines[-1][1])

    def add_table(
        self,
        numbers: Array,
        move: NDArray[np.int32],
        line: NDArray[np.int32],
        labels: list[tuple[int, str]],
        tools: Mapping[int, str] | None = None,
        from_cycle: NDArray[np.bool_] | None = None,
    ) -> None:
        """Append a whole table.

        Args:
            numbers: (N, 7) x y z i j k feed (mm, mm/min).
            move, line: (N,) Move codes and source lines.
            labels: first row and label of each operation; none: they go on in the present one.
            tools: of operations by their first row.
            from_cycle: (N,) rows that are strokes of a drilling cycle; none by default.
        """
        lacking = np.flatnonzero((move == MoveKind.CUT) & ~(numbers[:, 6] > 0.0))
        for row in lacking.tolist():
            numbers[row, 6] = self.feed_fallback(float(numbers[row, 6]), int(line[row]))
        codes = np.zeros((len(numbers), 4), dtype=np.int32)
        codes[:, 0], codes[:, 2] = move, line
        if from_cycle is not None:
            codes[:, 3] = from_cycle
        stops = [start for start, _ in labels[1:]] + [len(numbers)]
        for (start, label), stop in zip(labels or [(0, "")], stops, strict=True):
            if labels:
                self.begin_operation(label, tool=(tools or {}).get(start, ""))
            if not self._open:
                self._start_operation()
            codes[start:stop, 1] = len(self._operations) - 1
        self._numbers.frombytes(np.ascontiguousarray(numbers, dtype=np.float64).tobytes())
        self._codes.frombytes(codes.tobytes())

    def _start_operation(self) -> None:
        self._operations.append(self._pending)
        self._open = True

    def add_arc(
        self,
        points: Array,
        axis: Vector | Array,
        move: int,
        feed: float,
        line: int,
        *,
        axis_before: Vector | None = None,
    ) -> None:
        """Append the chord ends of an arc or curve.

        Args:
            points: (N, 3) mm.
            axis: the tool axis at its end, or (N, 3) that at each point.
            move, feed, line: of all points.
            axis_before: the tool axis at its start, from which it turns evenly; none: it does not turn.
        """
        first = len(self)
        if first + len(points) > MAX_POINTS:
            raise self.source.build_error(f"more than {MAX_POINTS} points", line)
        if not self._open:
            self._start_operation()
        if move == MoveKind.CUT and not feed > 0.0:
            feed = self.feed_fallback(feed, line)
        table = np.empty((len(points), 7))
        table[:, :3], table[:, 6] = points, feed
        table[:, 3:6] = axis
        if axis_before is not None and tuple(axis_before) != tuple(table[-1, 3:6].tolist()):
            shares = np.arange(1, len(points) + 1) / len(points)
            table[:, 3:6] = interpolate_axes(np.array(axis_before), table[-1, 3:6].copy(), shares)
        self._numbers.frombytes(table.tobytes())
        self._codes.extend((move, len(self._operations) - 1, line, 0) * len(points))
        self._arcs.append(ArcSpan(first, len(self) - 1, line))

    def replace_points(self, first: int, points: Array) -> None:
        """Replace the points from an index on, with the axis, feed and line of the first replaced point.

        Events after the last point stay there. Arcs of the replaced points become one arc where N > 1.

        Args:
            first: Index of the first replaced point.
            points: New positions (N, 3), mm.
        """
        old, row, codes = len(self), self._numbers[7 * first : 7 * first + 7], self._codes[4 * first : 4 * first + 4]
        arcs = [a for a in self._arcs if a.first >= first]
        del self._numbers[7 * first :], self._codes[4 * first :]
        if arcs:
            self._arcs[-len(arcs) :] = [ArcSpan(first, first + len(points) - 1, arcs[0].line)]
        for p in points.tolist():
            self._numbers.extend((*p, *row[3:]))
            self._codes.extend(codes)
        if len(self) != old:
            for k, e in enumerate(self._events):
                if e.index >= old:
                    self._events[k] = ToolpathEvent(len(self), e.kind, e.text, e.value)

    def begin_operation(self, label: str, *, tool: str = "", comment: str = "", tool_named: str = "") -> None:
        """Begin an operation for the points that follow, unless it is already open.

        Args:
            label: Name of the operation.
            tool: Name or number of the tool.
            comment: Comment of the operation.
            tool_named: Another name of the tool.
        """
        label = " ".join(label.split()) or "unnamed"
        if self._open and self._operations[-1].label == label and not tool:
            return
        self._pending = ToolpathOperation(label, "trajectory", tool, comment, tool_named)
        self._open = False

    def change_tool(self, tool: str) -> None:
        """Begin an operation for a new tool; a named operation without points keeps its name.

        Args:
            tool: Name or number of the tool.
        """
        named = not self._open and self._pending.label != "main"
        also = self._pending.tool if named and self._pending.tool != tool else ""
        self.begin_operation(self._pending.label if named else f"T{tool}", tool=tool, tool_named=also)

    def also_tool(self, word: str) -> None:
        """Add another name for the tool of a named operation without points.

        Args:
            word: The other name.
        """
        if not self._open and self._pending.tool != word:
            self._pending = replace(self._pending, tool_named=word)

    def event(self, kind: str, text: str, value: float = math.nan) -> None:
        """Add an event before the next point.

        Args:
            kind: Kind of the event.
            text: Text of the event.
            value: Number of the event; NaN where it has none.
        """
        self._events.append(ToolpathEvent(len(self), kind, text.strip()[:MAX_EVENT_TEXT], value))  # type: ignore[arg-type]

    def undo_event(self, kind: str, text: str) -> None:
        """Remove the last event if it is this one at this place, because the next one includes it (S8000, M3).

        Args:
            kind: Kind of the event.
            text: Text of the event.
        """
        for k in range(len(self._events) - 1, -1, -1):
            event = self._events[k]
            if event.index != len(self) or (event.kind == kind and event.text != text):
                return
            if event.kind == kind:
                del self._events[k]
                return

    def state_hole_depth(self, depth_mm: float, point: int | None = None) -> None:
        """State that a point is the bottom of a hole.

        Args:
            depth_mm: Distance from the surface to the point along the tool axis, mm.
            point: Index of the point; None: the last one.
        """
        self._hole_depths[len(self) - 1 if point is None else point] = depth_mm

    def keep_first(self, n: int) -> None:
        """Remove the points from index ``n`` on; their events move behind the last point that stays.

        Args:
            n: Number of points that stay.
        """
        del self._numbers[7 * n :], self._codes[4 * n :]
        self._arcs[:] = [a for a in self._arcs if a.last < n]
        self._hole_depths = {k: depth for k, depth in self._hole_depths.items() if k < n}
        for k, e in enumerate(self._events):
            if e.index > n:
                self._events[k] = ToolpathEvent(n, e.kind, e.text, e.value)

    def positions(self) -> Array:
        """(N, 3) mm, a copy."""
        return self._build_table()[:, :3].copy()

    def moves(self) -> NDArray[np.int32]:
        """(N,) Move codes so far."""
        return np.array(self._codes, dtype=np.int32).reshape(-1, 4)[:, 0]

    def fill_coordinate(self, k: int, value: float) -> None:
        """Set one coordinate of the points so far where it is not known.

        Args:
            k: Index of the coordinate: 0, 1, 2 for X, Y, Z.
            value: Value, mm.
        """
        column = self._build_table()[:, k]
        column[np.isnan(column)] = value

    def replace_positions(self, p_mm: Array) -> None:
        """Overwrite all positions, for coordinates that become known later.

        Args:
            p_mm: Positions (N, 3), mm.
        """
        self._build_table()[:, :3] = p_mm

    def _build_table(self) -> Array:
        return np.frombuffer(self._numbers, dtype=np.float64).reshape(-1, 7)

    def _warn_of_arcs(self, position: Array) -> None:
        """State the number of arcs; warn of those that run against the moves around them (positions (N, 3) mm)."""
        if self._arcs:
            self.meta["arcs"] = str(len(self._arcs))
        found = compare_arc_directions(self._arcs, position)
        if found.against:
            self.warn(
                f"{len(found.against)} arcs run against the tangents of their neighbours ({found.agree} run with "
                f"them), at lines {format_words([str(k) for k in found.against])}: check the arc direction"
            )

    def build(self, *, reference: Array | None = None, tolerance_mm: Array | None = None) -> Toolpath:
        """Build the finished toolpath.

        Args:
            reference: Reference direction of each point (N, 3), None where not given.
            tolerance_mm: Tolerance of each point (N,) in mm, None where not given.

        Returns:
            The toolpath, SI units.

        Raises:
            InputError: no cutting move, a number that is not finite or too large, a zero tool axis.
        """
        n = len(self)
        if n == 0:
            raise self.source.build_error("holds no toolpath points")
        table = self._build_table()
        codes = np.frombuffer(self._codes, dtype=np.int32).reshape(-1, 4)
        line = codes[:, 2].copy()
        check_numbers(self.source, table, line)
        check_extent(self.source, table[:, :3], line, self.options.max_extent * 1e3)
        check_feeds(self.source, table[:, :3], codes[:, 0], table[:, 6], line)
        move = codes[:, 0].astype(np.int8)
        if not (move == MoveKind.CUT).any():
            raise self.source.build_error(
                f"holds {n} points but no cutting move; expected at least one feed move (GOTO after FEDRAT, G1)"
            )
        p, axis = table[:, :3], self._normalise_axes(table[:, 3:6], line)
        self._warn_of_arcs(p)
        self.warn_of_feeds_and_words(table, move, line)
        if self.used_options:
            self.meta[USED] = " ".join(sorted(self.used_options))
        self.state_incompleteness()
        return Toolpath(
            position=p * 1e-3,
            axis=axis,
            move=move,
            feed=table[:, 6] / 60e3,
            operation=codes[:, 1].copy(),
            operations=classify_operations(self._operations, p, axis, codes[:, 0], codes[:, 1], codes[:, 3] != 0),
            reference=np.full((n, 3), np.nan) if reference is None else reference,
            tolerance=np.full(n, np.nan) if tolerance_mm is None else tolerance_mm * 1e-3,
            line=line,
            source=self.source.name,
            format=self.format,
            sha256=self.source.sha256,
            events=tuple(self._events),
            ignored=tuple(self._ignored.values()),
            warnings=tuple(self.warnings),
            meta=dict(self.meta),
            offsets=tuple((first, name) for first, name in self._offsets if first < n),
            hole_depth=self._list_hole_depths(n),
        )

    def _list_hole_depths(self, n: int) -> Array | None:
        """Return (N,) m, NaN where no depth is stated; None where the file states none."""
        if not self._hole_depths:
            return None
        out = np.full(n, np.nan)
        out[list(self._hole_depths)] = np.array(list(self._hole_depths.values())) * 1e-3
        return out

    def _normalise_axes(self, axis: Array, line: NDArray[np.int32]) -> Array:
        length = np.sqrt(np.einsum("ij,ij->i", axis, axis))
        if (length < 1e-6).any():
            at = int(np.argmax(length < 1e-6))
            raise self.source.build_error("the tool axis is zero; expected a direction", int(line[at]))
        off = np.abs(length - 1.0) > 1e-3
        if off.any():
            at = int(np.argmax(off))
            count = len(np.unique(line[off]))  # several points may come from one line
            self.warn(f"lines with a tool axis that is not of unit length: {count}; it was normalised", int(line[at]))
        return np.asarray(axis / length[:, None])
