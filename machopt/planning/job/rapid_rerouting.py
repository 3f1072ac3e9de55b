"""Rerouting of rapid moves without a collision-free path: the same postures with other whole turns, or other postures.

The choice assumes that any rapid move can be driven, and prices its travel. That may be wrong: the upper arm of a
robot with a shoulder range of more than a full turn might have to pass through its own base in one direction. Where the
motion fails for that reason, the rest is shifted by whole turns of its joints, as far as limits allow. Where that
fails, the job is chosen again without a rapid move between these two branches, and without a branch that
cannot be reached from home or cannot return home. The new plan is accepted if all of it can be driven.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.job.constraint_conflicts import is_complete
from machopt.planning.motion.rapid_moves import UNDER, BlockedRapid, FreeSpace, RapidTiming, plan_rapid
from machopt.planning.motion.retract_moves import compute_rest_poses
from machopt.planning.motion.search_budget import is_used_up
from machopt.planning.motion.trajectory_builder import SEARCHED, MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.repeated_search import search_without_branch_changes
from machopt.planning.pipeline.sequence_breaks import NO_WAY_FOUND, SequenceBreak

TRIES = 6  # maximum number of new plans: each shifts turns, or forbids a branch change, of which six axes have 28
AROUND = 12  # maximum number of whole turns tried at a place, the nearest first
JOINTS = 2  # maximum number of joints shifted at once

Motion = Callable[[Plan], tuple[Plan, MotionTimeline | None]]


@dataclass(frozen=True)
class _Shut:
    """Branch changes without a collision-free path."""

    between: Bools  # (B, B)
    ends: frozenset[tuple[int, int]]  # station at an end of the path, branch
    descriptions_so_far: tuple[str, ...]  # description of each

    def more_than(self, other: _Shut) -> bool:
        """Return whether these changes include one that the other set does not.

        Args:
            other: set to compare with.
        """
        return bool((self.between & ~other.between).any()) or not self.ends <= other.ends


def reroute_blocked_rapids(plan: Plan, motion: Motion, timings: StageTimings) -> tuple[Plan, MotionTimeline | None]:
    """Return the plan and its motion, or an alternative that avoids the branch changes that cannot be driven.

    Args:
        plan: as it was searched for, not shifted against the load.
        motion: computes the driven plan and its motion.
        timings: receives the duration of the stages.

    Returns:
        Those of the plan itself where it can be driven, or where no alternative can be either.
    """
    first = motion(plan)
    if not is_complete(plan):  # missing points and gouges belong to the plan; another search would not remove them
        return first
    driven, timeline = first
    A = plan.setup.arm.solver.branches
    shut, descriptions = _Shut(np.zeros((A, A), bool), frozenset(), ()), dict[str, str]()
    for _ in range(TRIES):
        stops = _list_blocked_moves(timeline)
        if timeline is None or timeline.trajectory is not None or not stops or is_used_up():
            break
        stuck: list[SequenceBreak] = []
        with timings.stage("retime"):
            for stop in stops:
                turned = _shift_by_turns(plan, stop)
                if turned is None:
                    stuck.append(stop)
                else:
                    plan, descriptions[stop.where] = turned
        if stuck:
            more = _extend_shut_moves(driven, stuck, shut)
            if plan.found is None or not plan.candidates.stable or not more.more_than(shut):
                return first
            shut, descriptions = more, {}
            with timings.stage("choose"):
                plan = search_without_branch_changes(plan, plan.found, shut.between, sorted(shut.ends), timings)
            if not is_complete(plan):
                return first
        driven, timeline = motion(plan)
    if timeline is None or timeline.trajectory is None:
        return first
    return driven, replace(timeline, detours=(*timeline.detours, *shut.descriptions_so_far, *descriptions.values()))


def _list_blocked_moves(timeline: MotionTimeline | None) -> list[SequenceBreak]:
    """Return the rapid moves between two contact-free places without a collision-free path."""
    every = () if timeline is None else timeline.obstructions[:SEARCHED]  # the others were not searched fully
    return [stop for stop in every if stop.code in NO_WAY_FOUND and stop.pair != UNDER]


def _shift_by_turns(plan: Plan, stop: SequenceBreak) -> tuple[Plan, str] | None:
    """Return the plan with the rest after a blocked move shifted by whole turns to a reachable posture, and its
    description.

    For a blocked return to home, the last stretch is shifted.
    """
    q, home = plan.chosen.assignment.q, not np.isfinite(stop.after)
    known = np.flatnonzero(np.isfinite(q).all(axis=1))  # skipped points have no posture
    begin, before = _find_row(plan, stop.after), _find_row(plan, stop.before)
    if home:
        run = next(first for first, last in plan.path.runs if last >= before)
        begin = int(known[np.searchsorted(known, run)])
        before = int(known[known < begin].max(initial=-1))
    rest, end = compute_rest_poses(plan)
    if before >= 0:
        rest = _stands(plan, before, q[before])
    for turns, last in _iterate_other_turns(plan, begin, rest[:6]):
        if not _free(plan, rest, _stands(plan, begin, q[begin] + turns)):
            continue
        if home and not _free(plan, _stands(plan, last, q[last] + turns), end):
            continue
        other = q.copy()
        other[begin : last + 1] += turns
        joints = ", ".join(f"joint {i + 1} by {np.degrees(turns[i]):+.0f}°" for i in np.flatnonzero(turns))
        assignment = replace(plan.chosen.assignment, q=other)
        return replace(
            rescore_plan(plan, assignment), over_external=None
        ), f"{stop.where}: {joints}, as {stop.text} the shorter way"
    return None


def _stands(plan: Plan, row: int, q: Array) -> Array:
    """Return the (6 + E,) machine joints at a planning point with joints q (6,) rad."""
    return np.asarray(plan.path.whole(q[None], np.array([row]))[0])


def _iterate_other_turns(plan: Plan, begin: int, rest: Array) -> Iterator[tuple[Array, int]]:
    """Yield whole turns (6,) rad by which the stretch from a planning point on may be shifted, and its last point.

    The turns nearest to the present posture ``rest`` (6,) rad come first.
    """
    a, arm, runs = plan.chosen.assignment, plan.setup.arm, plan.path.runs
    later = [(first, last) for first, last in runs if last >= begin]
    steps = [k for k in itertools.product((-1, 0, 1), repeat=6) if 0 < np.count_nonzero(k) <= JOINTS]
    every = 2 * np.pi * np.array(steps)
    every = every[np.argsort(np.abs(a.q[begin] + every - rest).sum(axis=1), kind="stable")]
    found = 0
    for turns in every:
        end = -1
        for first, last in later:
            rows = np.arange(max(first, begin), last + 1)
            rows = rows[np.isfinite(a.q[rows]).all(axis=1)]
            q = a.q[rows] + turns
            if (q < arm.lower).any() or (q > arm.upper).any():
                break
            end = int(rows.max(initial=end))
        if end >= begin:
            found += 1
            yield turns, end
        if found == AROUND:
            return


def _free(plan: Plan, a: Array, b: Array) -> bool:
    """Return whether a collision-free path leads from a to b, (6 + E,) rad or m."""
    setup, options = plan.setup, plan.options
    if not np.isfinite([a, b]).all():
        return False
    move = plan_rapid(
        a,
        b,
        timing=RapidTiming(setup.driven.limits, options.rapid_scale, options.sample),
        space=FreeSpace(collision=setup.collision, step=options.collision_step, per_rad=setup.per_rad),
        detours=lambda: (),
        rng=np.random.default_rng(options.seed),
    )
    return not isinstance(move, BlockedRapid)


def _extend_shut_moves(plan: Plan, stops: list[SequenceBreak], shut: _Shut) -> _Shut:
    """Return the set extended by the blocked moves of one more motion."""
    between, ends, descriptions = shut.between.copy(), set(shut.ends), list(shut.descriptions_so_far)
    for stop in stops:
        a, b = (_find_branch(plan, place) for place in (stop.before, stop.after))
        if a == b or (a >= 0 and b >= 0 and between[a, b]):
            continue
        if a >= 0 and b >= 0:
            between[a, b] = between[b, a] = True
            descriptions.append(_describe_stop(stop, f"between branches {a} and {b}"))
        else:
            row = _find_row(plan, stop.after if a < 0 else stop.before)
            ends.add((min(int(np.searchsorted(plan.path.stations, row)), len(plan.path.stations) - 1), max(a, b)))
            descriptions.append(_describe_stop(stop, f"{'to' if a < 0 else 'from'} branch {max(a, b)}"))
    return _Shut(between, frozenset(ends), tuple(descriptions))


def _find_row(plan: Plan, place: float) -> int:
    """The planning point at a place along the toolpath; −1 at home."""
    return int(np.searchsorted(plan.path.index, place)) if np.isfinite(place) else -1


def _find_branch(plan: Plan, place: float) -> int:
    """Of the planning point at a place along the toolpath; −1 at home."""
    row, a = _find_row(plan, place), plan.chosen.assignment
    return int(a.branch[row]) if row >= 0 and a.reason[row] == InfeasibilityReason.OK else -1


def _describe_stop(stop: SequenceBreak, what: str) -> str:
    return f"{what}: {stop.text} ({stop.where}), so that the plan does without"
