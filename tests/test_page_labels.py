"""Labels of a page: complete marks, ticks at the sampled positions, one word per quantity."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from sample_placement import build_sample_placement
from sample_report_data import full_result

from machopt.planning.retiming.slowdowns import FeedSlowdown
from machopt.report.charts.point_reduction import select_deepest_dips
from machopt.report.page_data.optimize import format_found_value
from machopt.report.page_data.optimize_feed_dips import describe_dip_cause
from machopt.report.page_types.optimize_page_data import FeedDipRow
from machopt.report.pages.optimize.optimize_page import build_report_html
from machopt.report.pages.placement_page import PlacementPageData, build_placement_html
from machopt.report.svg.placement_map import PlaceMark
from machopt.verification.check_results import VerificationCheck


def build_dip(time: float, lowest: float = 0.01) -> FeedDipRow:
    return FeedDipRow(
        point=1.0, s=0.1, time=time, duration=0.2, feed_programmed=0.05, feed_lowest=lowest, cause="axis 5 jerk"
    )


def test_dips_are_marked_up_to_the_end_and_the_deepest_neighbour_remains() -> None:
    dips = [build_dip(t) for t in np.arange(0.5, 99.0, 0.2)] + [build_dip(50.01, 0.0), build_dip(float("nan"))]
    marked = select_deepest_dips(dips, np.linspace(0.0, 100.0, 1001), 200)
    times = [d.time for d in marked]
    assert len(marked) <= 200
    assert times == sorted(times)
    assert times[0] < 1.0
    assert times[-1] > 98.0
    assert dips[-2] in marked


def ticks(page: PlacementPageData) -> tuple[list[str], list[str]]:
    """Return the words below and left of the map, as written."""
    html = build_placement_html(page)
    below = re.findall(r'<text[^>]*text-anchor="middle"[^>]*>(−?\d+)<', html)
    return below, re.findall(r'<text[^>]*text-anchor="end"[^>]*>(−?\d+)<', html)


def test_map_ticks_are_the_sampled_places() -> None:
    marks = [
        PlaceMark(x=x, y=y, value=0.4, planned=False, words="", refused="")
        for x in (-100.0, 0.0, 100.0)
        for y in (-50.0, 50.0)
    ]
    assert ticks(replace(build_sample_placement(), marks=tuple(marks))) == (["−100", "0", "100"], ["−50", "50"])


def test_labels_of_many_places_fit_and_include_the_middle() -> None:
    marks = [
        PlaceMark(x=10.0 * k, y=10.0 * n, value=0.4, planned=False, words="", refused="")
        for k in range(-12, 13)
        for n in (-1, 0, 1)
    ]
    below, left = ticks(replace(build_sample_placement(), marks=tuple(marks)))
    assert len(below) <= 9
    assert "0" in below
    assert left == ["−10", "0", "10"]


def test_axis_has_one_name_on_the_whole_page() -> None:
    slow = FeedSlowdown(first=0.0, last=1.0, ratio=0.5, joint=7, limit="jerk", where="path")
    assert describe_dip_cause(slow) == "external axis e1 jerk"
    assert describe_dip_cause(replace(slow, joint=5)) == "axis 5 jerk"


def test_unchecked_items_are_not_reported_as_checked() -> None:
    data = replace(full_result(points=50, samples=300), checks=())
    part = re.search(r"<section id=verification>.*?</section>", build_report_html(data), re.S)
    assert part
    assert "Not done: no trajectory was written" in part[0]
    assert "Done on the written" not in part[0]


def test_rounding_is_named_only_where_a_check_passed() -> None:
    even = VerificationCheck(name="uniform time", passed=True, value=5.73e-14, limit=5e-6, unit="s", where="sample 4")
    assert format_found_value(even) == "< 0.1 % of allowed"
    assert format_found_value(replace(even, value=2e-6)) == "0.000002 s"
    assert format_found_value(replace(even, value=0.0)) == "0 s"
    assert format_found_value(replace(even, passed=False)).endswith("e−14 s")  # no rounding if the check fails
    beyond = VerificationCheck(
        name="joint positions", passed=True, value=-1e-9, limit=0.0, unit="deg beyond the limit", where="", beyond="deg"
    )
    assert format_found_value(beyond).endswith("deg within the limit")
