"""Method joint: derivatives, acceptance, refusals and imports (:mod:`machopt.planning.posture_and_feed`)."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.tool_segments import ToolSegment
from machopt.errors import InputError
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import prepare_planning
from machopt.planning.posture_and_feed import window_problem
from machopt.planning.posture_and_feed.linearized_constraints import LimitSources
from machopt.planning.posture_and_feed.node_curves import interpolate_naturally
from machopt.planning.posture_and_feed.node_loads import MilledTargets
from machopt.planning.posture_and_feed.posture_feed_pipeline import find_free_axes
from machopt.planning.posture_and_feed.symbolic_machine import SymbolicMachine, build_symbolic_machine
from machopt.planning.posture_and_feed.window_builder import RunState, Window, build_window_data, list_windows
from machopt.planning.posture_and_feed.window_data import WindowData, WindowSolution
from machopt.planning.posture_and_feed.window_problem import solve_window
from machopt.planning.posture_and_feed.window_trial import TrialRefusal, compare_states, measure_run, try_solution
from machopt.verification.tables.csv_columns import read_columns

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr500_milling"
HEAD = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"
EXACT = 1e-10


def write_pass(file: Path) -> Path:
    """Write a weaving pass of 0.1 m along the rim, with a feed that the tolerance does not permit."""
    rows = [HEAD, "60,-81,40,0,0,1,rapid,,finish"]
    for n in range(26):
        u = n / 25
        lean = 0.1 * np.sin(2 * np.pi * u)
        size = np.hypot(lean, 1.0)
        rows.append(f"{60 - 100 * u:.4f},-81,-0.5,{lean / size:.7f},0,{1 / size:.7f},cut,2880,finish")
    rows.append("-40,-81,40,0,0,1,rapid,,finish")
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def toolpath_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pass(tmp_path_factory.mktemp("joint") / "pass.csv")


@pytest.fixture(scope="module")
def planned(toolpath_file: Path) -> tuple[Plan, ToolSegment]:
    request = OptimizeRequest(
        cell=CELL,
        toolpath=toolpath_file,
        out=toolpath_file.parent / "none",
        process=CELL / "process.yaml",
        direct={"objective": "tolerance", "method": "joint"},
    )
    given = load_optimize_inputs(request)
    segment = given.segments[0]
    return find_best_plan(segment.cell, segment.toolpath, segment.restrict_options(given.options)), segment


@pytest.fixture(scope="module")
def window(planned: tuple[Plan, ToolSegment]) -> tuple[RunState, Window, SymbolicMachine, WindowData]:
    plan, segment = planned
    machine = build_symbolic_machine(plan.setup.arm.machine, plan.setup.arm.T_flange_tcp)
    one = next(list_windows(plan))
    state = measure_run(plan, segment.toolpath, one.run)
    assert isinstance(state, RunState)
    milled = MilledTargets.build(plan, segment.toolpath)
    data = build_window_data(
        state, one, milled, LimitSources(plan, None), machine, find_free_axes(plan), np.radians(20.0)
    )
    return state, one, machine, data


def keep_present(data: WindowData) -> WindowSolution:
    """Return the present plan as the solution."""
    return WindowSolution(x=data.x, phi=data.phi, feed=data.cap, time=0.0, is_solved=True, status="", iterations=0)


def test_symbolic_kinematics_equals_pinocchio() -> None:
    cell = load_cell(CELL)
    machine = load_machine(cell, load_robot(cell))
    symbolic = build_symbolic_machine(machine, cell.tool.T_flange_tcp)
    model = pin.buildModelFromUrdf(str(CELL / "robot.urdf"))
    data, flange = model.createData(), model.getFrameId("flange")
    base = model.getFrameId("base_link")
    back = np.linalg.inv(machine.T_base_workpiece_zero)
    for q in np.random.default_rng(1).uniform(-1.2, 1.2, (8, 6)):
        pin.framesForwardKinematics(model, data, q)
        T_base_flange = data.oMf[base].inverse() * data.oMf[flange]
        wanted = back @ T_base_flange.homogeneous @ cell.tool.T_flange_tcp
        position, rotation = symbolic.pose(q)
        assert np.abs(np.asarray(position).ravel() - wanted[:3, 3]).max() < EXACT
        assert np.abs(np.asarray(rotation) - wanted[:3, :3]).max() < EXACT


@pytest.mark.parametrize("name", ["kr500_milling", "kr500_rail", "kr240_turntable"])
def test_jacobian_is_the_derivative_of_the_pose(name: str) -> None:
    cell = load_cell(ROOT / "cells" / name)
    machine = load_machine(cell, load_robot(cell))
    symbolic = build_symbolic_machine(machine, cell.tool.T_flange_tcp)
    x = np.random.default_rng(2).uniform(-0.8, 0.8, symbolic.count)
    J, step = np.asarray(symbolic.jacobian(x)), 1e-6
    for column in range(symbolic.count):
        ahead, behind = (
            [np.asarray(part) for part in symbolic.pose(x + sign * step * np.eye(symbolic.count)[column])]
            for sign in (1.0, -1.0)
        )
        linear = (ahead[0] - behind[0]).ravel() / (2 * step)
        spin = (ahead[1] - behind[1]) / (2 * step) @ np.asarray(symbolic.pose(x)[1]).T
        assert np.abs(linear - J[:3, column]).max() < 1e-8
        assert np.abs(np.array([spin[2, 1], spin[0, 2], spin[1, 0]]) - J[3:, column]).max() < 1e-8


def test_deflection_equals_that_of_the_springs() -> None:
    cell = load_cell(CELL)
    machine = load_machine(cell, load_robot(cell))
    symbolic = build_symbolic_machine(machine, cell.tool.T_flange_tcp)
    rng = np.random.default_rng(3)
    x, wrench, normal = rng.uniform(-1, 1, (4, 6)), rng.normal(size=(4, 6)), rng.normal(size=(4, 3))
    compliance = rng.uniform(1e-7, 1e-5, (4, 6))
    _, J = machine.compute_fk_jacobian(x, cell.tool.T_flange_tcp)
    C = np.einsum("mij,mj,mkj->mik", J, compliance, J)
    wanted = np.einsum("mi,mij,mj->m", normal, C[:, :3], wrench)
    assert np.allclose(symbolic.compute_deflections(x, compliance, wrench, normal), wanted, rtol=1e-12)


def test_spline_equals_scipy() -> None:
    from scipy.interpolate import CubicSpline

    at = np.array([0.0, 0.5, 1.5, 1.7, 3.0])
    values: Array = np.random.default_rng(4).normal(size=(5, 2))
    wanted = np.linspace(0.0, 3.0, 31)
    for count in (3, 4, 5):
        places = wanted[wanted <= at[count - 1]]
        found = interpolate_naturally(at[:count], values[:count], places)
        assert np.allclose(found, CubicSpline(at[:count], values[:count], bc_type="natural")(places), atol=1e-12)


def test_infeasible_start_becomes_feasible(window: tuple[RunState, Window, SymbolicMachine, WindowData]) -> None:
    state, _, machine, data = window
    bent = replace(data, x=data.x + 0.02 * np.random.default_rng(5).normal(size=data.x.shape))
    found = solve_window(machine, replace(bent, lower=bent.lower - 0.1, upper=bent.upper + 0.1))
    assert found.is_solved, found.status
    place = np.array([np.asarray(machine.pose(x)[0]).ravel() for x in found.x])
    assert np.abs(place - data.position).max() < 1e-8
    assert (found.feed <= data.cap * data.length / data.way * (1 + 1e-6)).all()
    assert state.seconds > 0


def test_solution_respects_its_limits(window: tuple[RunState, Window, SymbolicMachine, WindowData]) -> None:
    _, _, machine, data = window
    found = solve_window(machine, data)
    assert found.is_solved
    tau = np.where(data.length > 0, data.length / np.maximum(found.feed, 1e-12), np.nan)
    rate = np.diff(found.x, axis=0) / tau[:, None]
    assert np.nanmax(np.abs(rate) / data.velocity) < 1 + 1e-4
    rows = np.flatnonzero(data.has_tolerance[1:]) + 1
    wrench = data.loads.edge[rows] + data.loads.slope[rows] * found.feed[rows - 1][:, None]
    error = machine.compute_deflections(found.x[rows], data.loads.compliance[rows], wrench, data.loads.normal[rows])
    assert (np.abs(error) <= data.loads.limit[rows] + found.excess[rows] + 1e-9).all()


def test_colliding_window_is_rejected_with_the_pair(
    planned: tuple[Plan, ToolSegment], window: tuple[RunState, Window, SymbolicMachine, WindowData]
) -> None:
    _, segment = planned
    state, one, _, data = window
    narrow = prepare_planning(segment.cell, replace(state.plan.options, clearance=0.3))
    crowded = replace(state, plan=replace(state.plan, setup=narrow))
    refused = try_solution(crowded, segment.toolpath, one, keep_present(data))
    assert isinstance(refused, TrialRefusal)
    assert "touch or come nearer than the clearance at point" in refused.reason


def test_window_that_is_not_faster_is_rejected(
    planned: tuple[Plan, ToolSegment], window: tuple[RunState, Window, SymbolicMachine, WindowData]
) -> None:
    state = window[0]
    assert "the run would take" in compare_states(state, state)
    feed = state.advised.feed.copy()
    feed[np.flatnonzero(np.isfinite(feed))[0]] = 0.0
    worse = replace(state, advised=replace(state.advised, feed=feed), seconds=0.5 * state.seconds)
    assert "out of tolerance at any feed" in compare_states(state, worse)
    chatter = replace(state, advised=replace(state.advised, unstable=10**6), seconds=0.5 * state.seconds)
    assert "chatter is predicted" in compare_states(state, chatter)
    assert compare_states(state, replace(state, seconds=0.5 * state.seconds)) == ""


def test_command_is_verified_and_never_slower(toolpath_file: Path) -> None:
    outcome = run_optimize(
        OptimizeRequest(
            cell=CELL,
            toolpath=toolpath_file,
            out=toolpath_file.parent / "out",
            process=CELL / "process.yaml",
            direct={"objective": "tolerance", "method": "joint"},
        )
    )
    assert outcome.exit_code == 0
    assert outcome.result.joint is not None
    (entry,) = outcome.result.joint
    assert outcome.result.cycle_time_s is not None
    assert entry.fixed_path_s is not None
    assert outcome.result.cycle_time_s <= entry.fixed_path_s + 1e-9
    assert entry.accepted or entry.reason
    assert all(window.accepted or window.reason for window in entry.windows)
    table = read_columns(toolpath_file.parent / "out" / "points.csv")
    pairs = [
        (float(advised), float(largest))
        for advised, largest in zip(table["feed_advised_mm_min"], table["feed_max_mm_min"], strict=True)
        if advised and largest and float(largest) > 0.0
    ]
    assert len(pairs) > 20
    assert all(advised <= largest * (1.0 + 1e-4) for advised, largest in pairs)  # for the executed configurations
    page = (toolpath_file.parent / "out" / "report.html").read_text(encoding="utf-8")
    section = page.partition("<section id=joint>")[2].partition("</section>")[0]
    assert f"{entry.fixed_path_s:.1f}" in section
    assert all(window.window in section for window in entry.windows)


def test_result_that_fails_verification_is_replaced_by_the_fixed_path(
    toolpath_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    observed: list[str] = []

    def find_once(result: OptimizeDocument) -> str:
        observed.append("")
        return "its verification failed: time" if len(observed) == 1 else ""

    monkeypatch.setattr("machopt.commands.optimize.run.find_failed_joint_result", find_once)
    outcome = run_optimize(
        OptimizeRequest(
            cell=CELL,
            toolpath=toolpath_file,
            out=toolpath_file.parent / "fixed",
            process=CELL / "process.yaml",
            direct={"objective": "tolerance", "method": "joint"},
        )
    )
    assert outcome.exit_code == 0
    assert outcome.result.joint is not None
    assert not outcome.result.joint[0].accepted
    assert outcome.result.joint[0].reason == "its verification failed: time"
    assert outcome.result.cycle_time_s == pytest.approx(outcome.result.joint[0].fixed_path_s)


def test_missing_tolerance_is_refused_with_what_is_needed(toolpath_file: Path) -> None:
    with pytest.raises(InputError, match=r"method joint .* states no process; a process\.yaml with a tolerance"):
        load_optimize_inputs(
            OptimizeRequest(
                cell=CELL, toolpath=toolpath_file, out=toolpath_file.parent / "no", direct={"method": "joint"}
            )
        )


def test_shifted_path_is_refused(toolpath_file: Path) -> None:
    with pytest.raises(InputError, match="method joint drives the path of the file"):
        load_optimize_inputs(
            OptimizeRequest(
                cell=CELL,
                toolpath=toolpath_file,
                out=toolpath_file.parent / "no",
                process=CELL / "process.yaml",
                direct={"method": "joint", "compensate": True},
            )
        )


def test_plan_without_the_method_does_not_import_casadi(toolpath_file: Path) -> None:
    code = (
        "import sys\nfrom pathlib import Path\n"
        "from machopt.commands.optimize.request import OptimizeRequest\n"
        "from machopt.commands.optimize.run import run_optimize\n"
        f"out = run_optimize(OptimizeRequest(cell=Path({str(CELL)!r}), toolpath=Path({str(toolpath_file)!r}), "
        f"out=Path({str(toolpath_file.parent / 'plain')!r})))\n"
        "assert out.exit_code == 0\nprint('casadi' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "False"


def test_moving_external_joints_are_free(tmp_path: Path) -> None:
    lines = (ROOT / "toolpaths" / "beam_passes.csv").read_text(encoding="utf-8").splitlines()[:40]
    short = tmp_path / "beam.csv"
    short.write_text("\n".join(lines) + "\n", encoding="utf-8")
    given = load_optimize_inputs(
        OptimizeRequest(cell=ROOT / "cells" / "kr500_rail", toolpath=short, out=tmp_path / "o")
    )
    segment = given.segments[0]
    plan = find_best_plan(segment.cell, segment.toolpath, segment.restrict_options(given.options))
    assert find_free_axes(plan).tolist() == [True] * plan.path.external.shape[1]
    one = next(list_windows(plan))
    state = measure_run(plan, segment.toolpath, one.run)
    assert isinstance(state, RunState)
    machine = build_symbolic_machine(plan.setup.arm.machine, plan.setup.arm.T_flange_tcp)
    sources = LimitSources(plan, None)
    data = build_window_data(state, one, None, sources, machine, find_free_axes(plan), np.radians(10.0))
    found = solve_window(machine, data)
    assert found.is_solved, found.status
    place = np.array([np.asarray(machine.pose(x)[0]).ravel() for x in found.x])
    assert np.abs(place - data.position).max() < 1e-8
    trial = try_solution(state, segment.toolpath, one, found)
    assert isinstance(trial, RunState | TrialRefusal)
    if isinstance(trial, RunState):
        rows = one.points
        assert np.abs(trial.plan.path.external[rows] - found.x[:, 6:]).max() < 1e-9


def test_joint_ranges_hold_between_unequal_nodes() -> None:
    """A parabola exceeds its value at the middle node by 0.01 rad:
    the constraint row is the largest value of the parabola."""
    casadi = pytest.importorskip("casadi")
    way = np.array([0.001, 0.004])
    s = np.concatenate([[0.0], np.cumsum(way)])
    peak, curvature = 0.003, 500.0  # m, rad/m²; the maximum is at the middle of the longer segment
    x = np.zeros((3, 6))
    x[:, 0] = 1.0 - curvature * (s - peak) ** 2
    data = SimpleNamespace(
        way=way,
        x=x,
        is_free=np.zeros(0, bool),
        is_fixed=np.zeros(3, bool),
        lower=np.full(6, -3.0),
        upper=np.full(6, 3.0),
    )
    variable = casadi.MX.sym("x", 6, 3)
    rows = window_problem._Constraints()
    window_problem._add_joint_ranges(rows, data, SimpleNamespace(x=variable))  # type: ignore[arg-type]  # numbers
    value = np.array(casadi.Function("rows", [variable], [casadi.vertcat(*rows.rows)])(x.T)).ravel()
    chord = 0.5 * (x[1, 0] + x[2, 0])  # of the longer segment
    assert value[0] == pytest.approx(x[1, 0] + (1.0 - chord))
    assert value[0] >= 1.0  # the largest value of the curve
    np.testing.assert_allclose(value[1:], 0.0)
