"""``report.html``: one self-contained page that opens offline in any current browser, and prints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.report.charts.chart_colours import Spec
from machopt.report.charts.optimize_charts import build_figure_specs
from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.display_units import QUANTITY_LABELS
from machopt.report.page_types.optimize_page_data import ReportData
from machopt.report.page_types.steering_panel_data import PlanComparison, SteeringData, build_steering_spec
from machopt.report.pages import report_tables
from machopt.report.pages.optimize.posture_feed_section import build_joint_method_section
from machopt.report.pages.optimize.program_section import build_program_section
from machopt.report.pages.optimize.tolerance_section import build_tolerance_section
from machopt.report.pages.optimize.trade_off_section import build_trade_off_section
from machopt.report.template_rendering import join_markup, render_macro, render_part
from machopt.report.wording.result_verdict import build_key_figures, build_verdict, format_count

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

SCENE_SCRIPTS = ("fk.js", "stage.js", "view.js")

_SHIFT_NOTE = (
    "The commanded path is the programmed one less the deflection predicted at each point; the shift fades in along "
    "the approach and out along the retract. Where the path turns sharply the force turns with it at once, which no "
    "continuous path can follow: the shift then goes over to the new direction just before the corner, and that is "
    "where the largest remaining distance lies."
)


def write_report(path: Path, data: ReportData) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show; parts that are missing or empty leave no gap on the page.
    """
    path.write_text(build_report_html(data), encoding="utf-8", newline="\n")


def build_report_html(data: ReportData, steering: SteeringData | None = None) -> str:
    """Return the page; the same data give the same bytes.

    Args:
        data: Data of the report.
        steering: Data of the steering panel of ``machopt view``; None without it.
    """
    specs = build_figure_specs(data)
    scripts = ["chart.js", "heatmap.js", *(SCENE_SCRIPTS if data.view is not None else ()), "start.js"]
    if steering is not None:
        specs["steering"] = build_steering_spec(steering)
        scripts += ["steer.js", "start_steer.js"]
    charts = {spec["id"] for spec in specs["charts"]}
    sections = [
        ("verdict", "Verdict", _build_verdict(data)),
        ("tolerances", "Tolerances", build_tolerance_section(data, charts)),
        ("infeasible", "Infeasible points", _build_infeasible(data)),
        ("scene", "Robot", _build_scene(data)),
        ("rotation", "Map", _build_map(data, specs)),
        ("steer", "Steer", _build_steering(steering)),
        ("path", "Along the path", _build_path(charts)),
        ("points", "Worst points", _build_worst_points(data)),
        ("feed", "Feed", _build_feed(data, charts)),
        ("axes", "Axes", _build_axes(data, charts)),
        ("joint", "Rotation and feed", build_joint_method_section(data)),
        ("front", "Front", build_trade_off_section(data)),
        ("verification", "Verification", _build_verification(data)),
        ("programs", "Robot programs", build_program_section(data)),
        ("source", "CAM file", _build_source(data)),
        ("run", "This run", _build_run(data)),
    ]
    return build_page_html(
        data.title,
        (("Cell", data.cell), ("Toolpath", data.toolpath)),
        sections,
        specs,
        brief=True,
        scripts=scripts,
        footer=f"machopt {data.version}{f', {data.created}' if data.created else ''}. "
        "Lengths mm, angles deg, stiffness N/µm, feed mm/min. Drag in a picture to zoom, double click to see all, "
        "click a legend entry to hide it.",
    )


def _build_verdict(data: ReportData) -> Body:
    v = build_verdict(data)
    boxes = [(c.name, c.value, c.unit, c.more) for c in build_key_figures(data)]
    return render_part("verdict", "verdict", v.tone, v.badge, v.sentence, v.cautions, boxes, data.summary.blockers)


def _build_plot(name: str, charts: set[str]) -> Body:
    return render_part("chart", name) if name in charts else ""


def _build_infeasible(data: ReportData) -> Body:
    out: Body = ""
    if data.infeasible:
        lead = "Points without any posture that satisfies reach, limits, singularity distance and clearance."
        out = build_section("infeasible", "Infeasible points", lead, report_tables.build_infeasible_point_table(data))
    if data.breaks:
        lead = "Successive places that are possible by themselves, and no motion of the arm that joins them."
        out += build_section("breaks", "Where the motion breaks off", lead, report_tables.build_break_table(data))
    return out


def _build_scene(data: ReportData) -> Body:
    if data.view is None:
        return ""
    lead = (
        "Turn it by dragging, go nearer with the buttons or, after a click into it, with the wheel. A click on the "
        "path, on the map, on a curve or on a point's number in a table sets the robot there; on the map also to "
        "rotations that were not chosen, and the chosen posture stays as a shadow."
    )
    return build_section("scene", "The robot on its path", lead, render_macro("report.html", "view"))


def _build_map(data: ReportData, specs: Spec) -> Body:
    if specs["map"] is None:
        return ""
    lead = (
        "Every rotation φ of the tool about its own axis at every station of the path, counted from a direction that "
        "is carried along without turning (γ of the tables is counted from the direction of travel, so the CAM's "
        "default, γ = 0, is a curve where the path turns). Bright is stiff, dark is soft; grey and hatched places "
        "cannot be used, and the hatching gives the reason. "
    ) + (data.map.collisions if data.map is not None else "")
    return build_section(
        "rotation",
        f"{QUANTITY_LABELS[data.summary.quantity].axis} over path and rotation",
        lead,
        render_part("chart", "map"),
    )


def _build_steering(s: SteeringData | None) -> Body:
    if s is None:
        return ""
    rows = [
        (
            c.name + (f" ({c.unit})" if c.unit else ""),
            _format_number(c.before, c),
            _format_number(c.now, c),
            _format_change(c),
            _choose_tone(c),
        )
        for c in s.compared
    ]
    lead = (
        "Drag a point of the map's white curve up or down, and it is pinned there; or say here what is to hold where. "
        "Planning anew keeps what was loaded, so it takes seconds; nothing is written before the plan file is saved."
    )
    return build_section(
        "steer", "Steer", lead, render_macro("steer.html", "steer", rows, s.message, s.has_motion, s.file, s.command)
    )


def _format_number(value: float, c: PlanComparison) -> str:
    return f"{value:.{c.decimals}f}".replace("-", "−") if math.isfinite(value) else "–"


def _format_change(c: PlanComparison) -> str:
    if not (math.isfinite(c.before) and math.isfinite(c.now)) or not c.before:
        return "–"
    text = f"{100 * (c.now / c.before - 1):+.2f}"
    return "0.00 %" if float(text) == 0 else f"{text} %".replace("-", "−")


def _choose_tone(c: PlanComparison) -> str:
    """Better, worse or the same, to the decimals that are shown."""
    if not math.isfinite(c.before) or _format_number(c.before, c) == _format_number(c.now, c):
        return ""
    return "pass" if (c.now < c.before) == c.less_is_better else "fail"


def _build_path(charts: set[str]) -> Body:
    body: Body = join_markup(_build_plot(name, charts) for name in ("c-index", "c-deflection", "c-shift"))
    body += render_part("note", _SHIFT_NOTE) if "c-shift" in charts else ""
    if "c-stiffness" in charts:
        body += render_part("chart", "c-stiffness") + render_macro("report.html", "stiffness_note")
    small = [render_part("chart", name) for name in ("c-clearance", "c-margins") if name in charts]
    body += render_part("grid", 2, small) if small else ""
    return build_section(
        "path",
        "Along the path",
        "All pictures share the path length, counted where the tool cuts, and zoom together.",
        body,
    )


def _build_worst_points(data: ReportData) -> Body:
    body: Body = ""
    if data.worst:
        body += render_part("heading", "Worst points") + report_tables.build_worst_point_table(data)
    if data.operations:
        body += render_part("heading", "Operations") + report_tables.build_operation_table(data)
    return build_section("points", "Worst points and operations", "Where the result is decided.", body)


def _build_feed(data: ReportData, charts: set[str]) -> Body:
    if "c-feed" not in charts:
        return ""
    no_dip_text = render_part(
        "paragraph", "The axes hold the programmed feed throughout, apart from stops that the path demands."
    )
    body = render_part("chart", "c-feed") + (
        render_part("heading", "Dips") + report_tables.build_feed_dip_table(data) if data.dips else no_dip_text
    )
    if data.feed_stops:
        ramps = ", ".join(f"{count} {where}" for where, count in data.feed_stops)
        body += render_part("note", f"Ramps from and to stops that the path itself demands, no lost feed: {ramps}.")
    lead = "The programmed feed is held wherever the axes can; a dip names the axis and the limit that caused it."
    return build_section("feed", "Feed", lead, body)


def _build_axes(data: ReportData, charts: set[str]) -> Body:
    if data.motion is None or "c-q0" not in charts:
        return ""
    count = range(len(data.motion.joint_names))
    positions, ratios = ([_build_plot(f"c-{kind}{j}", charts) for j in count] for kind in "qv")
    key = ["velocity (blue)"]
    key += ["acceleration (orange)"] if data.motion.acceleration_ratio is not None else []
    key += ["jerk (green)"] if data.motion.jerk_ratio is not None else []
    body = render_part("heading", "Positions and their limits") + render_part("grid", 3, positions)
    body += render_part("heading", f"Peak shares of the limits: {', '.join(key)}") + render_part("grid", 3, ratios)
    return build_section("axes", "Axes over time", "Over time in seconds; dashed lines are the limits.", body)


def _build_verification(data: ReportData) -> Body:
    body: Body = report_tables.build_check_table(data) if data.checks else ""
    body += report_tables.build_folded_table(
        len(data.information), "Information (no checks)", report_tables.build_information_table, data
    )
    body += report_tables.build_folded_table(
        len(data.excluded_pairs) + len(data.adjacent_pairs),
        "Pairs left out of the collision check",
        report_tables.build_excluded_pair_table,
        data,
        opened=bool(data.excluded_pairs),
    )
    lead = (
        f"{format_count(len(data.checks), 'check')} of the written files, by code that shares nothing with the planner."
        if data.checks
        else "Not done: no trajectory was written that could be checked."
    )
    return build_section("verification", "Verification", lead, body)


def _build_source(data: ReportData) -> Body:
    body: Body = ""
    for title, words in (("Warnings", data.warnings), ("From the cell's files", data.notes)):
        body += render_part("heading", title) + render_part("bullets", words[: report_tables.MAX_ROWS]) if words else ""
    unknown = any(not w.understood for w in data.ignored)
    body += report_tables.build_folded_table(
        len(data.ignored), "Words without effect", report_tables.build_cam_word_table, data, opened=unknown
    )
    body += report_tables.build_folded_table(
        len(data.events), "Events on the way", report_tables.build_event_table, data
    )
    return build_section(
        "source", "CAM file", f"Content of {data.toolpath} besides its points, and what the cell does not define.", body
    )


def _build_run(data: ReportData) -> Body:
    body = report_tables.build_folded_table(len(data.timings), "Time per stage", report_tables.build_timing_table, data)
    if data.options:
        body += report_tables.build_folded_block(
            "Options", len(data.options), report_tables.build_pair_table("Option", "Value", data.options)
        )
    if data.hashes:
        body += report_tables.build_folded_block(
            "Inputs", len(data.hashes), report_tables.build_pair_table("File", "SHA-256", data.hashes)
        )
    return build_section("run", "This run", "What it was made from, with what settings, in what time.", body)
