"""A program's frames, axes and places in the cell's terms."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.domain.program import Controller
from machopt.formats.programs import ParsedProgram
from machopt.formats.programs.toolpath import URDF_JOINTS
from machopt.verify.table import Motion

FRAME = 1e-6  # m: frames are printed to 1e-3 mm at least
FRAME_ANGLE = float(np.radians(2e-3))


def index_at(motion: Motion, at: Array) -> Array:
    """(M,) toolpath index where each move ends; NaN where it is not known."""
    rows = np.clip(np.nan_to_num(at), 0, len(motion.point) - 1)
    low = np.floor(rows).astype(int)
    high = np.minimum(low + 1, len(motion.point) - 1)
    share = rows - low
    near = np.where(share < 0.5, motion.point[low], motion.point[high])  # beside the ends of what has an index
    value = (1.0 - share) * motion.point[low] + share * motion.point[high]
    value = np.where(np.isfinite(value), value, near)
    return np.where(np.isfinite(at), value, np.nan)


def wrong_frames(
    parsed: ParsedProgram, controller: Controller, T_base_workpiece: Array, T_flange_tcp: Array
) -> list[str]:
    """Tool and base, where the program gives their numbers."""
    own = parsed.dialect in URDF_JOINTS  # of the URDF, whatever the cell says of its controller
    root = np.eye(4) if own or controller.T_base_root is None else controller.T_base_root
    mount = np.eye(4) if own or controller.T_flange_mount is None else controller.T_flange_mount
    pose, wrong = parsed.has_pose, []
    for frames, T, name in (
        ([parsed.bases[k] for k in np.unique(parsed.base[pose])], np.linalg.inv(root) @ T_base_workpiece, "base"),
        ([parsed.tools[k] for k in np.unique(parsed.tool)], np.linalg.inv(mount) @ T_flange_tcp, "tool"),
    ):
        wrong += [f"{len(frames)} {name} frames"] if len(frames) > 1 else []
        for frame in frames:
            if frame.T is None:
                continue
            gap = float(np.linalg.norm(frame.T[:3, 3] - T[:3, 3]))
            chord = float(np.linalg.norm(frame.T[:3, :3] - T[:3, :3]) / np.sqrt(2.0))  # the angle where it is small
            if not (gap <= FRAME and chord <= FRAME_ANGLE):
                wrong.append(f"the {name} frame {frame.name} lies {1e3 * gap:.3f} mm, {np.degrees(chord):.3f} deg off")
    return wrong


def controller_axes(q: Array, controller: Controller) -> Array:
    """(M, 6) deg as the controller counts them: C (sign · q + offset), added up here axis by axis."""
    m = controller.joint_map
    degrees = np.degrees(q)
    if m is None:
        return np.asarray(degrees)
    plain = np.column_stack([m.sign[k] * degrees[:, k] + m.offset_deg[k] for k in range(6)])
    out = plain.copy()
    for k, j in zip(*np.nonzero(m.coupling), strict=True):
        out[:, k] += m.coupling[k, j] * plain[:, j]
    return out
