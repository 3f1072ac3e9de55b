"""What result.json tells of objective, gains, compensation and front, recomputed from the tables."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from machopt.arrays import Array, Bools
from machopt.domain.results.optimize import ChoiceObjective, ExternalSearchBound, MeanGain, ObjectiveParts
from machopt.recheck.told import DIGITS, Points, Told, known, near, same, short
from machopt.verify.columns import read_columns

PRINTED = 2e-6  # relative: tables print seven significant digits
BESIDE = 1.03  # a planning point is no softer than this times the worst sample, half a degree of joint travel away
BETWEEN = 1.5  # nor than this times the worst of near toolpath points, where no sample tells
NINETY = 1.6448536269514722  # standard deviations of a 90 % interval
CROWDED = 0.2  # of the nearness: places between two points may be nearer or farther than both
NONE_PERCENT = 0.01  # a smaller difference of the means is no gain


def not_beyond(t: Told, most: float, along: float) -> float:
    """The worst index that may be told, in SI.

    Args:
        most: of the points in points.csv.
        along: of the samples between them, of the same stretch; NaN: not known. What is left then: compliance goes
            with the square of the lever, which a move of L m changes by no more than L, and arms reach a metre.
    """
    if np.isfinite(along):
        return max(most, along) * BESIDE
    step = np.linalg.norm(np.diff(t.toolpath.position, axis=0), axis=1)[t.toolpath.cutting[1:]]
    return float(most * BETWEEN * (1.0 + step.max(initial=0.0)) ** 2)


def objective(t: Told) -> Iterable[str]:
    parts, w = t.result.objective, t.options.weights
    for name, o in (
        ("cam_default", parts.cam_default),
        ("jiao2022", parts.jiao2022),
        ("grid", parts.grid),
        ("chosen", parts.chosen),
    ):
        if o.mean is None or o.worst is None:
            yield from same(f"objective.{name}.total", o.total, None)
            continue
        total = (
            w.mean * o.mean
            + w.worst * o.worst
            + w.travel * known("travel", o.travel)
            + w.rotation * known("rotation", o.rotation)
            + w.feed * known("feed", o.feed)
            + known("preferred", o.preferred)
            + w.clearance * known("clearance", o.clearance)
        )
        yield from near(f"objective.{name}.total", o.total, total, DIGITS, DIGITS)
        if isinstance(o, ChoiceObjective) and not 0.0 <= o.feasible_share <= 1.0:
            yield f"objective.{name}.feasible_share is {short(o.feasible_share)}, not a share"
    search = parts.search
    if search is not None:
        gap = 100.0 * (1.0 - search.lower_bound / search.sequence) if search.sequence > 0 else 0.0
        yield from near("objective.search.gap_percent", search.gap_percent, gap, DIGITS, DIGITS)
        if not 0.0 <= search.lower_bound <= search.sequence * (1 + DIGITS):
            yield "objective.search.lower_bound is not between nothing and the sequence"
        yield from _over_external(search.external)
        driven = known("chosen.total", parts.chosen.total)
        above = 100.0 * (driven / search.lower_bound - 1.0) if search.lower_bound > 0 else 0.0
        yield from near(
            "objective.search.plan_above_bound_percent", search.plan_above_bound_percent, above, DIGITS, 1e-7
        )
        grid, total = known("grid.total", parts.grid.total), known("chosen.total", parts.chosen.total)
        beyond = 100.0 * (1.0 - total / grid) if grid > 0 else 0.0
        yield from near("objective.search.beyond_grid_percent", search.beyond_grid_percent, beyond, DIGITS, 1e-7)
    own = parts.chosen
    cost = Points.read(t).cost(t)
    if own.worst is not None and np.isfinite(cost).any():
        told, most = own.worst * known("index_scale", t.result.index_scale), float(np.nanmax(cost))
        rounding = Points.read(t).cost_rounding(t)[int(np.nanargmax(cost))]
        if not most * (1 - PRINTED) - rounding <= told <= not_beyond(t, most, float(np.max(t.along))):
            yield f"objective.chosen.worst is {told:.9g} in the index's unit, points.csv has {most:.9g}"
        if not 0.0 < known("chosen.mean", own.mean) <= own.worst:
            yield "objective.chosen.mean is not between nothing and the worst"
    yield from _crowding(t, known("chosen.clearance", own.clearance))
    for gain in parts.gain:
        yield from _gain(gain, own, parts.cam_default if gain.over == "cam default" else parts.jiao2022)
    yield from same("objective.gain", [g.over for g in parts.gain], ["cam default", "jiao2022"])


def _over_external(e: ExternalSearchBound | None) -> Iterable[str]:
    """A gap over the values of external joints is stated where the plan is not below the bound, and nowhere else."""
    if e is None or e.lower_bound is None or e.plan is None:
        return
    where = "objective.search.external"
    if e.lower_bound <= e.plan:
        gap = 100.0 * (1.0 - e.lower_bound / e.plan) if e.plan > 0 else None
        if gap is None or e.gap_percent is None:
            yield from same(f"{where}.gap_percent", e.gap_percent, gap)
        else:
            yield from near(f"{where}.gap_percent", e.gap_percent, gap, DIGITS, DIGITS)
    else:
        yield from same(f"{where}.gap_percent", e.gap_percent, None)
    if e.sequence is not None and e.lower_bound > e.sequence * (1 + DIGITS):
        yield f"{where}.lower_bound is above the sequence"


def _crowding(t: Told, told: float) -> Iterable[str]:
    """The mean nearness along the cut: 0 where it does not count, else near to that of the points in points.csv."""
    if not t.options.weights.clearance:
        yield from same("objective.chosen.clearance", told, 0.0)
        return
    points = Points.read(t)
    counts = t.toolpath.cutting & np.isfinite(points.number("clearance_mm"))
    near = np.clip(1.0 - 1e-3 * points.number("clearance_mm")[counts] / t.options.clearance_full, 0.0, 1.0)
    if len(near) and not near.min() - CROWDED <= told <= near.max() + CROWDED:
        yield (
            f"objective.chosen.clearance is {told:.6g}, the points of points.csv have {near.min():.6g} to "
            f"{near.max():.6g}"
        )


def _gain(gain: MeanGain, own: ObjectiveParts, other: ObjectiveParts) -> Iterable[str]:
    name = f"gain over {gain.over}"
    if gain.mean_percent is None:
        yield from same(f"{name}: std_percent", gain.std_percent, None)
        yield from same(f"{name}: ci90", gain.ci90, None)
        return
    expected = 100.0 * (1.0 - known("chosen.mean", own.mean) / known(f"{gain.over}: mean", other.mean))
    yield from near(f"{name}: mean_percent", gain.mean_percent, expected, DIGITS, 1e-7)
    half = NONE_PERCENT
    yield from same(f"{name}: ci90 is there", gain.ci90 is not None, gain.std_percent is not None)
    if gain.std_percent is not None:
        half = max(half, NINETY * gain.std_percent)
        for value, sign in zip(gain.ci90 or (), (-1.0, 1.0), strict=True):
            yield from near(f"{name}: ci90", value, gain.mean_percent + sign * NINETY * gain.std_percent, 1e-3, 1e-3)
    yield from same(f"{name}: distinguishable", gain.distinguishable, not abs(gain.mean_percent) <= half)


def compensation(t: Told) -> Iterable[str]:
    told, file = t.result.compensation, t.folder / "compensation.csv"
    if not t.options.compensate or t.contents is None:
        yield from same("compensation", told, None)
        return
    if told is None:
        yield "compensation is null, yet the path is compensated"
        return
    columns = read_columns(file)
    index = np.array(columns["point"], float)
    shift = np.linalg.norm(np.array([columns[f"d{c}_mm"] for c in "xyz"], float), axis=0)
    at = np.clip(np.ceil(index - 1e-9).astype(int), 0, len(t.toolpath) - 1)
    yield from near("compensation.max_mm", told.max_mm, float(shift[t.toolpath.cutting[at]].max()), PRINTED, 1e-5)
    for small, large in (("mean_mm", "max_mm"), ("residual_mean_mm", "residual_max_mm")):
        if not 0.0 <= getattr(told, small) <= getattr(told, large) * (1 + PRINTED):
            yield f"compensation.{small} is not between nothing and {large}"


def front(t: Told) -> Iterable[str]:
    """front.csv, the table in result.json, and the motion that lies in the folder, which is the first of them."""
    told, file = t.result.front, t.folder / "front.csv"
    if told is None:
        if file.exists():
            yield "names no front, yet there is a front.csv"
        return
    rows = read_columns(file)
    free = [p for p in told if not p.dominated]
    for name, words in rows.items():
        if name in ("plan", "changed"):
            yield from same(f"front.csv: {name}", words, [getattr(p, name) for p in free])
            continue
        yield from same(f"front.csv: rows of {name}", len(words), len(free))
        for p, word in zip(free, words, strict=True):
            found = getattr(p, name)
            if (found is None) != (word == ""):
                yield f"front.csv: {name} of {p.plan} is {word!r}, result.json has {short(found)}"
            elif word:
                yield from near(f"front.csv: {name} of {p.plan}", float(word), found, 1e-8, 0.0)
    keys = ("mean_index", "cycle_time_s", "joint_travel_deg", "clearance_mm")
    known_of = [[(k, getattr(p, k)) for k in keys if getattr(p, k) is not None] for p in told]
    less = [[(-1.0 if k == "clearance_mm" else 1.0) * v for k, v in row] for row in known_of]
    for p, a in zip(told, less, strict=True):
        pairs = [list(zip(a, b, strict=True)) for b in less]
        under = any(all(y <= x for x, y in c) and any(y < x - 1e-5 * abs(x) for x, y in c) for c in pairs)
        if under and not p.dominated:
            yield f"front: {p.plan} is not told as dominated, yet another plan is nowhere worse"
    own, q = told[0], np.array([t.motion.numbers(f"q{j}_deg") for j in range(1, 7)])
    chosen, scale = t.result.objective.chosen, 1e3 * known("index_scale", t.result.index_scale)
    yield from near("front: mean_index", own.mean_index, scale * known("chosen.mean", chosen.mean), DIGITS, 0.0)
    yield from near("front: worst_index", own.worst_index, scale * known("chosen.worst", chosen.worst), DIGITS, 0.0)
    yield from near("front: objective", own.objective, known("chosen.total", chosen.total), DIGITS, 0.0)
    yield from near("front: cycle_time_s", own.cycle_time_s, t.result.cycle_time_s, DIGITS, 0.0)
    yield from near("front: joint_travel_deg", own.joint_travel_deg, float(np.abs(np.diff(q)).sum()), 1e-3, 0.1)
    least = Points.read(t).number("clearance_mm")
    if np.isfinite(least).any():
        yield from near("front: clearance_mm", own.clearance_mm, float(np.nanmin(least)), PRINTED, 1e-3)


def lie_within(values: Array, ranges: Array) -> Bools:
    """(n,) which of the values (n,) lie in any of the closed ranges (K, 2); the time follows n + K, not n · K."""
    order = np.argsort(values, kind="stable")
    first = np.searchsorted(values[order], ranges[:, 0], side="left")
    stop = np.searchsorted(values[order], ranges[:, 1], side="right")
    real = first < stop
    steps = np.bincount(first[real], minlength=len(values) + 1) - np.bincount(stop[real], minlength=len(values) + 1)
    out = np.zeros(len(values), bool)
    out[order] = np.cumsum(steps)[:-1] > 0
    return out
