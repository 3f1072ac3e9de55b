"""Checks of the times, the feed share and the feed dips of result.json against the samples of trajectory.csv."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from machopt.data_types.slow_moves import RAMPS, TURN_BACK, SlowStretch, describe_slow_points, is_turn_back
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.folder.result_json.comparison_inputs import (
    RELATIVE_TOLERANCE,
    CheckedPoints,
    ResultComparison,
    check_close,
    check_equal,
    format_json_value,
    require_number,
)
from machopt.verification.folder.result_json.objective_and_gains import is_within_ranges
from machopt.verification.tables.advised_feeds import ADVISED, apply_exported_feeds

HELD_FEED_SHARE = 0.95  # of the programmed feed: what counts as held
POINT_INDEX_TOLERANCE = 1e-6  # of a point index: printed with six decimals or more
TILT_FEED_SPREAD = 0.01  # of a tilted ball's feed: the planner judges that of its tip, which differs inside a move
FEED_TOLERANCE = 1e-4  # of the programmed feed: feeds are printed to 0.001 mm/min
SHIFTED_CORNER_RAD = math.radians(
    10.0
)  # by this much a path shifted against the deflection may turn a corner less sharply


def check_times(t: ResultComparison) -> Iterable[str]:
    """Check cycle time and dwells against the tables; computing times must be numbers.

    Args:
        t: The result, and what it is compared with.
    """
    if t.contents is None:
        yield from check_equal("cycle_time_s", t.result.cycle_time_s, None)
        yield from check_equal("dwell_s", t.result.dwell_s, None)
        return
    waits = t.toolpath.dwells
    yield from check_close(
        "dwell_s",
        t.result.dwell_s,
        float(waits[0] + waits[1:][CheckedPoints.from_file(t).is_ok].sum()),
        RELATIVE_TOLERANCE,
        1e-9,
    )
    yield from check_close("cycle_time_s", t.result.cycle_time_s, float(t.motion.read_numbers("time_s")[-1]), 0.0, 1e-5)
    for name, seconds in t.result.timings_s.items():
        if not (isinstance(seconds, float | int) and math.isfinite(seconds) and seconds >= 0):
            yield f"timings_s.{name} is {format_json_value(seconds)}"


def check_feed(t: ResultComparison) -> Iterable[str]:
    """Check the share of the cutting time near the programmed feed, and where it falls short of it, from the samples.

    Args:
        t: The result, and what it is compared with.
    """
    share, dips, stops = t.result.feed_held_share, t.result.feed_dips, t.result.feed_stops
    if t.contents is None:
        yield from check_equal("feed_held_share", share, None)
        yield from check_equal("feed_dips", dips, [])
        yield from check_equal("feed_stops", stops, [])
        return
    number = {k: t.motion.read_numbers(k, empty=True) for k in ("point", "feed_mm_min")}
    move = np.array(t.motion.read_words("move"))
    fed = (move != MoveKind.RAPID.word) & np.isfinite(number["point"])  # dips begin in approaches too
    fed &= ~_is_dwelling(t, number["point"])
    cut, at = (move == MoveKind.CUT.word)[fed], number["point"][fed]
    advised = t.points.read_numbers(ADVISED, empty=True) if ADVISED in t.points else None
    feed = apply_exported_feeds(t.toolpath, advised, t.points.read_numbers("point").astype(np.intp)).feed
    programmed = np.where(np.isfinite(feed), feed, t.options.approach_feed)
    ends = np.clip(np.ceil(at - POINT_INDEX_TOLERANCE).astype(int), 0, len(t.toolpath) - 1)
    # the step to a sample just behind a point was driven before it for the most part: either point's feed may be meant
    either = np.stack([programmed[ends], programmed[np.r_[ends[:1], ends[:-1]]]])
    ratio = np.sort(number["feed_mm_min"][fed] / 60e3 / either, axis=0)
    runs = 1 + int((np.diff(np.flatnonzero(move == MoveKind.CUT.word)) > 1).sum())
    slack = (2 * runs + 0.5) / max(int(cut.sum()), 1)  # the sample at either end of each may count or not
    if not cut.any() or share is None:
        yield f"feed_held_share is {share}, but trajectory.csv holds no cut"
        return
    still = bool(_is_unmoved(t.toolpath)[ends[cut]].all())  # no cut has a length: nothing is slow
    spread = TILT_FEED_SPREAD if "lead_deg" in t.motion else 0.0
    thresholds = HELD_FEED_SHARE + spread, HELD_FEED_SHARE - spread
    least, most = (1.0 if still else (row[cut] >= h).mean() for row, h in zip(ratio, thresholds, strict=True))
    slack = 1e-9 if still else slack
    if not least - slack <= share <= most + slack:
        yield f"feed_held_share is {share:.6g}, {least:.6g} to {most:.6g} follows"
    axes = len(t.cell.limits.velocity)
    named = [(f"feed_dips.{n}", dip) for n, dip in enumerate(dips)]
    named += [(f"feed_stops.{n}", stop) for n, stop in enumerate(stops)]
    ranges = [
        (require_number("first_point", dip.first_point), require_number("last_point", dip.last_point))
        for _, dip in named
    ]
    inside = is_within_ranges(
        at, np.array([(a - POINT_INDEX_TOLERANCE, b + POINT_INDEX_TOLERANCE) for a, b in ranges]).reshape(-1, 2)
    )
    for (name, dip), (first, last) in zip(named, ranges, strict=True):
        if not (0.0 <= dip.lowest_ratio < HELD_FEED_SHARE and 1 <= dip.axis <= axes and first <= last):
            yield f"{name} is none: {format_json_value(dip)}"
        elif (dip.where in RAMPS) != name.startswith("feed_stops"):
            yield f"{name} belongs into the other list: {format_json_value(dip)}"
        elif dip.where == "reversal" and not any(_is_reversal(t.toolpath, at) for at in (first, last)):
            yield f"{name}: the path does not turn back there: {format_json_value(dip)}"
    yield from _check_slow_rows(t)
    missed = 0 if still else int((cut & (ratio[1] < HELD_FEED_SHARE - FEED_TOLERANCE - spread) & ~inside).sum())
    if missed > 2 * runs:
        yield f"{missed} samples below {HELD_FEED_SHARE:g} of the programmed feed are in no feed_dips or feed_stops"


def _check_slow_rows(t: ResultComparison) -> Iterable[str]:
    """The rows of points.csv that are ok and have a reason are those on the way to which a dip of the path lies."""
    points = CheckedPoints.from_file(t)
    stretches = [
        SlowStretch(
            first=require_number("first_point", dip.first_point),
            last=require_number("last_point", dip.last_point),
            ratio=dip.lowest_ratio,
            where=dip.where,
            axis=dip.axis,
            limit=dip.limit,
        )
        for dip in t.result.feed_dips
    ]
    wanted = describe_slow_points(stretches, len(t.toolpath))
    rows = zip(points.is_ok.tolist(), points.table.read_words("reason"), strict=True)
    wrong = [k for k, (ok, text) in enumerate(rows) if ok and text != wanted.get(k, "")]
    if wrong:
        yield f"the reason at {len(wrong)} points of points.csv does not follow from feed_dips, the first is {wrong[0]}"


def _is_reversal(toolpath: Toolpath, at: float) -> bool:
    """True where the path turns back at the point that a ramp begins or ends at."""
    point = round(at)
    on_point = abs(at - point) <= POINT_INDEX_TOLERANCE and 0 <= point < len(toolpath)
    return on_point and is_turn_back(toolpath.position, toolpath.axis, point, TURN_BACK - SHIFTED_CORNER_RAD)


def _is_dwelling(t: ResultComparison, point: Array) -> Bools:
    """Return (S,) rows at the position of the row before, at a dwell of the file: no feed applies there."""
    at = [min(e.index, len(t.toolpath)) - 1 for e in t.toolpath.events if e.kind == "dwell"]
    if not at:
        return np.zeros(len(point), bool)
    axes = [name for name in t.motion.column_names if name[:1] in "qe" and name[1:2].isdigit()]
    moved = [np.append(True, np.diff(t.motion.read_numbers(name)) != 0.0) for name in axes]
    there = np.isin(np.round(np.nan_to_num(point, nan=-2.0)), at)
    return np.asarray(there & ~np.any(moved, axis=0))


def _is_unmoved(toolpath: Toolpath) -> Bools:
    """(n,) the move into a point neither goes nor turns; none leads into the first."""
    place = np.hstack([toolpath.position, toolpath.axis])
    return np.append(True, ~np.diff(place, axis=0).any(axis=1))
