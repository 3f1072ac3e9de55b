"""``summary.html`` of a batch: gains, jobs that need attention, and every job with a link to its report."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.display_units import format_fixed
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.svg.toolpath_thumbnail import PathPicture, build_thumbnail
from machopt.report.template_rendering import render_macro, render_part
from machopt.report.wording.result_verdict import format_count

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

TableRow = Mapping[str, Any]

_BAR = 110  # px of the widest bar of gain


@dataclass(frozen=True, kw_only=True)
class BatchPageData:
    """Data of the page in the units of summary.csv (mm, N/mm, s, per cent); jobs in ranked order."""

    version: str
    complete: bool  # False: stopped by the user
    jobs: tuple[TableRow, ...]
    ignored_files: tuple[str, ...] = ()  # files that were taken for no toolpath
    others: tuple[str, ...] = ()  # folders of earlier jobs that are not in this batch
    compared_with: str = ""
    differences: tuple[TableRow, ...] = ()
    only_here: tuple[str, ...] = ()
    only_there: tuple[str, ...] = ()
    pictures: Mapping[str, PathPicture] = field(default_factory=dict)  # job → its toolpath


def build_batch_html(data: BatchPageData) -> str:
    """Return the page; the same data give the same bytes. Wall times come from ``timings.js`` in the same folder.

    Args:
        data: The data of the page.
    """
    sections = [
        ("verdict", "Verdict", _build_verdict(data)),
        ("attention", "Needs attention", _build_attention(data)),
        ("jobs", "Ranking", _build_ranking(data)),
        ("compare", "Compared", _build_comparison(data)),
        ("warnings", "Warnings", _build_warnings(data)),
        ("rest", "Not in it", _build_remaining(data)),
    ]
    done = sum(job["state"] == "done" for job in data.jobs)
    return build_page_html(
        f"Batch of {format_count(len(data.jobs), 'job')}",
        (("Done", f"{done} of {len(data.jobs)}"),),
        sections,
        {},
        scripts=("start_batch.js",),
        footer=render_macro("batch.html", "footer", data.version),
    )


def _build_verdict(data: BatchPageData) -> Body:
    states = Counter(job["state"] for job in data.jobs)
    done, total = states["done"], len(data.jobs)
    if not data.complete:
        badge, tone = "STOPPED", "warn"
    elif states["verification failed"]:
        badge, tone = "VERIFICATION FAILED: DO NOT RUN THOSE", "bad"
    elif done == total:
        badge, tone = "ALL DONE", ""
    else:
        badge, tone = "SOME HAVE NO ANSWER", "warn" if done else "bad"
    rest = ", ".join(f"{n} {_STATES[state]}" for state, n in sorted(states.items()) if state != "done")
    sentence = f"{done} of {format_count(total, 'job')} done and verified{f'; {rest}' if rest else ''}."
    gains = [job["gain_percent"] for job in data.jobs if job.get("gain_percent") is not None]
    items = []
    if states["waiting"]:
        items.append("The same command goes on with the jobs that were not run.")
    unsure = sum(job.get("distinguishable") is False for job in data.jobs)
    if unsure:
        items.append(f"{format_count(unsure, 'job')} with a gain below the stiffness model's own uncertainty.")
    boxes = [("jobs", str(total), "", f"{done} done")]
    if gains:
        known = [job for job in data.jobs if job.get("gain_percent") is not None]
        best, least = (pick(known, key=lambda j: j["gain_percent"]) for pick in (max, min))
        boxes += [
            ("median gain", _format_percent(statistics.median(gains)), "%", f"of {format_count(len(gains), 'job')}"),
            ("largest gain", _format_percent(best["gain_percent"]), "%", _format_job_name(best)),
            ("least gain", _format_percent(least["gain_percent"]), "%", _format_job_name(least)),
        ]
    cycles = [job["cycle_time_s"] for job in data.jobs if job.get("cycle_time_s") is not None]
    if cycles:
        boxes.append(("cycle time of all", f"{sum(cycles) / 60:.1f}", "min", f"longest {max(cycles):.0f} s"))
    jobs_with_feed = [job for job in data.jobs if job.get("feed_held_percent") is not None]
    if jobs_with_feed:
        worst = min(jobs_with_feed, key=lambda j: j["feed_held_percent"])
        boxes.append(("feed reached, smallest", f"{worst['feed_held_percent']:.1f}", "%", _format_job_name(worst)))
    return render_part("verdict", "verdict", tone, badge, sentence, items, boxes)


_STATES = {
    "verification failed": "failed verification",
    "infeasible": "infeasible",
    "refused": "refused",
    "over time": "over the time limit",
    "over memory": "over the memory limit",
    "crashed": "crashed",
    "waiting": "not run",
}


def _build_attention(data: BatchPageData) -> Body:
    rows = [
        (_build_link(job, job["folder"]), job["cell"], job["variant"], _format_state(job), job.get("reason", ""))
        for job in data.jobs
        if job["state"] not in ("done", "waiting")
    ]
    columns = [
        TableColumn("Toolpath", "html"),
        TableColumn("Cell"),
        TableColumn("Variant"),
        TableColumn("Verdict", "html"),
        TableColumn("Why", "why"),
    ]
    lead = "Jobs without an answer, or with one that must not be run. The others are not touched by them."
    return build_section(
        "attention", "Needs attention", lead, _build_table(columns, rows, keep=("Toolpath", "Verdict", "Why"))
    )


def _format_passes(job: Mapping[str, Any]) -> str:
    """Return the number of holes and points in tolerance, "–" where nothing has one."""
    total = job.get("with_tolerance")
    return "–" if not total else f"{job.get('in_tolerance')} of {total}"


def _build_ranking(data: BatchPageData) -> Body:
    gains = [abs(job["gain_percent"]) for job in data.jobs if job.get("gain_percent") is not None]
    widest = max(gains, default=1.0) or 1.0
    columns = [
        TableColumn("Rank", "n"),
        TableColumn("Path", "html"),
        TableColumn("Toolpath", "html"),
        TableColumn("Variant"),
        TableColumn("Verdict", "html"),
        TableColumn("Gain over the CAM default (%)", "html"),
        TableColumn("Gain over jiao2022 (%)", "n"),
        TableColumn("Mean", "n"),
        TableColumn("Worst", "n"),
        TableColumn("Unit"),
        TableColumn("Worst point", "n"),
        TableColumn("Cycle (s)", "n"),
        TableColumn("In tolerance", "n"),
        *(TableColumn(title, "n") for title in ("Marginal", "Fail", "Unknown", "Worst error (mm)")),
        TableColumn("Feed reached (%)", "n"),
        TableColumn("Warnings", "n"),
        TableColumn("Wall (s)", "html"),
    ]
    rows = [
        (
            rank,
            _build_picture(data, job),
            render_macro("batch.html", "placed", _build_link(job, job["report"] or job["folder"]), job["cell"]),
            job["variant"],
            _format_state(job),
            _format_gain(job, widest),
            _format_signed(job.get("gain_over_jiao2022_percent")),
            _format_number(job.get("mean")),
            _format_number(job.get("worst")),
            job.get("unit", ""),
            _format_text(job.get("worst_point")),
            _format_number(job.get("cycle_time_s"), 1),
            _format_passes(job),
            *(_format_text(job.get(word)) for word in ("marginal", "fail", "unknown")),
            _format_number(job.get("worst_error_mm"), 3),
            _format_number(job.get("feed_held_percent"), 1),
            len(job.get("warnings", ())),
            render_macro("batch.html", "wall", job["job"]),
        )
        for rank, job in enumerate(data.jobs, 1)
        if job["state"] in ("done", "verification failed")
    ]
    lead = (
        "By the gain over the CAM's default rotation, the largest first; then jobs where that rotation is not "
        "feasible, by name; then jobs that failed their verification. Mean and worst are of deflection (mm) or of "
        "stiffness along the tool (N/mm); "
        "summary.csv has those of the CAM default beside them. Paths are coloured by predicted deflection (stiffness "
        "where no force is given), each by itself: bright is good. A click opens the robot on that path."
    )
    body = render_macro("batch.html", "unrolled") + _build_table(columns, rows) if rows else ""
    return build_section("jobs", "Ranking", lead, body)


def _build_comparison(data: BatchPageData) -> Body:
    if not data.compared_with:
        return ""
    columns = [
        TableColumn("Toolpath", "html"),
        TableColumn("Variant"),
        TableColumn("Verdict"),
        TableColumn("Rotation differs, mean (deg)", "n"),
        TableColumn("worst (deg)", "n"),
        TableColumn("at point", "n"),
        TableColumn("of the points (%)", "n"),
        TableColumn("Branch changes", "n"),
        TableColumn("Mean before", "n"),
        TableColumn("now", "n"),
        TableColumn("Worst before", "n"),
        TableColumn("now", "n"),
        TableColumn("Unit"),
        TableColumn("Cycle before (s)", "n"),
        TableColumn("now (s)", "n"),
        TableColumn("Note"),
    ]
    report = {job["job"]: job["report"] or job["folder"] for job in data.jobs}
    rows = [
        (
            _build_link(row, report.get(row["job"], "")),
            row["variant"],
            _format_change(row),
            _format_number(row["rotation_mean_deg"], 1),
            _format_number(row["rotation_worst_deg"], 1),
            _format_text(row["worst_at_point"]),
            "–" if row["turned_share"] is None else f"{100 * row['turned_share']:.0f}",
            _format_text(row["branch_changes"]),
            *(_format_number(row[k]) for k in ("mean_before", "mean", "worst_before", "worst")),
            row["unit"] or "",
            _format_number(row["cycle_time_before_s"], 1),
            _format_number(row["cycle_time_s"], 1),
            row["note"],
        )
        for row in data.differences
    ]
    verdicts = sum(row["verdict"] != row["verdict_before"] for row in data.differences)
    turned = sum(bool(row["turned_share"]) for row in data.differences)
    lead = (
        f"Against {data.compared_with}: of {format_count(len(rows), 'job')} in both, "
        f"{format_count(verdicts, 'verdict')} changed and {turned} chose another rotation (more than 1° somewhere). "
        "Before and now are each predicted with their own model."
    )
    body: Body = _build_table(columns, rows, keep=("Toolpath", "Verdict"))
    for title, names in (("Only here", data.only_here), (f"Only in {data.compared_with}", data.only_there)):
        body += build_folded_block(title, len(names), render_part("bullets", names)) if names else ""
    return build_section("compare", "Compared", lead, body)


def _format_change(row: TableRow) -> str:
    before, now = row["verdict_before"], row["verdict"]
    return str(now) if before == now else f"{before} → {now}"


def _build_warnings(data: BatchPageData) -> Body:
    texts = Counter(w for job in data.jobs for w in job.get("warnings", ()))
    if not texts:
        return ""
    rows = sorted(((n, w) for w, n in texts.items()), key=lambda row: (-row[0], row[1]))
    body = build_table([TableColumn("Jobs", "n"), TableColumn("Warning", "why")], rows)
    return build_section("warnings", "Warnings", "Equal ones counted together; each job's report has its own.", body)


def _build_remaining(data: BatchPageData) -> Body:
    body: Body = ""
    waiting = [_format_job_name(job) for job in data.jobs if job["state"] == "waiting"]
    if waiting:
        body += build_folded_block("Not run yet", len(waiting), render_part("bullets", waiting), opened=True)
    if data.ignored_files:
        body += build_folded_block(
            "Files left out by their names", len(data.ignored_files), render_part("bullets", data.ignored_files)
        )
    if data.others:
        body += build_folded_block(
            "Folders of earlier jobs that this batch does not name",
            len(data.others),
            render_part("bullets", data.others),
        )
    return build_section(
        "rest", "Not in it", "What is not done yet, and what lies there and is not part of this batch.", body
    )


def _build_table(columns: Sequence[TableColumn], rows: Sequence[Sequence[object]], keep: Sequence[str] = ()) -> Body:
    """The table without columns that are empty for all jobs."""
    if not rows:
        return ""
    used = [n for n, c in enumerate(columns) if c.title in keep or any(row[n] not in ("", "–") for row in rows)]
    return build_table([columns[n] for n in used], [[row[n] for n in used] for row in rows])


def _format_job_name(job: TableRow) -> str:
    return f"{job['toolpath']}, {job['variant']}" if job["variant"] else str(job["toolpath"])


def _build_link(job: TableRow, target: str) -> Body:
    text = str(job["toolpath"])
    return render_macro("batch.html", "link", text, quote(target)) if target else text


def _build_picture(data: BatchPageData, job: TableRow) -> Body:
    path = data.pictures.get(job["job"])
    if path is None:
        return "–"
    return render_macro("batch.html", "link", build_thumbnail(path), f"{quote(job['report'])}#scene")


def _format_state(job: TableRow) -> Markup:
    tone = {"done": "pass", "waiting": "none"}.get(job["state"], "fail")
    return render_part("toned", tone, job["verdict"])


def _format_gain(job: TableRow, widest: float) -> Markup:
    """The number with a bar of its length; grey where it is not distinguishable from none."""
    gain = job.get("gain_percent")
    if gain is None:
        return render_macro("batch.html", "small", "CAM default not feasible")
    std = job.get("gain_std_percent")
    colour = "#c9ced4" if job.get("distinguishable") is False else "#7fb894" if gain >= 0 else "#d99a9a"
    text = _format_percent(gain) + (f" ± {std:.1f}" if std is not None else "")
    return render_macro("batch.html", "gain", text, f"{_BAR * abs(gain) / widest:.0f}", colour)


def _format_signed(value: float | None) -> str:
    return "–" if value is None else _format_percent(value)


def _format_percent(value: float) -> str:
    return format_fixed(value, 1)


def _format_number(value: float | None, decimals: int | None = None) -> str:
    """Four significant digits, or so many decimals; "–" where there is none."""
    if value is None:
        return "–"
    if decimals is None:
        decimals = 0 if abs(value) >= 100 else 3 if abs(value) < 10 else 2
    return format_fixed(value, decimals)


def _format_text(value: object) -> str:
    return "–" if value is None else str(value)
