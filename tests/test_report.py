"""Report: every outcome has a self-contained and correct page."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from sample_report_data import full_result, infeasible_result

from machopt.data_types.toolpath import IgnoredWord
from machopt.report.charts.optimize_charts import build_figure_specs, format_reason_with_distance
from machopt.report.charts.point_reduction import pack_levels, select_plot_points
from machopt.report.page_data.optimize import format_measured_value
from machopt.report.page_data.optimize_series import compute_cut_length, interpolate_path_length
from machopt.report.page_types.display_units import ANGLE, FEED, FINE_LENGTH, STIFFNESS, format_fixed
from machopt.report.page_types.optimize_page_data import STATUS_NAMES, GainOverBaseline, ReportData, ShiftSummary
from machopt.report.pages.optimize.optimize_page import build_report_html, write_report
from machopt.report.wording.result_verdict import build_key_figures, build_verdict
from machopt.verification.check_results import VerificationCheck

VOID = {"meta", "br", "link", "img", "input"}


class Balanced(HTMLParser):
    """Fail on a tag closed out of order; collect ids, link targets and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.anchors: list[str] = []
        self.tags: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        given = dict(attrs)
        assert "src" not in given
        if given.get("id"):
            self.ids.append(str(given["id"]))
        if str(given.get("href", "")).startswith("#"):
            self.anchors.append(str(given["href"])[1:])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] not in (["script"], ["style"]):
            self.text += data


def read(html: str) -> Balanced:
    page = Balanced()
    page.feed(html)
    page.close()
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert set(page.anchors) <= set(page.ids)
    return page


def specs_in(html: str) -> dict:  # type: ignore[type-arg]
    found = re.search(r'<script id=data type="application/json">(.*?)</script>', html, re.S)
    assert found
    return dict(json.loads(found[1]))


def test_page_is_self_contained_and_small() -> None:
    html = build_report_html(full_result(points=2000, rotations=72, samples=100_000))
    page = read(html)
    assert len(html.encode()) < 3_000_000
    assert set(re.findall(r"https?://[^\"'\s)]*", html)) == {"http://www.w3.org/2000/svg"}
    drawn = {spec["id"] for spec in specs_in(html)["charts"]} | {"map"}
    assert drawn <= set(page.ids)
    assert all(len(spec["x"]) <= 3100 for spec in specs_in(html)["charts"])  # 3000 points and the edges of gaps


def test_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, full_result(points=60, samples=500))
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


@pytest.mark.parametrize(
    "missing", [f.name for f in fields(ReportData) if f.name not in ("title", "cell", "toolpath", "version", "summary")]
)
def test_any_section_may_be_missing(missing: str) -> None:
    data = full_result(points=50, samples=300)
    empty = "" if missing == "created" else None if missing in ("map", "view", "path", "motion", "tolerances") else ()
    html = build_report_html(replace(data, **{missing: empty}))
    drawn = {spec["id"] for spec in specs_in(html)["charts"]}
    assert drawn <= set(read(html).ids)


def test_infeasible_result_has_a_page() -> None:
    page = read(build_report_html(infeasible_result()))
    assert "No feasible plan for 2 of 40 points" in page.text
    assert "the first point 7 at x 2900.0, y 100.0, z 400.0 mm, 38 mm out" in page.text
    assert "38 mm out" in page.text
    assert "hole <3>" in page.text
    assert build_verdict(infeasible_result()).tone == "bad"


@pytest.mark.parametrize(
    ("reason", "shortfall", "told"),
    [
        ("out of reach at every rotation", "38 mm out of reach", "38 mm out of reach at every rotation"),
        (
            "out of reach: the wrist lies 38 mm outside",
            "38 mm out of reach",
            "out of reach: the wrist lies 38 mm outside",
        ),
        ("axis 5 at 128°", "3.1° beyond", "axis 5 at 128°, 3.1° beyond"),
        ("joint limit", "", "joint limit"),
    ],
)
def test_scene_states_a_distance_once(reason: str, shortfall: str, told: str) -> None:
    assert format_reason_with_distance(reason, shortfall) == told


def test_hostile_names_do_not_break_the_page() -> None:
    evil = "</script><script>alert(1)</script><!-- & \"'"
    data = full_result(points=50, samples=300)
    operations = tuple(replace(o, label=evil) for o in data.operations)
    assert data.path is not None
    path = replace(data.path, nearest_pair=(evil,) * len(data.path.s))
    html = build_report_html(
        replace(
            data,
            title=evil,
            cell=evil,
            toolpath=evil,
            operations=operations,
            warnings=(evil,),
            path=path,
            ignored=(IgnoredWord(evil, 1, 1, False),),
            options=((evil, evil),),
        )
    )
    assert html.count("<script") == 2
    assert "<script>alert" not in html
    assert evil in read(html).text
    assert evil in str(specs_in(html)["charts"]).replace("\\'", "'")


def test_verdict_states_gain_and_safety() -> None:
    v = build_verdict(full_result(points=50, samples=300))
    assert v.sentence == (
        "Predicted worst deflection 0.182 → 0.108 mm (−41 %) against the CAM's default rotation, −18 % against "
        "Jiao 2022; mean deflection 36 % ± 6 % less than with the CAM's default rotation (90 %: 26 to 46 %), 14 % less "
        "than with Jiao 2022; programmed feed reached for 99.1 % of the cutting time; minimum clearance at the points "
        "12.4 mm "
        "(link5 – fixture, point 211); verification passed."
    )
    assert (v.badge, v.tone) == ("VERIFIED", "")
    assert any("GOFWDX" in c for c in v.cautions)


@pytest.mark.parametrize(
    ("changes", "badge", "words"),
    [
        ({"verification": "failed"}, "VERIFICATION FAILED: DO NOT RUN", "verification failed"),
        ({"verification": "not run"}, "NOT VERIFIED", "verification not run"),
        ({"worst_default": float("nan")}, "VERIFIED", "no gain over it to state"),
        ({"worst_default": 1.0e-4}, "VERIFIED", "there is no gain over the CAM's default"),
        (
            {"gains": (GainOverBaseline("Jiao 2022", 0.05, 0.04, (-0.02, 0.12), False),)},
            "VERIFIED",
            "The gain over Jiao 2022, 5 % ± 4 % on average, is below the stiffness model's own uncertainty",
        ),
        (
            {"gains": (GainOverBaseline("Jiao 2022", -0.012, 0.004, (-0.019, -0.005)),)},
            "VERIFIED",
            "1.2 % ± 0.4 % more than with Jiao 2022 (90 %: 0.5 to 1.9 %)",
        ),
        (
            {"gains": (GainOverBaseline("Jiao 2022", 0.03, 0.004, (-0.0002, 0.036)),)},
            "VERIFIED",
            "3.0 % ± 0.4 % less than with Jiao 2022 (90 %: 0.0 to 3.6 %)",  # no −0.0
        ),
        (
            {"gains": (GainOverBaseline("Jiao 2022", 1e-5, 1e-6, (-1e-6, 2e-5), False),)},
            "VERIFIED",
            "the same mean deflection as with Jiao 2022; programmed feed reached",
        ),
        (
            {"shift": ShiftSummary(worst=3.3e-4, mean=2.8e-4, left_worst=2.1e-5, left_mean=4e-6)},
            "VERIFIED",
            "shifted by up to 0.330 mm against the predicted deflection, which leaves 0.004 mm on average and 0.021 mm",
        ),
        (
            {"quantity": "stiffness", "worst_default": 1e6, "worst_chosen": 1.5e6},
            "VERIFIED",
            "Predicted least stiffness 1.000 → 1.500 N/µm (+50 %",
        ),
        ({"quantity": "stiffness", "worst_default": 1.5e6, "worst_chosen": 1e6}, "VERIFIED", "there is no gain"),
        ({"infeasible_points": 3}, "VERIFIED", "3 points without an answer"),
    ],
)
def test_verdict_does_not_exaggerate(changes: dict[str, object], badge: str, words: str) -> None:
    data = full_result(points=50, samples=300)
    v = build_verdict(replace(data, summary=replace(data.summary, **changes)))  # type: ignore[arg-type]
    assert v.badge == badge
    assert words in " ".join([v.sentence, *v.cautions])


def test_si_is_converted_to_shop_units() -> None:
    assert FINE_LENGTH.format_value(1.23456e-4, unit=True) == "0.123 mm"
    assert ANGLE.format_value(-np.pi / 2) == "−90.0"
    assert ANGLE.format_value(-1e-4) == "0.0"  # no minus sign due to rounding
    assert format_fixed(0.26, 1, signed=True) == "+0.3"
    assert format_fixed(-0.04, 1, signed=True) == "0.0"
    assert FEED.format_value(0.02, unit=True) == "1200 mm/min"
    assert STIFFNESS.format_value(1.5e6, unit=True) == "1.500 N/µm"
    assert FINE_LENGTH.format_value(float("nan")) == "–"
    assert [c.value for c in build_key_figures(full_result(points=50, samples=300))][:2] == ["0.108", "0.090"]


def test_thinning_keeps_peaks_gaps_and_ends() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 100_000))
    a[77_777], b[3] = 50.0, -50.0
    a[500:520] = np.nan
    k = select_plot_points([a, b])
    assert len(k) <= 3010
    assert {0, 3, 77_777, 99_999} <= set(k.tolist())
    assert np.isnan(a[k][(k >= 500) & (k < 520)]).any()
    np.testing.assert_array_equal(select_plot_points([a[:100]]), np.arange(100))


def test_map_is_read_back_from_the_page() -> None:
    data = full_result(points=300)
    m = data.map
    assert m is not None
    spec = build_figure_specs(data)["map"]
    shape = (spec["stations"], spec["rotations"])
    level = np.frombuffer(base64.b64decode(spec["index"]), "<u2").reshape(shape)
    status = np.frombuffer(base64.b64decode(spec["status"]), np.uint8).reshape(shape)
    np.testing.assert_array_equal(status, m.status)
    usable = (m.status == 0) | (m.status == 7)
    assert np.all((level == 65535) == ~usable)
    value = spec["lowest"] + level[usable] / 65534 * (spec["highest"] - spec["lowest"])
    step = (spec["highest"] - spec["lowest"]) / 65534
    np.testing.assert_allclose(value, m.index[usable] * 1e3, atol=0.51 * step, rtol=0)
    assert spec["names"] == list(STATUS_NAMES)
    assert len(build_figure_specs(full_result(points=2500))["map"]["s"]) == 2000


def test_lines_are_wrapped_into_the_range_of_the_map() -> None:
    data = full_result(points=50)
    assert data.map is not None
    wound = replace(data.map, chosen=data.map.chosen + 4 * np.pi)
    before, after = (
        next(line["y"] for line in build_figure_specs(replace(data, map=m))["map"]["lines"] if line["name"] == "chosen")
        for m in (data.map, wound)
    )
    np.testing.assert_allclose(after, before, atol=1e-3)  # six significant digits of up to 180 deg


def test_empty_map_is_drawn() -> None:
    data = full_result(points=50)
    assert data.map is not None
    nothing = replace(data.map, status=np.ones_like(data.map.status), index=np.full_like(data.map.index, np.nan))
    spec = build_figure_specs(replace(data, map=nothing))["map"]
    assert spec["present"] == [1]
    assert pack_levels(np.array([np.nan]), 0.0, 0.0) == base64.b64encode(b"\xff\xff").decode()


def test_every_axis_shows_the_same_path_length() -> None:
    """Rapid moves do not add length, at points and between them, and a sample without a point has no length."""
    made = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0], [0.3, 0.4, 0.1]])
    toolpath = SimpleNamespace(position=made)
    s = compute_cut_length(toolpath, np.array([False, True, False, True]))  # type: ignore[arg-type]
    np.testing.assert_allclose(s, [0.0, 0.3, 0.3, 0.4])
    np.testing.assert_allclose(interpolate_path_length(s, np.array([0.5, 1.7, np.nan, 2.5])), [0.15, 0.3, np.nan, 0.35])


def test_margin_is_not_called_a_negative_excess() -> None:
    def told(value: float, unit: str, beyond: str = "") -> str:
        return format_measured_value(
            value, VerificationCheck(name="", passed=True, value=value, limit=0.0, unit=unit, where="", beyond=beyond)
        )

    assert told(-5.541, "deg beyond the limit", "deg") == "5.541 deg within the limit"
    assert told(0.25, "mm beyond the limit", "mm") == "0.25 mm beyond the limit"
    assert told(0.0, "deg beyond the limit", "deg") == "at the limit"
    assert told(-0.5, "mm") == "−0.5 mm"
