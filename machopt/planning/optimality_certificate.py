"""Optimality certificate of a plan: its objective compared with the lower bound over the search grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.pipeline.plan_data_types import ExternalAxisBound, Plan
from machopt.planning.sequence_search.worst_index_across_swings import compute_worst_index, find_hidden_points


@dataclass(frozen=True)
class OptimalityCertificate:
    """Values of J (:mod:`machopt.planning.cost.objective`).

    The bound holds for every sequence over the grid of rotations, branches and turns, with the external joints of
    the plan (:func:`find_external_axis_bound` returns the bound over their values) and the prices of the search.
    Where stations are closer in time than a grid step of rotation takes, a step has the time since the last one. The
    smooth curve lies between the grid's steps and may be below the bound.
    """

    objective: float  # of the plan as it is driven
    sequence: float  # of the best sequence found over the grid
    bound: float  # no sequence over the grid has less
    grid: float  # of that sequence as a plan, point by point

    @property
    def gap(self) -> float:
        """Maximum share of ``sequence`` that another sequence could save."""
        return 1.0 - self.bound / self.sequence if self.sequence > 0 else 0.0

    @property
    def above(self) -> float:
        """Share by which the driven plan is above the bound; negative below it, where the bound is no limit.

        The gap is proven for sequences at the stations. The driven curve is priced at all points, so its value differs,
        and both are reported.
        """
        return self.objective / self.bound - 1.0 if self.bound > 0 else 0.0

    @property
    def beyond(self) -> float:
        """Share that the plan saves compared with the grid's own sequence; negative where it costs more."""
        return 1.0 - self.objective / self.grid if self.grid > 0 else 0.0


def compute_external_travel_cost(plan: Plan) -> float:
    """Return the cost of the external joints' travel: equal in every sequence, and not part of the search.

    Args:
        plan: plan of one tool.
    """
    path, setup = plan.path, plan.setup
    way = np.abs(np.diff(path.external * setup.per_rad[6:], axis=0)).sum(axis=1)
    terms = ObjectiveTerms.build(path, setup.velocity, plan.options)
    return float(plan.options.weights.travel * (terms.travel[1:] @ way))


def compute_certificate(plan: Plan) -> OptimalityCertificate | None:
    """Return the certificate of a plan; None where its path has gaps or breaks, or was not searched.

    Args:
        plan: plan of a job or of one tool.
    """
    if plan.parts:
        return _certify_job(plan)
    c, ways = plan.choice, compute_external_travel_cost(plan)
    values = (plan.chosen.objective.total, c.total + ways, c.bound + ways, plan.grid.total)
    if plan.found is None or c.broken or not np.isfinite(values).all():
        return None
    return OptimalityCertificate(*values)


def _certify_job(plan: Plan) -> OptimalityCertificate | None:
    """Return the certificate of a job that changes tools, J as in :mod:`machopt.planning.job.joined_plan`.

    The bound is that of all stretches under one cap on the worst index
    (:mod:`machopt.planning.job.worst_index_over_tools`).
    Where it is not known, the weighted sum of the stretches' bounds holds, each with its own worst index priced.
    """
    bound = sequence = 0.0
    worst, price = [0.0], plan.options.weights.worst
    for part in plan.parts:
        found = compute_certificate(part.plan)
        if found is None:
            return None
        own = _compute_sequence_worst(part.plan)
        bound += part.share * (found.bound if plan.bound is None else compute_external_travel_cost(part.plan))
        sequence += part.share * (found.sequence - price * own)
        worst.append(own)
    bound += plan.bound or 0.0
    return OptimalityCertificate(plan.chosen.objective.total, sequence + price * max(worst), bound, plan.grid.total)


def _compute_sequence_worst(plan: Plan) -> float:
    """The worst index of the sequence over the grid, in units of c₀."""
    c, path = plan.choice, plan.path
    return compute_worst_index(
        plan.scores.raw, path.counted[path.stations], find_hidden_points(path), c.rotation, c.branch
    )


def find_external_axis_bound(plan: Plan) -> ExternalAxisBound | None:
    """Return the lower bound over all sequences that also choose the external joints; None where none of them was free.

    For a job with tool changes J is at least Σ share·bound, because each stretch's bound prices its own worst index and
    the shares add up to 1.

    Args:
        plan: plan of a job or of one tool.
    """
    if not plan.parts:
        return plan.over_external
    own = [part.plan.over_external for part in plan.parts]
    known = [found for found in own if found is not None]
    if not known:
        return None
    why = next((found.why for found in known if found.why), "")
    if why or len(known) < len(own):
        return ExternalAxisBound(why=why or "a tool's stretch has none, as its external joints are locked")
    total = float(sum(part.share * found.bound for part, found in zip(plan.parts, known, strict=True)))
    least = min(known, key=lambda found: found.values)
    stations = sum(found.stations for found in known)
    return replace(least, bound=total, sequence=np.nan, plan=plan.chosen.objective.total, stations=stations)
