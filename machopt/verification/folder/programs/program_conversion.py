"""Conversion of a robot program that was read back to joints and poses of the cell."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import RobotController
from machopt.numerics.array_types import Array
from machopt.programs.checking.printed_precision import compute_target_step
from machopt.programs.maker_registry import find_language
from machopt.programs.program_reader import ParsedProgram
from machopt.programs.reading.joint_conversion import compute_urdf_joints
from machopt.verification.folder.programs.frames_and_axes import convert_external_joints
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.tables.exported_tables import ExportedMotion

ENCODER_TOLERANCE_PULSES = 3.0  # of an encoder: joints may be off by that much, by rounding and by coupling
REACH_M = 5.0  # m: what a joint's last digit is worth there
JOINT_TOLERANCE_RAD = 1e-8  # rad: places ten metres away by a tenth of a micrometre


def convert_to_cell_frames(
    name: str,
    parsed: ParsedProgram,
    cell: Cell,
    controller: RobotController,
    arm: UrdfKinematics,
    motion: ExportedMotion,
    tcp: Array,
    position_tolerance: float,
) -> ProgramInCell:
    """Convert a program to joints of the URDF, and to poses of joint targets by forward kinematics.

    Args:
        name: File of the program in the folder.
        parsed: The program as it was read.
        cell: The robot cell.
        controller: Controller that the program is for.
        arm: Kinematics of the cell as the controller reckons.
        motion: The planned motion.
        tcp: (S, 3, 4) pose of the TCP in the workpiece at its samples, m.
        position_tolerance: m, between the controller's lines and the motion.
    """
    m = controller.joint_map
    mapped = m is not None and not find_language(parsed.dialect).uses_urdf_joints
    axes = parsed.axes_deg
    q = compute_urdf_joints(axes, m.sign, m.offset_deg, m.coupling) if mapped and m is not None else np.radians(axes)
    external, _ = convert_external_joints(parsed, cell, arm, controller)
    T = _place_targets(parsed, q, external, cell, arm, motion, tcp)
    pulses = controller.pulses_per_deg
    coarse = (
        float(np.radians(ENCODER_TOLERANCE_PULSES / np.abs(pulses).min()))
        if pulses is not None and find_language(parsed.dialect).reads_pulses
        else 0.0
    )
    time, streamed = _find_times(parsed)
    labels = [*parsed.operations, ""]
    return ProgramInCell(
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
        is_streamed=streamed,
        feed_step=find_language(parsed.dialect).feed_step,
        place_step=position_tolerance if streamed else coarse * REACH_M,
        joint_step=coarse * 6.0,
        target_step=0.0 if streamed else compute_target_step(parsed, REACH_M),
    )


def _place_targets(
    parsed: ParsedProgram,
    q: Array,
    external: Array,
    cell: Cell,
    arm: UrdfKinematics,
    motion: ExportedMotion,
    tcp: Array,
) -> Array:
    """Return the (M, 4, 4) pose of each target in the workpiece; those of joint targets by forward kinematics."""
    T = parsed.T_base_tcp.copy()
    joint = ~parsed.has_pose & np.isfinite(q).all(axis=1)
    driven, wanted = np.hstack([q, external]), motion.joints
    if len(q) == len(motion.q):  # streamed: the motion's own samples have been placed already
        same = joint & (np.abs(driven - wanted).max(axis=1) < JOINT_TOLERANCE_RAD)
        T[same, :3], T[same, 3], joint = tcp[same, :3], np.array([0.0, 0.0, 0.0, 1.0]), joint & ~same
    if joint.any():
        # missing external axes are reported elsewhere; home allows the other checks
        external_values = np.where(np.isfinite(external), external, cell.external_home)
        T[joint] = arm.compute_tcp_in_workpiece(q[joint], external_values[joint])
    return T


def _find_times(parsed: ParsedProgram) -> tuple[Array, bool]:
    """Return the (M,) times that the program states in s, NaN where it states none, and whether it states any."""
    steps = np.array([float(c["step_s"]) if "step_s" in c else np.nan for c in parsed.configuration])  # type: ignore[arg-type]
    streamed = bool(np.isfinite(steps).any() or np.isfinite(parsed.time).any())
    time = (
        parsed.time
        if np.isfinite(parsed.time).any()
        else np.where(np.isfinite(steps), np.cumsum(np.nan_to_num(steps)), np.nan)
    )
    return time, streamed
