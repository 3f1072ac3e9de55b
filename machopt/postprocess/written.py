"""Robot programs of a job: written, with what came back when they were read, or withdrawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.domain.results.optimize import ProgramTold
from machopt.domain.stint import Stint
from machopt.formats.posts import (
    HeldFeed,
    assumptions,
    model_feed,
    needs_samples,
    program_name,
    unstarted,
    write_program,
)
from machopt.formats.posts.densify import Tolerance
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.postprocess.moves import Programmed, robot_program, sampled_program
from machopt.postprocess.wanted import Wanted
from machopt.recheck.compared import Compared, Posted
from machopt.recheck.posts import controller_for
from machopt.report import data as page
from machopt.verify import Verification
from machopt.verify.check import Promise

OWN_FILES = ("points.csv", "trajectory.csv", "compensation.csv", "result.json", "manifest.json", "report.html")


@dataclass(frozen=True, kw_only=True)
class Written:
    """One program of a job."""

    label: str
    files: tuple[str, ...]  # relative to the output folder, the one that is run first
    lines: int
    added: int  # moves put in to keep to the tolerance
    tolerance: float  # m
    post: str | Path = ""
    feed: HeldFeed | None = None  # by the controller's model; None: it streams the motion's own samples
    assumed: tuple[str, ...] = ()  # of the controller, because the cell does not say it
    unstarted: tuple[str, ...] = ()  # spindle, coolant and tool words of the CAM file that are comments only
    checked: Compared | None = None  # what came back; None: it has not been read yet, or is not there
    withheld: str = ""  # why no file of it is left; empty where it lies there
    stint: int = 0  # which tool of the job it drives, from 1; 0: the whole job
    tool: str = ""  # that tool's name, where there are several

    @property
    def ok(self) -> bool:
        """False where it says something else than motion and CAM file."""
        return self.checked is None or not self.checked.differences

    @property
    def posted(self) -> Posted:
        return Posted(self.label, self.post, self.files)

    def as_result(self) -> ProgramTold:
        """For result.json."""
        return ProgramTold(
            post=self.label,
            tool=self.tool or None,
            files=self.files,
            lines=self.lines,
            tolerance_mm=self.tolerance * 1e3,
            moves_added=self.added,
            withheld=self.withheld or None,
            feed_model=None if self.feed is None else self.feed.as_result(),
            assumed=self.assumed,
            not_in_program=self.unstarted,
            checked=None if self.checked is None else self.checked.as_result(),
            differences=() if self.checked is None else self.checked.differences,
        )

    def as_page(self) -> page.Program:
        """For the report."""
        c = self.checked
        held = self.feed
        said = page.Program(
            post=self.label,
            files=self.files,
            lines=self.lines,
            added=self.added,
            tolerance=self.tolerance,
            assumed=self.assumed,
            unstarted=self.unstarted,
            withheld=self.withheld,
            feed_mean=float("nan") if held is None else held.mean_share,
            feed_lowest=float("nan") if held is None else held.lowest_share,
            feed_deviation=float("nan") if held is None else held.deviation,
        )
        if c is None or not c.readable:
            return replace(said, checked=False)
        return replace(
            said,
            moves=c.moves,
            position_error=c.worst(Promise.CAM_POINTS) / 1e3,
            angle_error=math.radians(c.worst(Promise.ORIENTATIONS)),
            joint_error=math.radians(c.worst(Promise.JOINTS)),
            feed_error=c.worst(Promise.CAM_FEED) / 6e4,
            path_error=c.worst(Promise.LINES) / 1e3,
            axis_error=math.radians(c.worst(Promise.LINES_AXIS)),
            turn_error=math.radians(c.worst(Promise.LINES_TURN)),
            events_equal=c.passed(Promise.EVENTS) is not False,
            differences=c.differences,
            configuration_equal=c.passed(Promise.CONFIGURATION),
        )


def write_programs(
    folder: Path, wanted: Sequence[Wanted], jobs: Sequence[tuple[Stint, Plan, Timeline | None]], tolerance: Tolerance
) -> tuple[Written, ...]:
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
    made: dict[tuple[int, bool], Programmed] = {}
    out: list[Written] = []
    for one in wanted:
        samples = needs_samples(one.post)
        for stint, plan, timeline in jobs:
            key = stint.number, samples
            if timeline is None or timeline.trajectory is None:
                raise ValueError("a blocked motion is no program")
            if key not in made:
                made[key] = (
                    sampled_program(plan, stint.toolpath, timeline)
                    if samples
                    else robot_program(plan, stint.toolpath, timeline, tolerance)
                )
            out.append(_written(folder, one, stint, made[key], tolerance))
    return tuple(out)


def _written(folder: Path, one: Wanted, stint: Stint, made: Programmed, tolerance: Tolerance) -> Written:
    """One program of one post."""
    cell, program = stint.cell, made.program
    controller = controller_for(cell, one.post)
    target = folder / one.folder
    target.mkdir(exist_ok=True)
    files = write_program(
        target,
        stint_name(stint, one.post),
        program,
        one.post,
        controller,
        reserved=() if one.folder else OWN_FILES,
    )
    if isinstance(one.post, Path) and str(one.post) != cell.controller.post:
        (folder / one.label).write_bytes(one.post.read_bytes())  # who verifies has no other way to it
    return Written(
        label=one.label,
        files=tuple(f.relative_to(folder).as_posix() for f in files),
        lines=sum(f.read_bytes().count(b"\n") for f in files),
        added=made.added,
        tolerance=tolerance.position,
        post=one.post,
        feed=model_feed(program, one.post, controller),
        assumed=assumptions(program, one.post, controller),
        unstarted=unstarted(one.post, program, controller),
        stint=stint.number,
        tool=stint.tool if stint.number else "",
    )


def stint_name(stint: Stint, post: str | Path) -> str:
    """The program's name: the toolpath's, with the stint's number behind it where there are several."""
    source = stint.toolpath.source
    return program_name(f"{source} {stint.number}" if stint.number else source, post)


def read_back(programs: Sequence[Written], verification: Verification) -> tuple[Written, ...]:
    """The programs with what the verification says of each."""
    return tuple(replace(p, checked=Compared.of(p.posted, verification)) if p.files else p for p in programs)


def withheld(wanted: Sequence[Wanted], tolerance: Tolerance, why: str) -> tuple[Written, ...]:
    """What stands for programs that are not written at all."""
    return tuple(
        Written(label=one.label, files=(), lines=0, added=0, tolerance=tolerance.position, post=one.post, withheld=why)
        for one in wanted
    )


def withdrawn(folder: Path, programs: Sequence[Written], why: str) -> tuple[Written, ...]:
    """Remove programs that nobody may load, with folders of their own."""
    for name in (name for p in programs for name in p.files):
        file = folder / name
        file.unlink(missing_ok=True)
        while file.parent != folder and not any(file.parent.iterdir()):
            file = file.parent
            file.rmdir()
    return tuple(replace(p, files=(), withheld=why) for p in programs)
