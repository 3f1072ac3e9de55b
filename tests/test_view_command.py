"""``machopt view`` from the planner to the pointer: pins set on the page equal those of a plan file."""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser_driver import Browser
from test_cli import CELLS, KR500, PASS, toolpath
from test_cli import optimize as optimized

from machopt.cli import main
from machopt.commands.optimize.computation import compute_optimize_plan
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.errors import InputError
from machopt.planning.plan_output.collision_map import compute_collision_map
from machopt.report.page_data.optimize_rotation_map import build_rotation_map
from machopt.report.page_types.map_sample_states import PlaceCode
from machopt.report.page_types.optimize_page_data import STATUS_NAMES
from machopt.view.page_server import PageServer
from machopt.view.run import SessionActions, ViewRequest, serve_view
from machopt.view.session import ViewSession

pytestmark = pytest.mark.slow


def ignore_progress(_: str) -> None:
    """Ignore the progress."""


def job(folder: Path, *overrides: str) -> OptimizeRequest:
    return OptimizeRequest(cell=KR500, toolpath=toolpath(folder, PASS), out=folder / "out", overrides=overrides)


def begun(folder: Path, *overrides: str) -> ViewSession:
    return ViewSession.start(load_optimize_inputs(job(folder, *overrides)), folder / "plan.yaml", (), ignore_progress)


def gammas(session: ViewSession) -> list[float]:
    return np.degrees(session.current.job_result.points.table.gamma).tolist()


def test_session_pins_compares_restores_and_saves(tmp_path: Path) -> None:
    session = begun(tmp_path, "rotation_step_deg=10")
    free = gammas(session)
    want = round(free[6] + 21.3, 1)
    message, shown = session.replan(
        {"fixed": [{"point": 6, "gamma_deg": want}], "steer": [], "external": {}}, ignore_progress
    )
    assert (shown, message.startswith("Planned in")) == (True, True)
    assert gammas(session)[6] == pytest.approx(want, abs=0.25)  # deg; tolerance of verify
    assert session.list_wishes()["fixed"] == [{"point": 6, "gamma_deg": want}]
    assert '"name":"before"' in session.build_html()
    session.save_plan_file()
    again = compute_optimize_plan(
        load_optimize_inputs(OptimizeRequest(**{**vars(job(tmp_path)), "plan_file": session.file})),
        session.current.timings,
    )
    for name in ("phi", "q", "branch"):  # equal to the last bit, whatever results the session reused
        mine, own = (getattr(m.plan.chosen.assignment, name) for m in (session.current.job_result, again.job_result))
        np.testing.assert_array_equal(mine, own)
    session.swap_plans()
    assert gammas(session) == free
    assert session.list_wishes()["fixed"] == []


def test_pinned_column_is_marked_as_excluding_the_rest(tmp_path: Path) -> None:
    session = begun(tmp_path, "rotation_step_deg=10")
    made = session.current.job_result.plan
    before = build_rotation_map(made, compute_collision_map(made), np.zeros(len(session.optimize_inputs.toolpath)))
    want = round(gammas(session)[6], 1)
    session.replan({"fixed": [{"point": 6, "gamma_deg": want}], "steer": [], "external": {}}, ignore_progress)
    made = session.current.job_result.plan
    after = build_rotation_map(made, compute_collision_map(made), np.zeros(len(session.optimize_inputs.toolpath)))
    assert before is not None
    assert after is not None
    k, b = int(np.argmin(np.abs(after.point - 6))), int(np.argmin(np.abs(before.point - 6)))
    was_free = np.isin(before.status[b], (PlaceCode.OK, PlaceCode.NOT_CHECKED))
    now = after.status[k]
    assert (now == PlaceCode.BOUNDS).sum() >= was_free.sum() - 1 > 10
    changed = was_free & ~np.isin(now, (PlaceCode.OK, PlaceCode.NOT_CHECKED))
    assert set(now[changed].tolist()) == {int(PlaceCode.BOUNDS)}
    assert "pin" in STATUS_NAMES[PlaceCode.BOUNDS]


def test_verified_state_remains_until_another_plan_is_shown(tmp_path: Path) -> None:
    session = begun(tmp_path, "rotation_step_deg=10")
    nothing = session.list_wishes()
    assert session.verify(ignore_progress).good
    retained = session.current
    assert '"verified":{' in session.build_html()
    assert session.replan(nothing, ignore_progress)[1]
    assert session.current is retained  # nothing is planned again
    assert session.previous is None
    pin = {**nothing, "fixed": [{"point": 6, "gamma_deg": round(gammas(session)[6] + 15, 1)}]}
    assert session.replan(pin, ignore_progress)[1]
    assert '"verified":null' in session.build_html()
    session.swap_plans()
    assert '"verified":{' in session.build_html()


def test_dragging_a_handle_shows_angle_deflection_and_state(tmp_path: Path) -> None:
    request = job(tmp_path, "rotation_step_deg=10")
    server = serve_view(
        ViewRequest(paths=(request.cell, request.toolpath), request=request, save=tmp_path / "plan.yaml"),
        ignore_progress,
        ignore_progress,
    )

    def user(browser: Browser) -> None:
        browser.script("document.getElementById('rotation').scrollIntoView()")
        dots = browser.script(DOTS)
        points = browser.script("DATA.map.point.filter(p => Math.abs(p - Math.round(p)) < 1e-6).length")
        assert len(dots) == points  # one handle per point
        x, y, point = dots[len(dots) // 2]
        mouse, observed = browser.page.mouse, []
        mouse.move(x, y)
        mouse.down()
        for step in (6, 14, 22):
            mouse.move(x, y + step)
            rows = browser.script("[...document.querySelectorAll('.tip div')].map(r => r.innerText.split('\\n'))")
            observed.append(browser.script("document.querySelector('.tip').innerText"))
            assert rows
        message = browser.script(f"document.querySelector('.pin[data-point=\"{point}\"]').title")
        gamma = message.split("γ ")[1].split("°")[0]
        assert f"point\n{point}" in observed[-1] or f"point{point}" in observed[-1].replace("\n", "")
        assert gamma in observed[-1]
        assert "deflection" in observed[-1]
        assert "state" in observed[-1]
        assert len(set(observed)) == 3
        mouse.up()
        assert browser.script("document.getElementById('save').disabled")
        browser.page.click(".wish + button")  # removed again: the displayed plan is the requested one
        assert not browser.script("document.getElementById('save').disabled")
        assert browser.script("document.getElementById('status-message').textContent").startswith("Planned in")
        assert browser.complaints == []

    drive_page(server, user)


def test_infeasible_plan_is_reported_and_the_old_one_remains(tmp_path: Path) -> None:
    session = begun(tmp_path)
    old = session.current
    act = SessionActions(session).run_action
    found = act("plan", {"steer": [{"points": [5, 5], "branch": 0}, {"points": [9, 9], "branch": 7}]}, ignore_progress)
    assert not found.shown
    assert "branch 0 at point 5" in found.message or "branch 7 at point 9" in found.message
    assert session.current is old
    for wishes, part in (
        ({"fixed": [{"point": 99, "gamma_deg": 0}]}, "points 0 to 15"),
        ({"steer": [{"operation": "none", "branch": 1}]}, "'none' is no operation"),
        ({"steer": [{"forbid_deg": [1, 2]}]}, "narrower than rotation_step_deg"),
        ({"seed": 3}, "fixed, steer, external can be set here"),
        ({"steer": [{"gamma_deg": "x"}]}, "expected a number"),
    ):
        found = act("plan", wishes, ignore_progress)
        assert part in found.message
        assert not found.good
    assert session.current is old


def test_optimize_first_reports_contradicting_pins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.yaml"
    wishes = "  - {points: [5, 5], branch: 0}\n  - {points: [9, 9], branch: 7}\n"
    file.write_text(f"machopt_plan: 1\nsteer:\n{wishes}", encoding="utf-8")
    out = tmp_path / "out"
    assert optimized(KR500, toolpath(tmp_path, PASS), out, "--plan", str(file)) == 3
    message = next(line for line in capsys.readouterr().err.splitlines() if line.startswith("machopt:"))
    assert message.startswith("machopt: no feasible answer; No plan keeps")
    assert "branch 0 at point 5" in message or "branch 7 at point 9" in message
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index("No plan keeps") < page.index("No feasible plan for")


def drive_page(server: PageServer, drive: Callable[[Browser], None]) -> None:
    """Execute the requests of the page while ``drive`` acts as the user in a browser; its errors are raised here."""
    failed: list[BaseException] = []
    over = threading.Event()

    def user() -> None:
        try:
            with Browser() as browser:
                browser.open(server.url)
                drive(browser)
        except BaseException as problem:  # noqa: BLE001 — raised again by who waits
            failed.append(problem)
        finally:
            over.set()

    thread = threading.Thread(target=user)
    thread.start()
    try:
        while not over.is_set():
            with contextlib.suppress(queue.Empty):
                server.run_action(server.wait_for_action(0.1))
    finally:
        thread.join()
        server.close()
    if failed:
        raise failed[0]


DOTS = """[...document.querySelectorAll('.pin')].map(e => { const r = e.getBoundingClientRect();
    return [r.x + r.width / 2, r.y + r.height / 2, +e.dataset.point]; })"""
CURVE = "DATA.map.lines.find(l => l.name === 'chosen').y"


def test_point_dragged_on_the_map_is_pinned_planned_and_saved(tmp_path: Path) -> None:
    request = job(tmp_path, "rotation_step_deg=10")
    server = serve_view(
        ViewRequest(paths=(request.cell, request.toolpath), request=request, save=tmp_path / "plan.yaml"),
        ignore_progress,
        ignore_progress,
    )
    pinned: dict[str, float] = {}

    def user(browser: Browser) -> None:
        browser.script("document.getElementById('rotation').scrollIntoView()")
        dots = browser.script(DOTS)
        assert len(dots) >= 8
        x, y, point = dots[len(dots) // 2]
        browser.drag((x, y), (x, y + 24))
        message = browser.script("document.querySelector('.wish').textContent")
        assert message.startswith(f"point {point}: γ ")
        # the saved plan would differ from the displayed one
        assert browser.script("document.getElementById('save').disabled")
        before = browser.script(CURVE)
        with browser.loading():
            browser.page.click("#replan")
        wish = browser.script("DATA.steering.wishes.fixed[0]")
        pinned.update(wish)
        k = browser.script(f"DATA.map.point.indexOf({point})")
        at = browser.script(f"{CURVE}[{k}] + DATA.map.offset[{k}]")
        assert (at - wish["gamma_deg"] + 180) % 360 - 180 == pytest.approx(0.0, abs=0.25)  # deg
        assert abs(at - before[k] - browser.script(f"DATA.map.offset[{k}]")) > 3.0
        assert browser.script("DATA.map.lines.map(l => l.name)").count("before") == 1
        rows = browser.script("[...document.querySelectorAll('#steering tbody tr')].map(r => r.innerText.split('\\t'))")
        assert [r[0] for r in rows][:1] == ["Objective"]
        assert all(r[1] != "–" and r[2] != "–" for r in rows)
        browser.page.click("#save")
        end = time.monotonic() + 30
        while not (tmp_path / "plan.yaml").is_file():
            assert time.monotonic() < end
            time.sleep(0.1)
        while "Verification passed" not in (
            message := browser.script("document.getElementById('status-message').textContent")
        ):
            assert time.monotonic() < end + 60, message
            time.sleep(0.2)
        assert "machopt optimize" in message
        found = browser.script("[...document.querySelectorAll('#verified tbody tr')].map(r => r.cells[1].textContent)")
        assert len(found) > 20
        assert set(found) <= {"passed", "not run"}
        browser.script("[...document.querySelectorAll('.bodies input')].forEach(e => e.click())")
        assert browser.complaints == []
        assert {r.split("/")[2] for r in browser.requests if not r.startswith(("data:", "blob:"))} == {
            f"127.0.0.1:{server.port}"
        }

    drive_page(server, user)
    out = tmp_path / "out"
    assert optimized(KR500, request.toolpath, out, "--plan", str(tmp_path / "plan.yaml")) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["options"]["fixed"] == [pinned]
    checks = {c["name"]: c["passed"] for c in result["verification"]["checks"]}
    assert checks["requested: fixed rotations"]


def test_cells_and_reports_are_served_separately(tmp_path: Path) -> None:
    for places, part in (((CELLS / "cutting_cobot",), "The cell, the arm at home"),):
        server = serve_view(
            ViewRequest(
                paths=places,
                request=OptimizeRequest(cell=places[0], toolpath=places[0], out=tmp_path),
                save=tmp_path / "p",
            ),
            ignore_progress,
            ignore_progress,
        )
        server.close()
        assert part in server.html
    with pytest.raises(InputError, match="OUT CELL TOOLPATH would work"):
        serve_view(
            ViewRequest(
                paths=(CELLS,) * 4,
                request=OptimizeRequest(cell=CELLS, toolpath=CELLS, out=tmp_path),
                save=tmp_path / "p",
            ),
            ignore_progress,
            ignore_progress,
        )


def test_command_ends_with_ctrl_c() -> None:
    command = [sys.executable, "-m", "machopt", "view", str(CELLS / "cutting_cobot")]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell starts background jobs with SIGINT ignored, and child processes inherit that
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL) and None,  # noqa: PLW1509
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stderr is not None
            lines = [process.stdout.readline() for _ in range(2)]
            assert lines[1].startswith("http://127.0.0.1:")
            process.stderr.readline()
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=30) == 0
            assert "Traceback" not in process.stderr.read()
        finally:
            process.kill()  # a process that does not end would block the test


def test_invalid_port_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(["view", "out", "--port", "65536"])
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2
    assert "expected a port from 0 to 65535" in capsys.readouterr().err
