"""Unreadable, endless and too large files: every reader refuses them immediately."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from machopt.cell.kinematics_file import load_kinematics
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cell.urdf import read_urdf
from machopt.cli import main
from machopt.errors import InputError
from machopt.file_formats import file_reading
from machopt.measurement.recording.recording_table import AllowedColumns, read_table
from machopt.options.plan_option_reader import load_options
from machopt.programs.program_writer import load_post
from machopt.toolpath.toolpath_reader import read_toolpath

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "toolpath": ("part.nc", read_toolpath),
    "urdf": ("robot.urdf", read_urdf),
    "stiffness": ("stiffness.yaml", load_stiffness),
    "kinematics": ("kinematics.yaml", load_kinematics),
    "plan": ("plan.yaml", lambda path: load_options(plan_file=path)),
    "post": ("post.toml", load_post),
    "readings": (
        "data.csv",
        lambda path: read_table(path, AllowedColumns(numbers=("x",), words=(), listed_names="x", refused_names={})),
    ),
}


def pipe(path: Path) -> None:
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.mkdir()


def circle(path: Path) -> None:
    path.symlink_to(path.name)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(3 << 30)  # 3 GiB without allocated blocks


def nothing(path: Path) -> None:
    pass


KINDS = [
    (pipe, "is a named pipe"),
    (folder, "is a directory"),
    (circle, "cannot be read: Too many levels"),
    (device, "is a device"),
    (huge, "holds 3 GiB; expected"),
    (nothing, "no such file"),
]


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(("make", "part"), KINDS, ids=[k.__name__ for k, _ in KINDS])
def test_unreadable_file_is_refused_by_every_reader(
    make: Callable[[Path], None], part: str, reader: str, tmp_path: Path
) -> None:
    name, read = READERS[reader]
    make(tmp_path / name)
    with pytest.raises(InputError, match=part) as caught:
        read(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("name", "part"),
    [("x" * 300, "File name too long"), ("a\nb", "control characters"), ("a\0b", "NUL"), ("\udcff", "no UTF-8")],
    ids=["over-long", "newline", "NUL", "not UTF-8"],
)
def test_impossible_file_names_are_refused(name: str, part: str, reader: str, tmp_path: Path) -> None:
    file, read = READERS[reader]
    with pytest.raises(InputError, match=part):
        read(tmp_path / (name + Path(file).suffix))


def test_growing_file_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"x" * 100)
    monkeypatch.setattr(
        file_reading, "_check_file_status", lambda *_: None
    )  # simulates a file that grows after its size was checked
    with pytest.raises(InputError, match="holds more than"):
        file_reading.read_file(file, expected="a file", most=99)
    assert len(file_reading.read_file(file, expected="a file", most=100)) == 100


@pytest.mark.parametrize(
    "words",
    [
        ["optimize", "{p}", "{p}", "-o", "{o}"],
        ["inspect", "{p}"],
        ["identify", "{p}", "{p}", "-o", "{o}"],
        ["process", "{p}", "{p}", "-o", "{o}"],
        ["diagnose", "{p}", "{p}", "-o", "{o}"],
        ["map", "{p}", "-o", "{o}"],
        ["plan-poses", "{p}", "-o", "{o}"],
        ["batch", "{p}", "-o", "{o}"],
        ["verify", "{p}", "{p}", "{p}"],
    ],
    ids=lambda w: w[0],
)
def test_no_command_waits_for_a_pipe(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe(tmp_path / "pipe")
    code = main([w.format(p=tmp_path / "pipe", o=tmp_path / "out") for w in words])
    assert code == 2
    assert capsys.readouterr().err.count("machopt: ") == 1
    assert not (tmp_path / "out").exists()
