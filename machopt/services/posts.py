"""Robot programs of a job: which posts, whether they can be written at all, written, and read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest
from machopt.domain.options import PlanOptions
from machopt.domain.program import LIN, PTP, Controller, RobotProgram
from machopt.domain.results.optimize import ProgramTold
from machopt.domain.toolpath import Move, Toolpath
from machopt.errors import InputError
from machopt.formats.posts import (
    HeldFeed,
    assumptions,
    load_post,
    model_feed,
    needs_samples,
    program_name,
    unstarted,
    write_program,
)
from machopt.formats.posts.densify import Tolerance
from machopt.formats.posts.postfile import ALIASES, post_names
from machopt.model.robot import Robot, load_chain
from machopt.output.hashes import sha256_of
from machopt.plan.blend import SPIN_TOLERANCE
from machopt.plan.pipeline import Plan
from machopt.plan.timeline import BEND, Timeline
from machopt.services.program import Programmed, posture_of, robot_program, sampled_program
from machopt.services.readback import Compared, Posted, controller_for
from machopt.verify import Verification

TOLERANCE_MM = 0.05
OWN_FILES = ("points.csv", "trajectory.csv", "compensation.csv", "result.json", "manifest.json", "report.html")


@dataclass(frozen=True)
class Wanted:
    """One post of a job."""

    post: str | Path
    label: str  # as the user gave it; a file by its name
    folder: str  # inside the output folder, empty for the output folder itself


@dataclass(frozen=True)
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


def wanted_posts(cell: Cell, asked: Sequence[str]) -> tuple[Wanted, ...]:
    """The posts asked for, or the cell's own, or none; each is tried on a short program before anything is planned.

    One post writes into the output folder itself, several into folders of their own.

    Raises:
        InputError: no such post, a faulty template, the same one twice, or the cell does not say what it needs.
    """
    out: list[Wanted] = []
    for text in asked or ([] if cell.controller.post is None else [cell.controller.post]):
        file = is_post_file(text)
        post: str | Path = Path(text) if file else text
        label = Path(text).name if file else text
        folder = Path(text).stem if file else text
        if any(w.folder.lower() == folder.lower() for w in out):
            raise InputError(f"{text!r} is asked for twice, or two files have one name", where="--post")
        out.append(Wanted(post, label, folder if len(asked) > 1 else ""))
    robot = load_chain(cell)[0]
    for one in out:
        _try(cell, robot, one)
    return tuple(out)


def is_post_file(text: str) -> bool:
    """A template file rather than the name of a shipped post."""
    return text.endswith(".toml") or (text not in post_names() and Path(text).is_file())


def tolerance_of(mm: float | None, options: PlanOptions) -> Tolerance:
    """The tolerance between the controller's lines and the motion; None takes 0.05 mm.

    The angles leave room for what the motion itself smooths at the corners of the path.

    Raises:
        InputError: it is below the rounding of corners, which no program of straight lines can follow.
    """
    least = options.path_tolerance * 1e3
    if mm is None:
        mm = max(TOLERANCE_MM, 2.0 * least)
    if not (np.isfinite(mm) and mm > least):
        raise InputError(
            f"{mm:g} mm; more than path_tolerance_mm = {least:g} would work: by that much the motion rounds corners, "
            "and the program's points are the corners",
            where="--program-tolerance-mm",
        )
    return Tolerance(
        position=mm * 1e-3,
        axis=max(Tolerance.axis, 1.5 * options.axis_tolerance),
        turn=max(Tolerance.turn, 2.0 * SPIN_TOLERANCE + BEND + options.axis_tolerance),
    )


def write_programs(
    folder: Path, wanted: Sequence[Wanted], plan: Plan, toolpath: Toolpath, timeline: Timeline, tolerance: Tolerance
) -> tuple[Written, ...]:
    """Write every post's program.

    Raises:
        InputError: a post cannot write this program.
        ValueError: the timeline has no trajectory.
    """
    if timeline.trajectory is None:
        raise ValueError("a blocked motion is no program")
    made: dict[bool, Programmed] = {}
    out: list[Written] = []
    cell = plan.setup.cell
    for one in wanted:
        controller = controller_for(cell, one.post)
        samples = needs_samples(one.post)
        if samples not in made:
            made[samples] = (
                sampled_program(plan, toolpath, timeline)
                if samples
                else robot_program(plan, toolpath, timeline, tolerance)
            )
        target = folder / one.folder
        target.mkdir(exist_ok=True)
        program = made[samples].program
        files = write_program(
            target,
            program_name(toolpath.source, one.post),
            program,
            one.post,
            controller,
            reserved=() if one.folder else OWN_FILES,
        )
        if isinstance(one.post, Path) and str(one.post) != cell.controller.post:
            (folder / one.label).write_bytes(one.post.read_bytes())  # who verifies has no other way to it
        lines = sum(f.read_bytes().count(b"\n") for f in files)
        names = tuple(f.relative_to(folder).as_posix() for f in files)
        out.append(
            Written(
                one.label,
                names,
                lines,
                made[samples].added,
                tolerance.position,
                one.post,
                model_feed(program, one.post, controller),
                assumptions(program, one.post, controller),
                unstarted(one.post, program, controller),
            )
        )
    return tuple(out)


def read_back(programs: Sequence[Written], verification: Verification) -> tuple[Written, ...]:
    """The programs with what the verification says of each."""
    return tuple(replace(p, checked=Compared.of(p.posted, verification.checks)) if p.files else p for p in programs)


def withheld(wanted: Sequence[Wanted], tolerance: Tolerance, why: str) -> tuple[Written, ...]:
    """What stands for programs that are not written at all."""
    return tuple(Written(one.label, (), 0, 0, tolerance.position, one.post, withheld=why) for one in wanted)


def withdrawn(folder: Path, programs: Sequence[Written], why: str) -> tuple[Written, ...]:
    """Remove programs that nobody may load, with folders of their own."""
    for name in (name for p in programs for name in p.files):
        file = folder / name
        file.unlink(missing_ok=True)
        while file.parent != folder and not any(file.parent.iterdir()):
            file = file.parent
            file.rmdir()
    return tuple(replace(p, files=(), withheld=why) for p in programs)


def post_of(label: str, folder: Path, cell: Cell, manifest: Manifest | None) -> str | Path | None:
    """The post of that label: a shipped one's name, the cell's own, the folder's copy of a user's template, or None."""
    if label in post_names() or label in ALIASES:
        return label
    own = cell.controller.post
    if own is not None and Path(own).name == label and Path(own).is_file():
        return Path(own)
    copy = folder / label
    recorded = {f.sha256 for f in (() if manifest is None else manifest.inputs_of("post"))}
    return copy if copy.is_file() and sha256_of(copy) in recorded else None


def to_be_told(cell: Cell, toolpath: Toolpath, post: str | Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What a program of this post takes for granted, and which events it does not carry out; no plan is needed."""
    controller = controller_for(cell, post)
    program = replace(_short(cell, load_chain(cell)[0], controller), events=toolpath.events)
    return assumptions(program, post, controller), unstarted(post, program, controller)


def _try(cell: Cell, robot: Robot, one: Wanted) -> None:
    """Fill the post once, into nothing: what would fail after the plan should fail before it."""
    keys = load_post(one.post).keys
    controller = controller_for(cell, one.post)
    program = _short(cell, robot, controller)
    name = program_name("part", one.post)
    write_program(None, name, program, one.post, controller)
    if keys.moves_per_part is not None:  # the same in two parts, whose calls are templates of their own
        write_program(None, name, program, one.post, replace(controller, moves_per_part=1))


def _short(cell: Cell, robot: Robot, controller: Controller) -> RobotProgram:
    """Three moves at home."""
    q = np.tile(cell.home, (3, 1))
    standing = posture_of(robot, q, controller)
    return RobotProgram(
        kind=np.array([PTP, LIN, PTP], np.int8),
        q=q,
        T_workpiece_tcp=robot.fk(q, cell.tool.T_flange_tcp),
        feed=np.array([np.nan, 0.01, np.nan]),
        cutting=np.array([False, True, False]),
        operation=np.zeros(3, np.int32),
        operations=("cut",),
        T_flange_tcp=cell.tool.T_flange_tcp,
        T_base_workpiece=np.eye(4),
        move=np.array([Move.RAPID, Move.CUT, Move.RAPID], np.int8),
        time=np.arange(3.0),
        joint_names=cell.arm_joints,
        behind=None if standing is None else standing[0],
        elbow_up=None if standing is None else standing[1],
        tool_mass=cell.tool.mass if cell.tool.mass > 0.0 else float("nan"),
    )
