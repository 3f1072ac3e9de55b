"""What more stiffness costs in time, joint travel and clearance: further plans, and which of them others beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.errors import InputError
from machopt.planning.cost.objective import compute_total
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan import Plan
from machopt.planning.plan_output.point_table import PointResults
from machopt.planning.sequence_search.worst_value_constraint import GAP

INDEX = GAP  # relative: the choice claims its objective no nearer than this, so no difference below it is one
TIME = 0.1  # s: eight control samples; what a controller adds at stops differs by more from one run to the next
TRAVEL = 1.0  # deg of all axes together: below the rotation grid, and nothing that wears or heats an axis
CLEARANCE = 0.01  # mm: clearance is kept before corners are rounded, by up to path_tolerance_mm (0.015)
SAME = 1.0 + 1e-6  # of such a difference: round-off of a plain 0.1 s


@dataclass(frozen=True, kw_only=True)
class FrontPlan:
    """One whole plan; the index is deflection in mm, or compliance in mm/N where no force is given."""

    plan: str
    changed: str  # against the options in force
    mean_index: float  # over the length cut, from the objective
    worst_index: float
    cycle_time_s: float
    joint_travel_deg: float  # of all axes together, over the whole motion
    clearance_mm: float | None  # least at the points; None where collisions are not checked
    objective: float | None = None  # J by the weights in force, in units of the plan asked for
    dominated: bool = False  # another plan is better in one of these, worst_index aside, and worse in none

    def worse(self, other: FrontPlan) -> tuple[float, ...]:
        """By how many times what counts as a difference this plan is worse than another, criterion by criterion."""
        least = INDEX * max(abs(self.mean_index), abs(other.mean_index))
        pairs = [
            (self.mean_index, other.mean_index, least),
            (self.cycle_time_s, other.cycle_time_s, TIME),
            (self.joint_travel_deg, other.joint_travel_deg, TRAVEL),
        ]
        if self.clearance_mm is not None and other.clearance_mm is not None:
            pairs.append((other.clearance_mm, self.clearance_mm, CLEARANCE))
        return tuple((a - b) / unit if unit else 0.0 for a, b, unit in pairs)


def check_front_options(options: PlanOptions) -> None:
    """Refuse options that leave nothing to trade, or plans that cannot be compared.

    Raises:
        InputError: with what would work.
    """
    wrong = None
    if options.method != "global":
        wrong = f"method {options.method} has no weights to change; --method global would work"
    elif options.compensate:
        wrong = "a compensated path is another in each plan; without --compensate the plans can be compared"
    elif options.allow_gaps:
        wrong = "with --allow-gaps each plan may cut other points; without it the plans can be compared"
    if wrong:
        raise InputError(f"--front: {wrong}", file="options", where="front")


def list_front_variants(options: PlanOptions) -> list[tuple[str, str, PlanOptions]]:
    """Name, what is changed, and the options of each further plan."""
    w = options.weights
    out = [
        (
            "stiffness counts more",
            "weights.travel, rotation and feed / 10",
            replace(options, weights=replace(w, travel=w.travel / 10, rotation=w.rotation / 10, feed=w.feed / 10)),
        ),
        ("travel counts more", "weights.travel × 4", replace(options, weights=replace(w, travel=4 * w.travel))),
        ("travel counts most", "weights.travel × 20", replace(options, weights=replace(w, travel=20 * w.travel))),
        (
            "time counts more",
            "weights.feed and travel × 10",
            replace(options, weights=replace(w, feed=10 * w.feed, travel=10 * w.travel)),
        ),
    ]
    if options.collision:
        wide = options.clearance + 0.01
        out.append(("wider clearance", f"clearance_mm {1e3 * wide:g}", replace(options, clearance=wide)))
    return out


def describe_missing_plans(points: Sequence[FrontPlan], options: PlanOptions) -> tuple[str, ...]:
    """One sentence where further plans are missing from a front; none where no front was asked for."""
    have = {p.plan for p in points}
    lacking = [name for name, _, _ in list_front_variants(options) if name not in have]
    if not points or not lacking:
        return ()
    return (f"--front: {', '.join(lacking)} left out: no motion was found, or it failed the checks",)


def describe_better_plans(points: Sequence[FrontPlan]) -> tuple[str, ...]:
    """One sentence where a further plan has less of what the plan asked for was to have least of.

    The smoothed choice is the best in its neighbourhood only: other weights may lead to another, better one.
    """
    own = points[0].objective if points else None
    rivals = [(p.objective, p) for p in points[1:] if p.objective is not None]
    if own is None or not rivals:
        return ()
    least, best = min(rivals, key=lambda r: r[0])
    if not least < own * (1.0 - INDEX):
        return ()
    return (
        f"--front: the plan '{best.plan}' ({best.changed}) is better by the weights asked for as well: objective "
        f"{least:.4f} against {own:.4f}, {100.0 * (1.0 - least / own):.2f} % less; these options would make it",
    )


def measure_front_plan(
    name: str, changed: str, the_plan: Plan, timeline: MotionTimeline, points: PointResults, asked: Plan
) -> FrontPlan:
    """What one driven plan comes to, the objective by the weights of the plan that was asked for."""
    motion, o = timeline.trajectory, the_plan.chosen.objective
    if motion is None:
        raise ValueError("a plan without a motion is no point of the front")
    unit, share = 1e3 * the_plan.scores.scale, the_plan.scores.scale / asked.scores.scale
    in_its_units = replace(o, mean=share * o.mean, worst=share * o.worst)
    clearance = points.table.clearance
    return FrontPlan(
        plan=name,
        changed=changed,
        mean_index=unit * o.mean,
        worst_index=unit * o.worst,
        cycle_time_s=float(motion.time[-1]),
        joint_travel_deg=float(np.degrees(np.abs(np.diff(motion.q, axis=0)).sum())),
        clearance_mm=1e3 * float(np.nanmin(clearance)) if np.isfinite(clearance).any() else None,
        objective=compute_total(in_its_units, asked.options.weights),
    )


def mark_dominated_plans(points: list[FrontPlan]) -> list[FrontPlan]:
    """The points with ``dominated`` told, by differences that count (INDEX, TIME, TRAVEL, CLEARANCE).

    A plan is dominated by one that is worse in nothing and better in something; of two alike the later is. Being alike
    does not carry over from one pair to the next, so the dominated are taken away one by one, the last first, and
    compared with what is left: some plan always is.
    """
    left = list(range(len(points)))

    def beaten(a: int, b: int, *, alike: bool) -> bool:
        """Plan b by plan a."""
        loss = points[a].worse(points[b])
        return max(loss) <= SAME and (min(loss) < -SAME or (alike and a < b))

    for alike in (False, True):
        for b in reversed(range(len(points))):
            if b in left and any(beaten(a, b, alike=alike) for a in left if a != b):
                left.remove(b)
    return [replace(p, dominated=k not in left) for k, p in enumerate(points)]
