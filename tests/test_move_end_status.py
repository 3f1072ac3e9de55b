"""Failures between two points are reported in the row whose move ends there: points.csv, JSON and report."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import Row, changed_cell, optimize, result, toolpath
from test_path_gouges import LIMIT, UP, cell_of, plate, pose
from test_path_gouges import toolpath as held
from test_plan_explanation import ROWS, lose_row, made

from machopt.cli import main
from machopt.data_types.cell import CollisionShape
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import Code, SequenceBreak
from machopt.planning.plan_output.infeasibility_reasons import explain_points, list_breaks
from machopt.planning.plan_output.infeasibility_remedies import describe_remedy
from machopt.planning.plan_output.move_results import add_slowdown_notes, mark_undriven_points
from machopt.planning.plan_output.point_table import build_point_table
from machopt.planning.retiming.slowdowns import FeedSlowdown, Where

__all__ = ["made"]  # the fixture


def build_break(before: float, after: float, code: Code) -> SequenceBreak:
    return SequenceBreak(before=before, after=after, code=code, text="why it stops", help="what would help")


@pytest.mark.parametrize(
    ("before", "after", "code", "point", "status"),
    [
        (2.0, 3.0, "joint_jump", 3, InfeasibilityReason.NO_PATH),
        (2.25, 2.5, "collision", 3, InfeasibilityReason.COLLIDING),
        (2.0, 3.0, "joint_limit", 3, InfeasibilityReason.LIMIT),
        (np.nan, 0.0, "rapid_blocked", 0, InfeasibilityReason.NO_PATH),
        (9.0, np.nan, "rapid_collides", 9, InfeasibilityReason.COLLIDING),
        (np.nan, np.nan, "home_collides", 0, InfeasibilityReason.COLLIDING),
    ],
)
def test_failed_move_is_assigned_to_the_row_of_its_end(
    made: Plan, before: float, after: float, code: Code, point: int, status: InfeasibilityReason
) -> None:
    assert mark_undriven_points(made) is made
    stop = build_break(before, after, code)
    found = mark_undriven_points(made, [stop])
    (row,) = found.missing
    assert (found.path.index[row], found.chosen.assignment.reason[row]) == (point, status)
    assert explain_points(found) == {row: f"{stop.where}: why it stops"}
    assert describe_remedy(found, int(row)) == "what would help"
    assert np.isnan(found.chosen.cost[row])
    assert list_breaks(found, (stop,)) == (stop,)  # the break itself is reported as before
    assert not len(made.missing)


def test_place_between_two_points_gives_the_second_its_own_reason(made: Plan) -> None:
    inner = int(np.flatnonzero(~made.path.is_point)[0])
    without = lose_row(made, inner, InfeasibilityReason.LIMIT)
    found = mark_undriven_points(without)
    index = found.path.index
    (row,) = (p for p in found.missing if found.path.is_point[p])
    assert (index[row], found.chosen.assignment.reason[row]) == (np.ceil(index[inner]), InfeasibilityReason.LIMIT)
    text = explain_points(found)[int(row)]
    assert text.startswith(f"from point {index[row] - 1:g} to point {index[row]:g}: at {index[inner]:.2f} between them")
    assert [(b.code, b.before, b.after) for b in list_breaks(found)] == [("no_pose", index[row] - 1, index[row])]
    both = lose_row(without, int(row), InfeasibilityReason.LIMIT)
    assert mark_undriven_points(both) is both  # the second point has its own reason


def test_gouge_between_two_points_is_assigned_to_the_second(tmp_path: Path) -> None:
    rib = CollisionShape(
        name="rib", kind="box", size=(0.002, 0.1, 0.004), mesh=None, T_parent_shape=pose(0.0473, 0.0, 0.002)
    )
    cell = replace(cell_of(tmp_path, (plate(), rib)), stiffness=ArmStiffness(joints=np.full(6, 1e6)))
    path = held(
        [((x, 0.0, 0.05 * (x == 0)), UP, MoveKind.RAPID if x == 0 else MoveKind.CUT) for x in (0.0, 0.02, 0.08)]
    )
    options = PlanOptions(collision=False, rotation_step=np.radians(45.0), gouge=LIMIT)
    found = mark_undriven_points(plan_path(cell, path, options))
    table = build_point_table(found, path).table
    assert table.status == ("ok", "ok", "gouging")
    assert "the cutter gouges the finished part by 0.998 mm" in table.reason[2]
    row = int(np.flatnonzero(found.path.index == 2.0)[0])
    assert "another path in the CAM file" in describe_remedy(found, row)


def test_slow_move_is_reported_in_its_row(made: Plan) -> None:
    def dip(first: float, last: float, ratio: float, where: Where = "path") -> FeedSlowdown:
        return FeedSlowdown(first=first, last=last, ratio=ratio, where=where, joint=7, limit="jerk")

    assert not len(made.missing)
    table = replace(
        build_point_table(made, held([(at, UP, MoveKind.CUT) for at, _, _ in ROWS])).table, reason=("",) * len(ROWS)
    )
    dips = [dip(1.5, 2.0, 0.5), dip(2.0, 2.0, 0.4), dip(2.5, 3.5, 0.25), dip(5.0, 5.5, 0.1, "start")]
    output = add_slowdown_notes(table, dips).reason
    assert [k for k, text in enumerate(output) if text] == [2, 3, 4]
    assert output[2] == (
        "feed not held: down to 50 % of the programmed one between points 1.50 and 2.00, by jerk of e1"
    )
    assert "down to 25 %" in output[3]  # the lower value of the two
    given = replace(table, status=("ok", "ok", "gap", *table.status[3:]))
    assert add_slowdown_notes(given, dips).reason[2] == ""


def test_obstacle_between_two_points_is_reported_in_the_second_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both end points are free and the post is thin: every row was ok,
    and the table gave no reason for the missing motion."""
    post = "obstacles:\n  - {name: post, sphere_mm: 3, xyz_mm: [2140.7, -93.5, 795.3]}\n"
    cell, out = changed_cell(tmp_path, ("obstacles:\n", post)), tmp_path / "out"
    rows: list[Row] = [
        (-100, 0, 60, "rapid", ""),
        (-100, 0, 3, "approach", "1000"),
        (-40, 0, 3, "cut", "1500"),
        (-40, 0, 60, "rapid", ""),
    ]
    table = toolpath(tmp_path, rows)
    assert optimize(cell, table, out, "--set", "rotation_step_deg=30") == 3
    message = capsys.readouterr().err
    assert "the first is 2: from point 1 to point 2" in message
    with (out / "points.csv").open() as lines:
        by_point = list(csv.DictReader(lines))
    assert [r["status"] for r in by_point] == ["ok", "ok", "colliding", "ok"]
    assert "post" in by_point[2]["reason"]
    (infeasible,), (stop,) = result(out)["infeasible_points"], result(out)["breaks"]  # type: ignore[misc,attr-defined]
    assert (infeasible["point"], infeasible["reason"]) == (2, by_point[2]["reason"])
    assert (stop["from_point"], stop["to_point"]) == (1, 2)
    assert by_point[2]["reason"].split(": ", 1)[1][:40] in (out / "report.html").read_text()
    assert main(["verify", str(cell), str(table), str(out), "--quiet"]) == 3
