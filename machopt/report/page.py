"""``report.html``: one self-contained page that opens offline in any current browser, and prints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.report import tables
from machopt.report.data import ReportData
from machopt.report.display import WORDS
from machopt.report.figures import Spec, figure_specs
from machopt.report.front import front_section
from machopt.report.programs import programs
from machopt.report.shell import page_html, section
from machopt.report.steering import Compared, Steering, steering_spec
from machopt.report.template import fragment, joined, part
from machopt.report.verdict import cards, counted, verdict

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

SCENE = ("fk.js", "stage.js", "view.js")

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
    path.write_text(report_html(data), encoding="utf-8", newline="\n")


def report_html(data: ReportData, steering: Steering | None = None) -> str:
    """The page as text; the same data give the same bytes.

    Args:
        steering: on the page of ``machopt view``, what is needed to steer the plan; None: nothing is.
    """
    specs = figure_specs(data)
    scripts = ["chart.js", "heatmap.js", *(SCENE if data.view is not None else ()), "start.js"]
    if steering is not None:
        specs["steering"] = steering_spec(steering)
        scripts += ["steer.js", "start_steer.js"]
    charts = {spec["id"] for spec in specs["charts"]}
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("infeasible", "Infeasible points", _infeasible(data)),
        ("scene", "Robot", _scene(data)),
        ("rotation", "Map", _map(data, specs)),
        ("steer", "Steer", _steer(steering)),
        ("path", "Along the path", _path(charts)),
        ("points", "Worst points", _worst(data)),
        ("feed", "Feed", _feed(data, charts)),
        ("axes", "Axes", _axes(data, charts)),
        ("front", "Front", front_section(data)),
        ("verification", "Verification", _verification(data)),
        ("programs", "Robot programs", programs(data)),
        ("source", "CAM file", _source(data)),
        ("run", "This run", _run(data)),
    ]
    return page_html(
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


def _verdict(data: ReportData) -> Body:
    v = verdict(data)
    boxes = [(c.name, c.value, c.unit, c.more) for c in cards(data)]
    return part("verdict", "verdict", v.tone, v.badge, v.sentence, v.cautions, boxes, data.summary.blockers)


def _plot(name: str, charts: set[str]) -> Body:
    return part("chart", name) if name in charts else ""


def _infeasible(data: ReportData) -> Body:
    out: Body = ""
    if data.infeasible:
        lead = "Points without any posture that satisfies reach, limits, singularity distance and clearance."
        out = section("infeasible", "Infeasible points", lead, tables.infeasible_points(data))
    if data.breaks:
        lead = "Successive places that are possible by themselves, and no motion of the arm that joins them."
        out += section("breaks", "Where the motion breaks off", lead, tables.breaks(data))
    return out


def _scene(data: ReportData) -> Body:
    if data.view is None:
        return ""
    lead = (
        "Turn it by dragging, go nearer with the buttons or, after a click into it, with the wheel. A click on the "
        "path, on the map, on a curve or on a point's number in a table sets the robot there; on the map also to "
        "rotations that were not chosen, and the chosen posture stays as a shadow."
    )
    return section("scene", "The robot on its path", lead, fragment("report.html", "view"))


def _map(data: ReportData, specs: Spec) -> Body:
    if specs["map"] is None:
        return ""
    lead = (
        "Every rotation φ of the tool about its own axis at every station of the path, counted from a direction that "
        "is carried along without turning (γ of the tables is counted from the direction of travel, so the CAM's "
        "default, γ = 0, is a curve where the path turns). Bright is stiff, dark is soft; grey and hatched places "
        "cannot be used, and the hatching says why. "
    ) + (data.map.collisions if data.map is not None else "")
    return section(
        "rotation", f"{WORDS[data.summary.quantity].axis} over path and rotation", lead, part("chart", "map")
    )


def _steer(s: Steering | None) -> Body:
    if s is None:
        return ""
    rows = [
        (c.name + (f" ({c.unit})" if c.unit else ""), _number(c.before, c), _number(c.now, c), _change(c), _tone(c))
        for c in s.compared
    ]
    lead = (
        "Drag a point of the map's white curve up or down, and it is pinned there; or say here what is to hold where. "
        "Planning anew keeps what was loaded, so it takes seconds; nothing is written before the plan file is saved."
    )
    return section("steer", "Steer", lead, fragment("steer.html", "steer", rows, s.told, s.good, s.file, s.command))


def _number(value: float, c: Compared) -> str:
    return f"{value:.{c.decimals}f}".replace("-", "−") if math.isfinite(value) else "–"


def _change(c: Compared) -> str:
    if not (math.isfinite(c.before) and math.isfinite(c.now)) or not c.before:
        return "–"
    text = f"{100 * (c.now / c.before - 1):+.2f}"
    return "0.00 %" if float(text) == 0 else f"{text} %".replace("-", "−")


def _tone(c: Compared) -> str:
    """Better, worse or the same, to the decimals that are shown."""
    if not math.isfinite(c.before) or _number(c.before, c) == _number(c.now, c):
        return ""
    return "pass" if (c.now < c.before) == c.less_is_better else "fail"


def _path(charts: set[str]) -> Body:
    body: Body = joined(_plot(name, charts) for name in ("c-index", "c-deflection", "c-shift"))
    body += part("note", _SHIFT_NOTE) if "c-shift" in charts else ""
    if "c-stiffness" in charts:
        body += part("chart", "c-stiffness") + fragment("report.html", "stiffness_note")
    small = [part("chart", name) for name in ("c-clearance", "c-margins") if name in charts]
    body += part("grid", 2, small) if small else ""
    return section(
        "path",
        "Along the path",
        "All pictures share the path length, counted where the tool cuts, and zoom together.",
        body,
    )


def _worst(data: ReportData) -> Body:
    body: Body = ""
    if data.worst:
        body += part("heading", "Worst points") + tables.worst_points(data)
    if data.operations:
        body += part("heading", "Operations") + tables.operations(data)
    return section("points", "Worst points and operations", "Where the result is decided.", body)


def _feed(data: ReportData, charts: set[str]) -> Body:
    if "c-feed" not in charts:
        return ""
    held = part("paragraph", "The axes hold the programmed feed throughout, apart from stops that the path demands.")
    body = part("chart", "c-feed") + (part("heading", "Dips") + tables.feed_dips(data) if data.dips else held)
    if data.feed_stops:
        ramps = ", ".join(f"{count} {where}" for where, count in data.feed_stops)
        body += part("note", f"Ramps from and to stops that the path itself demands, no lost feed: {ramps}.")
    lead = "The programmed feed is held wherever the axes can; a dip names the axis and the limit that caused it."
    return section("feed", "Feed", lead, body)


def _axes(data: ReportData, charts: set[str]) -> Body:
    if data.motion is None or "c-q0" not in charts:
        return ""
    count = range(len(data.motion.joint_names))
    positions, ratios = ([_plot(f"c-{kind}{j}", charts) for j in count] for kind in "qv")
    key = ["velocity (blue)"]
    key += ["acceleration (orange)"] if data.motion.acceleration_ratio is not None else []
    key += ["jerk (green)"] if data.motion.jerk_ratio is not None else []
    body = part("heading", "Positions and their limits") + part("grid", 3, positions)
    body += part("heading", f"Peak shares of the limits: {', '.join(key)}") + part("grid", 3, ratios)
    return section("axes", "Axes over time", "Over time in seconds; dashed lines are the limits.", body)


def _verification(data: ReportData) -> Body:
    body: Body = tables.checks(data) if data.checks else ""
    body += tables.part(len(data.information), "Information (no checks)", tables.information, data)
    body += tables.part(
        len(data.excluded_pairs) + len(data.adjacent_pairs),
        "Pairs left out of the collision check",
        tables.excluded_pairs,
        data,
        opened=bool(data.excluded_pairs),
    )
    lead = (
        f"{counted(len(data.checks), 'check')} of the written files, by code that shares nothing with the planner."
        if data.checks
        else "Not done: no trajectory was written that could be checked."
    )
    return section("verification", "Verification", lead, body)


def _source(data: ReportData) -> Body:
    body: Body = ""
    for title, words in (("Warnings", data.warnings), ("From the cell's files", data.notes)):
        body += part("heading", title) + part("bullets", words[: tables.MOST_ROWS]) if words else ""
    unknown = any(not w.understood for w in data.ignored)
    body += tables.part(len(data.ignored), "Words without effect", tables.cam_words, data, opened=unknown)
    body += tables.part(len(data.events), "Events on the way", tables.events, data)
    return section(
        "source", "CAM file", f"What {data.toolpath} holds beside its points, and what the cell leaves open.", body
    )


def _run(data: ReportData) -> Body:
    body = tables.part(len(data.timings), "Time per stage", tables.timings, data)
    if data.options:
        body += tables.folded("Options", len(data.options), tables.pairs("Option", "Value", data.options))
    if data.hashes:
        body += tables.folded("Inputs", len(data.hashes), tables.pairs("File", "SHA-256", data.hashes))
    return section("run", "This run", "What it was made from, with what settings, in what time.", body)
