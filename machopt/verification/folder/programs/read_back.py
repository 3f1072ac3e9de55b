"""Verification of the robot programs of an output folder, read back from their files.

Each program is read by code that its writer does not share. It is compared with the motion and with the CAM file
(:mod:`machopt.verification.programs.motion_comparison`, :mod:`machopt.verification.programs.cam_comparison`).
Everything else (head, frames, loads, speeds, zones, events in the controller's words, END, further files) must equal,
word by word, what the post writes for such targets (:mod:`machopt.programs.writing.text_comparison`). ``optimize``
and ``verify`` both call :func:`check_programs`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import RobotController
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.kinematics.controller_posture import compute_controller_posture
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.programs.checking.configuration_check import find_first_difference
from machopt.programs.maker_registry import find_language, load_checks
from machopt.programs.program_reader import ParsedProgram, is_program_file, read_program
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.verification.check_results import CheckName, VerificationCheck, VerificationInformation, build_file_check
from machopt.verification.folder.programs.exported_motion_tables import read_program_tables
from machopt.verification.folder.programs.frames_and_axes import (
    compute_toolpath_index,
    compute_workpiece_frame,
    convert_external_joints,
    convert_to_controller_axes,
    find_wrong_frames,
)
from machopt.verification.folder.programs.kinematic_and_tilt_corrections import (
    compute_corrections,
    tilt_commanded_path,
    turn_samples_back,
    turn_targets_back,
)
from machopt.verification.folder.programs.post_lookup import select_listed_controller
from machopt.verification.folder.programs.program_comparison_result import ListedProgram, ProgramComparison
from machopt.verification.folder.programs.program_conversion import convert_to_cell_frames
from machopt.verification.folder.programs.rapid_zone_table import RapidZoneTable
from machopt.verification.folder.programs.rewritten_program import RewrittenProgram, build_failed_program_check
from machopt.verification.folder.programs.target_joints import (
    compute_external_joints,
    find_target_joints,
    interpolate_joints,
)
from machopt.verification.motion.checks.compensation_shift import compute_commanded_corners
from machopt.verification.motion.checks.rapid_corners import unround_motion
from machopt.verification.motion.checks.reentries import find_reentry_points
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.motion_verification import ExportedTables
from machopt.verification.motion.path_geometry.motion_polyline import CommandedPath, build_motion_polyline
from machopt.verification.motion.path_geometry.tool_tilt import ToolTilt
from machopt.verification.programs.cam_comparison import compare_with_cam
from machopt.verification.programs.expected_cuts import ExpectedCuts
from machopt.verification.programs.motion_comparison import compare_with_motion
from machopt.verification.programs.target_matching import TargetTolerances
from machopt.verification.tables.advised_feeds import ADVISED, apply_exported_feeds
from machopt.verification.tables.exported_tables import ExportedMotion

FRAME_TOLERANCE = 1e-6  # m, and of a rotation's entries: both are printed to nine decimals of a degree


def check_programs(
    cell: Cell,
    toolpath: Toolpath,
    out: Path,
    posted: Sequence[ListedProgram],
    *,
    options: PlanOptions,
    tolerance: ProgramTolerance,
    source: str | None = None,
    tables: ExportedTables | ExportedMotion | None = None,
) -> tuple[ProgramComparison, ...]:
    """Compare every robot program of an output folder with motion and CAM file.

    Args:
        cell: with its controller.
        toolpath: the CAM file.
        out: the folder, with trajectory.csv and points.csv.
        posted: the programs that ought to be there.
        options: as for the plan.
        tolerance: between the controller's lines and the motion.
        source: what the programs' heads say they are from; cell and toolpath by default.
        tables: what of the folder's tables belongs to the toolpath, where that is a part of the job; or trajectory.csv
            alone, where it has been read already.

    Returns:
        One entry a program.

    Raises:
        InputError: a table of the folder cannot be read.
    """
    out = Path(out)
    if not posted:
        return ()
    if not isinstance(tables, ExportedTables):
        tables = read_program_tables(cell, out, tables)
    given = cell, toolpath, out, options, tolerance, source or f"{cell.name}; {toolpath.source}"
    ground = straight = _ComparisonContext.build(*given, tables)
    if tables.corners is not None:  # targets of joint moves are where the motion would have stopped
        straight = _ComparisonContext.build(
            *given, replace(tables, motion=unround_motion(tables.motion, tables.corners))
        )
    return tuple(ground.compare_program(one, straight) for one in posted)


@dataclass(frozen=True, kw_only=True)
class _ComparisonContext:
    """What every program of the folder is compared with, computed once."""

    cell: Cell
    toolpath: Toolpath
    out: Path
    options: PlanOptions
    tolerance: ProgramTolerance
    source: str
    motion: ExportedMotion
    arm: UrdfKinematics
    tcp: Array  # (S, 3, 4) in workpiece by nominal kinematics
    offset: Array  # (S, 3) m from there to the true place
    tilt: Array  # (S, 3) from the tool axis there (tip to shank) to the true one
    cam_points: NDArray[np.bool_]  # (N,)
    corners: tuple[Array, Array]
    tool_tilt: ToolTilt | None  # of the tool against the CAM axes; None: there is none
    rapid: RapidZoneTable | None  # where joint moves may be rounded; None: nowhere

    @classmethod
    def build(
        cls,
        cell: Cell,
        toolpath: Toolpath,
        out: Path,
        options: PlanOptions,
        tolerance: ProgramTolerance,
        source: str,
        tables: ExportedTables,
    ) -> _ComparisonContext:
        motion, points, shift, stated = tables.motion, tables.points, tables.shift, tables.tilt
        arm = UrdfKinematics(cell, drawn=True)  # as the controller reckons
        tcp = arm.compute_tcp_in_workpiece(motion.q, motion.external, rows=3)
        offset, tilt = compute_corrections(cell, motion, tcp)
        wanted = toolpath.cutting.copy()
        if options.allow_gaps:
            given_up = [
                k for k, s in zip(points.point, points.status, strict=True) if s != "ok" and 0 <= k < len(wanted)
            ]
            wanted[given_up] = False
        line = (
            compute_commanded_corners(toolpath, shift)
            if shift is not None
            else (np.arange(len(toolpath), dtype=float), toolpath.position)
        )
        return cls(
            cell=cell,
            toolpath=apply_exported_feeds(toolpath, points.numbers.get(ADVISED), points.point),
            out=out,
            options=options,
            tolerance=tolerance,
            source=source,
            motion=motion,
            arm=arm,
            tcp=tcp,
            offset=offset,
            tilt=tilt,
            cam_points=wanted,
            corners=line,
            tool_tilt=None if stated is None else ToolTilt.build(cell, toolpath, stated, line),
            rapid=None if tables.corners is None else RapidZoneTable.build(motion, tables.corners, arm),
        )

    def compare_program(self, posted: ListedProgram, straight: _ComparisonContext) -> ProgramComparison:
        """Read one program back and compare it with motion, CAM file and post.

        Args:
            posted: The program as the manifest lists it.
            straight: The same with rapid moves straight as far as their corners, for programs that state targets.
        """
        name = posted.files[0]
        missing = [f for f in posted.files if not (self.out / f).is_file()]
        if missing:
            return ProgramComparison(
                posted, 0, (build_failed_program_check(name, "files there", f"{missing[0]} is missing"),)
            )
        controller, other = select_listed_controller(self.cell, posted.post)
        pulses = None if controller.pulses_per_deg is None else controller.pulses_per_deg.tolist()
        try:
            if other and not is_program_file(self.out / name):
                return ProgramComparison(posted, 0, (_build_unreadable_check(name),), readable=False)
            parsed = read_program(self.out / name, pulses_per_deg=pulses)
        except InputError as problem:
            return ProgramComparison(posted, 0, (build_failed_program_check(name, "readable", str(problem.reason)),))
        program = convert_to_cell_frames(
            name, parsed, self.cell, controller, self.arm, self.motion, self.tcp, self.tolerance.position
        )
        if not np.isfinite(program.T_workpiece_tcp).all():
            return ProgramComparison(
                posted,
                len(program),
                (build_failed_program_check(name, "readable", "a target has neither place nor joints"),),
            )
        context = self if program.is_streamed else straight
        checks, rows = context._compare_with_motion_and_cam(program)
        checks += context._check_frames_and_words(name, parsed, program, controller, rows)
        checks += context._check_wording(posted, parsed, program, controller, rows)
        read = VerificationInformation(
            name=f"{name}: {CheckName.MOVES}",
            value=float(len(program)),
            unit="moves",
            where=parsed.dialect,
            file=name,
            what=CheckName.MOVES,
        )
        return ProgramComparison(posted, len(program), tuple(checks), information=(read,))

    def _compare_with_motion_and_cam(self, program: ProgramInCell) -> tuple[list[VerificationCheck], Array]:
        """Return the checks, and (M,) the fractional sample of the motion at which each move ends."""
        o = self.options
        allowed = TargetTolerances(
            position=self.tolerance.position,
            axis=self.tolerance.axis,
            turn=self.tolerance.turn,
            corner=o.path_tolerance,
            axis_corner=o.axis_tolerance,
            external=self.tolerance.external,
        )
        path = CommandedPath(
            toolpath=self.toolpath,
            index=self.corners[0],
            position=self.corners[1],
            offset=self.offset,
            tilt=self.tilt,
        )
        on_samples = len(program) == len(self.tcp)
        checks, at = compare_with_motion(
            program, self.motion, self.tcp, allowed, tilt_commanded_path(self.tool_tilt, path)
        )
        rows = np.clip(np.nan_to_num(at), 0, len(self.tcp) - 1)
        offset, tilt = (
            np.column_stack([np.interp(rows, np.arange(len(self.tcp)), of[:, c]) for c in range(3)])
            for of in (self.offset, self.tilt)
        )
        position = np.column_stack(
            [np.interp(np.arange(len(self.toolpath)), self.corners[0], self.corners[1][:, c]) for c in range(3)]
        )
        cuts = ExpectedCuts(
            toolpath=self.toolpath,
            position=position,
            corners=self.corners,
            wanted=self.cam_points,
            corner=o.path_tolerance,
            axis_corner=o.axis_tolerance,
            approach_feed=o.approach_feed,
            offset=offset,
            tilt=tilt,
            reentries=find_reentry_points(self.motion),
            line=build_motion_polyline(
                self.motion, turn_samples_back(self.tool_tilt, self.tcp, self.motion.point), self.motion.q, path
            )
            if program.is_streamed and on_samples
            else None,
        )
        at_index = compute_toolpath_index(self.motion, at, self.toolpath)
        program, cuts = turn_targets_back(self.tool_tilt, program, cuts, at_index)
        checks += compare_with_cam(program, cuts, at_index)
        return checks, rows

    def _check_wording(
        self,
        posted: ListedProgram,
        parsed: ParsedProgram,
        program: ProgramInCell,
        controller: RobotController,
        rows: Array,
    ) -> list[VerificationCheck]:
        """Compare the text with what the post writes."""
        if posted.post is None:
            why = "not checked: the template of the post is not available"
            return [build_file_check(posted.files[0], "wording", None, np.nan, 0.0, "", why)]
        job = RewrittenProgram(
            cell=self.cell,
            toolpath=self.toolpath,
            out=self.out,
            options=self.options,
            tolerance=self.tolerance,
            source=self.source,
            rapid=None if self.rapid is None else self.rapid.select(rows),
        )
        external = compute_external_joints(self.motion, program, rows)
        q = find_target_joints(
            self.arm,
            self.cell.tool.T_flange_tcp,
            program,
            interpolate_joints(self.motion, rows),
            external,
            load_robot(self.cell).nominal_robot,
        )
        return job.check_text(posted.files, posted.post, parsed, program, controller, q, external)

    def _check_frames_and_words(
        self, name: str, parsed: ParsedProgram, program: ProgramInCell, controller: RobotController, rows: Array
    ) -> list[VerificationCheck]:
        """Check frames, configuration and unknown words."""
        given = compute_workpiece_frame(parsed, self.cell, self.arm, controller, self.motion.external[0])
        coupled = find_language(parsed.dialect).couples_frames and bool(
            self.arm.list_moving_joints(self.arm.workpiece_placement)
        )
        wrong = find_wrong_frames(parsed, controller, given, self.cell.tool.T_flange_tcp, rides=coupled)
        _, spare = convert_external_joints(parsed, self.cell, self.arm, controller)
        wrong += [f"{spare} values of external axes that the cell has not"] if spare else []
        checks = [
            build_file_check(
                name, "tool and base", not wrong, float(len(wrong)), 0.0, "frames", "; ".join(wrong) or "the cell's"
            )
        ]
        checks += self._check_configuration(name, parsed, program, controller, rows)
        own = set(re.findall(r"\w+", " ".join(controller.lines.values())))  # of the cell: its words are unknown here
        strange = [w.word for w in parsed.ignored if not w.understood and own.isdisjoint(re.findall(r"\w+", w.word))]
        strange += [w for w in parsed.warnings if "cut off" in w]
        checks += self._compare_poses_with_joints(name, parsed, program, rows)
        words = ", ".join(strange[:4]) or "all"
        count = float(len(strange))
        return [*checks, build_file_check(name, "every word understood", not strange, count, 0.0, "words", words)]

    def _check_configuration(
        self, name: str, parsed: ParsedProgram, program: ProgramInCell, controller: RobotController, rows: Array
    ) -> list[VerificationCheck]:
        """Compare status, turns and the like with the joints; no check where the program names none."""
        robot = load_robot(self.cell).nominal_robot
        q = find_target_joints(
            self.arm,
            self.cell.tool.T_flange_tcp,
            program,
            interpolate_joints(self.motion, rows),
            compute_external_joints(self.motion, program, rows),
            robot,
        )
        known, first = find_first_difference(
            load_checks(parsed.dialect),
            parsed.configuration,
            convert_to_controller_axes(q, controller),
            compute_controller_posture(robot, q, controller),
            controller.nonflip_j5,
        )
        if not known:
            return []
        where = "of all moves as their joints are"
        if first is not None:
            where = f"move {first + 1}, line {int(parsed.line[first])} names another one"
        passed = first is None
        return [build_file_check(name, CheckName.CONFIGURATION, passed, float(not passed), 0.0, "moves", where)]

    def _compare_poses_with_joints(
        self, name: str, parsed: ParsedProgram, program: ProgramInCell, rows: Array
    ) -> list[VerificationCheck]:
        """Compare poses and joints of a program that has both."""
        both = np.flatnonzero(parsed.has_pose & np.isfinite(program.q).all(axis=1))
        if not len(both):
            return []
        T = self.arm.compute_tcp_in_workpiece(
            program.q[both], compute_external_joints(self.motion, program, rows)[both]
        )
        gap = np.linalg.norm(T[:, :3, 3] - program.T_workpiece_tcp[both, :3, 3], axis=1)
        gap = np.maximum(gap, np.linalg.norm(T[:, :3, :3] - program.T_workpiece_tcp[both, :3, :3], axis=(1, 2)))
        n = int(np.argmax(gap))
        passed, where = bool(gap[n] <= FRAME_TOLERANCE), f"move {both[n] + 1}, line {int(parsed.line[both[n]])}"
        value, limit = 1e3 * float(gap[n]), 1e3 * FRAME_TOLERANCE
        return [build_file_check(name, "poses as the joints", passed, value, limit, "mm", where)]


def _build_unreadable_check(file: str) -> VerificationCheck:
    return build_file_check(
        file,
        CheckName.COMPARED,
        None,
        float("nan"),
        0.0,
        "",
        "NOT CHECKED: no reader for the language of this program exists",
    )
