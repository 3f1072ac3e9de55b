"""Program entries of result.json, compared with the manifest, the files, and the programs read back."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.cell.tool_selection import split_into_tool_segments
from machopt.data_types.documents.program_entries import RobotProgramEntry
from machopt.data_types.tool_segments import ToolSegment
from machopt.verification.folder.programs.post_lookup import find_post, list_post_assumptions
from machopt.verification.folder.programs.program_comparison_result import ListedProgram, ProgramComparison
from machopt.verification.folder.result_json.comparison_inputs import (
    CHECK_VALUE_TOLERANCE,
    RELATIVE_TOLERANCE,
    ResultComparison,
    check_close,
    check_equal,
    format_json_value,
    is_output_file,
)

DIFFERENCE_TOLERANCE = 1e-4  # mm, deg, mm/min: what rounding moves a measured difference by


def check_program_entries(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the program entries.

    Args:
        t: Result.json and everything that it is compared with.
    """
    stated = t.result.programs
    there = {f.name for f in t.manifest.files if f.role == "program"} if t.manifest else None
    named = [name for p in stated for name in p.files]
    for p in stated:
        if p.files:
            lines = sum((t.folder / name).read_bytes().count(b"\n") for name in p.files if is_output_file(t, name))
            yield from check_equal(f"{p.post}: lines", p.lines, lines)
            yield from check_equal(f"{p.post}: withheld", p.withheld, None)
            yield from check_equal(f"{p.post}: differences", p.differences, [])
            yield from _check_program_statements(t, p)
            yield from _check_feed_model(p)
        elif not p.withheld:
            yield f"{p.post}: has no files and no reason for that"
    for name in named:
        if not is_output_file(t, name):
            yield f"{name} is named and not there"
    if t.manifest is not None and there is not None:
        listed_programs = [[p.post, list(p.files)] for p in t.manifest.programs]
        yield from check_equal("programs", [[p.post, list(p.files)] for p in stated if p.files], listed_programs)
        for name in sorted(there - set(named)):
            yield f"{name} is a program and not named"
        remarks = [f"{p.files[0]}: {x}" for p in stated if p.files for x in (*p.not_in_program, *p.assumed)]
        yield from check_equal("warnings (of the manifest)", list(t.manifest.warnings), remarks)
        tolerance = t.manifest.program_tolerance_mm
        for p in stated:
            yield from check_close(f"{p.post}: tolerance_mm", p.tolerance_mm, tolerance, RELATIVE_TOLERANCE, 0.0)
    if t.result.exit_code != 0 and named:
        yield f"exit code {t.result.exit_code}, yet there is a robot program: {named[0]}"


def _check_feed_model(p: RobotProgramEntry) -> Iterable[str]:
    """What a model says of a feed follows from the planner's moves; that it can be so is checked."""
    stated = p.feed_model
    if stated is None:
        return
    low, mean, feed_limit = stated.lowest_percent, stated.mean_percent, stated.held_length_percent
    if not (
        0.0 <= low <= mean * (1 + RELATIVE_TOLERANCE)
        and mean <= 100.0 * (1 + RELATIVE_TOLERANCE)
        and 0.0 <= feed_limit <= 100.0 * (1 + RELATIVE_TOLERANCE)
    ):
        yield f"{p.post}: feed_model cannot be: {format_json_value(stated)}"
    if not (stated.cutting_time_s >= 0.0 and stated.rounding_max_mm >= 0.0 and stated.exact_stops >= 0):
        yield f"{p.post}: feed_model is below zero: {format_json_value(stated)}"
    if stated.rounding_max_mm > p.tolerance_mm * (1 + RELATIVE_TOLERANCE):
        yield f"{p.post}: rounds by {stated.rounding_max_mm:.4g} mm, more than its tolerance"


def _get_segment(t: ResultComparison, p: RobotProgramEntry) -> ToolSegment:
    """What of the job a program drives, by the manifest."""
    segments = split_into_tool_segments(t.cell, t.toolpath)
    listed = t.manifest.programs if t.manifest is not None else ()
    number = next((one.stint for one in listed if one.files == p.files), 0)
    return segments[max(number, 1) - 1]


def _check_program_statements(t: ResultComparison, p: RobotProgramEntry) -> Iterable[str]:
    """Check the entry of one program: its checks, assumptions and events left to a comment."""
    post = find_post(p.post, t.folder, t.cell, t.manifest)
    if post is not None:
        segment = _get_segment(t, p)
        yield from check_equal(f"{p.post}: tool", p.tool, segment.tool if segment.number else None)
        assumed, left = list_post_assumptions(segment.cell, segment.toolpath, post)
        yield from check_equal(f"{p.post}: assumed", p.assumed, list(assumed))
        yield from check_equal(f"{p.post}: not_in_program", p.not_in_program, list(left))
    found = ProgramComparison.build(ListedProgram(p.post, post, tuple(p.files)), t.contents).to_read_back()
    stated = p.checked
    if (found is None) != (stated is None):
        yield f"{p.post}: checked is {format_json_value(stated)}, {format_json_value(found)} follows"
    if found is None or stated is None:
        return
    for key, value in found:
        if isinstance(value, float) and not key.startswith("moves"):
            yield from check_close(
                f"{p.post}: checked.{key}", getattr(stated, key), value, CHECK_VALUE_TOLERANCE, DIFFERENCE_TOLERANCE
            )
        else:
            yield from check_equal(f"{p.post}: checked.{key}", getattr(stated, key), value)
