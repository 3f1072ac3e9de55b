"""Program section of report.html: written files, check, failed check."""

from __future__ import annotations

import re
from dataclasses import replace

from sample_report_data import full_result

from machopt.report.page_types.optimize_page_data import ProgramRow, ReportData
from machopt.report.pages.optimize.optimize_page import build_report_html
from machopt.report.wording.result_verdict import build_verdict


def block(data: ReportData) -> str:
    """Replace the non-breaking spaces between numbers and units by plain ones."""
    found = re.search(r"<section id=programs>.*?</section>", build_report_html(data), re.S)
    assert found
    return found[0].replace("\u00a0", " ")


def test_programs_section_names_files_and_differences() -> None:
    html = block(full_result(points=50, samples=300))
    assert "0.005\u00a0mm/min" in build_report_html(full_result(points=50, samples=300))
    rows = re.findall(r"<tr>(.*?)</tr>", html.partition("<tbody>")[2])
    krl, jbi, ros, mine = (re.sub(r"<[^>]+>", " ", row) for row in rows)
    assert 'href="krl/bracket_op10.src"' in rows[0]
    for words in (
        "812 moves",
        "3 of them added",
        "1210 lines",
        "&lt; 0.0001 mm",
        "0.005 mm/min",
        "0.016 of 0.050 mm",
        "tool axis 0.007 deg",
        "orientation 0.046 deg",
        "equal",
    ):
        assert words in krl
    assert "0.0026 mm" in jbi  # mm: rounding to whole pulses, 2.6 µm
    assert "no lines: joints are interpolated" in ros
    assert "not checked: no reader here knows its language" in mine
    assert [row.count("reads back") for row in rows] == [1, 1, 1, 0]
    assert "Do not run" not in html


def test_failed_program_is_reported_first_and_in_the_verdict() -> None:
    data = full_result(points=50, samples=300)
    differences = ("move 3 (line 14) goes elsewhere", "events differ")
    bad = ProgramRow(
        post="krl",
        files=("part<1>.src",),
        lines=12,
        added=0,
        tolerance=5e-5,
        moves=10,
        position_error=0.05,
        path_error=8e-5,
        events_equal=False,
        configuration_equal=False,
        differences=differences,
    )
    summary = replace(data.summary, outcome="verification_failed", note="But the program part.src: events differ.")
    data = replace(data, programs=(bad,), summary=summary)
    html = block(data)
    assert html.index("Do not run these") < html.index("<table")
    assert "<b>part&lt;1&gt;.src</b>: move 3 (line 14) goes elsewhere" in html
    assert "reads back" not in html.partition("<tbody>")[2]
    v = build_verdict(data)
    assert v.badge == "VERIFICATION FAILED: DO NOT RUN"
    assert v.sentence.endswith("But the program part.src: events differ.")


def test_result_without_programs_has_no_section() -> None:
    assert "id=programs" not in build_report_html(replace(full_result(points=50, samples=300), programs=()))


def test_many_files_are_counted() -> None:
    data = full_result(points=50, samples=300)
    parts = tuple(f"part_{n:03d}.src" for n in range(20))
    html = block(replace(data, programs=(replace(data.programs[0], files=parts),)))
    assert html.count("<a href=") == 4
    assert "… and 16 more" in html
