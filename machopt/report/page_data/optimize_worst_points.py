"""Worst points of a plan, and the largest contributions to their compliance."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma
from machopt.planning.plan_output.point_table import PointResults
from machopt.report.page_types import optimize_page_data as page
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance

MAX_WORST_POINTS = 8  # rows of the table


def list_worst_points(
    plan: Plan, toolpath: Toolpath, points: PointResults, series: dict[str, Array]
) -> tuple[page.WorstPointRow, ...]:
    """Return the rows of the table of worst points.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: Results at the toolpath's points.
        series: Series along the path by name, (N,) each.
    """
    there = plan.path.counted & (plan.chosen.assignment.reason == InfeasibilityReason.OK)
    values = np.where(there[points.rows], series["chosen"], np.nan)
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(values[known], kind="stable")]
    if plan.scores.index == "deflection":
        order = order[::-1]
    t, turned, phi = points.table, compute_gamma(plan)[points.rows], wrap_angle(plan.chosen.assignment.phi[points.rows])
    picked: list[int] = []
    for i in order:  # not eight neighbours of the same valley
        if all(abs(int(i) - j) > 0.02 * len(values) for j in picked):
            picked.append(int(i))
        if len(picked) == MAX_WORST_POINTS:
            break
    return tuple(
        page.WorstPointRow(
            point=i,
            operation=toolpath.operations[toolpath.operation[i]].label,
            value=float(values[i]),
            value_default=float(series["default"][i]),
            gamma=float(turned[i]),
            phi=float(phi[i]),
            deflection=float(t.deflection[i]),
            tolerance=float(toolpath.tolerance[i]),
            k_axial=float(t.k_axial[i]),
            clearance=float(t.clearance[i]),
            reason=_describe_main_compliance(plan, int(points.rows[i])),
            deflection_std=float(t.deflection_std[i]) if t.deflection_std is not None else float("nan"),
        )
        for i in picked
    )


def _describe_main_compliance(plan: Plan, row: int) -> str:
    """The joint or term that carries most of the compliance along the force or the tool axis, and how much of it."""
    plan, row = plan.at(row)
    elasticity, d = plan.setup.elasticity, plan.directions
    elastic = d.elastic(elasticity, plan.chosen.assignment.q[row][None], np.array([row]))
    is_loaded = plan.options.force.given and bool(np.any(d.force[row]))
    direction = d.force[row] if is_loaded else d.axial[row]
    wrench = np.concatenate([direction, np.zeros(3)])[None]
    part = dict(
        zip((f"joint {i}" for i in range(1, 7)), (elastic.state.J[0, :3].T @ direction) ** 2 / d.k[row], strict=True)
    )
    for term in elasticity.terms:
        twist = term.compute_twist(elastic.loaded_state, wrench, small=not is_loaded)[0, :3]
        part[f"{term.effect.replace('_', ' ')} of {term.location.replace(':', ' ')}"] = float(direction @ twist)
    if elasticity.shift is not None:
        twist = elasticity.shift.compute_twist(elastic.loaded_state, wrench, small=not is_loaded)[0, :3]
        part["what the readings show beyond the stiffness file"] = float(direction @ twist)
    carried = ExternalJointCompliance.build(plan.setup.arm.machine, elasticity.stiffness.external)
    if carried is not None:
        e, place = plan.path.external[row][None], plan.path.position[row][None]
        for own in carried.list_parts(e, plan.setup.arm.places(e, place)):
            part[own.name] = float(wrench[0] @ own.matrix[0] @ wrench[0])
    most = max(part, key=lambda name: part[name])
    along = "the force" if is_loaded else "the tool axis"
    return f"{most} causes {100 * part[most] / sum(part.values()):.0f} % of the deflection along {along}"
