"""Share of the deflection that a compensation removes, with 90 % intervals: overall, per operation, and at the worst
point.

The shift is −d of the model. The arm bends by d + δ, where δ is the model discrepancy stated in the stiffness file
(:mod:`machopt.planning.error_probability.model_discrepancy`; a covariance alone counts as one). The residual at a
place is |offset + d + δ|. It is not linear in δ. Its distribution is sampled with DRAWS sets of normal numbers, the
same in every run. Without a discrepancy, δ is that of the springs' covariance, of their ``spread_percent`` or of the
grid's standard uncertainties. With a process, d + δ also scatters with the force of each operation.

An interval reaches from the model's own residual, at the 5th percentile of the deflection, to the 95th percentile of
the samples. The lower end follows from the model's own value because δ hardly ever reduces the residual, and because
only an upper bound of δ is well known. (Where the 5th percentile is below it, for example at corners, the percentile is
used.) Without δ only the model's own value is reported, and no interval.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.planning.compensation.shifted_path import SHARES, get_segment_force
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel
from machopt.planning.error_probability.random_draws import UncertaintyDraws, build_draws
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.process.binding.point_loads import compute_mean_wear
from machopt.stiffness.arm_stiffness import ElasticState

DRAWS = 200
POWER = 256  # next power of two
SEED = 20_231
BLOCK = 1024  # segments at a time
RULE = np.array([0.125, 0.25, 0.25, 0.25, 0.125])  # trapezoids over SHARES
Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class DeflectionRemoval:
    """Residual of the mean deflection over the cut part of a stretch; lengths in m."""

    label: str  # of the operation, empty for all of them
    bent: float  # mean deflection, by the model
    left: float  # mean distance of the bent tool from the programmed path, by the model
    worst: float  # greatest of those distances, by the model
    left90: Interval | None  # 90 % intervals; None where the stiffness file states no uncertainty
    worst90: Interval | None
    removed90: Interval | None  # of ``removed``

    @property
    def removed(self) -> float:
        """Removed share of the mean deflection, by the model; 0 where nothing bends."""
        return 1.0 - self.left / self.bent if self.bent > 0 else 0.0


def predict_removals(
    plan: Plan,
    operation: NDArray[np.int32],
    labels: tuple[str, ...],
    process_operation: NDArray[np.int32] | None = None,
) -> tuple[DeflectionRemoval, ...]:
    """Return the removal of the whole path first, then of each operation that is cut; empty without a compensation.

    Args:
        plan: compensated plan.
        operation: (N,) of each toolpath point, an index into ``labels``.
        labels: name of each operation.
        process_operation: (N,) operation of process.yaml of each toolpath point, −1 for none; None: no process.
    """
    if plan.compensation is None:
        return ()
    path, ok = plan.path, plan.chosen.assignment.reason == InfeasibilityReason.OK
    pushed = plan.directions.force[1:].any(axis=1)  # on the way out of a hole there is nothing to correct
    end = 1 + np.flatnonzero(path.counted[1:] & pushed & ok[1:] & ok[:-1] & (path.run[1:] == path.run[:-1]))
    if not len(end):
        return ()
    at = np.minimum(np.ceil(path.index[end] - 1e-9).astype(int), len(operation) - 1)
    group = operation[at]
    doubt = _DeflectionDraws.build(plan)
    draws = 1 if doubt is None else 1 + DRAWS  # the first is the model itself
    load = np.ones((len(end), draws))
    if doubt is not None and process_operation is not None:
        load[:, 1:] = doubt.draw_loads(plan, process_operation[at])
    length = np.linalg.norm(path.position[end] - path.position[end - 1], axis=1)
    if not length.sum() > 0:
        length = np.ones(len(end))
    left, bent = (np.zeros((len(labels), draws)) for _ in range(2))
    worst, length_cut = np.zeros((len(labels), draws)), np.bincount(group, length, len(labels))
    for first in range(0, len(end), BLOCK):
        some = slice(first, first + BLOCK)
        for share, rule in zip(SHARES, RULE, strict=True):
            for own, mine in plan.among(end[some]):
                rows = end[some][mine]
                shift, d = _draw_deflections(own, rows - (rows[0] - plan.at(int(rows[0]))[1]), share, doubt)
                d = d * load[some][mine][:, None]
                rest, whole = np.linalg.norm(shift[..., None] + d, axis=1), np.linalg.norm(d, axis=1)
                weight, to = rule * length[some][mine][:, None], group[some][mine]
                np.add.at(left, to, weight * rest)
                np.add.at(bent, to, weight * whole)
                np.maximum.at(worst, to, rest)
    cut = np.flatnonzero(length_cut > 0)
    parts = [_build_removal(labels[k], left[k] / length_cut[k], bent[k] / length_cut[k], worst[k]) for k in cut]
    total = length_cut.sum()
    return (_build_removal("", left.sum(axis=0) / total, bent.sum(axis=0) / total, worst.max(axis=0)), *parts)


@dataclass(frozen=True, kw_only=True)
class _DeflectionDraws:
    """DRAWS errors of the deflection at any place."""

    discrepancy: DiscrepancyModel | None  # None: the spread of the springs counts
    spread: StiffnessSpread
    factors: Array  # (R, DRAWS) of each error
    local: Array  # (3, DRAWS) m/N
    draws: UncertaintyDraws  # of the loads

    @classmethod
    def build(cls, plan: Plan) -> _DeflectionDraws | None:
        """Return the draws; None where the stiffness file states no uncertainty."""
        elasticity, limits = plan.setup.elasticity, plan.setup.cell.limits
        spread = StiffnessSpread.build(elasticity, (limits.lower[:6], limits.upper[:6]))
        found = DiscrepancyModel.build(elasticity) or DiscrepancyModel.of_springs(elasticity)
        if found is None and not spread.is_known:
            return None
        draws = build_draws(spread, POWER).take_first(DRAWS)
        rng = np.random.default_rng(SEED)
        if found is None:
            return cls(
                discrepancy=None,
                spread=spread,
                factors=draws.stiffness[:, 1:7].T,
                local=np.zeros((3, DRAWS)),
                draws=draws,
            )
        z = rng.normal(size=(len(found.ways) - 1, DRAWS))
        return cls(
            discrepancy=found,
            spread=spread,
            factors=z,
            local=found.local * rng.normal(size=(3, DRAWS)),
            draws=draws,
        )

    def compute_errors(self, elastic: ElasticState, q: Array, force: Array) -> Array:
        """Return (S, 3, DRAWS) m, what the deflection under a force (S, 3) in N differs from the model's."""
        if self.discrepancy is not None:
            moves = self.discrepancy.moves(elastic, q, force)
            away = moves[..., :1] + moves[..., 1:] @ self.factors
        else:
            wrench = np.hstack([force, np.zeros_like(force)])
            away = self.spread.compute_joint_columns(elastic, wrench)[:, :3] @ self.factors
        return np.asarray(away + np.linalg.norm(force, axis=1)[:, None, None] * self.local)

    def draw_loads(self, plan: Plan, operation: NDArray[np.int32]) -> Array:
        """Return (S, DRAWS) the load of segments relative to nominal; 1 at a clamp or without a process."""
        process, out = plan.setup.cell.process, np.ones((len(operation), DRAWS))
        if process is None:
            return out
        for k in np.unique(operation[operation >= 0]).tolist():
            one = process.operations[k]
            if not one.clamp > 0:
                out[operation == k] = self.draws.compute_load_factor(process, one) / compute_mean_wear(one)
        return out


def _draw_deflections(
    plan: Plan, end: NDArray[np.intp], share: float, doubt: _DeflectionDraws | None
) -> tuple[Array, Array]:
    """Return the (S, 3) shift and (S, 3, draws) deflections in base_link at one place of each segment that ends at
    ``end``.
    """
    assert plan.compensation is not None
    path, arm, q = plan.path, plan.setup.arm, plan.chosen.assignment.q
    between = q[end - 1] + share * (q[end] - q[end - 1])
    offset = plan.compensation.offset
    shift = arm.directions(path.external[end - 1], offset[end - 1] + share * (offset[end] - offset[end - 1]))
    force = get_segment_force(plan, end)
    elastic = plan.directions.elastic(plan.setup.elasticity, between, end - 1)
    d = elastic.compute_deflection(force)[..., None]
    if doubt is None:
        return shift, d
    return shift, np.concatenate([d, d + doubt.compute_errors(elastic, between, force)], axis=2)


def _build_removal(label: str, left: Array, bent: Array, worst: Array) -> DeflectionRemoval:
    out = DeflectionRemoval(
        label=label,
        bent=float(bent[0]),
        left=float(left[0]),
        worst=float(worst[0]),
        left90=None,
        worst90=None,
        removed90=None,
    )
    if len(left) == 1:
        return out
    share = 1.0 - left[1:] / np.maximum(bent[1:], np.finfo(float).tiny)
    least = min(float(np.quantile(bent[1:], 0.05)) / max(out.bent, np.finfo(float).tiny), 1.0)
    high = 1.0 - least * (1.0 - out.removed)  # of what is removed: what no shift removes grows with the deflection
    return replace(
        out,
        left90=_compute_ninety_interval(left[1:], least * out.left),
        worst90=_compute_ninety_interval(worst[1:], least * out.worst),
        removed90=(float(np.quantile(share, 0.05)), max(float(np.quantile(share, 0.95)), high)),
    )


def _compute_ninety_interval(values: Array, own: float) -> Interval:
    """Return the 90 % interval of a quantity that is better the smaller it is."""
    low, high = np.quantile(values, [0.05, 0.95])
    return min(float(low), own), float(high)
