"""Model discrepancy of the stiffness file (``discrepancy``), propagated to a plan: error of a predicted deflection.

Where the mean is included in the model (``counted`` of the file), a number scatters about the predicted value, and 1 σ
is that. Otherwise:
A model's errors (x, u) have mean μ and covariance Σ mᵀ m
(:mod:`machopt.measurement.identification.assessment.model_discrepancy`). A result y changes by
b = g·μ in the mean and scatters by s² = Σ (g·m)², g its gradient. Around the number of the model, which is off by b
itself, the interval that contains the true value with 90 % has the half-width h with

    Φ((h − b)/s) − Φ((−h − b)/s) = 0.9

which is 1.645 s without discrepancy, and b + 1.28 s where b is larger than s. The reported standard deviation is
h/1.645, so that every reader's interval is this one.

``local`` is a compliance that belongs to one pose alone. Along one motion it counts as constant,
and two motions share it by how near their poses are, exp(−Δ²/2) with Δ the mean distance of their joints over NEAR.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import StiffnessIndex
from machopt.data_types.stiffness import ArmStiffness
from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.stiffness.arm_stiffness import ArmElasticity, ElasticState
from machopt.stiffness.discrepancy_columns import DiscrepancyColumns

NINETY = 1.6448536269514722  # half-width of the 90 % interval of a normal distribution, in σ
NEAR = 0.5  # rad; correlation length between poses: shorter variations would be visible in readings
HALVINGS = 60  # of the bracket of h


@dataclass(frozen=True)
class DiscrepancyModel:
    """Possible errors of the stiffness model: row 0 is the mean (zero where it is included in the model), the others
    1 σ each.
    """

    suspects: DiscrepancyColumns
    ways: Array  # (1 + R, K)
    local: float = 0.0  # m/N per coordinate, error of single poses, 1 σ

    @classmethod
    def build(cls, elasticity: ArmElasticity) -> DiscrepancyModel | None:
        """Return the model from the file's discrepancy; None where there is none.

        Args:
            elasticity: compliance model of the arm.
        """
        d = elasticity.stiffness.discrepancy
        if d is None:
            return None
        suspects = DiscrepancyColumns(
            robot=elasticity.robot,
            T_flange_tcp=elasticity.T_flange_tcp,
            names=d.parts,
            torque=d.torque,
            terms=elasticity.terms,
            masses=elasticity.masses,
            geometric=elasticity.geometric,
        )
        off = d.shift if elasticity.shift is None else np.zeros_like(d.shift)  # otherwise it is included in the model
        return cls(suspects, np.concatenate([off[None], d.modes]), d.local)

    @classmethod
    def of_springs(cls, elasticity: ArmElasticity) -> DiscrepancyModel | None:
        """Return the model of joint springs that only scatter, from a file's ``covariance``; None without one, or with
        a grid.

        Args:
            elasticity: compliance model of the arm.
        """
        stiffness: ArmStiffness = elasticity.stiffness
        if stiffness.covariance is None or stiffness.grid is not None:
            return None
        values, vectors = np.linalg.eigh(stiffness.covariance)
        modes = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        names = tuple(f"joint {j}" for j in range(1, 7))
        suspects = DiscrepancyColumns(
            robot=elasticity.robot,
            T_flange_tcp=elasticity.T_flange_tcp,
            names=names,
            torque=np.ones(6),
            masses=elasticity.masses,
        )
        return cls(suspects, np.concatenate([np.zeros((1, 6)), modes]))

    def moves(self, elastic: ElasticState, q: Array, force: Array, *, small: bool = False) -> Array:
        """Return the (M, 3, 1 + R) additional TCP displacement in m of each error.

        Args:
            elastic: elastic state of the configurations.
            q: (M, 6) rad.
            force: (M, 3) N in base_link.
            small: use the compliance of a small load.
        """
        return self.compute_twist(elastic, q, np.concatenate([force, np.zeros_like(force)], axis=1), small=small)[:, :3]

    def compute_twist(self, elastic: ElasticState, q: Array, wrench: Array, *, small: bool) -> Array:
        s = self.suspects
        state = s.robot.compute_state(q, s.T_flange_tcp, bodies=True)
        gears = elastic.k if elastic.gears is None else elastic.gears
        return np.asarray(s.compute_columns(state, gears, wrench, small=small) @ self.ways.T)

    def cost(
        self,
        elasticity: ArmElasticity,
        d: LoadDirections,
        points: NDArray[np.integer[Any]],
        q: Array,
        index: StiffnessIndex,
    ) -> Array:
        """Return the (M, 1 + R) change of a configuration's cost by each error, to first order.

        Args:
            elasticity: compliance model of the arm.
            d: directions and force per planning point.
            points: (M,) planning points.
            q: (M, 6) rad.
            index: stiffness index.
        """
        elastic = d.elastic(elasticity, q, points)
        if index == "deflection":
            bend = elastic.compute_deflection(d.force[points])
            size = np.linalg.norm(bend, axis=-1, keepdims=True)
            e = bend / np.maximum(size, np.finfo(float).tiny)
            return self._compute_change_along(elastic, q, d.force[points], e, small=False)
        axial = d.axial[points]
        if index == "jiao2022":
            return self._compute_held_change(elastic, q, axial)
        normal = d.normal[points]
        out, normal_change = (self._compute_change_along(elastic, q, e, e, small=True) for e in (axial, normal))
        return np.asarray(np.where(d.drilling[points][:, None], out, 0.5 * (out + normal_change)))

    def own(self, d: LoadDirections, points: NDArray[np.integer[Any]], index: StiffnessIndex) -> Array:
        """Return the (M,) 1 σ of a cost from the error of single poses.

        Args:
            d: directions and force per planning point.
            points: (M,) planning points.
            index: stiffness index.
        """
        if index != "deflection":  # a compliance
            return np.full(len(points), self.local)
        return np.asarray(self.local * np.linalg.norm(d.force[points], axis=1))

    def axial(self, elastic: ElasticState, q: Array, e: Array) -> Array:
        """Return the (M, 1 + R) change of eᵀ C e in m/N for a small load.

        Args:
            elastic: elastic state of the configurations.
            q: (M, 6) rad.
            e: (M, 3) unit directions in base_link.
        """
        return self._compute_change_along(elastic, q, e, e, small=True)

    def _compute_change_along(self, elastic: ElasticState, q: Array, force: Array, e: Array, *, small: bool) -> Array:
        return np.asarray(np.einsum("mc,mcr->mr", e, self.moves(elastic, q, force, small=small)))

    def _compute_held_change(self, elastic: ElasticState, q: Array, e: Array) -> Array:
        """Return the change of 1/k_x of jiao2022, see
        :meth:`machopt.stiffness.arm_stiffness.ElasticState.compute_jiao_sensitivity`.
        """
        C = elastic.compute_compliance()
        P = np.concatenate(
            [
                np.broadcast_to(np.eye(3), (len(C), 3, 3)),
                -np.swapaxes(np.linalg.solve(C[:, 3:, 3:], C[:, 3:, :3]), 1, 2),
            ],
            axis=2,
        )
        S = P @ C @ np.swapaxes(P, 1, 2)
        Se = np.einsum("mij,mj->mi", S, e)
        SSe = np.einsum("mij,mj->mi", S, Se)
        SSSe = np.einsum("mij,mj->mi", S, SSe)
        out = np.zeros((len(C), len(self.ways)))
        for load, by in ((Se, SSe), (e, SSSe)):  # (S² e)ᵀ (∂S S + S ∂S) e, ∂S = P ∂C Pᵀ
            wrench = np.einsum("mci,mc->mi", P, load)
            twist = self.compute_twist(elastic, q, wrench, small=True)
            out += np.einsum("mc,mci,mir->mr", by, P, twist)
        return np.asarray(0.5 * np.linalg.norm(SSe, axis=1)[:, None] ** -1.5 * out)


def compute_unshared_variance(q: Array, other: Array, weight: Array) -> float:
    """Return the share of the variance of ``local`` that two motions do not have in common.

    Args:
        q: (P, 6) rad, first motion.
        other: (P, 6) rad, second motion.
        weight: (P,) weight of each point.
    """
    rows = np.flatnonzero((weight > 0) & np.isfinite(q).all(axis=1) & np.isfinite(other).all(axis=1))
    turned = np.arctan2(np.sin(q[rows] - other[rows]), np.cos(q[rows] - other[rows]))
    distance = float(weight[rows] @ np.linalg.norm(turned, axis=1)) / max(float(weight[rows].sum()), 1e-300)
    return float(1.0 - np.exp(-0.5 * (distance / NEAR) ** 2))


def compute_half_width(shift: Array, sigma: Array) -> Array:
    """Return h of the 90 % interval ± h about a number with a bias and a scatter.

    Args:
        shift: (…,) bias of the number.
        sigma: (…,) standard deviation.
    """
    from scipy.special import ndtr  # imported here: not needed without discrepancy or covariance

    b, s = np.abs(np.asarray(shift, float)), np.maximum(np.asarray(sigma, float), np.finfo(float).tiny)
    low, high = np.zeros_like(b), b + NINETY * s
    for _ in range(HALVINGS):
        h = 0.5 * (low + high)
        enough = ndtr((h - b) / s) - ndtr((-h - b) / s) >= 0.9
        low, high = np.where(enough, low, h), np.where(enough, h, high)
    return np.asarray(high)


def compute_reported_std(ways: Array, added_variance: Array | float = 0.0) -> Array:
    """Return the reported 1 σ of results.

    Args:
        ways: (..., 1 + R) change of the result by each error.
        added_variance: additional variance.
    """
    sigma = np.sqrt(np.sum(ways[..., 1:] ** 2, axis=-1) + added_variance)
    return compute_half_width(ways[..., 0], sigma) / NINETY
