"""Robot programs of a job: written, verified after reading back, or removed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.data_types.documents.program_entries import RobotProgramEntry
from machopt.data_types.tool_segments import ToolSegment
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.program_export.program_moves import MotionProgram, build_robot_program, build_sampled_program
from machopt.program_export.selected_posts import SelectedPost
from machopt.programs.program_writer import (
    FeedModelResult,
    estimate_program_feed,
    format_program_name,
    has_sampled_output,
    list_assumptions,
    list_unstarted_events,
    write_program,
)
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.report.page_types import optimize_page_data as page
from machopt.verification import Verification
from machopt.verification.check_results import CheckName
from machopt.verification.folder.programs.post_lookup import select_controller
from machopt.verification.folder.programs.program_comparison_result import ListedProgram, ProgramComparison

OWN_FILES = (
    "points.csv",
    "trajectory.csv",
    "compensation.csv",
    "tilt.csv",
    "rapid_corners.csv",
    "engagement.csv",
    "result.json",
    "manifest.json",
    "report.html",
)


@dataclass(frozen=True, kw_only=True)
class ExportedProgram:
    """One robot program of a job."""

    label: str
    files: tuple[str, ...]  # relative to the output folder, the one that is run first
    lines: int
    added: int  # moves put in to keep to the tolerance
    tolerance: float  # m
    post: str | Path = ""
    feed: FeedModelResult | None = None  # by the controller's model; None: it streams the motion's own samples
    assumptions: tuple[str, ...] = ()  # of the controller, because the cell does not say it
    unstarted_events: tuple[str, ...] = ()  # spindle, coolant and tool words of the CAM file that are comments only
    checked: ProgramComparison | None = None  # what came back; None: it has not been read yet, or is not there
    omission_reason: str = ""  # why no file of it is left; empty where it lies there
    tool_segment: int = 0  # which tool of the job it drives, from 1; 0: the whole job
    tool: str = ""  # that tool's name, where there are several

    @property
    def ok(self) -> bool:
        """False where it differs from motion or CAM file."""
        return self.checked is None or not self.checked.differences

    @property
    def to_posted_program(self) -> ListedProgram:
        return ListedProgram(self.label, self.post, self.files)

    def to_document(self) -> RobotProgramEntry:
        """For result.json."""
        return RobotProgramEntry(
            post=self.label,
            tool=self.tool or None,
            files=self.files,
            lines=self.lines,
            tolerance_mm=self.tolerance * 1e3,
            moves_added=self.added,
            withheld=self.omission_reason or None,
            feed_model=None if self.feed is None else self.feed.to_document(),
            assumed=self.assumptions,
            not_in_program=self.unstarted_events,
            checked=None if self.checked is None else self.checked.to_read_back(),
            differences=() if self.checked is None else self.checked.differences,
        )

    def to_page_data(self) -> page.ProgramRow:
        """For the report."""
        c = self.checked
        feed_model = self.feed
        row = page.ProgramRow(
            post=self.label,
            files=self.files,
            lines=self.lines,
            added=self.added,
            tolerance=self.tolerance,
            assumed=self.assumptions,
            unstarted=self.unstarted_events,
            withheld=self.omission_reason,
            feed_mean=float("nan") if feed_model is None else feed_model.mean_share,
            feed_lowest=float("nan") if feed_model is None else feed_model.lowest_share,
            feed_deviation=float("nan") if feed_model is None else feed_model.deviation,
        )
        if c is None or not c.readable:
            return replace(row, checked=False)
        return replace(
            row,
            moves=c.moves,
            position_error=c.get_value(CheckName.CAM_POINTS) / 1e3,
            angle_error=math.radians(c.get_value(CheckName.ORIENTATIONS)),
            joint_error=math.radians(c.get_value(CheckName.JOINTS)),
            feed_error=c.get_value(CheckName.CAM_FEED) / 6e4,
            path_error=c.get_value(CheckName.LINES) / 1e3,
            axis_error=math.radians(c.get_value(CheckName.LINES_AXIS)),
            turn_error=math.radians(c.get_value(CheckName.LINES_TURN)),
            events_equal=c.get_verdict(CheckName.EVENTS) is not False,
            differences=c.differences,
            configuration_equal=c.get_verdict(CheckName.CONFIGURATION),
        )


def write_programs(
    folder: Path,
    wanted: Sequence[SelectedPost],
    jobs: Sequence[tuple[ToolSegment, Plan, MotionTimeline | None]],
    tolerance: ProgramTolerance,
) -> tuple[ExportedProgram, ...]:
    """Write every post's program; where the job changes tools, one for each that is on, from change to change.

    Args:
        folder: the output folder.
        wanted: the posts.
        jobs: what each tool does, its plan and its motion.
        tolerance: between the controller's lines and the motion.

    Raises:
        InputError: a post cannot write this program.
        ValueError: a timeline has no trajectory.
    """
    made: dict[tuple[int, bool], MotionProgram] = {}
    out: list[ExportedProgram] = []
    for one in wanted:
        samples = has_sampled_output(one.post)
        for segment, plan, timeline in jobs:
            key = segment.number, samples
            if timeline is None or timeline.trajectory is None:
                raise ValueError("a blocked motion is no program")
            if key not in made:
                made[key] = (
                    build_sampled_program(plan, segment.toolpath, timeline)
                    if samples
                    else build_robot_program(plan, segment.toolpath, timeline, tolerance)
                )
            out.append(_write_program(folder, one, segment, made[key], tolerance))
    return tuple(out)


def _write_program(
    folder: Path, one: SelectedPost, segment: ToolSegment, motion_program: MotionProgram, tolerance: ProgramTolerance
) -> ExportedProgram:
    """One program of one post."""
    cell, program = segment.cell, motion_program.program
    controller = select_controller(cell, one.post)
    target = folder / one.folder
    target.mkdir(exist_ok=True)
    files = write_program(
        target,
        build_segment_program_name(segment, one.post),
        program,
        one.post,
        controller,
        reserved=() if one.folder else OWN_FILES,
    )
    if isinstance(one.post, Path) and str(one.post) != cell.controller.post:
        (folder / one.label).write_bytes(one.post.read_bytes())  # who verifies has no other way to it
    return ExportedProgram(
        label=one.label,
        files=tuple(f.relative_to(folder).as_posix() for f in files),
        lines=sum(f.read_bytes().count(b"\n") for f in files),
        added=motion_program.added_targets,
        tolerance=tolerance.position,
        post=one.post,
        feed=estimate_program_feed(program, one.post, controller),
        assumptions=list_assumptions(program, one.post, controller),
        unstarted_events=list_unstarted_events(one.post, program, controller),
        tool_segment=segment.number,
        tool=segment.tool if segment.number else "",
    )


def build_segment_program_name(segment: ToolSegment, post: str | Path) -> str:
    """Return the program's name: the toolpath's, with the segment's number where there are several.

    Args:
        segment: The tool segment.
        post: Name of a shipped post, or the path of a template file.
    """
    source = segment.toolpath.source
    return format_program_name(f"{source} {segment.number}" if segment.number else source, post)


def add_read_back_results(
    programs: Sequence[ExportedProgram], verification: Verification
) -> tuple[ExportedProgram, ...]:
    """Return the programs, each with its verification result.

    Args:
        programs: The exported programs.
        verification: Verification of the output folder.
    """
    return tuple(
        replace(p, checked=ProgramComparison.build(p.to_posted_program, verification)) if p.files else p
        for p in programs
    )


def list_omitted_programs(
    wanted: Sequence[SelectedPost], tolerance: ProgramTolerance, why: str
) -> tuple[ExportedProgram, ...]:
    """Return the entries of programs that are not written.

    Args:
        wanted: The selected posts.
        tolerance: The tolerance between program and motion.
        why: Reason why they are not written.
    """
    return tuple(
        ExportedProgram(
            label=one.label,
            files=(),
            lines=0,
            added=0,
            tolerance=tolerance.position,
            post=one.post,
            omission_reason=why,
        )
        for one in wanted
    )


def remove_programs(folder: Path, programs: Sequence[ExportedProgram], why: str) -> tuple[ExportedProgram, ...]:
    """Remove programs that must not be loaded, with their own folders.

    Args:
        folder: The output folder.
        programs: The exported programs.
        why: Reason of the removal.

    Returns:
        The entries without files, with the reason.
    """
    for name in (name for p in programs for name in p.files):
        file = folder / name
        file.unlink(missing_ok=True)
        while file.parent != folder and not any(file.parent.iterdir()):
            file = file.parent
            file.rmdir()
    return tuple(replace(p, files=(), omission_reason=why) for p in programs)
