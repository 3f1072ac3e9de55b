"""What the uncertainty of the identified stiffness makes of a result: of a point's deflection, and of the gain.

The joint compliances c scatter about the file's values with covariance Σ: those of the constant model as the file's
``covariance``, those of each grid cell by its standard uncertainties, cells and joints independent, all points of one
cell with the same error. To first order a result y scatters by

    σ² = gᵀ Σ g,   g = ∂y/∂c

Two ways to drive a path share the same compliances, so most of the error cancels in their gain
G = 1 − mean(c₁)/mean(c₂), whose gradient is −∂mean₁/mean₂ + mean₁ ∂mean₂/mean₂². The parameters of ``terms`` carry no
uncertainty in the file and count as exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.options import Index
from machopt.domain.reason import Reason
from machopt.domain.stiffness import Stiffness
from machopt.model.elastic import ArmElasticity, cells_at
from machopt.plan.score import Directions

if TYPE_CHECKING:
    from machopt.plan.pipeline import Plan, Scored

NINETY = 1.6448536269514722  # half-width of the 90 % interval of a normal distribution, in σ
NONE = 1e-4  # of the mean: a smaller difference is rounding of the smoothing, not a gain


@dataclass(frozen=True)
class Spread:
    """Compliances in blocks of six: block 0 the constant model's, block 1 + n those of grid cell n.

    ``rows``, ``blocks`` and ``share`` say what the joints of a point are made of, ∂c_point/∂c_block per joint.
    """

    covariance: Array  # (B, 6, 6) (rad/(N·m))², NaN where the file does not say
    rows: NDArray[np.int64]  # (E,) point
    blocks: NDArray[np.int64]  # (E,)
    share: Array  # (E, 6)

    @classmethod
    def of(cls, stiffness: Stiffness, position: Array) -> Spread:
        """Args: position (M, 3) m of the TCP in base_link."""
        grid, everywhere = stiffness.grid, np.arange(len(position))
        constant = np.full((6, 6), np.nan) if stiffness.covariance is None else stiffness.covariance
        if grid is None:
            return cls(constant[None], everywhere, np.zeros(len(position), np.int64), np.ones((len(position), 6)))
        cells = np.full((len(grid.joints), 6, 6), np.nan)
        if grid.std is not None:
            cells = (grid.std / grid.joints**2)[:, :, None] ** 2 * np.eye(6)  # of 1/k
        rows, touched = cells_at(grid, position)
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
        """The file says anything at all about uncertainty."""
        return bool(np.isfinite(self.covariance).all(axis=(1, 2)).any())

    def gradient(self, weight: Array, by_point: Array) -> Array:
        """(B, 6) gradient of Σ weight·y from each point's own gradient (M, 6) in its effective compliances."""
        out = np.zeros((len(self.covariance), 6))
        np.add.at(out, self.blocks, self.share * weight[self.rows, None] * by_point[self.rows])
        return out

    def std(self, gradient: Array) -> float:
        """√(gᵀ Σ g) of one quantity with gradient (B, 6); NaN where it rests on a compliance of unknown uncertainty."""
        used = np.flatnonzero(gradient.any(axis=1))
        g = gradient[used]
        return float(np.sqrt(max(np.einsum("bi,bij,bj->", g, self.covariance[used], g), 0.0)))

    def point_std(self, by_point: Array) -> Array:
        """(M,) √(gᵀ Σ g) of one quantity a point with gradients (M, 6)."""
        g = self.share * by_point[self.rows]
        variance = np.einsum("ei,eij,ej->e", g, self.covariance[self.blocks], g)
        return np.sqrt(np.maximum(np.bincount(self.rows, variance, len(by_point)), 0.0))


@dataclass(frozen=True)
class Gain:
    """By how much the mean index as a cost is less than with a yardstick."""

    over: str  # "cam default" or "jiao2022"
    mean: float  # 1 − mean / mean of the yardstick; NaN where that one cannot be driven
    std: float  # 1 σ from the stiffness alone, NaN where the file does not say

    @property
    def interval(self) -> tuple[float, float]:
        """The 90 % interval."""
        return self.mean - NINETY * self.std, self.mean + NINETY * self.std

    @property
    def distinguishable(self) -> bool:
        """More than NONE, and the 90 % interval leaves out zero where an uncertainty is known."""
        return not (abs(self.mean) <= NONE or abs(self.mean) <= NINETY * self.std)


def cost_gradient(
    elasticity: ArmElasticity, d: Directions, points: NDArray[np.integer[Any]], q: Array, index: Index
) -> Array:
    """∂cost/∂c (M, 6) in the joints' effective compliances, of :func:`machopt.plan.score.configuration_cost`."""
    elastic = elasticity.at(q, d.k[points])
    if index == "deflection":
        bend = elastic.deflection(d.force[points])
        size = np.linalg.norm(bend, axis=-1, keepdims=True)
        return elastic.sensitivity(d.force[points], bend / np.maximum(size, np.finfo(float).tiny))
    if index == "jiao2022":
        return elastic.jiao_sensitivity(d.axial[points])
    axial, normal = (elastic.sensitivity(e[points], e[points], small=True) for e in (d.axial, d.normal))
    return np.asarray(np.where(d.drilling[points][:, None], axial, 0.5 * (axial + normal)))


def spread_of(plan: Plan) -> Spread:
    """What the joints at the planning points are made of."""
    programmed = plan.path.position
    if plan.compensation is not None:
        programmed = programmed - plan.compensation.offset
    return Spread.of(plan.setup.elasticity.stiffness, plan.setup.arm.places(plan.path.external, programmed))


def gains(plan: Plan) -> tuple[Gain, ...]:
    """Gain of the chosen path over the CAM's default rotation and over jiao2022, with its uncertainty."""
    spread = spread_of(plan.parts[0].plan if plan.parts else plan)  # of the same compliances everywhere
    own = _whole_mean(plan, lambda p: p.chosen)
    out = []
    yardsticks: tuple[tuple[str, Callable[[Plan], Scored]], ...] = (
        ("cam default", lambda p: p.cam_default),
        ("jiao2022", lambda p: p.jiao2022),
    )
    for name, yardstick in yardsticks:
        other = _whole_mean(plan, yardstick)  # by the same lengths, as their objectives
        if own is None or other is None:
            out.append(Gain(name, float("nan"), float("nan")))
            continue
        (a, ga), (b, gb) = own, other
        std = spread.std(-ga / b + a / b**2 * gb) if spread.known else float("nan")
        out.append(Gain(name, 1.0 - a / b, std))
    return tuple(out)


def _whole_mean(plan: Plan, of: Callable[[Plan], Scored]) -> tuple[float, Array] | None:
    """:func:`_mean` of a whole job: of its stretches by their shares of the length cut."""
    if not plan.parts:
        return _mean(plan, of(plan), plan.path.weight, spread_of(plan))
    total, gradient = 0.0, np.zeros(())
    for part in plan.parts:
        if not part.plan.path.counted.any():
            continue
        found = _mean(part.plan, of(part.plan), part.plan.path.weight, spread_of(part.plan))
        if found is None:
            return None
        total, gradient = total + part.share * found[0], gradient + part.share * found[1]
    return (total, gradient) if total > 0 else None


def _mean(plan: Plan, scored: Scored, weight: Array, spread: Spread) -> tuple[float, Array] | None:
    """Mean cost by ``weight`` (P,), and its gradient (B, 6); None where it cannot be driven in or near the part."""
    rows = np.flatnonzero(plan.path.counted)
    if not len(rows) or (scored.assignment.reason[plan.path.may_touch] != Reason.OK).any():
        return None
    gradient = np.zeros((len(plan.path.index), 6))
    q = scored.assignment.q[rows]
    gradient[rows] = cost_gradient(plan.setup.elasticity, plan.directions, rows, q, plan.scores.index)
    mean = float(weight[rows] @ scored.cost[rows])
    return (mean, spread.gradient(weight, gradient)) if mean > 0 else None
