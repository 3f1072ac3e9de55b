"""3-D scene of a sample result: the arm of the small cell on a path over its block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sample_report_data import full_result

from machopt.data_types.cell import Cell
from machopt.data_types.process_columns import OUTCOMES
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_chain
from machopt.report.page_data.machine_scene import build_bodies, build_machine_scene
from machopt.report.page_types.optimize_page_data import ReportData
from machopt.report.scene.scene_types import MotionScene, OptimizeScene, StationPostures, ToolpathScene

POSTURE = np.radians([10, -80, 110, 20, 60, 30])


def build_report_with_motion_scene(
    cell: Cell, points: int = 60, rotations: int = 72, samples: int = 400
) -> tuple[ReportData, Robot]:
    """Return a full result with a scene: axis 1 follows the path and axis 6 the rotation; unreachable map cells have
    no posture."""
    robot, shapes = load_chain(cell)
    data = full_result(points, rotations, samples)
    m, p, motion = data.map, data.path, data.motion
    assert m is not None
    assert p is not None
    assert motion is not None
    u = np.linspace(0, 1, points)
    q = np.broadcast_to(POSTURE, (points, rotations, 6)).copy()
    q[..., 0] += 0.4 * u[:, None]
    q[..., 5] += m.rotation
    chosen = q[:, 0].copy()
    chosen[:, 5] = POSTURE[5] + m.chosen
    q[m.status == 1] = np.nan
    more = len(cell.external_joints)
    still = [(0, 0)] * 2 + [(0, more)]
    at = np.interp(motion.s, p.s, np.arange(points), left=np.nan, right=np.nan)
    line = np.column_stack([0.3 * u - 0.15, 0.2 * np.sin(6 * u), 0 * u])
    view = OptimizeScene(
        scene=build_machine_scene(cell, robot, build_bodies(cell, robot, shapes)),
        path=ToolpathScene(
            position=line,
            point=np.arange(points, dtype=float),
            cutting=u > 0.05,
            value=1e3 * p.deflection,
            label="deflection (mm)",
            large_is_good=False,
            outcome=(1 + np.arange(points) % len(OUTCOMES)).astype(np.uint8),
            p_in=np.full(points, 0.61),
            cause=("joint:2 0.72",) * points,
        ),
        stations=StationPostures(
            q=np.pad(q, still),
            chosen=np.pad(chosen, still[1:]),
            k=np.full((points, 6), 1e6),
            force=np.tile([100.0, 0.0, 50.0], (points, 1)),
            bend=np.tile([1e-4, 2e-5, 0.0], (points, 1)),
            compliance=np.tile([1e-6, 2e-6, 5e-7, 1e-7, 0.0, 0.0], (points, 1)),
            clearance=p.clearance,
            nearest=p.nearest_pair,
            singularity=p.singularity,
        ),
        motion=MotionScene(
            time=motion.time,
            q=np.pad(POSTURE + 0.1 * motion.q, still[1:]),
            point=at,
            s=motion.s,
            phi=np.interp(at, np.arange(points), m.chosen),
            gamma=np.interp(at, np.arange(points), m.chosen) + 0.2,
        ),
    )
    return replace(data, view=view, worst=tuple(replace(w, point=w.point % points) for w in data.worst)), robot
