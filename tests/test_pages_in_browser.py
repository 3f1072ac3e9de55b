"""Pages in a browser: every picture is drawn, no script fails; pointer, legend and zoom work."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from browser_driver import Browser, program
from sample_diagnoses import explained
from sample_pages import STEERING
from sample_report_data import full_result
from test_diagnosis_page import page as diagnosis_of
from test_map_page import build_sample_map

from machopt.options.plan_option_reader import format_user_options, load_options
from machopt.report.page_types.steering_panel_data import SteeringAxis
from machopt.report.pages.diagnosis.diagnosis_page import build_diagnosis_html
from machopt.report.pages.map_page import build_map_html
from machopt.report.pages.optimize.optimize_page import build_report_html

ASSETS = Path(__file__).resolve().parents[1] / "machopt" / "report" / "assets"
SCRIPTS = Path(__file__).with_name("page_scripts")


def in_browser(page: str, script: str, folder: Path, given: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the result of a script of ``live`` on a rendered page; ``failed`` lists the errors of the page.

    Args:
        given: value that the script receives as ``GIVEN``.
    """
    tools, own = ((SCRIPTS / f"{name}.js").read_text(encoding="utf-8") for name in ("pointer_tools", script))
    file = folder / "page.html"
    file.write_text(page, encoding="utf-8")
    with Browser() as browser:
        browser.open(file)
        begun = f"const GIVEN = {json.dumps(given or {})};{tools}\nawait wait(200); const found = {{}};"
        found: dict[str, Any] = browser.script(f"(async () => {{ {begun}\n{{ {own}\n}} return found; }})()")
        return {**found, "failed": browser.complaints}


def test_missing_browser_fails_in_ci_and_skips_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match="no browser"):
        program()
    monkeypatch.delenv("CI")
    with pytest.raises(pytest.skip.Exception, match="not exercised"):
        program()


def test_chart_library_is_the_published_one() -> None:
    """uPlot 1.6.32 from the npm registry; its licence is included with it and on every page that uses it."""
    published = {
        "LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
        "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
        "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    }
    files = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in (ASSETS / "uplot").iterdir()}
    assert files == published
    html = build_report_html(full_result(points=20, samples=100))
    assert html.count("var uPlot=") == 1
    assert "uPlot 1.6.32\nThe MIT License (MIT)\n\nCopyright (c) 2022 Leon Sorokin" in html


@pytest.mark.slow
def test_report_is_drawn_and_answers_the_pointer(tmp_path: Path) -> None:
    data = full_result(points=60, samples=400)
    found = in_browser(build_report_html(data), "report", tmp_path)
    assert found["failed"] == []
    drawn = dict(found["drawn"])
    assert {"map", "c-index", "c-feed", "c-q0", "c-v5"} <= set(drawn)
    assert min(drawn.values()) > 5  # colours, including interpolated ones
    assert drawn["map"] > 100
    low, high = found["full"]
    for words in ("path length (mm)", "point", "operation", "chosen", "mm"):
        assert words in found["tip"]
    for words in ("point", "φ", "state", "Jiao 2022"):
        assert words in found["map"]
    for a, b in found["zoomed"]:  # the pictures zoom together to the half that was dragged over; a pixel is 1/1000
        assert a == pytest.approx(low + 0.25 * (high - low), abs=0.01 * (high - low))
        assert b == pytest.approx(low + 0.75 * (high - low), abs=0.01 * (high - low))
    assert found["other"] != found["zoomed"][0]
    assert found["back"] == found["full"]
    assert found["hidden"] == 1
    assert found["less"][0] < found["less"][1]
    assert (found["flip"], found["flipped"]) == ("show by station", ["show over path length", 0, 59])


@pytest.mark.slow
def test_diagnosis_is_drawn_and_names_the_nearest_point(tmp_path: Path) -> None:
    found = in_browser(build_diagnosis_html(diagnosis_of(explained())), "diagnosis", tmp_path)
    assert found["failed"] == []
    assert min(colours for _, colours in found["drawn"]) > 5
    assert "fitted law: play operator on the joint torque" in found["legend"]
    assert all(words in found["tip"] for words in found["expected"])
    assert found["less"][0] < found["less"][1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slice", "volume", "joints"])
def test_map_is_drawn_with_isolines_and_answers_the_pointer(kind: str, tmp_path: Path) -> None:
    found = in_browser(build_map_html(build_sample_map(kind)), "map", tmp_path)
    assert found["failed"] == []
    assert "best by the quantity postures are chosen by" in found["best"]
    assert found["arm"] > 0
    assert found["lines"] > 50  # white pixels
    assert "under the pointer" in found["under"]
    assert "Stiffness, <softest> direction" in found["tip"]
    assert "kept" in found["kept"]
    assert "Deflection under the load" in found["here"]
    assert ("level" in found) == (kind == "volume")


@pytest.mark.slow
def test_view_form_sends_external_values_as_in_a_plan_file(tmp_path: Path) -> None:
    """At a point, for an operation, a zone; the table limits of ±3.2 rad are not a round number of degrees."""
    axes = (
        SteeringAxis("rail", "mm", -1000.0, 1000.0),
        SteeringAxis("table", "deg", -math.degrees(3.2), math.degrees(3.2)),
    )
    page = build_report_html(full_result(points=60, samples=100), replace(STEERING, axes=axes))
    spot, some = {"first": 5, "last": 5}, {"first": 9, "last": 7}
    wishes = [
        ("points", "rail stands at", {**spot, "at": 100}),
        ("points", "rail stands at", {**spot, "at": 250.5}),  # replaces the first one
        ("points", "table stands at", {**spot, "at": -30.25}),
        ("points", "rail keeps out of", {**some, "from": -100, "to": 40}),
        ("whole path", "table keeps out of", {"from": -183, "to": -90}),
        ("operation rim", "table stands at", {"at": 12}),
        ("whole path", "rail keeps out of", {"from": 40, "to": 40}),  # an empty zone is reported and not added
    ]
    found = in_browser(page, "steering_form", tmp_path, {"wishes": wishes})
    assert found["failed"] == []
    assert found["refused"] == []
    assert found["told"] == "rail keeps out of a zone from a lower to a higher place."
    assert "point 5: table at −30.25°" in [" ".join(words.split()) for words in found["listed"]]
    [[what, requested]] = found["sent"]
    assert what == "plan"
    assert requested["steer"][1:] == [
        {"points": [5, 5], "external": "rail", "at_mm": 250.5},
        {"points": [5, 5], "external": "table", "at_deg": -30.25},
        {"points": [7, 9], "external": "rail", "forbid_mm": [-100, 40]},
        {"external": "table", "forbid_deg": [-183, -90]},
    ]
    assert requested["external"] == {"table": {"at_operations_deg": {"rim": 12}}}
    assert format_user_options(load_options(requested))["steer"][3]["forbid_mm"] == [
        -100.0,
        40.0,
    ]  # accepted as it is
