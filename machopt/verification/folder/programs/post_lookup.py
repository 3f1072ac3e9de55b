"""Posts by label, and what follows from a post without a plan: tolerance, assumptions, unsupported events."""

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
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.output.file_hashes import compute_sha256
from machopt.planning.motion.motion_segment import BEND
from machopt.planning.retiming.path_curve import SPIN_TOLERANCE
from machopt.programs.program_writer import list_assumptions, list_unstarted_events, load_post
from machopt.programs.writing.post_file import ALIASES, list_post_names
from machopt.programs.writing.target_insertion import ProgramTolerance

DEFAULT_TOLERANCE_MM = 0.05


def build_tolerance(mm: float | None, options: PlanOptions) -> ProgramTolerance:
    """Return the tolerance between the controller's straight lines and the motion.

    The angular tolerances leave room for the smoothing of the motion at corners of the path.

    Args:
        mm: Position tolerance, mm; None takes 0.05 mm.
        options: The planning options in force.

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
    """Return the post with a label: a shipped one, the cell's own, or the folder's copy of a template; None if there
    is none.

    Args:
        label: Label of the post in the manifest.
        folder: The output folder.
        cell: The robot cell.
        manifest: The manifest of the folder; None where it cannot be read.
    """
    if label in list_post_names() or label in ALIASES:
        return label
    own = cell.controller.post
    if own is not None and Path(own).name == label and Path(own).is_file():
        return Path(own)
    copy = folder / label
    recorded = {f.sha256 for f in (() if manifest is None else manifest.inputs_of("post"))}
    return copy if copy.is_file() and compute_sha256(copy) in recorded else None


def list_post_assumptions(cell: Cell, toolpath: Toolpath, post: str | Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what a program of this post assumes, and the events that it does not carry out.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        post: Name of a shipped post, or the path of a template file.
    """
    controller = select_controller(cell, post)
    program = replace(build_short_program(cell, load_robot(cell), controller), events=toolpath.events)
    return list_assumptions(program, post, controller), list_unstarted_events(post, program, controller)


def build_short_program(cell: Cell, robot: Robot, controller: RobotController) -> RobotProgram:
    """Return a program of three moves at home.

    Args:
        cell: The robot cell.
        robot: The kinematic model of the robot.
        controller: The robot controller.
    """
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
    """Return the external joints of a cell as posts need them.

    Args:
        cell: The robot cell.
    """
    if not cell.external_joints:
        return ()
    machine = load_machine(cell, load_robot(cell))
    part = {int(c) - 6 for c, sign in zip(machine.column, machine.sign, strict=True) if sign < 0 and c >= 6}
    return tuple(
        ExternalProgramAxis(name, slides, k in part)
        for k, (name, slides) in enumerate(zip(cell.external_joints, cell.external_prismatic, strict=True))
    )


def get_workpiece_on_positioner(cell: Cell) -> Array | None:
    """Return the (4, 4) workpiece pose in the positioner's link, else in world; None without external joints.

    Args:
        cell: The robot cell.
    """
    axes = list_external_axes(cell)
    if not axes:
        return None
    if any(axis.carries_part for axis in axes):
        return cell.workpiece.T_link_workpiece
    return np.asarray(load_machine(cell, load_robot(cell)).compute_T_world_workpiece(cell.external_home[None])[0])


def compute_workpiece_in_base(cell: Cell, external: Array) -> Array:
    """Return the (4, 4) workpiece pose in base_link.

    Args:
        cell: The robot cell.
        external: (E,) positions of the external joints, rad or m.
    """
    return np.asarray(load_machine(cell, load_robot(cell)).compute_T_base_workpiece(external[None])[0])


def select_controller(cell: Cell, post: str | Path) -> RobotController:
    """Return the cell's controller, without its own event lines where the post writes another language.

    Args:
        cell: The robot cell.
        post: Name of a shipped post, or the path of a template file.
    """
    named = cell.controller.post
    own = None if named is None else load_post(named).keys.dialect
    return cell.controller if own == load_post(post).keys.dialect else replace(cell.controller, lines={})


def select_listed_controller(cell: Cell, post: str | Path | None) -> tuple[RobotController, bool]:
    """Return the cell's controller as the post of a listed program took it, and whether the post is a user's own.

    Args:
        cell: The robot cell.
        post: Name of the post or its template file; None where the template is not known.
    """
    if post is None:
        return cell.controller, True
    return select_controller(cell, post), isinstance(post, Path)
