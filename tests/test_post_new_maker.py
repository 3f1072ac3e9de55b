"""A new maker is one folder (post, reader, checks and template of a toy controller) without other changes."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from output_damage.damage_case import Job, copy_job, plan_table, update_manifest_hashes

import machopt.programs
from machopt.cli import main
from machopt.errors import PostError
from machopt.programs import maker_registry
from machopt.programs.program_reader import read_program
from machopt.programs.program_writer import list_post_names, load_post
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
TOY = Path(__file__).with_name("toy_maker")
CACHED = ("list_languages", "find_language", "list_template_languages", "list_templates")
ROWS = [
    (-40.0, 0.0, 40.0, "rapid", ""),
    (-40.0, 0.0, 2.0, "cut", "600"),
    (0.0, 20.0, 2.0, "cut", "600"),
    (40.0, 0.0, 2.0, "cut", "600"),
    (40.0, 0.0, 40.0, "rapid", ""),
]


def _forget_makers() -> None:
    for name in CACHED:
        getattr(maker_registry, name).cache_clear()
    for name in [n for n in sys.modules if n.startswith("machopt.programs.toy_maker")]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Job]:
    """Return a plan with the program of the toy maker; only its folder is added to the search path of the makers."""
    shelf = tmp_path_factory.mktemp("shelf")
    shutil.copytree(TOY, shelf / "toy_maker")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machopt.programs, "__path__", [*machopt.programs.__path__, str(shelf)])
        _forget_makers()
        yield plan_table(tmp_path_factory.mktemp("job"), ROOT / "cells" / "kr500_milling", ROWS, posts=("toy",))
    _forget_makers()


def test_without_its_folder_the_maker_is_unknown() -> None:
    assert "toy" not in list_post_names()
    with pytest.raises(PostError, match="no post is named 'toy'"):
        load_post("toy")


def test_no_maker_is_imported_outside_its_folder() -> None:
    """Only a maker's own folder imports the modules of the maker."""
    package = ROOT / "machopt"
    makers = [language.package for language in maker_registry.list_languages()]
    assert len(set(makers)) == 8
    named = [
        (file.relative_to(package).as_posix(), maker)
        for file in package.rglob("*.py")
        for maker in makers
        if maker in file.read_text(encoding="utf-8") and maker.rpartition(".")[2] not in file.parts
    ]
    assert named == []


def test_new_post_is_listed_and_its_program_is_read_back(planned: Job) -> None:
    """``plan_table`` fails if a check of the program fails."""
    assert "toy" in list_post_names()
    (file,) = planned.out.glob("*.toy")
    program = read_program(file)
    assert program.dialect == "toy"
    assert len(program) >= len(ROWS)
    assert {str(c["wrist"]) for c in program.configuration if "wrist" in c} <= {"up", "down"}
    path = read_toolpath(file)
    assert path.format == "robot/toy"
    assert path.cutting.sum() >= 3


def test_verify_reads_the_new_program_and_detects_an_error(planned: Job, tmp_path: Path) -> None:
    job = copy_job(planned, tmp_path)
    words = [str(job.cell), str(job.toolpath), str(job.out), "--set", "rotation_step_deg=15", "--quiet"]
    assert main(["verify", *words]) == 0
    (file,) = job.out.glob("*.toy")
    text = file.read_text()
    other = {"WRIST=up": "WRIST=down", "WRIST=down": "WRIST=up"}
    found = next(word for word in other if word in text)
    file.write_text(text.replace(found, other[found], 1))
    update_manifest_hashes(job.out)
    assert main(["verify", *words]) == 4
