"""Where a refinement begins: on the curves next to a plan, or to a sequence that leads to a better one.

A sequence (:mod:`machopt.planning.external_axis_optimization.external_axis_bound`) looks at few stations and knows
nothing of curves: next to it a pose may be
out of reach or touch something. There the start goes back to the plan, in wider and wider stretches, with the posture
of the sequence as far as that has poses there.
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
from machopt.planning.sampling.configurations import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses

LEAST_RIDGE = 1e-12  # of a square of basis functions: where a curve has more of them than points


@dataclass(frozen=True)
class RefinementStart:
    """Where a refinement begins, at all planning points."""

    phi: Array  # (P,) rad
    external: Array  # (P, E) m or rad
    seed: Array  # (P, 6) rad, for the joints

    def nearer(self, phi: Array, external: Array, share: Array) -> RefinementStart:
        """As a share (P,) of the way from a plan's rotation (P,) rad and external joints (P, E)."""
        away = share[:, None] * (self.external - external)
        return RefinementStart(phi + share * (self.phi - phi), external + away, self.seed)

    def fitted(self, curves: OffsetCurves, per: Array, weight: Array) -> tuple[Array, Array]:
        """Rotation (P,) rad and external joints (P, E) as the curves next to them, points weighted (P,)."""
        z, d = np.column_stack([self.phi, self.external * per]), 1 + len(per)
        for k in range(d):
            basis = curves.at_points[k::d]
            basis = basis[:, np.flatnonzero(np.diff(basis.tocsc().indptr))].tocsc()
            if basis.shape[1]:
                counted = (basis.T.multiply(weight)).tocsc()
                square = (counted @ basis + LEAST_RIDGE * identity(basis.shape[1])).tocsc()
                z[:, k] = basis @ spsolve(square, counted @ z[:, k])
        return z[:, 0], z[:, 1:] / per


def compute_transition_weights(left: Bools, far: float) -> Array:
    """(n,) shares of a way: none at stations ``left`` (n,) and up to ``far`` beside them, all from three times that."""
    off = np.flatnonzero(left)
    if not len(off):
        return np.ones(len(left))
    beside = np.abs(np.arange(len(left))[:, None] - off).min(axis=1)
    share = np.clip((beside - far) / (2.0 * far), 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))


def find_nearby_seeds(
    path: PlanningPath, arm: PlanningArm, rows: NDArray[np.integer], phi: Array, e: Array, near: Array
) -> Array:
    """(n, 6) rad, the poses next to some at a path's rows, however far; these themselves where there is none.

    Args:
        phi: (n,) rad.
        e: (n, E) m or rad.
        near: (n, 6) rad.
    """
    poses = arm.in_base(e, compute_tcp_poses(path, rows.astype(np.int32), phi))
    away = np.asarray(wrap_angle(arm.solver.solve(poses @ invert_transform(arm.T_flange_tcp)).q - near[:, None]))
    far = np.nan_to_num(np.abs(away).max(axis=2), nan=np.inf)
    best = away[np.arange(len(near)), far.argmin(axis=1)]
    return np.where(np.isfinite(best), near + best, near)
