"""result.json held against what it was drawn from: tables, inputs, options, the manifest and the verification itself.

What is not checked here follows from the planner alone: the two yardsticks' costs (their sums and the gains made of
them are), the standard deviations of the gains, stage times, detours, how
deep each feed dip is, and the hints among the warnings; and the sentences under ``reason`` of points.csv (that a point
has one, and its status, are checked).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest, ManifestFile, with_scope
from machopt.domain.options import PlanOptions
from machopt.domain.results.optimize import ChoiceObjective, MeanGain, ObjectiveParts, OptimizeResult
from machopt.domain.toolpath import Move, Toolpath
from machopt.errors import InputError
from machopt.formats.options import options_as_user
from machopt.output.hashes import sha256_of
from machopt.output.jsonfile import plain, read_json
from machopt.output.manifest import MANIFEST, listed
from machopt.services.manifest import BATCH_ROLES
from machopt.services.resultform import wrong_parts
from machopt.services.resultprograms import programs
from machopt.services.scope import checked, done, not_run, unchecked
from machopt.services.told import AGREE, DIGITS, Points, Told, known, near, same, same_items, short
from machopt.verify import Check, Verification
from machopt.verify.table import read_columns

Array = NDArray[np.float64]
PRINTED = 2e-6  # relative: tables print seven significant digits
LAST = {"k_axial_N_mm": 6e-5, "k_normal_N_mm": 6e-5, "k_jiao_x_N_mm": 6e-5, "deflection_mm": 1e-6, "gamma_deg": 1e-6}
BETWEEN = 1.5  # a planning point between toolpath points is no softer than this times the worst of them
NINETY = 1.6448536269514722  # standard deviations of a 90 % interval
CROWDED = 0.2  # of the nearness: places between two points may be nearer or farther than both
NONE_PERCENT = 0.01  # a smaller difference of the means is no gain
HELD = 0.95  # of the programmed feed: what counts as held
ON_POINT = 1e-6  # of a point index: printed with six decimals or more
FEED = 1e-4  # of the programmed feed: feeds are printed to 0.001 mm/min
VERDICTS = {3: "infeasible", 4: "verification failed"}


def result_checks(
    folder: Path,
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    inputs: tuple[ManifestFile, ...],
    manifest: Manifest | None,
    contents: Verification | None,
) -> list[Check]:
    """One check for each part of result.json; a part that is missing or malformed fails its check."""
    file = folder / "result.json"
    try:
        value = read_json(file)
    except InputError as problem:
        return [_check("result.json", [str(problem)])]
    try:
        result = OptimizeResult.model_validate(value)
    except ValidationError as problem:  # what somebody else wrote into the file may be of any shape
        return [_check(f"result.json {part}", said) for part, said in wrong_parts(problem).items()]
    told = Told(result, folder, cell, toolpath, options, manifest.inputs if manifest else inputs, manifest, contents)
    return [_check(f"result.json {name}", _tried(part, told)) for name, part in _PARTS.items()]


def _tried(part: Callable[[Told], Iterable[str]], told: Told) -> list[str]:
    """The part's findings; numbers of a foreign file may fit the schema and yet lead nowhere."""
    try:
        return list(part(told))
    except InputError as problem:
        return [str(problem)]
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as problem:
        return [f"is not of the form that machopt writes: {_words(problem)}"]


def _words(problem: Exception) -> str:
    """What somebody who knows no Python makes something of."""
    if isinstance(problem, KeyError):
        return f"the key {short(problem.args[0])} is missing"
    if isinstance(problem, ValueError) and problem.args:
        return str(problem)
    return "a value is of another kind there"


def _check(name: str, wrong: list[str]) -> Check:
    more = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
    return Check(name, not wrong, float(len(wrong)), 0.0, "differences", "; ".join(wrong[:3]) + more)


def _verdict(t: Told) -> Iterable[str]:
    code, found = t.result.exit_code, t.contents
    expected = 3 if found is None else (0 if found.ok else 4)
    yield from same("exit_code", code, expected)
    missing = (*unchecked(t.cell, t.options), *(not_run(found.checks) if found else ()))
    yield from same("unchecked", t.result.unchecked, list(missing))
    word = VERDICTS.get(expected)
    if word is None:
        lacking = ~Points.read(t).ok
        word = done(int((lacking & t.toolpath.cutting).sum()), int((lacking & ~t.toolpath.cutting).sum()))
    yield from same("verdict", t.result.verdict, with_scope(word, missing))
    if t.manifest is not None:
        for key, value in (("verdict", t.manifest.verdict), ("exit_code", t.manifest.exit_code)):
            yield from same(f"{key} (of the manifest)", value, getattr(t.result, key))
        yield from same("unchecked (of the manifest)", list(t.manifest.unchecked), list(missing))
        told = [f"{c.what}: {c.how}" for c in t.manifest.checked]
        yield from same("checked (of the manifest)", told, [f"{c.what}: {c.how}" for c in checked(t.options)])
        yield from same("version", t.result.version, t.manifest.versions.get("machopt"))


def _inputs(t: Told) -> Iterable[str]:
    yield from same_items("inputs", t.result.inputs, {f.name: f.sha256 for f in t.inputs})
    yield from same("cell", t.result.cell, t.cell.name)


def _outputs(t: Told) -> Iterable[str]:
    later = {"result.json", MANIFEST, *BATCH_ROLES}
    there = {name: sha256_of(t.folder / name) for name in listed(t.folder) - later}
    yield from same_items("outputs", t.result.outputs, there)
    for name in ("points.csv", "report.html", *(("trajectory.csv",) if t.contents is not None else ())):
        if name not in there:
            yield f"{name} is missing; optimize writes it always"


def _options(t: Told) -> Iterable[str]:
    recorded = t.manifest.options if t.manifest else plain(options_as_user(t.options))
    yield from same_items("options", t.result.options, recorded)
    if t.manifest is not None:
        yield from same_items("reading", t.result.reading, t.manifest.reading)
    index = t.options.index
    if index == "auto":
        index = "deflection" if t.options.force.given else "stiffness"
    yield from same("index", t.result.index, index)
    own = {
        "global": ("smooth", "grid", "smooth and grid", "jiao2022", "cam default"),
        "jiao2022": ("jiao2022",),
        "default": ("cam default",),
    }[t.options.method]
    if t.result.chosen_from not in own:
        yield f"chosen_from is {short(t.result.chosen_from)}; method {t.options.method} gives {', '.join(own)}"


def _toolpath(t: Told) -> Iterable[str]:
    found, path = t.result.toolpath, t.toolpath
    recorded = [f.name for f in t.inputs if f.role == "toolpath"]
    expected = {
        "source": recorded[0] if recorded else path.source,
        "format": path.format,
        "points": len(path),
        "cutting_points": int(path.cutting.sum()),
        "operations": [o.label for o in path.operations],
        "ignored": [vars(w) for w in path.ignored],
    }
    yield from same_items("toolpath", found.plain(), plain(expected))


def _worst(t: Told) -> Iterable[str]:
    points = Points.read(t)
    worst = t.result.worst_point
    cost = points.cost(t)
    if not np.isfinite(cost).any():
        yield from same("worst_point", worst, None)
        return
    if worst is None:
        yield "worst_point is null, yet points are cut to"
        return
    n, most = worst.point, float(np.nanmax(cost))
    if not cost[n] >= most * (1 - PRINTED):
        yield f"worst_point is {n}, but point {int(np.nanargmax(cost))} is softer"
    for key in ("k_axial_N_mm", "k_normal_N_mm", "deflection_mm", "k_jiao_x_N_mm", "gamma_deg"):
        yield from near(f"worst_point.{key}", getattr(worst, key), points.number(key)[n], PRINTED, LAST[key])
    for joint, degrees in enumerate(worst.q_deg, 1):  # to four decimals
        yield from near(f"worst_point.q{joint}", degrees, points.number(f"q{joint}_deg")[n], 0.0, 6e-5)
    yield from same("worst_point.q_deg", len(worst.q_deg), 6)


def _infeasible(t: Told) -> Iterable[str]:
    points = Points.read(t)
    status, reason = points.table.words("status"), points.table.words("reason")
    keys = ("point", "status", "reason")
    expected = [dict(zip(keys, (n, word, reason[n]), strict=True)) for n, word in enumerate(status) if word != "ok"]
    found = [{key: getattr(p, key) for key in keys} for p in t.result.infeasible_points]
    if found != expected:
        yield f"{len(found)} infeasible points are named, points.csv has {len(expected)} or gives other reasons"
    if t.contents is not None and t.result.obstructions:
        yield "names obstructions, yet there is a motion"
    if t.contents is not None and t.result.breaks and not t.options.allow_gaps:
        yield "names breaks of the motion, yet there is one and no gaps were allowed"
    if t.contents is None and not t.result.infeasible_points and not t.result.breaks:
        yield "there is no motion, and no place is named where it fails"


def _times(t: Told) -> Iterable[str]:
    if t.contents is None:
        yield from same("cycle_time_s", t.result.cycle_time_s, None)
        return
    yield from near("cycle_time_s", t.result.cycle_time_s, float(t.motion.numbers("time_s")[-1]), 0.0, 1e-5)
    for name, seconds in t.result.timings_s.items():
        if not (isinstance(seconds, float | int) and math.isfinite(seconds) and seconds >= 0):
            yield f"timings_s.{name} is {short(seconds)}"


def _feed(t: Told) -> Iterable[str]:
    """Share of the cutting time near the programmed feed, and where it falls short of it, from the samples."""
    share, dips = t.result.feed_held_share, t.result.feed_dips
    if t.contents is None:
        yield from same("feed_held_share", share, None)
        yield from same("feed_dips", dips, [])
        return
    number = {k: t.motion.numbers(k, empty=True) for k in ("point", "feed_mm_min")}
    move = np.array(t.motion.words("move"))
    fed = (move != Move.RAPID.word) & np.isfinite(number["point"])  # dips begin in approaches too
    cut, at = (move == Move.CUT.word)[fed], number["point"][fed]
    programmed = np.where(np.isfinite(t.toolpath.feed), t.toolpath.feed, t.options.approach_feed)
    ends = np.clip(np.ceil(at - ON_POINT).astype(int), 0, len(t.toolpath) - 1)
    # the step to a sample just behind a point was driven before it for the most part: either point's feed may be meant
    either = np.stack([programmed[ends], programmed[np.r_[ends[:1], ends[:-1]]]])
    ratio = np.sort(number["feed_mm_min"][fed] / 60e3 / either, axis=0)
    runs = 1 + int((np.diff(np.flatnonzero(move == Move.CUT.word)) > 1).sum())
    slack = (2 * runs + 0.5) / max(int(cut.sum()), 1)  # the sample at either end of each may count or not
    if not cut.any() or share is None:
        yield f"feed_held_share is {share}, but trajectory.csv holds no cut"
        return
    least, most = ((row[cut] >= HELD).mean() for row in ratio)
    if not least - slack <= share <= most + slack:
        yield f"feed_held_share is {share:.6g}, {least:.6g} to {most:.6g} follows"
    inside = np.zeros(len(at), bool)
    for n, dip in enumerate(dips):
        first, last = known("first_point", dip.first_point), known("last_point", dip.last_point)
        inside |= (at >= first - ON_POINT) & (at <= last + ON_POINT)
        if not (0.0 <= dip.lowest_ratio < HELD and 1 <= dip.axis <= 6 and first <= last):
            yield f"feed_dips.{n} is none: {short(dip)}"
    missed = int((cut & (ratio[1] < HELD - FEED) & ~inside).sum())
    if missed > 2 * runs:
        yield f"{missed} samples below {HELD:g} of the programmed feed are in no feed_dips"


def _objective(t: Told) -> Iterable[str]:
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
        grid, total = known("grid.total", parts.grid.total), known("chosen.total", parts.chosen.total)
        beyond = 100.0 * (1.0 - total / grid) if grid > 0 else 0.0
        yield from near("objective.search.beyond_grid_percent", search.beyond_grid_percent, beyond, DIGITS, 1e-7)
    own = parts.chosen
    cost = Points.read(t).cost(t)
    if own.worst is not None and np.isfinite(cost).any():
        told, most = own.worst * known("index_scale", t.result.index_scale), float(np.nanmax(cost))
        if not most * (1 - PRINTED) <= told <= most * BETWEEN:
            yield f"objective.chosen.worst is {told:.6g} in the index's unit, points.csv has {most:.6g}"
        if not 0.0 < known("chosen.mean", own.mean) <= own.worst:
            yield "objective.chosen.mean is not between nothing and the worst"
    yield from _crowding(t, known("chosen.clearance", own.clearance))
    for gain in parts.gain:
        yield from _gain(gain, own, parts.cam_default if gain.over == "cam default" else parts.jiao2022)
    yield from same("objective.gain", [g.over for g in parts.gain], ["cam default", "jiao2022"])


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
        return
    expected = 100.0 * (1.0 - known("chosen.mean", own.mean) / known(f"{gain.over}: mean", other.mean))
    yield from near(f"{name}: mean_percent", gain.mean_percent, expected, DIGITS, 1e-7)
    half = NONE_PERCENT
    if gain.std_percent is not None:
        half = max(half, NINETY * gain.std_percent)
        for value, sign in zip(gain.ci90 or (), (-1.0, 1.0), strict=True):
            yield from near(f"{name}: ci90", value, gain.mean_percent + sign * NINETY * gain.std_percent, 1e-3, 1e-3)
    yield from same(f"{name}: distinguishable", gain.distinguishable, not abs(gain.mean_percent) <= half)


def _verification(t: Told) -> Iterable[str]:
    told, found = t.result.verification, t.contents
    if found is None:
        yield from same("verification", told, None)
        return
    if told is None:
        yield "verification is null, yet there is a motion"
        return
    yield from same("verification.passed", told.passed, all(c.passed is not False for c in told.checks))
    if told.passed != found.ok:
        yield f"says verification {'passed' if told.passed else 'failed'}, which is not so"
    expected = {c.name: c for c in found.checks}
    names = [c.name for c in told.checks]
    if names != list(expected):
        missing, more = sorted(set(expected) - set(names)), sorted(set(names) - set(expected))
        yield f"lists other checks: {', '.join(missing) or 'none'} missing, {', '.join(more) or 'none'} added"
        return
    for c in told.checks:
        e = expected[c.name]
        yield from same(f"{e.name}: passed", c.passed, e.passed)
        yield from same(f"{e.name}: unit", c.unit, e.unit)
        yield from near(f"{e.name}: limit", c.limit, e.limit, DIGITS, DIGITS)
        room = AGREE * abs(e.limit) if math.isfinite(e.limit) and e.limit else 1e-9
        yield from near(f"{e.name}: value", c.value, e.value, AGREE, room)


def _warnings(t: Told) -> Iterable[str]:
    expected = [*t.cell.warnings, *t.toolpath.warnings]
    yield from same("warnings", t.result.warnings[: len(expected)], expected)
    yield from same("notes", t.result.notes, list(t.cell.notes))


def _compensation(t: Told) -> Iterable[str]:
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


def _front(t: Told) -> Iterable[str]:
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
    yield from near("front: cycle_time_s", own.cycle_time_s, t.result.cycle_time_s, DIGITS, 0.0)
    yield from near("front: joint_travel_deg", own.joint_travel_deg, float(np.abs(np.diff(q)).sum()), 1e-3, 0.1)
    least = Points.read(t).number("clearance_mm")
    if np.isfinite(least).any():
        yield from near("front: clearance_mm", own.clearance_mm, float(np.nanmin(least)), PRINTED, 1e-3)


_PARTS: dict[str, Callable[[Told], Iterable[str]]] = {
    "verdict": _verdict,
    "inputs": _inputs,
    "outputs": _outputs,
    "options": _options,
    "toolpath": _toolpath,
    "worst point": _worst,
    "infeasible points": _infeasible,
    "times": _times,
    "feed": _feed,
    "objective": _objective,
    "front": _front,
    "compensation": _compensation,
    "verification": _verification,
    "programs": programs,
    "warnings": _warnings,
}
