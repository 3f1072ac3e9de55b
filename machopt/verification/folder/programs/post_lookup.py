"""Posts by their label, and what follows from a post without any plan: its tolerance, what it takes for granted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.manifest import FolderManifest
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.robot_program import LIN, PTP, ExternalProgramAxis, RobotController, RobotProgram
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import OptionError
from machopt.kinematics.controller_posture import compute_controller_posture
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import Robot, load_robot
from machopt.numerics.array_types import Array
from machopt.output.file_hashes import compute_sha256
from machopt.planning.motion.segments import BEND
from machopt.planning.retiming.path_curve import SPIN_TOLERANCE
from machopt.programs.program_writer import list_assumptions, list_unstarted_events, load_post
from machopt.programs.writing.post_file import ALIASES, list_post_names
from machopt.programs.writing.target_insertion import ProgramTolerance

DEFAULT_TOLERANCE_MM = 0.05


def build_tolerance(mm: float | None, options: PlanOptions) -> ProgramTolerance:
    """The tolerance between the controller's lines and the motion; None takes 0.05 mm.

    The angles leave room for what the motion itself smooths at the corners of the path.

    Raises:
        InputError: it is below the rounding of corners, which no program of straight lines can follow.
    """
    least = options.path_tolerance * 1e3
    if mm is None:
        mm = max(DEFAULT_TOLERANCE_MM, 2.0 * least)
    if not (np.isfinite(mm) and mm > least):
        raise OptionError(
            f"{mm:g} mm; more than path_tolerance_mm = {least:g} would work: by that much the motion rounds corners, "
            "and the program's points are the corners",
            where="--program-tolerance-mm",
        )
    return ProgramTolerance(
        position=mm * 1e-3,
        axis=max(ProgramTolerance.axis, 1.5 * options.axis_tolerance),
        turn=max(ProgramTolerance.turn, 2.0 * SPIN_TOLERANCE + BEND + options.axis_tolerance),
    )


def find_post(label: str, folder: Path, cell: Cell, manifest: FolderManifest | None) -> str | Path | None:
    """The post of that label: a shipped one's name, the cell's own, the folder's copy of a user's template, or None."""
    if label in list_post_names() or label in ALIASES:
        return label
    own = cell.controller.post
    if own is not None and Path(own).name == label and Path(own).is_file():
        return Path(own)
    copy = folder / label
    recorded = {f.sha256 for f in (() if manifest is None else manifest.inputs_of("post"))}
    return copy if copy.is_file() and compute_sha256(copy) in recorded else None


def list_post_assumptions(cell: Cell, toolpath: Toolpath, post: str | Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What a program of this post takes for granted, and which events it does not carry out; no plan is needed."""
    controller = select_controller(cell, post)
    program = replace(build_short_program(cell, load_robot(cell), controller), events=toolpath.events)
    return list_assumptions(program, post, controller), list_unstarted_events(post, program, controller)


def build_short_program(cell: Cell, robot: Robot, controller: RobotController) -> RobotProgram:
    """Three moves at home."""
    q = np.tile(cell.home, (3, 1))
    standing = compute_controller_posture(robot, q, controller)
    return RobotProgram(
        kind=np.array([PTP, LIN, PTP], np.int8),
        q=q,
        T_workpiece_tcp=robot.nominal_robot.compute_fk(q, cell.tool.T_flange_tcp),
        feed=np.array([np.nan, 0.01, np.nan]),
        cutting=np.array([False, True, False]),
        operation=np.zeros(3, np.int32),
        operations=("cut",),
        T_flange_tcp=cell.tool.T_flange_tcp,
        T_base_workpiece=compute_workpiece_in_base(cell, cell.external_home),
        external=np.tile(cell.external_home, (3, 1)),
        external_axes=list_external_axes(cell),
        T_carrier_workpiece=get_workpiece_on_positioner(cell),
        move=np.array([MoveKind.RAPID, MoveKind.CUT, MoveKind.RAPID], np.int8),
        time=np.arange(3.0),
        joint_names=cell.arm_joints,
        wrist_behind=None if standing is None else standing[0],
        elbow_up=None if standing is None else standing[1],
        tool_mass=cell.tool.mass if cell.tool.mass > 0.0 else float("nan"),
    )


def list_external_axes(cell: Cell) -> tuple[ExternalProgramAxis, ...]:
    """The external joints of a cell as posts take them."""
    if not cell.external_joints:
        return ()
    machine = load_machine(cell, load_robot(cell))
    part = {int(c) - 6 for c, sign in zip(machine.column, machine.sign, strict=True) if sign < 0 and c >= 6}
    return tuple(
        ExternalProgramAxis(name, slides, k in part)
        for k, (name, slides) in enumerate(zip(cell.external_joints, cell.external_prismatic, strict=True))
    )


def get_workpiece_on_positioner(cell: Cell) -> Array | None:
    """(4, 4) the workpiece in the positioner's link, else in world; None where no external joint moves anything."""
    axes = list_external_axes(cell)
    if not axes:
        return None
    if any(axis.carries_part for axis in axes):
        return cell.workpiece.T_link_workpiece
    return np.asarray(load_machine(cell, load_robot(cell)).compute_T_world_workpiece(cell.external_home[None])[0])


def compute_workpiece_in_base(cell: Cell, external: Array) -> Array:
    """(4, 4) the workpiece in base_link with external joints at (E,) rad or m."""
    return np.asarray(load_machine(cell, load_robot(cell)).compute_T_base_workpiece(external[None])[0])


def select_controller(cell: Cell, post: str | Path) -> RobotController:
    """The cell's controller; its own lines for events are in its own language and stay out of other programs."""
    named = cell.controller.post
    own = None if named is None else load_post(named).keys.dialect
    return cell.controller if own == load_post(post).keys.dialect else replace(cell.controller, lines={})
