"""The summary of a batch: ranked rows as CSV, JSON and one page."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.batch.compare import COLUMNS as COMPARED
from machopt.batch.compare import Comparison
from machopt.batch.find import Found
from machopt.batch.line import Line
from machopt.batch.picture import picture_of
from machopt.domain.results.batch import BatchComparison, BatchDifference, BatchLine, BatchResult
from machopt.formats.celltext import as_cell
from machopt.report.batch_page import BatchData, batch_html

if TYPE_CHECKING:
    from machopt.batch.store import Store

COLUMNS = (
    "rank",
    "job",
    "toolpath",
    "cell",
    "variant",
    "verdict",
    "exit_code",
    "gain_percent",
    "gain_std_percent",
    "gain_over_jiao2022_percent",
    "unit",
    "mean",
    "mean_cam_default",
    "worst",
    "worst_cam_default",
    "worst_point",
    "deflection_mm",
    "k_axial_N_mm",
    "cycle_time_s",
    "feed_held_percent",
    "points",
    "infeasible_points",
    "programs",
    "warnings",
    "reason",
    "report",
)
_ORDER = ("done", "verification failed", "infeasible", "refused", "over time", "over memory", "crashed", "waiting")
_TIMES = ("wall_s", "cpu_s", "peak_MiB", "worker")


def ranked(lines: Iterable[Line]) -> list[Line]:
    """Answers by their gain over the CAM's default rotation, the largest first; then what has no answer, by kind."""

    def place(line: Line) -> tuple[int, bool, float, str]:
        gain = line.row.get("gain_percent")
        return _ORDER.index(line.state), gain is None, -(gain or 0.0), line.job.label

    return sorted(lines, key=place)


def exit_code_of(lines: Iterable[Line]) -> int:
    """The worst of the jobs: 4 verification failed, else 1 crashed, else 3 no answer, else 0."""
    codes = {line.exit_code for line in lines}
    if 4 in codes:
        return 4
    if 1 in codes:
        return 1
    return 3 if codes & {2, 3} else 0


def result_of(
    found: Found,
    lines: Sequence[Line],
    version: str,
    *,
    complete: bool,
    others: Sequence[str] = (),
    compared: Comparison | None = None,
) -> BatchResult:
    """batch.json: the same for the same jobs, however often the batch was stopped."""
    states = Counter(line.state for line in lines)
    return BatchResult(
        machopt_batch=1,
        version=version,
        complete=complete,
        exit_code=exit_code_of(lines) if complete else None,
        counts={state: states[state] for state in _ORDER if states[state]},
        jobs=tuple(_line(rank, line) for rank, line in enumerate(ranked(lines), 1)),
        left_out_files=tuple(found.left_out),
        other_jobs_in_folder=tuple(others),
        compare=None
        if compared is None
        else BatchComparison(
            compared_with=compared.other,
            rows=tuple(BatchDifference.model_validate(r) for r in compared.rows),
            only_here=compared.only_here,
            only_there=compared.only_there,
        ),
    )


def _line(rank: int, line: Line) -> BatchLine:
    own = {k: v for k, v in line.row.items() if k != "verdict"}
    return BatchLine(
        rank=rank,
        job=line.job.label,
        key=line.key,
        toolpath=line.job.shown,
        cell=line.cell_name,
        variant=line.job.variant,
        options=dict(line.job.options),
        state=line.state,
        verdict=line.verdict,
        **own,
        folder=line.folder,
        report=line.report,
    )


def write_summary(store: Store, lines: Sequence[Line], result: BatchResult, compared: Comparison | None) -> None:
    """Write batch.json, summary.csv, summary.html, timings.csv, timings.js and, where asked for, compare.csv."""
    known = {line.job.label: store.timing(line.job.label) for line in ranked(lines) if line.folder}
    times = [{"job": label, **({} if took is None else took.plain())} for label, took in known.items()]
    store.write("summary.csv", _csv(COLUMNS, [_cells(rank, line) for rank, line in enumerate(ranked(lines), 1)]))
    store.write("timings.csv", _csv(("job", *_TIMES), times))
    store.write("timings.js", f"const TIMINGS = {json.dumps({t['job']: t.get('wall_s') for t in times})};\n")
    if compared is not None:
        store.write("compare.csv", _csv(COMPARED, compared.rows))
    store.write("summary.html", batch_html(_page(lines, result, compared, store.jobs)))
    store.write_main(result)


def _cells(rank: int, line: Line) -> dict[str, object]:
    warnings, programs = line.row.get("warnings", ()), line.row.get("programs", ())
    return {
        **line.row,
        "rank": rank,
        "job": line.job.label,
        "toolpath": line.job.shown,
        "cell": line.cell_name,
        "variant": line.job.variant,
        "verdict": line.verdict,
        "programs": " ".join(programs),
        "warnings": len(warnings),
        "report": line.report,
    }


def _csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_text(row.get(name)) for name in columns])
    return out.getvalue()


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = " ".join(str(value).split())
    return text if isinstance(value, int) else as_cell(text)


def _page(lines: Sequence[Line], result: BatchResult, compared: Comparison | None, jobs: Path) -> BatchData:
    return BatchData(
        version=result.version,
        complete=result.complete,
        pictures={
            line.job.label: picture
            for line in lines
            if line.report and (picture := picture_of(jobs / line.job.label / "points.csv", line.job.shown)) is not None
        },
        jobs=tuple(
            {
                **line.row,
                "job": line.job.label,
                "toolpath": line.job.shown,
                "cell": line.cell_name,
                "variant": line.job.variant,
                "state": line.state,
                "verdict": line.verdict,
                "folder": line.folder,
                "report": line.report,
            }
            for line in ranked(lines)
        ),
        left_out=result.left_out_files,
        others=result.other_jobs_in_folder,
        compared_with="" if compared is None else compared.other,
        differences=() if compared is None else compared.rows,
        only_here=() if compared is None else compared.only_here,
        only_there=() if compared is None else compared.only_there,
    )
