"""``summary.html`` of a batch: what was gained, what needs attention, every job with a link to its report."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from machopt.report.display import fixed
from machopt.report.shell import page_html, section
from machopt.report.tables import Column, folded, table
from machopt.report.template import fragment, part
from machopt.report.thumbnail import PathPicture, thumbnail
from machopt.report.verdict import counted

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

Row = Mapping[str, Any]

_BAR = 110  # px of the widest bar of gain


@dataclass(frozen=True, kw_only=True)
class BatchData:
    """What the page shows, in the units of summary.csv (mm, N/mm, s, per cent); the jobs in their order of rank."""

    version: str
    complete: bool  # False: stopped by the user
    jobs: tuple[Row, ...]
    left_out: tuple[str, ...] = ()  # files that were taken for no toolpath
    others: tuple[str, ...] = ()  # folders of earlier jobs that are not in this batch
    compared_with: str = ""
    differences: tuple[Row, ...] = ()
    only_here: tuple[str, ...] = ()
    only_there: tuple[str, ...] = ()
    pictures: Mapping[str, PathPicture] = field(default_factory=dict)  # job → its toolpath


def batch_html(data: BatchData) -> str:
    """The page as text; the same data give the same bytes. Wall times come from ``timings.js`` beside it."""
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("attention", "Needs attention", _attention(data)),
        ("jobs", "Ranking", _ranking(data)),
        ("compare", "Compared", _compared(data)),
        ("warnings", "Warnings", _warnings(data)),
        ("rest", "Not in it", _rest(data)),
    ]
    done = sum(job["state"] == "done" for job in data.jobs)
    return page_html(
        f"Batch of {counted(len(data.jobs), 'job')}",
        (("Done", f"{done} of {len(data.jobs)}"),),
        sections,
        {},
        scripts=("start_batch.js",),
        footer=fragment("batch.html", "footer", data.version),
    )


def _verdict(data: BatchData) -> Body:
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
    sentence = f"{done} of {counted(total, 'job')} done and verified{f'; {rest}' if rest else ''}."
    gains = [job["gain_percent"] for job in data.jobs if job.get("gain_percent") is not None]
    items = []
    if states["waiting"]:
        items.append("The same command goes on with the jobs that were not run.")
    unsure = sum(job.get("distinguishable") is False for job in data.jobs)
    if unsure:
        items.append(f"{counted(unsure, 'job')} with a gain below the stiffness model's own uncertainty.")
    boxes = [("jobs", str(total), "", f"{done} done")]
    if gains:
        known = [job for job in data.jobs if job.get("gain_percent") is not None]
        best, least = (pick(known, key=lambda j: j["gain_percent"]) for pick in (max, min))
        boxes += [
            ("median gain", _percent(statistics.median(gains)), "%", f"of {counted(len(gains), 'job')}"),
            ("largest gain", _percent(best["gain_percent"]), "%", _name(best)),
            ("least gain", _percent(least["gain_percent"]), "%", _name(least)),
        ]
    cycles = [job["cycle_time_s"] for job in data.jobs if job.get("cycle_time_s") is not None]
    if cycles:
        boxes.append(("cycle time of all", f"{sum(cycles) / 60:.1f}", "min", f"longest {max(cycles):.0f} s"))
    held = [job for job in data.jobs if job.get("feed_held_percent") is not None]
    if held:
        worst = min(held, key=lambda j: j["feed_held_percent"])
        boxes.append(("feed held, least", f"{worst['feed_held_percent']:.1f}", "%", _name(worst)))
    return part("verdict", "verdict", tone, badge, sentence, items, boxes)


_STATES = {
    "verification failed": "failed verification",
    "infeasible": "infeasible",
    "refused": "refused",
    "over time": "over the time limit",
    "over memory": "over the memory limit",
    "crashed": "crashed",
    "waiting": "not run",
}


def _attention(data: BatchData) -> Body:
    rows = [
        (_link(job, job["folder"]), job["cell"], job["variant"], _word(job), job.get("reason", ""))
        for job in data.jobs
        if job["state"] not in ("done", "waiting")
    ]
    columns = [
        Column("Toolpath", "html"),
        Column("Cell"),
        Column("Variant"),
        Column("Verdict", "html"),
        Column("Why", "why"),
    ]
    lead = "Jobs without an answer, or with one that must not be run. The others are not touched by them."
    return section("attention", "Needs attention", lead, _table(columns, rows, keep=("Toolpath", "Verdict", "Why")))


def _ranking(data: BatchData) -> Body:
    gains = [abs(job["gain_percent"]) for job in data.jobs if job.get("gain_percent") is not None]
    widest = max(gains, default=1.0) or 1.0
    columns = [
        Column("Rank", "n"),
        Column("Path", "html"),
        Column("Toolpath", "html"),
        Column("Variant"),
        Column("Verdict", "html"),
        Column("Gain over the CAM default (%)", "html"),
        Column("Gain over jiao2022 (%)", "n"),
        Column("Mean", "n"),
        Column("Worst", "n"),
        Column("Unit"),
        Column("Worst point", "n"),
        Column("Cycle (s)", "n"),
        Column("Feed held (%)", "n"),
        Column("Warnings", "n"),
        Column("Wall (s)", "html"),
    ]
    rows = [
        (
            rank,
            _picture(data, job),
            fragment("batch.html", "placed", _link(job, job["report"] or job["folder"]), job["cell"]),
            job["variant"],
            _word(job),
            _gain(job, widest),
            _signed(job.get("gain_over_jiao2022_percent")),
            _number(job.get("mean")),
            _number(job.get("worst")),
            job.get("unit", ""),
            _text(job.get("worst_point")),
            _number(job.get("cycle_time_s"), 1),
            _number(job.get("feed_held_percent"), 1),
            len(job.get("warnings", ())),
            fragment("batch.html", "wall", job["job"]),
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
    body = fragment("batch.html", "unrolled") + _table(columns, rows) if rows else ""
    return section("jobs", "Ranking", lead, body)


def _compared(data: BatchData) -> Body:
    if not data.compared_with:
        return ""
    columns = [
        Column("Toolpath", "html"),
        Column("Variant"),
        Column("Verdict"),
        Column("Rotation differs, mean (deg)", "n"),
        Column("worst (deg)", "n"),
        Column("at point", "n"),
        Column("of the points (%)", "n"),
        Column("Branch changes", "n"),
        Column("Mean before", "n"),
        Column("now", "n"),
        Column("Worst before", "n"),
        Column("now", "n"),
        Column("Unit"),
        Column("Cycle before (s)", "n"),
        Column("now (s)", "n"),
        Column("Note"),
    ]
    report = {job["job"]: job["report"] or job["folder"] for job in data.jobs}
    rows = [
        (
            _link(row, report.get(row["job"], "")),
            row["variant"],
            _change(row),
            _number(row["rotation_mean_deg"], 1),
            _number(row["rotation_worst_deg"], 1),
            _text(row["worst_at_point"]),
            "–" if row["turned_share"] is None else f"{100 * row['turned_share']:.0f}",
            _text(row["branch_changes"]),
            *(_number(row[k]) for k in ("mean_before", "mean", "worst_before", "worst")),
            row["unit"] or "",
            _number(row["cycle_time_before_s"], 1),
            _number(row["cycle_time_s"], 1),
            row["note"],
        )
        for row in data.differences
    ]
    verdicts = sum(row["verdict"] != row["verdict_before"] for row in data.differences)
    turned = sum(bool(row["turned_share"]) for row in data.differences)
    lead = (
        f"Against {data.compared_with}: of {counted(len(rows), 'job')} in both, "
        f"{counted(verdicts, 'verdict')} changed and {turned} chose another rotation (more than 1° somewhere). "
        "Before and now are each predicted with their own model."
    )
    body: Body = _table(columns, rows, keep=("Toolpath", "Verdict"))
    for title, names in (("Only here", data.only_here), (f"Only in {data.compared_with}", data.only_there)):
        body += folded(title, len(names), part("bullets", names)) if names else ""
    return section("compare", "Compared", lead, body)


def _change(row: Row) -> str:
    before, now = row["verdict_before"], row["verdict"]
    return str(now) if before == now else f"{before} → {now}"


def _warnings(data: BatchData) -> Body:
    texts = Counter(w for job in data.jobs for w in job.get("warnings", ()))
    if not texts:
        return ""
    rows = sorted(((n, w) for w, n in texts.items()), key=lambda row: (-row[0], row[1]))
    body = table([Column("Jobs", "n"), Column("Warning", "why")], rows)
    return section("warnings", "Warnings", "Equal ones counted together; each job's report has its own.", body)


def _rest(data: BatchData) -> Body:
    body: Body = ""
    waiting = [_name(job) for job in data.jobs if job["state"] == "waiting"]
    if waiting:
        body += folded("Not run yet", len(waiting), part("bullets", waiting), opened=True)
    if data.left_out:
        body += folded("Files left out by their names", len(data.left_out), part("bullets", data.left_out))
    if data.others:
        body += folded(
            "Folders of earlier jobs that this batch does not name", len(data.others), part("bullets", data.others)
        )
    return section(
        "rest", "Not in it", "What is not done yet, and what lies there and is not part of this batch.", body
    )


def _table(columns: Sequence[Column], rows: Sequence[Sequence[object]], keep: Sequence[str] = ()) -> Body:
    """The table without columns that are empty for all jobs."""
    if not rows:
        return ""
    used = [n for n, c in enumerate(columns) if c.title in keep or any(row[n] not in ("", "–") for row in rows)]
    return table([columns[n] for n in used], [[row[n] for n in used] for row in rows])


def _name(job: Row) -> str:
    return f"{job['toolpath']}, {job['variant']}" if job["variant"] else str(job["toolpath"])


def _link(job: Row, target: str) -> Body:
    text = str(job["toolpath"])
    return fragment("batch.html", "link", text, quote(target)) if target else text


def _picture(data: BatchData, job: Row) -> Body:
    path = data.pictures.get(job["job"])
    if path is None:
        return "–"
    return fragment("batch.html", "link", thumbnail(path), f"{quote(job['report'])}#scene")


def _word(job: Row) -> Markup:
    tone = {"done": "pass", "waiting": "none"}.get(job["state"], "fail")
    return part("toned", tone, job["verdict"])


def _gain(job: Row, widest: float) -> Markup:
    """The number with a bar of its length; grey where it is not distinguishable from none."""
    gain = job.get("gain_percent")
    if gain is None:
        return fragment("batch.html", "small", "CAM default not feasible")
    std = job.get("gain_std_percent")
    colour = "#c9ced4" if job.get("distinguishable") is False else "#7fb894" if gain >= 0 else "#d99a9a"
    text = _percent(gain) + (f" ± {std:.1f}" if std is not None else "")
    return fragment("batch.html", "gain", text, f"{_BAR * abs(gain) / widest:.0f}", colour)


def _signed(value: float | None) -> str:
    return "–" if value is None else _percent(value)


def _percent(value: float) -> str:
    return fixed(value, 1)


def _number(value: float | None, decimals: int | None = None) -> str:
    """Four significant digits, or so many decimals; "–" where there is none."""
    if value is None:
        return "–"
    if decimals is None:
        decimals = 0 if abs(value) >= 100 else 3 if abs(value) < 10 else 2
    return fixed(value, decimals)


def _text(value: object) -> str:
    return "–" if value is None else str(value)
