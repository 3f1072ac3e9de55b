"""Uncertainty of results from the uncertainty of the identified stiffness: of a point's deflection, and of the gain.

The joint compliances c scatter about the file's values with covariance Σ: those of the constant model as the file's
``covariance``, those of each grid cell by its standard uncertainties, cells and joints independent, all points of one
cell with the same error. To first order a result y scatters by

    σ² = gᵀ Σ g,   g = ∂y/∂c

Two plans of a path share the same compliances, so most of the error cancels in their gain
G = 1 − mean(c₁)/mean(c₂), whose gradient is −∂mean₁/mean₂ + mean₁ ∂mean₂/mean₂². Where the file states its model
discrepancy (``discrepancy``), that replaces the constant model's covariance
(:mod:`machopt.planning.error_probability.model_discrepancy`). Otherwise the parameters of ``terms`` have no
uncertainty in the file and count as exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import StiffnessIndex
from machopt.data_types.stiffness import ArmStiffness
from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import LoadDirections, compute_load_directions
from machopt.planning.error_probability.model_discrepancy import (
    NINETY,
    DiscrepancyModel,
    compute_reported_std,
    compute_unshared_variance,
)
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment, fix_external_axes
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.joint_stiffness import find_grid_cells

ROWS = 4096  # planning points per block: the discrepancy has dozens of columns
NONE = 1e-4  # share of the mean: a smaller difference is numerical, not a gain


@dataclass(frozen=True)
class ComplianceCovariance:
    """Covariance of compliances in blocks of six: block 0 the constant model's, block 1 + n those of grid cell n.

    ``rows``, ``blocks`` and ``share`` describe how the joints of a point depend on the blocks, ∂c_point/∂c_block per
    joint.
    """

    covariance: Array  # (B, 6, 6) (rad/(N·m))², NaN where the file states none
    rows: NDArray[np.int64]  # (E,) point
    blocks: NDArray[np.int64]  # (E,)
    share: Array  # (E, 6)

    @classmethod
    def build(cls, stiffness: ArmStiffness, position: Array) -> ComplianceCovariance:
        """Return the covariance at some TCP positions.

        Args:
            stiffness: stiffness model of the arm.
            position: (M, 3) m of the TCP in base_link.
        """
        grid, everywhere = stiffness.grid, np.arange(len(position))
        constant = np.full((6, 6), np.nan) if stiffness.covariance is None else stiffness.covariance
        if stiffness.discrepancy is not None:  # includes the joints
            constant = np.zeros((6, 6))
        if grid is None:
            return cls(constant[None], everywhere, np.zeros(len(position), np.int64), np.ones((len(position), 6)))
        cells = np.full((len(grid.joints), 6, 6), np.nan)
        if grid.std is not None:
            cells = (grid.std / grid.joints**2)[:, :, None] ** 2 * np.eye(6)  # of 1/k
        rows, touched = find_grid_cells(grid, position)
        count = np.bincount(rows, minlength=len(position))
        outside = everywhere[count == 0]
        # stiffnesses are averaged on shared faces: c = n / Σ 1/c_i, so ∂c/∂c_i = c² k_i² / n
        total = np.zeros((len(position), 6))
        np.add.at(total, rows, grid.joints[touched])
        share = count[rows, None] * (grid.joints[touched] / total[rows]) ** 2
        return cls(
            np.concatenate([constant[None], cells]),
            np.concatenate([rows, outside]),
            np.concatenate([touched + 1, np.zeros(len(outside), np.int64)]),
            np.concatenate([share, np.ones((len(outside), 6))]),
        )

    @property
    def known(self) -> bool:
        """Whether the file states any uncertainty."""
        return bool(np.isfinite(self.covariance).all(axis=(1, 2)).any())

    def gradient(self, weight: Array, by_point: Array) -> Array:
        """Return the (B, 6) gradient of Σ weight·y.

        Args:
            weight: (M,) weight of each point.
            by_point: (M, 6) gradient of each point's y in its effective compliances.
        """
        out = np.zeros((len(self.covariance), 6))
        np.add.at(out, self.blocks, self.share * weight[self.rows, None] * by_point[self.rows])
        return out

    def std(self, gradient: Array) -> float:
        """Return √(gᵀ Σ g) of one quantity; NaN where it depends on a compliance of unknown uncertainty.

        Args:
            gradient: (B, 6).
        """
        used = np.flatnonzero(gradient.any(axis=1))
        g = gradient[used]
        return float(np.sqrt(max(np.einsum("bi,bij,bj->", g, self.covariance[used], g), 0.0)))

    def point_std(self, by_point: Array) -> Array:
        """Return (M,) √(gᵀ Σ g) of one quantity per point.

        Args:
            by_point: (M, 6) gradients.
        """
        g = self.share * by_point[self.rows]
        variance = np.einsum("ei,eij,ej->e", g, self.covariance[self.blocks], g)
        return np.sqrt(np.maximum(np.bincount(self.rows, variance, len(by_point)), 0.0))


@dataclass(frozen=True)
class IndexGain:
    """Reduction of the mean index (as a cost) compared with a baseline."""

    over: str  # "cam default" or "jiao2022"
    mean: float  # 1 − mean / mean of the baseline; NaN where the baseline cannot be driven
    std: float  # 1 σ from the stiffness alone, NaN where the file states none

    @property
    def interval(self) -> tuple[float, float]:
        """The 90 % interval."""
        return self.mean - NINETY * self.std, self.mean + NINETY * self.std

    @property
    def distinguishable(self) -> bool:
        """Whether it is more than NONE, and the 90 % interval excludes zero where an uncertainty is known."""
        return not (abs(self.mean) <= NONE or abs(self.mean) <= NINETY * self.std)


def compute_cost_gradient(
    elasticity: ArmElasticity, d: LoadDirections, points: NDArray[np.integer[Any]], q: Array, index: StiffnessIndex
) -> Array:
    """Return ∂cost/∂c (M, 6) in the joints' effective compliances, of
    :func:`machopt.planning.cost.stiffness_index.compute_configuration_cost`.

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
        return elastic.compute_sensitivity(d.force[points], bend / np.maximum(size, np.finfo(float).tiny))
    if index == "jiao2022":
        return elastic.compute_jiao_sensitivity(d.axial[points])
    axial, normal = (elastic.compute_sensitivity(e[points], e[points], small=True) for e in (d.axial, d.normal))
    return np.asarray(np.where(d.drilling[points][:, None], axial, 0.5 * (axial + normal)))


def compute_carrier_sensitivity(
    elasticity: ArmElasticity, d: LoadDirections, points: NDArray[np.integer[Any]], q: Array, index: StiffnessIndex
) -> Array:
    """Return the (M, K) change of a configuration's cost by 1 σ of each external joint's stiffness, to first order.

    Args:
        elasticity: compliance model of the arm.
        d: directions and force per planning point.
        points: (M,) planning points.
        q: (M, 6) rad.
        index: stiffness index.
    """
    if d.unsure is None or not d.unsure.shape[1]:
        return np.zeros((len(points), 0))
    s = d.unsure[points]

    def along(e: Array, f: Array) -> Array:
        return np.asarray(np.einsum("mkc,mc->mk", s[..., :3], e) * np.einsum("mkc,mc->mk", s[..., :3], f))

    axial, normal = d.axial[points], d.normal[points]
    if index == "deflection":
        bend = d.elastic(elasticity, q, points).compute_deflection(d.force[points])
        size = np.linalg.norm(bend, axis=-1, keepdims=True)
        return along(bend / np.maximum(size, np.finfo(float).tiny), d.force[points])
    if index == "jiao2022":
        return d.elastic(elasticity, q, points).compute_jiao_sensitivity(axial, np.swapaxes(s, 1, 2))
    out, normal_part = along(axial, axial), along(normal, normal)
    return np.asarray(np.where(d.drilling[points][:, None], out, 0.5 * (out + normal_part)))


def build_compliance_covariance(plan: Plan) -> ComplianceCovariance:
    """Return the compliance covariance at the planning points.

    Args:
        plan: plan of one tool.
    """
    place = plan.setup.arm.places(plan.path.external, plan.path.without_shift.position)
    return ComplianceCovariance.build(plan.setup.elasticity.stiffness, place)


@dataclass(frozen=True)
class UncertainCost:
    """A cost, or a mean of costs, with its dependence on uncertain quantities."""

    value: Any  # (...,)
    by_springs: Array  # gradient of a mean (B, 6); of points (P, 6) in the point's compliances
    by_doubt: Array | None  # (..., 1 + R), None where the file has no discrepancy
    own: Any = 0.0  # (...,) 1 σ of single poses
    by_carriers: Array = field(
        default_factory=lambda: np.zeros(0)
    )  # (..., K) by 1 σ of each external joint's stiffness

    def times(self, share: float) -> UncertainCost:
        """Return the cost scaled by a factor.

        Args:
            share: factor.
        """
        by_doubt = None if self.by_doubt is None else share * self.by_doubt
        return UncertainCost(
            share * self.value, share * self.by_springs, by_doubt, share * self.own, share * self.by_carriers
        )

    def plus(self, more: UncertainCost) -> UncertainCost:
        """Return the sum of two costs that depend on the same stiffness.

        Args:
            more: the other cost.
        """
        by_doubt = None if self.by_doubt is None or more.by_doubt is None else self.by_doubt + more.by_doubt
        return UncertainCost(
            self.value + more.value,
            self.by_springs + more.by_springs,
            by_doubt,
            self.own + more.own,
            self.by_carriers + more.by_carriers,
        )


def compute_gains(plan: Plan) -> tuple[IndexGain, ...]:
    """Return the gain of the chosen path over the CAM's default rotation and over jiao2022, with its uncertainty.

    Args:
        plan: plan of a job or of one tool.
    """
    spread = build_compliance_covariance(plan.parts[0].plan if plan.parts else plan)  # the same compliances everywhere
    own = _compute_job_mean(plan, lambda p: p.chosen)
    out = []
    baselines: tuple[tuple[str, Callable[[Plan], ScoredAssignment]], ...] = (
        ("cam default", lambda p: p.cam_default),
        ("jiao2022", lambda p: p.jiao2022),
    )
    for name, baseline in baselines:
        other = _compute_job_mean(plan, baseline, at_home=True)  # with the same lengths, like their objectives
        if own is None or other is None:
            out.append(IndexGain(name, float("nan"), float("nan")))
            continue
        parted = compute_unshared_variance(plan.chosen.assignment.q, baseline(plan).assignment.q, plan.path.weight)
        out.append(IndexGain(name, 1.0 - own.value / other.value, _compute_gain_std(own, other, spread, parted)))
    return tuple(out)


def _compute_job_mean(
    plan: Plan, of: Callable[[Plan], ScoredAssignment], *, at_home: bool = False
) -> UncertainCost | None:
    """Return :func:`_compute_mean` of a whole job: of its stretches by their shares of the length cut.

    Args:
        at_home: the external joints are at home, as for the baselines.
    """

    def mean(part: Plan) -> UncertainCost | None:
        there = _place_at_home(part) if at_home else part
        return _compute_mean(there, of(part), part.path.weight, build_compliance_covariance(there))

    if not plan.parts:
        return mean(plan)
    total: UncertainCost | None = None
    for part in plan.parts:
        if not part.plan.path.counted.any():
            continue
        found = mean(part.plan)
        if found is None:
            return None
        total = found.times(part.share) if total is None else total.plus(found.times(part.share))
    return total


def _place_at_home(plan: Plan) -> Plan:
    """Return the plan's path and directions with the external joints at home."""
    if (plan.path.external == plan.setup.cell.external_home).all():
        return plan
    path, setup = fix_external_axes(plan.path, plan.setup.cell.external_home), plan.setup
    return replace(
        plan, path=path, directions=compute_load_directions(path, setup.arm, setup.elasticity, plan.options.force)
    )


def _compute_gain_std(
    uncertain_cost: UncertainCost, other: UncertainCost, spread: ComplianceCovariance, parted: float
) -> float:
    """``parted``: share of the variance of ``uncertain_cost`` that the two do not have in common."""
    if not spread.known:
        return float("nan")
    a, b = uncertain_cost.value, other.value
    by_arm = spread.std(-uncertain_cost.by_springs / b + a / b**2 * other.by_springs)
    by_springs = float(np.hypot(by_arm, np.linalg.norm(-uncertain_cost.by_carriers / b + a / b**2 * other.by_carriers)))
    if uncertain_cost.by_doubt is None or other.by_doubt is None:
        return by_springs
    ma, mb = uncertain_cost.by_doubt, other.by_doubt
    there, here = max(a + ma[0], 0.0), max(b + mb[0], 0.1 * b)  # means with the discrepancy included
    ways = -ma / here + there / here**2 * mb
    ways[0] = (1.0 - there / here) - (1.0 - a / b)
    alone = parted * (uncertain_cost.own**2 + (there / here * other.own) ** 2) / here**2
    return float(compute_reported_std(ways, by_springs**2 + alone))


def _compute_mean(
    plan: Plan, scored: ScoredAssignment, weight: Array, spread: ComplianceCovariance
) -> UncertainCost | None:
    """Return the mean cost by ``weight`` (P,); None where a point in or near the part is infeasible."""
    rows = np.flatnonzero(plan.path.counted)
    if not len(rows) or (scored.assignment.reason[plan.path.may_touch] != InfeasibilityReason.OK).any():
        return None
    points = _compute_point_costs(plan, scored)
    mean = float(weight[rows] @ scored.cost[rows])
    if not mean > 0:
        return None
    by_doubt = None if points.by_doubt is None else weight @ points.by_doubt
    springs = spread.gradient(weight, points.by_springs)
    return UncertainCost(mean, springs, by_doubt, float(weight @ points.own), weight @ points.by_carriers)


def _compute_point_costs(plan: Plan, scored: ScoredAssignment) -> UncertainCost:
    """Cost of each planning point that is cut, zero elsewhere."""
    P, index = len(plan.path.index), plan.scores.index
    rows = np.flatnonzero(plan.path.counted & (scored.assignment.reason == InfeasibilityReason.OK))
    elasticity, doubt = plan.setup.elasticity, DiscrepancyModel.build(plan.setup.elasticity)
    by_springs, own = np.zeros((P, 6)), np.zeros(P)
    by_doubt = None if doubt is None else np.zeros((P, len(doubt.ways)))
    carriers = np.zeros((P, 0 if plan.directions.unsure is None else plan.directions.unsure.shape[1]))
    for first in range(0, len(rows), ROWS):
        some = rows[first : first + ROWS]
        q = scored.assignment.q[some]
        by_springs[some] = compute_cost_gradient(elasticity, plan.directions, some, q, index)
        carriers[some] = compute_carrier_sensitivity(elasticity, plan.directions, some, q, index)
        if doubt is not None and by_doubt is not None:
            by_doubt[some] = doubt.cost(elasticity, plan.directions, some, q, index)
            own[some] = doubt.own(plan.directions, some, index)
    return UncertainCost(scored.cost, by_springs, by_doubt, own, carriers)
