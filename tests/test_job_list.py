"""Folders, patterns and lists of jobs, and the errors of invalid ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from batch_stub_jobs import CELL, folder_of, request_for

from machopt.batch.job_discovery import find_jobs
from machopt.batch.run import run_batch
from machopt.errors import InputError
from machopt.input_files.job_list import is_job_table


def test_folders_patterns_and_neighbouring_cells(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0")
    (jobs / "README.md").write_text("notes")
    (jobs / ".hidden").write_text("no")
    inner = jobs / "deep"
    (inner / "cell").mkdir(parents=True)
    (inner / "cell" / "cell.yaml").write_text("machopt_cell: 1\n")
    (inner / "c.nc").write_text("#sleep 0")
    found = find_jobs(request_for(jobs, tmp_path / "out"))
    assert [(j.toolpath_name, j.cell.name) for j in found.jobs] == [
        ("a.nc", "s420f_handling"),
        ("b.nc", "s420f_handling"),
        ("deep/c.nc", "cell"),
    ]
    assert found.ignored_files == ("README.md",)
    assert len({j.label for j in found.jobs}) == 3
    pattern = find_jobs(request_for(f"{jobs}/**/*.nc", tmp_path / "out"))
    assert {j.label for j in pattern.jobs} == {j.label for j in found.jobs}
    with pytest.raises(InputError, match=r"a\.nc: has no cell; --cell FOLDER"):
        find_jobs(request_for(jobs, tmp_path / "out", cell=None))
    with pytest.raises(InputError, match="no toolpath matches this pattern"):
        find_jobs(request_for(f"{jobs}/*.cls", tmp_path / "out"))
    with pytest.raises(InputError, match="is given twice"):
        find_jobs(replace(request_for(jobs, tmp_path / "out"), jobs=(str(jobs), str(jobs / "a.nc"))))


def test_lists_combine_and_name_jobs(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0", b="sleep 0")
    yaml = tmp_path / "list.yaml"
    yaml.write_text(
        f"machopt_batch: 1\ntime_limit_s: 5\ncells: [{CELL}]\ntoolpaths: [jobs/*.nc]\n"
        "options:\n  fine: {rotation_step_deg: 2}\n  paper: {method: jiao2022}\n"
        "jobs:\n  - {toolpath: jobs/a.nc, name: Ünique / name, time_limit_s: 9, reading: {feed_mm_min: 600}}\n"
    )
    found = find_jobs(request_for(yaml, tmp_path / "out", reading={"unit": "mm", "machine": None})).jobs
    assert [(j.toolpath_name, j.variant, j.time_limit) for j in found] == [
        ("jobs/a.nc", "fine", 5),
        ("jobs/a.nc", "paper", 5),
        ("jobs/b.nc", "fine", 5),
        ("jobs/b.nc", "paper", 5),
        ("jobs/a.nc", "Ünique / name", 9),
    ]
    assert found[1].options == {"method": "jiao2022"}
    assert found[4].reading == {"unit": "mm", "default_feed": pytest.approx(0.01)}  # 600 mm/min in m/s
    assert found[4].label.startswith("jobs-a-s420f_handling-Unique-name-")
    table = tmp_path / "list.csv"
    table.write_text(
        f"# a comment\ntoolpath,cell,force_N.normal,memory_limit_MiB\njobs/a.nc,{CELL},200,500\njobs/b.nc,,,\n"
    )
    a, b = find_jobs(request_for(table, tmp_path / "out")).jobs
    assert (a.options, a.memory_limit) == ({"force_N": {"normal": 200}}, 500 * 2**20)
    assert (b.options, b.cell) == ({}, CELL)
    assert jobs.is_dir()


def test_list_may_be_parquet(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is an optional dependency")
    parquet = pytest.importorskip("pyarrow.parquet")
    for name in "ab":
        (tmp_path / f"{name}.nc").write_text("x")
    columns = {
        "toolpath": ["a.nc", "b.nc"],
        "cell": [str(CELL), None],
        "force_N.normal": [200.0, None],
        "collision": [None, False],
    }
    file = tmp_path / "list.parquet"
    parquet.write_table(pyarrow.table(columns), file)
    a, b = find_jobs(request_for(file, tmp_path / "out")).jobs
    assert (a.options, a.cell) == ({"force_N": {"normal": 200.0}}, CELL)
    assert b.options == {"collision": False}
    parquet.write_table(pyarrow.table({"toolpath": ["a.nc"], "cel": [None]}), file)
    with pytest.raises(InputError, match="unknown column; did you mean 'cell'"):
        find_jobs(request_for(file, tmp_path / "out"))
    file.write_bytes(b"PAR1 and no more")  # not a list; the reader of points reports the reason
    assert not is_job_table(file)


def test_list_in_the_docs_is_valid(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[1] / "docs" / "batch.md").read_text(encoding="utf-8")
    listed = tmp_path / "jobs.yaml"
    listed.write_text(next(t for t in page.split("```yaml\n")[1:] if "machopt_batch" in t).partition("```")[0])
    for file in ("cells/a/cell.yaml", "cells/b/cell.yaml", "parts/x.cls", "old/flange.src"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    found = find_jobs(request_for(listed, tmp_path / "out")).jobs
    assert [(j.cell.name, j.toolpath.name, j.variant) for j in found[:4]] == [
        ("a", "x.cls", "fine"),
        ("a", "x.cls", "paper"),
        ("b", "x.cls", "fine"),
        ("b", "x.cls", "paper"),
    ]
    assert (found[4].reading, found[4].time_limit, found[4].posts) == ({"tool_axis": "+z"}, 600.0, ("krl",))


GOOD = "machopt_batch: 1\njobs:\n  - {cell: CELL, toolpath: jobs/a.nc}\n"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("l.yaml", "", "is empty; expected a mapping with"),
        ("l.yaml", "machopt_batch: 1\n", "names no job"),
        ("l.yaml", GOOD + "jbos: []\n", r"line 4: jbos: unknown key 'jbos'; did you mean 'jobs'"),
        ("l.yaml", GOOD.replace("toolpath:", "toolpth:"), r"line 3: jobs\[0\].toolpth: unknown key 'toolpth'; did you"),
        ("l.yaml", GOOD.replace("a.nc", "x.nc"), r"line 3: jobs\[0\].toolpath: no such toolpath: jobs/x.nc"),
        ("l.yaml", GOOD.replace("CELL", "nowhere"), r"line 3: jobs\[0\].cell: no such cell: nowhere"),
        ("l.yaml", GOOD.replace("CELL", "jobs"), r"line 3: jobs\[0\].cell: no cell.yaml in the folder jobs"),
        ("l.yaml", GOOD.replace("a.nc}", "a.nc, time_limit_s: 0}"), r"time_limit_s: found 0; expected greater than 0"),
        ("l.yaml", GOOD.replace("a.nc}", "a.nc, time_limit_s: .nan}"), "expected a finite number"),
        ("l.yaml", GOOD.replace("a.nc}", "a.nc, options: {metod: x}}"), r"options.metod: unknown key .* 'method'"),
        ("l.yaml", GOOD + GOOD.splitlines()[2] + "\n", r"line 4: jobs\[1\]: .*is given twice, first in .*line 3"),
        ("l.yaml", "machopt_batch: 1\ncells: [CELL]\n", "there is no key toolpaths"),
        ("l.yaml", "machopt_batch: 1\ntoolpaths: ['*.cls']\n", r"line 2: toolpaths\[0\]: no file matches \*.cls"),
        ("l.yaml", "machopt_batch: [\n", "is not YAML"),
        ("l.csv", "toolpath,cel\njobs/a.nc,CELL\n", "line 1, column 'cel': unknown column; did you mean 'cell'"),
        ("l.csv", "toolpath,cell\njobs/a.nc\n", "line 2: found 1 fields; expected 2"),
        ("l.csv", "toolpath,cell,seed\njobs/a.nc,CELL,x\n", "line 2: options.seed: found the text 'x'; expected"),
        ("l.csv", "toolpath,cell\njobs/a.nc,nowhere\n", "line 2: cell: no such cell: nowhere"),
        ("l.csv", "toolpath,toolpath\na,b\n", "column is given twice"),
    ],
)
def test_invalid_list_starts_nothing_and_names_the_place(name: str, text: str, words: str, tmp_path: Path) -> None:
    folder_of(tmp_path, a="sleep 0")
    file = tmp_path / name
    file.write_text(text.replace("CELL", str(CELL)))
    with pytest.raises(InputError, match=words) as caught:
        run_batch(request_for(file, tmp_path / "out", cell=None))
    assert str(caught.value).startswith(str(file))
    assert caught.value.exit_code == 2
    assert not (tmp_path / "out").exists()
