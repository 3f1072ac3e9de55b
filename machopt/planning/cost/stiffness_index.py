"""Stiffness index: the cost of a configuration.

Cost c of a configuration, always "less is better":

==============  =======================================================  =====
index           c                                                        unit
==============  =======================================================  =====
deflection      |C_tt f|, the tip's displacement under the given force   m
stiffness       eᵀC_tt e along the tool axis (drilling), the mean of     m/N
                that and of the same along the path normal (milling)
jiao2022        1/k_x along the tool axis (eq. 23)                       m/N
==============  =======================================================  =====

c₀ is the median cost over the feasible candidates; :mod:`machopt.planning.cost.objective` weighs c/c₀ against motion.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions, ProcessForce, StiffnessIndex
from machopt.errors import CellError
from machopt.numerics.array_types import Array
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.cost.process_force_direction import compute_process_force, compute_sideways_directions
from machopt.planning.cost.rapid_time import RapidPricing
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.planning_arm import PlanningArm, turn_directions
from machopt.planning.stations.planning_path import PlanningPath
from machopt.stiffness.arm_stiffness import ArmElasticity, ElasticState
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance
from machopt.stiffness.joint_stiffness import compute_joint_stiffness

CHUNK = 8_192  # configurations at a time


@dataclass(frozen=True, kw_only=True)
class LoadDirections:
    """Directions and force per planning point, in base_link."""

    axial: Array  # (P, 3) tool axis, tip to shank
    normal: Array  # (P, 3) path normal: tool axis × travel
    force: Array  # (P, 3) N
    k: Array  # (P, 6) N·m/rad, joint stiffness at the TCP position
    in_grid: NDArray[np.bool_]  # (P,)
    drilling: NDArray[np.bool_]  # (P,)
    beside: Array | None = None  # (P, 6, 6) compliance of the external joints at the TCP; None: they are rigid
    unsure: Array | None = None  # (P, K, 6) TCP twist for 1 σ of each external joint whose stiffness has a σ

    def elastic(self, elasticity: ArmElasticity, q: Array, points: NDArray[np.integer[Any]]) -> ElasticState:
        """Return the elastic state of configurations, with the external joints as at their planning points.

        Args:
            elasticity: compliance model of the arm.
            q: (M, 6) rad, joints.
            points: (M,) planning points.
        """
        return elasticity.evaluate(q, self.k[points], None if self.beside is None else self.beside[points])


@dataclass(frozen=True)
class CandidateScores:
    """Cost of every candidate and the scale of the objective."""

    cost: Array  # (S, R, B), NaN where infeasible
    index: StiffnessIndex  # the index in force, never "auto"
    scale: float  # c₀
    _: KW_ONLY
    crowded: Array | None = (
        None  # (S, R, B) :func:`machopt.planning.cost.objective.compute_crowding`; None: it does not count
    )
    elsewhere: float = 0.0  # worst index of the other tools, in units of c₀: a lower one has no price
    place_price: Array | None = None  # (S, R, B) price of a vertex that no share multiplies; None: there is none
    feed_price: Array | None = None  # (S, R, B) price of the time lost by accelerations; None: it does not count
    rapid: RapidPricing | None = None  # prices of rapid moves and changes; None: they have none

    def without_search_prices(self) -> CandidateScores:
        """Return the scores without the prices of clearance and lost feed, for search, smoothing and bounds."""
        return replace(self, crowded=None, feed_price=None)

    @property
    def raw(self) -> Array:
        """(S, R, B) cost in units of the scale, inf where there is none."""
        return np.where(np.isfinite(self.cost), self.cost / self.scale, np.inf)

    @property
    def least(self) -> Array:
        """(S,) lowest cost of each station in units of the scale, inf where there is none."""
        return np.asarray(
            np.where(np.isfinite(self.cost), self.cost, np.inf).min(axis=(1, 2), initial=np.inf) / self.scale
        )


def resolve_index(options: PlanOptions) -> StiffnessIndex:
    """Return the index that "auto" selects: deflection where a force is given, else directional stiffness.

    Args:
        options: plan options with ``index`` and ``force``.
    """
    if options.index != "auto":
        return options.index
    return "deflection" if options.force.given else "stiffness"


def compute_load_directions(
    path: PlanningPath, arm: PlanningArm, elasticity: ArmElasticity, force: ProcessForce, across: Array | None = None
) -> LoadDirections:
    """Return directions and force of a path, with the external joints as they are along it.

    Along a tilted path they are those of the programmed one: the tool tilts, the surface and the cut on it do not.

    Args:
        path: planning points.
        arm: arm model with the base pose per external position.
        elasticity: compliance model of the arm.
        force: force components, N.
        across: (P, 3) :func:`machopt.planning.cost.process_force_direction.compute_sideways_directions` of the path,
            which no external joint changes; None: it is computed.
    """
    path, e = path.programmed, path.external
    R, origin = arm.compute_workpiece_frame(e)
    axial, travel = turn_directions(R, path.axis), turn_directions(R, path.travel)
    normal = np.cross(axial, travel)
    across = compute_sideways_directions(path) if across is None else across
    f = turn_directions(R, compute_process_force(path.axis, across, force, path.force))
    place = np.asarray(turn_directions(R, path.position) + origin)
    joint = compute_joint_stiffness(elasticity.stiffness, place)
    carried = ExternalJointCompliance.build(arm.machine, elasticity.stiffness.external)
    external_compliance = None if carried is None else carried.compute_compliance(e, place)
    unsure = None if carried is None else carried.compute_uncertain_twists(e, place)
    return LoadDirections(
        axial=axial,
        normal=normal,
        force=f,
        k=joint.k,
        in_grid=joint.is_in_grid,
        drilling=path.is_drilling,
        beside=external_compliance,
        unsure=unsure,
    )


def compute_configuration_cost(
    elasticity: ArmElasticity, d: LoadDirections, points: NDArray[np.integer[Any]], q: Array, index: StiffnessIndex
) -> Array:
    """Return the (M,) cost of configurations.

    Args:
        elasticity: compliance model of the arm.
        d: directions and force per planning point.
        points: (M,) planning points.
        q: (M, 6) rad, joints.
        index: stiffness index, not "auto".

    Raises:
        InputError: a force that the joint springs cannot support.
    """

    def cost(a: int) -> Array:
        p = points[a : a + CHUNK]
        elastic = d.elastic(elasticity, q[a : a + CHUNK], p)
        if index == "deflection":
            out = np.asarray(np.linalg.norm(elastic.compute_deflection(d.force[p]), axis=-1))
            if not np.isfinite(out).all():
                raise CellError(
                    f"the joint springs do not hold {np.linalg.norm(d.force[p], axis=-1).max():.4g} N: with "
                    "geometric_stiffness the arm would buckle; a force in N, or a file without that term, would work",
                    file="options",
                    where="force_N",
                )
            return out
        if index == "jiao2022":
            return np.asarray(1.0 / elastic.compute_jiao_index(d.axial[p]))
        axial, normal = elastic.compute_compliance_along(d.axial[p]), elastic.compute_compliance_along(d.normal[p])
        return np.where(d.drilling[p], axial, 0.5 * (axial + normal))

    return np.concatenate([np.empty(0), *map_in_threads(cost, range(0, len(q), CHUNK))])


def score_candidates(
    path: PlanningPath, candidates: CandidateGrid, elasticity: ArmElasticity, d: LoadDirections, options: PlanOptions
) -> CandidateScores:
    """Return the cost of every feasible candidate and the scale c₀.

    Args:
        path: planning points.
        candidates: candidate grid of the search.
        elasticity: compliance model of the arm.
        d: directions and force per planning point.
        options: plan options with the index.
    """
    index = resolve_index(options)
    usable = candidates.usable
    cost = np.full(usable.shape, np.nan)
    size = max(CHUNK // max(usable[0].size, 1), 1)  # stations at a time

    def price(start: int) -> None:
        some = slice(start, start + size)
        there = usable[some]
        points = path.stations[some][np.nonzero(there)[0]]
        # a joint spring with an angular sector is not periodic: it is evaluated at the usual turn
        q = np.asarray(wrap_angle(candidates.q[some][there]))
        cost[some][there] = compute_configuration_cost(elasticity, d, points, q, index)

    map_in_threads(price, range(0, len(usable), size))
    counted = usable & path.counted[path.stations][:, None, None]
    values = cost[counted if counted.any() else usable]
    values = values[values > 0] if (values > 0).any() else values  # points without a force do not depend on the arm
    return CandidateScores(cost=cost, index=index, scale=float(np.median(values)) if values.size else 1.0)
