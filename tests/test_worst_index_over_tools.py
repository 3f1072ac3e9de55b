"""Worst index of a job with tool changes: compared with every limit, and with separate choices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from small_cell import small_cell

from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.job import worst_index_over_tools as module
from machopt.planning.job.joined_plan import ToolSegmentPlan, compute_length_shares, join_plans, shift_break_indices
from machopt.planning.job.worst_index_over_tools import plan_worst_index_over_tools
from machopt.planning.optimality_certificate import compute_certificate
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.sequence_search.dynamic_programming import SequenceGrid
from machopt.planning.sequence_search.worst_value_constraint import WorstLimitedSequence
from machopt.toolpath.toolpath_reader import read_toolpath


def _groove(folder: Path, name: str, y: float, length: float) -> Path:
    xs = np.linspace(-0.5 * length, 0.5 * length, 12)
    rows = [f"{xs[0]},{y},40,0,0,1,rapid,", f"{xs[0]},{y},5,0,0,1,approach,2000"]
    rows += [f"{x},{y + 20 * np.sin(x / 40)},-1,0,0,1,cut,1500" for x in xs]
    rows += [f"{xs[-1]},{y},40,0,0,1,retract,3000"]
    (folder / name).write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min", *rows]) + "\n")
    return folder / name


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> list[Plan]:
    """A long groove with a short tool, and a short one at the end of the table with a long tool, planned separately."""
    folder = tmp_path_factory.mktemp("together")
    cell = replace(small_cell(folder), stiffness=ArmStiffness(joints=np.array([2.0, 2.0, 1.5, 0.5, 0.4, 0.3]) * 1e6))
    far = cell.tool.T_flange_tcp.copy()
    far[:3, 3] += [0.15, 0.0, 0.2]
    cells = [cell, replace(cell, tool=replace(cell.tool, T_flange_tcp=far))]
    options = PlanOptions(
        collision=False,
        rotation_step=np.radians(15.0),
        weights=replace(ObjectiveWeights(), worst=0.3, travel=0.3, rapid=0.0, reorientation=0.0),
    )
    out: list[Plan] = []
    for one, name, y, length in zip(cells, ("a.csv", "b.csv"), (-100.0, 300.0), (300.0, 60.0), strict=True):
        path = read_toolpath(_groove(folder, name, y, length))
        scale = out[0].scores.scale if out else None
        out.append(plan_path(one, path, options, scale=scale))
    return out


def _values(one: Plan, cap: float) -> float:
    """Return the rest of the objective of the cheapest sequence under a cap."""
    assert one.found is not None
    grid = SequenceGrid.build(one.path, one.candidates, one.scores, one.setup.cell.limits.velocity[:6], one.options)
    found = grid.capped(one.found.edges)
    assert found is not None
    free, floor, under = found
    if free.worst <= cap:
        return free.value
    answer = under(cap, np.inf) if cap >= floor else None
    return np.inf if answer is None else answer.value


def test_common_bound_is_that_of_the_best_limit(alone: list[Plan]) -> None:
    share, w = compute_length_shares(alone), alone[0].options.weights.worst
    plans, bound = plan_worst_index_over_tools(alone, share, StageTimings())
    assert bound is not None
    caps = np.unique(np.concatenate([(p.scores.cost / p.scores.scale).ravel() for p in alone]))
    caps = caps[np.isfinite(caps)][::7]
    every = [float(share @ [_values(p, c) for p in alone]) + w * c for c in caps.tolist()]
    assert bound <= min(every) + 1e-9
    assert bound >= min(every) * (1 - 0.01)  # every seventh cap
    one_by_one = float(share @ [p.choice.bound for p in alone])
    assert bound > one_by_one
    certificate = compute_certificate(join_plans([ToolSegmentPlan(p, 0, "") for p in plans], bound))
    assert certificate is not None
    assert certificate.bound == pytest.approx(bound)
    assert 0 <= certificate.gap < 5e-3


def test_combined_choice_is_never_worse_than_separate_ones(alone: list[Plan]) -> None:
    share = compute_length_shares(alone)
    plans, bound = plan_worst_index_over_tools(alone, share, StageTimings())
    before = join_plans([ToolSegmentPlan(p, 0, "") for p in alone])
    after = join_plans([ToolSegmentPlan(p, 0, "") for p in plans], bound)
    old, new = compute_certificate(before), compute_certificate(after)
    assert old is not None
    assert new is not None
    assert new.objective < old.objective
    assert new.gap < old.gap
    assert all(p.options == q.options for p, q in zip(plans, alone, strict=True))
    w = alone[0].options.weights.worst
    for p in plans:  # expressed in the user's weights
        o, assignment = p.chosen.objective, p.chosen.assignment
        own = rescore_plan(p, assignment).chosen.objective
        assert (own.total, own.worst) == pytest.approx((o.total, o.worst))
        assert p.choice.bound <= p.choice.total
        assert p.choice.total > w * o.worst * 0.9
    again, _ = plan_worst_index_over_tools(alone, share, StageTimings())
    for p, q in zip(plans, again, strict=True):
        np.testing.assert_array_equal(p.chosen.assignment.q, q.chosen.assignment.q)


def test_job_with_gaps_is_unchanged(alone: list[Plan]) -> None:
    plans, bound = plan_worst_index_over_tools(
        [alone[0], replace(alone[1], found=None)], compute_length_shares(alone), StageTimings()
    )
    assert bound is None
    assert plans[0] is alone[0]


def test_break_of_a_segment_names_its_ends(alone: list[Plan]) -> None:
    change = np.zeros(6)
    sequence_break = SequenceBreak(
        before=np.nan, after=3.0, code="rapid_blocked", text="no free way", help="another pose"
    )
    assert sequence_break.where == "from home to point 3"
    assert shift_break_indices(sequence_break, ToolSegmentPlan(alone[0], 10, "b")).where == "from home to point 13"
    after = ToolSegmentPlan(replace(alone[0], begin=change), 10, "b")
    assert shift_break_indices(sequence_break, after).where == "from the tool change to point 13"
    back = replace(sequence_break, before=5.0, after=np.nan)
    assert (
        shift_break_indices(back, ToolSegmentPlan(replace(alone[0], end=change), 10, "b")).where
        == "from point 15 to the tool change"
    )
    assert shift_break_indices(back, after).where == "from point 15 to home"


def build_segment_plan(total: float, worst: float) -> Plan:
    """Return a stand-in for a plan, with the fields that its cost needs."""
    objective = SimpleNamespace(total=total, worst=worst)
    return cast(Plan, SimpleNamespace(chosen=SimpleNamespace(objective=objective)))


def test_improvements_are_accepted_together_or_one_by_one() -> None:
    """J = Σ share (total − w worst) + w max worst; by hand."""
    share, w = np.array([0.5, 0.5]), 1.0
    best = [build_segment_plan(2.0, 1.0), build_segment_plan(2.0, 1.0)]
    assert module._sum_job_objective([p.chosen.objective for p in best], share, w) == pytest.approx(2.0)
    both = [build_segment_plan(1.5, 0.5), build_segment_plan(1.5, 0.5)]
    assert module._select_better(best, both, share, w) == both  # 1 + 0.5
    first = [build_segment_plan(1.5, 1.0), build_segment_plan(3.0, 1.0)]
    assert module._select_better(best, first, share, w) == [first[0], best[1]]
    worse = [build_segment_plan(3.0, 1.0), build_segment_plan(2.5, 1.5)]
    assert module._select_better(best, worse, share, w) is best


def test_segment_under_a_limit_is_solved_once() -> None:
    requested: list[float] = []

    def solve(cap: float, limit: float) -> WorstLimitedSequence | None:
        requested.append(cap)
        return WorstLimitedSequence(np.empty((0, 3), np.int32), 7.0, 0.8 * cap) if limit > 7.0 else None

    one = module._Stretch(WorstLimitedSequence(np.empty((0, 3), np.int32), 5.0, 2.0), 0.5, solve)
    assert one.under(2.5, 6.0) is one.free
    assert one.under(2.5, 5.0) is None  # not better than the known sequence
    assert one.under(0.4, 99.0) is None  # below the minimum of any sequence
    assert one.under(1.0, 6.0) is None
    found = one.under(1.0, 8.0)
    assert found is not None
    assert found.value == 7.0
    assert one.under(0.9, 8.0) is found  # 0.8 ≤ 0.9 ≤ 1
    assert one.under(0.9, 7.0) is None
    assert requested == [1.0, 1.0]
