"""Pipes, devices, sockets and huge files in an output folder are reported within seconds and never opened."""

from __future__ import annotations

import os
import shutil
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from output_damage.damage_case import Job, copy_job, find_single_file, update_manifest_hashes

from machopt.cli import main

SECONDS = 20.0  # one command on a loaded machine; a pipe would block forever


@pytest.fixture(scope="module")
def planned(damage_job: Callable[[str], Job]) -> Job:
    return damage_job("pass")


def _pipe(file: Path) -> None:
    file.unlink(missing_ok=True)
    os.mkfifo(file)


def _zeros(file: Path) -> None:
    file.unlink(missing_ok=True)
    file.symlink_to("/dev/zero")


def _socket(file: Path) -> None:
    file.unlink(missing_ok=True)
    here = Path.cwd()
    os.chdir(file.parent)  # the name of a socket is limited to about one hundred bytes
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(file.name)
    finally:
        os.chdir(here)


HUGE = 3 << 30  # bytes, all of them zero
HUGE_SHA256 = "305b66a59d15b252092fbda9d09711230c429f351897cbd430e7b55a35fd3b97"


def _huge(file: Path) -> None:
    file.unlink(missing_ok=True)
    file.touch()
    os.truncate(file, HUGE)


KINDS = (_pipe, _zeros, _socket, _huge)
NAMES = ("trajectory.csv", "points.csv", "result.json", "manifest.json", "report.html", "*.src", "*.dat", "stray.src")
CASES = [(kind, name) for kind in KINDS for name in NAMES]


def _file(job: Job, name: str) -> Path:
    return find_single_file(job.out, name) if "*" in name else job.out / name


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_verify_answers(kind: Callable[[Path], None], name: str, planned: Job, tmp_path: Path) -> None:
    job = copy_job(planned, tmp_path)
    kind(_file(job, name))
    begun = time.monotonic()
    assert main(["verify", str(job.cell), str(job.toolpath), str(job.out), "--quiet"]) == 4
    assert time.monotonic() - begun < SECONDS


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in KINDS for name in ("points.csv", "report.html")])
def test_view_and_optimize_answer(kind: Callable[[Path], None], name: str, planned: Job, tmp_path: Path) -> None:
    job = copy_job(planned, tmp_path)
    kind(_file(job, name))
    begun = time.monotonic()
    assert main(["view", str(job.out), "--as-it-is", "--quiet"]) == 2
    assert main(["optimize", str(job.cell), str(job.toolpath), "-o", str(job.out), "--quiet"]) == 2
    assert time.monotonic() - begun < SECONDS
    assert os.path.lexists(_file(job, name))


def test_huge_listed_file_is_refused(planned: Job, tmp_path: Path) -> None:
    job = copy_job(planned, tmp_path)
    _huge(job.out / "points.csv")
    update_manifest_hashes(job.out, {"points.csv": HUGE_SHA256})
    assert main(["verify", str(job.cell), str(job.toolpath), str(job.out), "--quiet"]) == 4


def test_output_path_is_a_pipe_or_a_device(planned: Job, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for out in (str(tmp_path / "pipe"), "/dev/zero"):
        assert main(["verify", str(planned.cell), str(planned.toolpath), out, "--quiet"]) == 2
        assert main(["optimize", str(planned.cell), str(planned.toolpath), "-o", out, "--quiet"]) == 2


def test_endless_folder_is_not_read_forever(planned: Job, tmp_path: Path) -> None:
    job = copy_job(planned, tmp_path)
    shutil.rmtree(job.out)
    job.out.mkdir()
    os.mkfifo(job.out / "manifest.json")
    assert main(["verify", str(job.cell), str(job.toolpath), str(job.out), "--quiet"]) == 4
