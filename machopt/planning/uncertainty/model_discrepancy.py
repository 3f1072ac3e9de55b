"""What the file says of its own misfit (``discrepancy``), carried to a plan: how far a deflection may be from the said.

Where the mean is counted in (``counted`` of the file), a number scatters about what is said, and 1 σ is that. Else:

A model's errors (x, u) have mean μ and covariance Σ mᵀ m
(:mod:`machopt.measurement.identification.assessment.model_discrepancy`). A result y changes by
b = g·μ in the mean and scatters by s² = Σ (g·m)², g its gradient. Around the number of the model, which is off by b
itself, the interval that holds the truth with 90 % has the half-width h with

    Φ((h − b)/s) − Φ((−h − b)/s) = 0.9

which is 1.645 s without misfit, and b + 1.28 s where b is larger than s. What is told as one standard deviation is
h/1.645, so that every reader's interval is this one.

``local`` is a compliance that belongs to one pose alone: along one motion it counts as the same everywhere,
and two motions share it by how near their poses are, exp(−Δ²/2) with Δ the mean distance of their joints over NEAR.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import StiffnessIndex
from machopt.data_types.stiffness import ArmStiffness
from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.stiffness.arm_stiffness import ArmElasticity, ElasticState
from machopt.stiffness.discrepancy_columns import DiscrepancyColumns

if TYPE_CHECKING:
    from machopt.planning.pipeline.planning_setup import PlanningSetup

NINETY = 1.6448536269514722  # half-width of the 90 % interval of a normal distribution, in σ
NEAR = 0.5  # rad; poses farther apart than that are others: what comes and goes over less, readings would show
HALVINGS = 60  # of the bracket of h


@dataclass(frozen=True)
class DiscrepancyModel:
    """Ways in which the arm may differ from its stiffness: row 0 by how much in the mean (zero where that
    is counted in), the others 1 σ each."""

    suspects: DiscrepancyColumns
    ways: Array  # (1 + R, K)
    local: float = 0.0  # m/N of a coordinate, one pose's own, 1 σ

    @classmethod
    def of(cls, elasticity: ArmElasticity) -> DiscrepancyModel | None:
        """None where the file holds no discrepancy."""
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
        off = d.shift if elasticity.shift is None else np.zeros_like(d.shift)  # else it is counted in
        return cls(suspects, np.concatenate([off[None], d.modes]), d.local)

    @classmethod
    def of_springs(cls, elasticity: ArmElasticity) -> DiscrepancyModel | None:
        """The same of joints that only scatter, from a file's ``covariance``; None where there is none, or a grid."""
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
        """(M, 3, 1 + R) m how far the TCP moves more than the model says, under forces (M, 3) N at q (M, 6)."""
        return self._twist(elastic, q, np.concatenate([force, np.zeros_like(force)], axis=1), small=small)[:, :3]

    def _twist(self, elastic: ElasticState, q: Array, wrench: Array, *, small: bool) -> Array:
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
        """(M, 1 + R) by how much each way changes a configuration's cost, to first order."""
        elastic = d.elastic(elasticity, q, points)
        if index == "deflection":
            bend = elastic.compute_deflection(d.force[points])
            size = np.linalg.norm(bend, axis=-1, keepdims=True)
            e = bend / np.maximum(size, np.finfo(float).tiny)
            return self._along(elastic, q, d.force[points], e, small=False)
        axial = d.axial[points]
        if index == "jiao2022":
            return self._held(elastic, q, axial)
        normal = d.normal[points]
        out, beside = (self._along(elastic, q, e, e, small=True) for e in (axial, normal))
        return np.asarray(np.where(d.drilling[points][:, None], out, 0.5 * (out + beside)))

    def own(self, d: LoadDirections, points: NDArray[np.integer[Any]], index: StiffnessIndex) -> Array:
        """(M,) 1 σ of a cost by what each pose has for itself."""
        if index != "deflection":  # a compliance
            return np.full(len(points), self.local)
        return np.asarray(self.local * np.linalg.norm(d.force[points], axis=1))

    def axial(self, elastic: ElasticState, q: Array, e: Array) -> Array:
        """(M, 1 + R) m/N, change of eᵀ C e for a small load."""
        return self._along(elastic, q, e, e, small=True)

    def _along(self, elastic: ElasticState, q: Array, force: Array, e: Array, *, small: bool) -> Array:
        return np.asarray(np.einsum("mc,mcr->mr", e, self.moves(elastic, q, force, small=small)))

    def _held(self, elastic: ElasticState, q: Array, e: Array) -> Array:
        """Change of 1/k_x of jiao2022, see
        :meth:`machopt.stiffness.arm_stiffness.ElasticState.compute_jiao_sensitivity`."""
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
            twist = self._twist(elastic, q, wrench, small=True)
            out += np.einsum("mc,mci,mir->mr", by, P, twist)
        return np.asarray(0.5 * np.linalg.norm(SSe, axis=1)[:, None] ** -1.5 * out)


def compute_unshared_variance(q: Array, other: Array, weight: Array) -> float:
    """Share of its variance that ``local`` does not have in common between two motions (P, 6), weighed by (P,)."""
    rows = np.flatnonzero((weight > 0) & np.isfinite(q).all(axis=1) & np.isfinite(other).all(axis=1))
    turned = np.arctan2(np.sin(q[rows] - other[rows]), np.cos(q[rows] - other[rows]))
    distance = float(weight[rows] @ np.linalg.norm(turned, axis=1)) / max(float(weight[rows].sum()), 1e-300)
    return float(1.0 - np.exp(-0.5 * (distance / NEAR) ** 2))


def build_discrepancy_model(setup: PlanningSetup) -> DiscrepancyModel | None:
    """What is known of a setup's misfit."""
    return DiscrepancyModel.of(setup.elasticity)


def compute_half_width(shift: Array, sigma: Array) -> Array:
    """h of the 90 % interval ± h about a number that is off by ``shift`` in the mean and scatters by ``sigma``."""
    from scipy.special import ndtr  # only here: a stiffness without misfit or covariance does not wait for it

    b, s = np.abs(np.asarray(shift, float)), np.maximum(np.asarray(sigma, float), np.finfo(float).tiny)
    low, high = np.zeros_like(b), b + NINETY * s
    for _ in range(HALVINGS):
        h = 0.5 * (low + high)
        enough = ndtr((h - b) / s) - ndtr((-h - b) / s) >= 0.9
        low, high = np.where(enough, low, h), np.where(enough, h, high)
    return np.asarray(high)


def compute_reported_std(ways: Array, beside: Array | float = 0.0) -> Array:
    """What is told as 1 σ of results that change by ``ways`` (..., 1 + R), with a variance ``beside`` them."""
    sigma = np.sqrt(np.sum(ways[..., 1:] ** 2, axis=-1) + beside)
    return compute_half_width(ways[..., 0], sigma) / NINETY
