"""Robot programs of a batch: ``--post``, ``post`` and ``posts`` in job lists, and template files in the key of a
job."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from batch_stub_jobs import CELL, folder_of, request_for
from cells_without_controller import without_controller

from machopt.batch import run as batch_run
from machopt.batch.job_discovery import find_jobs
from machopt.batch.job_key import JobKeyBuilder, ReadyJob, RefusedJob
from machopt.batch.job_process import build_summary_row
from machopt.batch.request import BatchRequest, BatchResult
from machopt.cli import main
from machopt.data_types.documents.batch_document import BatchDocument
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.errors import InputError
from machopt.programs.program_writer import read_post_text


def key_of(request: BatchRequest) -> ReadyJob | RefusedJob:
    (job,) = find_jobs(request).jobs
    return JobKeyBuilder(request, "test").build_key(job)


def key(request: BatchRequest) -> str:
    found = key_of(request)
    assert isinstance(found, ReadyJob)
    return found.key


def test_posts_of_a_job_override_those_of_the_list_and_the_command(tmp_path: Path) -> None:
    folder_of(tmp_path, a="sleep 0", b="sleep 0")
    mine = tmp_path / "mine.toml"
    mine.write_text(read_post_text("krl"))
    jobs = (
        "  - {toolpath: jobs/a.nc, post: rapid}\n  - {toolpath: jobs/a.nc, posts: [krl_pos, mine.toml]}\n"
        "  - {toolpath: jobs/b.nc}\n"
    )
    listed = tmp_path / "list.yaml"
    request = request_for(listed, tmp_path / "out", posts=("ros", "json"))
    listed.write_text(f"machopt_batch: 1\njobs:\n{jobs}")
    assert [j.posts for j in find_jobs(request).jobs] == [("rapid",), ("krl_pos", mine), ("ros", "json")]
    listed.write_text(
        f"machopt_batch: 1\npost: val3\ntoolpaths: [jobs/*.nc]\njobs:\n{jobs}".replace("b.nc}", "b.nc, name: x}")
    )
    found = find_jobs(request).jobs
    assert [j.posts for j in found] == [("val3",), ("val3",), ("rapid",), ("krl_pos", mine), ("val3",)]
    assert len({j.label for j in found}) == 5
    table = tmp_path / "list.csv"
    table.write_text('toolpath,post,posts\njobs/a.nc,mine.toml,\njobs/b.nc,,"[csv, json]"\njobs/a.nc,,\n')
    found = find_jobs(replace(request, jobs=(str(table),))).jobs
    assert [j.posts for j in found] == [(mine,), ("csv", "json"), ("ros", "json")]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("post: karel", r"line 2: post: no such post or template file: karel \(searched for .*karel\)"),
        ("post: my.toml", r"line 2: post: no such post or template file: my\.toml \(searched for .*my\.toml\)"),
        ("posts: [krl, krl]", r"line 2: posts\[1\]: krl is given twice; keep one"),
        ("posts: []", r"line 2: posts: "),
        ("posts: [krl]\npost: krl", r"posts: post and posts are both given; keep one"),
        ("jobs: [{toolpath: jobs/a.nc, post: krll}]", r"line 2: jobs\[0\]\.post: no such post .*did you mean 'krl'"),
    ],
)
def test_invalid_post_in_a_list_is_reported_with_its_place(text: str, words: str, tmp_path: Path) -> None:
    folder_of(tmp_path, a="sleep 0")
    listed = tmp_path / "list.yaml"
    more = "" if text.startswith("jobs") else "\ntoolpaths: [jobs/a.nc]"
    listed.write_text(f"machopt_batch: 1\n{text}{more}\n")
    with pytest.raises(InputError, match=words) as caught:
        find_jobs(request_for(listed, tmp_path / "out"))
    assert str(caught.value).startswith(str(listed))


def test_key_contains_post_names_and_the_bytes_of_templates(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0")
    mine = tmp_path / "mine.toml"
    mine.write_text(read_post_text("krl"))
    plain = request_for(jobs, tmp_path / "out")
    keys = [key(plain), *(key(replace(plain, posts=p)) for p in (("krl",), ("rapid",), ("krl", "rapid"), (str(mine),)))]
    assert len(set(keys)) == 5
    with_file = replace(plain, posts=(str(mine),))
    before = key_of(with_file)
    assert isinstance(before, ReadyJob)
    assert str(mine) in before.inputs  # a job whose template changes during the run gives no result
    moved = tmp_path / "elsewhere" / "mine.toml"
    moved.parent.mkdir()
    moved.write_text(mine.read_text())
    assert key(replace(plain, posts=(str(moved),))) == before.key
    mine.write_text(read_post_text("krl").replace("C_DIS", "C_VEL"))
    assert key(with_file) != before.key
    mine.write_text(read_post_text("krl").replace("A6 @{a6:.5f}", "A6 @{a7"))
    faulty = key_of(with_file)
    assert isinstance(faulty, RefusedJob)  # before any job starts
    assert "mine.toml" in faulty.reason


def test_key_contains_the_bytes_of_effect_files(tmp_path: Path) -> None:
    jobs = folder_of(tmp_path, a="sleep 0")
    mine = tmp_path / "mine.py"
    mine.write_text("EFFECTS = []")
    plain = request_for(jobs, tmp_path / "out")
    with_effects = replace(plain, effects=(mine,))
    before = key_of(with_effects)
    assert isinstance(before, ReadyJob)
    assert str(mine) in before.inputs
    assert before.key != key(plain)
    mine.write_text("EFFECTS = [1]")
    assert key(with_effects) != before.key


def test_key_contains_the_template_of_a_cell(tmp_path: Path) -> None:
    import shutil

    jobs = folder_of(tmp_path, a="sleep 0")
    shutil.copytree(CELL, tmp_path / "cell")
    file, post = tmp_path / "cell" / "cell.yaml", tmp_path / "cell" / "own.toml"
    without_controller(tmp_path / "cell")
    file.write_text(file.read_text() + "\ncontroller: {post: own.toml}\n")
    post.write_text(read_post_text("krl"))
    request = request_for(jobs, tmp_path / "out", cell=tmp_path / "cell")
    before = key(request)
    post.write_text(read_post_text("krl").replace("C_DIS", "C_VEL"))
    assert key(request) != before


def test_command_passes_posts_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = folder_of(tmp_path, a="sleep 0")
    requested: list[BatchRequest] = []

    def noted(request: BatchRequest, _: object) -> BatchResult:
        requested.append(request)
        stub = cast(BatchDocument, SimpleNamespace(counts={}))
        return BatchResult(0, stub, tmp_path / "summary.html", 0, 0)

    words = ["batch", str(jobs), "--cell", str(CELL), "-o", str(tmp_path / "out"), "--quiet"]
    scheduler = "tcp://127.0.0.1:8786"
    with monkeypatch.context() as patch:
        patch.setattr(batch_run, "run_batch", noted)
        more = ["--program-tolerance-mm", "0.1", "--scheduler", scheduler]
        assert main([*words, "--post", "krl", "--post", "rapid", *more]) == 0
    assert requested[0].posts == ("krl", "rapid")
    assert (requested[0].extra, requested[0].scheduler) == ({"program_tolerance_mm": 0.1}, scheduler)
    assert main([*words, "--post", "nowhere.toml"]) == 2
    assert "--post: no such post or template file: nowhere.toml" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_unreadable_program_is_the_reason_in_the_summary() -> None:
    part = {"mean": 1e-8, "worst": 1e-8}
    result = {
        "exit_code": 4,
        "verdict": "verification failed",
        "index": "deflection",
        "index_scale": 1.0,
        "worst_point": None,
        "objective": {"gain": [], "chosen": part, "cam_default": part},
        "infeasible_points": [],
        "breaks": [],
        "obstructions": [],
        "toolpath": {"points": 3, "ignored": []},
        "cycle_time_s": 1.0,
        "feed_held_share": 1.0,
        "warnings": [],
        "process": None,
        "verification": {
            "checks": [
                {"name": "cut throughout", "passed": True, "where": ""},
                {"name": "a.src: CAM points", "passed": False, "where": "point 3 is missing"},
            ]
        },
        "programs": [
            {"post": "krl", "files": [], "differences": ["move 3 (line 9) goes elsewhere"]},
            {"post": "csv", "files": [], "differences": []},
        ],
    }
    values = json.loads(json.dumps(result), object_hook=lambda part: SimpleNamespace(**part))
    found = build_summary_row(cast(OptimizeDocument, values))
    assert found.reason == "a.src: CAM points at point 3 is missing"
    assert found.programs == ()  # no program remains in the output folder
