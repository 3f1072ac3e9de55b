"""Page of ``machopt plan-poses``: expected uncertainty of the stiffness, and the poses to measure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.report.charts.pose_plan_charts import build_arm_views, build_pose_count_chart, build_uncertainty_chart
from machopt.report.charts.scene_json import build_posture_view
from machopt.report.page_shell import POSTURE_SCRIPTS, build_page_html, build_section
from machopt.report.page_types.pose_plan_page_data import PosePlanPageData
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.template_rendering import join_markup, render_macro, render_part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def write_pose_plan_page(path: Path, data: PosePlanPageData) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show.
    """
    path.write_text(build_pose_plan_html(data), encoding="utf-8", newline="\n")


def build_pose_plan_html(data: PosePlanPageData) -> str:
    """Return the page; the same data give the same bytes.

    Args:
        data: The data of the page.
    """
    charts = (
        [
            build_uncertainty_chart(data),
            *([] if data.explanation_pairs else [build_pose_count_chart(data)]),
            *build_arm_views(data),
        ]
        if data.work is not None
        else []
    )
    sections = [
        ("verdict", "Verdict", _build_verdict(data)),
        ("apart", "Explanations it separates", _build_explanation_pairs(data)),
        ("accuracy", "Expected accuracy", _build_accuracy(data)),
        ("amount", "Amount of work", _build_amount(data)),
        ("job", "Loads like the job's", _build_job(data)),
        ("poses", "Poses", _build_poses(data)),
        ("work", "Order of work", _build_work(data)),
        ("left", "Left out", _build_left_out(data)),
        ("run", "This run", _build_run(data)),
    ]
    return build_page_html(
        data.title,
        (("Cell", data.cell),),
        sections,
        {"xy": charts, **_build_scene(data)},
        scripts=("chart.js", "xy.js", *(POSTURE_SCRIPTS if _build_scene(data) else ()), "start_xy.js"),
        footer=f"machopt {data.version}. Lengths mm, forces N, moments N·m, angles deg. Uncertainties are one "
        "standard deviation of the joint stiffness as a share of its value. Click a legend entry to hide it.",
    )


def _build_scene(data: PosePlanPageData) -> dict[str, object]:
    if data.scene is None or data.postures is None:
        return {}
    return {"view": build_posture_view("The arm at the chosen poses", data.scene, data.postures)}


def _build_verdict(data: PosePlanPageData) -> Body:
    if data.work is None:
        sentence = f"{data.reason[:1].upper()}{data.reason[1:]}."
        items = [w for w in data.warnings if w != data.reason]
        return render_part("verdict", "verdict", "bad", "NOTHING TO MEASURE", sentence, items, [])
    seen = bool(np.isfinite(data.sigma).all())
    tone, badge = ("", "READY") if seen else ("warn", "NOT EVERYTHING IS SEEN")
    if data.explanation_pairs:
        split = all(a.is_distinguished for a in data.explanation_pairs)
        tone, badge = ("", "READY") if split else ("warn", "NOT ALL DISTINGUISHED")
    return render_part(
        "verdict", "verdict", tone, badge, format_verdict_sentence(data), data.warnings, _list_key_figures(data)
    )


def format_verdict_sentence(data: PosePlanPageData) -> str:
    """Return the sentence at the top of the page.

    Args:
        data: The data of the page.
    """
    if data.explanation_pairs:
        return _describe_distinguished_pairs(data)
    known = np.asarray(data.sigma[data.relative], float)
    seen = np.isfinite(known)
    names = np.array(data.unknowns)[data.relative]
    stepped = len(data.steps) > 1
    full = f" ({data.readings // len(data.steps)} of full loads)" if stepped else ""
    out = f"{data.poses} poses, {data.readings} readings{full}: "
    if not seen.any():
        return out + "no unknown is seen by itself."
    worst = int(np.argmax(np.where(seen, known, -1.0)))
    out += (
        f"joint stiffness to ± {_format_percent(float(np.sqrt(np.mean(known[seen] ** 2))))} in the root mean square, "
    )
    out += f"{names[worst]} worst with ± {_format_percent(known[worst])}"
    if not seen.all():
        out += f"; not seen: {', '.join(names[~seen])}"
    others = [h for h in data.heuristics if math.isfinite(h.readings)]
    if others:
        least = min(others, key=lambda h: h.readings)
        out += f". The best of the other ways of choosing ({least.name}) needs {least.readings:.1f} times the readings"
        out += " of full loads" if stepped else ""
    return out + "."


def _describe_distinguished_pairs(data: PosePlanPageData) -> str:
    """Which pairs the plan splits, which it does not, and what would."""
    split = [a for a in data.explanation_pairs if a.is_distinguished]
    rest = [a for a in data.explanation_pairs if not a.is_distinguished]
    rounds = "round" if data.rounds == 1 else "rounds"
    out = f"{data.poses} poses, {data.rounds} {rounds}, {data.readings} readings: "
    if split:
        worst = min(split, key=lambda a: a.planned)
        out += (
            f"{len(split)} of {len(data.explanation_pairs)} pairs are separated in nine of ten cases, "
            f"{worst.pair} the hardest "
        )
        out += f"(noncentrality {worst.planned:.0f}, {data.required_noncentrality:.1f} needed"
        if worst.random > 0.0 and worst.per_cycle > worst.random:
            out += f"; random poses need {worst.per_cycle / worst.random:.1f} times the rounds"
        out += ")"
    else:
        out += "no pair is separated"
    if rest:
        out += f". Not separated: {rest[0].pair}"
        out += f" and {len(rest) - 1} more" if len(rest) > 1 else ""
        out += f"; {rest[0].advice} would" if rest[0].advice else "; more poses or larger loads would"
    return out + "."


def _build_explanation_pairs(data: PosePlanPageData) -> Body:
    if data.work is None or not data.explanation_pairs:
        return ""
    columns = [
        TableColumn("Explanations"),
        TableColumn("Noncentrality a round", "n"),
        TableColumn("Planned", "n"),
        TableColumn("Rounds for 90 %", "n"),
        TableColumn("Until diagnose excludes one", "n"),
        TableColumn("Random poses, a round", "n"),
        TableColumn("Otherwise", "why"),
    ]
    body: Body = ""
    for why in dict.fromkeys(a.why for a in data.explanation_pairs):
        rows = [
            [
                a.pair,
                _format_number(a.per_cycle, 1),
                _format_number(a.planned, 1),
                "–" if a.cycles is None else str(a.cycles),
                "–" if a.cycles_until_excluded is None else str(a.cycles_until_excluded),
                _format_number(a.random, 1),
                a.advice,
            ]
            for a in data.explanation_pairs
            if a.why == why
        ]
        body += render_part("heading", why[:1].upper() + why[1:]) + build_table(columns, rows)
    lead = (
        "Each explanation in turn is taken as true, as the diagnosis fitted it; the other may refit its own numbers "
        "and every joint. What it still misses, squared and in units of the noise, is the noncentrality, the worse way "
        f"round. {data.required_noncentrality:.1f} finds the difference in nine of ten measurements at the 1 % "
        f"level. Poses and loads "
        "make the least of them as large as they can (Atkinson & Fedorov 1975). Diagnosing these readings alone "
        "needs more: a rival is excluded only if it is worse in pose after pose; the old recording together with the "
        "new one helps."
    )
    return build_section("apart", "Explanations it separates", lead, body)


def _list_key_figures(data: PosePlanPageData) -> list[tuple[str, str, str, str]]:
    cards = [
        ("Poses", str(data.poses), "", f"of {data.passed} candidates"),
        ("Readings", str(data.readings), "", f"{data.per_pose} at each pose"),
        (
            "Condition number",
            f"{data.condition:.1f}" if math.isfinite(data.condition) else "–",
            "",
            "of the whitened design",
        ),
    ]
    if math.isfinite(data.bound):
        cards.append(("D-efficiency", f"≥ {100 * data.bound:.0f}", "%", "against any choice of as many"))
    if data.explanation_pairs:
        distinguished = sum(a.is_distinguished for a in data.explanation_pairs)
        cards.append(
            ("Distinguished", f"{distinguished} of {len(data.explanation_pairs)}", "", "pairs of explanations")
        )
    if math.isfinite(data.target):
        value = str(data.needed * data.per_pose) if data.needed is not None else "–"
        more = f"readings ({data.needed} poses)" if data.needed is not None else "out of reach"
        cards.append((f"Every joint to {_format_percent(data.target)}", value, "", more))
    return cards


def _build_accuracy(data: PosePlanPageData) -> Body:
    if data.work is None:
        return ""
    stepped = len(data.steps) > 1
    columns = [
        TableColumn("Chosen by"),
        TableColumn("How"),
        TableColumn("Poses to draw from", "n"),
        TableColumn("rms (%)", "n"),
        TableColumn("10–90 % of draws (%)", "n"),
        TableColumn("D-eff.", "n"),
        TableColumn("A-eff.", "n"),
        TableColumn("E-eff.", "n"),
        TableColumn("Full loads for the same" if stepped else "Readings for the same", "n"),
    ]
    how = "separates explanations" if data.explanation_pairs else "D-optimal"
    rows = [["this plan", how, str(data.passed), f"{100 * data.rms:.2f}", "–", "1", "1", "1", "1"]]
    for h in data.heuristics:
        rows.append(
            [
                h.name,
                h.words,
                str(h.poses),
                _format_number(100 * h.rms[1], 2),
                f"{_format_number(100 * h.rms[0], 2)} … {_format_number(100 * h.rms[2], 2)}",
                *(f"{e:.2f}" for e in h.efficiency),
                f"× {_format_number(h.readings, 1)}",
            ]
        )
    further: Body = ""
    if not data.relative.all():
        rows_further = [
            [n, _format_number(100 * s, 1)]
            for n, s, r in zip(data.unknowns, data.sigma, data.relative, strict=True)
            if not r
        ]
        what = "Further physics without a prior value: one sigma in percent of a joint's usual contribution"
        further = render_part("heading", what) + build_table(
            [TableColumn("Unknown"), TableColumn("1 σ (%)", "n")], rows_further
        )
    by = "full loads" if stepped else "readings"
    lead = (
        f"One standard deviation of each joint's stiffness as these {by} will give it, beside the same number of {by} "
        "with the same loads at poses and loads chosen as the papers do (median of random draws)."
    )
    if data.explanation_pairs:
        lead = f"One standard deviation of each joint's stiffness as these {by} give it by themselves."
    if stepped:
        lead += " Smaller steps of them are not counted here."
    body = render_part("chart", "p-bars") + build_table(columns, rows) + further
    return build_section("accuracy", "Expected accuracy", lead, body)


def _build_amount(data: PosePlanPageData) -> Body:
    if data.work is None or data.explanation_pairs:
        return ""
    lead = "Uncertainty falls with the square root of the work; each point is a design of its own."
    return build_section("amount", "Amount of work", lead, render_part("chart", "p-curve"))


def _build_poses(data: PosePlanPageData) -> Body:
    if data.work is None:
        return ""
    lead = (
        "Step through the chosen poses; the others are drawn as shadows. Below, the arm as a line through its axes: "
        "grey "
        "dots are candidates, blue dots the chosen TCPs."
    )
    body = render_macro("report.html", "view") if _build_scene(data) else join_markup(())
    body += render_part("grid", 2, [render_part("chart", "p-top"), render_part("chart", "p-side")])
    return build_section("poses", "Poses", lead, body)


def _build_job(data: PosePlanPageData) -> Body:
    if data.work is None or not data.job:
        return ""
    columns = [
        TableColumn("Joint", "n"),
        TableColumn("Job (N·m)", "n"),
        TableColumn("Turned round"),
        TableColumn("Load tests (N·m)", "n"),
        TableColumn("Usual play shows"),
    ]
    rows = [
        [
            str(j.joint),
            "–" if j.job is None else _format_span(j.job),
            "–" if j.job is None else "yes" if j.job[0] < 0.0 < j.job[1] else "no",
            _format_span(j.tests),
            "yes" if j.shows_play else "no",
        ]
        for j in data.job
    ]
    lead = (
        f"Torques of weight and load together. Each load is read at {100 * data.steps[0]:.0f} % and in full: full "
        "loads alone call play or a knee a softer spring, and loads are such as turn joints both ways round."
    )
    return build_section("job", "Loads like the job's", lead, build_table(columns, rows))


def _describe_readings_per_pose(data: PosePlanPageData) -> str:
    if len(data.steps) > 1:
        return (
            "A cycle is as many rows as it has steps: read the unloaded TCP, then load step by step, and read at each."
        )
    return "In each row: read the unloaded TCP, load, read, unload, read again."


def _format_span(of: tuple[float, float]) -> str:
    return " … ".join(f"{v:.0f}".replace("-", "−") for v in of)


def _build_work(data: PosePlanPageData) -> Body:
    t = data.work
    if t is None:
        return ""
    words = {True: "free", False: "touches: drive round", None: "–"}
    columns = [
        TableColumn("#", "n"),
        TableColumn("Round", "n"),
        TableColumn("Pose", "n"),
        TableColumn("Cycle", "n"),
        TableColumn("q1 … q6 (deg)", "n"),
        TableColumn("Load", "why"),
        TableColumn("|d| (mm)", "n"),
        TableColumn("KCI", "n"),
        TableColumn("ν_p", "n"),
        TableColumn("Clearance (mm)", "n"),
        TableColumn("Straight way"),
    ]
    rows = [
        [
            str(n + 1),
            str(t.session[n]),
            str(t.pose[n]),
            str(t.cycle[n]),
            "  ".join(f"{v:.1f}".replace("-", "−") for v in np.degrees(t.q[n])),
            t.load[n],
            f"{1e3 * t.deflection[n]:.2f}",
            f"{t.kci[n]:.2f}",
            f"{t.nu_p[n]:.4f}",
            _format_number(1e3 * float(t.clearance[n]), 0),
            words[t.way_free[n]],
        ]
        for n in range(len(t.pose))
    ]
    lead = (
        f"poses.csv holds the same rows with the full wrench. {_describe_readings_per_pose(data)} The rounds "
        f"run in opposite directions and "
        "the loads are shuffled, so that drift does not look like stiffness; recording_template is the folder to fill "
        "in."
    )
    return build_section("work", "Order of work", lead, build_table(columns, rows))


def _build_left_out(data: PosePlanPageData) -> Body:
    body: Body = ""
    if data.rejected_poses:
        body += render_part("heading", f"Poses: {data.passed} taken of {data.tried} tried")
        body += build_table(
            [TableColumn("Fails first for"), TableColumn("Poses", "n")], [[r, str(n)] for r, n in data.rejected_poses]
        )
    if data.rejected_loads:
        body += render_part("heading", f"Loads: {data.cases} admissible pairs of pose and load")
        body += build_table(
            [TableColumn("Fails first for"), TableColumn("Pairs", "n")], [[r, str(n)] for r, n in data.rejected_loads]
        )
    return build_section("left", "Left out", "What was not considered, and why.", body)


def _build_run(data: PosePlanPageData) -> Body:
    body = build_folded_block(
        "Options", len(data.options), build_table([TableColumn("Option"), TableColumn("Value", "mono")], data.options)
    )
    body += build_folded_block(
        "Inputs", len(data.hashes), build_table([TableColumn("File"), TableColumn("SHA-256", "mono")], data.hashes)
    )
    return build_section("run", "This run", "What it was made from, with what settings.", body)


def _format_percent(share: float) -> str:
    """Two digits; what is ten times itself is no measure any more."""
    percent = 100.0 * share
    return "more than 1000 %" if percent > 1000.0 else f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


def _format_number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "–"
