"""3-D scene: simplified triangles, packed numbers, poses equal to pinocchio."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from browser_driver import Browser
from external_axis_cells import external_cell
from parallel_linkage_arm import build_mimic_joints, expand_mimic_joints, linked_urdf
from sample_motion_scene import build_report_with_motion_scene
from sample_report_data import full_result
from small_cell import small_cell
from test_machine import by_pinocchio
from test_map_page import build_sample_map
from test_pages_in_browser import ASSETS, in_browser

from machopt.data_types.cell import Cell
from machopt.data_types.process_columns import OUTCOMES
from machopt.kinematics.urdf_loading import load_chain
from machopt.report.charts.scene_json import build_posture_view, build_scene_spec, pack_joint_levels, reduce_bodies
from machopt.report.page_data.machine_scene import build_bodies, build_machine_scene
from machopt.report.page_shell import POSTURE_SCRIPTS, build_page_html, build_section
from machopt.report.page_types.optimize_page_data import CheckRow, FeedDipRow
from machopt.report.page_types.workspace_map_page_data import MapScene
from machopt.report.pages.map_page import build_map_html
from machopt.report.pages.optimize.optimize_page import build_report_html
from machopt.report.scene.mesh_decimation import decimate_mesh
from machopt.report.scene.scene_types import PostureVectors, SceneBody, ScenePostures
from machopt.report.template_rendering import render_macro

Q = np.random.default_rng(3).uniform(-2.5, 2.5, (20, 6))


def ball(rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a unit sphere by longitude and latitude; as in many meshes, the vertices at the seam are not shared."""
    a, b = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * rings), np.linspace(0, np.pi, rings), indexing="ij")
    vertices = np.stack([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(2 * rings - 1), np.arange(rings - 1), indexing="ij")
    k = (i * rings + j).ravel()
    return vertices, np.concatenate([np.c_[k, k + rings, k + 1], np.c_[k + 1, k + rings, k + rings + 1]])


def test_simplified_mesh_keeps_the_shape() -> None:
    vertices, faces = ball(80)
    less, retained = decimate_mesh(vertices, faces, 2000)
    assert 500 < len(retained) <= 2000
    radius = np.linalg.norm(less, axis=1)
    assert radius.min() > 0.93  # a cell of the grid is 0.09 wide
    assert radius.max() <= 1.0 + 1e-12
    corners = less[retained]
    volume = float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()) / 6
    assert abs(volume) == pytest.approx(4 / 3 * np.pi, rel=0.05)  # no hole and no inverted face
    same = decimate_mesh(vertices, faces, len(faces))
    assert same[0] is vertices


def test_bodies_share_one_triangle_budget() -> None:
    big, small = ball(90), ball(8)
    bodies = tuple(
        SceneBody(name=name, kind="link", joint=0, vertices=mesh[0], faces=mesh[1])
        for name, mesh in (("big", big), ("small", small))
    )
    shown = reduce_bodies(bodies, 3000)
    assert sum(len(b.faces) for b in shown) <= 3000
    assert len(shown[1].faces) == len(small[1])  # the small one is not simplified


def test_joint_values_are_recovered_from_their_levels() -> None:
    q = Q.copy()
    q[3] = np.nan
    spec = pack_joint_levels(q)
    level = np.frombuffer(base64.b64decode(spec["data"]), "<u2").reshape(q.shape)
    back = np.where(level == 65535, np.nan, np.array(spec["low"]) + level * np.array(spec["step"]))
    np.testing.assert_allclose(back, q, atol=5.0 / 65534, rtol=0)


def test_page_with_the_scene_is_small_and_names_its_library(tmp_path: Path) -> None:
    data, _ = build_report_with_motion_scene(small_cell(tmp_path), points=5000, samples=60_000)
    html = build_report_html(data)
    assert len(html.encode()) < 12_000_000
    places = set(re.findall(r"https?://[^\"'\s)]*", html))
    assert places == {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xhtml"}  # namespace names, not addresses
    assert html.count("var THREE=") == 1
    assert "Copyright © 2010-2026 three.js authors" in html
    assert len((ASSETS / "three" / "three.min.js").read_bytes()) < 700_000
    without = build_report_html(replace(data, view=None))
    assert "THREE" not in without
    assert "data-point" not in without


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["arm", "linkage", "rail and table"])
def test_page_places_the_arm_like_pinocchio(kind: str, tmp_path: Path) -> None:
    cell: Cell = small_cell(tmp_path)
    if kind == "linkage":
        (tmp_path / "robot.urdf").write_text(linked_urdf(offset=0.0))
        cell = replace(cell, mimics=build_mimic_joints(offset=0.0))
    elif kind == "rail and table":
        cell = external_cell(tmp_path, rail=True, table=True, tilt=True)
    data, robot = build_report_with_motion_scene(cell)
    assert (robot.coupling is not None) == (kind == "linkage")
    assert data.view is not None
    assert build_scene_spec(data.view.scene)["joints"][1]["unit"] == "°"
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (8, 6 + len(cell.external_joints)))
    found = in_browser(build_report_html(data), "kinematics", tmp_path, {"q": x.tolist()})
    assert found["failed"] == []
    model = pin.buildModelFromXML(cell.urdf_text)
    work = model.createData()
    flange = model.getFrameId("flange")
    for n, q in enumerate(x):
        T = np.vstack([np.reshape(found["poses"][n], (3, 4)), [0, 0, 0, 1]])  # of the tool relative to the part
        if kind == "rail and table":
            np.testing.assert_allclose(T, by_pinocchio(cell, q)[0], atol=1e-9)
            continue
        pin.framesForwardKinematics(model, work, expand_mimic_joints(model, q, cell.mimics))
        tool = work.oMf[flange].homogeneous @ cell.tool.T_flange_tcp
        np.testing.assert_allclose(T, np.linalg.inv(cell.workpiece.T_link_workpiece) @ tool, atol=1e-9)
        J = robot.compute_fk_jacobian(q, cell.tool.T_flange_tcp)[1][
            :3
        ]  # compared with pinocchio in test_robot_kinematics.py
        np.testing.assert_allclose(np.reshape(found["compliance"][n], (3, 3)), J @ J.T / 1e6, atol=1e-12)
        np.testing.assert_allclose(found["eigenvalues"][n], np.linalg.eigvalsh(J @ J.T / 1e6)[::-1], atol=1e-12)


@pytest.mark.slow
def test_slider_map_curves_and_tables_move_one_robot(tmp_path: Path) -> None:
    data, _ = build_report_with_motion_scene(small_cell(tmp_path))
    found = in_browser(build_report_html(data), "view", tmp_path)
    assert found["failed"] == []
    assert found["asked"] == 0  # no request to the network or to other files
    assert found["colours"] > 200
    assert found["moved"] > 500  # pixels that differ after each motion of the robot
    assert found["turned"] > 100
    assert found["cell"] == pytest.approx(found["wanted"], abs=1e-4)  # the stored configuration of that cell
    for words in ("not the chosen one", "State", "Clearance", "a6", "γ"):
        assert words in found["told"]
    assert "no posture of the arm reaches" in found["unreachable"]
    point, shown, marks = found["curve"]
    assert shown == pytest.approx(point, abs=0.1)
    assert len(marks) > 10  # every picture over path or time, including the map
    assert min(marks) >= 0
    assert found["slider"][0] != found["slider"][1]
    bend = data.path.deflection[round(found["linked"])] if data.path is not None else np.nan
    assert f"Deflection{1e3 * bend:.3f} mm" in found["at"]  # as in the tables and curves
    assert f"Tolerance{OUTCOMES[round(found['linked']) % 4]}, probability 61 %" in found["at"]
    assert found["link"] == [pytest.approx(found["linked"], abs=0.1), "#scene"]
    assert "φ, γ" in found["tip"]
    assert found["keyboard"]


@pytest.mark.slow
def test_map_is_navigated_by_keys_and_enter_moves_the_robot(tmp_path: Path) -> None:
    data, _ = build_report_with_motion_scene(small_cell(tmp_path))
    page = tmp_path / "page.html"
    page.write_text(build_report_html(data), encoding="utf-8")
    over = "document.querySelector('.u-over[role=application]')"
    with Browser() as browser:
        browser.open(page)
        for _ in range(40):
            browser.page.keyboard.press("Tab")
            if browser.script(f"document.activeElement === {over}"):
                break
        assert browser.script(f"document.activeElement === {over}")
        assert "Enter" in browser.script(f"{over}.getAttribute('aria-label')")
        assert browser.script(f"getComputedStyle({over}).outlineStyle") == "solid"
        output = []
        for key in ("Home", "ArrowRight", "ArrowUp"):
            browser.page.keyboard.press(key)
            output.append(browser.script("document.querySelector('[role=status].aloud').textContent"))
        assert len(set(output)) == 3
        before = browser.script("document.querySelector('.view .pose-details').textContent")
        browser.page.keyboard.press("Enter")
        message = browser.script("document.querySelector('.view .pose-details').textContent")
        assert message != before
        assert output[-1].split(", ")[2].removeprefix("φ ") in message
        assert browser.complaints == []


@pytest.mark.slow
def test_page_without_webgl_reports_it_and_works(tmp_path: Path) -> None:
    data, _ = build_report_with_motion_scene(small_cell(tmp_path))
    blind = (
        "<script>const given = HTMLCanvasElement.prototype.getContext; HTMLCanvasElement.prototype.getContext = "
        "function (kind, ...more) { return kind[0] === 'w' ? null : given.call(this, kind, ...more); };</script>"
    )
    found = in_browser(build_report_html(data).replace("<head>", "<head>" + blind), "scene_without_webgl", tmp_path)
    assert found["failed"] == []
    assert "no WebGL" in found["said"]
    assert "not the chosen one" in found["told"]


@pytest.mark.slow
def test_report_prints_on_three_pages(tmp_path: Path) -> None:
    """A report with eighty checks and forty feed dips has at most three printed pages, with six of the dips."""
    data, _ = build_report_with_motion_scene(small_cell(tmp_path))
    data = replace(data, checks=tuple(CheckRow(f"check {n}", n != 70, "0.1 mm", "1 mm", "point 3") for n in range(80)))
    dips = tuple(
        FeedDipRow(point=1.0, s=0.1, time=t, duration=0.2, feed_programmed=0.05, feed_lowest=0.01, cause="axis 5 jerk")
        for t in np.linspace(0.0, 1.0, 40)
    )
    data = replace(data, dips=dips, motion=full_result().motion)
    page = tmp_path / "page.html"
    page.write_text(build_report_html(data), encoding="utf-8")
    with Browser() as browser:
        browser.open(page)
        browser.page.emulate_media(media="print")
        rows = "[...document.querySelectorAll('#feed .scroll tbody tr')].filter(r => r.offsetHeight).length"
        assert browser.script(rows) == 6
        sheets = browser.page.pdf(format="A4")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b(?!s)", sheets)) <= 3


@pytest.mark.slow
def test_configurations_are_stepped_through_with_their_vectors(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    robot, shapes = load_chain(cell)
    force = np.tile([100.0, 0.0, 0.0], (4, 1))
    postures = ScenePostures(
        q=Q[:4],
        label="Pose",
        names=("one", "two", "three", "four"),
        words=((("Load", "first"),), (("Load", "second"),), (("Load", "<third>"),), (("Load", "fourth"),)),
        vectors=(PostureVectors("force", "#d61f69", force),),
    )
    view = build_posture_view("Poses", build_machine_scene(cell, robot, build_bodies(cell, robot, shapes)), postures)
    body = build_section("poses", "Poses", "", render_macro("report.html", "view"))
    html = build_page_html("Poses", (), [("poses", "Poses", body)], {"view": view}, scripts=POSTURE_SCRIPTS, footer="")
    found = in_browser(html, "posture", tmp_path)
    assert found["failed"] == []
    assert found["colours"] > 100
    assert found["moved"] > 300
    assert "three" in found["told"]
    assert "<third>" in found["told"]
    assert found["shown"] == 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slice", "volume", "joints", "line"])
def test_clicked_place_of_the_map_moves_the_arm(kind: str, tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True, table=True, tilt=False)
    robot, shapes = load_chain(cell)
    space = MapScene(build_machine_scene(cell, robot, build_bodies(cell, robot, shapes)), np.eye(4), cell.external_home)
    html = build_map_html(build_sample_map(kind, space=space))
    assert html.count("var THREE=") == 1
    found = in_browser(html, "map_3d_view", tmp_path)
    assert found["failed"] == []
    assert found["colours"] > 100
    assert found["moved"] > 300
    assert found["names"][0] != found["names"][1]
    if kind != "line":
        assert "out of reach" in found["unreachable"]
        assert found["shown"] == [False, True]  # the arm is hidden where no configuration exists, and reappears
