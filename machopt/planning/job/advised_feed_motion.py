"""Motion of one tool at advised feeds: ``advised_feed_share``, and method joint.

With method joint: fixed path or joint result, each at its own advised feeds.

The joint result is driven where its whole motion, rapid moves included, is shorter, and where no fewer points are in
tolerance at the feeds that the motion reaches. Otherwise the path of the plan is driven, at its own advised feeds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.posture_feed_result import AdvisedFeedResult, PostureFeedResult, WindowOutcome
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.posture_and_feed.advised_feeds import (
    AdvisedFeeds,
    advise_feeds,
    apply_advised_feeds,
    compute_driven_outcomes,
    restore_file_feeds,
)
from machopt.planning.tolerance.process_results import find_driven_feed

Drive = Callable[[Plan, Callable[[PlanOptions], Plan]], tuple[Plan, Plan, MotionTimeline | None]]
TRIES = 3  # of driving with feeds that are lowered where a driven point is not in tolerance


@dataclass(frozen=True)
class DrivenCandidate:
    """A plan as driven at its advised feeds."""

    plan: Plan
    driven: Plan
    timeline: MotionTimeline | None
    advised: AdvisedFeeds

    @property
    def seconds(self) -> float:
        """Cycle time; NaN without a motion."""
        if self.timeline is None or self.timeline.trajectory is None:
            return np.nan
        return float(self.timeline.trajectory.time[-1])


def drive_posture_and_feed(
    segment: ToolSegment,
    plan: Plan,
    timings: StageTimings,
    drive: Drive,
    replan: Callable[[PlanOptions], Plan],
    refused: str = "",
) -> tuple[Plan, Plan, MotionTimeline | None]:
    """Return the plan, the plan as driven, and the motion of the better of fixed path and joint result.

    Args:
        segment: Toolpath of one tool.
        plan: Its plan.
        timings: Receives the duration of the stages.
        drive: Computes the motion of a plan; its second argument plans anew with other options.
        replan: Plans the same with other options for the whole job.
        refused: Why the joint result is not to be driven; empty: it is tried.
    """
    toolpath = segment.toolpath
    fixed = drive_at_advised_feeds(plan, toolpath, drive, replan)
    if not np.isfinite(fixed.seconds):
        return _conclude(fixed, toolpath, np.nan, "the plan has no motion", ())
    if not fixed.advised.is_known or refused:
        reason = refused or f"no point has a feed advice: {fixed.advised.unknown_because}"
        return _conclude(fixed, toolpath, np.nan, reason, ())
    from machopt.planning.posture_and_feed.posture_feed_pipeline import optimize_windows  # imports CasADi

    with timings.stage("joint"):
        better, windows = optimize_windows(restore_file_feeds(fixed.plan, toolpath), toolpath)
    if not any(window.is_accepted for window in windows):
        reason = "no window is accepted" if windows else "no run of the toolpath is cut along a path with a tolerance"
        return _conclude(fixed, toolpath, np.nan, reason, windows)
    joint = drive_at_advised_feeds(better, toolpath, drive, lambda _: better)
    reason = _find_reason_against(fixed, joint, better, toolpath)
    return _conclude(fixed if reason else joint, toolpath, joint.seconds, reason, windows, fixed.seconds)


def _find_reason_against(fixed: DrivenCandidate, joint: DrivenCandidate, plan: Plan, toolpath: Toolpath) -> str:
    """Return why the joint result is not driven; empty where it is."""
    if not np.isfinite(joint.seconds):
        stopped = joint.timeline.obstructions if joint.timeline is not None else ()
        return f"its motion is not possible: {stopped[0].text}" if stopped else "its motion is not possible"
    if joint.plan.chosen.assignment is not plan.chosen.assignment:
        return "its rapid moves or margins need another plan"
    if joint.seconds >= fixed.seconds - plan.options.sample:
        return f"its cycle time is {joint.seconds:.2f} s, that of the fixed path {fixed.seconds:.2f} s"
    before, after = (compute_driven_outcomes(c.driven, toolpath, c.timeline).count("pass") for c in (fixed, joint))
    if after < before:
        return f"{after} points would be in tolerance, {before} are with the fixed path"
    return ""


def drive_share_of_advice(
    segment: ToolSegment, plan: Plan, share: float, drive: Drive, replan: Callable[[PlanOptions], Plan]
) -> tuple[Plan, Plan, MotionTimeline | None]:
    """Return the plan, the plan as driven, and its motion at some of the advised feeds.

    Args:
        segment: Toolpath of one tool.
        plan: Its plan.
        share: ``advised_feed_share``.
        drive: Computes the motion of a plan; its second argument plans anew with other options.
        replan: Plans the same with other options for the whole job.
    """
    toolpath = segment.toolpath
    at_file_feed = DrivenCandidate(*drive(plan, replan), AdvisedFeeds(np.full(len(toolpath), np.nan), 0))
    if not np.isfinite(at_file_feed.seconds):
        return at_file_feed.plan, at_file_feed.driven, at_file_feed.timeline
    reached = find_driven_feed(toolpath, at_file_feed.timeline)
    words = compute_driven_outcomes(at_file_feed.driven, toolpath, at_file_feed.timeline)
    passes = np.array([word == "pass" for word in words], bool)
    found = drive_at_advised_feeds(
        at_file_feed.plan, toolpath, drive, replan, lambda advised: advised.select_share(reached, passes, share)
    )
    result = AdvisedFeedResult(
        feed=np.where(np.isnan(toolpath.feed), np.nan, np.fmin(toolpath.feed, found.advised.limit_feeds())),
        share=share,
        slowed=len(found.advised.places),
        needed=found.advised.needed,
        file_feed_seconds=at_file_feed.seconds,
    )
    plan, driven = (replace(one, advised_feed=result) for one in (found.plan, found.driven))
    return plan, driven, found.timeline


def drive_at_advised_feeds(
    plan: Plan,
    toolpath: Toolpath,
    drive: Drive,
    replan: Callable[[PlanOptions], Plan],
    select: Callable[[AdvisedFeeds], AdvisedFeeds] | None = None,
) -> DrivenCandidate:
    """Return a plan driven at the advice for its postures, which another plan in its place has, too.

    Where the driven postures ask for less, because the motion rounds corners, the advice is lowered to theirs.

    Args:
        plan: Plan of one tool.
        toolpath: Its toolpath.
        drive: Computes the motion of a plan; its second argument plans anew with other options.
        replan: Plans the same with other options for the whole job.
        select: Returns the part of an advice that is driven; None: every advice holds.
    """

    def advise(one: Plan) -> AdvisedFeeds:
        whole = advise_feeds(one, toolpath)
        return whole if select is None else select(whole)

    advised = advise(plan)
    found = plan
    for _ in range(TRIES):
        start = apply_advised_feeds(restore_file_feeds(found, toolpath), advised)
        result = DrivenCandidate(*drive(start, replan), advised)
        if result.plan.chosen.assignment is start.chosen.assignment:
            slower = advised.lower_to(advise_feeds(result.driven, toolpath)) if np.isfinite(result.seconds) else None
            if slower is None:
                break
            advised = slower
            continue
        found, advised = result.plan, advise(result.plan)
    return result


def _conclude(
    candidate: DrivenCandidate,
    toolpath: Toolpath,
    joint_seconds: float,
    reason: str,
    windows: tuple[WindowOutcome, ...],
    fixed_seconds: float | None = None,
) -> tuple[Plan, Plan, MotionTimeline | None]:
    limit = candidate.advised.limit_feeds()
    result = PostureFeedResult(
        feed=np.where(np.isnan(toolpath.feed), np.nan, np.fmin(toolpath.feed, limit)),
        is_accepted=not reason,
        reason=reason,
        fixed_seconds=candidate.seconds if fixed_seconds is None else fixed_seconds,
        joint_seconds=joint_seconds,
        windows=windows,
    )
    plan, driven = (replace(one, posture_feed=result) for one in (candidate.plan, candidate.driven))
    return plan, driven, candidate.timeline
