"""Hints about cell and path of a plan: model misfit, tool axis, external joints, configuration changes."""

from __future__ import annotations

import numpy as np

from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.external_axis_reasons import list_overruled_pins
from machopt.planning.plan_output.reentry_section import list_reentry_points
from machopt.planning.uncertainty.external_axis_settlement import describe_settlement
from machopt.planning.uncertainty.measured_tcp_error import predict_position_error

NEARLY_PARALLEL = np.radians(8.0)


LARGE = 0.02  # m; deflection above the validity limit of linear elasticity


BESIDE = 0.02  # m; a tip farther from axis 6 moves the wrist noticeably when it turns


SURE = "Their uncertainty is given by the intervals; "


def describe_model_misfit(plan: Plan) -> str:
    """Return the model discrepancy stated in the stiffness file as a sentence; empty where its readings show none.

    Args:
        plan: plan of one tool.
    """
    position = predict_position_error(plan)
    return " ".join(w for w in (_describe_spring_readings(plan), "" if position is None else position.words()) if w)


def _describe_spring_readings(plan: Plan) -> str:
    """Return the sentence about readings under load."""
    stiffness = plan.setup.elasticity.stiffness
    d = stiffness.discrepancy
    if d is None and stiffness.covariance is not None and stiffness.grid is None:
        return (
            "The stiffness states the uncertainty of its springs (covariance), but not what it may lack (discrepancy): "
            "intervals of deflection, gain and compensation are valid only if no other part is compliant. This is the "
            "case for springs "
            "from measured poses or motions; identify or diagnose with load tests (kind deflection) gives the "
            "discrepancy."
        )
    return "" if d is None else d.describe_misfit("Gain, deflection and compensation", SURE)


def list_hints(plan: Plan) -> tuple[str, ...]:
    """Return hints about the cell and the path, for feasible and infeasible plans.

    Args:
        plan: plan of a job or of one tool.
    """
    if plan.parts:
        return tuple(dict.fromkeys(hint for part in plan.parts for hint in list_hints(part.plan)))
    out = [misfit] if (misfit := describe_model_misfit(plan)) else []
    out += [plan.conflict] if plan.conflict else []
    if plan.elsewhere:
        several = len(plan.elsewhere) > 1
        out.append(
            f"Around {'points' if several else 'point'} {_format_some(plan.elsewhere)} the rotation is another than "
            "stiffness alone would choose: with that one the path shifted against the deflection could not be driven."
        )
    out += plan.setup.collision.suspicious if plan.setup.collision else []
    robot, arm = plan.setup.robot, plan.setup.arm
    axis6 = robot.T_base_flange_zero[:3, :3].T @ robot.axis[5]
    angle = np.arccos(np.clip(abs(axis6 @ arm.T_flange_tcp[:3, 2]), 0.0, 1.0))
    if angle < NEARLY_PARALLEL:
        zero = robot.T_base_flange_zero
        tip = zero[:3, :3] @ arm.T_flange_tcp[:3, 3] + zero[:3, 3]
        tip_offset = float(np.linalg.norm(np.cross(tip - robot.point[5], robot.axis[5])))  # m, of the tip from axis 6
        effect = (
            "so turning about it only turns joint 6 and hardly changes stiffness or reach"
            if tip_offset < BESIDE
            else f"{1e3 * tip_offset:.0f} mm from it, so turning about it moves the wrist on so small a circle"
        )
        out.append(
            f"The tool axis is {np.degrees(angle):.1f}° from axis 6, {effect}. What would help: another branch, "
            "a spindle set at an angle to the flange, a rail, or another workpiece placement."
        )
    if not plan.directions.in_grid.all():
        share = 1.0 - float(plan.directions.in_grid[plan.path.counted].mean()) if plan.path.counted.any() else 1.0
        out.append(
            f"{100 * share:.0f} % of the cutting points lie outside the identified stiffness grid; "
            "the constant values are used there."
        )
    bent = plan.chosen.cost[plan.path.counted & np.isfinite(plan.chosen.cost)]
    if plan.scores.index == "deflection" and bent.max(initial=0.0) > LARGE:
        out.append(
            f"The force bends the arm by up to {1e3 * bent.max():,.0f} mm, beyond linear elasticity; "
            "is force_N in N, and the stiffness in N·m/rad?"
        )
    out += plan.setup.elasticity.warnings
    if plan.setup.correction is not None:
        out += plan.setup.correction.list_range_violations(plan.chosen.assignment.q)
    out += _describe_external_positions(plan) + list_overruled_pins(plan)
    out += _describe_reentries(plan)
    out += describe_settlement(plan)
    changes = _describe_changes(plan)
    if changes:
        more = f"; and {len(changes) - 6} more" if len(changes) > 6 else ""
        changes_text = "; ".join(changes[:6]) + more
        out.append(f"The arm changes its configuration between runs, where the tool is retracted: {changes_text}")
    return tuple(out)


def _format_some(points: tuple[int, ...], most: int = 6) -> str:
    more = f" and {len(points) - most} more" if len(points) > most else ""
    return ", ".join(map(str, points[:most])) + more


def _describe_external_positions(plan: Plan) -> list[str]:
    """Return the position of each external joint while the tool cuts."""
    cell, cut, out = plan.setup.cell, plan.path.counted, []
    for k, (name, slides) in enumerate(zip(cell.external_joints, cell.external_prismatic, strict=True)):
        value = plan.path.external[cut, k] * (1e3 if slides else np.degrees(1.0))
        if len(value):
            low, high, unit = float(value.min()), float(value.max()), "mm" if slides else "°"
            a, b = (f"{float(f'{v:.4g}'):g}" for v in (low, high))
            span = f"at {a} {unit}" if high - low < 1e-6 else f"from {a} to {b} {unit}"
            out.append(f"External joint {name} (e{k + 1}) is at {span} while cutting.")
    return out


def _describe_reentries(plan: Plan) -> list[str]:
    """Say where the tool is lifted inside of a cut."""
    points = list_reentry_points(plan)
    if not points:
        return []
    several = len(points) > 1
    return [
        f"The tool is lifted inside of the cut at {'points' if several else 'point'} {_format_some(points)} and enters "
        "again there: it leaves a mark."
    ]


def _describe_changes(plan: Plan) -> list[str]:
    """Branch changes and unwindings of more than half a turn from run to run."""
    out, a, path = [], plan.chosen.assignment, plan.path
    previous = -1
    for first, last in path.runs:
        if last == first or a.branch[first] < 0:
            continue
        if previous >= 0 and a.branch[previous] >= 0:
            step = np.degrees(a.q[first] - a.q[previous])
            if a.branch[first] != a.branch[previous]:
                out.append(f"branch {a.branch[previous]} → {a.branch[first]} before point {path.index[first]:g}")
            elif np.abs(step).max() > 180.0:
                joint = int(np.abs(step).argmax())
                out.append(f"joint {joint + 1} unwinds {step[joint]:.0f}° before point {path.index[first]:g}")
        previous = last
    return out
