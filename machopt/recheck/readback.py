"""The robot programs of an output folder, read back and held against everything they follow from.

Each program is read by code that its writer does not share and compared with the motion and with the CAM file
(:mod:`machopt.verify.program`, :mod:`machopt.verify.programcam`). What no comparison of targets sees (head, frames,
loads, speeds, zones, events in the controller's words, END, files beside) must be, word by word, what the post writes
for such targets (:mod:`machopt.formats.posts.wording`). ``optimize`` and ``verify`` both call :func:`check_programs`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.program import Controller
from machopt.domain.readprogram import ReadProgram
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.formats.posts.densify import Tolerance
from machopt.formats.programs import ParsedProgram, read_program, recognised
from machopt.formats.programs.configuration import first_difference
from machopt.formats.programs.joints import urdf_joints
from machopt.formats.programs.toolpath import URDF_JOINTS
from machopt.model.ik import refine
from machopt.model.posture import posture_of
from machopt.model.robot import Robot, load_robot
from machopt.recheck.compared import Compared, Posted
from machopt.recheck.posts import controller_for
from machopt.recheck.printed import target_step
from machopt.recheck.rewritten import Rewritten, failed_check
from machopt.recheck.terms import COUPLED, controller_axes, external_of, frame_given, index_at, wrong_frames
from machopt.verify.arm import Arm
from machopt.verify.check import Check, Information, Promise, of_file
from machopt.verify.encoder import true_angles
from machopt.verify.motion_polyline import CommandedPath, polyline
from machopt.verify.output import Tables
from machopt.verify.program import along_motion
from machopt.verify.programcam import Cuts, against_cam
from machopt.verify.programtargets import Allowed
from machopt.verify.shift import corners
from machopt.verify.table import Motion, read_motion, read_points, read_shift

PULSES = 3.0  # of an encoder: joints may be off by that much, by rounding and by coupling
REACH = 5.0  # m: what a joint's last digit is worth there
COARSE = 5.1e-5  # m/s: FANUC and Yaskawa print tenths of mm/s
SAME = 1e-8  # rad: places ten metres away by a tenth of a micrometre
TWICE = 1e-6  # m, and of a rotation's entries: both are printed to nine decimals of a degree
ROWS = 20_000  # targets worked out at once
STEPS, CLOSED, BESIDE_DEG = 5, 1e-8, 3.0  # of Newton's method to a target's own joints; m and rad; from the motion's


def check_programs(
    cell: Cell,
    toolpath: Toolpath,
    out: Path,
    posted: Sequence[Posted],
    *,
    options: PlanOptions,
    tolerance: Tolerance,
    source: str | None = None,
    motion: Motion | None = None,
    tables: Tables | None = None,
) -> tuple[Compared, ...]:
    """Compare every robot program of an output folder with motion and CAM file.

    Args:
        cell: with its controller.
        toolpath: the CAM file.
        out: the folder, with trajectory.csv and points.csv.
        posted: the programs that ought to be there.
        options: as for the plan.
        tolerance: between the controller's lines and the motion.
        source: what the programs' heads say they are from; cell and toolpath by default.
        motion: trajectory.csv where it has been read already.
        tables: what of the folder's tables belongs to the toolpath, where that is a part of the job.

    Returns:
        One entry a program.

    Raises:
        InputError: a table of the folder cannot be read.
    """
    out = Path(out)
    if not posted:
        return ()
    ground = _Ground.of(
        cell, toolpath, out, options, tolerance, source or f"{cell.name}; {toolpath.source}", motion, tables
    )
    return tuple(ground.compare(one) for one in posted)


@dataclass(frozen=True, kw_only=True)
class _Ground:
    """What every program of the folder is compared with, computed once."""

    cell: Cell
    toolpath: Toolpath
    out: Path
    options: PlanOptions
    tolerance: Tolerance
    source: str
    motion: Motion
    arm: Arm
    tcp: Array  # (S, 4, 4) in workpiece by nominal kinematics
    offset: Array  # (S, 3) m from there to the true place
    tilt: Array  # (S, 3) from the tool axis there (tip to shank) to the true one
    wanted: NDArray[np.bool_]  # (N,)
    corners: tuple[Array, Array]

    @classmethod
    def of(
        cls,
        cell: Cell,
        toolpath: Toolpath,
        out: Path,
        options: PlanOptions,
        tolerance: Tolerance,
        source: str,
        motion: Motion | None,
        tables: Tables | None,
    ) -> _Ground:
        if tables is None:
            motion = motion or read_motion(out / "trajectory.csv", cell)
            points = read_points(out / "points.csv", cell)
            shift = read_shift(out / "compensation.csv") if points.shift is not None else None
        else:
            motion, points, shift = tables.motion, tables.points, tables.shift
        arm = Arm(cell, drawn=True)  # as the controller reckons
        tcp = arm.tcp_in_workpiece(motion.q, motion.external)
        offset, tilt = np.zeros((len(tcp), 3)), np.zeros((len(tcp), 3))
        if cell.kinematics is not None:
            true = Arm(cell).tcp_in_workpiece(true_angles(cell.kinematics, motion.q), motion.external)
            offset, tilt = true[:, :3, 3] - tcp[:, :3, 3], tcp[:, :3, 2] - true[:, :3, 2]
        wanted = toolpath.cutting.copy()
        if options.allow_gaps:
            given_up = [
                k for k, s in zip(points.point, points.status, strict=True) if s != "ok" and 0 <= k < len(wanted)
            ]
            wanted[given_up] = False
        line = (
            corners(toolpath, shift)
            if shift is not None
            else (np.arange(len(toolpath), dtype=float), toolpath.position)
        )
        return cls(
            cell=cell,
            toolpath=toolpath,
            out=out,
            options=options,
            tolerance=tolerance,
            source=source,
            motion=motion,
            arm=arm,
            tcp=tcp,
            offset=offset,
            tilt=tilt,
            wanted=wanted,
            corners=line,
        )

    def compare(self, posted: Posted) -> Compared:
        name = posted.files[0]
        missing = [f for f in posted.files if not (self.out / f).is_file()]
        if missing:
            return Compared(posted, 0, (failed_check(name, "files there", f"{missing[0]} is missing"),))
        controller, other = _controller(self.cell, posted)
        pulses = None if controller.pulses_per_deg is None else controller.pulses_per_deg.tolist()
        try:
            if other and not recognised(self.out / name):
                return Compared(posted, 0, (_unread(name),), readable=False)
            parsed = read_program(self.out / name, pulses_per_deg=pulses)
        except InputError as problem:
            return Compared(posted, 0, (failed_check(name, "readable", str(problem.reason)),))
        said = self._in_cell_terms(name, parsed, controller)
        if not np.isfinite(said.T_workpiece_tcp).all():
            return Compared(
                posted, len(said), (failed_check(name, "readable", "a target has neither place nor joints"),)
            )
        o = self.options
        allowed = Allowed(
            position=self.tolerance.position,
            axis=self.tolerance.axis,
            turn=self.tolerance.turn,
            corner=o.path_tolerance,
            axis_corner=o.axis_tolerance,
            external=self.tolerance.external,
        )
        read = Information(
            name=f"{name}: {Promise.MOVES}",
            value=float(len(said)),
            unit="moves",
            where=parsed.dialect,
            file=name,
            what=Promise.MOVES,
        )
        path = CommandedPath(
            toolpath=self.toolpath,
            index=self.corners[0],
            position=self.corners[1],
            offset=self.offset,
            tilt=self.tilt,
        )
        on_samples = len(said) == len(self.tcp)
        checks, at = along_motion(said, self.motion, self.tcp, allowed, path)
        rows = np.clip(np.nan_to_num(at), 0, len(self.tcp) - 1)
        offset, tilt = (
            np.column_stack([np.interp(rows, np.arange(len(self.tcp)), of[:, c]) for c in range(3)])
            for of in (self.offset, self.tilt)
        )
        position = np.column_stack(
            [np.interp(np.arange(len(self.toolpath)), self.corners[0], self.corners[1][:, c]) for c in range(3)]
        )
        cuts = Cuts(
            toolpath=self.toolpath,
            position=position,
            corners=self.corners,
            wanted=self.wanted,
            corner=o.path_tolerance,
            axis_corner=o.axis_tolerance,
            approach_feed=o.approach_feed,
            offset=offset,
            tilt=tilt,
            line=polyline(self.motion, self.tcp, self.motion.q, path) if said.streamed and on_samples else None,
        )
        checks += against_cam(said, cuts, index_at(self.motion, at, self.toolpath))
        checks += self._terms(name, parsed, said, controller, rows)
        if posted.post is None:
            checks.append(
                of_file(name, "wording", None, np.nan, 0.0, "", "not checked: the post's template is not at hand")
            )
        else:
            job = Rewritten(
                cell=self.cell,
                toolpath=self.toolpath,
                out=self.out,
                options=self.options,
                tolerance=self.tolerance,
                source=self.source,
            )
            external = self._external(said, rows)
            q = self._joints_of(said, self._joints_at(said, rows), external, load_robot(self.cell).drawn)
            checks += job.checks(posted.files, posted.post, parsed, said, controller, q, external)
        return Compared(posted, len(said), tuple(checks), information=(read,))

    def _in_cell_terms(self, name: str, parsed: ParsedProgram, controller: Controller) -> ReadProgram:
        """Joints of the URDF; poses of joint targets by forward kinematics."""
        m = controller.joint_map
        mapped = m is not None and parsed.dialect not in URDF_JOINTS
        axes = parsed.axes_deg
        q = urdf_joints(axes, m.sign, m.offset_deg, m.coupling) if mapped and m is not None else np.radians(axes)
        external, _ = external_of(parsed, self.cell, self.arm, controller)
        T = parsed.T_base_tcp.copy()
        joint = ~parsed.has_pose & np.isfinite(q).all(axis=1)
        driven, wanted = np.hstack([q, external]), np.hstack([self.motion.q, self.motion.external])
        if len(q) == len(self.motion.q):  # streamed: the motion's own samples have been placed already
            same = joint & (np.abs(driven - wanted).max(axis=1) < SAME)
            T[same], joint = self.tcp[same], joint & ~same
        if joint.any():
            # where external axes are missing is told elsewhere; home lets the rest be looked at
            stood = np.where(np.isfinite(external), external, self.cell.external_home)
            T[joint] = self.arm.tcp_in_workpiece(q[joint], stood[joint])
        pulses = controller.pulses_per_deg
        coarse = (
            float(np.radians(PULSES / np.abs(pulses).min())) if pulses is not None and parsed.dialect == "jbi" else 0.0
        )
        steps = np.array([float(c["step_s"]) if "step_s" in c else np.nan for c in parsed.configuration])  # type: ignore[arg-type]
        streamed = bool(np.isfinite(steps).any() or np.isfinite(parsed.time).any())
        time = (
            parsed.time
            if np.isfinite(parsed.time).any()
            else np.where(np.isfinite(steps), np.cumsum(np.nan_to_num(steps)), np.nan)
        )
        labels = [*parsed.operations, ""]
        return ReadProgram(
            file=name,
            kind=parsed.kind,
            q=q,
            external=external,
            T_workpiece_tcp=T,
            feed=parsed.feed,
            move=parsed.move,
            operation=tuple(labels[k] for k in parsed.operation.tolist()),
            events=parsed.events,
            line=parsed.line,
            time=time,
            streamed=streamed,
            feed_step=COARSE if parsed.dialect in ("fanuc", "jbi") else 1e-6,
            place_step=self.tolerance.position if streamed else coarse * REACH,
            joint_step=coarse * 6.0,
            target_step=0.0 if streamed else target_step(parsed, REACH),
        )

    def _terms(
        self, name: str, parsed: ParsedProgram, said: ReadProgram, controller: Controller, rows: Array
    ) -> list[Check]:
        """Frames, configuration and words that nobody understood."""
        given = frame_given(parsed, self.cell, self.arm, controller, self.motion.external[0])
        coupled = parsed.dialect in COUPLED and bool(self.arm.moved_by(self.arm.part))
        wrong = wrong_frames(parsed, controller, given, self.cell.tool.T_flange_tcp, rides=coupled)
        _, spare = external_of(parsed, self.cell, self.arm, controller)
        wrong += [f"{spare} values of external axes that the cell has not"] if spare else []
        checks = [
            of_file(
                name, "tool and base", not wrong, float(len(wrong)), 0.0, "frames", "; ".join(wrong) or "the cell's"
            )
        ]
        robot = load_robot(self.cell).drawn
        q = self._joints_of(said, self._joints_at(said, rows), self._external(said, rows), robot)
        standing = posture_of(robot, q, controller)
        told, first = first_difference(
            parsed.dialect, parsed.configuration, controller_axes(q, controller), standing, controller.nonflip_j5
        )
        if told:
            where = "" if first is None else f"move {first + 1}, line {int(parsed.line[first])} names another one"
            checks.append(
                of_file(
                    name,
                    Promise.CONFIGURATION,
                    first is None,
                    float(first is not None),
                    0.0,
                    "moves",
                    where or "of all moves as their joints are",
                )
            )
        own = set(re.findall(r"\w+", " ".join(controller.lines.values())))  # of the cell: nobody here knows its words
        strange = [w.word for w in parsed.ignored if not w.understood and own.isdisjoint(re.findall(r"\w+", w.word))]
        strange += [w for w in parsed.warnings if "cut off" in w]
        both = np.flatnonzero(parsed.has_pose & np.isfinite(said.q).all(axis=1))
        if len(both):  # tables say the same thing twice
            T = self.arm.tcp_in_workpiece(said.q[both], self._external(said, rows)[both])
            gap = np.linalg.norm(T[:, :3, 3] - said.T_workpiece_tcp[both, :3, 3], axis=1)
            gap = np.maximum(gap, np.linalg.norm(T[:, :3, :3] - said.T_workpiece_tcp[both, :3, :3], axis=(1, 2)))
            n = int(np.argmax(gap))
            checks.append(
                of_file(
                    name,
                    "poses as the joints",
                    bool(gap[n] <= TWICE),
                    1e3 * float(gap[n]),
                    1e3 * TWICE,
                    "mm",
                    f"move {both[n] + 1}, line {int(parsed.line[both[n]])}",
                )
            )
        checks.append(
            of_file(
                name,
                "every word understood",
                not strange,
                float(len(strange)),
                0.0,
                "words",
                ", ".join(strange[:4]) or "all",
            )
        )
        return checks

    def _joints_at(self, said: ReadProgram, rows: Array) -> Array:
        """(M,) rad: joints of the motion where each move ends."""
        s = np.arange(len(self.motion.q))
        return np.column_stack([np.interp(rows, s, self.motion.q[:, k]) for k in range(6)])

    def _external(self, said: ReadProgram, rows: Array) -> Array:
        """(M, E) rad or m as the program says, those of the motion where it does not."""
        s = np.arange(len(self.motion.q))
        columns = [np.interp(rows, s, e) for e in self.motion.external.T]
        driven = np.array(columns).T.reshape(len(said), -1)
        return np.where(np.isfinite(said.external), said.external, driven)

    def _joints_of(self, said: ReadProgram, near: Array, external: Array, robot: Robot) -> Array:
        """(M, 6) rad: joints of each target itself, those of the motion (``near``) where none are close to them.

        The motion rounds what the program says at its targets; an axis may stand on the other side of zero there.
        """
        wanted = self.arm.T_base_workpiece(external) @ said.T_workpiece_tcp
        out = near.copy()
        for first in range(0, len(near), ROWS):
            some = slice(first, first + ROWS)
            q, error = refine(robot, wanted[some], near[some], self.cell.tool.T_flange_tcp, STEPS)
            good = (error < CLOSED) & (np.abs(q - near[some]).max(axis=1) < np.radians(BESIDE_DEG))
            out[some][good] = q[good]
        return out


def _unread(file: str) -> Check:
    return of_file(
        file,
        Promise.COMPARED,
        None,
        float("nan"),
        0.0,
        "",
        "NOT CHECKED: the program is in a language that no reader here knows",
    )


def _controller(cell: Cell, posted: Posted) -> tuple[Controller, bool]:
    """The cell's controller as the post took it, and whether the post is a user's own."""
    if posted.post is None:
        return cell.controller, True
    return controller_for(cell, posted.post), isinstance(posted.post, Path)
