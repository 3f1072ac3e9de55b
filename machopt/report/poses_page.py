"""The page of ``machopt plan-poses``: how well the stiffness will be known, and what to measure for it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.report.poses_data import PosesPage
from machopt.report.poses_figures import bars, curve, views
from machopt.report.scene_spec import posture_view
from machopt.report.shell import POSTURE, page_html, section
from machopt.report.tables import Column, folded, table
from machopt.report.template import fragment, joined, part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def write_poses_page(path: Path, data: PosesPage) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show.
    """
    path.write_text(poses_html(data), encoding="utf-8", newline="\n")


def poses_html(data: PosesPage) -> str:
    """The page as text; the same data give the same bytes."""
    charts = [bars(data), *([] if data.apart else [curve(data)]), *views(data)] if data.work is not None else []
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("apart", "What it tells apart", _apart(data)),
        ("accuracy", "Expected accuracy", _accuracy(data)),
        ("amount", "Amount of work", _amount(data)),
        ("job", "Loads like the job's", _job(data)),
        ("poses", "Poses", _poses(data)),
        ("work", "Order of work", _work(data)),
        ("left", "Left out", _left_out(data)),
        ("run", "This run", _run(data)),
    ]
    return page_html(
        data.title,
        (("Cell", data.cell),),
        sections,
        {"xy": charts, **_view(data)},
        scripts=("chart.js", "xy.js", *(POSTURE if _view(data) else ()), "start_xy.js"),
        footer=f"machopt {data.version}. Lengths mm, forces N, moments N·m, angles deg. Uncertainties are one "
        "standard deviation of the joint stiffness as a share of its value. Click a legend entry to hide it.",
    )


def _view(data: PosesPage) -> dict[str, object]:
    if data.scene is None or data.postures is None:
        return {}
    return {"view": posture_view("The arm at the chosen poses", data.scene, data.postures)}


def _verdict(data: PosesPage) -> Body:
    if data.work is None:
        said = f"{data.reason[:1].upper()}{data.reason[1:]}."
        items = [w for w in data.warnings if w != data.reason]
        return part("verdict", "verdict", "bad", "NOTHING TO MEASURE", said, items, [])
    seen = bool(np.isfinite(data.sigma).all())
    tone, badge = ("", "READY") if seen else ("warn", "NOT EVERYTHING IS SEEN")
    if data.apart:
        split = all(a.told for a in data.apart)
        tone, badge = ("", "READY") if split else ("warn", "NOT EVERYTHING IS TOLD APART")
    return part("verdict", "verdict", tone, badge, sentence(data), data.warnings, _cards(data))


def sentence(data: PosesPage) -> str:
    if data.apart:
        return _told(data)
    known = np.asarray(data.sigma[data.relative], float)
    seen = np.isfinite(known)
    names = np.array(data.unknowns)[data.relative]
    stepped = len(data.steps) > 1
    full = f" ({data.readings // len(data.steps)} of full loads)" if stepped else ""
    out = f"{data.poses} poses, {data.readings} readings{full}: "
    if not seen.any():
        return out + "no unknown is seen by itself."
    worst = int(np.argmax(np.where(seen, known, -1.0)))
    out += f"joint stiffness to ± {_percent(float(np.sqrt(np.mean(known[seen] ** 2))))} in the root mean square, "
    out += f"{names[worst]} worst with ± {_percent(known[worst])}"
    if not seen.all():
        out += f"; not seen: {', '.join(names[~seen])}"
    others = [h for h in data.heuristics if math.isfinite(h.readings)]
    if others:
        least = min(others, key=lambda h: h.readings)
        out += f". The best of the other ways of choosing ({least.name}) needs {least.readings:.1f} times the readings"
        out += " of full loads" if stepped else ""
    return out + "."


def _told(data: PosesPage) -> str:
    """Which pairs the plan splits, which it does not, and what would."""
    split = [a for a in data.apart if a.told]
    rest = [a for a in data.apart if not a.told]
    rounds = "round" if data.rounds == 1 else "rounds"
    out = f"{data.poses} poses, {data.rounds} {rounds}, {data.readings} readings: "
    if split:
        worst = min(split, key=lambda a: a.planned)
        out += f"{len(split)} of {len(data.apart)} pairs are told apart in nine of ten cases, {worst.pair} the hardest "
        out += f"(noncentrality {worst.planned:.0f}, {data.enough:.1f} needed"
        if worst.random > 0.0 and worst.per_cycle > worst.random:
            out += f"; random poses need {worst.per_cycle / worst.random:.1f} times the rounds"
        out += ")"
    else:
        out += "no pair is told apart"
    if rest:
        out += f". Not told apart: {rest[0].pair}"
        out += f" and {len(rest) - 1} more" if len(rest) > 1 else ""
        out += f"; {rest[0].advice} would" if rest[0].advice else "; more poses or larger loads would"
    return out + "."


def _apart(data: PosesPage) -> Body:
    if data.work is None or not data.apart:
        return ""
    columns = [
        Column("Explanations"),
        Column("Noncentrality a round", "n"),
        Column("Planned", "n"),
        Column("Rounds for 90 %", "n"),
        Column("Until diagnose excludes one", "n"),
        Column("Random poses, a round", "n"),
        Column("Otherwise", "why"),
    ]
    body: Body = ""
    for why in dict.fromkeys(a.why for a in data.apart):
        rows = [
            [
                a.pair,
                _number(a.per_cycle, 1),
                _number(a.planned, 1),
                "–" if a.cycles is None else str(a.cycles),
                "–" if a.until is None else str(a.until),
                _number(a.random, 1),
                a.advice,
            ]
            for a in data.apart
            if a.why == why
        ]
        body += part("heading", why[:1].upper() + why[1:]) + table(columns, rows)
    lead = (
        "Each explanation in turn is taken as true, as the diagnosis fitted it; the other may refit its own numbers "
        "and every joint. What it still misses, squared and in units of the noise, is the noncentrality, the worse way "
        f"round. {data.enough:.1f} finds the difference in nine of ten measurements at the 1 % level. Poses and loads "
        "make the least of them as large as they can (Atkinson & Fedorov 1975). Diagnosing these readings alone "
        "asks for more: a rival goes only where pose after pose it does worse; the old recording beside the new one "
        "helps."
    )
    return section("apart", "What it tells apart", lead, body)


def _cards(data: PosesPage) -> list[tuple[str, str, str, str]]:
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
    if data.apart:
        told = sum(a.told for a in data.apart)
        cards.append(("Told apart", f"{told} of {len(data.apart)}", "", "pairs of explanations"))
    if math.isfinite(data.target):
        value = str(data.needed * data.per_pose) if data.needed is not None else "–"
        more = f"readings ({data.needed} poses)" if data.needed is not None else "out of reach"
        cards.append((f"Every joint to {_percent(data.target)}", value, "", more))
    return cards


def _accuracy(data: PosesPage) -> Body:
    if data.work is None:
        return ""
    stepped = len(data.steps) > 1
    columns = [
        Column("Chosen by"),
        Column("How"),
        Column("Poses to draw from", "n"),
        Column("rms (%)", "n"),
        Column("10–90 % of draws (%)", "n"),
        Column("D-eff.", "n"),
        Column("A-eff.", "n"),
        Column("E-eff.", "n"),
        Column("Full loads for the same" if stepped else "Readings for the same", "n"),
    ]
    how = "tells explanations apart" if data.apart else "D-optimal"
    rows = [["this plan", how, str(data.passed), f"{100 * data.rms:.2f}", "–", "1", "1", "1", "1"]]
    for h in data.heuristics:
        rows.append(
            [
                h.name,
                h.words,
                str(h.poses),
                _number(100 * h.rms[1], 2),
                f"{_number(100 * h.rms[0], 2)} … {_number(100 * h.rms[2], 2)}",
                *(f"{e:.2f}" for e in h.efficiency),
                f"× {_number(h.readings, 1)}",
            ]
        )
    further: Body = ""
    if not data.relative.all():
        rows_further = [
            [n, _number(100 * s, 1)] for n, s, r in zip(data.unknowns, data.sigma, data.relative, strict=True) if not r
        ]
        what = "Further physics without a prior value: one sigma in percent of a joint's usual contribution"
        further = part("heading", what) + table([Column("Unknown"), Column("1 σ (%)", "n")], rows_further)
    by = "full loads" if stepped else "readings"
    lead = (
        f"One standard deviation of each joint's stiffness as these {by} will give it, beside the same number of {by} "
        "with the same loads at poses and loads chosen as the papers do (median of random draws)."
    )
    if data.apart:
        lead = f"One standard deviation of each joint's stiffness as these {by} give it by themselves."
    if stepped:
        lead += " Smaller steps of them are not counted here."
    body = part("chart", "p-bars") + table(columns, rows) + further
    return section("accuracy", "Expected accuracy", lead, body)


def _amount(data: PosesPage) -> Body:
    if data.work is None or data.apart:
        return ""
    lead = "Uncertainty falls with the square root of the work; each point is a design of its own."
    return section("amount", "Amount of work", lead, part("chart", "p-curve"))


def _poses(data: PosesPage) -> Body:
    if data.work is None:
        return ""
    lead = (
        "Step through the chosen poses; the others stand as shadows. Below, the arm as a line through its axes: grey "
        "dots are candidates, blue dots the chosen TCPs."
    )
    body = fragment("report.html", "view") if _view(data) else joined(())
    body += part("grid", 2, [part("chart", "p-top"), part("chart", "p-side")])
    return section("poses", "Poses", lead, body)


def _job(data: PosesPage) -> Body:
    if data.work is None or not data.job:
        return ""
    columns = [
        Column("Joint", "n"),
        Column("Job (N·m)", "n"),
        Column("Turned round"),
        Column("Load tests (N·m)", "n"),
        Column("Usual play shows"),
    ]
    rows = [
        [
            str(j.joint),
            "–" if j.job is None else _span(j.job),
            "–" if j.job is None else "yes" if j.job[0] < 0.0 < j.job[1] else "no",
            _span(j.tests),
            "yes" if j.shows else "no",
        ]
        for j in data.job
    ]
    lead = (
        f"Torques of weight and load together. Each load is read at {100 * data.steps[0]:.0f} % and in full: full "
        "loads alone call play or a knee a softer spring, and loads are such as turn joints both ways round."
    )
    return section("job", "Loads like the job's", lead, table(columns, rows))


def _each(data: PosesPage) -> str:
    if len(data.steps) > 1:
        return (
            "A cycle is as many rows as it has steps: read the unloaded TCP, then load step by step, and read at each."
        )
    return "In each row: read the unloaded TCP, load, read, unload, read again."


def _span(of: tuple[float, float]) -> str:
    return " … ".join(f"{v:.0f}".replace("-", "−") for v in of)


def _work(data: PosesPage) -> Body:
    t = data.work
    if t is None:
        return ""
    words = {True: "free", False: "touches: drive round", None: "–"}
    columns = [
        Column("#", "n"),
        Column("Round", "n"),
        Column("Pose", "n"),
        Column("Cycle", "n"),
        Column("q1 … q6 (deg)", "n"),
        Column("Load", "why"),
        Column("|d| (mm)", "n"),
        Column("KCI", "n"),
        Column("ν_p", "n"),
        Column("Clearance (mm)", "n"),
        Column("Straight way"),
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
            _number(1e3 * float(t.clearance[n]), 0),
            words[t.way_free[n]],
        ]
        for n in range(len(t.pose))
    ]
    lead = (
        f"poses.csv holds the same rows with the full wrench. {_each(data)} The rounds run in opposite directions and "
        "the loads are shuffled, so that drift does not look like stiffness; recording_template is the folder to fill "
        "in."
    )
    return section("work", "Order of work", lead, table(columns, rows))


def _left_out(data: PosesPage) -> Body:
    body: Body = ""
    if data.rejected_poses:
        body += part("heading", f"Poses: {data.passed} taken of {data.tried} tried")
        body += table([Column("Fails first for"), Column("Poses", "n")], [[r, str(n)] for r, n in data.rejected_poses])
    if data.rejected_loads:
        body += part("heading", f"Loads: {data.cases} admissible pairs of pose and load")
        body += table([Column("Fails first for"), Column("Pairs", "n")], [[r, str(n)] for r, n in data.rejected_loads])
    return section("left", "Left out", "What was not considered, and why.", body)


def _run(data: PosesPage) -> Body:
    body = folded("Options", len(data.options), table([Column("Option"), Column("Value", "mono")], data.options))
    body += folded("Inputs", len(data.hashes), table([Column("File"), Column("SHA-256", "mono")], data.hashes))
    return section("run", "This run", "What it was made from, with what settings.", body)


def _percent(share: float) -> str:
    """Two digits; what is ten times itself is no measure any more."""
    percent = 100.0 * share
    return "more than 1000 %" if percent > 1000.0 else f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "–"
