"""Trajectory of a chosen path: failures of runs, gaps where allowed, messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_planning_path import Rows, toolpath
from test_planning_pipeline import FREE, UP, C, R, pass_over_block, small_job

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.planning.motion import blocked_rapid_break, segment_planner, trajectory_builder
from machopt.planning.motion.rapid_moves import BlockedRapid
from machopt.planning.motion.trajectory_builder import build_timeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.retiming.run_retiming import RunFailure

ROWS = pass_over_block()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return small_job(tmp_path_factory.mktemp("timeline"), ROWS, FREE)


def builder(plan: Plan, *, gaps: bool = False, path: Toolpath | None = None) -> trajectory_builder._Builder:
    options = replace(plan.options, allow_gaps=gaps)
    return trajectory_builder._Builder(replace(plan, options=options), path or toolpath(ROWS), lambda _: None)


def no_room(b: trajectory_builder._Builder, before: int, after: int) -> SequenceBreak:
    return b._build_no_room_break(float(b.path.index[before]), float(b.path.index[after]))


def test_whole_path_is_driven_from_home_and_back(made: Plan) -> None:
    done = build_timeline(made, toolpath(ROWS))
    assert done.trajectory is not None
    assert done.obstructions == ()
    np.testing.assert_allclose(done.trajectory.q[[0, -1]], made.setup.cell.home[None, :6].repeat(2, 0), atol=1e-12)
    assert set(done.trajectory.move) == {int(MoveKind.RAPID), int(MoveKind.CUT)}


def test_run_without_room_at_an_end_loses_that_point(made: Plan) -> None:
    b = builder(made)
    ((first, last),) = [run for run in made.path.runs if run[1] > run[0]]
    points = np.flatnonzero(made.path.is_point)
    points = points[(points >= first) & (points <= last)]
    assert b._shorten_stretch(no_room(b, 0, first), first, last) == (points[1], last)
    at_end = replace(no_room(b, last, 0), after=float("nan"))
    assert b._shorten_stretch(at_end, first, last) == (first, points[-2])
    assert b._shorten_stretch(no_room(b, 0, first), first, int(points[1])) is None  # one remaining point is not a cut
    other = replace(no_room(b, 0, first), code="rapid_blocked")
    assert b._shorten_stretch(other, first, last) is None


def test_gap_without_room_stops_the_job_or_omits_adjacent_cuts(made: Plan) -> None:
    """In the second half of a run, as after a gap, no lift is found."""
    ((first, last),) = [run for run in made.path.runs if run[1] > run[0]]
    middle = int(np.flatnonzero(made.path.is_point)[5])
    b = builder(made)
    here = blocked_rapid_break.RestPose(made.setup.cell.home, float("nan"), -1)
    b.lifts.gap = lambda row: float("nan")  # type: ignore[method-assign]
    into, out = b._build_legs(here, middle, last), b._build_legs(here, first, middle)
    assert isinstance(into, SequenceBreak)
    assert isinstance(out, SequenceBreak)
    assert (into.code, into.after) == ("no_room", float(made.path.index[middle]))
    assert (out.code, out.before) == ("no_room", float(made.path.index[middle]))
    assert b._stretch(here, middle, last) is None
    assert b.obstructions == [into]
    allowed = builder(made, gaps=True)
    allowed.lifts.gap = b.lifts.gap  # type: ignore[method-assign]
    assert allowed._stretch(here, middle, last) is None
    assert allowed.obstructions == []
    assert [x.code for x in allowed.in_the_way] == ["no_room"] * len(allowed.in_the_way)
    assert next(iter(allowed.given_up)) == (middle, last)
    assert "left out with the stretch it is in: there is not enough free space" in allowed.given_up[middle, last]


def test_cut_that_loses_its_first_point_starts_at_the_next(made: Plan) -> None:
    ((first, last),) = [run for run in made.path.runs if run[1] > run[0]]
    middle = int(np.flatnonzero(made.path.is_point)[3])
    b = builder(made, gaps=True)
    gap = b.lifts.gap
    b.lifts.gap = lambda row: float("nan") if row == middle else gap(row)  # type: ignore[method-assign]
    end = b._stretch(blocked_rapid_break.RestPose(made.setup.cell.home, float("nan"), -1), middle, last)
    assert end is not None
    assert end.row == last
    (driven,) = b.driven
    assert driven[0] > middle
    assert "the cut to it is left out" in b.given_up[middle, last]
    assert first < middle


@pytest.mark.parametrize(
    ("reason", "code", "said"),
    [
        ("way", "rapid_blocked", "no collision-free path was found past spindle ~ post"),
        ("start", "home_collides", "another home pose"),
        ("end", "rapid_collides", "at the end of the rapid move"),
    ],
)
def test_blocked_rapid_move_reports_a_remedy(
    made: Plan, monkeypatch: pytest.MonkeyPatch, reason: str, code: str, said: str
) -> None:
    blocked = BlockedRapid("spindle ~ post", np.zeros(6), 0.0, reason)  # type: ignore[arg-type]
    monkeypatch.setattr(segment_planner, "plan_rapid", lambda *a, **k: blocked)
    done = build_timeline(made, toolpath(ROWS))
    assert done.trajectory is None
    assert code in {b.code for b in done.obstructions}
    assert any(said in f"{b.text} {b.help}" for b in done.obstructions)
    assert {b.pair for b in done.obstructions} == {"spindle ~ post"}


def test_job_of_gaps_only_is_no_motion(made: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """With gaps allowed each run may be omitted, but not all of them: the reason is reported."""
    blocked = BlockedRapid("spindle ~ post", np.zeros(6), 0.5, "way")
    own = segment_planner.plan_rapid
    monkeypatch.setattr(
        segment_planner, "plan_rapid", lambda a, b, **k: own(a, b, **k) if np.array_equal(a, b) else blocked
    )
    done = build_timeline(replace(made, options=replace(made.options, allow_gaps=True)), toolpath(ROWS))
    assert done.trajectory is None
    assert {b.code for b in done.obstructions} == {"rapid_blocked"}
    assert done.given_up


def test_undrivable_run_or_retract_is_a_break_at_its_place(made: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    ((first, last),) = [run for run in made.path.runs if run[1] > run[0]]
    middle = int(np.flatnonzero(made.path.is_point)[4])
    b = builder(made)
    here = blocked_rapid_break.RestPose(made.setup.cell.home, float("nan"), -1)
    monkeypatch.setattr(segment_planner, "retime_run", lambda run: RunFailure(1.5, "joint 2 leaves its range"))
    run = b._build_legs(here, first, last)
    assert isinstance(run, SequenceBreak)
    assert "joint 2 leaves its range" in run.text
    assert made.path.index[first] < run.after < made.path.index[last]
    lift = b._build_legs(here, middle, last)
    assert isinstance(lift, SequenceBreak)
    assert lift.after == float(made.path.index[middle])


def test_file_of_rapid_moves_only_uses_the_approach_feed(tmp_path_factory: pytest.TempPathFactory) -> None:
    rows: Rows = [((-0.1 + 0.05 * k, -0.1, 0.08), UP, R) for k in range(3)]
    p = small_job(tmp_path_factory.mktemp("rapid"), rows, FREE)
    assert (builder(p, path=toolpath(rows)).made.feed_after == p.options.approach_feed).all()
    cut = small_job(tmp_path_factory.mktemp("cut"), [*rows, ((0.1, -0.1, 0.08), UP, C)], FREE)
    feed = builder(cut).made.feed_after
    assert (feed == feed[-1]).all()  # rapid moves have the feed of the following cut
