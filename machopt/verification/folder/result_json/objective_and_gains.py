"""Objective, gains, compensation and trade-off front of result.json, recomputed from the tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from machopt.data_types.documents.optimize_document import (
    ChoiceObjectiveSection,
    CompensationSection,
    ExternalSearchBoundSection,
    MeanGainEntry,
    ObjectivePartsSection,
    ObjectivesSection,
    ParetoPlanEntry,
    SearchBoundSection,
)
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
from machopt.verification.folder.result_json.rapid_terms import check_rapid_terms
from machopt.verification.motion.checks.compensation_shift import compute_force_errors, compute_force_tolerance
from machopt.verification.tables.csv_columns import read_columns

PRINTED_TOLERANCE = 2e-6  # relative: tables print seven significant digits
POINT_TO_SAMPLE_FACTOR = (
    1.03  # a planning point is no softer than this times the worst sample, half a degree of joint travel away
)
POINT_TO_NEIGHBOUR_FACTOR = 1.5  # nor than this times the worst of near toolpath points, where no sample shows it
Z_90_PERCENT = 1.6448536269514722  # standard deviations of a 90 % interval
NEARNESS_TOLERANCE = 0.2  # of the nearness: places between two points may be nearer or farther than both
MIN_GAIN_PERCENT = 0.01  # a smaller difference of the means is no gain
PRINTED_DEPTH = 1e-4  # mm, last decimal of a_lim_mm
LARGEST_RATIO = 10.0  # of the stable depth of cut over the planned one in a front
ROUND_OFF = 1e-12  # relative: bound and plan may be sums of the same terms in another order


def limit_worst_index(t: ResultComparison, most: float, along: float) -> float:
    """Return the worst index that may be reported, SI.

    Args:
        t: Result.json and everything that it is compared with.
        most: Worst index of the points in points.csv.
        along: Worst index of the samples between them, of the same stretch. If it is NaN, a bound is used: compliance
            grows with the square of the lever, which a move of L m changes by at most L, and arms reach 1 m.
    """
    if np.isfinite(along):
        return max(most, along) * POINT_TO_SAMPLE_FACTOR
    step = np.linalg.norm(np.diff(t.toolpath.position, axis=0), axis=1)[t.toolpath.cutting[1:]]
    return float(most * POINT_TO_NEIGHBOUR_FACTOR * (1.0 + step.max(initial=0.0)) ** 2)


def check_objective(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with objective and gains.

    Args:
        t: Result.json and everything that it is compared with.
    """
    parts, w = t.result.objective, t.options.weights
    for name, o in (
        ("cam_default", parts.cam_default),
        ("jiao2022", parts.jiao2022),
        ("grid", parts.grid),
        ("chosen", parts.chosen),
    ):
        if o.mean is None or o.worst is None:
            yield from check_equal(f"objective.{name}.total", o.total, None)
            continue
        total = (
            w.mean * o.mean
            + w.worst * o.worst
            + w.travel * require_number("travel", o.travel)
            + w.rotation * require_number("rotation", o.rotation)
            + w.feed * require_number("feed", o.feed)
            + require_number("preferred", o.preferred)
            + w.clearance * require_number("clearance", o.clearance)
            + require_number("tolerance", o.tolerance)
            + require_number("stability", o.stability)
            + w.rapid * require_number("rapid", o.rapid)
            + w.reorientation * require_number("reorientation", o.reorientation)
        )
        if t.options.objective != "tolerance":
            yield from check_equal(f"objective.{name}.tolerance", o.tolerance, 0.0)
        yield from check_close(f"objective.{name}.total", o.total, total, RELATIVE_TOLERANCE, RELATIVE_TOLERANCE)
        if isinstance(o, ChoiceObjectiveSection) and not 0.0 <= o.feasible_share <= 1.0:
            yield f"objective.{name}.feasible_share is {format_json_value(o.feasible_share)}, not a share"
    if parts.search is not None:
        yield from _check_search(parts, parts.search)
    yield from _check_worst_index(t)
    own = parts.chosen
    yield from _check_mean_nearness(t, require_number("chosen.clearance", own.clearance))
    yield from check_rapid_terms(t)
    for gain in parts.gain:
        yield from _check_gain(gain, own, parts.cam_default if gain.over == "cam default" else parts.jiao2022)
    yield from check_equal("objective.gain", [g.over for g in parts.gain], ["cam default", "jiao2022"])


def _check_search(parts: ObjectivesSection, search: SearchBoundSection) -> Iterable[str]:
    """Yield what is wrong with bound and gap."""
    gap = 100.0 * (1.0 - search.lower_bound / search.sequence) if search.sequence > 0 else 0.0
    yield from check_close(
        "objective.search.gap_percent", search.gap_percent, gap, RELATIVE_TOLERANCE, RELATIVE_TOLERANCE
    )
    if not 0.0 <= search.lower_bound <= search.sequence * (1 + RELATIVE_TOLERANCE):
        yield "objective.search.lower_bound is not between nothing and the sequence"
    yield from _check_external_gap(search.external)
    driven = require_number("chosen.total", parts.chosen.total)
    above = 100.0 * (driven / search.lower_bound - 1.0) if search.lower_bound > 0 else 0.0
    yield from check_close(
        "objective.search.plan_above_bound_percent",
        search.plan_above_bound_percent,
        above,
        RELATIVE_TOLERANCE,
        1e-7,
    )
    grid, total = require_number("grid.total", parts.grid.total), require_number("chosen.total", parts.chosen.total)
    beyond = 100.0 * (1.0 - total / grid) if grid > 0 else 0.0
    yield from check_close(
        "objective.search.beyond_grid_percent", search.beyond_grid_percent, beyond, RELATIVE_TOLERANCE, 1e-7
    )


def _check_worst_index(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the worst index, by points.csv."""
    own = t.result.objective.chosen
    cost = CheckedPoints.from_file(t).compute_cost(t)
    if own.worst is not None and np.isfinite(cost).any():
        stated, most = own.worst * require_number("index_scale", t.result.index_scale), float(np.nanmax(cost))
        rounding = CheckedPoints.from_file(t).cost_rounding(t)[int(np.nanargmax(cost))]
        if (
            not most * (1 - PRINTED_TOLERANCE) - rounding
            <= stated
            <= limit_worst_index(t, most, float(np.max(t.worst_along_cuts)))
        ):
            yield f"objective.chosen.worst is {stated:.9g} in the index's unit, points.csv has {most:.9g}"
        if not 0.0 < require_number("chosen.mean", own.mean) <= own.worst * (1.0 + RELATIVE_TOLERANCE):
            yield "objective.chosen.mean is not between nothing and the worst"


def _check_external_gap(e: ExternalSearchBoundSection | None) -> Iterable[str]:
    """A gap over the values of external joints is stated where the plan is not below the bound, and nowhere else."""
    if e is None or e.lower_bound is None or e.plan is None:
        return
    where = "objective.search.external"
    if e.lower_bound <= e.plan * (1.0 + ROUND_OFF):
        gap = max(100.0 * (1.0 - e.lower_bound / e.plan), 0.0) if e.plan > 0 else None
        if gap is None or e.gap_percent is None:
            yield from check_equal(f"{where}.gap_percent", e.gap_percent, gap)
        else:
            yield from check_close(f"{where}.gap_percent", e.gap_percent, gap, RELATIVE_TOLERANCE, RELATIVE_TOLERANCE)
    else:
        yield from check_equal(f"{where}.gap_percent", e.gap_percent, None)
    if e.sequence is not None and e.lower_bound > e.sequence * (1 + RELATIVE_TOLERANCE):
        yield f"{where}.lower_bound is above the sequence"


def _check_mean_nearness(t: ResultComparison, stated: float) -> Iterable[str]:
    """The mean nearness along the cut: 0 where it does not count, else near to that of the points in points.csv."""
    if not t.options.weights.clearance:
        yield from check_equal("objective.chosen.clearance", stated, 0.0)
        return
    points = CheckedPoints.from_file(t)
    cut = t.toolpath.cutting
    counts = (cut | np.r_[cut[1:], False]) & np.isfinite(points.get_column("clearance_mm"))  # ends of all cut moves
    near = np.clip(1.0 - 1e-3 * points.get_column("clearance_mm")[counts] / t.options.clearance_full, 0.0, 1.0)
    if len(near) and not near.min() - NEARNESS_TOLERANCE <= stated <= near.max() + NEARNESS_TOLERANCE:
        yield (
            f"objective.chosen.clearance is {stated:.6g}, the points of points.csv have {near.min():.6g} to "
            f"{near.max():.6g}"
        )


def _check_gain(
    gain: MeanGainEntry, objective_parts_section: ObjectivePartsSection, other: ObjectivePartsSection
) -> Iterable[str]:
    name = f"gain over {gain.over}"
    if gain.mean_percent is None:
        yield from check_equal(f"{name}: std_percent", gain.std_percent, None)
        yield from check_equal(f"{name}: ci90", gain.ci90, None)
        return
    expected = 100.0 * (
        1.0
        - require_number("chosen.mean", objective_parts_section.mean) / require_number(f"{gain.over}: mean", other.mean)
    )
    yield from check_close(f"{name}: mean_percent", gain.mean_percent, expected, RELATIVE_TOLERANCE, 1e-7)
    half = MIN_GAIN_PERCENT
    yield from check_equal(f"{name}: ci90 is there", gain.ci90 is not None, gain.std_percent is not None)
    if gain.std_percent is not None:
        half = max(half, Z_90_PERCENT * gain.std_percent)
        for value, sign in zip(gain.ci90 or (), (-1.0, 1.0), strict=True):
            yield from check_close(
                f"{name}: ci90", value, gain.mean_percent + sign * Z_90_PERCENT * gain.std_percent, 1e-3, 1e-3
            )
    yield from check_equal(f"{name}: distinguishable", gain.distinguishable, not abs(gain.mean_percent) <= half)


def check_compensation(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the compensation section.

    Args:
        t: Result.json and everything that it is compared with.
    """
    stated, file = t.result.compensation, t.folder / "compensation.csv"
    if not t.options.compensate or t.contents is None:
        yield from check_equal("compensation", stated, None)
        return
    if stated is None:
        yield "compensation is null, yet the path is compensated"
        return
    columns = read_columns(file)
    index = np.array(columns["point"], float)
    shift = np.linalg.norm(np.array([columns[f"d{c}_mm"] for c in "xyz"], float), axis=0)
    at = np.clip(np.ceil(index - 1e-9).astype(int), 0, len(t.toolpath) - 1)
    yield from check_close(
        "compensation.max_mm", stated.max_mm, float(shift[t.toolpath.cutting[at]].max()), PRINTED_TOLERANCE, 1e-5
    )
    for small, large in (("mean_mm", "max_mm"), ("residual_mean_mm", "residual_max_mm")):
        if not 0.0 <= getattr(stated, small) <= getattr(stated, large) * (1 + PRINTED_TOLERANCE):
            yield f"compensation.{small} is not between nothing and {large}"
    yield from _check_force_lengths(t, stated, columns)


def _check_force_lengths(
    t: ResultComparison, stated: CompensationSection, columns: Mapping[str, list[str]]
) -> Iterable[str]:
    """The force of compensation.csv turns and fades over the stated lengths; a job with several tools has several."""
    segments, options = t.segments
    if stated.fade_mm is None or stated.length_mm is None or len(segments) > 1 or not options.force.given:
        return
    toolpath = segments[0].toolpath
    force = np.array([columns[f"f{c}_N"] for c in "xyz"], float).T
    errors = compute_force_errors(toolpath, np.array(columns["point"], float), force, options)
    off = errors.get((round(1e-3 * stated.length_mm, 9), round(1e-3 * stated.fade_mm, 9)))
    if off is None or not off.max() <= compute_force_tolerance(toolpath, options):
        yield (
            f"compensation.length_mm {stated.length_mm:g} and fade_mm {stated.fade_mm:g} are not those over which the "
            "force of compensation.csv turns and fades"
        )


def check_trade_off_front(t: ResultComparison) -> Iterable[str]:
    """Yield what differs between front.csv, the front in result.json, and the motion in the folder, which is its
    first plan.

    Args:
        t: Result.json and everything that it is compared with.
    """
    stated, file = t.result.front, t.folder / "front.csv"
    if stated is None:
        if file.exists():
            yield "names no front, yet there is a front.csv"
        return
    rows = read_columns(file)
    free = [p for p in stated if not p.dominated]
    for name, words in rows.items():
        if name in ("plan", "changed"):
            yield from check_equal(f"front.csv: {name}", words, [getattr(p, name) for p in free])
            continue
        yield from check_equal(f"front.csv: rows of {name}", len(words), len(free))
        for p, word in zip(free, words, strict=True):
            found = getattr(p, name)
            if (found is None) != (word == ""):
                yield f"front.csv: {name} of {p.plan} is {word!r}, result.json has {format_json_value(found)}"
            elif word:
                yield from check_close(f"front.csv: {name} of {p.plan}", float(word), found, 1e-8, 0.0)
    signs = {"mean_index": 1.0, "cycle_time_s": 1.0, "joint_travel_deg": 1.0, "mean_error_mm": 1.0}
    signs |= {"clearance_mm": -1.0, "in_tolerance": -1.0, "least_stability_ratio": -1.0}
    less = [{k: sign * getattr(p, k) for k, sign in signs.items() if getattr(p, k) is not None} for p in stated]
    for p, a in zip(stated, less, strict=True):
        pairs = [[(a[k], b[k]) for k in signs if k in a and k in b] for b in less]
        under = any(all(y <= x for x, y in c) and any(y < x - 1e-5 * abs(x) for x, y in c) for c in pairs)
        if under and not p.dominated:
            yield f"front: {p.plan} is not marked as dominated, but another plan is at least as good in every criterion"
    own, q = stated[0], np.array([t.motion.read_numbers(f"q{j}_deg") for j in range(1, 7)])
    chosen, scale = t.result.objective.chosen, 1e3 * require_number("index_scale", t.result.index_scale)
    yield from check_close(
        "front: mean_index", own.mean_index, scale * require_number("chosen.mean", chosen.mean), RELATIVE_TOLERANCE, 0.0
    )
    yield from check_close(
        "front: worst_index",
        own.worst_index,
        scale * require_number("chosen.worst", chosen.worst),
        RELATIVE_TOLERANCE,
        0.0,
    )
    yield from check_close(
        "front: objective", own.objective, require_number("chosen.total", chosen.total), RELATIVE_TOLERANCE, 0.0
    )
    yield from check_close("front: cycle_time_s", own.cycle_time_s, t.result.cycle_time_s, RELATIVE_TOLERANCE, 0.0)
    yield from check_close("front: joint_travel_deg", own.joint_travel_deg, float(np.abs(np.diff(q)).sum()), 1e-3, 0.1)
    least = CheckedPoints.from_file(t).get_column("clearance_mm")
    if np.isfinite(least).any():
        yield from check_close(
            "front: clearance_mm", own.clearance_mm, float(np.nanmin(least)), PRINTED_TOLERANCE, 1e-3
        )
    yield from _check_process_of_front(t, own)


def _check_process_of_front(t: ResultComparison, pareto_plan_entry: ParetoPlanEntry) -> Iterable[str]:
    """Yield what of outcomes, errors and stability of the first plan does not follow from points.csv."""
    if "outcome" not in t.points:
        return
    words, chatter = (np.array(t.points.read_words(name), dtype=object) for name in ("outcome", "chatter"))
    counts = {"in_tolerance": "pass", "marginal": "marginal", "fail": "fail", "unknown": "unknown"}
    for key, word in counts.items():
        if pareto_plan_entry.in_tolerance is not None or (words == word).any():
            yield from check_equal(f"front: {key}", getattr(pareto_plan_entry, key), int(np.sum(words == word)))
    normal, across = (np.abs(t.points.read_numbers(f"error_{n}_mm", empty=True)) for n in ("normal", "across"))
    error = np.where(np.isfinite(normal), normal, across)[words != ""]
    if np.isfinite(error).any():
        yield from check_close(
            "front: mean_error_mm", pareto_plan_entry.mean_error_mm, float(np.nanmean(error)), 0.0, 1e-5
        )
        yield from check_close(
            "front: worst_error_mm", pareto_plan_entry.worst_error_mm, float(np.nanmax(error)), 0.0, 1e-5
        )
    if not (chatter != "").any() or (chatter == "unknown").any():
        yield from check_equal("front: least_stability_ratio", pareto_plan_entry.least_stability_ratio, None)
        return
    limit, depth = (t.points.read_numbers(name, empty=True)[chatter != ""] for name in ("a_lim_mm", "ap_mm"))
    ratio = min(float(np.min(np.where(np.isfinite(limit), limit, np.inf) / depth)), LARGEST_RATIO)
    rounding = PRINTED_DEPTH / float(depth.min())
    yield from check_close(
        "front: least_stability_ratio", pareto_plan_entry.least_stability_ratio, ratio, 0.0, rounding
    )


def is_within_ranges(values: Array, ranges: Array) -> Bools:
    """Return (n,) whether each value lies in any of the closed ranges, in O(n + K) time after sorting.

    Args:
        values: (n,) values.
        ranges: (K, 2) lower and upper ends.
    """
    order = np.argsort(values, kind="stable")
    first = np.searchsorted(values[order], ranges[:, 0], side="left")
    stop = np.searchsorted(values[order], ranges[:, 1], side="right")
    real = first < stop
    steps = np.bincount(first[real], minlength=len(values) + 1) - np.bincount(stop[real], minlength=len(values) + 1)
    out = np.zeros(len(values), bool)
    out[order] = np.cumsum(steps)[:-1] > 0
    return out
