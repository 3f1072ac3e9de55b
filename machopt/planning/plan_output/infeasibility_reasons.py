"""Messages about infeasible points: cause and remedy, from the plan's own numbers."""

from __future__ import annotations

import numpy as np

from machopt.collision.collision_model import CollisionPair, suggest_remedy
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.plan_output.external_axis_reasons import explain_external_axes, list_overruled_pins
from machopt.planning.plan_output.reach_advice import compute_reach_shift
from machopt.planning.plan_output.reentry_section import list_reentry_points
from machopt.planning.plan_output.stability_section import describe_best_ratio
from machopt.planning.plan_output.unit_check import compute_maximum_reach
from machopt.planning.sampling.configurations import solve_station
from machopt.planning.uncertainty.external_axis_settlement import describe_settlement
from machopt.planning.uncertainty.position_error import predict_position_error

NEARLY_PARALLEL = np.radians(8.0)
LARGE = 0.02  # m; deflection above the validity limit of linear elasticity
FAR = 20.0  # m; longer than any arm, so a length was given in another unit
BESIDE = 0.02  # m; a tip farther from axis 6 moves the wrist noticeably when it turns


def explain_points(plan: Plan) -> dict[int, str]:
    """Return one sentence for every planning point without a configuration.

    Args:
        plan: plan of a job or of one tool.
    """
    if plan.parts:
        return {part.row + p: text for part in plan.parts for p, text in explain_points(part.plan).items()}
    station_of = np.searchsorted(plan.path.stations, np.arange(len(plan.path.index)))
    out = {}
    for p in plan.missing:
        s = min(int(station_of[p]), len(plan.path.stations) - 1)
        out[int(p)] = _sentence(plan, s, InfeasibilityReason(int(plan.chosen.assignment.reason[p])), int(p))
    return out


def list_breaks(plan: Plan, obstructions: tuple[SequenceBreak, ...] = ()) -> tuple[SequenceBreak, ...]:
    """Return every break of the motion: in the sequence, between toolpath points, and in time.

    Args:
        plan: plan of a job or of one tool.
        obstructions: breaks of its motion.
    """
    path, reason = plan.path, plan.chosen.assignment.reason
    missing, sentences = reason != InfeasibilityReason.OK, explain_points(plan)
    missing[list(plan.ways)] = False  # here the move to them is reported
    between: dict[tuple[int, int], int] = {}
    for p in np.flatnonzero(missing & ~path.is_point):
        ends = int(np.floor(path.index[p])), int(np.ceil(path.index[p]))
        rows = np.searchsorted(path.index, ends)
        if not missing[rows].any():  # else the point itself is reported
            between.setdefault(ends, int(p))
    inner = tuple(
        SequenceBreak(
            before=a,
            after=b,
            code="no_pose",
            text=f"at {path.index[p]:.2f} between them: {sentences[p]}",
            help=describe_remedy(plan, p),
        )
        for (a, b), p in between.items()
        if not any(a - 1e-9 <= k.before and k.after <= b + 1e-9 for k in plan.breaks)
    )
    return (*plan.breaks, *inner, *obstructions)


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
        return f"{instead}, or no compensation would help{_left_out(plan)}"
    s = min(int(np.searchsorted(plan.path.stations, point)), len(plan.path.stations) - 1)
    rotations = plan.candidates.reason_of_rotation()[s]
    if not plan.options.is_searched and (rotations == InfeasibilityReason.OK).any():
        word = "would" if plan.setup.collision is None else "may"  # collisions were not checked
        return f"--method global, which chooses among them, {word} help{_left_out(plan)}"
    if (plan.candidates.reasons_at(s) == InfeasibilityReason.UNREACHABLE).all():
        return _towards(plan, point)
    words = [_HELP[r] for r in _HELP if (rotations == r).any()]
    missed = _missed_limit(plan, s)[1] if (rotations == InfeasibilityReason.LIMIT).any() else 0.0
    if missed > plan.options.limit_margin:  # the joint's own range is too small
        words = ["a wider joint range" if w == _HELP[InfeasibilityReason.LIMIT] else w for w in words]
    hopeless = {InfeasibilityReason.UNREACHABLE, InfeasibilityReason.BOUNDS} | (
        {InfeasibilityReason.LIMIT} if missed > plan.options.rotation_step else set()
    )
    if not np.isin(rotations, list(hopeless)).all():
        words.append(f"a finer rotation_step_deg than {np.degrees(plan.options.rotation_step):g}")
    return f"{', '.join(dict.fromkeys(words))} would help{_left_out(plan)}"


def _left_out(plan: Plan) -> str:
    return "" if plan.options.allow_gaps else "; --allow-gaps leaves the cut out"


def _towards(plan: Plan, point: int) -> str:
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


def compute_reach_shortfall(plan: Plan, point: int) -> float:
    """Return the distance in m by which a planning point is outside the reach; 0 where reach is sufficient.

    Args:
        plan: plan of a job or of one tool.
        point: planning point.
    """
    plan, point = plan.at(point)
    s = min(int(np.searchsorted(plan.path.stations, point)), len(plan.path.stations) - 1)
    return float(plan.candidates.shortfall[s])


def _sentence(plan: Plan, s: int, reason: InfeasibilityReason, point: int) -> str:
    if point in plan.notes:
        return plan.notes[point]
    if plan.compensation is not None and plan.compensation.lost[point]:
        return _lost_by_shift(plan, reason, point)
    rotations = plan.candidates.reason_of_rotation()[s]
    feasible = int((rotations == InfeasibilityReason.OK).sum())
    if reason == InfeasibilityReason.COLLIDING and plan.check is not None and plan.setup.collision is not None:
        k = int(plan.check.pair[point])
        if k >= 0:
            return _too_near(plan.setup.collision.pairs[k])
    if feasible and not plan.options.is_searched:
        known = (
            InfeasibilityReason.LIMIT,
            InfeasibilityReason.SINGULAR_WRIST,
            InfeasibilityReason.SINGULAR_ELBOW,
            InfeasibilityReason.SINGULAR_SHOULDER,
            InfeasibilityReason.UNSTABLE,
        )
        own = f" ({_SHIFTED[reason]})" if reason in known else ""
        if reason == InfeasibilityReason.COLLIDING:
            own = " (it collides)"
        but = "" if plan.setup.collision is None else ", collisions not checked"
        return f"{_OWN[plan.options.method]} does not work here{own}; {feasible} of {len(rotations)} rotations do{but}"
    if feasible:
        return (
            f"{feasible} of {len(rotations)} rotations work here, but none can be reached from the neighbouring "
            "points without leaving the path: a retract between them, another rotation range or a smaller "
            "singularity margin would help"
        )
    is_out_of_reach = bool((plan.candidates.reasons_at(s) == InfeasibilityReason.UNREACHABLE).all())
    external = explain_external_axes(plan, point, out_of_reach=is_out_of_reach)
    positions = f" {external.stands}" if external.stands else ""
    if is_out_of_reach:
        short = 1e3 * plan.candidates.shortfall[s]
        missing = f"{short:.0f}" if short >= 0.5 else "less than 1"
        elsewhere = f"{external.elsewhere}; " if external.elsewhere else ""
        if not short > 0.0:
            return (
                f"no posture at any rotation{positions} brings the tool here with this axis, though it is not too far "
                f"away; {elsewhere}turning or moving the workpiece would help"
            )
        return (
            f"out of reach at every rotation{positions}: the wrist centre lies {missing} mm outside the workspace; "
            f"{elsewhere}moving the workpiece or the robot by that much would help"
        )
    parts = [f"{int((rotations == r).sum())} {_WORDS[r]}" for r in _WORDS if (rotations == r).any()]
    joint = _limiting_joint(plan, s) if (rotations == InfeasibilityReason.LIMIT).any() else ""
    best = describe_best_ratio(plan, s) if (rotations == InfeasibilityReason.UNSTABLE).any() else ""
    return (
        f"no rotation works{positions}: of {len(rotations)} tried, "
        + ", ".join(parts)
        + joint
        + _touching(plan, s)
        + best
    )


def _touching(plan: Plan, s: int) -> str:
    """Return the pair of bodies that causes most of a station's collisions."""
    if plan.found is None or plan.setup.collision is None:
        return ""
    pairs = plan.found.pairs[s]
    known, count = np.unique(pairs[pairs >= 0], return_counts=True)
    if not len(known):
        return ""
    order = known[np.argsort(-count, kind="stable")][:2]
    return f" ({', '.join(plan.setup.collision.pairs[int(k)].name for k in order)})"


def _lost_by_shift(plan: Plan, reason: InfeasibilityReason, point: int) -> str:
    size = float(np.linalg.norm(plan.compensation.offset[point])) if plan.compensation is not None else 0.0
    what = f"possible as programmed, but not with the compensation of {1e3 * size:.3f} mm: "
    if reason == InfeasibilityReason.COLLIDING and plan.check is not None and plan.setup.collision is not None:
        k = int(plan.check.pair[point])
        if k >= 0:
            return f"{what}{_too_near(plan.setup.collision.pairs[k])}"
    return what + _SHIFTED.get(reason, "no configuration of the same branch is there")


_OWN = {"default": "the CAM file's own rotation", "jiao2022": "the rotation that jiao2022 takes"}
_SHIFTED = {
    InfeasibilityReason.UNREACHABLE: "the shifted point is out of reach",
    InfeasibilityReason.LIMIT: "a joint would leave its range",
    InfeasibilityReason.SINGULAR_WRIST: "it comes too near the wrist singularity",
    InfeasibilityReason.SINGULAR_ELBOW: "it comes too near the stretched arm (elbow singularity)",
    InfeasibilityReason.SINGULAR_SHOULDER: "it comes too near the shoulder singularity",
    InfeasibilityReason.UNSTABLE: "the stable depth of cut is below min_stability_ratio",
    InfeasibilityReason.COLLIDING: "the way there collides",
}
_WORDS = {
    InfeasibilityReason.UNREACHABLE: "are out of reach",
    InfeasibilityReason.LIMIT: "break a joint limit",
    InfeasibilityReason.SINGULAR_WRIST: "are too near the wrist singularity",
    InfeasibilityReason.SINGULAR_ELBOW: "are too near the stretched arm (elbow singularity)",
    InfeasibilityReason.SINGULAR_SHOULDER: "are too near the shoulder singularity",
    InfeasibilityReason.UNSTABLE: "lie below min_stability_ratio",
    InfeasibilityReason.COLLIDING: "collide",
    InfeasibilityReason.BOUNDS: "lie outside the given rotation range or the steering rules",
    InfeasibilityReason.NO_PATH: "cannot be joined to their neighbours",
}


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


def _too_near(pair: CollisionPair) -> str:
    own = (
        suggest_remedy(pair) if set(pair.kinds) == {"link"} else ""
    )  # contacts of a spindle at a link are not caused by the arm design
    return f"{pair.name} touch or come nearer than the clearance{own}"


def _limiting_joint(plan: Plan, s: int) -> str:
    """Return the joint whose limit is violated least, and the amount."""
    joint, missed = _missed_limit(plan, s)
    return f" (nearest: joint {joint + 1} by {np.degrees(missed):.1f}°)"


def _missed_limit(plan: Plan, s: int) -> tuple[int, float]:
    """Return, for the configuration of station s nearest to the limits, its joint and the violation in rad."""
    arm = plan.setup.arm
    joints, reason = solve_station(plan.path, arm, plan.candidates, s)
    q = np.asarray(wrap_angle(joints[reason == InfeasibilityReason.LIMIT]))[:, None] + arm.turns  # (L, K, 6)
    over = np.maximum(arm.lower - q, q - arm.upper).clip(min=0.0)
    best = np.unravel_index(over.max(axis=-1).argmin(), over.shape[:2])
    joint = int(over[best].argmax())
    return joint, float(over[best][joint])


SURE = "Their uncertainty is given by the intervals; "


def describe_model_misfit(plan: Plan) -> str:
    """Return the model discrepancy stated in the stiffness file as a sentence; empty where its readings show none.

    Args:
        plan: plan of one tool.
    """
    position = predict_position_error(plan)
    return " ".join(w for w in (_springs_words(plan), "" if position is None else position.words()) if w)


def _springs_words(plan: Plan) -> str:
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
            f"Around {'points' if several else 'point'} {_some(plan.elsewhere)} the rotation is another than stiffness "
            "alone would choose: with that one the path shifted against the deflection could not be driven."
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
    out += _where_external(plan) + list_overruled_pins(plan)
    out += _describe_reentries(plan)
    out += describe_settlement(plan)
    changes = _changes(plan)
    if changes:
        more = f"; and {len(changes) - 6} more" if len(changes) > 6 else ""
        changes_text = "; ".join(changes[:6]) + more
        out.append(f"The arm changes its configuration between runs, where the tool is retracted: {changes_text}")
    return tuple(out)


def _some(points: tuple[int, ...], most: int = 6) -> str:
    more = f" and {len(points) - most} more" if len(points) > most else ""
    return ", ".join(map(str, points[:most])) + more


def _where_external(plan: Plan) -> list[str]:
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
        f"The tool is lifted inside of the cut at {'points' if several else 'point'} {_some(points)} and enters again "
        "there: it leaves a mark."
    ]


def _changes(plan: Plan) -> list[str]:
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


def compute_gamma(plan: Plan) -> Array:
    """Return the (P,) rotation gamma in rad, as in the files, at every planning point.

    Args:
        plan: plan of a job or of one tool.
    """
    return np.asarray(wrap_angle(plan.chosen.assignment.phi + plan.path.offset))
