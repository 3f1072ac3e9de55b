"""Collects points, operations, events and unknown words while a reader walks through its source."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.domain.toolpath import Array, Event, IgnoredWord, Move, Operation, Toolpath
from machopt.formats.arcs import RADIUS_FAULT, RADIUS_WARN, Arc, ArcError
from machopt.formats.source import ReadOptions, Source

MAX_COORDINATE_MM = 1e6  # a kilometre: no robot cell is larger, so the number is a fault
ALONG_AXIS = math.cos(math.radians(1.0))  # a cut within 1° of the tool axis counts as drilling
TANGENT = math.cos(math.radians(3.0))  # a line that runs within 3° into an arc is meant to be tangential
MAX_EVENT_TEXT = 200
Vector = tuple[float, float, float]


@dataclass
class _Arc:
    first: int  # index of the first chord's end
    last: int
    line: int


@dataclass
class PathBuilder:
    """One toolpath in the making. Lengths in mm, feeds in mm/min; :meth:`build` turns them into SI."""

    source: Source
    options: ReadOptions
    format: str
    _numbers: array[float] = field(default_factory=lambda: array("d"))  # x y z i j k feed of each point
    _codes: array[int] = field(default_factory=lambda: array("i"))  # move operation line from_cycle
    _operations: list[Operation] = field(default_factory=list)
    _pending: Operation = field(default_factory=lambda: Operation("main", "trajectory"))
    _open: bool = False
    _events: list[Event] = field(default_factory=list)
    _ignored: dict[tuple[str, bool], list[int]] = field(default_factory=dict)
    _arcs: list[_Arc] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    meta: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self._codes) // 4

    def add(self, p: Vector, axis: Vector, move: int, feed: float, line: int, *, cycle: bool = False) -> None:
        """Append one programmed point (mm, mm/min; feed NaN for rapid moves)."""
        if not self._open:
            self._operations.append(self._pending)
            self._open = True
        if move == Move.CUT and not feed > 0.0:
            feed = self.feed_fallback(feed, line)
        self._numbers.extend((*p, *axis, feed))
        self._codes.extend((move, len(self._operations) - 1, line, cycle))

    def add_arc(
        self, points: Array, axis: Vector, move: int, feed: float, line: int, *, axis_before: Vector | None = None
    ) -> None:
        """Append the chord ends of an arc or curve; the tool axis goes over from ``axis_before`` on the way."""
        first = len(self)
        if axis_before is None or axis_before == axis:
            for x, y, z in points.tolist():
                self.add((x, y, z), axis, move, feed, line)
        else:
            share = (np.arange(1, len(points) + 1) / len(points))[:, None]
            axes = (1.0 - share) * np.array(axis_before) + share * np.array(axis)
            axes /= np.maximum(np.linalg.norm(axes, axis=1), 1e-12)[:, None]
            for (x, y, z), (i, j, k) in zip(points.tolist(), axes.tolist(), strict=True):
                self.add((x, y, z), (i, j, k), move, feed, line)
        self._arcs.append(_Arc(first, len(self) - 1, line))

    def feed_fallback(self, feed: float, line: int) -> float:
        """The feed of a cut that has none of its own (mm/min).

        Raises:
            InputError: no default feed was given.
        """
        if feed <= 0.0:
            raise self.source.error(f"feed {feed:g} on a cutting move; expected a feed above zero", line)
        if self.options.default_feed is None:
            raise self.source.error(
                "cutting move without a feed; expected a feed word before it, or give one with --feed MM_MIN",
                line,
            )
        self.warn_once("cutting moves without a feed of their own take the given default feed")
        return self.options.default_feed * 60e3

    def begin_operation(self, label: str, *, tool: str = "", comment: str = "") -> None:
        """Points from here on belong to a new operation, unless it is the one already open."""
        label = " ".join(label.split()) or "unnamed"
        if self._open and self._operations[-1].label == label and not tool:
            return
        self._pending = Operation(label, "trajectory", tool, comment)
        self._open = False

    def change_tool(self, tool: str) -> None:
        """A new operation for a new tool; one that was named but has no points yet keeps its name."""
        named = not self._open and self._pending.label != "main"
        self.begin_operation(self._pending.label if named else f"T{tool}", tool=tool)

    def event(self, kind: str, text: str, value: float = math.nan) -> None:
        """Something that happens before the move to the next point starts."""
        self._events.append(Event(len(self), kind, text.strip()[:MAX_EVENT_TEXT], value))  # type: ignore[arg-type]

    def ignore(self, word: str, line: int, *, understood: bool) -> None:
        """Count a word without effect here; with ``strict`` the first not understood one is refused."""
        key = (word, understood)
        entry = self._ignored.get(key)
        if entry is None:
            if self.options.strict and not understood:
                raise self.source.error(f"word {word!r} is not understood and strict reading was asked for", line)
            self._ignored[key] = [1, line]
        else:
            entry[0] += 1

    def warn(self, message: str, line: int | None = None) -> None:
        self.warnings.append(message if line is None else f"line {line}: {message}")

    def warn_once(self, message: str, line: int | None = None) -> None:
        """A warning of which only the first occurrence is told."""
        if not any(w.endswith(message) for w in self.warnings):
            self.warn(message, line)

    def positions(self) -> Array:
        """(N, 3) mm, a copy."""
        return self._table()[:, :3].copy()

    def moves(self) -> NDArray[np.int32]:
        """(N,) Move codes so far."""
        return np.array(self._codes, dtype=np.int32).reshape(-1, 4)[:, 0]

    def replace_positions(self, p_mm: Array) -> None:
        """Overwrite all positions (N, 3) mm; for coordinates that become known only later."""
        table = self._table().copy()
        table[:, :3] = p_mm
        self._numbers = array("d", table.tobytes())

    def _table(self) -> Array:
        return np.frombuffer(self._numbers, dtype=np.float64).reshape(-1, 7)

    def build(self, *, reference: Array | None = None, tolerance_mm: Array | None = None) -> Toolpath:
        """The finished toolpath in SI units.

        Raises:
            InputError: no cutting move, a number that is not finite or absurd, a zero tool axis.
        """
        n = len(self)
        if n == 0:
            raise self.source.error("holds no toolpath points")
        table = self._table()
        codes = np.array(self._codes, dtype=np.int32).reshape(-1, 4)
        p, axis, feed = table[:, :3], table[:, 3:6], table[:, 6]
        line = codes[:, 2].copy()
        self._check_numbers(table, line)
        move = codes[:, 0].astype(np.int8)
        if not (move == Move.CUT).any():
            raise self.source.error(
                f"holds {n} points but no cutting move; expected at least one feed move (GOTO after FEDRAT, G1)"
            )
        length = np.linalg.norm(axis, axis=1)
        if (length < 1e-6).any():
            at = int(np.argmax(length < 1e-6))
            raise self.source.error("the tool axis is zero; expected a direction", int(line[at]))
        off = np.abs(length - 1.0) > 1e-3
        if off.any():
            at = int(np.argmax(off))
            self.warn(f"{int(off.sum())} tool axes are not of unit length; they were normalised", int(line[at]))
        axis = axis / length[:, None]
        self._check_arcs(p)
        ignored = tuple(
            IgnoredWord(word, count, first, understood) for (word, understood), (count, first) in self._ignored.items()
        )
        strange = sum(w.count for w in ignored if not w.understood)
        if strange:
            self.warn(f"{strange} words were not understood: " + _some([w.word for w in ignored if not w.understood]))
        return Toolpath(
            position=p * 1e-3,
            axis=axis,
            move=move,
            feed=feed / 60e3,
            operation=codes[:, 1].copy(),
            operations=self._with_kinds(p, axis, codes),
            reference=np.full((n, 3), np.nan) if reference is None else reference,
            tolerance=np.full(n, np.nan) if tolerance_mm is None else tolerance_mm * 1e-3,
            line=line,
            source=self.source.name,
            format=self.format,
            sha256=self.source.sha256,
            events=tuple(self._events),
            ignored=ignored,
            warnings=tuple(self.warnings),
            meta=dict(self.meta),
        )

    def _check_numbers(self, table: Array, line: NDArray[np.int32]) -> None:
        for columns, what in ((table[:, :3], "coordinate"), (table[:, 3:6], "tool axis")):
            bad = ~np.isfinite(columns).all(axis=1)
            if bad.any():
                at = int(np.argmax(bad))
                raise self.source.error(f"a {what} is not a finite number", int(line[at]))
        far = np.abs(table[:, :3]).max(axis=1) > MAX_COORDINATE_MM
        if far.any():
            at = int(np.argmax(far))
            raise self.source.error(
                f"coordinate {np.abs(table[at, :3]).max():g} mm; expected less than {MAX_COORDINATE_MM:g} mm",
                int(line[at]),
            )
        if np.isinf(table[:, 6]).any():
            at = int(np.argmax(np.isinf(table[:, 6])))
            raise self.source.error("the feed is not a finite number", int(line[at]))

    def _with_kinds(self, p: Array, axis: Array, codes: NDArray[np.int32]) -> tuple[Operation, ...]:
        """Operations with ``kind``: point where every cut runs along the tool axis or comes from a cycle."""
        count = len(self._operations)
        step = np.diff(p, axis=0, prepend=p[:1])
        length = np.linalg.norm(step, axis=1)
        along = np.abs(np.einsum("ij,ij->i", step, axis)) >= ALONG_AXIS * length  # holds for zero length too
        cut = codes[:, 0] == Move.CUT
        sideways = cut & ~(along | (codes[:, 3] != 0))
        # a cut of zero length proves nothing: only a plunge or a cycle makes a point operation
        plunge = cut & ((length > 1e-6) | (codes[:, 3] != 0)) & ~sideways
        plunge[0] = plunge[0] and codes[0, 3] != 0
        has_sideways = np.bincount(codes[sideways, 1], minlength=count) > 0
        has_plunge = np.bincount(codes[plunge, 1], minlength=count) > 0
        return tuple(
            Operation(o.label, "point" if has_plunge[k] and not has_sideways[k] else "trajectory", o.tool, o.comment)
            for k, o in enumerate(self._operations)
        )

    def _check_arcs(self, p: Array) -> None:
        """Compare each arc's end tangents with the straight moves before and after it."""
        against: list[int] = []
        agree = 0
        for k, arc in enumerate(self._arcs):
            votes: list[float] = []
            if arc.first > 1 and not (k and self._arcs[k - 1].last == arc.first - 1):
                votes.append(_turn(p[arc.first - 2], p[arc.first - 1], p[arc.first]))
            straight_after = not (k + 1 < len(self._arcs) and self._arcs[k + 1].first == arc.last + 1)
            if arc.last + 1 < len(p) and straight_after and arc.last > 0:
                votes.append(_turn(p[arc.last - 1], p[arc.last], p[arc.last + 1]))
            tangential = [v for v in votes if abs(v) > TANGENT]
            if tangential and all(v < 0.0 for v in tangential):
                against.append(arc.line)
            elif tangential:
                agree += 1
        if against:
            self.warn(
                f"{len(against)} arcs run against the tangents of their neighbours ({agree} run with them), "
                f"at lines {_some([str(n) for n in against])}: check the arc direction"
            )


def check_radius(found: Arc, line: int, out: PathBuilder) -> None:
    """Say where an arc's start and end are not equally far from its centre (mm).

    Raises:
        ArcError: they differ by more than half a millimetre or a tenth of the radius.
    """
    off = abs(found.mismatch)
    if off > RADIUS_WARN and (off > RADIUS_FAULT * found.radius or off > 10.0 * RADIUS_WARN):
        raise ArcError(f"start and end of the arc differ by {off:.4g} mm in their distance from the centre")
    if off > RADIUS_WARN:
        out.warn_once("start and end of an arc differ by more than 0.05 mm in their distance from its centre", line)


def _turn(a: Array, b: Array, c: Array) -> float:
    """Cosine between a→b and b→c; 0 where either is too short to have a direction."""
    u, v = b - a, c - b
    norm = float(np.linalg.norm(u) * np.linalg.norm(v))
    return float(u @ v) / norm if norm > 1e-9 else 0.0


def _some(words: list[str], most: int = 8) -> str:
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")
