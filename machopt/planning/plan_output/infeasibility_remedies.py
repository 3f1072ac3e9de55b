"""What would make an infeasible point feasible, from the plan's own numbers."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.external_axis_reasons import explain_external_axes
from machopt.planning.plan_output.reach_advice import compute_reach_shift
from machopt.planning.plan_output.unit_check import compute_maximum_reach
from machopt.planning.sampling.candidate_enumeration import solve_station

FAR = 20.0  # m; longer than any arm, so a length was given in another unit


def describe_remedy(plan: Plan, point: int) -> str:
    """Return what would make a planning point feasible.

    Args:
        plan: plan of a job or of one tool.
        point: planning point without a configuration.
    """
    plan, point = plan.at(point)
    if point in plan.ways:
        return plan.ways[point].help
    reason = InfeasibilityReason(int(plan.chosen.assignment.reason[point]))
    if reason == InfeasibilityReason.GAP:
        return "what helps at the gap it lies at brings this cut back too"
    if reason == InfeasibilityReason.GOUGING:
        return (
            "another tool axis, a smaller cutter or another path in the CAM file would help, no posture does; or "
            "tool.cutter.corner_mm, where the cutter has a corner radius"
        )
    if reason == InfeasibilityReason.SHIFT:
        return "a larger compensation_max_mm where the shift is meant, a stiffer pose, or no compensation would help"
    if plan.compensation is not None and plan.compensation.lost[point]:
        instead = _HELP_SHIFTED.get(reason, "another rotation there (steer)")
        return f"{instead}, or no compensation would help{_describe_left_out(plan)}"
    s = min(int(np.searchsorted(plan.path.stations, point)), len(plan.path.stations) - 1)
    rotations = plan.candidates.reason_of_rotation()[s]
    if not plan.options.is_searched and (rotations == InfeasibilityReason.OK).any():
        word = "would" if plan.setup.collision is None else "may"  # collisions were not checked
        return f"--method global, which chooses among them, {word} help{_describe_left_out(plan)}"
    if (plan.candidates.reasons_at(s) == InfeasibilityReason.UNREACHABLE).all():
        return _describe_direction(plan, point)
    words = [_HELP[r] for r in _HELP if (rotations == r).any()]
    missed = find_missed_limit(plan, s)[1] if (rotations == InfeasibilityReason.LIMIT).any() else 0.0
    if missed > plan.options.limit_margin:  # the joint's own range is too small
        words = ["a wider joint range" if w == _HELP[InfeasibilityReason.LIMIT] else w for w in words]
    hopeless = {InfeasibilityReason.UNREACHABLE, InfeasibilityReason.BOUNDS} | (
        {InfeasibilityReason.LIMIT} if missed > plan.options.rotation_step else set()
    )
    if not np.isin(rotations, list(hopeless)).all():
        words.append(f"a finer rotation_step_deg than {np.degrees(plan.options.rotation_step):g}")
    return f"{', '.join(dict.fromkeys(words))} would help{_describe_left_out(plan)}"


def _describe_left_out(plan: Plan) -> str:
    return "" if plan.options.allow_gaps else "; --allow-gaps leaves the cut out"


def _describe_direction(plan: Plan, point: int) -> str:
    """Return the direction in which the workpiece would have to move: from the point to axis 1, by the missing
    reach.
    """
    arm = plan.setup.arm
    at = arm.places(plan.path.external[[point]], plan.path.position[[point]])[0]
    middle = plan.setup.robot.point[1]  # axis 2, the shoulder
    way = middle - at
    size = float(np.linalg.norm(way))
    moved = compute_reach_shift(plan, point)
    distance_text = f"the tip is {1e3 * size:,.0f} mm from the shoulder"
    extent = float(np.linalg.norm(np.ptp(plan.path.position, axis=0)))
    unit = "; is the workpiece frame in mm?" if size > FAR else ""
    if (
        extent > compute_maximum_reach(plan.setup.robot, plan.setup.arm.T_flange_tcp)
        and not plan.path.external.shape[1]
    ):
        unit += f"; the path is {extent:.3g} m long: is another --unit needed?"
    by = ", ".join(f"{v:.0f}".replace("-", "\N{MINUS SIGN}") for v in np.round(1e3 * moved.by) + 0.0)
    part = f"moving the part by about ({by}) mm in the robot's base"
    if not np.round(1e3 * moved.by).any():  # near enough: for an arm without a wrist centre the shortfall is unknown
        part = "another pose of the part (machopt place looks for one) or another tool axis"
    whom = "" if moved.points == 1 else f" all {moved.points} points out of reach"
    if not moved.all:
        whom = f" this point, not all {moved.points} out of reach"
    option = explain_external_axes(plan, point, out_of_reach=True).help
    if option:
        return f"{option} would help; so would {part}{' for' if whom else ''}{whom}"
    return f"{part} would help{whom} ({distance_text}{unit})"


_HELP = {
    InfeasibilityReason.LIMIT: "a wider joint range or smaller limit_margin_deg",
    InfeasibilityReason.SINGULAR_WRIST: "a smaller singularity_wrist_deg",
    InfeasibilityReason.SINGULAR_ELBOW: "a smaller singularity_elbow_deg",
    InfeasibilityReason.SINGULAR_SHOULDER: "a smaller singularity_shoulder_mm",
    InfeasibilityReason.UNSTABLE: "a smaller min_stability_ratio, another spindle speed or a smaller depth of cut",
    InfeasibilityReason.COLLIDING: "moving part, tool or what is in the way, a smaller clearance_mm",
    InfeasibilityReason.BOUNDS: "a wider rotation_range_deg, another fixed rotation or other steering rules (steer)",
    InfeasibilityReason.NO_PATH: "a retract before it",
}


_HELP_SHIFTED = {
    InfeasibilityReason.COLLIDING: "a smaller clearance_mm, another rotation there (steer), moving part, tool "
    "or what is in the way",
    InfeasibilityReason.LIMIT: "a larger limit_margin_deg, so that more of the range remains for the shift",
    InfeasibilityReason.SINGULAR_WRIST: "a larger singularity_wrist_deg, so that more of the range remains for the "
    "shift",
    InfeasibilityReason.SINGULAR_ELBOW: "a larger singularity_elbow_deg, so that more of the range remains for the "
    "shift",
    InfeasibilityReason.SINGULAR_SHOULDER: "a larger singularity_shoulder_mm, so that more of the range "
    "remains for the shift",
    InfeasibilityReason.UNSTABLE: "a larger min_stability_ratio, so that more of it remains for the shift",
    InfeasibilityReason.UNREACHABLE: "moving the part nearer to the robot",
}


def find_missed_limit(plan: Plan, s: int) -> tuple[int, float]:
    """Return, for the configuration of a station nearest to the limits, its joint and the violation in rad.

    Args:
        plan: plan of one tool.
        s: the station.
    """
    arm = plan.setup.arm
    joints, reason = solve_station(plan.path, arm, plan.candidates, s)
    q = np.asarray(wrap_angle(joints[reason == InfeasibilityReason.LIMIT]))[:, None] + arm.turns  # (L, K, 6)
    over = np.maximum(arm.lower - q, q - arm.upper).clip(min=0.0)
    best = np.unravel_index(over.max(axis=-1).argmin(), over.shape[:2])
    joint = int(over[best].argmax())
    return joint, float(over[best][joint])
