"""A part is rotated back under the tool before an arm joint reaches its limit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from external_axis_cells import external_cell
from small_cell import pose, urdf_text
from test_planning_path import Rows, toolpath

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions, ProcessForce
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan

K = ArmStiffness(joints=np.array([1.4e6, 1.2e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5]))
SKEW = "".join(
    f'<link name="{link}"/><joint name="{joint}" type="revolute"><parent link="{on}"/><child link="{link}"/>'
    f'<origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/><limit lower="-6" upper="6" velocity="3" effort="1"/></joint>'
    for joint, on, link, at, rpy, axis in (
        ("tilt", "base_link", "arm", "1.7 0.2 0.35", "0.1 -0.2 0.3", "0.573576 0.2 0.794"),
        ("turn", "arm", "plate", "0 0.05 0.1", "0.3 0 0", "0.1 -0.3 0.95"),
    )
)


def build_dressed_positioner(folder: Path) -> Cell:
    """Return a positioner with two skew axes; hoses limit joints 4 and 6 to about one turn."""
    cell = replace(external_cell(folder, table=True, tilt=True), stiffness=K)
    cell.urdf.write_text(urdf_text().replace("</robot>", SKEW + "</robot>"))
    low, high = cell.limits.lower.copy(), cell.limits.upper.copy()
    low[6:], high[6:] = (-2.5, -6.0), (2.5, 6.0)
    high[[3, 5]] = np.radians(182.0)
    low[[3, 5]] = -high[[3, 5]]
    part = replace(cell.workpiece, T_link_workpiece=pose(0.01, 0.02, 0.025), geometry=())
    return replace(cell, limits=replace(cell.limits, lower=low, upper=high), workpiece=part)


def test_part_is_rotated_back_before_a_joint_reaches_its_limit(tmp_path: Path) -> None:
    """One revolution around a cone with the tool perpendicular to it. Whole turns of joint 4 were ignored, so that
    it could not continue at 182°."""
    around = np.linspace(0.0, 2.0 * np.pi, 40)
    away = np.column_stack([np.cos(0.4) * np.cos(around), np.cos(0.4) * np.sin(around), np.full(40, np.sin(0.4))])
    at = np.column_stack([0.1 * np.cos(around), 0.1 * np.sin(around), np.full(40, 0.15)])
    rows: Rows = [(tuple(at[0] + 0.06 * away[0]), tuple(away[0]), MoveKind.RAPID)]
    rows += [(tuple(p), tuple(a), MoveKind.CUT) for p, a in zip(at, away, strict=True)]
    force = ProcessForce(normal=80.0, axial=50.0)
    options = PlanOptions(rotation_step=np.radians(15.0), force=force, collision=False)
    found = find_best_plan(build_dressed_positioner(tmp_path), toolpath(rows), options)
    assert not len(found.missing)
    assert not found.breaks
