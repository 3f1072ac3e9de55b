"""Distances, singularity margins and the depth limit of chatter at nodes, linear in the rotation and external joints.

They have no closed form in the joints, so that they are evaluated by the code of the planner at an iterate and at
neighbours of it: central differences of exact poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import fix_external_axes
from machopt.planning.posture_and_feed.window_data import LocalLimits
from machopt.planning.sampling.joint_path import MARGINS, solve_joint_path
from machopt.planning.stability.depth_ratio import StabilityModel

STENCIL = np.radians(0.25)  # rad, to either side
SLIDE = 1e-3  # m, the same of a sliding external joint
FAR = 0.05  # m, distances beyond it are no limit
DISTANCE_SIZE, ANGLE_SIZE, LENGTH_SIZE, RATIO_SIZE = 0.01, np.radians(5.0), 0.05, 0.5  # typical sizes
KEPT_DISTANCE = 3e-4  # m, reserve for the error of the linear model
LACKING = (InfeasibilityReason.UNREACHABLE, InfeasibilityReason.NO_PATH)


@dataclass(frozen=True)
class LimitSources:
    """What the values are computed from."""

    plan: Plan
    stability: StabilityModel | None

    def evaluate(self, points: NDArray[np.intp], phi: Array, external: Array, seed: Array) -> Array:
        """Return (N, 5): distance, shoulder, elbow and wrist margin, depth limit, each beyond its limit and scaled.

        NaN where a pose does not exist or the quantity does not count.

        Args:
            points: (N,) planning points.
            phi: (N,) rad.
            external: (N, E) rad or m.
            seed: (N, 6) rad.
        """
        plan, setup = self.plan, self.plan.setup
        whole_phi, whole_seed = np.full(len(plan.path.index), np.nan), np.full((len(plan.path.index), 6), np.nan)
        whole_external = plan.path.external.copy()
        whole_phi[points], whole_seed[points], whole_external[points] = phi, seed, external
        path = fix_external_axes(plan.path, whole_external)
        a = solve_joint_path(path, setup.arm, setup.robot, whole_phi, whole_seed)
        q = a.q[points]
        out = np.full((len(points), 5), np.nan)
        known = np.flatnonzero(np.isfinite(q).all(axis=1) & ~np.isin(a.reason[points], LACKING))
        margins = setup.arm.margins
        for column, name in enumerate(MARGINS, start=1):
            size = LENGTH_SIZE if name == "shoulder" else ANGLE_SIZE
            out[:, column] = (getattr(a, name)[points] - getattr(margins, name)) / size
        if not len(known):
            return out
        x = np.hstack([q[known], external[known]])
        if setup.collision is not None:
            out[known, 0] = self._measure_distances(x, path.may_touch[points[known]])
        if self.stability is not None:
            ratio = self.stability.compute_ratios(points[known], q[known])
            least = max(1.0, plan.options.min_stability_ratio or 0.0)
            out[known, 4] = np.where(np.isfinite(ratio), (ratio - least) / RATIO_SIZE, np.nan)
        return out

    def _measure_distances(self, x: Array, cutting: Bools) -> Array:
        model = self.plan.setup.collision
        assert model is not None
        found = model.find_nearest_pair(x, cutting, FAR + model.clearance)
        clearance = np.array([pair.clearance for pair in model.pairs] or [0.0])
        required_distance = np.where(found.pair >= 0, clearance[found.pair], 0.0)
        return np.asarray((found.distance - required_distance - KEPT_DISTANCE) / DISTANCE_SIZE)


def build_local_limits(
    sources: LimitSources, points: NDArray[np.intp], phi: Array, x: Array, is_free: Bools
) -> LocalLimits:
    """Return the limits at an iterate.

    A quantity that is below its limit already is none: the trial of the result counts it.

    Args:
        sources: What the values are computed from.
        points: (N,) planning points.
        phi: (N,) rad.
        x: (N, 6 + E) rad or m.
        is_free: (E,) external joints that may move.
    """
    q, external = x[:, :6], x[:, 6:]
    value = sources.evaluate(points, phi, external, q)
    ahead, behind = (sources.evaluate(points, phi + step, external, q) for step in (STENCIL, -STENCIL))
    by_external = np.zeros((*value.shape, external.shape[1]))
    prismatic = sources.plan.setup.cell.external_prismatic
    for e in np.flatnonzero(is_free).tolist():
        size = SLIDE if prismatic[e] else STENCIL
        step = np.zeros_like(external)
        step[:, e] = size
        sides = [sources.evaluate(points, phi, external + sign * step, q) for sign in (1.0, -1.0)]
        by_external[:, :, e] = (sides[0] - sides[1]) / (2.0 * size)
    by_phi = (ahead - behind) / (2.0 * STENCIL)
    usable = (value >= 0.0) & np.isfinite(by_phi) & np.isfinite(by_external).all(axis=2)
    return LocalLimits(
        value=np.where(usable, value, np.nan),
        by_phi=np.where(usable, by_phi, 0.0),
        by_external=np.where(usable[:, :, None], by_external, 0.0),
    )
