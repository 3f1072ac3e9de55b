"""Index of each station as parabolas of the tilt, at a given rotation and branch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.joint_path import solve_joint_path
from machopt.planning.stations.tilt_curve import tilt_path
from machopt.planning.tilt.tilt_grid import TiltNodes
from machopt.planning.tilt.tilt_limits import TiltLimits

BLOCKED = 0.3  # index by which a tilt without a configuration is above the largest one of its station, in units of c₀
WIDE = 1e-9  # a range of tangents narrower than this is one value


@dataclass(frozen=True, kw_only=True)
class LocalCosts:
    """Parabolas of the index in (tan lead, tan side) at M stations."""

    rows: NDArray[np.intp]  # (M,) planning points
    frame: Array  # (M, 2, 3) directions of the two tangents
    levels: Array  # (M, 3, 2) tangents at which the index is known
    values: Array  # (M, 3, 3) index there, in units of c₀

    @property
    def low(self) -> Array:
        """(M, 2) lowest tangents."""
        return self.levels[:, 0]

    @property
    def high(self) -> Array:
        """(M, 2) highest tangents."""
        return self.levels[:, 2]

    def evaluate(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the index (M,), its gradient (M, 2) and Hessian (M, 2, 2) by the tangents.

        Args:
            x: (M, 2) tangents of lead and side.
        """
        (a, da, dda), (b, db, ddb) = (_interpolate(self.levels[:, :, c], x[:, c]) for c in (0, 1))

        def combine(u: Array, v: Array) -> Array:
            return np.asarray(np.einsum("mi,mij,mj->m", u, self.values, v))

        gradient = np.column_stack([combine(da, b), combine(a, db)])
        cross = combine(da, db)
        hessian = np.stack([np.stack([combine(dda, b), cross], axis=1), np.stack([cross, combine(a, ddb)], axis=1)], 1)
        return combine(a, b), gradient, hessian


def _interpolate(level: Array, x: Array) -> tuple[Array, Array, Array]:
    """Lagrange polynomials (M, 3) through three levels, their slopes and curvatures; constant where levels coincide."""
    a, b, c = level.T
    wide = c - a > WIDE
    a, c = np.where(wide, a, b - 1.0), np.where(wide, c, b + 1.0)
    value, slope, bend = [], [], []
    for p, q, r in ((b, c, a), (a, c, b), (a, b, c)):  # roots, and where the polynomial is one
        unit = (r - p) * (r - q)
        value.append((x - p) * (x - q) / unit)
        slope.append((2.0 * x - p - q) / unit)
        bend.append(2.0 / unit)
    fixed = ~wide[:, None]
    one = np.array([0.0, 1.0, 0.0])
    return (
        np.where(fixed, one, np.column_stack(value)),
        np.where(fixed, 0.0, np.column_stack(slope)),
        np.where(fixed, 0.0, np.column_stack(bend)),
    )


def build_local_costs(nodes: TiltNodes, limits: TiltLimits, rows: NDArray[np.intp], cost: Array) -> LocalCosts:
    """Return the parabolas through the index of the tilts of a grid.

    Args:
        nodes: tilts of the grid.
        limits: permitted tilts.
        rows: (M,) planning points.
        cost: (M, K) index of each tilt in units of c₀, inf where there is no configuration.
    """
    known = np.isfinite(cost)
    top = np.where(known, cost, -np.inf).max(axis=1)
    use = known.any(axis=1) & limits.is_free[rows]
    filled = np.where(known, cost, top[:, None] + BLOCKED)[use]
    return LocalCosts(
        rows=rows[use],
        frame=nodes.frame[rows[use]],
        levels=nodes.levels[rows[use]],
        values=filled[:, nodes.number],
    )


def price_tilts(plan: Plan, nodes: TiltNodes, rows: NDArray[np.intp], phi: Array, seed: Array) -> Array:
    """Return the index (M, K) of each tilt at some planning points in units of c₀, inf without a configuration.

    Args:
        plan: plan of the path.
        nodes: tilts of the grid.
        rows: (M,) planning points.
        phi: (P,) rad, rotation.
        seed: (P, 6) rad, joints near those of every tilt.
    """
    path, setup = plan.path.programmed, plan.setup
    own = np.full_like(seed, np.nan)
    own[rows] = seed[rows]
    out = np.full((len(rows), len(nodes.tangent)), np.inf)
    for k, tangent in enumerate(nodes.tangent):
        tilted = tilt_path(path, normalise_vectors(path.axis + tangent), setup.ball_radius)
        found = solve_joint_path(tilted, setup.arm, setup.robot, phi, own)
        ok = np.flatnonzero(found.reason[rows] == InfeasibilityReason.OK)
        at = rows[ok]
        cost = compute_configuration_cost(setup.elasticity, plan.directions, at, found.q[at], plan.scores.index)
        out[ok, k] = cost / plan.scores.scale
    return out
