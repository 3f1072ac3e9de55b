"""What a configuration costs: the index.

Cost c of a configuration, always "less is better":

==============  =======================================================  =====
index           c                                                        unit
==============  =======================================================  =====
deflection      |C_tt f|, the tip's displacement under the given force   m
stiffness       eᵀC_tt e along the tool axis (drilling), the mean of     m/N
                that and of the same along the path normal (milling)
jiao2022        1/k_x along the tool axis (eq. 23)                       m/N
==============  =======================================================  =====

c₀ is the median cost over the feasible candidates; :mod:`machopt.plan.cost.objective` weighs c/c₀ against motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.options import Index, PlanOptions, ProcessForce
from machopt.errors import InputError
from machopt.model.beside import Beside
from machopt.model.elastic import ArmElasticity, Elastic, joint_stiffness
from machopt.model.threads import side_by_side
from machopt.plan.configurations.candidates import Candidates, PlanningArm
from machopt.plan.cost.engagement import process_force, sideways
from machopt.plan.stations.path import Path
from machopt.se3 import wrap

CHUNK = 8_192  # configurations at a time


@dataclass(frozen=True, kw_only=True)
class Directions:
    """Directions and force per planning point, in base_link."""

    axial: Array  # (P, 3) tool axis, tip to shank
    normal: Array  # (P, 3) path normal: tool axis × travel
    force: Array  # (P, 3) N
    k: Array  # (P, 6) N·m/rad, joint stiffness at the TCP position
    in_grid: NDArray[np.bool_]  # (P,)
    drilling: NDArray[np.bool_]  # (P,)
    beside: Array | None = None  # (P, 6, 6) compliance at the TCP of what external joints give; None: they are rigid
    unsure: Array | None = (
        None  # (P, K, 6) of those whose stiffness has a σ: :meth:`machopt.model.beside.Beside.unsure`
    )

    def elastic(self, elasticity: ArmElasticity, q: Array, points: NDArray[np.integer[Any]]) -> Elastic:
        """The elasticity of configurations q (M, 6) rad at planning points (M,) where external joints are as there."""
        return elasticity.at(q, self.k[points], None if self.beside is None else self.beside[points])


@dataclass(frozen=True)
class Scores:
    """Cost of every candidate and the scale of the objective."""

    cost: Array  # (S, R, B), NaN where infeasible
    index: Index  # the index in force, never "auto"
    scale: float  # c₀
    crowded: Array | None = None  # (S, R, B) :func:`machopt.plan.cost.objective.crowding`; None: it does not count
    elsewhere: float = 0.0  # worst index of what is planned beside this, in units of c₀: below it a worst one is free

    @property
    def raw(self) -> Array:
        """(S, R, B) cost in units of the scale, inf where there is none."""
        return np.where(np.isfinite(self.cost), self.cost / self.scale, np.inf)


def resolve_index(options: PlanOptions) -> Index:
    """The index "auto" stands for: deflection where a force is given, else directional stiffness."""
    if options.index != "auto":
        return options.index
    return "deflection" if options.force.given else "stiffness"


def directions(
    path: Path, arm: PlanningArm, elasticity: ArmElasticity, force: ProcessForce, across: Array | None = None
) -> Directions:
    """Of a path, where the external joints stand along it.

    Args:
        across: (P, 3) :func:`machopt.plan.cost.engagement.sideways` of it, which no external joint changes; None: not
        known.
    """
    e = path.external
    axial, travel = arm.directions(e, path.axis), arm.directions(e, path.travel)
    normal = np.cross(axial, travel)
    f = arm.directions(e, process_force(path.axis, sideways(path) if across is None else across, force))
    place = arm.places(e, path.position)
    joint = joint_stiffness(elasticity.stiffness, place)
    carried = Beside.of(arm.machine, elasticity.stiffness.external)
    beside = None if carried is None else carried.compliance(e, place)
    unsure = None if carried is None else carried.unsure(e, place)
    return Directions(
        axial=axial,
        normal=normal,
        force=f,
        k=joint.k,
        in_grid=joint.in_grid,
        drilling=path.is_drilling,
        beside=beside,
        unsure=unsure,
    )


def configuration_cost(
    elasticity: ArmElasticity, d: Directions, points: NDArray[np.integer[Any]], q: Array, index: Index
) -> Array:
    """Cost (M,) of configurations q (M, 6) at planning points (M,).

    Raises:
        InputError: a force the joint springs do not hold.
    """

    def cost(a: int) -> Array:
        p = points[a : a + CHUNK]
        elastic = d.elastic(elasticity, q[a : a + CHUNK], p)
        if index == "deflection":
            out = np.asarray(np.linalg.norm(elastic.deflection(d.force[p]), axis=-1))
            if not np.isfinite(out).all():
                raise InputError(
                    f"the joint springs do not hold {np.linalg.norm(d.force[p], axis=-1).max():.4g} N: with "
                    "geometric_stiffness the arm would buckle; a force in N, or a file without that term, would work",
                    file="options",
                    where="force_N",
                )
            return out
        if index == "jiao2022":
            return np.asarray(1.0 / elastic.jiao_index(d.axial[p]))
        axial, normal = elastic.along(d.axial[p]), elastic.along(d.normal[p])
        return np.where(d.drilling[p], axial, 0.5 * (axial + normal))

    return np.concatenate([np.empty(0), *side_by_side(cost, range(0, len(q), CHUNK))])


def score_candidates(
    path: Path, candidates: Candidates, elasticity: ArmElasticity, d: Directions, options: PlanOptions
) -> Scores:
    """Cost of every feasible candidate."""
    index = resolve_index(options)
    usable = candidates.usable
    cost = np.full(usable.shape, np.nan)
    size = max(CHUNK // max(usable[0].size, 1), 1)  # stations at a time

    def price(start: int) -> None:
        some = slice(start, start + size)
        there = usable[some]
        points = path.stations[some][np.nonzero(there)[0]]
        # a spring that gives over a sector does not repeat every turn: it counts where the arm mostly stands
        q = np.asarray(wrap(candidates.q[some][there]))
        cost[some][there] = configuration_cost(elasticity, d, points, q, index)

    side_by_side(price, range(0, len(usable), size))
    counted = usable & path.counted[path.stations][:, None, None]
    values = cost[counted if counted.any() else usable]
    return Scores(cost=cost, index=index, scale=float(np.median(values)) if values.size else 1.0)
