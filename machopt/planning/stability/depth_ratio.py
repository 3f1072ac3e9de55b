"""Largest stable depth of cut over the planned depth, of configurations at planning points.

Modes are those of the arm with locked rotors: joint springs at the TCP's position, masses and inertias of URDF and
tool. The limit is that of the coupled modes, and of the tool's own modes where the cell states them elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.process import CuttingProcess
from machopt.data_types.toolpath import Toolpath
from machopt.dynamics.rigid_body import MissingInertiaError, RigidBodyDynamics, load_dynamics
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stability.tool_mode_depth_limit import compute_tool_limit
from machopt.planning.stations.planning_path import PlanningPath
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.binding.job_binding import compute_loads
from machopt.process.binding.point_loads import PointLoads
from machopt.process.milling.engagement_angles import ContactArc
from machopt.process.milling.milling_cut import CutSide, MillingCut
from machopt.process.stability.depth_limit import compute_depth_limit, compute_tooth_period
from machopt.process.stability.directional_matrix import compute_directional_matrix
from machopt.process.stability.structural_modes import compute_arm_modes
from machopt.process.stock.contact_load import compute_contact_matrix

WIDEST = 4.0  # times the planned depth: a larger limit counts as none
BLOCK = 8192
_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


@dataclass(frozen=True, kw_only=True)
class StabilityModel:
    """Everything that the limit of a configuration follows from."""

    process: CuttingProcess
    dynamics: RigidBodyDynamics
    robot: Robot
    arm: PlanningArm
    cell: Cell
    directions: LoadDirections
    loads: PointLoads
    operation: NDArray[np.int32]  # (N,) process operation of each toolpath point
    row: NDArray[np.intp]  # (P,) toolpath point whose move each planning point belongs to
    travel: Array  # (P, 3) sideways direction of travel, in base_link
    is_milled: NDArray[np.bool_]  # (P,) a flat end mill cuts there
    matrices: Mapping[int, Array]  # (N, 3, 2) Pa by operation, where the contact comes from the stock

    @classmethod
    def build(
        cls,
        cell: Cell,
        toolpath: Toolpath,
        path: PlanningPath,
        arm: PlanningArm,
        robot: Robot,
        directions: LoadDirections,
    ) -> StabilityModel | None:
        """Return the model; None without damping, inertias or milling with a flat end mill.

        Args:
            cell: The cell with the tool and the process.
            toolpath: Toolpath of one tool.
            path: Its planning points.
            arm: Arm model.
            robot: Kinematic model.
            directions: Directions and force per planning point.
        """
        process, loads = cell.process, compute_loads(cell, toolpath, toolpath.feed)
        if find_missing_input(cell, toolpath) or loads is None or process is None:
            return None
        assert toolpath.process_operation is not None
        row, is_milled = _find_milled_points(process, toolpath.process_operation, path)
        if not is_milled.any():
            return None
        try:
            dynamics = load_dynamics(cell)
        except MissingInertiaError:
            return None
        return cls(
            process=process,
            dynamics=dynamics,
            robot=robot,
            arm=arm,
            cell=cell,
            directions=directions,
            loads=loads,
            operation=toolpath.process_operation,
            row=row,
            travel=arm.directions(path.external, compute_sideways_directions(path)),
            is_milled=is_milled,
            matrices=_build_contact_matrices(process, toolpath, loads, cell),
        )

    def with_path(self, path: PlanningPath, directions: LoadDirections) -> StabilityModel:
        """Return the model for other planning points of the same toolpath.

        Args:
            path: Planning points.
            directions: Directions and force per planning point.
        """
        row, is_milled = _find_milled_points(self.process, self.operation, path)
        travel = self.arm.directions(path.external, compute_sideways_directions(path))
        return replace(self, directions=directions, row=row, is_milled=is_milled, travel=travel)

    def compute_ratios(self, points: NDArray[np.intp], q: Array) -> Array:
        """Return (M,) the limit of the depth of cut over the planned depth; inf where nothing is milled.

        Args:
            points: (M,) planning points.
            q: (M, 6) rad.
        """
        out = np.full(len(q), np.inf)
        rows = self.row[points]
        key = np.stack([self.operation[rows], self.loads.side[rows]], axis=1)
        cuts = self.is_milled[points] & np.isfinite(self.loads.ap[rows])
        for k, code in np.unique(key[cuts], axis=0).tolist():
            mine = np.flatnonzero(cuts & (key[:, 0] == k) & (key[:, 1] == code))
            for first in range(0, len(mine), BLOCK):
                some = mine[first : first + BLOCK]
                out[some] = self._compute_block(k, code, points[some], q[some])
        return out

    def _compute_block(self, k: int, code: int, points: NDArray[np.intp], q: Array) -> Array:
        one = self.process.operations[k]
        coefficients = self.process.materials[one.material].milling
        assert coefficients is not None
        assert self.process.damping is not None
        cutter = build_milling_cutter(self.cell.tool.cutter)
        cut = MillingCut(_SIDES[code], one.spindle)
        rows = self.row[points]
        if one.takes_stock:
            H = self.matrices[k][rows]
        else:
            zero = np.zeros(())
            arc = ContactArc(self.loads.entry_angle[rows[0]], self.loads.exit_angle[rows[0]], zero, zero)
            H = compute_directional_matrix(coefficients, cutter, cut, arc)
        axis, travel = self.directions.axial[points], self.travel[points]
        axes = np.stack([travel, np.cross(axis, travel), axis], axis=1)
        T, J_base = self.robot.compute_fk_jacobian(q, self.cell.tool.T_flange_tcp)
        J = axes @ J_base[:, :3]
        ratios = self.process.damping.ratios
        damping = ratios[0] if len(ratios) == 1 else ratios[:6]
        modes = compute_arm_modes(self.dynamics.compute_mass_matrix(q), 1.0 / self.directions.k[points], J, damping)
        depth = self.loads.ap[rows]
        period = compute_tooth_period(60.0 * self.loads.spindle_speed[rows], cutter.teeth)
        limit = compute_depth_limit(modes, H, period, largest=WIDEST * float(depth.max())).depth
        tool = compute_tool_limit(self.cell.tool.cutter, H, period, axes, T[:, :3, :3])
        limit = limit if tool is None else np.fmin(limit, tool)
        return np.where(np.isnan(limit), np.inf, limit / depth)


def find_missing_input(cell: Cell, toolpath: Toolpath) -> str:
    """Return what the stability of one tool's cuts lacks; empty where it can be computed.

    Args:
        cell: The cell with the tool and the process.
        toolpath: Toolpath of one tool.
    """
    process, cutter, operation = cell.process, cell.tool.cutter, toolpath.process_operation
    if process is None or operation is None:
        return "a process.yaml"
    kinds = np.array([*(one.kind == "milling" for one in process.operations), False])
    if not (kinds[operation] & toolpath.cutting).any():
        return "an operation of kind milling"
    if process.damping is None or 1 < len(process.damping.ratios) < 6:
        return "modes.damping_percent of process.yaml, one value or six"
    if cutter is None or cutter.corner > 0:
        return "a flat end mill"
    return "an arm whose joints mimic no others" if cell.mimics else ""


def _build_contact_matrices(
    process: CuttingProcess, toolpath: Toolpath, loads: PointLoads, cell: Cell
) -> dict[int, Array]:
    """Return the directional matrix of each point by operation, where the contact comes from the stock."""
    out: dict[int, Array] = {}
    for k, one in enumerate(process.operations):
        mine = toolpath.process_operation == k
        if not (one.takes_stock and np.any(mine)):
            continue
        coefficients = process.materials[one.material].milling
        assert coefficients is not None
        assert toolpath.engagement is not None
        found = toolpath.engagement.select_points(np.asarray(mine))
        cutter = build_milling_cutter(cell.tool.cutter)
        out[k] = compute_contact_matrix(coefficients, cutter, MillingCut("slot", one.spindle), found, loads.ap)
    return out


def _find_milled_points(
    process: CuttingProcess, operation: NDArray[np.int32], path: PlanningPath
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the toolpath point of each planning point, and whether it is milled, (P,) each."""
    row = np.clip(np.ceil(path.index - 1e-9).astype(np.intp), 0, len(operation) - 1)
    kinds = np.array([*(one.kind == "milling" for one in process.operations), False])
    return row, np.asarray(kinds[operation[row]] & path.counted)
