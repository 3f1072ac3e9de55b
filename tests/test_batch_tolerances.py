"""Tolerances of a job in the summary of a batch."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from machopt.batch.job_process import find_worst_tolerance
from machopt.batch.request import BatchRequest
from machopt.batch.run import run_batch
from machopt.data_types.documents.process_entries import ProcessSection, ToleranceEntry
from machopt.errors import InputError

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
HOLES = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},{y},{z},0,0,1,{move},{feed},holes"
    for x, y in ((-150, -200), (50, 200))
    for z, move, feed in ((40, "rapid", ""), (25, "rapid", ""), (0, "cut", 420), (40, "retract", ""))
)


def build_entry(p_in: float | None, error: float | None) -> ToleranceEntry:
    return ToleranceEntry(
        operation="o",
        kind="holes",
        limits={},
        reference="relative",
        counts={},
        worst_point=3,
        worst_error_mm=error,
        worst_p_in=p_in,
        worst_cause="",
    )


def test_worst_operation_has_the_lowest_probability() -> None:
    rows = (build_entry(0.9, 0.5), build_entry(0.4, 0.1), build_entry(0.4, 0.2), build_entry(None, 0.9))
    process = ProcessSection.model_construct(tolerances=rows)
    assert find_worst_tolerance(process) is rows[2]
    assert find_worst_tolerance(ProcessSection.model_construct(tolerances=())) is None


def test_missing_process_file_is_refused_before_the_first_job(tmp_path: Path) -> None:
    (tmp_path / "holes.csv").write_text(HOLES)
    request = BatchRequest(jobs=(str(tmp_path / "holes.csv"),), cell=CELL, out=tmp_path / "o", process=tmp_path / "p")
    with pytest.raises(InputError) as refused:
        run_batch(request)
    assert refused.value.where == "--process"


@pytest.mark.slow
def test_summary_contains_the_outcome_of_each_job(tmp_path: Path) -> None:
    """The same numbers as in result.json; another process.yaml gives another job."""
    (tmp_path / "holes.csv").write_text(HOLES)
    own = (CELL / "process.yaml").read_text().replace("    kind: drilling", "    spindle_rpm: 4000\n    kind: drilling")
    for name, limit in (("narrow", "0.1"), ("wide", "5.0")):
        (tmp_path / f"{name}.yaml").write_text(own.replace("position_mm: 0.3", f"position_mm: {limit}"))
        request = BatchRequest(
            jobs=(str(tmp_path / "holes.csv"),),
            cell=CELL,
            out=tmp_path / "out",
            process=tmp_path / f"{name}.yaml",
            overrides=("rotation_step_deg=20",),
            workers=1,
        )
        assert run_batch(request).done == 1
        with (tmp_path / "out" / "summary.csv").open(encoding="utf-8") as file:
            (row,) = csv.DictReader(file)
        (made,) = (tmp_path / "out" / "jobs").glob("*/result.json")
        process = json.loads(made.read_text())["process"]
        counts = process["in_tolerance"]["after"]
        assert {word: int(row[word]) for word in ("marginal", "fail", "unknown")} == {
            word: counts[word] for word in ("marginal", "fail", "unknown")
        }
        assert (int(row["in_tolerance"]), int(row["with_tolerance"])) == (counts["pass"], 2)
        (tolerance,) = process["tolerances"]
        assert float(row["worst_error_mm"]) == pytest.approx(tolerance["worst_error_mm"], rel=1e-5)  # written with %.6g
        assert int(row["worst_error_point"]) == tolerance["worst_point"]
        assert counts["pass" if name == "wide" else "fail"] == 2
    assert run_batch(request).reused == 1
    assert "Worst error (mm)" in (tmp_path / "out" / "summary.html").read_text()
