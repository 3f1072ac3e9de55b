"""Starting point of a refinement: on the curves nearest to a plan, or to a sequence that leads to a better one.

A sequence (:mod:`machopt.planning.external_axis_optimization.external_axis_bound`) covers few stations and does not
use curves: next to it a pose may be out of reach or in contact. There the start returns to the plan, over wider and
wider stretches, with the posture of the sequence wherever that has poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import identity
from scipy.sparse.linalg import spsolve

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import invert_transform, wrap_angle
from machopt.planning.continuous_refinement.offset_curves import OffsetCurves
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses

LEAST_RIDGE = 1e-12  # ridge of the normal equations, for a curve with more basis functions than points


@dataclass(frozen=True)
class RefinementStart:
    """Starting point of a refinement at all planning points."""

    phi: Array  # (P,) rad
    external: Array  # (P, E) m or rad
    seed: Array  # (P, 6) rad, for the joints

    def nearer(self, phi: Array, external: Array, share: Array) -> RefinementStart:
        """Return the point at a share of the way from a plan to this start.

        Args:
            phi: (P,) rad, rotation of the plan.
            external: (P, E) m or rad, external joints of the plan.
            share: (P,) share of the way, 0 at the plan.
        """
        away = share[:, None] * (self.external - external)
        return RefinementStart(phi + share * (self.phi - phi), external + away, self.seed)

    def fitted(self, curves: OffsetCurves, per: Array, weight: Array) -> tuple[Array, Array]:
        """Return rotation (P,) rad and external joints (P, E) on the curves nearest to this start (weighted least
        squares).

        Args:
            curves: permitted offsets.
            per: (E,) rad per m or rad of the external joints.
            weight: (P,) weight of each point.
        """
        z, d = np.column_stack([self.phi, self.external * per]), 1 + len(per)
        for k in range(d):
            basis = curves.at_points[k::d]
            basis = basis[:, np.flatnonzero(np.diff(basis.tocsc().indptr))].tocsc()
            if basis.shape[1]:
                counted = (basis.T.multiply(weight)).tocsc()
                square = (counted @ basis + LEAST_RIDGE * identity(basis.shape[1])).tocsc()
                z[:, k] = basis @ spsolve(square, counted @ z[:, k])
        return z[:, 0], z[:, 1:] / per


def compute_transition_weights(excluded: Bools, radius: float) -> Array:
    """Return (n,) shares of the way to the start: 0 at the excluded stations and near them, 1 from three times that
    distance.

    Args:
        excluded: (n,) excluded stations.
        radius: number of stations to either side that also get 0.
    """
    off = np.flatnonzero(excluded)
    if not len(off):
        return np.ones(len(excluded))
    distance = np.abs(np.arange(len(excluded))[:, None] - off).min(axis=1)
    share = np.clip((distance - radius) / (2.0 * radius), 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))


def find_nearby_seeds(
    path: PlanningPath, arm: PlanningArm, rows: NDArray[np.integer], phi: Array, e: Array, near: Array
) -> Array:
    """Return the (n, 6) rad poses nearest to given ones at a path's rows; the given ones where there is no pose.

    Args:
        path: planning points.
        arm: arm model with its inverse kinematics.
        rows: (n,) planning points.
        phi: (n,) rad, rotation.
        e: (n, E) m or rad, external joints.
        near: (n, 6) rad, poses to stay near.
    """
    poses = arm.in_base(e, compute_tcp_poses(path, rows.astype(np.int32), phi))
    difference = np.asarray(wrap_angle(arm.solver.solve(poses @ invert_transform(arm.T_flange_tcp)).q - near[:, None]))
    distance = np.nan_to_num(np.abs(difference).max(axis=2), nan=np.inf)
    best = difference[np.arange(len(near)), distance.argmin(axis=1)]
    return np.where(np.isfinite(best), near + best, near)
