"""Error and outcome of one hole or milled point at another rotation, fast enough for a handle that is dragged.

Only the posture of that point changes. Force and feed are those of the plan. A compensation follows the rotation: the
shift of the point is computed anew from the compliance there, as for a plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.compensation.shifted_points import shift_points
from machopt.planning.error_probability.toleranced_points import compute_tip_length, list_hole_targets
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.joint_path import solve_joint_path
from machopt.planning.tolerance.cutting_dynamics import compute_cutting_dynamics
from machopt.planning.tolerance.point_errors import PointErrors, compute_point_errors
from machopt.planning.tolerance.process_results import find_driven_feed
from machopt.process.binding.job_binding import compute_loads
from machopt.process.binding.point_loads import PointLoads

NOT_REACHED = "unreachable"


@dataclass(frozen=True, kw_only=True)
class LiveOutcome:
    """A hole or milled point at another rotation."""

    point: int  # toolpath point that carries the outcome
    outcome: str  # pass, marginal, fail, unknown; unreachable without a posture
    error_name: str = ""  # across, along, normal or axis: the first that has a limit
    error: float = math.nan  # m or rad, nominal
    tolerance: float = math.nan  # m, the tightest limit of a length
    p_in: float = math.nan  # of all tolerances; of the deflection alone where the outcome is unknown
    reason: str = ""  # why the outcome is unknown


@dataclass(frozen=True, eq=False)
class LiveOutcomes:
    """One tool's plan with what no rotation changes."""

    plan: Plan
    toolpath: Toolpath
    loads: PointLoads
    wall_force: Array  # (N,)
    spans: tuple[tuple[float, float, int], ...]  # of each hole with a tolerance: first and last index, its point

    @classmethod
    def build(cls, plan: Plan, toolpath: Toolpath, timeline: MotionTimeline | None) -> LiveOutcomes | None:
        """Return what is needed for any rotation; None where no process is stated.

        Args:
            plan: Plan of one tool, as driven.
            toolpath: Its toolpath.
            timeline: Its motion; None: the programmed feed counts.
        """
        cell = plan.setup.cell
        loads = compute_loads(cell, toolpath, find_driven_feed(toolpath, timeline))
        if cell.process is None or loads is None or not any(one.tolerance.is_given for one in cell.process.operations):
            return None
        wall_force = compute_cutting_dynamics(plan, toolpath, loads).wall_force
        holes = list_hole_targets(cell.process, toolpath, loads, compute_tip_length(cell.tool.cutter))
        spans = zip(np.floor(holes.entry).tolist(), holes.exit.tolist(), holes.row.tolist(), strict=True)
        return cls(plan, toolpath, loads, wall_force, tuple(spans))

    def evaluate(self, point: int, phi: float, seed: Array) -> LiveOutcome | None:
        """Return the outcome at a rotation; None where the point has no tolerance.

        Args:
            point: Toolpath point, or one of the strokes of a hole.
            phi: rad, rotation about the transported reference.
            seed: (6,) rad, a posture near that rotation; NaN where there is none.
        """
        first, last, row = next((s for s in self.spans if s[0] <= point <= s[1]), (float(point), float(point), point))
        rows = np.flatnonzero((self.plan.path.index >= first - 1e-6) & (self.plan.path.index <= last + 1e-6))
        plan = self._turn_rows(rows, phi, seed)
        assignment = plan.chosen.assignment
        found = compute_point_errors(plan, self.toolpath, self.loads, wall_force=self.wall_force, only=row)
        if not found.outcome[row]:
            return None
        if (assignment.reason[rows] != InfeasibilityReason.OK).any():
            return LiveOutcome(point=row, outcome=NOT_REACHED)
        return self._describe(row, found)

    def _turn_rows(self, rows: NDArray[np.intp], phi: float, seed: Array) -> Plan:
        """Return the plan with some planning points at another rotation, shifted against the deflection there."""
        plan, before = self.plan, self.plan.chosen.assignment
        angles, seeds = np.full(len(plan.path.index), np.nan), np.full(before.q.shape, np.nan)
        angles[rows], seeds[rows] = phi, seed
        if plan.compensation is None:
            turned = solve_joint_path(plan.path, plan.setup.arm, plan.setup.robot, angles, seeds)
        else:
            plan, turned = shift_points(plan, rows, angles, seeds)
        q, reason = before.q.copy(), before.reason.copy()
        q[rows], reason[rows] = turned.q[rows], turned.reason[rows]
        chosen = replace(plan.chosen, assignment=replace(before, q=q, reason=reason))
        return replace(plan, chosen=chosen)

    def _describe(self, row: int, point_errors: PointErrors) -> LiveOutcome:
        process = self.plan.setup.cell.process
        operation = self.toolpath.process_operation
        assert process is not None
        assert operation is not None
        limits = process.operations[operation[row]].tolerance
        pairs = (
            ("across", limits.position),
            ("along", limits.depth),
            ("axis", limits.axis),
            ("normal", limits.surface),
        )
        name = next((name for name, limit in pairs if np.isfinite(limit)), "normal")
        p = point_errors.p_in[row]
        return LiveOutcome(
            point=row,
            outcome=point_errors.outcome[row],
            error_name=name,
            error=float(point_errors.errors[name][row]),
            tolerance=float(point_errors.tolerance[row]),
            p_in=float(p if np.isfinite(p) else point_errors.p_in_deflection_only[row]),
            reason=point_errors.unknown_because.get(row, ""),
        )
