"""Points of a milling plan as delay equations, with the modes of the verifier."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from process.delay_reference import DelaySystem

from machopt.cell.cell_reader import load_cell
from machopt.process.binding.operation_matching import attach_process
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.process_force import compute_sideways_directions
from machopt.verification.motion.process.stability import DelayLaw, ModeModel, find_given_arc
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel
from machopt.verification.tables.csv_columns import read_columns


def choose_rows(out: Path, count: int) -> list[tuple[int, float]]:
    """Return points with the smallest, the largest and evenly spaced limits (m) between them."""
    table = read_columns(out / "points.csv")
    known = [(float(a) / 1e3, n) for n, a in enumerate(table["a_lim_mm"]) if a and table["chatter"][n]]
    known.sort()
    return [(known[k][1], known[k][0]) for k in np.linspace(0, len(known) - 1, count).round().astype(int)]


def build_delay_system(cell_folder: Path, process: Path, job: Path, out: Path, row: int) -> tuple[DelaySystem, float]:
    """Return the delay equation at a toolpath point with a given radial depth of cut, and its second-order limit in
    m."""
    cell = load_cell(cell_folder, process=process)
    toolpath = attach_process(cell.process, read_toolpath(job))
    assert cell.process is not None
    assert cell.process.damping is not None
    assert cell.stiffness is not None
    assert cell.tool.cutter is not None
    assert cell.tool.cutter.teeth is not None
    assert toolpath.process_operation is not None
    table = read_columns(out / "points.csv")
    q = np.radians([[float(table[f"q{j}_deg"][row]) for j in range(1, 7)]])
    arm, none = UrdfKinematics(cell), np.zeros((1, 0))
    T = arm.T_base_workpiece(none)[0]
    place = (T[:3, :3] @ toolpath.position[row] + T[:3, 3])[None]
    state = ComplianceModel(cell, arm, cell.stiffness).evaluate(arm.compute_configuration(q, none), place)
    travel, axis = compute_sideways_directions(toolpath)[row], toolpath.axis[row]
    frame = np.stack([travel, np.cross(axis, travel), axis]) @ T[:3, :3].T
    modes = ModeModel(cell, arm).compute_modes(q[0], none[0], state.gear[0], state.J[0], frame)
    one = cell.process.operations[toolpath.process_operation[row]]
    milling = cell.process.materials[one.material].milling
    assert milling is not None
    assert one.cut is not None
    _, start, end = find_given_arc(cell, one.cut, 1e-3 * float(table["ae_mm"][row]))
    zeta = np.array([cell.process.damping.get_ratio(n) for n in range(6)], float)
    teeth = cell.tool.cutter.teeth
    assert one.spindle_speed is not None
    K = (milling.Ktc_Pa, milling.Krc_Pa, milling.Kac_Pa)
    law = DelayLaw.build(cell, one, [(1.0, start, end)], modes, one.spindle_speed)
    system = DelaySystem(modes.omega, zeta, modes.shape, teeth, start, end, K, 1.0 / (one.spindle_speed * teeth))
    return system, law.find_limit()
