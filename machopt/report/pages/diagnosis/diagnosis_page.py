"""Page of ``machopt diagnose``: size and location of the model error, missing effects, uncertainty, next steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.effects.effect_wording import format_effect_at_place, format_place, join_with_commas
from machopt.effects.protocol import UNCATALOGUED
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.verdict.verdict_text import is_mismatch_closed
from machopt.report.charts.diagnosis_charts import (
    Spec,
    build_axis_chart,
    build_group_chart,
    build_job_charts,
    build_law_chart,
)
from machopt.report.page_shell import POSTURE_SCRIPTS, build_page_html, build_section
from machopt.report.page_types.diagnosis_page_data import DiagnosisPageData
from machopt.report.page_types.display_units import format_fixed
from machopt.report.pages.diagnosis.base_model_section import MAX_OPEN_ROWS, build_model_html
from machopt.report.pages.diagnosis.detection_limits_section import build_limits_html
from machopt.report.pages.diagnosis.finding_section import build_finding_html
from machopt.report.pages.diagnosis.residual_scene_section import build_residual_html, build_residual_scene
from machopt.report.pages.diagnosis.verdict_section import build_verdict_html, has_data_finding
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.svg.machine_diagram import MIN_SHARE, build_machine_column, build_machine_strip, build_share_bars
from machopt.report.template_rendering import render_macro, render_part
from machopt.report.wording.diagnosis_terms import (
    describe_axis,
    describe_share,
    format_error,
    format_error_parts,
    format_p_value,
    format_percent,
    format_plural,
    format_significant,
    has_machine_finding,
)

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

MAX_AXES = 2  # of the data, drawn


def write_diagnosis_page(path: Path, data: DiagnosisPageData) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show; parts that are missing leave no gap.
    """
    path.write_text(build_diagnosis_html(data), encoding="utf-8", newline="\n")


def build_diagnosis_html(data: DiagnosisPageData) -> str:
    """Return the page; the same data give the same bytes.

    Args:
        data: The data of the page.
    """
    charts, view = _build_charts(data), build_residual_scene(data)
    have = {c["id"] for c in charts}
    sections = [
        ("verdict", "Verdict", build_verdict_html(data)),
        ("where", "Where", _build_location(data)),
        ("errors", "Before and after", _build_errors(data, have)),
        ("space", "At the arm", build_residual_html(view)),
        ("findings", "What is missing", _build_findings(data, have)),
        ("proof", "Proof", _build_validation(data)),
        ("limits", "Detection limits", _build_limits(data.diagnosis)),
        ("record", "Record", _build_data_quality(data)),
        ("model", "Model", build_model_html(data.diagnosis)),
        ("job", "The job", _build_job(data, have)),
        ("next", "Next", _build_next_experiment(data.diagnosis)),
        ("run", "This run", _build_run(data)),
    ]
    d = data.diagnosis
    head = (("Cell", data.cell), ("Recording", data.recording), ("Predicted", d.predicted))
    return build_page_html(
        data.title,
        head,
        sections,
        {"xy": charts} if view is None else {"xy": charts, "view": view},
        scripts=("chart.js", "xy.js", *(() if view is None else POSTURE_SCRIPTS), "start_xy.js"),
        footer=f"machopt {data.version}. Errors are rms per coordinate of readings that no fit saw, outliers "
        "apart. Intervals in brackets are 90 %. Click a legend entry to hide it.",
    )


def _build_location(data: DiagnosisPageData) -> Body:
    d = data.diagnosis
    machine = [s for s in d.mismatch if s.kind == "machine" and math.isfinite(s.share)]
    places = [s for s in d.mismatch if s.kind == "data"]
    if not machine and not places and not d.findings:
        return ""
    body: Body = build_machine_strip(d) + build_machine_column(d)
    if d.findings:
        body += render_part(
            "lead",
            "Orange bars and full marks: where a finding sits. Dashed marks: where these data would "
            "place it just as well.",
        )
    notes = [
        [format_place(s.axis), format_percent(s.share), s.note]
        for s in sorted(machine, key=lambda s: -s.share)
        if s.share >= MIN_SHARE and s.note
    ]
    if notes:
        columns = [TableColumn("Part of the machine"), TableColumn("Share", "n"), TableColumn("Shows")]
        body += build_folded_block("Parts of the machine", len(notes), build_table(columns, notes))
    if places:
        body += render_part("heading", "In the data")
        body += render_part("lead", "How much of it sits in which part of the readings.")
        body += build_share_bars(places)
    by_chance = f" (p {format_p_value(d.mismatch_p)} that noise alone does this)" if math.isfinite(d.mismatch_p) else ""
    known = math.isfinite(d.mismatch_p)
    unrepeated = (
        ", what unseen readings miss by less what is allowed for noise; no reading was repeated, so part of it may be "
        f"noise. The noise floor, {format_error(d.noise_floor, d.unit)}, is what the fit leaves in the readings "
        f"it has seen"
    )
    lead = (
        f"{'Repeatable mismatch' if known else 'Mismatch'} of the refitted model: "
        f"{format_error(d.repeatable, d.unit)} rms"
        f"{by_chance if known else unrepeated}. A bar says how "
        "much of it that part could take up, driven by its own load. Parts compete for the same mismatch, so bars need "
        "not add up to 100 %."
    )
    return build_section("where", "Where the mismatch lives", lead, body)


def _choose_axes(d: DiagnosisResult) -> list[str]:
    """Axes to draw: what carries the mismatch, and the load."""
    ranked = [s.axis for s in sorted(d.mismatch, key=lambda s: -s.share) if s.kind == "data" and s.axis in d.axes]
    return (
        list(dict.fromkeys([*ranked[: MAX_AXES - 1], *(name for name in d.axes if "load" in name), *ranked]))
        or list(d.axes)[:1]
    )


def _build_charts(data: DiagnosisPageData) -> list[Spec]:
    d = data.diagnosis
    charts = [c for c in [build_group_chart(data)] if c is not None]
    drawn = 0
    for name in _choose_axes(d):
        chart = build_axis_chart(data, name, f"d-axis{drawn}") if drawn < MAX_AXES else None
        if chart is not None:
            charts.append(chart)
            drawn += 1
    laws = (build_law_chart(data, n, f) for n, f in enumerate(d.findings, 1))
    charts += [c for c in laws if c is not None]
    return charts + (build_job_charts(data.job) if data.job is not None else [])


def _build_errors(data: DiagnosisPageData, have: set[str]) -> Body:
    body = _build_chart_host("d-groups", have)
    axes = [render_part("chart", f"d-axis{n}") for n in range(MAX_AXES) if f"d-axis{n}" in have]
    body += render_part("grid", 2, axes) if axes else ""
    lead = (
        f"Each {data.group_word} is predicted by fits that never saw it. Residuals at the noise floor cannot get "
        "smaller."
    )
    d = data.diagnosis
    if has_machine_finding(d) and has_data_finding(d):
        lead += " Faults of the record itself are corrected in both."
    elif has_data_finding(d):
        lead += " The record is corrected in all that is drawn here"
        lead += f"; as stated, it is off by {format_error(d.heldout_before, d.unit)}." if is_mismatch_closed(d) else "."
    return build_section("errors", "Before and after", lead, body)


def _build_findings(data: DiagnosisPageData, have: set[str]) -> Body:
    d = data.diagnosis
    if d.findings:
        body = render_macro(
            "diagnosis.html", "ruled", [build_finding_html(n, f, d.unit, have) for n, f in enumerate(d.findings, 1)]
        )
        lead = f"{d.tried} combinations of law, place and shape were tried; base and candidates were refitted together."
        if d.verdict == "partly_explained":
            body += render_part("note", _describe_unexplained(d))
        return build_section("findings", "What is missing", lead, body)
    if d.verdict == "consistent":
        sentence = (
            "Nothing is missing that these data could show: what is left does not come back when a reading is "
            "repeated. An effect below its detection limit may still be there; the limits are listed below."
        )
    elif d.verdict == "insufficient":
        sentence = "Nothing is named, and these readings are too few to say that nothing is missing."
    else:
        sentence = _describe_unexplained(d)
    return build_section(
        "findings",
        "What is missing",
        f"{d.tried} combinations of law, place and shape were tried.",
        render_part("note", sentence),
    )


def _describe_unexplained(d: DiagnosisResult) -> str:
    """What is there that no term explains: how much; and where, while the shares still speak of it."""
    if d.findings:
        still = "still come back in every repeat" if math.isfinite(d.mismatch_p) else "are left, noise in it"
        return (
            f"{format_error(d.repeatable_after, d.unit)} rms {still}. No further law of the catalogue "
            "predicts them on unseen readings, so no more is named; above, shares are of the whole mismatch."
        )
    ranked = sorted((s for s in d.mismatch if math.isfinite(s.share) and s.share >= MIN_SHARE), key=lambda s: -s.share)
    machine = [f"{format_place(s.axis)} ({format_percent(s.share)})" for s in ranked if s.kind == "machine"][:3]
    data = [
        f"{describe_axis(s.axis)}{f', {describe_share(s)}' if s.note else ''} ({format_percent(s.share)})"
        for s in ranked
        if s.kind == "data"
    ][:3]
    left = "come back in every repeat" if math.isfinite(d.mismatch_p) else "are left, noise in it,"
    out = f"{format_error(d.repeatable, d.unit)} rms {left} and no law of the catalogue predicts them"
    out += " on unseen readings, so none is named."
    if machine:
        out += f" In the machine a free deflection takes up most at {join_with_commas(machine, 'and')}."
    if data:
        out += f" In the data it gathers along {'; '.join(data)}."
    return out


def _build_validation(data: DiagnosisPageData) -> Body:
    p = data.diagnosis.proof
    if p is None:
        return ""
    unit = data.diagnosis.unit
    cards = [
        ("Before", *format_error_parts(p.before, unit), "error on what was locked away"),
        (
            "After",
            *format_error_parts(p.after, unit),
            "with what was found" if data.diagnosis.findings else "with what was withdrawn",
        ),
        ("Noise floor", *format_error_parts(p.noise_floor, unit), "of the same readings"),
        ("Better", f"{p.wins} of {p.of}", "", format_plural(data.group_word)),
        ("p", format_p_value(p.p_value), "", "of so many by chance"),
    ]
    names = dict(zip(data.diagnosis.errors.groups.tolist(), data.group_names, strict=True))
    locked = [names.get(g, str(g)) for g in p.groups.tolist()]
    which = (
        f"{data.group_word if len(locked) == 1 else format_plural(data.group_word)} {join_with_commas(locked, 'and')}"
    )
    body = render_part("boxes", cards, True) + render_part("lead", f"Locked away: {which}.")
    lead = (
        f"{len(p.groups)} {format_plural(data.group_word)} were locked away before anything was fitted, "
        f"searched or decided, "
        "and were predicted once, at the end."
    )
    return build_section("proof", "Proof on data that no step saw", lead, body)


def _build_limits(d: DiagnosisResult) -> Body:
    lead = (
        "The least size that this recording would have shown in nine of ten repeats. In brackets: it would have been "
        "seen, but only as one of a set. A cross: these data cannot show it; the reason is in the list."
    )
    return build_section("limits", "What would have been seen", lead, build_limits_html(d))


def _build_data_quality(data: DiagnosisPageData) -> Body:
    d = data.diagnosis
    body: Body = render_part("bullets", d.notes)
    out = np.flatnonzero(~d.used)
    if len(out):
        size = np.full(len(d.used), np.nan)
        main = [n for n, c in enumerate(data.coordinates) if c.main]
        size[out] = np.abs(d.errors.residual[out][:, main]).max(axis=1) * data.coordinates[main[0]].factor
        rows = [
            [
                str(data.row[n]),
                f"{data.file[n]} line {data.line[n]}" if data.file else str(data.line[n]),
                str(data.pose[n]),
                str(data.session[n]),
                format_error(float(size[n]), d.unit),
            ]
            for n in out
        ]
        columns = [
            TableColumn("Row", "n"),
            TableColumn("Line", "n"),
            TableColumn(data.group_word.capitalize(), "n"),
            TableColumn("Session", "n"),
            TableColumn("Largest residual", "n"),
        ]
        body += build_folded_block(
            "Readings put aside", len(rows), build_table(columns, rows), opened=len(rows) <= MAX_OPEN_ROWS
        )
    lead = f"{len(d.used)} readings, {len(out)} put aside; no fit and no error figure uses those."
    if not len(out):
        lead = f"{len(d.used)} readings, none put aside."
    return build_section("record", "The record", lead, body or render_part("paragraph", "Nothing to report."))


def _build_job(data: DiagnosisPageData, have: set[str]) -> Body:
    job = data.job
    if job is None:
        return ""
    rows = []
    for c in job.changes:
        change = 100 * (c.after / c.before - 1.0) if c.before and math.isfinite(c.before + c.after) else math.nan
        rows.append(
            [
                c.what,
                format_significant(c.before),
                format_significant(c.after),
                c.unit,
                f"{format_fixed(change, 0, signed=True)} %" if math.isfinite(change) else "–",
            ]
        )
    columns = [
        TableColumn("Quantity"),
        TableColumn("Before", "n"),
        TableColumn("After", "n"),
        TableColumn("Unit"),
        TableColumn("Change", "n"),
    ]
    body: Body = render_part("paragraph", job.sentence) if job.sentence else ""
    body += build_table(columns, rows) if rows else ""
    both = [render_part("chart", name) for name in ("d-gamma", "d-deflection") if name in have]
    body += render_part("grid", 2, both) if both else ""
    return build_section("job", "What it changes for the job", f"Toolpath {job.toolpath}.", body)


def _build_next_experiment(d: DiagnosisResult) -> Body:
    if not d.next_experiment:
        return ""
    open_ = [(f.one_of[0], *(name for name in f.one_of[1:] if name[0] != UNCATALOGUED)) for f in d.findings]
    if all(len(names) == 1 for names in open_):  # what is proposed is then a measurement for the forms without a name
        open_ = [tuple(f.one_of) for f in d.findings]
    split = [join_with_commas([format_effect_at_place(*n) for n in names], "and") for names in open_ if len(names) > 1]
    lead = f"It would tell apart: {'; '.join(split)}." if split else "What would teach most."
    return build_section("next", "The next measurement", lead, render_part("note", d.next_experiment))


def _build_run(data: DiagnosisPageData) -> Body:
    body = build_table([TableColumn("What"), TableColumn("Value", "mono")], data.facts) if data.facts else ""
    return build_section("run", "This run", "What it was made from, with what settings.", body)


def _build_chart_host(name: str, have: set[str] | Sequence[str]) -> Body:
    return render_part("chart", name) if name in have else ""
