"""Frames, axes and positions of a robot program, converted to the cell's frames and units."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.robot_program import ExternalAxisMap, RobotController
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.programs.maker_registry import find_language
from machopt.programs.program_reader import ParsedProgram
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.tables.exported_tables import ExportedMotion

AXIS_LEVER_M = 0.1  # m: the way that a turn of the tool axis by a radian counts for
MIN_STEP_M = 1e-9  # m: the same of a step on which nothing moves, so that indices stay apart
FRAME_TOLERANCE_M = 1e-6  # m: frames are printed to 1e-3 mm at least
FRAME_TOLERANCE_RAD = float(np.radians(2e-3))


def compute_toolpath_index(motion: ExportedMotion, at: Array, toolpath: Toolpath) -> Array:
    """Return the (M,) toolpath index where each move of the program ends; NaN where it is not known.

    Between two samples the index is interpolated by path length. Interpolation by time would be wrong where points
    lie close together.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        at: (M,) fractional motion samples at which the moves end.
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    rows = np.clip(np.nan_to_num(at), 0, len(motion.point) - 1)
    low = np.floor(rows).astype(int)
    high = np.minimum(low + 1, len(motion.point) - 1)
    share = rows - low
    near = np.where(share < 0.5, motion.point[low], motion.point[high])  # beside the ends of what has an index
    step = np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)
    step += AXIS_LEVER_M * np.linalg.norm(np.diff(toolpath.axis, axis=0), axis=1) + MIN_STEP_M
    points, way = np.arange(len(toolpath)), np.append(0.0, np.cumsum(step))
    before, behind = (np.interp(motion.point[n], points, way) for n in (low, high))
    value = np.interp((1.0 - share) * before + share * behind, way, points)
    value = np.where(np.isfinite(value), value, near)
    return np.where(np.isfinite(at), value, np.nan)


def convert_external_joints(
    parsed: ParsedProgram, cell: Cell, arm: UrdfKinematics, controller: RobotController
) -> tuple[Array, int]:
    """Convert the program's external axis values to the cell's external joints.

    Args:
        parsed: The program as it was read.
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        controller: The robot controller.

    Returns:
        (M, E) rad or m, NaN where the program gives no value; and the number of values that belong to no joint.
    """
    rides = [
        arm.model.getJointId(name) in arm.list_moving_joints(arm.workpiece_placement) for name in cell.external_joints
    ]
    drives = [controller.external.get(name, ExternalAxisMap()) for name in cell.external_joints]
    numbers = [drive.number or k for k, drive in enumerate(drives, start=1)]
    language = find_language(parsed.dialect)
    order = sorted(range(len(numbers)), key=numbers.__getitem__)
    if language.external_order == "number":
        place = {k: numbers[k] - 1 for k in order}
    elif language.external_order == "cell":
        place = {k: k for k in order}
    else:  # the group that carries the robot, then the one that carries the part
        groups = [k for k in order if not rides[k]] + [k for k in order if rides[k]]
        place = {k: n for n, k in enumerate(order if language.external_order == "ascending" else groups)}
    out = np.full((len(parsed), len(numbers)), np.nan)
    for k, column in place.items():
        if column >= parsed.external.shape[1]:
            continue
        values, scale = parsed.external[:, column], 1e-3 if cell.external_prismatic[k] else np.pi / 180.0
        if language.external_in_si:
            scale = 1.0
        if not language.uses_urdf_joints:
            pulsed = np.array([_is_in_pulses(words.get("external"), column) for words in parsed.configuration])
            values = np.where(pulsed, values / (drives[k].pulses or np.nan), values)
            values = (values - drives[k].offset) * drives[k].sign
        out[:, k] = scale * values
    spare = [c for c in range(parsed.external.shape[1]) if c not in place.values()]
    return out, int(np.isfinite(parsed.external[:, spare]).sum())


def _is_in_pulses(words: object, column: int) -> bool:
    return isinstance(words, tuple) and column < len(words) and words[column] == "pulse"


def compute_workpiece_frame(
    parsed: ParsedProgram, cell: Cell, arm: UrdfKinematics, controller: RobotController, external: Array
) -> Array:
    """Return the (4, 4) workpiece pose in the frame that the controller's base frames refer to.

    A controller that couples rail and positioner uses the positioner's flange, or its WORLD on a rail. Any other uses
    its robot coordinate system.

    Args:
        parsed: The program as it was read.
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        controller: The robot controller.
        external: (E,) positions of the external joints, rad or m.
    """
    language = find_language(parsed.dialect)
    if cell.external_joints and language.couples_frames:
        if arm.list_moving_joints(arm.workpiece_placement):
            return cell.workpiece.T_link_workpiece
        world = arm.compute_placements(np.zeros((1, 6)), external[None])[0, arm.workpiece_placement]
        return world if controller.T_world_root is None else np.asarray(np.linalg.inv(controller.T_world_root) @ world)
    T = arm.T_base_workpiece(external[None])[0]
    if language.uses_urdf_joints or controller.T_base_root is None:
        return np.asarray(T)
    return np.asarray(np.linalg.inv(controller.T_base_root) @ T)


def find_wrong_frames(
    parsed: ParsedProgram, controller: RobotController, T_given_workpiece: Array, T_flange_tcp: Array, *, rides: bool
) -> list[str]:
    """Return the wrong tool and base frames, where the program gives their values.

    Args:
        parsed: The program as it was read.
        controller: The robot controller.
        T_given_workpiece: (4, 4) result of :func:`compute_workpiece_frame`.
        T_flange_tcp: (4, 4) pose of the TCP in the flange.
        rides: A positioner carries the workpiece.
    """
    language = find_language(parsed.dialect)
    mount = np.eye(4) if language.uses_urdf_joints or controller.T_flange_mount is None else controller.T_flange_mount
    pose, wrong = parsed.has_pose, []
    for k in np.unique(parsed.base[pose]) if language.shows_coupling else ():
        frame = parsed.bases[k]
        if bool(frame.rides_on) != rides:
            state = f"moves with {frame.rides_on}" if frame.rides_on else "is at rest"
            wrong.append(f"the base frame {frame.name} {state}, the workpiece {'is carried' if rides else 'is not'}")
    for frames, T, name in (
        ([parsed.bases[k] for k in np.unique(parsed.base[pose])], T_given_workpiece, "base"),
        ([parsed.tools[k] for k in np.unique(parsed.tool)], np.linalg.inv(mount) @ T_flange_tcp, "tool"),
    ):
        wrong += [f"{len(frames)} {name} frames"] if len(frames) > 1 else []
        for frame in frames:
            if frame.T is None:
                continue
            gap = float(np.linalg.norm(frame.T[:3, 3] - T[:3, 3]))
            chord = float(np.linalg.norm(frame.T[:3, :3] - T[:3, :3]) / np.sqrt(2.0))  # the angle where it is small
            if not (gap <= FRAME_TOLERANCE_M and chord <= FRAME_TOLERANCE_RAD):
                wrong.append(f"the {name} frame {frame.name} lies {1e3 * gap:.3f} mm, {np.degrees(chord):.3f} deg off")
    return wrong


def convert_to_controller_axes(q: Array, controller: RobotController) -> Array:
    """Return the (M, 6) axis angles as the controller counts them: C (sign · q + offset), deg.

    Args:
        q: (M, 6) joint positions of the URDF, rad.
        controller: The robot controller.
    """
    m = controller.joint_map
    degrees = np.degrees(q)
    if m is None:
        return np.asarray(degrees)
    plain = np.column_stack([m.sign[k] * degrees[:, k] + m.offset_deg[k] for k in range(6)])
    out = plain.copy()
    for k, j in zip(*np.nonzero(m.coupling), strict=True):
        out[:, k] += m.coupling[k, j] * plain[:, j]
    return out
