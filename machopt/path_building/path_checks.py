"""Checks of a finished list of points: numbers, tool axes, arc directions, kinds of operations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, ToolpathOperation
from machopt.file_formats.source_file import SourceFile
from machopt.numerics.array_types import Array

MAX_COORDINATE_MM = 1e6  # a kilometre: no robot cell is larger, so the number is a fault
MAX_FEED_MM_MIN = 1e9  # 1,000 km/h: demonstration files run at 4.5e6 mm/min
MAX_MOVE_H = 3.0  # of one cut that is not faster than CUTTING_MM_MIN: 5 m at 30 mm/min
CUTTING_MM_MIN = 60.0  # a longer cut at more than that is no matter of its feed, but of its length
SLOW_MM_MIN = 1.0  # cuts below it are in another unit (mm per turn, m/min), unless they are few and short
MAX_SLOW_H = 1.0  # of all cuts below it
ALONG_AXIS = math.cos(math.radians(1.0))  # a cut within 1° of the tool axis counts as drilling
TANGENT = math.cos(math.radians(3.0))  # a line that runs within 3° into an arc is meant to be tangential


@dataclass(frozen=True)
class ArcSpan:
    """Range of the points that are chords of one arc."""

    first: int  # index of the first chord's end
    last: int
    line: int


@dataclass(frozen=True)
class ArcDirections:
    """Arcs whose end tangents run with, or against, the adjacent straight moves."""

    agree: int
    against: tuple[int, ...]  # lines


def check_numbers(source: SourceFile, table: Array, line: NDArray[np.int32]) -> None:
    """Coordinates, tool axes and feeds are finite and of a sane size.

    Args:
        source: the file, for messages.
        table: (N, 7) x y z (mm) i j k feed (mm/min).
        line: (N,) lines of the source.
    Raises:
        InputError: the first one that is not.
    """
    for columns, what in ((table[:, :3], "coordinate"), (table[:, 3:6], "tool axis")):
        bad = ~np.isfinite(columns).all(axis=1)
        if bad.any():
            at = int(np.argmax(bad))
            raise source.build_error(f"a {what} is not a finite number", int(line[at]))
    far = np.abs(table[:, :3]).max(axis=1) > MAX_COORDINATE_MM
    if far.any():
        at = int(np.argmax(far))
        raise source.build_error(
            f"coordinate {np.abs(table[at, :3]).max():g} mm; expected less than {MAX_COORDINATE_MM:g} mm. "
            "If its numbers have implied decimals give --decimals N, if the file says no unit give --unit",
            int(line[at]),
        )
    feed = table[:, 6]
    wild = np.isinf(feed) | (feed > MAX_FEED_MM_MIN)
    if wild.any():
        at = int(np.argmax(wild))
        raise source.build_error(f"a feed of {feed[at]:g} mm/min; expected a finite, sane number", int(line[at]))


def check_extent(source: SourceFile, p: Array, line: NDArray[np.int32], limit: float) -> None:
    """Check that the path is not longer along X, Y or Z than a limit.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        p: Points (N, 3), mm.
        line: Line number of each point (N,).
        limit: Largest extent, mm.

    Raises:
        InputError: it is longer: a wrong unit, wrong implied decimals, or a very large part, which the user must
            confirm.
    """
    low, high = p.min(axis=0), p.max(axis=0)
    k = int(np.argmax(high - low))
    if not high[k] - low[k] > limit:
        return
    middle = 0.5 * (low[k] + high[k])
    at = int(np.argmax(np.abs(p[:, k] - middle)))
    raise source.build_error(
        f"the path is {(high[k] - low[k]) * 1e-3:.4g} m long in {'XYZ'[k]} ({low[k]:g} … {high[k]:g} mm); expected "
        f"less than {limit * 1e-3:g} m. If its numbers have implied decimals give --decimals N, if the file says no "
        "unit give the right one with --unit, and if the part is that large give --max-extent MM",
        int(line[at]),
    )


def check_feeds(source: SourceFile, p: Array, move: NDArray[np.int32], feed: Array, line: NDArray[np.int32]) -> None:
    """No cut takes hours: its feed is then in another unit, per revolution for instance.

    Args:
        source: the file, for messages.
        p: (N, 3) points, mm.
        move: (N,) Move codes.
        feed: (N,) mm/min of the move that ends at each point.
        line: (N,) lines of the source.
    Raises:
        InputError: the first cut that does, or all cuts below SLOW_MM_MIN together.
    """
    step = np.diff(p, axis=0, prepend=p[:1])
    cut = (move == MoveKind.CUT) & (feed > 0.0)
    hours = np.where(cut, np.sqrt(np.einsum("ij,ij->i", step, step)) / np.where(cut, feed, 1.0) / 60.0, 0.0)
    slow = cut & (feed < SLOW_MM_MIN)
    together = float(hours[slow].sum())
    hours[feed > CUTTING_MM_MIN] = 0.0
    at = int(np.argmax(hours))
    if hours[at] > MAX_MOVE_H:
        what = f"one move would take {hours[at]:.3g} h at {feed[at]:g} mm/min"
    elif together > MAX_SLOW_H:
        at = int(np.argmax(slow))
        what = f"moves below {SLOW_MM_MIN:g} mm/min would take {together:.3g} h, the first at {feed[at]:g} mm/min"
    else:
        return
    raise source.build_error(
        f"{what}; expected a feed in mm/min (inch/min). A feed per revolution needs its word (G95, MMPR, IPR) and a "
        "spindle speed, a feed in m/min the right number; correct the feed or give the unit",
        int(line[at]),
    )


def classify_operations(
    operations: Sequence[ToolpathOperation],
    p: Array,
    axis: Array,
    move: NDArray[np.int32],
    operation: NDArray[np.int32],
    from_cycle: NDArray[np.bool_],
) -> tuple[ToolpathOperation, ...]:
    """Operations with ``kind``: point where every cut runs along the tool axis or comes from a cycle.

    Args:
        operations: as collected.
        p, axis: (N, 3) mm and unit vectors.
        move, operation: (N,) Move codes and indices into ``operations``.
        from_cycle: (N,) strokes of drilling cycles.
    """
    count = len(operations)
    step = np.diff(p, axis=0, prepend=p[:1])
    length = np.sqrt(np.einsum("ij,ij->i", step, step))
    along = np.abs(np.einsum("ij,ij->i", step, axis)) >= ALONG_AXIS * length  # holds for zero length too
    cut = move == MoveKind.CUT
    sideways = cut & ~(along | from_cycle)
    # a cut of zero length proves nothing: only a plunge or a cycle makes a point operation
    plunge = cut & ((length > 1e-6) | from_cycle) & ~sideways
    plunge[0] = plunge[0] and bool(from_cycle[0])
    has_sideways = np.bincount(operation[sideways], minlength=count) > 0
    has_plunge = np.bincount(operation[plunge], minlength=count) > 0
    return tuple(
        ToolpathOperation(
            o.label, "point" if has_plunge[k] and not has_sideways[k] else "trajectory", o.tool, o.comment, o.tool_named
        )
        for k, o in enumerate(operations)
    )


def compare_arc_directions(arcs: Sequence[ArcSpan], p: Array) -> ArcDirections:
    """Compare the end tangents of each arc with the straight moves before and after it.

    Args:
        arcs: Arcs of the path.
        p: Points (N, 3), mm.

    Returns:
        Counts of matching and contradicting arcs.
    """
    against: list[int] = []
    agree = 0
    for k, arc in enumerate(arcs):
        votes: list[float] = []
        if arc.first > 1 and not (k and arcs[k - 1].last == arc.first - 1):
            votes.append(_compute_turn_cosine(p[arc.first - 2], p[arc.first - 1], p[arc.first]))
        straight_after = not (k + 1 < len(arcs) and arcs[k + 1].first == arc.last + 1)
        if arc.last + 1 < len(p) and straight_after and arc.last > 0:
            votes.append(_compute_turn_cosine(p[arc.last - 1], p[arc.last], p[arc.last + 1]))
        tangential = [v for v in votes if abs(v) > TANGENT]
        if tangential and all(v < 0.0 for v in tangential):
            against.append(arc.line)
        elif tangential:
            agree += 1
    return ArcDirections(agree, tuple(against))


def _compute_turn_cosine(a: Array, b: Array, c: Array) -> float:
    """Cosine between a→b and b→c; 0 where either is too short to have a direction."""
    u, v = b - a, c - b
    norm = float(np.linalg.norm(u) * np.linalg.norm(v))
    return float(u @ v) / norm if norm > 1e-9 else 0.0
