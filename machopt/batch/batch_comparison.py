"""What differs between two batches of the same toolpaths, e.g. planned with two stiffness models."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from machopt.batch.job_status import JobStatus
from machopt.data_types.documents.batch_document import BatchDocument

_ROTATION_CHANGE_DEG = 1.0  # deg; a rotation that differs less is the same choice

COMPARISON_COLUMNS = (
    "job",
    "toolpath",
    "variant",
    "verdict_before",
    "verdict",
    "rotation_mean_deg",
    "rotation_worst_deg",
    "worst_at_point",
    "turned_share",
    "branch_changes",
    "unit",
    "mean_before",
    "mean",
    "worst_before",
    "worst",
    "cycle_time_before_s",
    "cycle_time_s",
    "note",
)


@dataclass(frozen=True)
class BatchComparison:
    """Rows with :data:`COMPARISON_COLUMNS` as keys, those that changed most first."""

    other: str  # name of the other batch's folder
    rows: tuple[dict[str, Any], ...]
    only_here: tuple[str, ...]  # toolpaths
    only_there: tuple[str, ...]


def compare_batches(jobs: Path, lines: Sequence[JobStatus], other: Path, result: BatchDocument) -> BatchComparison:
    """Pair the jobs of two batches by toolpath and variant, and take the differences.

    Jobs are paired by their folder's label where both have it; the others, whose cell is in another place, by
    toolpath and variant where these name one job on both sides.

    Args:
        jobs: folder of this batch's jobs.
        lines: this batch.
        other: output folder of the other batch ("before").
        result: its batch.json.
    """
    theirs = {line.job: line.to_json_types() for line in result.jobs}
    mine = {line.job.label: line for line in lines}
    pairs = {label: label for label in mine if label in theirs}
    rest = {label: (line.job.toolpath_name, line.job.variant) for label, line in mine.items() if label not in pairs}
    found = {label: (row["toolpath"], row["variant"]) for label, row in theirs.items() if label not in pairs}
    once_here, once_there = _match_unique_jobs(rest), _match_unique_jobs(found)
    pairs |= {once_here[what]: once_there[what] for what in once_here if what in once_there}
    rows = [_build_row(jobs, mine[a], other / "jobs", theirs[b]) for a, b in pairs.items()]
    rows.sort(key=lambda r: (r["verdict"] == r["verdict_before"], -(r["rotation_worst_deg"] or 0.0), r["job"]))
    return BatchComparison(
        other.resolve().name,
        tuple(rows),
        tuple(sorted(line.job.toolpath_name for label, line in mine.items() if label not in pairs)),
        tuple(sorted(row["toolpath"] for label, row in theirs.items() if label not in pairs.values())),
    )


def _match_unique_jobs(what: dict[str, tuple[str, str]]) -> dict[tuple[str, str], str]:
    times = Counter(what.values())
    return {key: label for label, key in what.items() if times[key] == 1}


def _build_row(jobs: Path, line: JobStatus, others: Path, before: dict[str, Any]) -> dict[str, Any]:
    row = line.row
    out: dict[str, Any] = {
        "job": line.job.label,
        "toolpath": line.job.toolpath_name,
        "variant": line.job.variant,
        "verdict_before": before["verdict"],
        "verdict": line.verdict,
        "unit": row.get("unit") or before.get("unit"),
        "cycle_time_before_s": before.get("cycle_time_s"),
        "cycle_time_s": row.get("cycle_time_s"),
    }
    same_unit = row.get("unit") is None or before.get("unit") is None or row["unit"] == before["unit"]
    for name in ("mean", "worst"):
        out[f"{name}_before"] = before.get(name) if same_unit else None
        out[name] = row.get(name)
    note = "" if same_unit else "the two were planned for different quantities"
    a, b = _read_points(others / before["job"] / "points.csv"), _read_points(jobs / line.job.label / "points.csv")
    out |= (
        _compare_rotations(a, b) if a is not None and b is not None and len(a) == len(b) else _compare_rotations([], [])
    )
    if a is not None and b is not None and len(a) != len(b):
        note = f"the toolpath had {len(a)} points before and has {len(b)}"
    return {name: {**out, "note": note}.get(name) for name in COMPARISON_COLUMNS}


def _read_points(file: Path) -> list[tuple[float, str]] | None:
    """Rotation in degrees (NaN where not cutting or none) and branch of every point."""
    try:
        with file.open(encoding="utf-8", newline="") as text:
            return [
                (_parse_number(r["gamma_deg"] if r["move"] == "cut" else ""), r["branch"]) for r in csv.DictReader(text)
            ]
    except (OSError, KeyError, csv.Error):
        return None


def _compare_rotations(before: Iterable[tuple[float, str]], after: Iterable[tuple[float, str]]) -> dict[str, Any]:
    """How the chosen rotation and branch differ at the cutting points that both have."""
    pairs = [
        (k, abs(math.remainder(b - a, 360.0)), p != q)
        for k, ((a, p), (b, q)) in enumerate(zip(before, after, strict=True))
        if math.isfinite(a) and math.isfinite(b)
    ]
    if not pairs:
        return {}
    at, worst, _ = max(pairs, key=lambda p: (p[1], -p[0]))
    return {
        "rotation_mean_deg": math.fsum(p[1] for p in pairs) / len(pairs),
        "rotation_worst_deg": worst,
        "worst_at_point": at,
        "turned_share": sum(p[1] > _ROTATION_CHANGE_DEG for p in pairs) / len(pairs),
        "branch_changes": sum(p[2] for p in pairs),
    }


def _parse_number(text: str) -> float:
    return float(text) if text else math.nan
