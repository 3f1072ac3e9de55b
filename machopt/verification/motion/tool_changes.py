"""Verification of a job with tool changes: each change at its place, and each tool's segment against its points.

The CAM file and the cell's tool table say which operation needs which tool. Each tool has its own kinematics,
stiffness and bodies. So the rows between two changes are verified as a separate motion. Time, joint limits and both
ends are checked over the whole motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.verification.check_results import (
    CheckName,
    Verification,
    VerificationInformation,
    VerificationRow,
    build_count_check,
)
from machopt.verification.motion.checks.time_and_joint_limits import HOME_TOLERANCE_DEG, check_limits
from machopt.verification.motion.motion_verification import (
    ExportedTables,
    read_tables,
    verify_motion,
    verify_single_tool,
)
from machopt.verification.tables.exported_tables import (
    ExportedMotion,
    ExportedPoints,
    ExportedShift,
    ExportedTilt,
)


def verify_tool_segments(
    segments: Sequence[ToolSegment],
    out: Path,
    *,
    options: PlanOptions | None = None,
    motion: ExportedMotion | None = None,
    touching: Sequence[tuple[str, str]] | None = None,
) -> Verification:
    """Check the tables of a folder, whether the job changes tools or not; otherwise as :func:`verify_motion`.

    Args:
        segments: the job, cut where the CAM file changes the tool.
        out: the output folder.
        options: those of the run, for the whole job.
        motion: trajectory.csv where it has been read already.
        touching: names of the bodies that the folder's manifest says touch by construction; None: it lists none.
    """
    options = options or PlanOptions()
    whole = segments[0]
    if len(segments) == 1:
        return verify_motion(whole.cell, whole.toolpath, out, options=options, motion=motion, touching=touching)
    cell = replace(whole.cell, tools={s.tool: s.cell.tool for s in segments}, tool_name=None)
    tables = read_tables(cell, Path(out), motion)
    if isinstance(tables, Verification):
        return tables
    motion = tables.motion
    checks: list[VerificationRow] = list(check_limits(motion, cell, options, (segments[0].begin, segments[-1].end)))
    wrong = _check_tool_changes(motion, segments) + _check_point_rows(tables.points, segments)
    checks.append(build_count_check(CheckName.CHANGES, wrong, "places"))
    if not wrong:
        parts = split_tables(tables, segments)
        found = [
            verify_single_tool(s.cell, s.toolpath, part, s.restrict_options(options), touching)
            for s, part in zip(segments, parts, strict=True)
        ]
        checks += _merge_checks(segments, found)
    return Verification.from_rows(checks, len(motion.time), float(motion.time[-1] - motion.time[0]))


def _find_segment_starts(motion: ExportedMotion) -> list[int]:
    """Rows from which another tool is on, the first row too."""
    return [0, *(n for n in range(1, len(motion.tool)) if motion.tool[n] != motion.tool[n - 1])]


def _check_tool_changes(motion: ExportedMotion, segments: Sequence[ToolSegment]) -> list[str]:
    """Check that tools follow the order of the CAM file, each changed at rest at the tool-change pose."""
    starts = _find_segment_starts(motion)
    found, wanted = [motion.tool[n] for n in starts], [s.tool for s in segments]
    if found != wanted:
        return [f"the rows have the tools {', '.join(found)}; the toolpath wants {', '.join(wanted)}"]
    x = motion.joints
    wrong = []
    for n, segment in zip(starts[1:], segments[1:], strict=True):
        off = float(np.degrees(np.abs(x[n - 1 : n + 1] - segment.begin).max()))  # a metre of a slide counts as a radian
        if not off <= HOME_TOLERANCE_DEG:
            wrong.append(
                f"{segment.tool} comes on {off:.3g} deg from where tools are changed ({motion.describe_row(n)})"
            )
    ends = [*starts[1:], len(motion.time)]
    wrong += [f"{s.tool} has one row only" for s, a, b in zip(segments, starts, ends, strict=True) if b - a < 2]
    return wrong


def _check_point_rows(points: ExportedPoints, segments: Sequence[ToolSegment]) -> list[str]:
    rows, wanted = len(points.point), segments[-1].stop
    if rows != wanted or (points.point != np.arange(wanted)).any():
        return [f"points.csv has {rows} rows, not the points 0 to {wanted - 1} in order"]
    return []


def split_tables(tables: ExportedTables, segments: Sequence[ToolSegment]) -> list[ExportedTables]:
    """Return the tables of each tool segment, with points and time counted from its start.

    Args:
        tables: The exported tables of the folder.
        segments: The tool segments in order.
    """
    motion, points, shift = tables.motion, tables.points, tables.shift
    starts = _find_segment_starts(motion)
    return [
        ExportedTables(
            slice_motion(motion, a, b, segment.first),
            _slice_points(points, segment),
            None if shift is None else _slice_shift(shift, segment),
            None if tables.tilt is None else _slice_tilt(tables.tilt, segment),
            None if tables.corners is None else tables.corners.select(a, b),
        )
        for a, b, segment in zip(starts, [*starts[1:], len(motion.time)], segments, strict=True)
    ]


def slice_motion(motion: ExportedMotion, start: int, stop: int, first: int) -> ExportedMotion:
    """Return some rows of a motion as a separate motion.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        start: First row.
        stop: Row behind the last one.
        first: Toolpath point that becomes point 0.
    """
    rows = slice(start, stop)
    return ExportedMotion(
        time=motion.time[rows] - motion.time[start],
        point=motion.point[rows] - first,
        move=motion.move[rows],
        q=motion.q[rows],
        external=motion.external[rows],
        operation=motion.operation[rows],
        gamma=motion.gamma[rows],
        feed=motion.feed[rows],
        slides=motion.slides,
        tool=motion.tool[rows],
        lead=None if motion.lead is None else motion.lead[rows],
        side=None if motion.side is None else motion.side[rows],
        lifted=None if motion.lifted is None else motion.lifted[rows],
    )


def _slice_points(points: ExportedPoints, segment: ToolSegment) -> ExportedPoints:
    rows = slice(segment.first, segment.stop)
    return ExportedPoints(
        point=points.point[rows] - segment.first,
        q=points.q[rows],
        external=points.external[rows],
        status=points.status[rows],
        numbers={name: values[rows] for name, values in points.numbers.items()},
        words={name: words[rows] for name, words in points.words.items()},
        shift=None if points.shift is None else points.shift[rows],
        lead=None if points.lead is None else points.lead[rows],
        side=None if points.side is None else points.side[rows],
    )


def _slice_shift(shift: ExportedShift, segment: ToolSegment) -> ExportedShift:
    rows = (shift.index >= segment.first) & (shift.index <= segment.stop - 1)
    return ExportedShift(shift.index[rows] - segment.first, shift.offset[rows], shift.force[rows])


def _slice_tilt(tilt: ExportedTilt, segment: ToolSegment) -> ExportedTilt:
    rows = (tilt.index >= segment.first) & (tilt.index <= segment.stop - 1)
    return ExportedTilt(tilt.index[rows] - segment.first, tilt.lead[rows], tilt.side[rows])


def _merge_checks(segments: Sequence[ToolSegment], found: Sequence[list[VerificationRow]]) -> list[VerificationRow]:
    """One check of each name: of all tools the one that keeps it worst."""
    names = list(dict.fromkeys(c.name for checks in found for c in checks))
    out: list[VerificationRow] = []
    for name in names:
        same = [(s, c) for s, checks in zip(segments, found, strict=True) for c in checks if c.name == name]
        segment, check = max(same, key=lambda one: _rank_check(one[1]))
        stated = f"tool {segment.tool}, points counted from {segment.first}: {check.where}"
        out.append(replace(check, where=stated))
    return out


def _rank_check(check: VerificationRow) -> tuple[int, float]:
    """Return the rank of a check, failed highest, then not run, passed; within these by value."""
    if isinstance(check, VerificationInformation):
        return 0, check.value if np.isfinite(check.value) else -np.inf
    order = {False: 2, None: 1, True: 0}[check.passed]
    value = check.value - check.limit if np.isfinite(check.limit) else check.value
    return order, float(value) if np.isfinite(value) else -np.inf
