"""A rapid move that no free way was found for: the same postures by other whole turns, or others.

The choice takes any rapid move for one that can be driven, and pays its travel. That may not be so: the upper arm of a
robot whose shoulder goes right round would have to pass through its own base, which the other way round it need not.
Where the motion shows that, what follows is turned by whole turns of its joints, as far as limits allow. Where that
does not help, the job is chosen once more without a rapid move between these two branches, and without the branch that
is not come by from home or leads to no way home. The new plan is taken if all of it can be driven.
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
from machopt.planning.motion.rapid_moves import UNDER, BlockedRapid, plan_rapid
from machopt.planning.motion.retract_moves import compute_rest_poses
from machopt.planning.motion.search_budget import is_used_up
from machopt.planning.motion.trajectory_builder import SEARCHED, MotionTimeline
from machopt.planning.pipeline.path_planner import search_without_branch_changes
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import NO_WAY_FOUND, SequenceBreak

TRIES = 6  # plans made again: each goes round otherwise, or shuts a change of branch, of which six axes have 28
AROUND = 12  # whole turns that are tried at a place, the nearest first
JOINTS = 2  # most joints that go round at once

Motion = Callable[[Plan], tuple[Plan, MotionTimeline | None]]


@dataclass(frozen=True)
class _Shut:
    """Changes of branch that no free way was found for."""

    between: Bools  # (B, B)
    ends: frozenset[tuple[int, int]]  # station at an end of the path, branch
    told: tuple[str, ...]  # of each in words

    def more_than(self, other: _Shut) -> bool:
        return bool((self.between & ~other.between).any()) or not self.ends <= other.ends


def reroute_blocked_rapids(plan: Plan, motion: Motion, timings: StageTimings) -> tuple[Plan, MotionTimeline | None]:
    """The plan and its motion, or what goes round, or does without, changes of branch that cannot be driven.

    Args:
        plan: as it was searched for, not shifted against the load.
        motion: what is driven of a plan, and how.

    Returns:
        those of the plan itself where it can be driven, or where no other can be either.
    """
    first = motion(plan)
    if not is_complete(plan):  # what is missing or gouges is the plan's, and another search would not know of it
        return first
    driven, timeline = first
    B = plan.candidates.q.shape[2]
    shut, told = _Shut(np.zeros((B, B), bool), frozenset(), ()), dict[str, str]()
    for _ in range(TRIES):
        stops = _stops(timeline)
        if timeline is None or timeline.trajectory is not None or not stops or is_used_up():
            break
        stuck: list[SequenceBreak] = []
        with timings.stage("retime"):
            for stop in stops:
                turned = _turned(plan, stop)
                if turned is None:
                    stuck.append(stop)
                else:
                    plan, told[stop.where] = turned
        if stuck:
            more = _shut_by(driven, stuck, shut)
            if plan.found is None or not plan.candidates.stable or not more.more_than(shut):
                return first
            shut, told = more, {}
            with timings.stage("choose"):
                plan = search_without_branch_changes(plan, plan.found, shut.between, sorted(shut.ends), timings)
            if not is_complete(plan):
                return first
        driven, timeline = motion(plan)
    if timeline is None or timeline.trajectory is None:
        return first
    return driven, replace(timeline, detours=(*timeline.detours, *shut.told, *told.values()))


def _stops(timeline: MotionTimeline | None) -> list[SequenceBreak]:
    """Rapid moves between two free places that no way was found for."""
    every = () if timeline is None else timeline.obstructions[:SEARCHED]  # of the others little is known
    return [stop for stop in every if stop.code in NO_WAY_FOUND and stop.pair != UNDER]


def _turned(plan: Plan, stop: SequenceBreak) -> tuple[Plan, str] | None:
    """The plan with what follows a blocked move turned by whole turns to where a free way leads; and that in words.

    On the way home it is the last stretch that is turned.
    """
    q, home = plan.chosen.assignment.q, not np.isfinite(stop.after)
    known = np.flatnonzero(np.isfinite(q).all(axis=1))  # points that are passed by have no posture
    begin, before = _row(plan, stop.after), _row(plan, stop.before)
    if home:
        run = next(first for first, last in plan.path.runs if last >= before)
        begin = int(known[np.searchsorted(known, run)])
        before = int(known[known < begin].max(initial=-1))
    rest, end = compute_rest_poses(plan)
    if before >= 0:
        rest = _stands(plan, before, q[before])
    for turns, last in _other_turns(plan, begin, rest[:6]):
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
    """(6 + E,) the machine at a planning point with joints q (6,) rad."""
    return np.asarray(plan.path.whole(q[None], np.array([row]))[0])


def _other_turns(plan: Plan, begin: int, rest: Array) -> Iterator[tuple[Array, int]]:
    """Whole turns (6,) rad that the stretch from a planning point on may be turned by, and the last point that may.

    Nearest to where the machine stands first, rest (6,) rad.
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
    """A free way leads from a to b, (6 + E,) rad or m."""
    setup, options = plan.setup, plan.options
    if not np.isfinite([a, b]).all():
        return False
    move = plan_rapid(
        a,
        b,
        limits=setup.driven.limits,
        scale=options.rapid_scale,
        sample=options.sample,
        collision=setup.collision,
        step=options.collision_step,
        detours=lambda: (),
        rng=np.random.default_rng(options.seed),
        per_rad=setup.per_rad,
    )
    return not isinstance(move, BlockedRapid)


def _shut_by(plan: Plan, stops: list[SequenceBreak], shut: _Shut) -> _Shut:
    """With what stands in the way of one more motion."""
    between, ends, told = shut.between.copy(), set(shut.ends), list(shut.told)
    for stop in stops:
        a, b = (_branch(plan, place) for place in (stop.before, stop.after))
        if a == b or (a >= 0 and b >= 0 and between[a, b]):
            continue
        if a >= 0 and b >= 0:
            between[a, b] = between[b, a] = True
            told.append(_words(stop, f"between branches {a} and {b}"))
        else:
            row = _row(plan, stop.after if a < 0 else stop.before)
            ends.add((min(int(np.searchsorted(plan.path.stations, row)), len(plan.path.stations) - 1), max(a, b)))
            told.append(_words(stop, f"{'to' if a < 0 else 'from'} branch {max(a, b)}"))
    return _Shut(between, frozenset(ends), tuple(told))


def _row(plan: Plan, place: float) -> int:
    """The planning point at a place along the toolpath; −1 at home."""
    return int(np.searchsorted(plan.path.index, place)) if np.isfinite(place) else -1


def _branch(plan: Plan, place: float) -> int:
    """Of the planning point at a place along the toolpath; −1 at home."""
    row, a = _row(plan, place), plan.chosen.assignment
    return int(a.branch[row]) if row >= 0 and a.reason[row] == InfeasibilityReason.OK else -1


def _words(stop: SequenceBreak, what: str) -> str:
    return f"{what}: {stop.text} ({stop.where}), so that the plan does without"
