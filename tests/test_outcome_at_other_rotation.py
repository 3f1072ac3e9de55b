"""Outcome of a point while its rotation is dragged on the page of ``machopt view``."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from browser_driver import Browser
from test_view_command import DOTS, drive_page

from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.errors import InputError
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.view.dragged_point_outcomes import LiveJob
from machopt.view.run import SessionActions, ViewRequest, serve_view
from machopt.view.session import ViewSession

pytestmark = pytest.mark.slow
CELLS = Path(__file__).resolve().parents[1] / "cells"
DRILLING = """machopt_process: 1
materials:
  al: {drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300, thrust_spread_percent: 30,
    torque_spread_percent: 25, source: t}}
operations:
  default: {kind: drilling, spindle_rpm: 4000, layers: [{material: al, thickness_mm: 12}], depth_mm: 12,
    tolerance: {position_mm: 0.3, axis_deg: 0.5, reference: relative}}
"""
HOLES = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},{y},{z},0,0,1,{move},{feed},holes"
    for x, y in ((-150, -400), (50, 200))
    for z, move, feed in ((40, "rapid", ""), (25, "rapid", ""), (0, "cut", 420), (40, "retract", ""))
)
WALL = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},0,20,0,0,1,{move},{feed},wall"
    for x, move, feed in ((-60, "rapid", ""), (-50, "cut", 1200), (0, "cut", 1200), (50, "cut", 1200))
)


def start(folder: Path, cell: str, rows: str, process: str, *overrides: str) -> ViewSession:
    (folder / "job.csv").write_text(rows)
    (folder / "mine.yaml").write_text(process)
    request = OptimizeRequest(
        cell=CELLS / cell,
        toolpath=folder / "job.csv",
        out=folder / "out",
        process=folder / "mine.yaml",
        overrides=("rotation_step_deg=10", *overrides),
    )
    return ViewSession.start(load_optimize_inputs(request), folder / "plan.yaml", (), lambda _: None)


def ignore_progress(_: str) -> None:
    """Ignore the progress."""


@pytest.fixture(scope="module")
def drilling(tmp_path_factory: pytest.TempPathFactory) -> ViewSession:
    return start(tmp_path_factory.mktemp("holes"), "kr240_drilling", HOLES, DRILLING)


def find_phi(session: ViewSession, point: int) -> float:
    plan = session.current.job_result.plan
    return float(plan.chosen.assignment.phi[np.searchsorted(plan.path.index, point - 1e-6)])


def test_chosen_rotation_has_the_outcome_of_the_tables(drilling: ViewSession) -> None:
    columns = drilling.current.job_result.points.table.process
    assert columns is not None
    for point in (2, 6):
        found = drilling.find_outcome({"point": point, "phi_deg": np.degrees(find_phi(drilling, point))}).outcome
        assert found is not None
        assert found.point == point
        assert found.outcome == columns.outcome[point]
        # at the executed rotation
        assert found.error_mm == pytest.approx(1e3 * columns.errors["across"][point], rel=2e-3)
        assert found.p_in == pytest.approx(columns.p_in[point], abs=0.02)  # 1,024 draws compared with 8,192
        assert found.tolerance_mm == pytest.approx(0.3)


@pytest.mark.parametrize("turn", [-40.0, 25.0, 95.0])
def test_other_rotation_has_the_outcome_of_a_plan_with_that_pin(tmp_path: Path, turn: float) -> None:
    session = start(tmp_path, "kr240_drilling", HOLES, DRILLING)
    plan = session.current.job_result.plan
    row = int(np.searchsorted(plan.path.index, 2 - 1e-6))
    phi = find_phi(session, 2) + np.radians(turn)
    outcome = session.find_outcome({"point": 2, "phi_deg": float(np.degrees(phi))}).outcome
    assert outcome is not None
    gamma = float(np.degrees(wrap_angle(np.array(phi + plan.path.offset[row]))))
    _, shown = session.replan({"fixed": [], "steer": [{"operation": "holes", "gamma_deg": gamma}]}, ignore_progress)
    if outcome.outcome == "unreachable":
        assert not shown
        return
    assert shown
    columns = session.current.job_result.points.table.process
    assert columns is not None
    assert outcome.error_mm == pytest.approx(1e3 * columns.errors["across"][2], rel=5e-3)
    assert outcome.outcome == columns.outcome[2]


@pytest.fixture(scope="module")
def compensated(tmp_path_factory: pytest.TempPathFactory) -> ViewSession:
    return start(tmp_path_factory.mktemp("shifted"), "kr240_drilling", HOLES, DRILLING, "compensate=true")


def test_unchanged_state_with_compensation_equals_the_plan(compensated: ViewSession) -> None:
    result = compensated.current.job_result
    columns = result.points.table.process
    assert result.plan.compensation is not None
    assert columns is not None
    for point in (2, 6):
        found = compensated.find_outcome({"point": point, "phi_deg": np.degrees(find_phi(compensated, point))}).outcome
        assert found is not None
        assert found.outcome == columns.outcome[point]
        assert found.error_mm == pytest.approx(1e3 * columns.errors["across"][point], rel=2e-3, abs=1e-4)
        assert found.p_in == pytest.approx(columns.p_in[point], abs=0.02)


def test_retract_move_marked_as_cut_does_not_change_the_shift(tmp_path: Path) -> None:
    """It has no force: the shift of the hole applies until the drill has left it."""
    rows = HOLES.replace("retract,", "cut,600")
    errors = {}
    for name, overrides in (("bare", ()), ("shifted", ("compensate=true",))):
        (tmp_path / name).mkdir()
        session = start(tmp_path / name, "kr240_drilling", rows, DRILLING, *overrides)
        columns = session.current.job_result.points.table.process
        assert columns is not None
        errors[name] = columns.errors["across"][[2, 6]]
    assert (np.abs(errors["shifted"]) < 0.03 * np.abs(errors["bare"])).all()


@pytest.mark.parametrize("turn", [-40.0, 25.0])
def test_other_rotation_with_compensation_equals_a_new_plan(tmp_path: Path, turn: float) -> None:
    session = start(tmp_path, "kr240_drilling", HOLES, DRILLING, "compensate=true")
    plan = session.current.job_result.plan
    row = int(np.searchsorted(plan.path.index, 2 - 1e-6))
    phi = find_phi(session, 2) + np.radians(turn)
    outcome = session.find_outcome({"point": 2, "phi_deg": float(np.degrees(phi))}).outcome
    assert outcome is not None
    gamma = float(np.degrees(wrap_angle(np.array(phi + plan.path.offset[row]))))
    _, shown = session.replan({"fixed": [], "steer": [{"operation": "holes", "gamma_deg": gamma}]}, ignore_progress)
    assert shown
    columns = session.current.job_result.points.table.process
    assert columns is not None
    assert outcome.error_mm == pytest.approx(1e3 * columns.errors["across"][2], rel=5e-3, abs=1e-4)
    assert outcome.p_in == pytest.approx(columns.p_in[2], abs=0.02)
    assert outcome.outcome == columns.outcome[2]


def test_compensated_wall_at_the_chosen_rotation_equals_the_plan(tmp_path: Path) -> None:
    own = (CELLS / "kr500_milling" / "process.yaml").read_text()
    session = start(tmp_path, "kr500_milling", WALL, own, "compensate=true")
    columns = session.current.job_result.points.table.process
    assert columns is not None
    found = session.find_outcome({"point": 2, "phi_deg": np.degrees(find_phi(session, 2))}).outcome
    assert found is not None
    assert abs(found.error_mm) < 0.5 * abs(1e3 * session.current.job_result.points.table.deflection[2])
    assert found.error_mm == pytest.approx(1e3 * columns.errors["normal"][2], rel=5e-3, abs=2e-4)
    assert found.outcome == columns.outcome[2]


def test_points_without_a_tolerance_have_no_outcome_and_invalid_requests_are_refused(drilling: ViewSession) -> None:
    assert drilling.find_outcome({"point": 0, "phi_deg": 0.0}).outcome is None
    bad = ({}, {"point": 99, "phi_deg": 0.0}, {"point": True, "phi_deg": 0.0}, {"point": 2, "phi_deg": float("nan")})
    for body in bad:
        with pytest.raises(InputError):
            drilling.find_outcome(body)
        answer = SessionActions(drilling).run_action("outcome", body, ignore_progress)
        assert not answer.good
    assert (
        "outcome"
        in SessionActions(drilling).run_action("outcome", {"point": 2, "phi_deg": 3}, ignore_progress).to_json_types()
    )


def test_milled_point_has_the_error_normal_to_its_wall(tmp_path: Path) -> None:
    own = (CELLS / "kr500_milling" / "process.yaml").read_text()
    session = start(tmp_path, "kr500_milling", WALL, own)
    columns = session.current.job_result.points.table.process
    assert columns is not None
    found = session.find_outcome({"point": 2, "phi_deg": np.degrees(find_phi(session, 2))}).outcome
    assert found is not None
    assert found.error_name == "normal"
    assert found.error_mm == pytest.approx(1e3 * columns.errors["normal"][2], rel=5e-3)
    assert found.outcome == columns.outcome[2]


def test_unknown_outcome_remains_unknown_without_a_process(tmp_path: Path) -> None:
    shutil.copytree(CELLS / "kr240_drilling", tmp_path / "cell")
    text = re.sub(r"(?m)^accuracy:.*\n", "", (tmp_path / "cell" / "cell.yaml").read_text())
    (tmp_path / "cell" / "cell.yaml").write_text(text)
    session = start(tmp_path, str(tmp_path / "cell"), HOLES, DRILLING)
    found = session.find_outcome({"point": 2, "phi_deg": 0.0}).outcome
    assert found is not None
    assert found.outcome == "unknown"
    assert found.reason
    made = LiveJob.build(session.current.job_result)
    assert made.parts[0][1] is not None
    assert '"live": true' in session.build_html() or '"live":true' in session.build_html()


def test_dragged_hole_shows_its_outcome_and_the_plan_is_restored(tmp_path: Path) -> None:
    (tmp_path / "job.csv").write_text(HOLES)
    (tmp_path / "mine.yaml").write_text(DRILLING)
    request = OptimizeRequest(
        cell=CELLS / "kr240_drilling",
        toolpath=tmp_path / "job.csv",
        out=tmp_path / "out",
        process=tmp_path / "mine.yaml",
        overrides=("rotation_step_deg=10",),
    )
    result = ViewRequest(paths=(request.cell, request.toolpath), request=request, save=tmp_path / "plan.yaml")
    server = serve_view(result, ignore_progress, ignore_progress)

    def user(browser: Browser) -> None:
        browser.script("document.getElementById('rotation').scrollIntoView()")
        x, y, _ = next(dot for dot in browser.script(DOTS) if dot[2] == 2)
        mouse = browser.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x, y + (20 if y < 400 else -20))
        browser.page.wait_for_selector(".pin[data-outcome]:not([data-outcome=''])")
        output = browser.script("document.querySelector('.tip').innerText")
        assert "outcome" in output
        assert "error across" in output
        assert "of ± 0.3 mm" in output
        mouse.up()
        assert browser.script("document.querySelectorAll('.pin[data-outcome]').length") == 0
        browser.page.click(".wish + button")
        assert browser.script("document.getElementById('status-message').textContent").startswith("Planned in")
        assert browser.complaints == []

    drive_page(server, user)
