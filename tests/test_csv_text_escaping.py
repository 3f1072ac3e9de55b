"""User text in CSV cells: no formulas, and exact round trip."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from batch_stub_jobs import CELL, request_for
from hypothesis import given
from hypothesis import strategies as st
from independent_trajectory_reader import read_trajectory_csv

from machopt.batch.run import run_batch
from machopt.data_types.toolpath import MoveKind
from machopt.file_formats.csv_text_escaping import escape_formula_text, unescape_formula_text
from machopt.output.tables.plan_tables import write_trajectory_csv
from machopt.verification.tables.csv_columns import read_columns

BAD = ("=HYPERLINK(1)", "+1", "-1", "@SUM(A1)", "'=1", "''@x", " =1", "＝1+1")
RUN = tuple("=+-@\t\r＝＋－＠")


@given(st.text(alphabet="='+-@ a\t\r＝", max_size=6))
def test_every_text_is_read_back_and_none_is_a_formula(text: str) -> None:
    assert unescape_formula_text(escape_formula_text(text)) == text
    assert not escape_formula_text(text).lstrip(" ").startswith(RUN)


def test_harmless_words_and_numbers_remain_unchanged() -> None:
    for text in ("", "drill 5", "it's", "'quoted'", "Ünique", "5-1"):
        assert escape_formula_text(text) == text


@pytest.mark.parametrize("label", BAD)
def test_operation_labels_survive_the_trajectory_in_both_readers(label: str, tmp_path: Path) -> None:
    import numpy as np

    from machopt.data_types.trajectory import Trajectory

    n = 3
    t = Trajectory(
        time=np.arange(n) * 0.012,
        point=np.arange(n, dtype=float),
        operation=np.zeros(n, np.int32),
        move=np.full(n, int(MoveKind.CUT), np.int8),
        q=np.zeros((n, 6)),
        external=np.zeros((n, 0)),
        gamma=np.zeros(n),
        feed=np.full(n, 0.01),
    )
    file = tmp_path / "trajectory.csv"
    write_trajectory_csv(file, t, (label,))
    want = " ".join(label.split())
    assert read_trajectory_csv(file).operations == (want,)
    assert set(read_columns(file)["operation"]) == {want}
    for row in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))):
        assert not row[2].startswith(RUN)


def test_file_job_and_reason_texts_survive_the_batch_summary(tmp_path: Path) -> None:
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "=cmd|x.nc").write_text("#raise\n")
    (tmp_path / "list.yaml").write_text(
        f"machopt_batch: 1\njobs:\n  - {{cell: {CELL}, toolpath: 'jobs/=cmd|x.nc', name: '@SUM(A1)'}}\n"
    )
    run_batch(request_for(tmp_path / "list.yaml", tmp_path / "out", workers=1))
    run_batch(request_for(tmp_path / "list.yaml", tmp_path / "out2", workers=1, compare=tmp_path / "out"))
    for file in (
        tmp_path / "out" / "summary.csv",
        tmp_path / "out2" / "summary.csv",
        tmp_path / "out2" / "compare.csv",
    ):
        rows = list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))))
        assert rows, file
        words = [v for row in rows for k, v in row.items() if k in ("job", "toolpath", "variant", "reason", "cell")]
        assert any("cmd" in word for word in words)
        assert not [word for word in words if word.startswith(RUN)]


@pytest.mark.parametrize("label", BAD[:6])
def test_operation_labels_survive_the_csv_program(label: str, tmp_path: Path) -> None:
    from sample_robot_programs import Recipe, program

    from machopt.data_types.robot_program import RobotController
    from machopt.programs.program_reader import read_program
    from machopt.programs.program_writer import write_program

    write_program(tmp_path, "part", program(Recipe(seed=1, operations=(label, "b"))), "csv", RobotController())
    (file,) = tmp_path.iterdir()
    for row in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))):
        assert row[0].startswith("#") or not [c for c in (row[1], row[-1]) if c.startswith(RUN)]
    assert label.strip() in read_program(file).operations
