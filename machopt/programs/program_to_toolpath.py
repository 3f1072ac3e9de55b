"""Conversion of a parsed robot program to a toolpath for planning: tip, tool axis, feed, operations and events."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.robot_program import RobotController
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.file_formats.source_file import TOOL_AXES, ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.path_building.point_collector import PathBuilder
from machopt.programs.maker_registry import find_language
from machopt.programs.reading.joint_conversion import compute_urdf_joints
from machopt.programs.reading.parsed_program import LINEAR, ParsedProgram
from machopt.programs.reading.rotation_conventions import invert_pose

SAME_PLACE = 1e-4  # m; frames farther apart are reported


@dataclass(frozen=True)
class ProgramRobot:
    """The robot a program was written for: gives joint targets their places."""

    fk: Callable[[Array, Array], Array]  # q (M, 6) rad and the tool in the flange (4, 4) → (M, 4, 4) in base_link
    controller: RobotController
    T_flange_tcp: Array  # (4, 4) of the cell, where the program does not give its tool
    T_base_workpiece: Array  # (4, 4)

    def poses(self, program: ParsedProgram, rows: NDArray[np.intp]) -> Array:
        """Compute the TCP poses of targets, with the tool frame of the program where it gives one.

        Args:
            program: The parsed program.
            rows: Indices (M,) of the targets.

        Returns:
            Poses (M, 4, 4) in base_link, m.
        """
        c, axes = self.controller, program.axes_deg[rows]
        own = find_language(program.dialect).uses_urdf_joints
        m = None if own else c.joint_map
        q = np.radians(axes) if m is None else compute_urdf_joints(axes, m.sign, m.offset_deg, m.coupling)
        T = np.empty((len(rows), 4, 4))
        for number in np.unique(program.tool[rows]).tolist():
            mine = program.tool[rows] == number
            tool = program.tools[number].T
            if tool is not None and c.T_flange_mount is not None and not own:
                tool = c.T_flange_mount @ tool
            T[mine] = self.fk(q[mine], self.T_flange_tcp if tool is None else tool)
        return T

    def frame(self, T_root_frame: Array, dialect: str) -> Array:
        """Convert a frame from the controller's robot coordinate system.

        Args:
            T_root_frame: Frame (4, 4) in the controller's robot coordinate system, m.
            dialect: Language of the program.

        Returns:
            Frame (4, 4) in base_link, m.
        """
        root = self.controller.T_base_root
        return T_root_frame if root is None or find_language(dialect).uses_urdf_joints else root @ T_root_frame


def convert_to_toolpath(
    program: ParsedProgram, source: SourceFile, options: ReadOptions, robot: ProgramRobot | None = None
) -> Toolpath:
    """Points of the tool tip in the program's first base frame.

    Joint targets have no place without the robot: with ``robot`` they get one, without they are left out and counted.
    Where a program has joint targets only, its points are in the cell's workpiece frame.

    Args:
        program: as read.
        source: the file, for messages and its hash.
        options: default feed, strictness, the direction of the tool frame that points to the shank.
        robot: what the cell says of the robot.

    Raises:
        InputError: no linear move, frames that only the controller knows change, a cut without a feed.
    """
    column, sign = TOOL_AXES[options.tool_axis]
    if options.unit not in (None, "mm"):
        raise source.build_error(f"robot programs are in mm (URScript in m), but --unit {options.unit} was given")
    out = PathBuilder(source=source, options=options, format=f"robot/{program.dialect}")
    out.used_options.add("--tool-axis")
    T, known = _transform_to_first_base(program, source, out)
    base = program.bases[int(program.base[known][0])].name if known.any() else ""
    rows = np.flatnonzero(~known & np.isfinite(program.axes_deg).all(axis=1))
    if robot is not None and len(rows):
        T[rows] = invert_pose(_find_base(program, robot, known, out)) @ robot.poses(program, rows)
        base = base or "the cell's workpiece"
        known[rows] = True
    if not (known & (program.move == MoveKind.CUT)).any():
        raise source.build_error(_describe_missing_cut(program, known, robot))
    _add_moves(program, source, out, T, known, sign * T[:, :3, column])
    for word in program.ignored:
        for _ in range(word.count):
            out.ignore(word.word, word.first_line, understood=word.understood, stops=word.stops)
    out.warnings.extend(w for w in program.warnings if not w.startswith("not understood"))
    _warn_upside_down(out, sign * T[known & (program.move == MoveKind.CUT), 2, column], options.tool_axis)
    out.meta |= {
        "unit": "mm",
        "program": program.name,
        "tool_axis": f"{options.tool_axis} of the tool frame",
        "base": base,
    }
    return out.build(reference=T[known][:, :3, 0 if column != 0 else 1])


def _add_moves(
    program: ParsedProgram, source: SourceFile, out: PathBuilder, T: Array, known: NDArray[np.bool_], axis: Array
) -> None:
    """Add every move with a known place, with the events before it."""
    events = sorted(program.events, key=lambda e: e.index)  # stable: in order at one move
    operation, passed_events = -2, 0
    away = 0  # line of a joint move without a place that came after the last point, 0 where there is none
    for k in range(len(program)):
        while passed_events < len(events) and events[passed_events].index <= k:
            out.event(events[passed_events].kind, events[passed_events].text, events[passed_events].value)
            passed_events += 1
        line = int(program.line[k])
        if not known[k] and program.kind[k] == LINEAR and program.move[k] == MoveKind.CUT:
            raise source.build_error(
                "a linear move to joint positions, whose place is not known without the robot: with a cell it is "
                "(optimize has one, inspect takes one with --cell); or post it with a Cartesian target",
                line,
            )
        if not known[k]:
            out.ignore("joint move (no place without the robot)", line, understood=True)
            away = line if len(out) else 0
            continue
        if program.operation[k] != operation:
            operation = int(program.operation[k])
            if operation >= 0:
                out.begin_operation(program.operations[operation])
        x, y, z = (T[k, :3, 3] * 1e3).tolist()
        i, j, c = axis[k].tolist()
        move, feed = int(program.move[k]), float(program.feed[k]) * 6e4
        if away and move != MoveKind.RAPID:
            out.warn_once(
                f"a linear move follows joint moves without a known place (line {away}): its start is not known, so "
                "the way to its end is taken as a rapid one; with a cell (inspect --cell) its start is known",
                line,
            )
            move, feed = int(MoveKind.RAPID), math.nan
        away = 0
        out.add((x, y, z), (i, j, c), move, feed, line)
    for event in events[passed_events:]:
        out.event(event.kind, event.text, event.value)


def _transform_to_first_base(
    program: ParsedProgram, source: SourceFile, out: PathBuilder
) -> tuple[Array, NDArray[np.bool_]]:
    """Poses in the base of the first one, and which moves have one."""
    T = program.T_base_tcp.copy()
    known = program.has_pose.copy()
    used = list(dict.fromkeys(program.base[known].tolist()))
    if len(used) > 1:
        first = program.bases[used[0]]
        for k in used[1:]:
            other = program.bases[k]
            rows = known & (program.base == k)
            if first.T is None or other.T is None:
                unknown = first.name if first.T is None else other.name
                names = ", ".join(program.bases[b].name for b in used[:4])
                raise source.build_error(
                    f"moves in {len(used)} base frames ({names}), but only the controller knows where {unknown} is; "
                    "post it in one frame",
                    int(program.line[rows][0]),
                )
            T[rows] = invert_pose(first.T) @ other.T @ T[rows]
        out.warn(f"points of {len(used)} base frames were brought into {first.name}")
    tools = set(program.tool[known].tolist())
    if len(tools) > 1:
        names = ", ".join(program.tools[t].name for t in sorted(tools)[:4])
        out.warn(f"the program uses {len(tools)} tools ({names}); their tips make one toolpath")
    for column in program.external[known].T:
        moving = column[np.isfinite(column)]
        if len(moving) and float(np.ptp(moving)) > 1e-6:
            out.warn_once("external axes move: the points are taken in the frame the program gives them in")
    return T, known


def _find_base(program: ParsedProgram, robot: ProgramRobot, known: NDArray[np.bool_], out: PathBuilder) -> Array:
    """(4, 4) in base_link: the frame that the points are given in."""
    if not known.any():
        return robot.T_base_workpiece
    frame = program.bases[int(program.base[known][0])]
    if frame.T is None:
        out.warn(
            f"the program names its base {frame.name} without numbers: joint targets are placed as if it were the "
            "cell's workpiece"
        )
        return robot.T_base_workpiece
    T = robot.frame(frame.T, program.dialect)
    apart = float(np.linalg.norm(T[:3, 3] - robot.T_base_workpiece[:3, 3]))
    if apart > SAME_PLACE:
        out.warn(
            f"the program's base {frame.name} lies {1e3 * apart:.1f} mm from the cell's workpiece; the points keep "
            "their numbers, so the job moves with the workpiece"
        )
    return T


def _warn_upside_down(out: PathBuilder, up: Array, tool_axis: str) -> None:
    """A shank below every point of a cut is more often a tool frame that looks the other way."""
    if len(up) and float(up.max()) < -0.7:
        other = ("-" if tool_axis[0] == "+" else "+") + tool_axis[1]
        out.warn(
            f"the tool comes from below throughout: if the tool frame's {other} axis points to the shank, give "
            f"--tool-axis={other}"
        )


def _describe_missing_cut(program: ParsedProgram, known: NDArray[np.bool_], robot: ProgramRobot | None) -> str:
    linear = int((program.move == MoveKind.CUT).sum())
    if not linear:
        return f"holds {len(program)} joint moves and no linear one: there is no path to plan anew"
    if np.isnan(program.axes_deg).all() and find_language(program.dialect).reads_pulses:
        return (
            f"holds {linear} linear moves to positions in encoder pulses; a cell with controller.pulses_per_deg would "
            "tell their angles"
        )
    wanted = "a program with Cartesian targets would work" + (
        ", or a cell: optimize has one, inspect takes one with --cell" if robot is None else ""
    )
    return f"holds {linear} linear moves, but all of them to joint positions without a known place; {wanted}"
