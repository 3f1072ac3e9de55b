"""Forces within a revolution, and stability of milling at the points of a plan.

Modes are those of the arm with locked rotors at the posture of each point: joint springs of the stiffness file, masses
and inertias of the URDF and of the tool. The limit of the depth of cut is that of the coupled modes; of the modes of
the tool, where they are stated, the zeroth-order solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.toolpath import Toolpath
from machopt.dynamics.rigid_body import MissingInertiaError, RigidBodyDynamics, load_dynamics
from machopt.numerics.array_types import Array
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.stability.tool_mode_depth_limit import compute_tool_limit
from machopt.planning.tolerance.error_sensitivities import TargetPoses, locate_poses
from machopt.planning.tolerance.wall_force import FEEDS, SIDES, compute_wall_forces
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.binding.point_loads import PointLoads, compute_mean_wear
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.instantaneous_force import compute_waveform, find_peak_force
from machopt.process.milling.milling_cut import MillingCut
from machopt.process.stability.depth_limit import compute_depth_limit, compute_tooth_period
from machopt.process.stability.directional_matrix import compute_directional_matrix
from machopt.process.stability.resonance import find_resonances
from machopt.process.stability.structural_modes import StructuralModes, compute_arm_modes
from machopt.process.stock.contact_load import compute_contact_matrix
from machopt.process.stock.contact_waveform import compute_contact_peaks

WIDEST_DEPTH = 10.0  # times the planned depth: a larger limit is written as none


@dataclass(frozen=True, kw_only=True)
class CuttingDynamics:
    """Columns of N toolpath points; NaN or empty where there is nothing to say."""

    peak_force: Array  # (N,) N
    wall_force: Array  # (N,) N along axis × travel at the moment the wall is made
    f1: Array  # (N,) Hz
    depth_limit: Array  # (N,) m
    chatter: tuple[str, ...]
    notes: tuple[str, ...]


def compute_cutting_dynamics(plan: Plan, toolpath: Toolpath, loads: PointLoads) -> CuttingDynamics:
    """Return peak forces, modes and stability along a plan.

    Args:
        plan: Plan of one tool.
        toolpath: Its toolpath, with the operations of the process.
        loads: The loads of its points.
    """
    return _DynamicsTable(plan, toolpath, loads).build()


class _DynamicsTable:
    def __init__(self, plan: Plan, toolpath: Toolpath, loads: PointLoads) -> None:
        cell = plan.setup.cell
        assert cell.process is not None
        assert toolpath.process_operation is not None
        n = len(toolpath)
        self.plan, self.toolpath, self.loads = plan, toolpath, loads
        self.process: CuttingProcess = cell.process
        self.operation = toolpath.process_operation
        self.peak, self.f1, self.limit = (np.full(n, np.nan) for _ in range(3))
        self.wall = np.zeros(n)
        self.chatter = [""] * n
        self.notes: list[str] = []

    def build(self) -> CuttingDynamics:
        dynamics = self._load_dynamics()
        for k, one in enumerate(self.process.operations):
            rows = np.flatnonzero(self.toolpath.cutting & (self.operation == k))
            if not len(rows):
                continue
            poses = locate_poses(self.plan, self.plan.chosen, rows.astype(float))
            modes = None if dynamics is None else self._compute_modes(dynamics, poses)
            if modes is not None:
                known = poses.is_reached
                self.f1[rows[known]] = modes.frequency[known, 0]
            if one.kind == "milling":
                self._add_milling(one, rows, poses, modes)
        return CuttingDynamics(
            peak_force=self.peak,
            wall_force=self.wall,
            f1=self.f1,
            depth_limit=self.limit,
            chatter=tuple(self.chatter),
            notes=tuple(dict.fromkeys(self.notes)),
        )

    def _load_dynamics(self) -> RigidBodyDynamics | None:
        cell = self.plan.setup.cell
        if self.plan.setup.robot.coupling is not None:
            self.notes.append("no modes: the arm has joints that mimic others")
            return None
        try:
            dynamics = load_dynamics(cell)
        except MissingInertiaError:
            self.notes.append("no modes: the URDF states no masses and inertias")
            return None
        if cell.tool.mass > 0 and cell.tool.inertia is None:
            self.notes.append("f1_Hz is an upper bound: tool.inertia_kg_m2 is not stated")
        if cell.stiffness is not None and cell.stiffness.terms:
            self.notes.append("the modes count the joint springs; the other terms of the stiffness file are left out")
        return dynamics

    def _compute_modes(self, dynamics: RigidBodyDynamics, poses: TargetPoses) -> StructuralModes:
        """Return the modes at the poses; those of a pose that is not reached mean nothing."""
        setup = self.plan.setup
        q = np.nan_to_num(poses.q)
        place = setup.arm.places(poses.external, poses.position)
        elastic = setup.elasticity.evaluate(q)
        from machopt.stiffness.joint_stiffness import compute_joint_stiffness

        k = compute_joint_stiffness(setup.elasticity.stiffness, place).k
        axes = np.stack([poses.travel, poses.normal, poses.axis], axis=1)  # (M, 3, 3)
        J = axes @ elastic.state.J[:, :3]
        damping = () if self.process.damping is None else self._list_damping()
        return compute_arm_modes(dynamics.compute_mass_matrix(q), 1.0 / k, J, damping)

    def _list_damping(self) -> tuple[float, ...] | float:
        assert self.process.damping is not None
        ratios = self.process.damping.ratios
        return ratios[0] if len(ratios) == 1 else ratios[:6]

    def _add_milling(
        self, one: ProcessOperation, rows: NDArray[np.intp], poses: TargetPoses, modes: StructuralModes | None
    ) -> None:
        coefficients = self.process.materials[one.material].milling
        assert coefficients is not None
        cutter = build_milling_cutter(self.plan.setup.cell.tool.cutter)
        if one.takes_stock:
            self._add_stock_milling(one, rows, poses, modes)
            return
        for code, side in SIDES.items():
            mine = np.flatnonzero(self.loads.side[rows] == code)
            if not len(mine):
                continue
            cut, at = MillingCut(side, one.spindle), rows[mine]
            self._add_revolution_forces(one, at, cut)
            if modes is None or cutter.corner_radius > 0:
                self._mark_unknown(at, modes)
                continue
            arc = compute_contact_arc(cutter, cut, np.array([self.loads.ae[at[0]]]), cutter.radius)
            flat = replace(arc, start=arc.start[0], end=arc.end[0])
            H = compute_directional_matrix(coefficients, cutter, cut, flat)
            self._add_stability(one, at, mine, poses, modes, H)

    def _add_stock_milling(
        self, one: ProcessOperation, rows: NDArray[np.intp], poses: TargetPoses, modes: StructuralModes | None
    ) -> None:
        """Write the columns of points whose contact comes from the stock."""
        coefficients = self.process.materials[one.material].milling
        assert coefficients is not None
        assert self.toolpath.engagement is not None
        geometry = self.plan.setup.cell.tool.cutter
        cutter = build_milling_cutter(geometry)
        wanted = np.zeros(len(self.toolpath), bool)
        wanted[rows] = True
        found, ap = self.toolpath.engagement.select_points(wanted), self.loads.ap
        bite, wear = self.loads.bite, compute_mean_wear(one)
        self.peak[rows] = wear * compute_contact_peaks(coefficients, cutter, one.spindle, found, bite)[rows]
        self.wall[rows] = compute_wall_forces(one, geometry, coefficients, self.loads, rows, bite[rows])
        mine = np.flatnonzero(np.isfinite(ap[rows]))
        if not len(mine):
            return
        if modes is None or cutter.corner_radius > 0:
            self._mark_unknown(rows[mine], modes)
            return
        H = compute_contact_matrix(coefficients, cutter, MillingCut("slot", one.spindle), found, ap)
        self._add_stability(one, rows[mine], mine, poses, modes, H[rows[mine]])

    def _mark_unknown(self, rows: NDArray[np.intp], modes: StructuralModes | None) -> None:
        for row in rows.tolist():
            self.chatter[row] = "unknown"
        if modes is not None:
            self.notes.append("stability is computed for flat end mills only")

    def _add_revolution_forces(self, one: ProcessOperation, rows: NDArray[np.intp], cut: MillingCut) -> None:
        """Write the peak force and, where the tool deflects, the force that makes the wall."""
        coefficients = self.process.materials[one.material].milling
        assert coefficients is not None
        cutter, geometry = build_milling_cutter(self.plan.setup.cell.tool.cutter), self.plan.setup.cell.tool.cutter
        bite = self.loads.bite[rows]
        depths = (float(self.loads.ae[rows[0]]), float(self.loads.ap[rows[0]]))
        feeds = np.unique(np.linspace(bite.min(), bite.max(), FEEDS))
        wear = compute_mean_wear(one)
        peaks = [find_peak_force(compute_waveform(coefficients, cutter, cut, depths, float(f))) for f in feeds]
        self.peak[rows] = wear * np.interp(bite, feeds, peaks)
        self.wall[rows] = compute_wall_forces(one, geometry, coefficients, self.loads, rows, bite)

    def _add_stability(
        self,
        one: ProcessOperation,
        rows: NDArray[np.intp],
        mine: NDArray[np.intp],
        poses: TargetPoses,
        modes: StructuralModes,
        H: Array,
    ) -> None:
        cutter = self.plan.setup.cell.tool.cutter
        assert cutter is not None
        assert cutter.teeth is not None
        period = compute_tooth_period(60.0 * self.loads.spindle_speed[rows], cutter.teeth)
        some = StructuralModes(modes.omega[mine], modes.zeta[mine], modes.shape[mine])
        depth = self.loads.ap[rows]
        found = compute_depth_limit(some, H, period, largest=WIDEST_DEPTH * float(depth.max()))
        limit = np.where(poses.is_reached[mine], found.depth, np.nan)
        word = [f"robot:{m + 1}" for m in found.mode]
        tool = self._compute_tool_limit(H, period, poses, mine)
        if tool is not None:
            word = ["spindle" if t < a or np.isnan(a) else w for t, a, w in zip(tool, limit, word, strict=True)]
            is_unknown = np.where(np.isnan(limit), depth < tool, np.isnan(tool) & (depth < limit))
            limit = np.where(is_unknown, np.nan, np.fmin(limit, tool))  # below one limit, and the other is not known
        self.limit[rows] = limit
        for n, row in enumerate(rows.tolist()):
            known = np.isfinite(limit[n]) or limit[n] == np.inf
            self.chatter[row] = "unknown" if not known else "stable" if depth[n] < limit[n] else word[n]
        if self.process.damping is None:
            self.notes.append("chatter is unknown: modes.damping_percent of process.yaml is not stated")
        self._note_resonances(one, rows, some, cutter.teeth)

    def _compute_tool_limit(self, H: Array, period: Array, poses: TargetPoses, mine: NDArray[np.intp]) -> Array | None:
        """Return the limit of the modes of tool and spindle; None where none are stated."""
        path_axes = np.stack([poses.travel, poses.normal, poses.axis], axis=1)[mine]
        cutter = self.plan.setup.cell.tool.cutter
        return compute_tool_limit(cutter, H, period, path_axes, self._list_tool_axes(poses, mine))

    def _list_tool_axes(self, poses: TargetPoses, mine: NDArray[np.intp]) -> Array:
        """Return (m, 3, 3) the TCP axes in base_link as columns."""
        q = np.nan_to_num(poses.q[mine])
        T = self.plan.setup.robot.compute_fk_jacobian(q, self.plan.setup.cell.tool.T_flange_tcp)[0]
        return np.asarray(T[:, :3, :3])

    def _note_resonances(
        self, one: ProcessOperation, rows: NDArray[np.intp], modes: StructuralModes, teeth: int
    ) -> None:
        """Note where a tooth or spindle frequency lies near a mode."""
        speed = float(np.median(self.loads.spindle_speed[rows]))
        met = find_resonances(modes, 60.0 * speed, teeth)
        for name in ("tooth", "spindle"):
            mine = [meeting for meeting in met if meeting.excitation == name]
            if mine:
                worst = max(mine, key=lambda meeting: meeting.amplification)
                count = len({meeting.point for meeting in mine})
                self.notes.append(
                    f"{one.label}: the {name} frequency of {worst.excitation_hz:.3g} Hz lies near mode "
                    f"{worst.mode + 1} of the arm ({worst.mode_hz:.3g} Hz) at {count} of {len(rows)} points"
                )
