"""Section ``process`` of result.json compared with points.csv and process.yaml."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from machopt.data_types.documents.process_entries import ProcessSection
from machopt.verification.folder.result_json.comparison_inputs import ResultComparison, check_close, check_equal
from machopt.verification.motion.process.hole_strokes import list_holes
from machopt.verification.motion.process.point_loads import find_operations
from machopt.verification.tables.advised_feeds import ADVISED

OUTCOMES = ("pass", "marginal", "fail", "unknown")
SHARE_TOLERANCE = 1e-6
SLOWED = 5e-4  # share: half of what an advice keeps below the largest feed
PRINTED_DEPTH = 1e-4  # mm, last decimal of a_lim_mm


def check_process_section(t: ResultComparison) -> Iterable[str]:
    """Yield what in the section does not follow from points.csv and process.yaml.

    Args:
        t: Result.json and everything that it is compared with.
    """
    found, process = t.result.process, t.cell.process
    if found is None or process is None:
        if (found is None) != (process is None):
            yield "process is there without a process of the cell" if process is None else "process is missing"
        return
    yield from check_equal("process.quantile", found.quantile, process.quantile)
    words = np.array(t.points.read_words("outcome"), dtype=object)
    counts = {word: int(np.sum(words == word)) for word in OUTCOMES}
    yield from check_equal("process.in_tolerance.after", dict(found.in_tolerance.after), counts)
    total = sum(counts.values())
    for name, before in (
        ("before", found.in_tolerance.before),
        ("before_jiao2022", found.in_tolerance.before_jiao2022),
    ):
        if sum(before.values()) != total:
            yield f"process.in_tolerance.{name} counts {sum(before.values())} points, points.csv has {total}"
    yield from _check_tolerances(t, found, words)
    yield from _check_stability(t, found)
    yield from _check_advised_feed(t, found)
    if found.variance_shares:
        yield from check_close(
            "process.variance_shares", sum(found.variance_shares.values()), 1.0, SHARE_TOLERANCE, 0.0
        )
    if total and f"{counts['pass']} of " not in found.headline and len(found.tolerances) == 1:
        yield "process.headline does not state the number of points in tolerance"


def _check_stability(t: ResultComparison, process_section: ProcessSection) -> Iterable[str]:
    """Yield what in the stability does not follow from points.csv."""
    words, stated = np.array(t.points.read_words("chatter"), dtype=object), process_section.stability
    if stated is None or not any(words):
        if (stated is None) == any(words):
            yield "process.stability does not fit the column chatter of points.csv"
        return
    yield from check_equal(
        "process.stability.min_stability_ratio", stated.min_stability_ratio, t.options.min_stability_ratio
    )
    counts = {name: int(np.sum(words == name)) for name in ("stable", "unknown")}
    counts["unstable"] = int(np.sum(words != "")) - sum(counts.values())
    for name, count in counts.items():
        yield from check_equal(f"process.stability.{name}", getattr(stated, name), count)
    ok = np.array(t.points.read_words("status"), dtype=object) == "ok"
    beyond = [pair for pair in stated.unknown_points if not 0 <= pair[0] <= pair[1] < len(words)]
    if beyond:
        yield f"process.stability.unknown_points has {list(beyond[0])}; first and last point are 0 to {len(words) - 1}"
    else:
        listed = [p for first, last in stated.unknown_points for p in range(first, last + 1)]
        unknown = np.flatnonzero((words == "unknown") & ok).tolist()
        yield from check_equal("process.stability.unknown_points", listed, unknown)
    limit, depth = (t.points.read_numbers(name, empty=True) for name in ("a_lim_mm", "ap_mm"))
    is_known = (words != "") & (words != "unknown")
    if not (depth[is_known] > 0).all():
        yield "process.stability: points.csv has a milled point whose ap_mm is not above 0"
        return
    ratio = np.full(len(words), np.nan)
    ratio[is_known] = limit[is_known] / depth[is_known]
    if not np.isfinite(ratio).any():
        yield from check_equal("process.stability.least_ratio", stated.least_ratio, None)
        return
    if stated.least_ratio is None or stated.least_point is None:
        yield f"process.stability states no least ratio and its point; points.csv has {np.nanmin(ratio):.4g}"
        return
    rounding = PRINTED_DEPTH / float(np.min(depth[is_known]))
    yield from check_close("process.stability.least_ratio", stated.least_ratio, float(np.nanmin(ratio)), 0.0, rounding)
    at = float(ratio[stated.least_point]) if 0 <= stated.least_point < len(ratio) else np.nan
    yield from check_close("process.stability.least_point", stated.least_ratio, at, 0.0, rounding)


def _check_advised_feed(t: ResultComparison, process_section: ProcessSection) -> Iterable[str]:
    """Yield what in the feeds below those of the file does not follow from options and points.csv."""
    stated, share = process_section.advised_feed, t.options.advised_feed_share
    if stated is None or share is None or t.options.method == "joint":
        is_expected = share is not None and t.options.method != "joint" and t.contents is not None
        if is_expected != (stated is not None):
            yield "process.advised_feed does not fit advised_feed_share of the options"
        return
    yield from check_equal("process.advised_feed.share", stated.share, share)
    yield from check_equal("process.advised_feed.slowed", stated.slowed, len(_find_slowed_places(t)))
    if stated.slowed != math.ceil(share * stated.needed - 1e-9):
        yield f"process.advised_feed.slowed is {stated.slowed} of {stated.needed}, the share is {share:g}"


def _find_slowed_places(t: ResultComparison) -> set[int]:
    """Return the milled points and deepest points of holes whose exported feed is below that of the file."""
    advised, of_file = (t.points.read_numbers(name, empty=True) for name in (ADVISED, "feed_mm_min"))
    assert t.cell.process is not None
    place = np.arange(len(advised))
    for hole in list_holes(t.cell.process, t.toolpath, find_operations(t.cell.process, t.toolpath)):
        place[[stroke.point for stroke in hole.strokes]] = hole.deepest
    return set(place[advised < (1.0 - SLOWED) * of_file].tolist())


def _check_tolerances(t: ResultComparison, process_section: ProcessSection, words: np.ndarray) -> Iterable[str]:
    """Yield what is wrong in the rows of the operations."""
    summed = {word: sum(row.counts.get(word, 0) for row in process_section.tolerances) for word in OUTCOMES}
    yield from check_equal("process.tolerances: counts", summed, dict(process_section.in_tolerance.after))
    p_in = t.points.read_numbers("p_in", empty=True)
    across, normal, along = (
        t.points.read_numbers(f"error_{name}_mm", empty=True) for name in ("across", "normal", "along")
    )
    for row in process_section.tolerances:
        point = row.worst_point
        if not 0 <= point < len(words) or not words[point]:
            yield f"process.tolerances: {row.operation}: point {point} has no outcome"
            continue
        if row.worst_p_in is not None and np.isfinite(p_in[point]):
            yield from check_close(f"process.tolerances: {row.operation}: p_in", row.worst_p_in, p_in[point], 0.0, 1e-4)
        stated = normal if row.kind == "surface" else across if "position_mm" in row.limits else along
        if row.worst_error_mm is not None:
            error = abs(float(stated[point]))
            yield from check_close(f"process.tolerances: {row.operation}: error", row.worst_error_mm, error, 1e-4, 1e-5)
