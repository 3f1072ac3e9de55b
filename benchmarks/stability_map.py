"""Stability over the rotation about the tool axis: processor time of the map, and the map of one point.

Run: ``python benchmarks/stability_map.py [points]``. On the shipped milling cell and its five-axis contour, every point
at 72 rotations: modes of the arm (joint springs, masses of the URDF) and the limit of the depth of cut of a two-tooth
20 mm cutter in 7075 at 12,000 rpm, radial depth 5 mm, damping assumed at 3 % for every mode. Printed: processor
seconds of each step for the whole map, and at the middle of the path the limits by rotation with the least stiffness.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.cell.cell_reader import load_cell
from machopt.dynamics.rigid_body import load_dynamics
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.urdf_loading import load_robot
from machopt.process.materials import find_milling_coefficients
from machopt.process.milling import MillingCut, MillingCutter, compute_contact_arc
from machopt.process.stability import (
    DelayLaw,
    StructuralModes,
    compute_arm_modes,
    compute_depth_limit,
    compute_directional_matrix,
    compute_tooth_period,
)
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
ROTATIONS, DAMPING, AE, RPM = 72, 0.03, 0.005, 12000.0
CUTTER = MillingCutter(diameter=0.02, teeth=2, helix=math.radians(30), length=0.04)
Array = NDArray[np.float64]


def build_frames(position: Array, axis: Array, travel: Array) -> Array:
    """TCP frames in the workpiece: (P, ROTATIONS, 4, 4)."""
    z = -axis
    x = travel - np.sum(travel * z, axis=1)[:, None] * z
    x /= np.linalg.norm(x, axis=1)[:, None]
    y = np.cross(z, x)
    gamma = np.arange(ROTATIONS) * (2 * np.pi / ROTATIONS)
    T = np.zeros((len(position), ROTATIONS, 4, 4))
    T[..., :3, 0] = np.cos(gamma)[:, None] * x[:, None] + np.sin(gamma)[:, None] * y[:, None]
    T[..., :3, 1] = -np.sin(gamma)[:, None] * x[:, None] + np.cos(gamma)[:, None] * y[:, None]
    T[..., :3, 2], T[..., :3, 3], T[..., 3, 3] = z[:, None], position[:, None], 1.0
    return T


def main() -> None:
    """Measure and print."""
    points = int(sys.argv[1]) if sys.argv[1:] else 1000
    cell = load_cell(ROOT / "cells" / "kr500_milling", bodies=False)
    toolpath = read_toolpath(ROOT / "toolpaths" / "contour_5axis.csv")
    robot, dynamics = load_robot(cell), load_dynamics(cell)
    assert cell.stiffness is not None
    cut = np.flatnonzero(toolpath.cutting)
    rows = cut[np.linspace(1, len(cut) - 2, points).astype(int)]
    travel = toolpath.position[rows + 1] - toolpath.position[rows - 1]
    travel /= np.linalg.norm(travel, axis=1)[:, None]
    T_base_work = np.linalg.inv(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    frames = T_base_work @ build_frames(toolpath.position[rows], toolpath.axis[rows], travel)
    flange = (frames @ np.linalg.inv(cell.tool.T_flange_tcp)).reshape(-1, 4, 4)
    q = build_solver(robot).solve(flange).q
    home = np.asarray(cell.home[:6])
    distance = np.abs(q - home).max(axis=-1)
    q = q[np.arange(len(q)), np.where(np.isnan(distance), np.inf, distance).argmin(axis=1)]
    reached = np.isfinite(q).all(axis=1)
    q = np.nan_to_num(q)
    J = robot.compute_fk_jacobian(q, cell.tool.T_flange_tcp)[1][:, :3]
    R = T_base_work[:3, :3]
    axis, along = (np.repeat(v @ R.T, ROTATIONS, axis=0) for v in (toolpath.axis[rows], travel))
    along -= np.sum(along * axis, axis=1)[:, None] * axis
    along /= np.linalg.norm(along, axis=1)[:, None]
    path_axes = np.stack([along, np.cross(axis, along), axis], axis=1)
    M = dynamics.compute_mass_matrix(q)
    coefficients = find_milling_coefficients("al7075-t6-a")
    matrices = {}
    for side in ("down", "up"):
        direction = MillingCut(side)  # type: ignore[arg-type]
        arc = compute_contact_arc(CUTTER, direction, np.array(AE), CUTTER.radius)
        matrices[side] = compute_directional_matrix(coefficients, CUTTER, direction, arc)
    T = compute_tooth_period(RPM, CUTTER.teeth)
    compute_depth_limit(
        _take(compute_arm_modes(M[:2], 1 / cell.stiffness.joints, J[:2], DAMPING), 2), matrices["up"], T
    )
    start = time.process_time()
    modes = compute_arm_modes(M, 1 / cell.stiffness.joints, path_axes @ J, DAMPING)
    print(f"{points} points × {ROTATIONS} rotations, {reached.mean():.1%} reached; processor seconds")
    print(f"  modes of the arm                        {time.process_time() - start:6.2f}")
    limits = {}
    for name, law, largest in (
        ("delay to second order", DelayLaw.SECOND_ORDER, 1.0),
        ("all laws of the delay", DelayLaw.COUPLED, 1.0),
        ("all laws, depths to 20 mm", DelayLaw.COUPLED, 0.02),
    ):
        start = time.process_time()
        found = compute_depth_limit(modes, matrices["down"], T, law, largest)
        print(f"  limit, {name:32} {time.process_time() - start:6.2f}")
        limits[name] = found
    _print_point(modes, matrices, float(T), slice((points // 2) * ROTATIONS, (points // 2 + 1) * ROTATIONS))


def _take(modes: StructuralModes, count: int) -> StructuralModes:
    return StructuralModes(modes.omega[:count].copy(), modes.zeta[:count].copy(), modes.shape[:count].copy())


def _print_point(modes: StructuralModes, matrices: dict[str, Array], T: float, part: slice) -> None:
    one = StructuralModes(modes.omega[part].copy(), modes.zeta[part].copy(), modes.shape[part].copy())
    C = np.einsum("pni,pnj->pij", one.shape / one.omega[..., None] ** 2, one.shape)
    stiffness = 1e-3 / np.linalg.eigvalsh(C)[:, -1]
    depth = {side: compute_depth_limit(one, H, T).depth * 1e3 for side, H in matrices.items()}
    print("middle of the path: rotation (°), least stiffness (N/mm), limit down and up (mm)")
    for k in range(0, ROTATIONS, 3):
        print(f"  {k * 360 // ROTATIONS:4d} {stiffness[k]:8.0f} {depth['down'][k]:9.2f} {depth['up'][k]:9.2f}")
    for side, values in depth.items():
        known = np.isfinite(values)
        print(
            f"  {side}: {values.min():.1f} … {values.max():.1f} mm; correlation of stiffness with the logarithm "
            f"{np.corrcoef(stiffness[known], np.log(values[known]))[0, 1]:.2f}"
        )


if __name__ == "__main__":
    main()
