"""Straight retracts and approaches along the tool axis before or after a rapid move: out of a cut, over a gap, around
obstacles; and the rapid moves between the ends of runs that are free without them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from machopt.kinematics.inverse.solver import refine_by_newton
from machopt.numerics.array_types import Array
from machopt.planning.motion.straight_rapid_collisions import EndContacts, Way, find_free_rapids
from machopt.planning.pipeline.gaps import Stretch
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.stations.planning_path import compute_tcp_poses

LIFTS = (0.02, 0.05, 0.1, 0.2, 0.4)  # m along the tool axis, tried in this order around obstacles
GAP_LIFTS = (0.05, 0.02, 0.1, 0.2, 0.4)  # m along the tool axis where the path is interrupted, tried in this order
WITHDRAWALS = (0.002, 0.005, 0.01, 0.02, 0.035, 0.05, 0.1, 0.2, 0.4)  # m along the tool axis out of the workpiece
LIFT_STEP = 0.01  # m between the configurations along a lift


def compute_rest_poses(plan: Plan) -> tuple[Array, Array]:
    """Return the (6 + E,) machine joints before and after the motion, true angles, rad or m.

    Args:
        plan: plan of one tool.
    """
    return _compute_true_angles(plan, plan.begin), _compute_true_angles(plan, plan.end)


def _compute_true_angles(plan: Plan, encoder_angles: Array | None) -> Array:
    """Return the true angles of given encoder angles; home without them."""
    if encoder_angles is None:
        return np.asarray(np.r_[plan.setup.driven.home, plan.setup.cell.external_home])
    correction = plan.setup.correction
    return (
        encoder_angles
        if correction is None
        else np.r_[correction.compute_true_angles(encoder_angles[None, :6])[0], encoder_angles[6:]]
    )


class RetractMoves:
    """Lifts at the planning points of a plan."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.path, self.options, self.q = plan, plan.path, plan.options, plan.chosen.assignment.q
        self.x = plan.path.whole(self.q)  # (P, 6 + E) with the external joints, which do not move during a lift
        self.touch = EndContacts(frozenset(), frozenset(), frozenset())
        self.heights: dict[int, float] = {}  # m by planning point, of withdrawals

    def gap(self, row: int) -> float:
        """Return the retract in m along the tool axis at a gap, until a rapid move may begin; NaN if there is no room.

        Args:
            row: planning point.
        """
        model = self.plan.setup.collision
        for height in GAP_LIFTS:
            way = self._find_lift(row, height)
            if way is None:
                continue
            if model is None:
                return height
            steps = np.vstack([self.x[row], self._add_external_joints(row, way)])
            if (
                not model.check_motion(steps, np.ones(len(steps), bool), self.options.collision_step).any
                and not (model.check_configurations(steps[-1:], np.array([False])).hit[0])
            ):
                return height
        return float("nan")

    def detours(self, row_a: int, row_b: int) -> Iterator[Array]:
        """Yield waypoints that lift the tool off at either end of a rapid move, or at both.

        Args:
            row_a: planning point at the start, −1 at home.
            row_b: planning point at the end, −1 at home.
        """
        for height in LIFTS:
            up_a, up_b = (self.lifted(row, height) if row >= 0 else None for row in (row_a, row_b))
            if up_a is not None and up_b is not None:
                yield np.array([up_a, up_b])
            for up in (up_a, up_b):
                if up is not None:
                    yield np.array([up])

    def lifted(self, row: int, height: float) -> Array | None:
        """Return the (6 + E,) joints with the tool retracted by the arm; None where there is no configuration nearby.

        Args:
            row: planning point.
            height: m along the tool axis.
        """
        way = self._find_lift(row, height)
        return None if way is None else self._add_external_joints(row, way[-1:])[0]

    def _add_external_joints(self, row: int, way: Array) -> Array:
        """(n, 6 + E) joints of the machine along a lift (n, 6) at a planning point."""
        return self.path.whole(way, np.full(len(way), row))

    def _find_lift(self, row: int, height: float) -> Array | None:
        """Return (n, 6) configurations LIFT_STEP apart that retract the tool along its axis, None where one is
        missing.
        """
        arm = self.plan.setup.arm
        q: Array = self.q[row]
        rows = np.array([row], np.int32)
        pose = arm.in_base(
            self.path.external[rows], compute_tcp_poses(self.path, rows, self.plan.chosen.assignment.phi[rows])
        )[0]
        way = []
        for share in np.linspace(0.0, height, int(np.ceil(height / LIFT_STEP - 1e-9)) + 1)[1:]:
            lifted = pose.copy()
            lifted[:3, 3] -= share * pose[:3, 2]
            q, error = refine_by_newton(self.plan.setup.robot, lifted, q, arm.T_flange_tcp, 5)
            if not error < 1e-8 or (q < arm.lower).any() or (q > arm.upper).any():
                return None
            way.append(q)
        return np.array(way)

    def free_between(self, pieces: list[Stretch]) -> frozenset[Way]:
        """Return the free straight rapid moves from the start of the motion over the stretches to its end.

        Args:
            pieces: stretches in order.
        """
        model, (rest, last) = self.plan.setup.collision, compute_rest_poses(self.plan)
        if model is None or not pieces:
            return frozenset()
        whole = set(self.path.runs)  # start and end of other stretches depend on the gap
        self.touch = EndContacts.build(model, self.x, (row for piece in pieces for row in piece))
        ends: list[tuple[Array, Array]] = []
        here: Array | None = rest
        for piece in pieces:
            begin, end = (self._stands(row) if piece in whole else None for row in piece)
            if here is not None and begin is not None:
                ends.append((here, begin))
            here = end
        if here is not None:
            ends.append((here, last))
        return find_free_rapids(model, ends, self.options.collision_step)

    def _stands(self, row: int) -> Array | None:
        """Return the joints where a rapid move to or from the end of a run begins or ends."""
        height = self.withdrawal(row)
        return self.lifted(row, height) if height else np.asarray(self.x[row])

    def withdrawal(self, row: int) -> float:
        """Return the retract in m along the tool axis until a rapid move may begin; 0 if it may at once, or never.

        Args:
            row: planning point.
        """
        if row not in self.heights:
            self.heights[row] = self._measure_retract(row)
        return self.heights[row]

    def _measure_retract(self, row: int) -> float:
        model = self.plan.setup.collision
        if model is None:
            return 0.0
        touch = self.touch if row in self.touch.checked_rows else EndContacts.build(model, self.x, [row])
        if row not in touch.rapid or row in touch.cut:
            return 0.0
        x = self.x[row][None]
        for height in WITHDRAWALS:
            up = self.lifted(row, height)
            if (
                up is None
                or model.check_motion(np.vstack([x, up]), np.array([True, True]), self.options.collision_step).any
            ):
                return 0.0
            if not model.check_configurations(up[None], np.array([False])).hit[0]:
                return height
        return 0.0
