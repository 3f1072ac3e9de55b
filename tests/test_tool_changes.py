"""Jobs with tool changes: divided, planned, executed, verified and combined."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import pose, small_cell
from test_external_axes import K, slots
from test_planning_path import Rows, toolpath

from machopt.cell.tool_selection import select_job_tools, split_into_tool_segments
from machopt.data_types.cell import Cell, CutterGeometry
from machopt.data_types.plan_options import FixedRotation, PlanOptions, ProcessForce, SteeringRule
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathEvent, ToolpathOperation
from machopt.errors import InputError
from machopt.output.tables.plan_tables import write_points_csv, write_trajectory_csv
from machopt.planning.job.job_planner import JobPlan, plan_job
from machopt.planning.optimality_certificate import compute_certificate
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.collision_map import compute_collision_map
from machopt.planning.uncertainty.stiffness_uncertainty import compute_gains
from machopt.report.page_data.optimize_rotation_map import find_cut_stations
from machopt.report.page_data.optimize_scene import build_optimize_scene
from machopt.verification import Verification
from machopt.verification.motion.tool_changes import verify_tool_segments

OPTIONS = PlanOptions(
    collision=False, rotation_step=np.radians(30.0), force=ProcessForce(normal=200.0, axial=100.0), sample=0.02
)
CHANGE = np.deg2rad([20, -90, 90, 0, 45, 0.0])
EVENTS = (
    ToolpathEvent(10, "spindle", "M5"),
    ToolpathEvent(10, "tool", "T2", 2.0),
    ToolpathEvent(10, "spindle", "S900 M3", 900.0),
)
LABELS = ("3", "3", "BALL", "3")  # the tool of each slot


def table(folder: Path) -> Cell:
    cell = small_cell(folder, stiffness=K, obstacles=())
    long = replace(cell.tool, T_flange_tcp=pose(0, 0, 0.45), mass=24.0, cutter=CutterGeometry(0.016, 0.1))
    return replace(cell, tools={"3": cell.tool, "BALL": long}, tool_name="3", tool_change=CHANGE)


def job(*tools: str, rows: Rows | None = None) -> Toolpath:
    """Return one slot per tool, each in its own operation."""
    path = toolpath(rows or slots(*np.linspace(0.1, -0.1, len(tools))))
    operation = np.minimum(np.cumsum(path.move == MoveKind.RAPID) - 1, len(tools) - 1).astype(np.int32)
    labels = tuple(ToolpathOperation(f"op{k}", "trajectory", tool) for k, tool in enumerate(tools))
    return replace(path, operation=operation, operations=labels, events=EVENTS)


def test_job_is_divided_at_tool_changes(tmp_path: Path) -> None:
    cell, path = table(tmp_path), job(*LABELS)
    segments = split_into_tool_segments(select_job_tools(cell, path), path)
    assert [(s.tool, s.first, s.stop, s.number) for s in segments] == [
        ("3", 0, 10, 1),
        ("BALL", 10, 15, 2),
        ("3", 15, 20, 3),
    ]
    events = [[(e.index, e.text) for e in s.toolpath.events] for s in segments]
    assert events == [[(10, "M5")], [(0, "T2"), (0, "S900 M3")], []]  # the spindle stops before its tool is removed
    for s, begin, end in zip(segments, (cell.home, CHANGE, CHANGE), (CHANGE, CHANGE, cell.home), strict=True):
        np.testing.assert_array_equal(np.array([s.begin, s.end]), np.array([begin, end]))
        assert s.cell.tool is cell.tools[s.tool]
    np.testing.assert_array_equal(np.vstack([s.toolpath.position for s in segments]), path.position)
    wished = replace(OPTIONS, fixed=(FixedRotation(3, 0.1), FixedRotation(12, 0.2)))
    assert [[f.point for f in s.restrict_options(wished).fixed] for s in segments] == [[3], [2], []]
    (one,) = split_into_tool_segments(select_job_tools(cell, job("3", "T03")), job("3", "T03"))
    assert one.number == 0
    assert one.tool == "3"


def test_tool_change_within_a_cut_or_a_shared_number_is_refused(tmp_path: Path) -> None:
    cell, path = table(tmp_path), job("3", "BALL")
    cut = replace(path, operation=(np.arange(len(path)) > 1).astype(np.int32))
    with pytest.raises(InputError, match=r"cuts from point 1 to point 2, and the tool changes from 3 to BALL"):
        split_into_tool_segments(select_job_tools(cell, cut), cut)
    out = replace(cut, move=np.where(np.arange(len(cut)) == 2, MoveKind.RETRACT, cut.move).astype(cut.move.dtype))
    with pytest.raises(InputError, match=r"goes out of a cut \(a retract\) from point 1 to point 2, and the tool"):
        split_into_tool_segments(select_job_tools(cell, out), out)
    numbered = replace(cell, tools={name: replace(tool, number=4) for name, tool in cell.tools.items()})
    with pytest.raises(InputError, match=r"the tools 3 and BALL would both be number 4"):
        split_into_tool_segments(numbered, path)
    with pytest.raises(InputError, match=r"wants the tool 'DRILL', which the cell does not have.*3.*BALL"):
        select_job_tools(cell, job("3", "DRILL"))


def test_equal_text_takes_precedence_over_equal_number(tmp_path: Path) -> None:
    cell = table(tmp_path)
    both = replace(cell, tools={"3": cell.tools["3"], "T03": cell.tools["BALL"]})
    assert select_job_tools(both, job("3")).tool_name == "3"
    assert select_job_tools(both, job("T03")).tool_name == "T03"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan]:
    cell, path = table(tmp_path_factory.mktemp("tools")), job(*LABELS)
    cell = select_job_tools(cell, path)
    segments = split_into_tool_segments(cell, path)
    return cell, path, segments, plan_job(segments, path, OPTIONS, StageTimings())


def test_each_tool_has_the_plan_of_its_own_job(done: tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan]) -> None:
    _, path, segments, whole = done
    assert len(whole.plan.parts) == len(segments) == 3
    np.testing.assert_array_equal(whole.plan.path.index[whole.plan.path.is_point], np.arange(len(path)))
    assert whole.plan.path.runs[-1][1] == len(whole.plan.path.index) - 1
    np.testing.assert_array_equal(whole.points.table.q, np.vstack([p.points.table.q for p in whole.parts]))
    p, row = whole.plan.at(len(whole.plan.path.index) - 1)
    assert p is whole.plan.parts[2].plan
    assert p.path.index[row] == len(path) - 1
    parts, o = whole.plan.parts, whole.plan.chosen.objective
    share = np.array([p.share for p in parts])
    np.testing.assert_allclose(share, [0.5, 0.25, 0.25])
    assert o.worst == max(p.plan.chosen.objective.worst for p in parts)
    np.testing.assert_allclose(o.mean, share @ [p.plan.chosen.objective.mean for p in parts])
    own = share @ [p.plan.chosen.objective.total - OPTIONS.weights.worst * p.plan.chosen.objective.worst for p in parts]
    np.testing.assert_allclose(o.total, own + OPTIONS.weights.worst * o.worst)
    found = compute_certificate(whole.plan)
    assert found is not None
    assert found.bound <= found.sequence
    assert found.bound <= found.grid * (1 + 1e-6)
    assert found.bound * (1 - 2e-3) <= o.total  # the curve is between the steps of the grid
    assert found.gap < 5e-3
    gain = compute_gains(whole.plan)[0]
    np.testing.assert_allclose(gain.mean, 1.0 - o.mean / whole.plan.cam_default.objective.mean)


def write_output(done: tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan], out: Path, *tools: str) -> Path:
    _, path, segments, whole = done
    assert whole.timeline is not None
    assert whole.timeline.trajectory is not None
    out.mkdir(exist_ok=True)
    write_points_csv(out / "points.csv", whole.points.table)
    labels = [o.label for o in path.operations]
    names = tools or [s.tool for s in segments if s.tool]
    write_trajectory_csv(out / "trajectory.csv", whole.timeline.trajectory, labels, (), names)
    return out


def verify_output(done: tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan], out: Path) -> Verification:
    return verify_tool_segments(done[2], out, options=OPTIONS)


def test_motion_changes_tools_at_rest_and_is_verified(
    done: tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan], tmp_path: Path
) -> None:
    motion = done[3].timeline.trajectory  # type: ignore[union-attr]
    assert motion is not None
    assert motion.tool is not None
    at = np.flatnonzero(np.diff(motion.tool))
    assert len(at) == 2
    for n in at:
        np.testing.assert_array_equal(motion.q[n], motion.q[n + 1])
        np.testing.assert_allclose(motion.q[n], CHANGE, atol=1e-12)
        assert np.isnan(motion.point[[n, n + 1]]).all()
    found = verify_output(done, write_output(done, tmp_path))
    assert not found.failed, found.failed
    text = (tmp_path / "trajectory.csv").read_text().splitlines()
    assert [line.rpartition(",")[2] for line in (text[1], text[at[0] + 2], text[-1])] == ["3", "BALL", "3"]


def test_verifier_detects_a_wrong_tool_and_a_misplaced_change(
    done: tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan], tmp_path: Path
) -> None:
    out = write_output(done, tmp_path, "BALL", "3", "BALL")
    assert [c.name for c in verify_output(done, out).failed] == ["tool changes"]
    out = write_output(done, tmp_path)
    lines = (out / "trajectory.csv").read_text().splitlines()
    n = next(k for k, line in enumerate(lines) if line.endswith(",BALL"))
    lines[n - 3 : n] = [line.removesuffix("3") + "BALL" for line in lines[n - 3 : n]]  # during the motion of the arm
    (out / "trajectory.csv").write_text("\n".join(lines) + "\n")
    (check,) = verify_output(done, out).failed
    assert "BALL comes on" in check.where
    assert "from where tools are changed" in check.where
    cell, path, segments, whole = done
    longer = replace(segments[1].cell.tool, T_flange_tcp=pose(0, 0, 0.451))  # 1 mm longer
    other = (segments[0], replace(segments[1], cell=replace(segments[1].cell, tool=longer)), segments[2])
    failed = {c.name: c for c in verify_output((cell, path, other, whole), write_output(done, tmp_path)).failed}
    assert {"path", "points.csv on the toolpath"} <= set(failed)
    assert failed["path"].where.startswith("tool BALL, points counted from 10:")


def test_steering_rules_apply_to_their_segment(tmp_path: Path) -> None:
    cell, path = table(tmp_path), job(*LABELS)
    segments = split_into_tool_segments(select_job_tools(cell, path), path)
    wished = replace(
        OPTIONS, steer=(SteeringRule(points=(8, 16), prefer=0.3), SteeringRule(operation="op2", gamma=0.1))
    )
    laid = [s.restrict_options(wished) for s in segments]
    assert [[w.points for w in o.steer] for o in laid] == [[(8, 9)], [(0, 4), (1, 3)], [(0, 1)]]
    assert [[f.point for f in o.fixed] for o in laid] == [[], [1, 2, 3], []]


def test_picture_shows_the_active_tool(done: tuple[Cell, Toolpath, tuple[ToolSegment, ...], JobPlan]) -> None:
    _, path, _, whole = done
    plan, shown = whole.plan, compute_collision_map(whole.plan)
    assert len(shown.known) == len(plan.path.stations)
    view = build_optimize_scene(plan, path, whole.points, whole.timeline, shown, whole.points.table.deflection)
    assert [name for name, _ in view.scene.tools] == ["3", "BALL"]
    np.testing.assert_allclose(view.scene.tools[1][1][:3, 3] - view.scene.tools[0][1][:3, 3], [0.1, 0, 0], atol=1e-9)
    assert {(b.name, b.tools) for b in view.scene.bodies if b.tools} == {
        (name, (n,)) for n in (0, 1) for name in ("spindle", "cutter")
    }
    assert view.motion is not None
    assert view.motion.tool is not None
    assert set(
        view.motion.tool[np.isfinite(view.motion.point) & (view.motion.point > 10) & (view.motion.point < 14)]
    ) == {1}
    assert view.stations is not None
    bent = np.linalg.norm(np.array(view.stations.bend), axis=1)  # with the elasticity of the mounted tool
    at = plan.path.index[plan.path.stations[find_cut_stations(plan)]]
    whole_points = at == np.round(at)
    table = whole.points.table.deflection[np.round(at[whole_points]).astype(int)]
    np.testing.assert_allclose(bent[whole_points], table)
    assert view.stations.tool is not None
    assert view.stations.tool.tolist() == [int(10 <= k < 15) for k in at]


def test_repeated_place_has_a_sample_for_each_point(tmp_path: Path) -> None:
    """G0 X Y, then G0 Z at the current position: a rapid move of zero length."""
    rows = slots(0.0)
    path = toolpath([rows[0], *rows])
    cell = small_cell(tmp_path, stiffness=K, obstacles=())
    segments = split_into_tool_segments(cell, path)
    whole = plan_job(segments, path, OPTIONS, StageTimings())
    out = write_output((cell, path, segments, whole), tmp_path / "out")
    assert not verify_tool_segments(segments, out, options=OPTIONS).failed
