"""Checks of result.json against the tables, inputs, options, manifest and verification it was made from.

Values that follow from the planner alone are listed in ``coverage.NOT_RECOMPUTED``; sums and ratios of them are
checked. The sentences under ``reason`` of points.csv are not compared; that a point has a reason, and its status,
are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from machopt.cell.tool_selection import list_used_operations, split_into_tool_segments
from machopt.data_types.cell import Cell
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.manifest import FolderManifest, ManifestFile, add_scope_to_verdict
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.options.plan_option_reader import format_user_options
from machopt.output.file_hashes import compute_sha256
from machopt.output.file_roles import BATCH_ROLES, TABLES
from machopt.output.json_files import convert_to_json_types, read_json
from machopt.output.manifest_file import MANIFEST, list_folder_files
from machopt.verification import Verification, VerificationCheck
from machopt.verification.check_results import CheckName, build_file_check
from machopt.verification.folder.options_in_force import get_error_file
from machopt.verification.folder.result_json.comparison_inputs import (
    CHECK_VALUE_TOLERANCE,
    RELATIVE_TOLERANCE,
    CheckedPoints,
    ResultComparison,
    check_close,
    check_equal,
    check_same_items,
    format_json_value,
    require_number,
)
from machopt.verification.folder.result_json.objective_and_gains import (
    PRINTED_TOLERANCE,
    check_compensation,
    check_objective,
    check_trade_off_front,
    limit_worst_index,
)
from machopt.verification.folder.result_json.position_error import check_position_error
from machopt.verification.folder.result_json.posture_feed_section import check_joint_section
from machopt.verification.folder.result_json.process_section import check_process_section
from machopt.verification.folder.result_json.program_entries import check_program_entries
from machopt.verification.folder.result_json.reentry_section import check_reentry_section
from machopt.verification.folder.result_json.schema_errors import list_schema_errors
from machopt.verification.folder.result_json.tilt_section import check_tilt_section
from machopt.verification.folder.result_json.times_and_feed import check_feed, check_times
from machopt.verification.folder.result_json.worst_point import check_worst_point
from machopt.verification.folder.verification_scope import (
    NOT_RECOMPUTED,
    format_completeness,
    list_checked,
    list_checks_not_run,
    list_production_blockers,
    list_unchecked,
)
from machopt.verification.folder.version_mismatch import find_older_version

CHOSEN_MEAN_TOLERANCE = 0.05  # of the mean index: what rescoring a choice as it is driven may move it by
RESULT_FILE = "result.json"
_WRITTEN_LAST = {RESULT_FILE, MANIFEST, *BATCH_ROLES}  # their hashes are not in result.json
VERDICT_BY_EXIT_CODE = {3: "infeasible", 4: "verification failed"}


def check_result_document(
    folder: Path,
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    inputs: tuple[ManifestFile, ...],
    manifest: FolderManifest | None,
    contents: Verification | None,
) -> list[VerificationCheck]:
    """Return one check for each part of result.json; a part that is missing or malformed fails its check.

    Args:
        folder: The output folder.
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        options: The planning options in force.
        inputs: The given input files with their hashes.
        manifest: The manifest of the folder; None where it cannot be read.
        contents: Verification of the tables; None where there is none.
    """
    file = folder / RESULT_FILE
    try:
        value = read_json(file)
    except InputError as problem:
        return [_build_check("", [str(problem)])]
    if find_older_version(folder, value, manifest) is not None and manifest is not None:
        return [_build_check("older version", list(_compare_older_document(value, folder, manifest, contents)))]
    try:
        result = OptimizeDocument.model_validate(value)
    except ValidationError as problem:  # an edited file may have any form
        return [_build_check(part, errors) for part, errors in list_schema_errors(problem).items()]
    stated = ResultComparison(
        result=result,
        folder=folder,
        cell=cell,
        toolpath=toolpath,
        options=options,
        inputs=manifest.inputs if manifest else inputs,
        manifest=manifest,
        contents=contents,
    )
    return [_run_part_check(name, part, stated) for name, part in _PARTS.items()]


def _compare_older_document(
    value: Mapping[str, Any], folder: Path, manifest: FolderManifest, contents: Verification | None
) -> Iterable[str]:
    """Compare what every version states: its figures have other definitions, and are not recomputed."""
    expected = 3 if contents is None else (0 if contents.ok else 4)
    yield from check_equal("exit_code", value.get("exit_code"), expected)
    for key, stated in (("exit_code", manifest.exit_code), ("verdict", manifest.verdict)):
        yield from check_equal(f"{key} (of the manifest)", stated, value.get(key))
    inputs, outputs = (
        items if isinstance(items := value.get(key), Mapping) else {key: items} for key in ("inputs", "outputs")
    )
    yield from check_same_items("inputs", inputs, {f.name: f.sha256 for f in manifest.inputs})
    there = {name: compute_sha256(folder / name) for name in list_folder_files(folder) - _WRITTEN_LAST}
    yield from check_same_items("outputs", outputs, there)


def _run_part_check(
    name: str, part: Callable[[ResultComparison], Iterable[str]], document: ResultComparison
) -> VerificationCheck:
    """The part's findings; numbers of a foreign file may fit the schema and yet lead nowhere."""
    try:
        return _build_check(name, list(part(document)))
    except InputError as problem:
        return replace(_build_check(name, [str(problem)]), because=get_error_file(problem))
    except (KeyError, TypeError, ValueError, IndexError, ArithmeticError) as problem:
        return _build_check(name, [f"is not of the form that machopt writes: {_format_error(problem)}"])


def _format_error(problem: Exception) -> str:
    """Return the message in words that do not refer to Python."""
    if isinstance(problem, KeyError):
        return f"the key {format_json_value(problem.args[0])} is missing"
    if isinstance(problem, ValueError) and problem.args:
        return str(problem)
    return "a value is of another kind there"


def _build_check(part: str, wrong: list[str]) -> VerificationCheck:
    more = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
    text = "; ".join(wrong[:3]) + more
    return build_file_check(
        RESULT_FILE, part, not wrong, float(len(wrong)), 0.0, "differences", text, of=" " if part else ""
    )


def _check_verdict(t: ResultComparison) -> Iterable[str]:
    code, found = t.result.exit_code, t.contents
    expected = 3 if found is None else (0 if found.ok else 4)
    yield from check_equal("exit_code", code, expected)
    missing = (*list_unchecked(t.cell, t.options, t.toolpath), *(list_checks_not_run(found.checks) if found else ()))
    yield from check_equal("unchecked", t.result.unchecked, list(missing))
    blockers = () if expected == 3 else list_production_blockers(t.cell, missing, t.result.programs)
    yield from check_equal("production_blockers", t.result.production_blockers, list(blockers))
    word = VERDICT_BY_EXIT_CODE.get(expected)
    if word is None:
        lacking = ~CheckedPoints.from_file(t).is_ok
        if lacking.any() and not t.options.allow_gaps:
            yield f"{int(lacking.sum())} points are left out, yet allow_gaps is false: exit code 3 follows"
        word = format_completeness(
            int((lacking & t.toolpath.cutting).sum()), int((lacking & ~t.toolpath.cutting).sum())
        )
    yield from check_equal("verdict", t.result.verdict, add_scope_to_verdict(word, missing))
    if t.manifest is not None:
        for key, value in (("verdict", t.manifest.verdict), ("exit_code", t.manifest.exit_code)):
            yield from check_equal(f"{key} (of the manifest)", value, getattr(t.result, key))
        yield from check_equal("unchecked (of the manifest)", list(t.manifest.unchecked), list(missing))
        yield from check_equal(
            "not_recomputed (of the manifest)", list(t.manifest.not_recomputed), list(NOT_RECOMPUTED)
        )
        stated = [f"{c.what}: {c.how}" for c in t.manifest.checked]
        yield from check_equal(
            "checked (of the manifest)", stated, [f"{c.what}: {c.how}" for c in list_checked(t.options)]
        )
        yield from check_equal("version", t.result.version, t.manifest.versions.get("machopt"))


def _check_inputs(t: ResultComparison) -> Iterable[str]:
    yield from check_same_items("inputs", t.result.inputs, {f.name: f.sha256 for f in t.inputs})
    yield from check_equal("cell", t.result.cell, t.cell.name)


def _check_outputs(t: ResultComparison) -> Iterable[str]:
    there = {name: compute_sha256(t.folder / name) for name in list_folder_files(t.folder) - _WRITTEN_LAST}
    yield from check_same_items("outputs", t.result.outputs, there)
    for name in ("points.csv", "report.html", *(("trajectory.csv",) if t.contents is not None else ())):
        if name not in there:
            yield f"{name} is missing; optimize writes it always"
    for name in sorted(there.keys() & set(TABLES)):
        line = _find_first_comment(t.folder / name)
        if line:
            yield f"{name} has a comment in line {line}; machopt writes none, units are in the names of columns"


def _find_first_comment(table: Path) -> int:
    """Number of the first line of a CSV table that readers skip: a comment or an empty line; 0 where there is none."""
    if table.suffix != ".csv":
        return 0
    with table.open("rb") as lines:
        return next((n for n, line in enumerate(lines, 1) if line.startswith(b"#") or not line.strip()), 0)


def _check_options(t: ResultComparison) -> Iterable[str]:
    recorded = t.manifest.options if t.manifest else convert_to_json_types(format_user_options(t.options))
    yield from check_same_items("options", t.result.options, recorded)
    if t.manifest is not None:
        yield from check_same_items("reading", t.result.reading, t.manifest.reading)
    index = t.options.index
    if index == "auto":
        index = "deflection" if t.segments[1].force.given else "stiffness"
    yield from check_equal("index", t.result.index, index)
    own = {
        "global": ("smooth", "grid", "smooth and grid", "jiao2022", "cam default"),
        "joint": ("joint", "smooth", "grid", "smooth and grid", "jiao2022", "cam default"),
        "jiao2022": ("jiao2022",),
        "default": ("cam default",),
    }[t.options.method]
    if not {*t.result.chosen_from.split(" / ")} <= {*own}:
        yield (
            f"chosen_from is {format_json_value(t.result.chosen_from)}; method {t.options.method} gives "
            f"{', '.join(own)}"
        )
    parts = t.result.objective
    source = {"jiao2022": parts.jiao2022, "cam default": parts.cam_default}.get(t.result.chosen_from)
    if source is not None and (source.mean is None or parts.chosen.mean is None):
        yield f"chosen_from is {format_json_value(t.result.chosen_from)}, which has no objective"
    elif source is not None and not t.options.compensate:
        yield from check_close("chosen_from: mean", parts.chosen.mean, source.mean, CHOSEN_MEAN_TOLERANCE, 0.0)


def _check_toolpath(t: ResultComparison) -> Iterable[str]:
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
    yield from check_same_items("toolpath", found.to_json_types(), convert_to_json_types(expected))


def _check_tools(t: ResultComparison) -> Iterable[str]:
    """Which tool each stretch of the job has, by the CAM file."""
    segments, stated = split_into_tool_segments(t.cell, t.toolpath), t.result.tools
    if len(segments) == 1:
        yield from check_equal("tools", stated, None)
        return
    keys = ("tool", "first_point", "last_point", "operations")
    expected = [
        dict(zip(keys, (s.tool, s.first, s.stop - 1, list(list_used_operations(s.toolpath))), strict=True))
        for s in segments
    ]
    found = [{**{k: getattr(p, k) for k in keys}, "operations": list(p.operations)} for p in stated or ()]
    yield from check_equal("tools", found, expected)
    points, scale = CheckedPoints.from_file(t), require_number("index_scale", t.result.index_scale)
    cost = points.compute_cost(t)
    for s, p, along in zip(segments, stated or (), t.worst_along_cuts, strict=False):
        own = cost[s.first : s.stop]
        if p.worst_index is not None and np.isfinite(own).any() and scale > 0:
            most = float(np.nanmax(own))
            rounding = points.cost_rounding(t)[s.first + int(np.nanargmax(own))]
            if not most * (1 - PRINTED_TOLERANCE) - rounding <= p.worst_index <= limit_worst_index(t, most, along):
                yield f"tools: the worst index with {s.tool} is {p.worst_index:.6g}, points.csv has {most:.6g}"


def _check_infeasible(t: ResultComparison) -> Iterable[str]:
    points = CheckedPoints.from_file(t)
    status, reason = points.table.read_words("status"), points.table.read_words("reason")
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


def _check_verification(t: ResultComparison) -> Iterable[str]:
    document, found = t.result.verification, t.contents
    if found is None:
        yield from check_equal("verification", document, None)
        return
    if document is None:
        yield "verification is null, yet there is a motion"
        return
    yield from check_equal("verification.passed", document.passed, all(c.passed is not False for c in document.checks))
    if document.passed != found.ok:
        yield f"states verification {'passed' if document.passed else 'failed'}, which is wrong"
    yield from check_equal(
        "verification.information", [i.name for i in document.information], [i.name for i in found.information]
    )
    for stated, measured in zip(document.information, found.information, strict=False):
        room = CHECK_VALUE_TOLERANCE * abs(measured.value) + 1e-9
        yield from check_close(f"{measured.name}: value", stated.value, measured.value, CHECK_VALUE_TOLERANCE, room)
    expected = {c.name: c for c in found.checks}
    names = [c.name for c in document.checks]
    if names != list(expected):
        missing, more = sorted(set(expected) - set(names)), sorted(set(names) - set(expected))
        yield f"lists other checks: {', '.join(missing) or 'none'} missing, {', '.join(more) or 'none'} added"
        return
    for c in document.checks:
        e = expected[c.name]
        yield from check_equal(f"{e.name}: passed", c.passed, e.passed)
        yield from check_equal(f"{e.name}: unit", c.unit, e.unit)
        yield from check_equal(f"{e.name}: file", c.file, e.file)
        yield from check_close(f"{e.name}: limit", c.limit, e.limit, RELATIVE_TOLERANCE, RELATIVE_TOLERANCE)
        room = CHECK_VALUE_TOLERANCE * abs(e.limit) if math.isfinite(e.limit) and e.limit else 1e-9
        yield from check_close(f"{e.name}: value", c.value, e.value, CHECK_VALUE_TOLERANCE, room)


def _check_warnings(t: ResultComparison) -> Iterable[str]:
    expected = [*t.cell.warnings, *t.toolpath.warnings]
    yield from check_equal("warnings", t.result.warnings[: len(expected)], expected)
    yield from check_equal("notes", t.result.notes, list(t.cell.notes))


_PARTS: dict[str, Callable[[ResultComparison], Iterable[str]]] = {
    CheckName.VERDICT: _check_verdict,
    "inputs": _check_inputs,
    CheckName.OUTPUTS: _check_outputs,
    "options": _check_options,
    "toolpath": _check_toolpath,
    "tools": _check_tools,
    "worst point": check_worst_point,
    "infeasible points": _check_infeasible,
    "times": check_times,
    "feed": check_feed,
    "objective": check_objective,
    "front": check_trade_off_front,
    "compensation": check_compensation,
    "tilt": check_tilt_section,
    "joint": check_joint_section,
    "reentry": check_reentry_section,
    "position error": check_position_error,
    "process": check_process_section,
    CheckName.VERIFICATION: _check_verification,
    "programs": check_program_entries,
    "warnings": _check_warnings,
}
