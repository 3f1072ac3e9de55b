"""Alternative plans that trade stiffness, tolerances and stability against time, and their Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process_columns import merge_process_summaries
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CellError
from machopt.planning.cost.objective import PlanObjective, compute_total
from machopt.planning.cost.rapid_time import count_changes
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.point_table import PointResults
from machopt.planning.reentry.closed_contours import find_reentry_points
from machopt.planning.sequence_search.worst_value_constraint import GAP
from machopt.planning.stability.depth_ratio import find_missing_input

INDEX = GAP  # relative: accuracy of the objective of the choice, so smaller differences are not significant
TIME = 0.1  # s: eight control samples; the time a controller adds at stops varies by more between runs
TRAVEL = 1.0  # deg of all axes together: below the rotation grid, and irrelevant for wear and heating
COUNT = 0.5  # holes and points in tolerance: one more is a difference
ERROR = 1e-3  # mm, last digit of errors in tables
ADVISED_SHARES = (0.3, 0.6, 1.0)  # of the alternatives: a curve of tolerances against time has some points
STABILITY_WEIGHT = 30.0  # of the alternative: benchmarks/stability_choice.py
STABLE_RATIOS = {"stable cuts": 1.0, "stable cuts with reserve": 1.2}  # the reserve is that of weights.stability
LARGEST_RATIO = 10.0  # larger limits of the depth are not written
RATIO = 0.01  # stable depth over planned depth
CLEARANCE = 0.01  # mm: clearance is checked before corners are rounded, by up to path_tolerance_mm (0.015)
SAME = 1.0 + 1e-6  # factor of such a difference: round-off of 0.1 s


@dataclass(frozen=True, kw_only=True)
class FrontPlan:
    """Criteria of one whole plan; the index is deflection in mm, or compliance in mm/N where no force is given."""

    plan: str
    changed: str  # difference from the active options
    mean_index: float  # over the length cut, from the objective
    worst_index: float
    cycle_time_s: float
    joint_travel_deg: float  # of all axes together, over the whole motion
    clearance_mm: float | None  # least at the points; None where collisions are not checked
    in_tolerance: int | None = None  # holes and points that pass; None where nothing has a tolerance
    marginal: int | None = None
    fail: int | None = None
    unknown: int | None = None
    mean_error_mm: float | None = None  # nominal, of holes and points with a tolerance, at the driven feed
    worst_error_mm: float | None = None
    least_stability_ratio: float | None = None  # stable depth over planned depth, at most LARGEST_RATIO
    posture_changes: int = 0  # branch changes and whole turns in rapid moves
    objective: float | None = None  # J by the active weights, in units of the requested plan
    dominated: bool = False  # another plan is better in one of these, worst_index aside, and worse in none

    def worse(self, other: FrontPlan) -> tuple[float, ...]:
        """Return, per criterion, how much worse this plan is than another, in units of the smallest significant
        difference.

        Args:
            other: plan to compare with.
        """
        least = INDEX * max(abs(self.mean_index), abs(other.mean_index))
        pairs = [
            (self.mean_index, other.mean_index, least),
            (self.cycle_time_s, other.cycle_time_s, TIME),
            (self.joint_travel_deg, other.joint_travel_deg, TRAVEL),
        ]
        if self.clearance_mm is not None and other.clearance_mm is not None:
            pairs.append((other.clearance_mm, self.clearance_mm, CLEARANCE))
        if self.in_tolerance is not None and other.in_tolerance is not None:
            pairs.append((other.in_tolerance, self.in_tolerance, COUNT))
        if self.mean_error_mm is not None and other.mean_error_mm is not None:
            pairs.append((self.mean_error_mm, other.mean_error_mm, ERROR))
        if self.least_stability_ratio is not None and other.least_stability_ratio is not None:
            pairs.append((other.least_stability_ratio, self.least_stability_ratio, RATIO))
        return tuple((a - b) / unit if unit else 0.0 for a, b, unit in pairs)


def check_front_options(options: PlanOptions) -> None:
    """Refuse options that leave nothing to trade, or plans that cannot be compared.

    Args:
        options: plan options.

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
        raise CellError(f"--front: {wrong}", file="options", where="front")


def list_front_variants(options: PlanOptions) -> list[tuple[str, str, PlanOptions]]:
    """Return name, description of the change, and options of each alternative plan.

    Args:
        options: plan options.
    """
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
    out.append(
        (
            "rapids and changes count more",
            "weights.rapid and reorientation × 4",
            replace(options, weights=replace(w, rapid=4 * w.rapid, reorientation=4 * w.reorientation)),
        )
    )
    if options.collision:
        wide = options.clearance + 0.01
        out.append(("wider clearance", f"clearance_mm {1e3 * wide:g}", replace(options, clearance=wide)))
    return out


def list_process_variants(
    cells: Sequence[tuple[Cell, Toolpath]], options: PlanOptions
) -> list[tuple[str, str, PlanOptions]]:
    """Return the alternatives about tolerances and stability, where the process states them.

    Args:
        cells: the cell and the toolpath of each tool.
        options: plan options.
    """
    out: list[tuple[str, str, PlanOptions]] = []
    if not cells:
        return out
    process = cells[0][0].process
    has_tolerances = process is not None and any(one.tolerance.is_given for one in process.operations)
    if has_tolerances:
        out += _list_tolerance_variants(options)
    if not all(find_missing_input(cell, toolpath) for cell, toolpath in cells):
        out += _list_stability_variants(options, has_tolerances)
    return out


def _list_tolerance_variants(options: PlanOptions) -> list[tuple[str, str, PlanOptions]]:
    first = replace(options, objective="tolerance")
    out = []
    if options.objective == "tolerance":
        out.append(("index first", "objective index", replace(options, objective="index")))
    else:
        out.append(("tolerances first", "objective tolerance", first))
    for share in ADVISED_SHARES:
        name = "feed advice" if share == 1.0 else f"{100 * share:g} % of the feed advice"
        if options.advised_feed_share != share:
            changed = f"objective tolerance, advised_feed_share {share:g}"
            out.append((name, changed, replace(first, advised_feed_share=share)))
    if options.advised_feed_share is not None:
        out.append(("feeds of the file", "no advised_feed_share", replace(options, advised_feed_share=None)))
    return out


def _list_stability_variants(options: PlanOptions, has_tolerances: bool) -> list[tuple[str, str, PlanOptions]]:
    w, least = options.weights, options.min_stability_ratio
    weight = max(STABILITY_WEIGHT, 4.0 * w.stability)
    counted = replace(options, weights=replace(w, stability=weight))
    out = [("stability counts", f"weights.stability {weight:g}", counted)]
    for name, ratio in STABLE_RATIOS.items():
        if least is None or ratio > least:
            out.append((name, f"min_stability_ratio {ratio:g}", replace(options, min_stability_ratio=ratio)))
    if has_tolerances:
        ratio = max(1.0, least or 0.0)
        changed = f"objective tolerance, advised_feed_share 1, min_stability_ratio {ratio:g}"
        both = replace(options, objective="tolerance", advised_feed_share=1.0, min_stability_ratio=ratio)
        if both not in (options, replace(options, objective="tolerance", advised_feed_share=1.0)):
            out.append(("stable cuts, feed advice", changed, both))
    return out


def list_reentry_variants(
    requested: Plan, toolpath: Toolpath, options: PlanOptions
) -> list[tuple[str, str, PlanOptions]]:
    """Return the alternative with a lift inside of a closed contour, or without those that are permitted.

    Args:
        requested: the plan of the job.
        toolpath: its toolpath.
        options: its options.
    """
    if options.max_reentries:
        return [("no re-entry", "max_reentries 0", replace(options, max_reentries=0))]
    if options.tilts or not len(find_reentry_points(requested.path, toolpath)):
        return []
    name, changed, stiffer = list_front_variants(options)[0]
    return [
        ("one re-entry", "max_reentries 1", replace(options, max_reentries=1)),
        (f"one re-entry, {name}", f"max_reentries 1, {changed}", replace(stiffer, max_reentries=1)),
    ]


def describe_missing_plans(
    points: Sequence[FrontPlan], options: PlanOptions, cells: Sequence[tuple[Cell, Toolpath]] = ()
) -> tuple[str, ...]:
    """Return one sentence where alternative plans are missing from a front; none where no front was requested.

    Args:
        points: plans of the front.
        options: plan options.
        cells: the cell and the toolpath of each tool.
    """
    present = {p.plan for p in points}
    tried = [*list_front_variants(options), *list_process_variants(cells, options)]
    missing = [name for name, _, _ in tried if name not in present]
    if not points or not missing:
        return ()
    return (f"--front: {', '.join(missing)} left out: no motion was found, or it failed the checks",)


def describe_better_plans(points: Sequence[FrontPlan]) -> tuple[str, ...]:
    """Return one sentence where an alternative plan has a lower objective than the requested one.

    The smoothed choice is only a local optimum: other weights may lead to another, better one.

    Args:
        points: plans of the front, the requested one first.
    """
    requested = points[0].objective if points else None
    rivals = [(p.objective, p) for p in points[1:] if p.objective is not None]
    if requested is None or not rivals:
        return ()
    least, best = min(rivals, key=lambda r: r[0])
    if not least < requested * (1.0 - INDEX):
        return ()
    return (
        f"--front: the plan '{best.plan}' ({best.changed}) is better even by the requested weights: objective "
        f"{least:.4f} against {requested:.4f}, {100.0 * (1.0 - least / requested):.2f} % less; "
        "these options would make it",
    )


def measure_front_plan(
    name: str, changed: str, the_plan: Plan, timeline: MotionTimeline, points: PointResults, requested_plan: Plan
) -> FrontPlan:
    """Return the criteria of one driven plan, with the objective by the weights of the requested plan.

    Args:
        name: name of the plan.
        changed: description of the changed options.
        the_plan: plan to measure.
        timeline: its motion.
        points: its point results.
        requested_plan: requested plan.

    Raises:
        ValueError: the plan has no motion.
    """
    motion, o = timeline.trajectory, the_plan.chosen.objective
    if motion is None:
        raise ValueError("a plan without a motion is no point of the front")
    unit, share = 1e3 * the_plan.scores.scale, the_plan.scores.scale / requested_plan.scores.scale
    in_its_units = _convert_prices(replace(o, mean=share * o.mean, worst=share * o.worst), the_plan, requested_plan)
    clearance = points.table.clearance
    return FrontPlan(
        plan=name,
        changed=changed,
        mean_index=unit * o.mean,
        worst_index=unit * o.worst,
        cycle_time_s=float(motion.time[-1]),
        joint_travel_deg=float(np.degrees(np.abs(np.diff(motion.q, axis=0)).sum())),
        clearance_mm=1e3 * float(np.nanmin(clearance)) if np.isfinite(clearance).any() else None,
        **_measure_process(points),
        posture_changes=count_changes(
            the_plan.path, the_plan.chosen.assignment.q, the_plan.chosen.assignment.branch, the_plan.candidates.stable
        ),
        objective=None if in_its_units is None else compute_total(in_its_units, requested_plan.options.weights),
    )


def _convert_prices(parts: PlanObjective, plan: Plan, requested: Plan) -> PlanObjective | None:
    """Return the parts with the prices that the requested plan counts; None where they are not known."""
    own, wanted = plan.options, requested.options
    if own.advised_feed_share != wanted.advised_feed_share:
        return None
    tolerance, stability = parts.tolerance, parts.stability
    if own.objective != wanted.objective:
        tolerance = 0.0 if wanted.objective == "index" else np.nan
    if own.weights.stability != wanted.weights.stability:
        share = wanted.weights.stability / own.weights.stability if own.weights.stability else np.nan
        stability = share * stability if wanted.weights.stability else 0.0
    is_known = np.isfinite(tolerance) and np.isfinite(stability)
    return replace(parts, tolerance=tolerance, stability=stability) if is_known else None


def _measure_process(points: PointResults) -> dict[str, Any]:
    """Return outcomes, errors and least stability of a plan; nothing where the cell has no process."""
    summary, columns = merge_process_summaries(points.process), points.table.process
    if summary is None or columns is None:
        return {}
    found: dict[str, Any] = {}
    ratio = columns.compute_stability_ratios()
    if np.isfinite(columns.ap).any() and not np.isnan(ratio).all() and "unknown" not in columns.chatter:
        found["least_stability_ratio"] = min(float(np.nanmin(ratio)), LARGEST_RATIO)
    if summary.tolerances:
        counts = summary.after
        found |= {"in_tolerance": counts["pass"], **{name: counts[name] for name in ("marginal", "fail", "unknown")}}
        error = 1e3 * columns.compute_deciding_errors()
        if np.isfinite(error).any():
            found |= {"mean_error_mm": float(np.nanmean(error)), "worst_error_mm": float(np.nanmax(error))}
    return found


def mark_dominated_plans(points: list[FrontPlan]) -> list[FrontPlan]:
    """Return the points with ``dominated`` set, by significant differences (INDEX, TIME, TRAVEL, CLEARANCE).

    A plan is dominated by one that is worse in nothing and better in something; of two equal ones the later is
    dominated, unless the earlier is worse by however little and better in nothing.
    This equality is not transitive. Dominated plans are therefore removed one by one, the last first, and the others
    are compared with the remaining ones, so that at least one plan remains.

    Args:
        points: plans of the front, the requested one first.
    """
    remaining = [
        b for b, own in enumerate(points) if not any(_is_better(other, own) for other in points if other is not own)
    ]

    def beaten(a: int, b: int, *, alike: bool) -> bool:
        """Plan b by plan a."""
        loss = points[a].worse(points[b])
        return max(loss) <= SAME and (min(loss) < -SAME or (alike and a < b))

    for alike in (False, True):
        for b in reversed(range(len(points))):
            if b in remaining and any(beaten(a, b, alike=alike) for a in remaining if a != b):
                remaining.remove(b)
    return [replace(p, dominated=k not in remaining) for k, p in enumerate(points)]


def _is_better(plan: FrontPlan, other: FrontPlan) -> bool:
    """Return whether a plan is worse in nothing, not even by an insignificant difference, and better in something."""
    loss = plan.worse(other)
    return max(loss) <= 0.0 and min(loss) < 1.0 - SAME
