"""What more stiffness costs in time, joint travel and clearance: further plans, and which of them others beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.domain.options import PlanOptions
from machopt.errors import InputError
from machopt.plan.made import Plan
from machopt.plan.points import PointResults
from machopt.plan.timeline import Timeline

SAME = 1e-6  # relative: nearer than this two plans are alike in what is compared


@dataclass(frozen=True)
class Point:
    """One whole plan; the index is deflection in mm, or compliance in mm/N where no force is given."""

    plan: str
    changed: str  # against the options in force
    mean_index: float  # over the length cut, from the objective
    worst_index: float
    cycle_time_s: float
    joint_travel_deg: float  # of all axes together, over the whole motion
    clearance_mm: float | None  # least at the points; None where collisions are not checked
    dominated: bool = False  # another plan is better in one of these, worst_index aside, and worse in none

    def criteria(self) -> tuple[float, ...]:
        """What is compared, less is better."""
        room = () if self.clearance_mm is None else (-self.clearance_mm,)
        return (self.mean_index, self.cycle_time_s, self.joint_travel_deg, *room)


def refuse(options: PlanOptions) -> None:
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


def variants(options: PlanOptions) -> list[tuple[str, str, PlanOptions]]:
    """Name, what is changed, and the options of each further plan."""
    w = options.weights
    out = [
        (
            "stiffness alone",
            "weights.travel, rotation and feed / 10",
            replace(options, weights=replace(w, travel=w.travel / 10, rotation=w.rotation / 10, feed=w.feed / 10)),
        ),
        ("less travel", "weights.travel × 4", replace(options, weights=replace(w, travel=4 * w.travel))),
        ("least travel", "weights.travel × 20", replace(options, weights=replace(w, travel=20 * w.travel))),
        (
            "less time",
            "weights.feed and travel × 10",
            replace(options, weights=replace(w, feed=10 * w.feed, travel=10 * w.travel)),
        ),
    ]
    if options.collision:
        wide = options.clearance + 0.01
        out.append(("more clearance", f"clearance_mm {1e3 * wide:g}", replace(options, clearance=wide)))
    return out


def left_out(points: Sequence[Point], options: PlanOptions) -> tuple[str, ...]:
    """One sentence where further plans are missing from a front; none where no front was asked for."""
    have = {p.plan for p in points}
    lacking = [name for name, _, _ in variants(options) if name not in have]
    if not points or not lacking:
        return ()
    return (f"--front: {', '.join(lacking)} left out: no motion was found, or it failed the checks",)


def measured(name: str, changed: str, the_plan: Plan, timeline: Timeline, points: PointResults) -> Point:
    """What one driven plan comes to."""
    motion, o = timeline.trajectory, the_plan.chosen.objective
    if motion is None:
        raise ValueError("a plan without a motion is no point of the front")
    unit = 1e3 * the_plan.scores.scale
    clearance = points.table.clearance
    return Point(
        name,
        changed,
        unit * o.mean,
        unit * o.worst,
        float(motion.time[-1]),
        float(np.degrees(np.abs(np.diff(motion.q, axis=0)).sum())),
        1e3 * float(np.nanmin(clearance)) if np.isfinite(clearance).any() else None,
    )


def weighed(points: list[Point]) -> list[Point]:
    """The points with ``dominated`` told; of two alike the later is."""

    def beats(a: int, b: int) -> bool:
        pairs = list(zip(points[a].criteria(), points[b].criteria(), strict=True))
        if any(x > y + SAME * abs(y) for x, y in pairs):
            return False
        return a < b or any(x < y - SAME * abs(y) for x, y in pairs)

    every = range(len(points))
    return [replace(p, dominated=any(beats(a, b) for a in every if a != b)) for b, p in enumerate(points)]
