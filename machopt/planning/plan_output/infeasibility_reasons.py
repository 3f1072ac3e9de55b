"""Messages about infeasible points: cause and remedy, from the plan's own numbers."""

from __future__ import annotations

import numpy as np

from machopt.collision.collision_pairs import CollisionPair, suggest_remedy
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.plan_output.external_axis_reasons import explain_external_axes
from machopt.planning.plan_output.infeasibility_remedies import describe_remedy, find_missed_limit
from machopt.planning.plan_output.stability_section import describe_best_ratio


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
        out[int(p)] = _describe_reason(plan, s, InfeasibilityReason(int(plan.chosen.assignment.reason[p])), int(p))
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


def compute_reach_shortfall(plan: Plan, point: int) -> float:
    """Return the distance in m by which a planning point is outside the reach; 0 where reach is sufficient.

    Args:
        plan: plan of a job or of one tool.
        point: planning point.
    """
    plan, point = plan.at(point)
    s = min(int(np.searchsorted(plan.path.stations, point)), len(plan.path.stations) - 1)
    return float(plan.candidates.shortfall[s])


def _describe_reason(plan: Plan, s: int, reason: InfeasibilityReason, point: int) -> str:
    if point in plan.notes:
        return plan.notes[point]
    if plan.compensation is not None and plan.compensation.lost[point]:
        return _describe_lost_by_shift(plan, reason, point)
    rotations = plan.candidates.reason_of_rotation()[s]
    feasible = int((rotations == InfeasibilityReason.OK).sum())
    if reason == InfeasibilityReason.COLLIDING and plan.check is not None and plan.setup.collision is not None:
        k = int(plan.check.pair[point])
        if k >= 0:
            return _describe_too_near(plan.setup.collision.pairs[k])
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
    positions = f" {external.position_text}" if external.position_text else ""
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
    joint = _describe_limiting_joint(plan, s) if (rotations == InfeasibilityReason.LIMIT).any() else ""
    best = describe_best_ratio(plan, s) if (rotations == InfeasibilityReason.UNSTABLE).any() else ""
    return (
        f"no rotation works{positions}: of {len(rotations)} tried, "
        + ", ".join(parts)
        + joint
        + _describe_touching(plan, s)
        + best
    )


def _describe_touching(plan: Plan, s: int) -> str:
    """Return the pair of bodies that causes most of a station's collisions."""
    if plan.found is None or plan.setup.collision is None:
        return ""
    pairs = plan.found.pairs[s]
    known, count = np.unique(pairs[pairs >= 0], return_counts=True)
    if not len(known):
        return ""
    order = known[np.argsort(-count, kind="stable")][:2]
    return f" ({', '.join(plan.setup.collision.pairs[int(k)].name for k in order)})"


def _describe_lost_by_shift(plan: Plan, reason: InfeasibilityReason, point: int) -> str:
    size = float(np.linalg.norm(plan.compensation.offset[point])) if plan.compensation is not None else 0.0
    what = f"possible as programmed, but not with the compensation of {1e3 * size:.3f} mm: "
    if reason == InfeasibilityReason.COLLIDING and plan.check is not None and plan.setup.collision is not None:
        k = int(plan.check.pair[point])
        if k >= 0:
            return f"{what}{_describe_too_near(plan.setup.collision.pairs[k])}"
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


def _describe_too_near(pair: CollisionPair) -> str:
    own = (
        suggest_remedy(pair) if set(pair.kinds) == {"link"} else ""
    )  # contacts of a spindle at a link are not caused by the arm design
    return f"{pair.name} touch or come nearer than the clearance{own}"


def _describe_limiting_joint(plan: Plan, s: int) -> str:
    """Return the joint whose limit is violated least, and the amount."""
    joint, missed = find_missed_limit(plan, s)
    return f" (nearest: joint {joint + 1} by {np.degrees(missed):.1f}°)"


def compute_gamma(plan: Plan) -> Array:
    """Return the (P,) rotation gamma in rad, as in the files, at every planning point.

    Args:
        plan: plan of a job or of one tool.
    """
    return np.asarray(wrap_angle(plan.chosen.assignment.phi + plan.path.offset))
