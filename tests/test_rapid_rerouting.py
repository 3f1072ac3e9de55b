"""Blocked rapid moves are avoided by whole turns or by another branch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_planning_path import toolpath
from test_planning_pipeline import FREE, UP, C, R, small_job

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import MoveKind
from machopt.planning.job import rapid_rerouting
from machopt.planning.job.rapid_rerouting import reroute_blocked_rapids
from machopt.planning.motion.rapid_moves import BlockedRapid
from machopt.planning.motion.trajectory_builder import MotionTimeline, build_timeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import SequenceBreak

ROWS = [
    ((x, y, 0.01 if kind is C else 0.08), UP, kind)
    for x, kinds in ((-0.1, (R, C, C, R)), (0.1, (R, C, C, R)))
    for y, kind in zip((-0.1, -0.1, 0.1, 0.1), kinds, strict=True)
]  # two cuts, with rapid moves before, between and after


HOME = np.deg2rad([0, -90, 90, 0, 45, 170.0])  # joint 6 can reach configurations on either side of zero from here


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return small_job(tmp_path_factory.mktemp("passages"), ROWS, FREE, home=HOME)


@pytest.fixture(scope="module")
def driven(made: Plan) -> MotionTimeline:
    done = build_timeline(made, toolpath(ROWS))
    assert done.trajectory is not None
    return done


def stop(before: float, after: float, code: Any = "rapid_blocked") -> SequenceBreak:
    return SequenceBreak(
        before=before, after=after, code=code, text="no collision-free path was found past a ~ b", help="", pair="a ~ b"
    )


def second_cut(plan: Plan) -> tuple[int, int]:
    """Return the first planning point of the cut in the second half, and the last planning point."""
    cut = np.flatnonzero((plan.path.index >= 4) & (plan.path.move == MoveKind.CUT))
    return int(cut[0]), len(plan.path.index) - 1


class Motion:
    """Simulate the motion of a plan: fail with ``stops`` if ``blocked(plan)`` is true."""

    def __init__(self, good: MotionTimeline, blocked: Any, stops: tuple[SequenceBreak, ...]) -> None:
        self.good, self.blocked, self.stops, self.asked = good, blocked, stops, 0

    def __call__(self, plan: Plan) -> tuple[Plan, MotionTimeline]:
        self.asked += 1
        if not self.blocked(plan):
            return plan, self.good
        return plan, replace(self.good, trajectory=None, obstructions=self.stops)


def test_drivable_plan_is_unchanged(made: Plan, driven: MotionTimeline) -> None:
    motion = Motion(driven, lambda plan: False, ())
    assert reroute_blocked_rapids(made, motion, StageTimings()) == (made, driven)
    assert motion.asked == 1


def test_plan_after_a_blocked_move_is_shifted_by_whole_turns(made: Plan, driven: MotionTimeline) -> None:
    first, last = second_cut(made)
    q = made.chosen.assignment.q
    motion = Motion(driven, lambda plan: np.allclose(plan.chosen.assignment.q, q), (stop(3.0, 4.0),))
    plan, timeline = reroute_blocked_rapids(made, motion, StageTimings())
    assert timeline is not None
    assert timeline.trajectory is not None
    turned = plan.chosen.assignment.q - q
    begin = int(np.searchsorted(made.path.index, 4.0))
    assert begin <= first
    assert (turned[:begin] == 0).all()
    whole = turned[begin : last + 1] / (2 * np.pi)
    np.testing.assert_allclose(whole, np.round(whole), atol=1e-12)
    assert 1 <= np.count_nonzero(np.round(whole[0])) <= rapid_rerouting.JOINTS
    arm = made.setup.arm
    assert (plan.chosen.assignment.q >= arm.lower).all()
    assert (plan.chosen.assignment.q <= arm.upper).all()
    np.testing.assert_allclose(plan.chosen.cost, made.chosen.cost, rtol=1e-9)  # the same configurations
    assert plan.chosen.objective.travel > made.chosen.objective.travel
    assert "from point 3 to point 4: joint" in timeline.detours[-1]


def test_blocked_move_home_turns_the_last_segment(made: Plan, driven: MotionTimeline) -> None:
    q = made.chosen.assignment.q
    motion = Motion(driven, lambda plan: np.allclose(plan.chosen.assignment.q, q), (stop(7.0, float("nan")),))
    plan, timeline = reroute_blocked_rapids(made, motion, StageTimings())
    assert timeline is not None
    assert timeline.trajectory is not None
    changed = np.flatnonzero((plan.chosen.assignment.q != q).any(axis=1))
    last_run = made.path.runs[-1]
    assert changed.min() >= last_run[0]
    assert changed.max() == last_run[1]


def nothing_is_free(*_: object, **__: object) -> BlockedRapid:
    return BlockedRapid("a ~ b", np.zeros(6), 0.5, "way")


def test_another_branch_starts_at_home_where_no_turn_helps(
    made: Plan, driven: MotionTimeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rapid_rerouting, "plan_rapid", nothing_is_free)
    taken = int(made.chosen.assignment.branch[0])
    motion = Motion(driven, lambda plan: plan.chosen.assignment.branch[0] == taken, (stop(float("nan"), 0.0),))
    plan, timeline = reroute_blocked_rapids(made, motion, StageTimings())
    assert timeline is not None
    assert timeline.trajectory is not None
    assert plan.chosen.assignment.branch[0] != taken
    # the candidates of the original plan are unchanged
    assert made.candidates.feasible[0][:, made.candidates.branch == taken].any()
    assert f"to branch {taken}" in timeline.detours[-1]


def test_branch_is_kept_where_no_turn_helps(
    made: Plan, driven: MotionTimeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plan changes branch between the cuts; the search itself would not take the branch of its first half."""
    monkeypatch.setattr(rapid_rerouting, "plan_rapid", nothing_is_free)
    a, begin = made.chosen.assignment, int(np.searchsorted(made.path.index, 4.0))
    usable = made.candidates.branch[made.candidates.feasible[0].any(axis=(0, 2))]
    other = int(next(b for b in usable if b != a.branch[0]))
    branch = a.branch.copy()
    branch[:begin] = other
    mixed = replace(made, chosen=replace(made.chosen, assignment=replace(a, branch=branch)))

    def changes(plan: Plan) -> bool:
        b = plan.chosen.assignment.branch
        return bool(b[begin - 1] != b[begin])

    plan, timeline = reroute_blocked_rapids(mixed, Motion(driven, changes, (stop(3.0, 4.0),)), StageTimings())
    assert timeline is not None
    assert timeline.trajectory is not None
    assert not changes(plan)
    assert plan.candidates.shut is not None
    assert plan.candidates.shut[other, a.branch[begin]]
    assert f"between branches {other} and {a.branch[begin]}" in timeline.detours[-1]


@pytest.mark.parametrize("code", ["rapid_collides", "not_driven", "home_collides"])
def test_other_failures_are_reported_unchanged(
    made: Plan, driven: MotionTimeline, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    monkeypatch.setattr(rapid_rerouting, "plan_rapid", nothing_is_free)
    motion = Motion(driven, lambda plan: True, (stop(3.0, 4.0, code),))
    plan, timeline = reroute_blocked_rapids(made, motion, StageTimings())
    assert plan is made
    assert timeline is not None
    assert timeline.obstructions == motion.stops
    assert motion.asked == 1
    always = Motion(driven, lambda plan: True, (stop(3.0, 4.0),))  # a single branch: no branch change to exclude
    assert reroute_blocked_rapids(made, always, StageTimings())[0] is made


def test_incomplete_plan_is_not_searched_again(
    made: Plan, driven: MotionTimeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another search would not know the reason of the unreachable points, for example gouging."""
    monkeypatch.setattr(rapid_rerouting, "plan_rapid", nothing_is_free)
    a = made.chosen.assignment
    lacking = replace(
        made, chosen=replace(made.chosen, assignment=a.marked(made.path.counted, InfeasibilityReason.GOUGING))
    )
    motion = Motion(driven, lambda plan: True, (stop(float("nan"), 0.0),))
    assert reroute_blocked_rapids(lacking, motion, StageTimings())[0] is lacking
    assert motion.asked == 1


def test_omitted_points_have_no_turn(made: Plan, driven: MotionTimeline) -> None:
    """The last rapid point of the file is out of reach: the move to home starts at the point before it."""
    a, q = made.chosen.assignment, made.chosen.assignment.q.copy()
    last = made.path.runs[-1][1]
    q[last] = np.nan
    short = replace(made, chosen=replace(made.chosen, assignment=replace(a, q=q)))
    retained = np.isfinite(q).all(axis=1)
    motion = Motion(
        driven, lambda plan: np.allclose(plan.chosen.assignment.q[retained], q[retained]), (stop(6.0, float("nan")),)
    )
    plan, timeline = reroute_blocked_rapids(short, motion, StageTimings())
    assert timeline is not None
    assert timeline.trajectory is not None
    assert np.isnan(plan.chosen.assignment.q[last]).all()
    changed = np.flatnonzero((plan.chosen.assignment.q[retained] != q[retained]).any(axis=1))
    assert changed.max() == last - 1
