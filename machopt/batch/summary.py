"""Summary of a batch: ranked rows as CSV, JSON and one page."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.batch.batch_comparison import COMPARISON_COLUMNS as COMPARED
from machopt.batch.batch_comparison import BatchComparison
from machopt.batch.job_discovery import DiscoveredJobs
from machopt.batch.job_status import JobStatus
from machopt.batch.toolpath_picture import build_path_picture
from machopt.data_types.documents.batch_document import (
    BatchComparisonSection,
    BatchDifferenceEntry,
    BatchDocument,
    BatchJobEntry,
)
from machopt.file_formats.csv_text_escaping import escape_formula_text
from machopt.report.pages.batch_page import BatchPageData, build_batch_html

if TYPE_CHECKING:
    from machopt.batch.job_store import JobStore

SUMMARY_COLUMNS = (
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
    "in_tolerance",
    "with_tolerance",
    "marginal",
    "fail",
    "unknown",
    "worst_error_mm",
    "worst_error_point",
    "worst_p_in",
    "feed_held_percent",
    "points",
    "infeasible_points",
    "programs",
    "warnings",
    "reason",
    "report",
)
_STATE_ORDER = (
    "done",
    "verification failed",
    "infeasible",
    "refused",
    "over time",
    "over memory",
    "crashed",
    "waiting",
)
_TIMING_COLUMNS = ("wall_s", "cpu_s", "peak_MiB", "worker")


def rank_jobs(lines: Iterable[JobStatus]) -> list[JobStatus]:
    """Return solved jobs by their gain over the CAM's default rotation, largest first; then the others, by kind.

    Args:
        lines: The jobs with their states.
    """

    def place(line: JobStatus) -> tuple[int, bool, float, str]:
        gain = line.row.get("gain_percent")
        return _STATE_ORDER.index(line.state), gain is None, -(gain or 0.0), line.job.label

    return sorted(lines, key=place)


def compute_exit_code(lines: Iterable[JobStatus]) -> int:
    """Return the worst exit code: 4 verification failed, else 1 crashed, else 3 no solution, else 0.

    Args:
        lines: The jobs with their states.
    """
    codes = {line.exit_code for line in lines}
    if 4 in codes:
        return 4
    if 1 in codes:
        return 1
    return 3 if codes & {2, 3} else 0


def build_batch_document(
    discovered_jobs: DiscoveredJobs,
    lines: Sequence[JobStatus],
    version: str,
    *,
    complete: bool,
    others: Sequence[str] = (),
    compared: BatchComparison | None = None,
) -> BatchDocument:
    """Return the content of batch.json: the same for the same jobs, however often the batch was stopped.

    Args:
        discovered_jobs: The jobs that were found, and ignored files.
        lines: The ranked jobs with their states.
        version: Program version.
        complete: All jobs have ended.
        others: Folders of finished jobs that are not in this batch.
        compared: Comparison with another batch; None where none was requested.
    """
    states = Counter(line.state for line in lines)
    return BatchDocument(
        machopt_batch=1,
        version=version,
        complete=complete,
        exit_code=compute_exit_code(lines) if complete else None,
        counts={state: states[state] for state in _STATE_ORDER if states[state]},
        jobs=tuple(_build_summary_entry(rank, line) for rank, line in enumerate(rank_jobs(lines), 1)),
        left_out_files=tuple(discovered_jobs.ignored_files),
        other_jobs_in_folder=tuple(others),
        compare=None
        if compared is None
        else BatchComparisonSection(
            compared_with=compared.other,
            rows=tuple(BatchDifferenceEntry.model_validate(r) for r in compared.rows),
            only_here=compared.only_here,
            only_there=compared.only_there,
        ),
    )


def _build_summary_entry(rank: int, line: JobStatus) -> BatchJobEntry:
    own = {k: v for k, v in line.row.items() if k != "verdict"}
    return BatchJobEntry(
        rank=rank,
        job=line.job.label,
        key=line.key,
        toolpath=line.job.toolpath_name,
        cell=line.cell_name,
        variant=line.job.variant,
        options=dict(line.job.options),
        state=line.state,
        verdict=line.verdict,
        **own,
        folder=line.folder,
        report=line.report,
    )


def write_summary(
    store: JobStore, lines: Sequence[JobStatus], result: BatchDocument, compared: BatchComparison | None
) -> None:
    """Write batch.json, summary.csv, summary.html, timings.csv, timings.js and, if requested, compare.csv.

    Args:
        store: Output folder of the batch.
        lines: The ranked jobs with their states.
        result: Content of batch.json.
        compared: Comparison with another batch; None where none was requested.
    """
    known = {line.job.label: store.read_timing(line.job.label) for line in rank_jobs(lines) if line.folder}
    times = [{"job": label, **({} if took is None else took.to_json_types())} for label, took in known.items()]
    store.write_summary_file(
        "summary.csv",
        _format_csv(SUMMARY_COLUMNS, [_build_csv_cells(rank, line) for rank, line in enumerate(rank_jobs(lines), 1)]),
    )
    store.write_summary_file("timings.csv", _format_csv(("job", *_TIMING_COLUMNS), times))
    store.write_summary_file(
        "timings.js", f"const TIMINGS = {json.dumps({t['job']: t.get('wall_s') for t in times})};\n"
    )
    if compared is not None:
        store.write_summary_file("compare.csv", _format_csv(COMPARED, compared.rows))
    store.write_summary_file("summary.html", build_batch_html(_build_page_data(lines, result, compared, store.jobs)))
    store.write_main(result)


def _build_csv_cells(rank: int, line: JobStatus) -> dict[str, object]:
    warnings, programs = line.row.get("warnings", ()), line.row.get("programs", ())
    return {
        **line.row,
        "rank": rank,
        "job": line.job.label,
        "toolpath": line.job.toolpath_name,
        "cell": line.cell_name,
        "variant": line.job.variant,
        "verdict": line.verdict,
        "programs": " ".join(programs),
        "warnings": len(warnings),
        "report": line.report,
    }


def _format_csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_format_text(row.get(name)) for name in columns])
    return out.getvalue()


def _format_text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = " ".join(str(value).split())
    return text if isinstance(value, int) else escape_formula_text(text)


def _build_page_data(
    lines: Sequence[JobStatus], result: BatchDocument, compared: BatchComparison | None, jobs: Path
) -> BatchPageData:
    return BatchPageData(
        version=result.version,
        complete=result.complete,
        pictures={
            line.job.label: picture
            for line in lines
            if line.report
            and (picture := build_path_picture(jobs / line.job.label / "points.csv", line.job.toolpath_name))
            is not None
        },
        jobs=tuple(
            {
                **line.row,
                "job": line.job.label,
                "toolpath": line.job.toolpath_name,
                "cell": line.cell_name,
                "variant": line.job.variant,
                "state": line.state,
                "verdict": line.verdict,
                "folder": line.folder,
                "report": line.report,
            }
            for line in rank_jobs(lines)
        ),
        ignored_files=result.left_out_files,
        others=result.other_jobs_in_folder,
        compared_with="" if compared is None else compared.other,
        differences=() if compared is None else compared.rows,
        only_here=() if compared is None else compared.only_here,
        only_there=() if compared is None else compared.only_there,
    )
