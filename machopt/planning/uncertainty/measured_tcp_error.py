"""Position error of the TCP from measured poses: reported with the plan, never used for planning.

The residual of measured poses (``position_error`` of stiffness.yaml) has zero mean and no direction. It
therefore moves no point and affects no choice. Where joints are outside the range of the poses, the
corrections found there may not apply, and the error without them counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.stiffness import PositionError
from machopt.numerics.array_types import Array
from machopt.planning.pipeline.plan_data_types import Plan


@dataclass(frozen=True, kw_only=True)
class PositionErrorPrediction:
    """Position error of the cut points."""

    error: PositionError
    std: float  # m per coordinate, inside the joint range of the poses
    beyond: float  # m, outside that range
    uncovered: float  # share of the cutting points
    joints: tuple[int, ...]  # joint numbers from 1 outside that range
    corrected: bool  # the corrections identified with it are active

    def words(self) -> str:
        """Return one or two sentences; empty where there is nothing to report."""
        e = self.error
        out = (
            f"Measured poses put the TCP within ± {1e3 * self.std:.2g} mm a coordinate of where the model says (1 σ, "
            f"{e.poses} poses that no fit saw, {1e3 * e.noise:.2g} mm of it their noise), beside base and TCP as set "
            "there; choice, deflection and intervals do not count it in."
        )
        if not self.corrected and e.std < e.plain:
            out += f" With the kinematics.yaml that was found with it, it would be ± {1e3 * e.std:.2g} mm."
        if self.uncovered > 0.0:
            which = ", ".join(str(j) for j in self.joints)
            out += (
                f" {100 * self.uncovered:.0f} % of the cutting points lie outside the angles of these poses (joint "
                f"{which}), where nothing better than ± {1e3 * self.beyond:.2g} mm was shown."
            )
        return out


def predict_position_error(plan: Plan) -> PositionErrorPrediction | None:
    """Return the position error of a plan; None where the stiffness file has none, or nothing is cut.

    Args:
        plan: plan of a job or of one tool.
    """
    e = plan.setup.elasticity.stiffness.position
    if e is None:
        return None
    covered = (
        np.concatenate([e.is_in_covered_range(q) for q in _iterate_cut_angles(plan)])
        if plan.path.index.size
        else np.zeros((0, 6), bool)
    )
    if not len(covered):
        return None
    corrected = bool(plan.setup.cell.kinematics)
    std, beyond = (e.std if corrected else e.plain), max(e.plain, e.std)
    outside = ~covered.all(axis=1)
    joints = tuple(int(j) + 1 for j in np.flatnonzero(~covered.all(axis=0)))
    return PositionErrorPrediction(
        error=e, std=std, beyond=beyond, uncovered=float(outside.mean()), joints=joints, corrected=corrected
    )


def _iterate_cut_angles(plan: Plan) -> Iterator[Array]:
    """(M, 6) rad at the points that are cut, stretch by stretch."""
    for part in [p.plan for p in plan.parts] or [plan]:
        rows: NDArray[np.bool_] = part.path.counted & (part.chosen.assignment.reason == InfeasibilityReason.OK)
        yield np.asarray(part.chosen.assignment.q[rows][:, :6])
