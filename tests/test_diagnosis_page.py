"""Diagnosis on page, diagnosis.json, residuals.csv and terminal."""

from __future__ import annotations

import argparse
import base64
import csv
import json
import re
import sys
from dataclasses import dataclass, fields, replace
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import sample_diagnoses as made_up

from machopt.cell.cell_reader import load_cell
from machopt.cli import diagnose_command as command
from machopt.commands.diagnose.output_files import write_residual_table
from machopt.effects import registry
from machopt.effects.effect_wording import format_effect_at_place, format_place
from machopt.measurement.diagnosis.data_types.diagnosis_result import (
    AxisInterval,
    DiagnosisResult,
    EstimatedValue,
    MismatchShare,
)
from machopt.measurement.diagnosis.outputs.diagnosis_document import build_diagnosis_document, format_rows_location
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.measurement.diagnosis.verdict.verdict_rules import apply_verdict_rules
from machopt.output import write_json
from machopt.report.charts.diagnosis_charts import (
    build_axis_chart,
    build_group_chart,
    build_law_chart,
    compute_binned_median,
    compute_binned_rms,
    compute_value_range,
)
from machopt.report.page_data.cell_scene import build_cell_scene
from machopt.report.page_data.diagnosis import build_diagnosis_page_data
from machopt.report.pages.diagnosis.detection_limits_section import build_limits_html
from machopt.report.pages.diagnosis.diagnosis_page import build_diagnosis_html, write_diagnosis_page
from machopt.report.pages.diagnosis.residual_scene_section import build_residual_scene
from machopt.report.svg.machine_diagram import build_machine_column, build_machine_strip, build_share_bars
from machopt.report.template_rendering import bind_units
from machopt.report.wording.diagnosis_terms import (
    describe_alternatives,
    describe_share,
    format_error,
    format_estimate,
    format_interval_parts,
)

CELL = load_cell(Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling")
CASES = ("explained", "consistent", "unexplained", "three", "insufficient", "torque")
VOID = {"meta", "hr", "br"}
VOCABULARY = {
    "joint_nonlinear_stiffness",
    "joint_backlash",
    "joint_hysteresis",
    "joint_creep",
    "joint_pose_dependent_stiffness",
    "joint_zero_offset",
    "transmission_error",
    "joint_friction",
    "joint_coupling",
    "gravity_compensator",
    "link_compliance",
    "base_compliance",
    "tool_compliance",
    "payload",
    "geometric_stiffness",
    "geometry",
    "force_sensor_offset",
    "force_sensor_gain",
    "force_sensor_frame",
    "displacement_frame",
    "load_geometry",
    "columns",
    "units",
    "time_skew",
    "outliers",
    "thermal_drift",
    "servo_lag",
    "joint_elasticity",
}


class Balanced(HTMLParser):
    """HTML parser that rejects unbalanced tags and external resources; it collects ids, links and text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.anchors: list[str] = []
        self.text = ""
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        assert "src" not in given
        assert str(given.get("href", "#")).startswith("#")
        if tag not in VOID:
            self.open.append(tag)
        if given.get("id"):
            self.ids.append(str(given["id"]))
        if tag == "a":
            self.anchors.append(str(given["href"])[1:])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("script", "style"):
            self.text += data


def page(name: str | DiagnosisResult, **changes: Any) -> Any:
    d: DiagnosisResult = getattr(made_up, name)() if isinstance(name, str) else name
    r = made_up.recording(motion=d.channel == "torque")
    job = made_up.job() if len(d.findings) in (1, 3) and d.channel != "torque" else None
    return replace(build_diagnosis_page_data(CELL, r, d, (("seed", "0"),), job, problem=made_up.problem(d)), **changes)


def read(name: str | DiagnosisResult) -> Balanced:
    return Balanced(build_diagnosis_html(page(name)))


def specs(html: str) -> list[dict[str, Any]]:
    text = re.search(r'<script id=data type="application/json">(.*?)</script>', html)
    assert text is not None
    return list(json.loads(text[1])["xy"])


@pytest.mark.parametrize("name", CASES)
def test_page_is_self_contained(name: str, tmp_path: Path) -> None:
    """One file: balanced tags, no external resources, valid menu links, and a place for each chart."""
    write_diagnosis_page(tmp_path / "report.html", page(name))
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert html == build_diagnosis_html(page(name))  # the same data give the same bytes
    observed = Balanced(html)
    assert set(observed.anchors) <= set(observed.ids)
    assert len(observed.ids) == len(set(observed.ids))
    drawn = [c["id"] for c in specs(html)]
    assert drawn
    assert set(drawn) <= set(observed.ids)
    d = page(name).diagnosis
    assert bind_units(d.sentence) in observed.text
    for word in ("nan", "None", "inf "):
        assert not re.search(rf"\b{word}\b", observed.text)


def test_finding_shows_size_place_law_and_alternatives() -> None:
    text = read("explained").text
    assert "Hysteresis of joint 3: 0.90 arcmin (0.82 … 0.98), on load reversal" in text
    assert "play operator on the joint torque" in text
    assert "61 µm" in text
    assert "25 µm" in text
    assert "backlash of joint 3dead zone on total torque31 %" in text
    assert "placebo: hysteresis of joint 2" in text
    assert "2 of 2 did" in text
    assert "These data single it out" in text
    assert "6 of 6" in text
    assert "Load joint 3 through zero" in text
    assert "410" in text  # N·m/arcmin of 1.41e6 N·m/rad: 1.41e6 · π/10800


def test_alternative_sets_are_listed_and_drawn() -> None:
    text = read("three").text
    assert "These data cannot tell it from coupling of joints 4 and 5 or compliance of the tool." in text
    assert "These data cannot tell it from misalignment of the tracker." in text
    assert "Goes into stiffness.yaml as a term, which optimize takes: link_compliance link:4 (EI_Nm2 3.1e+06" in text
    assert "Goes into kinematics.yaml" in text
    assert "38 µm rms still come back in every repeat" in text
    strip = build_machine_strip(made_up.three())
    # three findings, and three other locations in their alternative sets
    assert strip.count("<circle") - strip.count('r="10.5"') == 3 + 3
    assert strip.count("stroke-dasharray") == 3


def test_data_strip_collects_record_findings() -> None:
    """Rows and columns of the recording share one mark; two findings of one joint are drawn next to each other."""
    d = made_up.three()
    spoilt = replace(made_up.frame(), effect="outliers", location="rows:1,2", one_of=(("outliers", "rows:1,2"),))
    strip = build_machine_strip(
        replace(d, findings=(made_up.hysteresis(), spoilt, replace(made_up.hysteresis(), note="b")))
    )
    assert strip.count(">record<") == 1
    assert re.findall(r'font-weight="700" fill="#fff">(\d)<', strip) == [
        "1",
        "3",
        "2",
    ]  # joint 3 first, then the record
    at = [float(x) for x in re.findall(r'<circle cx="([\d.]+)" cy="[\d.]+" r="9"', strip)]
    assert abs(at[1] - at[0]) >= 18.0  # two marks of radius 9 do not overlap


def of_the_record(explained: float) -> DiagnosisResult:
    """Return a diagnosis with findings of the recording only; no improvement of the machine model is shown."""
    d = replace(made_up.three(), findings=(made_up.frame(),), verdict="partly_explained", explained=explained)
    return apply_verdict_rules(replace(d, mismatch_p=np.nan))


def test_record_correction_without_improvement_is_no_explanation() -> None:
    d = of_the_record(0.0)
    assert d.verdict == "unexplained"
    assert d.sentence.startswith("Unexplained, with the record corrected")
    assert "→" not in d.sentence
    text = read(d).text
    assert "NOT EXPLAINED" in text
    assert "EXPLAINED IN PART" not in text
    assert "Held-out error before" not in text
    assert "of the error of the corrected record" in text
    assert "more than the noise" not in text  # without replicates noise and mismatch cannot be separated
    assert "no reading was repeated, so part of it may be noise" in text


def test_charts_show_one_state_where_only_record_faults_are_found() -> None:
    d = of_the_record(0.6)
    assert d.sentence.startswith("Partly explained: ")
    text = read(d).text
    assert "EXPLAINED IN PART" in text
    assert "The record is corrected in all that is drawn here; as stated, it is off by" in text
    names = {
        layer["name"]
        for c in specs(build_diagnosis_html(page(d)))
        if c["id"] not in ("d-gamma", "d-deflection")
        for layer in c["layers"]
    }
    assert "record corrected, model refitted" in names
    assert not {"with what was found", "model as it was, refitted", "rms, after"} & names


def test_page_without_findings_states_detection_limits() -> None:
    text = read("consistent").text
    assert "CONSISTENT" in text
    assert "Nothing is missing that these data could show" in text
    assert "Backlasharcmin0.200.150.110.150.20✕" in text
    assert "Where the mismatch lives" not in text
    assert "Proof" not in text
    assert "the recording has neither time nor temperature" in text


def test_unexplained_mismatch_states_place_and_size() -> None:
    text = read("unexplained").text
    assert "NOT EXPLAINED" in text
    assert "57 µm rms come back in every repeat and no law of the catalogue predicts them" in text
    assert "joint 3 (78 %), link 3 (41 %) and joint 2 (19 %)" in text
    assert "loading and unloading, unloading against loading (71 %)" in text
    assert "single it out" not in text


def test_broken_record_has_no_success_page() -> None:
    d = replace(made_up.explained(), findings=(made_up.frame(),))
    assert "CHECK THE RECORD" in read(d).text
    assert "Stays in the diagnosis, the robot's model is not touched by it" in read(d).text


def test_law_is_drawn_with_the_readings() -> None:
    data = page("explained")
    f = data.diagnosis.findings[0]
    spec = build_law_chart(data, 1, f)
    assert spec is not None
    by_name = {x["name"]: x for x in spec["layers"]}
    line = by_name["fitted law: play operator on the joint torque"]
    # six digits are written
    assert np.allclose(line["y"], f.curve.law, rtol=1e-5, atol=1e-9)
    shown = np.array(by_name["loading"]["y"] + by_name["unloading"]["y"])
    value = (f.curve.per_reading + f.curve_residual)[data.diagnosis.used]
    assert value.max() > 30
    assert np.abs(shown).max() < 5  # a reading that hardly depends on the joint does not compress the chart
    left = int(re.search(r"(\d+) readings lie outside", spec["title"])[1])  # type: ignore[index]
    assert len(shown) + left == len(value)  # no reading is dropped without a message
    # the averaged loading and unloading branches lie on their sides of the law, as in the simulated readings
    up, down = by_name["loading, averaged"], by_name["unloading, averaged"]
    assert np.median(up["y"]) > 0.3 > -0.3 > np.median(down["y"])


def test_axis_range_shows_the_whole_law() -> None:
    low, high = compute_value_range(np.array([0.0, 0.1, -0.1, 0.05, 500.0]), np.array([-3.0, 2.0]))
    assert low <= -3.0
    assert 2.0 <= high < 500.0


def test_bins_preserve_the_power() -> None:
    rng = np.random.default_rng(2)
    x, r = np.sort(rng.integers(0, 40, 500)).astype(float), rng.normal(size=500)
    at, mean = compute_binned_rms(x, np.abs(r), few=True)
    count = np.array([(x == v).sum() for v in at])
    assert np.isclose((count * mean**2).sum(), (r**2).sum(), rtol=1e-12)  # the sum in a different order
    middle, height, half = compute_binned_median(x, 2 * x + 0.1 * r)
    # values are spaced by one and the slope is 2: the two medians of a bin differ by at most one step, plus 5 σ of
    # 0.022
    assert np.abs(height - 2 * middle).max() < 2.11
    assert (half > 0).all()


def test_groups_are_sorted_worst_first_with_recorded_names() -> None:
    data = page("explained")
    spec = build_group_chart(data)
    assert spec is not None
    before = next(x for x in spec["layers"] if x["name"] == "model as it was, refitted")["y"]
    assert before == sorted(before, reverse=True)
    worst = int(np.argmax(data.diagnosis.errors.by_group[:, 0]))
    assert spec["xcats"][0] == str(worst + 1)  # poses of the recording start at 1, groups at 0
    # written in µm from values of some mm/1000
    assert np.isclose(before[0], 1e3 * data.diagnosis.errors.by_group[worst, 0], rtol=1e-5)


def test_motion_page_shows_the_affected_joint() -> None:
    spec = build_axis_chart(page("torque"), "qd2", "a")
    assert spec is not None
    assert spec["title"] == "Size of the residual of joint 2 over velocity of joint 2"
    assert "(N·m)" in spec["ylabel"]
    before = next(x for x in spec["layers"] if x["name"] == "rms, before")["y"]
    # simulated with 14 N·m of friction and 6 N·m of noise: 15.2; a bin of 30 readings has an error of about 2
    assert np.abs(np.array(before) - 15.2).max() < 4
    assert (
        build_axis_chart(
            page("torque", diagnosis=replace(made_up.torque(), used=np.zeros(made_up.N, bool))), "qd2", "a"
        )
        is None
    )


def test_axis_without_numbers_is_not_drawn() -> None:
    d = made_up.explained()
    data = page(replace(d, axes={"temperature": np.full(made_up.N, np.nan), "session": np.zeros(made_up.N)}))
    assert build_axis_chart(data, "temperature", "a") is None
    assert build_axis_chart(data, "session", "a") is None


def test_json_agrees_with_the_contract() -> None:
    d = replace(made_up.three(), explained=np.nan, repeatable_after=np.inf)
    got = build_diagnosis_document(
        CELL, made_up.recording(), d, kinematics="kinematics.yaml", effect_on_job=made_up.job()
    ).to_json_types()
    assert json.loads(json.dumps(got, allow_nan=False)) == got
    assert got["machopt_diagnosis"] == 1
    assert (got["verdict"], got["channel"], got["rmse_unit"]) == ("partly_explained", "deflection", "mm")
    assert got["baseline"]["heldout_rmse"] == 0.061
    assert got["baseline"]["noise_floor"] == 0.022
    assert got["baseline"]["repeatable_rmse"] == 0.057
    assert got["final"] == {"rmse": None, "heldout_rmse": 0.0423, "explained_share": None, "repeatable_rmse": None}
    assert got["mismatch"][0] == {"axis": "joint:3", "share": 0.78, "note": "on load reversal", "kind": "machine"}
    first, second, _ = got["findings"]
    assert first["one_of"] == [["joint_hysteresis", "joint:3"]]
    assert second["one_of"][0] == ["link_compliance", "link:4"]
    width = first["parameters"]["width"]
    assert (width["value"], width["unit"]) == (0.9, "arcmin")
    assert width["ci95"] == pytest.approx([0.804, 0.996])
    assert (first["heldout_rmse_before"], first["heldout_rmse_after"], first["p_value"]) == (0.061, 0.03, 0.0004)
    assert {"effect": "joint_backlash", "location": "joint:3", "value": 0.11, "unit": "arcmin"}.items() <= next(
        x for x in got["detection_limits"] if (x["effect"], x["location"]) == ("joint_backlash", "joint:3")
    ).items()
    # effects without a limit are listed in not_testable
    assert all(isinstance(x["value"], float) for x in got["detection_limits"])
    assert got["not_testable"]
    assert isinstance(got["next_experiment"], str)
    assert (got["model"], got["kinematics"]) == ("stiffness.yaml", "kinematics.yaml")
    assert got["outliers"] == {"location": "rows:41,134,401", "rows": [41, 134, 401]}
    assert got["effect_on_job"]["deflection_after_mm"][-1] is None


def test_named_effect_is_first_in_its_set() -> None:
    """Also if the engine omits it or puts it last."""
    f = replace(made_up.link(), one_of=(("tool_compliance", "tool"), ("link_compliance", "link:4")))
    got = build_diagnosis_document(
        CELL, made_up.recording(), replace(made_up.explained(), findings=(f,))
    ).to_json_types()
    assert got["findings"][0]["one_of"] == [["link_compliance", "link:4"], ["tool_compliance", "tool"]]
    assert "cannot tell it from compliance of the tool." in read(replace(made_up.explained(), findings=(f,))).text


def test_json_accepts_numpy_inside_corrections(tmp_path: Path) -> None:
    f = made_up.frame()
    assert f.correction is not None
    f = replace(f, correction=replace(f.correction, parameters={"R": np.eye(2), "n": np.int64(3), "bad": np.nan}))
    got = build_diagnosis_document(
        CELL, made_up.recording(), replace(made_up.explained(), findings=(f,))
    ).to_json_types()
    assert got["findings"][0]["correction"]["parameters"] == {"R": [[1.0, 0.0], [0.0, 1.0]], "n": 3, "bad": None}
    assert got["findings"][0]["correction"]["of"] == "record"
    write_json(tmp_path / "diagnosis.json", got)
    assert json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8")) == got


def test_outlier_rows_are_a_location() -> None:
    assert format_rows_location([12, 3, 7]) == "rows:3,7,12"
    assert format_place("rows:3,7,12") == "rows 3, 7 and 12"
    assert format_place("rows:" + ",".join(map(str, range(1, 41)))) == "40 rows (1, 2, 3, 4 …)"


@pytest.mark.parametrize("name", ["three", "torque"])
def test_residuals_are_read_back_from_the_table(name: str, tmp_path: Path) -> None:
    d: DiagnosisResult = getattr(made_up, name)()
    final = d.errors.final.copy()
    final[5, 1] = np.nan
    d = replace(d, errors=replace(d.errors, final=final))
    write_residual_table(tmp_path / "residuals.csv", made_up.recording(motion=name == "torque"), d, made_up.problem(d))
    with (tmp_path / "residuals.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == made_up.N
    names = ["dx_mm", "dy_mm", "dz_mm"] if name == "three" else [f"joint{j}_Nm" for j in range(1, 7)]
    factor = 1e3 if name == "three" else 1.0
    got = np.array([[float(r[f"before_{n}"]) for n in names] for r in rows])
    assert np.abs(got - factor * d.errors.residual).max() <= 5.1e-7  # six decimals
    assert rows[5][f"after_{names[1]}"] == ""
    assert [r["used"] for r in rows].count("0") == int((~d.used).sum())
    assert [int(r["line"]) for r in rows] == made_up.recording().line.tolist()


def test_file_name_is_shown_with_several_files() -> None:
    d = made_up.explained()
    r = made_up.recording()
    two = replace(r, files=("monday.csv", "tuesday.csv"), file=(r.session > 0).astype(np.int64))
    text = Balanced(build_diagnosis_html(build_diagnosis_page_data(CELL, two, d, ()))).text
    assert "401tuesday.csv line 402" in text
    apart = [replace(r, source="a", files=("a.csv",)), replace(r, source="b", files=("b.csv",))]
    assert build_diagnosis_page_data(CELL, apart, d, ()).recording == "a, b"


def test_foreign_text_is_escaped() -> None:
    bad = "</script><b onclick=x>"
    d = made_up.three()
    f = replace(d.findings[0], law=bad, note=bad, equation=bad)
    html = build_diagnosis_html(
        page(replace(d, sentence=bad, findings=(f, *d.findings[1:]), warnings=(bad,)), cell=bad)
    )
    assert bad not in html
    assert Balanced(html).text.count(bad) >= 4


def test_every_word_of_the_vocabulary_has_a_name() -> None:
    unnamed = {"kinematic_correction"}  # written to kinematics.yaml, never a finding
    assert {e.file_word for e in registry.EFFECTS.values()} == VOCABULARY | unnamed
    assert format_effect_at_place("joint_hysteresis", "joint:3") == "hysteresis of joint 3"
    assert format_effect_at_place("joint_coupling", "joint:4-5") == "coupling of joints 4 and 5"
    assert format_effect_at_place("units", "column:fx_N") == "wrong unit in column fx_N"
    assert format_effect_at_place("time_skew", "sensor:tau") == "time skew of the torque channel"
    assert format_effect_at_place("my_own_law", "link:2") == "my own law of link 2"
    assert describe_alternatives((("base_compliance", "base"), ("joint_creep", "joint:1"))) == (
        "These data cannot tell it from creep of joint 1."
    )


@pytest.mark.parametrize(
    ("value", "low", "high", "texts"),
    [
        (0.9, 0.82, 0.98, ("0.90", "0.82", "0.98")),
        (212.4, 181.2, 243.3, ("212", "181", "243")),
        (1.41e6, 1.3e6, 1.5e6, ("1.41e6", "1.30e6", "1.50e6")),
        (-0.5, -0.6, -0.4, ("−0.50", "−0.60", "−0.40")),
        (3e-7, 1e-7, 5e-7, ("3.00e−7", "1.00e−7", "5.00e−7")),
        (2.0, np.nan, np.nan, ("2", "–", "–")),
    ],
)
def test_numbers_have_the_digits_of_their_interval(
    value: float, low: float, high: float, texts: tuple[str, str, str]
) -> None:
    assert format_interval_parts(value, low, high) == texts


def test_compliances_have_small_units() -> None:
    assert (
        format_estimate(EstimatedValue(2.4e-7, "rad/(N·m)", (2.0e-7, 2.8e-7), (1.9e-7, 2.9e-7)))
        == "0.24 µrad/(N·m) (0.20 … 0.28)"
    )
    assert format_error(0.0613, "mm") == "61.3 µm"
    assert format_error(1.25, "mm") == "1.25 mm"
    assert format_error(np.nan, "mm") == "–"


def test_data_notes_use_display_units() -> None:
    def told(axis: str, low: float, high: float, readings: float) -> tuple[str, str]:
        there = AxisInterval(low, high, readings)
        return there.words, describe_share(MismatchShare(axis, 0.5, there.words, "data", there))

    assert told("q3", 0.7854, 1.5708, 0.33) == (
        "0.7854 … 1.571: 33 % of the readings",
        "45.0 … 90.0 deg, 33 % of the readings",
    )
    assert told("branch", -1.0, -1.0, 0.5) == ("-1: 50 % of the readings", "unloading, 50 % of the readings")
    assert told("load", 500.0, 1000.0, 0.2) == (
        "500 … 1000: 20 % of the readings",
        "500 … 1000 N, 20 % of the readings",
    )
    assert (
        describe_share(MismatchShare("q3", 0.5, "where joint 3 is stretched", "data")) == "where joint 3 is stretched"
    )


def test_limits_name_sets_and_reasons() -> None:
    html = build_limits_html(made_up.explained())
    assert 'title="cannot be distinguished from compliance of the base">(11)</span>' in html
    text = Balanced(html).text
    assert "Creep (joints 1, 2, 3, 4, 5 and 6)the recording has no time" in text.replace("; ", "; ")
    assert build_limits_html(replace(made_up.explained(), limits=(), untestable=())) == ""


def test_shares_of_the_mismatch_are_sorted_bars() -> None:
    bars = build_share_bars([s for s in made_up.explained().mismatch if s.kind == "data"])
    assert [float(w) for w in re.findall(r'style="width:([\d.]+)%"', bars)] == [71.0, 22.0, 11.0, 2.0]
    assert build_share_bars([]) == ""


def test_narrow_page_shows_the_same_as_the_wide_one() -> None:
    """The column shows every part, share and mark of the strip, and no two of its lines overlap."""
    for d in (made_up.three(), made_up.explained(), made_up.unexplained()):
        strip, column = build_machine_strip(d), build_machine_column(d)
        numbers = re.compile(r'font-weight="(\d+)" fill="#\w+">(\d+)<')
        assert sorted(numbers.findall(column)) == sorted(numbers.findall(strip))
        assert re.search('aria-label="[^"]*"', column)[0] == re.search('aria-label="[^"]*"', strip)[0]  # type: ignore[index]
        lines = sorted({float(y) for y in re.findall(r'text class="label" x="142" y="([\d.]+)"', column)})
        assert np.diff(lines).min() >= 14.0  # px between lines of 12 px
        assert "force sensor" in column


def test_terminal_summary() -> None:
    lines = command.format_diagnosis_summary(
        build_diagnosis_document(CELL, made_up.recording(), made_up.three(), effect_on_job=made_up.job())
    )
    text = "\n".join(lines)
    assert lines[0] == made_up.three().sentence
    assert "held-out error 61 µm → 42.3 µm, noise floor 22 µm, repeatable 57 µm, 55 % of it closed" in text
    assert "1. joint_hysteresis joint:3, on load reversal" in text
    assert "these data cannot distinguish it from: joint_coupling joint:4-5, tool_compliance tool" in text
    assert "excluded: 3 readings (rows:41,134,401)" in text
    assert "largest shares of the mismatch: joint:3 78 %" in text
    empty = replace(made_up.consistent(), explained=np.nan, heldout_before=np.nan)
    quiet = "\n".join(command.format_diagnosis_summary(build_diagnosis_document(CELL, made_up.recording(), empty)))
    assert "nothing repeatable above the noise" in quiet
    assert "nan" not in quiet


@pytest.mark.parametrize("verdict", CASES[:5])
def test_command_passes_options_on_and_every_verdict_is_success(
    verdict: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @dataclass(frozen=True)
    class Outcome:
        result: dict[str, Any]
        report: Path

    observed: list[DiagnoseRequest] = []

    def run(request: DiagnoseRequest, progress: Any) -> Outcome:
        progress("screening")
        observed.append(request)
        return Outcome(
            build_diagnosis_document(CELL, made_up.recording(), getattr(made_up, verdict)()),
            request.out / "report.html",
        )

    stub = ModuleType("machopt.commands.diagnose.run")
    stub.run_diagnose = run  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "machopt.commands.diagnose.run", stub)
    common = argparse.ArgumentParser(add_help=False)
    for flag in ("--quiet", "--json", "--debug"):
        common.add_argument(flag, action="store_true")
    parser = argparse.ArgumentParser()
    command.add_commands(parser.add_subparsers(), common)
    typed = (
        "diagnose cell mon tue -o out --channel torque --toolpath t.apt --effects a.py --terms b.py --max-findings 2 "
        "--accept units --seed 7 --tables parquet --allow-external --jobs 2 --set seed=3 --force"
    )
    args = parser.parse_args(typed.split())
    assert args.run(args) == 0
    out = capsys.readouterr().out
    assert getattr(made_up, verdict)().sentence in out
    assert "report: out/report.html" in out
    expected = DiagnoseRequest(
        cell=Path("cell"),
        recordings=(Path("mon"), Path("tue")),
        out=Path("out"),
        channel="torque",
        toolpath=Path("t.apt"),
        terms=(Path("a.py"), Path("b.py")),
        max_findings=2,
        accept=("units",),
        seed=7,
        tables="parquet",
        allow_external=True,
        overrides=("seed=3",),
        overwrite=True,
    )
    assert observed == [expected]
    assert len(fields(DiagnoseRequest)) == 13  # no option is omitted
    args = parser.parse_args([*typed.split(), "--json"])
    assert args.run(args) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == getattr(made_up, verdict)().verdict


def test_residuals_are_drawn_at_the_arm_before_and_after() -> None:
    scene, _ = build_cell_scene(CELL)
    data = page("explained", scene=scene)
    recording = made_up.recording()
    data = replace(data, q=recording.q)
    view = build_residual_scene(data)
    assert view is not None
    d, postures = data.diagnosis, view["postures"]
    assert len(postures["names"]) == len(np.unique(data.pose[d.used]))
    before, after = postures["vectors"]
    assert before["length"] == after["length"]  # the same scale; otherwise the picture would hide the improvement
    red, green = postures["needles"]
    at = [np.frombuffer(base64.b64decode(n["at"]), "<f4").reshape(-1, 3) for n in (red, green)]
    observed = d.used & np.isfinite(d.errors.residual[:, :3]).all(axis=1)
    assert len(at[0]) == observed.sum()
    np.testing.assert_allclose(np.sum(at[0] ** 2), np.sum(d.errors.residual[observed, :3] ** 2), rtol=1e-5)
    np.testing.assert_allclose(np.sum(at[1] ** 2), np.sum(d.errors.final[observed, :3] ** 2), rtol=1e-5)
    html = build_diagnosis_html(data)
    assert html.count("var THREE=") == 1
    assert "each reading predicted by fits that never saw it" in html
    assert build_residual_scene(page("torque", scene=scene)) is None
    assert "THREE" not in build_diagnosis_html(page("explained"))
