"""result.json held against what it was drawn from: tables, inputs, options, the manifest and the verification itself.

What follows from the planner alone is listed in ``scope.NOT_RECOMPUTED``; sums and ratios made of it are checked. So
are the sentences under ``reason`` of points.csv (that a point has one, and its status, are checked).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from machopt.arrays import Array, Bools
from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest, ManifestFile, with_scope
from machopt.domain.options import PlanOptions
from machopt.domain.results.optimize import OptimizeResult
from machopt.domain.slowmoves import RAMPS, TURN_BACK, Slow, is_turn_back, said_at
from machopt.domain.toolpath import Move, Toolpath
from machopt.errors import InputError
from machopt.formats.options import options_as_user
from machopt.formats.toolchoice import stints_of, used_operations
from machopt.output.hashes import sha256_of
from machopt.output.jsonfile import plain, read_json
from machopt.output.manifest import MANIFEST, listed
from machopt.output.roles import BATCH_ROLES, TABLES
from machopt.recheck.inforce import file_of
from machopt.recheck.resultform import wrong_parts
from machopt.recheck.resultnumbers import PRINTED, compensation, front, lie_within, not_beyond, objective
from machopt.recheck.resultposition import position_error
from machopt.recheck.resultprograms import programs
from machopt.recheck.resultworst import worst_point
from machopt.recheck.scope import NOT_RECOMPUTED, checked, done, not_run, production_blockers, unchecked
from machopt.recheck.told import AGREE, DIGITS, Points, Told, known, near, same, same_items, short
from machopt.verify import Check, Verification
from machopt.verify.check import Promise, of_file

CHOSEN = 0.05  # of the mean index: what rescoring a choice as it is driven may move it by
HELD = 0.95  # of the programmed feed: what counts as held
ON_POINT = 1e-6  # of a point index: printed with six decimals or more
FEED = 1e-4  # of the programmed feed: feeds are printed to 0.001 mm/min
SHIFTED = math.radians(10.0)  # by this much a path shifted against the deflection may turn a corner less sharply
RESULT = "result.json"
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
    file = folder / RESULT
    try:
        value = read_json(file)
    except InputError as problem:
        return [_check("", [str(problem)])]
    try:
        result = OptimizeResult.model_validate(value)
    except ValidationError as problem:  # what somebody else wrote into the file may be of any shape
        return [_check(part, said) for part, said in wrong_parts(problem).items()]
    told = Told(
        result=result,
        folder=folder,
        cell=cell,
        toolpath=toolpath,
        options=options,
        inputs=manifest.inputs if manifest else inputs,
        manifest=manifest,
        contents=contents,
    )
    return [_tried(name, part, told) for name, part in _PARTS.items()]


def _tried(name: str, part: Callable[[Told], Iterable[str]], told: Told) -> Check:
    """The part's findings; numbers of a foreign file may fit the schema and yet lead nowhere."""
    try:
        return _check(name, list(part(told)))
    except InputError as problem:
        return replace(_check(name, [str(problem)]), because=file_of(problem))
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as problem:
        return _check(name, [f"is not of the form that machopt writes: {_words(problem)}"])


def _words(problem: Exception) -> str:
    """What somebody who knows no Python makes something of."""
    if isinstance(problem, KeyError):
        return f"the key {short(problem.args[0])} is missing"
    if isinstance(problem, ValueError) and problem.args:
        return str(problem)
    return "a value is of another kind there"


def _check(part: str, wrong: list[str]) -> Check:
    more = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
    said = "; ".join(wrong[:3]) + more
    return of_file(RESULT, part, not wrong, float(len(wrong)), 0.0, "differences", said, of=" " if part else "")


def _verdict(t: Told) -> Iterable[str]:
    code, found = t.result.exit_code, t.contents
    expected = 3 if found is None else (0 if found.ok else 4)
    yield from same("exit_code", code, expected)
    missing = (*unchecked(t.cell, t.options, t.toolpath), *(not_run(found.checks) if found else ()))
    yield from same("unchecked", t.result.unchecked, list(missing))
    blockers = () if expected == 3 else production_blockers(t.cell, missing, t.result.programs)
    yield from same("production_blockers", t.result.production_blockers, list(blockers))
    word = VERDICTS.get(expected)
    if word is None:
        lacking = ~Points.read(t).ok
        if lacking.any() and not t.options.allow_gaps:
            yield f"{int(lacking.sum())} points are left out, yet allow_gaps is false: exit code 3 follows"
        word = done(int((lacking & t.toolpath.cutting).sum()), int((lacking & ~t.toolpath.cutting).sum()))
    yield from same("verdict", t.result.verdict, with_scope(word, missing))
    if t.manifest is not None:
        for key, value in (("verdict", t.manifest.verdict), ("exit_code", t.manifest.exit_code)):
            yield from same(f"{key} (of the manifest)", value, getattr(t.result, key))
        yield from same("unchecked (of the manifest)", list(t.manifest.unchecked), list(missing))
        yield from same("not_recomputed (of the manifest)", list(t.manifest.not_recomputed), list(NOT_RECOMPUTED))
        told = [f"{c.what}: {c.how}" for c in t.manifest.checked]
        yield from same("checked (of the manifest)", told, [f"{c.what}: {c.how}" for c in checked(t.options)])
        yield from same("version", t.result.version, t.manifest.versions.get("machopt"))


def _inputs(t: Told) -> Iterable[str]:
    yield from same_items("inputs", t.result.inputs, {f.name: f.sha256 for f in t.inputs})
    yield from same("cell", t.result.cell, t.cell.name)


def _outputs(t: Told) -> Iterable[str]:
    later = {RESULT, MANIFEST, *BATCH_ROLES}
    there = {name: sha256_of(t.folder / name) for name in listed(t.folder) - later}
    yield from same_items("outputs", t.result.outputs, there)
    for name in ("points.csv", "report.html", *(("trajectory.csv",) if t.contents is not None else ())):
        if name not in there:
            yield f"{name} is missing; optimize writes it always"
    for name in sorted(there.keys() & set(TABLES)):
        line = _first_comment(t.folder / name)
        if line:
            yield f"{name} has a comment in line {line}; machopt writes none, units are in the names of columns"


def _first_comment(table: Path) -> int:
    """Number of the first line of a CSV table that readers skip: a comment or an empty line; 0 where there is none."""
    if table.suffix != ".csv":
        return 0
    with table.open("rb") as lines:
        return next((n for n, line in enumerate(lines, 1) if line.startswith(b"#") or not line.strip()), 0)


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
    if not {*t.result.chosen_from.split(" / ")} <= {*own}:
        yield f"chosen_from is {short(t.result.chosen_from)}; method {t.options.method} gives {', '.join(own)}"
    parts = t.result.objective
    source = {"jiao2022": parts.jiao2022, "cam default": parts.cam_default}.get(t.result.chosen_from)
    if source is not None and (source.mean is None or parts.chosen.mean is None):
        yield f"chosen_from is {short(t.result.chosen_from)}, which has no objective"
    elif source is not None and not t.options.compensate:
        yield from near("chosen_from: mean", parts.chosen.mean, source.mean, CHOSEN, 0.0)


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


def _tools(t: Told) -> Iterable[str]:
    """Which tool each stretch of the job has, by the CAM file."""
    stints, told = stints_of(t.cell, t.toolpath), t.result.tools
    if len(stints) == 1:
        yield from same("tools", told, None)
        return
    keys = ("tool", "first_point", "last_point", "operations")
    expected = [
        dict(zip(keys, (s.tool, s.first, s.stop - 1, list(used_operations(s.toolpath))), strict=True)) for s in stints
    ]
    found = [{**{k: getattr(p, k) for k in keys}, "operations": list(p.operations)} for p in told or ()]
    yield from same("tools", found, expected)
    points, scale = Points.read(t), known("index_scale", t.result.index_scale)
    cost = points.cost(t)
    for s, p, along in zip(stints, told or (), t.along, strict=False):
        own = cost[s.first : s.stop]
        if p.worst_index is not None and np.isfinite(own).any() and scale > 0:
            most = float(np.nanmax(own))
            rounding = points.cost_rounding(t)[s.first + int(np.nanargmax(own))]
            if not most * (1 - PRINTED) - rounding <= p.worst_index <= not_beyond(t, most, along):
                yield f"tools: the worst index with {s.tool} is {p.worst_index:.6g}, points.csv has {most:.6g}"


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
        yield from same("dwell_s", t.result.dwell_s, None)
        return
    waits = t.toolpath.dwells
    yield from near("dwell_s", t.result.dwell_s, float(waits[0] + waits[1:][Points.read(t).ok].sum()), DIGITS, 1e-9)
    yield from near("cycle_time_s", t.result.cycle_time_s, float(t.motion.numbers("time_s")[-1]), 0.0, 1e-5)
    for name, seconds in t.result.timings_s.items():
        if not (isinstance(seconds, float | int) and math.isfinite(seconds) and seconds >= 0):
            yield f"timings_s.{name} is {short(seconds)}"


def _feed(t: Told) -> Iterable[str]:
    """Share of the cutting time near the programmed feed, and where it falls short of it, from the samples."""
    share, dips, stops = t.result.feed_held_share, t.result.feed_dips, t.result.feed_stops
    if t.contents is None:
        yield from same("feed_held_share", share, None)
        yield from same("feed_dips", dips, [])
        yield from same("feed_stops", stops, [])
        return
    number = {k: t.motion.numbers(k, empty=True) for k in ("point", "feed_mm_min")}
    move = np.array(t.motion.words("move"))
    fed = (move != Move.RAPID.word) & np.isfinite(number["point"])  # dips begin in approaches too
    fed &= ~_dwelling(t, number["point"])
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
    still = bool(_unmoved(t.toolpath)[ends[cut]].all())  # no cut has a length: nothing is slow
    least, most = (1.0 if still else (row[cut] >= HELD).mean() for row in ratio)
    slack = 1e-9 if still else slack
    if not least - slack <= share <= most + slack:
        yield f"feed_held_share is {share:.6g}, {least:.6g} to {most:.6g} follows"
    axes = len(t.cell.limits.velocity)
    named = [(f"feed_dips.{n}", dip) for n, dip in enumerate(dips)]
    named += [(f"feed_stops.{n}", stop) for n, stop in enumerate(stops)]
    ranges = [(known("first_point", dip.first_point), known("last_point", dip.last_point)) for _, dip in named]
    inside = lie_within(at, np.array([(a - ON_POINT, b + ON_POINT) for a, b in ranges]).reshape(-1, 2))
    for (name, dip), (first, last) in zip(named, ranges, strict=True):
        if not (0.0 <= dip.lowest_ratio < HELD and 1 <= dip.axis <= axes and first <= last):
            yield f"{name} is none: {short(dip)}"
        elif (dip.where in RAMPS) != name.startswith("feed_stops"):
            yield f"{name} belongs into the other list: {short(dip)}"
        elif dip.where == "reversal" and not any(_turns_back(t.toolpath, at) for at in (first, last)):
            yield f"{name}: the path does not turn back there: {short(dip)}"
    yield from _slow_rows(t)
    missed = 0 if still else int((cut & (ratio[1] < HELD - FEED) & ~inside).sum())
    if missed > 2 * runs:
        yield f"{missed} samples below {HELD:g} of the programmed feed are in no feed_dips or feed_stops"


def _slow_rows(t: Told) -> Iterable[str]:
    """The rows of points.csv that are ok and have a reason are those on the way to which a dip of the path lies."""
    points = Points.read(t)
    stretches = [
        Slow(
            first=known("first_point", dip.first_point),
            last=known("last_point", dip.last_point),
            ratio=dip.lowest_ratio,
            where=dip.where,
            axis=dip.axis,
            limit=dip.limit,
        )
        for dip in t.result.feed_dips
    ]
    wanted = said_at(stretches, len(t.toolpath))
    rows = zip(points.ok.tolist(), points.table.words("reason"), strict=True)
    wrong = [k for k, (ok, text) in enumerate(rows) if ok and text != wanted.get(k, "")]
    if wrong:
        yield f"the reason at {len(wrong)} points of points.csv does not follow from feed_dips, the first is {wrong[0]}"


def _turns_back(toolpath: Toolpath, at: float) -> bool:
    """True where the path turns back at the point that a ramp begins or ends at."""
    point = round(at)
    on_point = abs(at - point) <= ON_POINT and 0 <= point < len(toolpath)
    return on_point and is_turn_back(toolpath.position, toolpath.axis, point, TURN_BACK - SHIFTED)


def _dwelling(t: Told, point: Array) -> Bools:
    """(S,) rows that stand where the one before stood, at a point where the file dwells: no feed is asked for there."""
    at = [min(e.index, len(t.toolpath)) - 1 for e in t.toolpath.events if e.kind == "dwell"]
    if not at:
        return np.zeros(len(point), bool)
    axes = [name for name in t.motion.names if name[:1] in "qe" and name[1:2].isdigit()]
    moved = [np.append(True, np.diff(t.motion.numbers(name)) != 0.0) for name in axes]
    there = np.isin(np.round(np.nan_to_num(point, nan=-2.0)), at)
    return np.asarray(there & ~np.any(moved, axis=0))


def _unmoved(toolpath: Toolpath) -> Bools:
    """(n,) the move into a point neither goes nor turns; none leads into the first."""
    place = np.hstack([toolpath.position, toolpath.axis])
    return np.append(True, ~np.diff(place, axis=0).any(axis=1))


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
    yield from same("verification.information", [i.name for i in told.information], [i.name for i in found.information])
    for stated, measured in zip(told.information, found.information, strict=False):
        room = AGREE * abs(measured.value) + 1e-9
        yield from near(f"{measured.name}: value", stated.value, measured.value, AGREE, room)
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
        yield from same(f"{e.name}: file", c.file, e.file)
        yield from near(f"{e.name}: limit", c.limit, e.limit, DIGITS, DIGITS)
        room = AGREE * abs(e.limit) if math.isfinite(e.limit) and e.limit else 1e-9
        yield from near(f"{e.name}: value", c.value, e.value, AGREE, room)


def _warnings(t: Told) -> Iterable[str]:
    expected = [*t.cell.warnings, *t.toolpath.warnings]
    yield from same("warnings", t.result.warnings[: len(expected)], expected)
    yield from same("notes", t.result.notes, list(t.cell.notes))


_PARTS: dict[str, Callable[[Told], Iterable[str]]] = {
    Promise.VERDICT: _verdict,
    "inputs": _inputs,
    Promise.OUTPUTS: _outputs,
    "options": _options,
    "toolpath": _toolpath,
    "tools": _tools,
    "worst point": worst_point,
    "infeasible points": _infeasible,
    "times": _times,
    "feed": _feed,
    "objective": objective,
    "front": front,
    "compensation": compensation,
    "position error": position_error,
    Promise.VERIFICATION: _verification,
    "programs": programs,
    "warnings": _warnings,
}
