"""The page of ``machopt diagnose``: how much differs, where it lives, what is missing, how sure, what next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.diagnose.nouns.result import Diagnosis
from machopt.diagnose.verdict.words import closes
from machopt.effects.words import listed, named, place
from machopt.report.diagnosis import DiagnosisPage
from machopt.report.diagnosis_figures import Spec, job_charts, law, over_axis, per_group
from machopt.report.diagnosis_finding import finding_html
from machopt.report.diagnosis_limits import limits_html
from machopt.report.diagnosis_model import OPEN, model_html
from machopt.report.diagnosis_space import residual_view, space_html
from machopt.report.diagnosis_svg import LEAST, machine_column, machine_strip, share_bars
from machopt.report.diagnosis_verdict import of_record, verdict_html
from machopt.report.diagnosis_words import (
    axis_words,
    chance,
    digits,
    of_machine,
    parted,
    percent,
    plural,
    share_note,
    sized,
)
from machopt.report.display import fixed
from machopt.report.shell import POSTURE, page_html, section
from machopt.report.tables import Column, folded, table
from machopt.report.template import fragment, part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

MOST_AXES = 2  # of the data, drawn


def write_diagnosis(path: Path, data: DiagnosisPage) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show; parts that are missing leave no gap.
    """
    path.write_text(diagnosis_html(data), encoding="utf-8", newline="\n")


def diagnosis_html(data: DiagnosisPage) -> str:
    """The page as text; the same data give the same bytes."""
    charts, view = _charts(data), residual_view(data)
    have = {c["id"] for c in charts}
    sections = [
        ("verdict", "Verdict", verdict_html(data)),
        ("where", "Where", _where(data)),
        ("errors", "Before and after", _errors(data, have)),
        ("space", "At the arm", space_html(view)),
        ("findings", "What is missing", _findings(data, have)),
        ("proof", "Proof", _proof(data)),
        ("limits", "Detection limits", _limits(data.diagnosis)),
        ("record", "Record", _record(data)),
        ("model", "Model", model_html(data.diagnosis)),
        ("job", "The job", _job(data, have)),
        ("next", "Next", _next(data.diagnosis)),
        ("run", "This run", _run(data)),
    ]
    d = data.diagnosis
    head = (("Cell", data.cell), ("Recording", data.recording), ("Predicted", d.predicted))
    return page_html(
        data.title,
        head,
        sections,
        {"xy": charts} if view is None else {"xy": charts, "view": view},
        scripts=("chart.js", "xy.js", *(() if view is None else POSTURE), "start_xy.js"),
        footer=f"machopt {data.version}. Errors are rms per coordinate of readings that no fit saw, outliers "
        "apart. Intervals in brackets are 90 %. Click a legend entry to hide it.",
    )


def _where(data: DiagnosisPage) -> Body:
    d = data.diagnosis
    machine = [s for s in d.mismatch if s.kind == "machine" and math.isfinite(s.share)]
    places = [s for s in d.mismatch if s.kind == "data"]
    if not machine and not places and not d.findings:
        return ""
    body: Body = machine_strip(d) + machine_column(d)
    if d.findings:
        body += part(
            "lead",
            "Orange bars and full marks: where a finding sits. Dashed marks: where these data would "
            "place it just as well.",
        )
    notes = [
        [place(s.axis), percent(s.share), s.note]
        for s in sorted(machine, key=lambda s: -s.share)
        if s.share >= LEAST and s.note
    ]
    if notes:
        columns = [Column("Part of the machine"), Column("Share", "n"), Column("Shows")]
        body += folded("Parts of the machine", len(notes), table(columns, notes))
    if places:
        body += part("heading", "In the data")
        body += part("lead", "How much of it sits in which part of the readings.")
        body += share_bars(places)
    by_chance = f" (p {chance(d.mismatch_p)} that noise alone does this)" if math.isfinite(d.mismatch_p) else ""
    known = math.isfinite(d.mismatch_p)
    unrepeated = (
        ", what unseen readings miss by less what is allowed for noise; no reading was repeated, so part of it may be "
        f"noise. The noise floor, {sized(d.noise_floor, d.unit)}, is what the fit leaves in the readings it has seen"
    )
    lead = (
        f"{'Repeatable mismatch' if known else 'Mismatch'} of the refitted model: {sized(d.repeatable, d.unit)} rms"
        f"{by_chance if known else unrepeated}. A bar says how "
        "much of it that part could take up, driven by its own load. Parts compete for the same mismatch, so bars need "
        "not add up to 100 %."
    )
    return section("where", "Where the mismatch lives", lead, body)


def _axes(d: Diagnosis) -> list[str]:
    """Axes to draw: what carries the mismatch, and the load."""
    ranked = [s.axis for s in sorted(d.mismatch, key=lambda s: -s.share) if s.kind == "data" and s.axis in d.axes]
    return (
        list(dict.fromkeys([*ranked[: MOST_AXES - 1], *(name for name in d.axes if "load" in name), *ranked]))
        or list(d.axes)[:1]
    )


def _charts(data: DiagnosisPage) -> list[Spec]:
    d = data.diagnosis
    charts = [c for c in [per_group(data)] if c is not None]
    drawn = 0
    for name in _axes(d):
        chart = over_axis(data, name, f"d-axis{drawn}") if drawn < MOST_AXES else None
        if chart is not None:
            charts.append(chart)
            drawn += 1
    laws = (law(data, n, f) for n, f in enumerate(d.findings, 1))
    charts += [c for c in laws if c is not None]
    return charts + (job_charts(data.job) if data.job is not None else [])


def _errors(data: DiagnosisPage, have: set[str]) -> Body:
    body = _host("d-groups", have)
    axes = [part("chart", f"d-axis{n}") for n in range(MOST_AXES) if f"d-axis{n}" in have]
    body += part("grid", 2, axes) if axes else ""
    lead = (
        f"Each {data.group_word} is predicted by fits that never saw it. Residuals at the noise floor cannot get "
        "smaller."
    )
    d = data.diagnosis
    if of_machine(d) and of_record(d):
        lead += " What was found of the record itself is put right in both."
    elif of_record(d):
        lead += " The record is put right in all that is drawn here"
        lead += f"; as stated, it is off by {sized(d.heldout_before, d.unit)}." if closes(d) else "."
    return section("errors", "Before and after", lead, body)


def _findings(data: DiagnosisPage, have: set[str]) -> Body:
    d = data.diagnosis
    if d.findings:
        body = fragment(
            "diagnosis.html", "ruled", [finding_html(n, f, d.unit, have) for n, f in enumerate(d.findings, 1)]
        )
        lead = f"{d.tried} combinations of law, place and shape were tried; base and candidates were refitted together."
        if d.verdict == "partly_explained":
            body += part("note", _open(d))
        return section("findings", "What is missing", lead, body)
    if d.verdict == "consistent":
        said = (
            "Nothing is missing that these data could show: what is left does not come back when a reading is "
            "repeated. An effect below its detection limit may still be there; the limits are listed below."
        )
    elif d.verdict == "insufficient":
        said = "Nothing is named, and these readings are too few to say that nothing is missing."
    else:
        said = _open(d)
    return section(
        "findings", "What is missing", f"{d.tried} combinations of law, place and shape were tried.", part("note", said)
    )


def _open(d: Diagnosis) -> str:
    """What is there that no term explains: how much; and where, while the shares still speak of it."""
    if d.findings:
        still = "still come back in every repeat" if math.isfinite(d.mismatch_p) else "are left, noise in it"
        return (
            f"{sized(d.repeatable_after, d.unit)} rms {still}. No further law of the catalogue "
            "predicts them on unseen readings, so no more is named; above, shares are of the whole mismatch."
        )
    ranked = sorted((s for s in d.mismatch if math.isfinite(s.share) and s.share >= LEAST), key=lambda s: -s.share)
    machine = [f"{place(s.axis)} ({percent(s.share)})" for s in ranked if s.kind == "machine"][:3]
    data = [
        f"{axis_words(s.axis)}{f', {share_note(s)}' if s.note else ''} ({percent(s.share)})"
        for s in ranked
        if s.kind == "data"
    ][:3]
    left = "come back in every repeat" if math.isfinite(d.mismatch_p) else "are left, noise in it,"
    out = f"{sized(d.repeatable, d.unit)} rms {left} and no law of the catalogue predicts them"
    out += " on unseen readings, so none is named."
    if machine:
        out += f" In the machine a free deflection takes up most at {listed(machine, 'and')}."
    if data:
        out += f" In the data it gathers along {'; '.join(data)}."
    return out


def _proof(data: DiagnosisPage) -> Body:
    p = data.diagnosis.proof
    if p is None:
        return ""
    unit = data.diagnosis.unit
    cards = [
        ("Before", *parted(p.before, unit), "error on what was locked away"),
        (
            "After",
            *parted(p.after, unit),
            "with what was found" if data.diagnosis.findings else "with what was withdrawn",
        ),
        ("Noise floor", *parted(p.noise_floor, unit), "of the same readings"),
        ("Better", f"{p.wins} of {p.of}", "", plural(data.group_word)),
        ("p", chance(p.p_value), "", "of so many by chance"),
    ]
    names = dict(zip(data.diagnosis.errors.groups.tolist(), data.group_names, strict=True))
    locked = [names.get(g, str(g)) for g in p.groups.tolist()]
    which = f"{data.group_word if len(locked) == 1 else plural(data.group_word)} {listed(locked, 'and')}"
    body = part("boxes", cards, True) + part("lead", f"Locked away: {which}.")
    lead = (
        f"{len(p.groups)} {plural(data.group_word)} were locked away before anything was fitted, searched or decided, "
        "and were predicted once, at the end."
    )
    return section("proof", "Proof on data that no step saw", lead, body)


def _limits(d: Diagnosis) -> Body:
    lead = (
        "The least size that this recording would have shown in nine of ten repeats. In brackets: it would have been "
        "seen, but only as one of a set. A cross: these data cannot show it; the reason is in the list."
    )
    return section("limits", "What would have been seen", lead, limits_html(d))


def _record(data: DiagnosisPage) -> Body:
    d = data.diagnosis
    body: Body = part("bullets", d.notes)
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
                sized(float(size[n]), d.unit),
            ]
            for n in out
        ]
        columns = [
            Column("Row", "n"),
            Column("Line", "n"),
            Column(data.group_word.capitalize(), "n"),
            Column("Session", "n"),
            Column("Largest residual", "n"),
        ]
        body += folded("Readings put aside", len(rows), table(columns, rows), opened=len(rows) <= OPEN)
    lead = f"{len(d.used)} readings, {len(out)} put aside; no fit and no error figure uses those."
    if not len(out):
        lead = f"{len(d.used)} readings, none put aside."
    return section("record", "The record", lead, body or part("paragraph", "Nothing to report."))


def _job(data: DiagnosisPage, have: set[str]) -> Body:
    job = data.job
    if job is None:
        return ""
    rows = []
    for c in job.changes:
        change = 100 * (c.after / c.before - 1.0) if c.before and math.isfinite(c.before + c.after) else math.nan
        rows.append(
            [
                c.what,
                digits(c.before),
                digits(c.after),
                c.unit,
                f"{fixed(change, 0, signed=True)} %" if math.isfinite(change) else "–",
            ]
        )
    columns = [Column("Quantity"), Column("Before", "n"), Column("After", "n"), Column("Unit"), Column("Change", "n")]
    body: Body = part("paragraph", job.sentence) if job.sentence else ""
    body += table(columns, rows) if rows else ""
    both = [part("chart", name) for name in ("d-gamma", "d-deflection") if name in have]
    body += part("grid", 2, both) if both else ""
    return section("job", "What it changes for the job", f"Toolpath {job.toolpath}.", body)


def _next(d: Diagnosis) -> Body:
    if not d.next_experiment:
        return ""
    split = [listed([named(*name) for name in f.one_of], "and") for f in d.findings if len(f.one_of) > 1]
    lead = f"It would tell apart: {'; '.join(split)}." if split else "What would teach most."
    return section("next", "The next measurement", lead, part("note", d.next_experiment))


def _run(data: DiagnosisPage) -> Body:
    body = table([Column("What"), Column("Value", "mono")], data.facts) if data.facts else ""
    return section("run", "This run", "What it was made from, with what settings.", body)


def _host(name: str, have: set[str] | Sequence[str]) -> Body:
    return part("chart", name) if name in have else ""
