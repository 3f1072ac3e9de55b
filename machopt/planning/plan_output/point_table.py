"""Table with one row per toolpath point, from the plan's planning points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.process_columns import ProcessSummary
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel, compute_reported_std
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma, explain_points
from machopt.planning.uncertainty.stiffness_uncertainty import (
    build_compliance_covariance,
    compute_carrier_sensitivity,
    compute_cost_gradient,
)

ROWS = 32_768  # rows of the table per block


def find_reason(plan: Plan, point: int) -> InfeasibilityReason:
    """Return why a planning point has no configuration; where no rotation works, the reason of the furthest one.

    Args:
        plan: plan of one tool.
        point: planning point.
    """
    reason = InfeasibilityReason(int(plan.chosen.assignment.reason[point]))
    if reason != InfeasibilityReason.NO_PATH:
        return reason
    s = min(int(np.searchsorted(plan.path.stations, point)), len(plan.path.stations) - 1)
    rotations = plan.candidates.reason_of_rotation()[s]
    if (rotations == InfeasibilityReason.OK).any():
        return reason
    known = rotations[rotations != InfeasibilityReason.BOUNDS]
    return InfeasibilityReason(int(known.max() if len(known) else InfeasibilityReason.BOUNDS))


@dataclass(frozen=True)
class PointResults:
    """The table, and additional data for the report; N toolpath points."""

    table: PointsTable
    rows: NDArray[np.intp]  # (N,) planning point of each toolpath point
    nearest_pair: tuple[str, ...]  # (N,)
    process: tuple[ProcessSummary, ...] = ()  # one per tool of a job with a process


def build_point_table(plan: Plan, toolpath: Toolpath) -> PointResults:
    """Return stiffness, deflection, clearance and margins of the chosen configuration at every toolpath point.

    Args:
        plan: plan of one tool.
        toolpath: its toolpath.
    """
    rows = np.flatnonzero(plan.path.is_point)
    a = plan.chosen.assignment
    q = a.q[rows]  # true angles; the table has encoder angles
    known = plan.setup.correction
    encoder_angles = q if known is None else known.compute_encoder_angles(q)
    ok = np.flatnonzero(a.reason[rows] == InfeasibilityReason.OK)
    soft = _compute_stiffness_columns(plan, rows, ok, q)
    bend_std, axial_std = _compute_uncertainty(plan, rows, ok, q, soft.axial)
    clearance, pairs = _find_clearances(plan, rows, ok, q)
    lower, upper = plan.setup.cell.limits.lower[:6], plan.setup.cell.limits.upper[:6]
    margin = np.minimum(encoder_angles - lower, upper - encoder_angles).min(axis=1)
    shoulder = np.arctan2(a.shoulder[rows], 1.0)  # as an angle over 1 m, to compare with the others
    singular = np.fmin(np.fmin(a.wrist[rows], a.elbow[rows]), shoulder)
    why = explain_points(plan)
    table = PointsTable(
        position=toolpath.position,
        axis=toolpath.axis,
        move=toolpath.move,
        operation=toolpath.operation,
        operations=tuple(o.label for o in toolpath.operations),
        gamma=np.where(a.reason[rows] == InfeasibilityReason.OK, compute_gamma(plan)[rows], np.nan),
        branch=a.branch[rows].astype(np.int8),
        q=encoder_angles,
        external=plan.path.external[rows],
        external_prismatic=plan.setup.cell.external_prismatic,
        k_axial=soft.axial,
        k_normal=soft.normal,
        deflection=soft.deflection,
        clearance=clearance,
        limit_margin=margin,
        singularity=singular,
        status=_list_status(plan, rows),
        reason=tuple(why.get(p, "") for p in rows.tolist()),
        feed=toolpath.feed,
        k_jiao_x=soft.jiao_x,
        nearest_pair=pairs,
        in_grid=None if plan.setup.elasticity.stiffness.grid is None else plan.directions.in_grid[rows],
        deflection_std=bend_std,
        k_axial_std=axial_std,
        dwell=list_dwells(toolpath),
        compensation=None if plan.compensation is None else plan.compensation.offset[rows],
        lead=_mask_unreached(plan, plan.path.lead, rows),
        side=_mask_unreached(plan, plan.path.side, rows),
        feed_advised=_get_advised_feeds(plan),
    )
    return PointResults(table, rows, pairs)


@dataclass(frozen=True)
class _StiffnessColumns:
    """Columns of n toolpath points; NaN where there is no configuration."""

    axial: Array  # (n,) N/m, along the tool axis
    normal: Array  # (n,) N/m, across it
    jiao_x: Array  # (n,) N/m, index of jiao2022
    deflection: Array  # (n,) m; NaN without a force


def _compute_stiffness_columns(plan: Plan, rows: NDArray[np.intp], ok: NDArray[np.intp], q: Array) -> _StiffnessColumns:
    """Return stiffness and deflection at the feasible toolpath points ``ok``, at true angles q (n, 6)."""
    axial, normal, paper, bend = (np.full(len(rows), np.nan) for _ in range(4))
    elasticity, d = plan.setup.elasticity, plan.directions
    for some in _iterate_blocks(ok):
        at = rows[some]
        elastic = d.elastic(elasticity, q[some], at)
        axial[some], normal[some] = (
            1.0 / elastic.compute_compliance_along(d.axial[at]),
            1.0 / elastic.compute_compliance_along(d.normal[at]),
        )
        paper[some] = elastic.compute_jiao_index(d.axial[at])
        if plan.options.force.given:
            bend[some] = np.linalg.norm(elastic.compute_deflection(d.force[at]), axis=-1)
    return _StiffnessColumns(axial, normal, paper, bend)


def _find_clearances(
    plan: Plan, rows: NDArray[np.intp], ok: NDArray[np.intp], q: Array
) -> tuple[Array, tuple[str, ...]]:
    """Return clearance (n,) in m and the names of the nearest pair; NaN and empty where they are not known."""
    clearance, pairs = np.full(len(rows), np.nan), [""] * len(rows)
    model = plan.setup.collision
    if model is not None and len(ok):
        near = model.find_nearest_pair(plan.path.whole(q[ok], rows[ok]), plan.path.may_touch[rows[ok]])
        clearance[ok] = near.distance
        for i, k in zip(ok, near.pair, strict=True):
            pairs[i] = model.pairs[k].name if k >= 0 else ""
    return clearance, tuple(pairs)


def _mask_unreached(plan: Plan, tilt: Array | None, rows: NDArray[np.intp]) -> Array | None:
    """Return a tilt (N,) at the points, NaN without a configuration; None where the axis is that of the CAM file."""
    if tilt is None:
        return None
    return np.where(plan.chosen.assignment.reason[rows] == InfeasibilityReason.OK, tilt[rows], np.nan)


def list_dwells(toolpath: Toolpath) -> Array | None:
    """Return the (N,) dwell in s at each point; None where there is none.

    Args:
        toolpath: toolpath with its events.
    """
    out = toolpath.dwells[1:]
    return out if out.any() else None


def _iterate_blocks(rows: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield the rows in blocks that fit the memory."""
    return (rows[first : first + ROWS] for first in range(0, len(rows), ROWS))


def _list_status(plan: Plan, rows: NDArray[np.intp]) -> tuple[str, ...]:
    """Return (N,) the word of :func:`find_reason`, which is called only where the point alone does not determine it."""
    reason = plan.chosen.assignment.reason[rows]
    words = {int(known): known.word for known in InfeasibilityReason}
    out = [words[code] for code in reason.tolist()]
    for i in np.flatnonzero(reason == InfeasibilityReason.NO_PATH).tolist():
        out[i] = find_reason(plan, int(rows[i])).word
    return tuple(out)


def _compute_uncertainty(
    plan: Plan, rows: NDArray[np.intp], ok: NDArray[np.intp], q: Array, axial: Array
) -> tuple[Array | None, Array | None]:
    """Return the standard uncertainty of the deflection in m and of the axial stiffness in N/m, (N,) each; None if
    unknown.
    """
    spread, doubt = build_compliance_covariance(plan), DiscrepancyModel.build(plan.setup.elasticity)
    if not spread.known:
        return None, None
    bend_std, axial_std = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    P, at, elasticity = len(plan.path.index), rows[ok], plan.setup.elasticity
    by_point = np.zeros((P, 6))
    moved: Array | None = None if doubt is None else np.zeros((P, len(doubt.ways)))
    for some in _iterate_blocks(ok):
        along = plan.directions.axial[rows[some]]
        elastic = plan.directions.elastic(elasticity, q[some], rows[some])
        by_point[rows[some]] = elastic.compute_sensitivity(along, along, small=True)
        if doubt is not None and moved is not None:
            moved[rows[some]] = doubt.axial(elastic, q[some], along)
    own_std = np.hypot(spread.point_std(by_point), _compute_carrier_uncertainty(plan, at, q[ok], along_axis=True))
    own = np.zeros(P)  # contribution of single poses
    if doubt is not None and moved is not None:
        own[at] = doubt.own(plan.directions, at, "stiffness")
        own_std = compute_reported_std(moved, own_std**2 + own**2)
    axial_std[ok] = own_std[at] * axial[ok] ** 2  # of 1/c
    if not plan.options.force.given:
        return None, axial_std
    for some in _iterate_blocks(ok):
        by_point[rows[some]] = compute_cost_gradient(elasticity, plan.directions, rows[some], q[some], "deflection")
        if doubt is not None and moved is not None:
            moved[rows[some]] = doubt.cost(elasticity, plan.directions, rows[some], q[some], "deflection")
    own_std = np.hypot(spread.point_std(by_point), _compute_carrier_uncertainty(plan, at, q[ok], along_axis=False))
    if doubt is not None and moved is not None:
        own[at] = doubt.own(plan.directions, at, "deflection")
        own_std = compute_reported_std(moved, own_std**2 + own**2)
    bend_std[ok] = own_std[at]
    return bend_std, axial_std


def _compute_carrier_uncertainty(plan: Plan, at: NDArray[np.intp], q: Array, *, along_axis: bool) -> Array:
    """Return (P,) standard uncertainty from external joints at some planning points: of 1/k axially, or of the
    deflection.
    """
    out, d = np.zeros(len(plan.path.index)), plan.directions
    if d.unsure is not None and along_axis:
        out[at] = np.linalg.norm(np.einsum("mkc,mc->mk", d.unsure[at, :, :3], d.axial[at]) ** 2, axis=1)
    elif d.unsure is not None:
        out[at] = np.linalg.norm(compute_carrier_sensitivity(plan.setup.elasticity, d, at, q, "deflection"), axis=1)
    return out


def _get_advised_feeds(plan: Plan) -> Array | None:
    """Return (N,) m/s the feeds that replace those of the file; None where those of the file are driven."""
    given = plan.posture_feed or plan.advised_feed
    return None if given is None else given.feed
