"""Output options overwrite neither inputs nor foreign files; with ``--force`` they do."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from machopt.api.figure import Figure
from machopt.api.table import Table
from machopt.cli import main
from machopt.data_types.manifest import FolderManifest
from machopt.errors import InputError
from machopt.output import write_json, write_manifest, write_output_folder
from machopt.output.single_file import write_text_file

CELL = Path(__file__).parents[1] / "cells" / "kr500_milling"
TABLE = (
    "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n0,0,10,0,0,1,rapid,\n0,0,0,0,0,1,cut,600\n20,0,0,0,0,1,cut,600\n"
    "0,0,10,0,0,1,rapid,\n"
)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    file = tmp_path / "path.csv"
    file.write_text(TABLE)
    return file


def _keep_path(file: Path) -> Path:
    return file


def _add_dots(file: Path) -> Path:
    (file.parent / "sub").mkdir()
    return file.parent / "sub" / ".." / file.name


def _symlink(file: Path) -> Path:
    link = file.with_name("page.html")
    link.symlink_to(file)
    return link


def _chain(file: Path) -> Path:
    first = file.with_name("first")
    first.symlink_to(file)
    link = file.with_name("second.html")
    link.symlink_to(first)
    return link


def _hard_link(file: Path) -> Path:
    link = file.with_name("hard.html")
    os.link(file, link)
    return link


def _linked_folder(file: Path) -> Path:
    link = file.parent / "elsewhere"
    link.symlink_to(file.parent)
    return link / file.name


def _build_foreign_path(file: Path) -> Path:
    other = file.with_name("thesis.html")
    other.write_text("precious")
    return other


def _empty(file: Path) -> Path:
    other = file.with_name("empty.html")
    other.write_text("")
    return other


def _folder(file: Path) -> Path:
    other = file.with_name("folder.html")
    other.mkdir()
    return other


def _pipe(file: Path) -> Path:
    other = file.with_name("pipe.html")
    os.mkfifo(other)
    return other


def _forged_seal(file: Path) -> Path:
    other = file.with_name("forged.html")
    other.write_text(f"mine\n<!-- machopt sha256:{'0' * 64} -->\n")
    return other


def _edit_file(file: Path) -> Path:
    other = file.with_name("edited.html")
    write_text_file(other, "<html></html>\n")
    other.write_text(other.read_text().replace("<html>", "<html>my note"))
    return other


def _read_only(file: Path) -> Path:
    other = file.with_name("kept.html")
    write_text_file(other, "<html>1</html>\n")
    other.chmod(0o444)
    return other


def _upper_case(file: Path) -> Path:
    other = file.with_name("PATH.HTML")
    other.write_text("another file, or the same where case does not count")
    return other


NAMES: list[Callable[[Path], Path]] = [
    _keep_path, _add_dots, _symlink, _chain, _hard_link, _linked_folder, _build_foreign_path, _empty, _folder,
    _pipe, _forged_seal, _edit_file, _read_only, _upper_case,
]  # fmt: skip


def _bytes(file: Path) -> bytes | None:
    return file.read_bytes() if file.is_file() else None


@pytest.mark.parametrize("name", NAMES)
def test_html_never_overwrites(name: Callable[[Path], Path], table: Path) -> None:
    out = name(table)
    before = _bytes(out)
    assert main(["inspect", str(table), "--html", str(out), "--quiet"]) == 2
    assert _bytes(out) == before
    assert table.read_text() == TABLE


@pytest.mark.parametrize("name", [_build_foreign_path, _edit_file, _read_only, _forged_seal])
def test_force_overwrites_and_has_no_abbreviation(name: Callable[[Path], Path], table: Path) -> None:
    out = name(table)
    before = _bytes(out)
    with pytest.raises(SystemExit, match="2"):
        main(["inspect", str(table), "--html", str(out), "--quiet", "--for"])
    assert _bytes(out) == before
    assert main(["inspect", str(table), "--html", str(out), "--quiet", "--force"]) == 0
    assert _bytes(out) != before


def test_page_of_machopt_is_replaced(table: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    for text in (TABLE, TABLE.replace("20,", "25,")):
        table.write_text(text)
        assert main(["inspect", str(table), "--html", str(page), "--quiet"]) == 0
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".partial")]


def test_picture_never_overwrites(tmp_path: Path) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    foreign = tmp_path / "logo.svg"
    foreign.write_text("<svg>mine</svg>")
    assert main(["validate", str(cell), "--picture", str(foreign), "--quiet"]) == 2
    assert foreign.read_text() == "<svg>mine</svg>"
    for _ in range(2):
        assert main(["validate", str(cell), "--picture", str(tmp_path / "new.svg"), "--quiet"]) == 0
    link = tmp_path / "cell.svg"
    link.symlink_to(cell / "cell.yaml")
    before = (cell / "cell.yaml").read_bytes()
    assert main(["validate", str(cell), "--picture", str(link), "--quiet"]) == 2
    assert (cell / "cell.yaml").read_bytes() == before


def test_library_files_never_overwrite(tmp_path: Path) -> None:
    for name in ("a.svg", "a.csv"):
        (tmp_path / name).write_text("mine")
    with pytest.raises(InputError):
        Figure("<svg/>").save(tmp_path / "a.svg")
    columns = Table({"x_mm": np.array([1.0, 2.0])})
    with pytest.raises(InputError):
        columns.write(tmp_path / "a.csv")
    assert [(tmp_path / name).read_text() for name in ("a.svg", "a.csv")] == ["mine", "mine"]
    columns.write(tmp_path / "b.csv")
    columns.write(tmp_path / "b.csv")  # the same bytes: no data are lost
    with pytest.raises(InputError):
        Table({"x_mm": np.array([3.0])}).write(tmp_path / "b.csv")
    Table({"x_mm": np.array([3.0])}).write(tmp_path / "b.csv", force=True)
    assert Figure("<svg/>").save(tmp_path / "a.svg", force=True).read_text() != "mine"


def _output(out: Path) -> None:
    with write_output_folder(out) as folder:
        write_json(folder / "result.json", {"machopt_result": 1})
        (folder / "krl").mkdir()
        (folder / "krl" / "job.src").write_text("LIN")
        write_manifest(folder, FolderManifest(command="optimize", verdict="", exit_code=0, versions={}, inputs=()), {})


def _with_manifest_gone(out: Path) -> str:
    (out / "manifest.json").unlink()
    return "krl/job.src"


def _with_program_edited(out: Path) -> str:
    (out / "krl" / "job.src").write_text("PTP")
    return "krl/job.src"


def _with_file_added(out: Path) -> str:
    (out / "krl" / "mine.src").write_text("PTP")
    return "krl/mine.src"


def _with_program_linked(out: Path) -> str:
    target = out.parent / "job.src"
    (out / "krl" / "job.src").rename(target)
    (out / "krl" / "job.src").symlink_to(target)
    return "krl/job.src"


def _with_pipe(out: Path) -> str:
    (out / "result.json").unlink()
    os.mkfifo(out / "result.json")
    return "result.json"


def _with_huge_file(out: Path) -> str:
    os.truncate(out / "krl" / "job.src", 3 << 30)
    return "krl/job.src"


CHANGES: list[Callable[[Path], str]] = [
    _with_manifest_gone, _with_program_edited, _with_file_added, _with_program_linked, _with_pipe, _with_huge_file
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_edited_output_is_preserved(change: Callable[[Path], str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    _output(out)
    name = change(out)
    with pytest.raises(InputError, match=name), write_output_folder(out):
        pytest.fail("not reached")
    assert os.path.lexists(out / name)
    with write_output_folder(out, force=True) as folder:
        (folder / "new").write_text("1")
    assert [p.name for p in out.iterdir()] == ["new"]


def test_input_inside_the_output_is_preserved(tmp_path: Path) -> None:
    out = tmp_path / "out"
    _output(out)
    link = tmp_path / "job.src"
    link.symlink_to(out / "krl" / "job.src")
    for given in (out / "krl" / "job.src", link, out, tmp_path / "out" / ".." / "out" / "krl"):
        with pytest.raises(InputError), write_output_folder(out, inputs=(given,)):
            pytest.fail("not reached")
    with write_output_folder(out, inputs=(tmp_path / "elsewhere",)):
        pass


def test_every_command_with_an_output_has_force(capsys: pytest.CaptureFixture[str]) -> None:
    for command in (
        "optimize",
        "inspect",
        "validate",
        "identify",
        "process",
        "plan-poses",
        "map",
        "diagnose",
        "place",
        "batch",
        "view",
    ):
        with pytest.raises(SystemExit, match="0"):
            main([command, "--help"])
        with pytest.raises(SystemExit, match="0"):
            main([command, "--help-advanced"])
        assert "--force " in capsys.readouterr().out.replace("\n", " "), command
    with pytest.raises(SystemExit, match="2"):
        main(["map", str(CELL), "-o", "x", "--force=0,0,1"])
    assert "--force" in capsys.readouterr().err


def test_progress_of_place_never_overwrites(tmp_path: Path, table: Path) -> None:
    journal = tmp_path / "out.progress.jsonl"
    journal.write_text("my notes\n")
    assert main(["place", str(CELL), str(table), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    assert journal.read_text() == "my notes\n"
