"""Tutorials run, and the pictures of the documentation are current."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import pytest

from machopt.cli import main

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def list_commands(page: Path) -> list[list[str]]:
    """Return the words of every command in the shell blocks of a page."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    return [shlex.split(line, comments=True) for block in blocks for line in block.splitlines() if line.strip()]


@pytest.mark.proof
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_tutorial_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each command ends with exit status 0, in the order of the page."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    for name in ("cells", "toolpaths", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    commands = list_commands(page)
    assert len(commands) >= 4
    for words in commands:
        if words[0] == "machopt":
            assert main([*words[1:], "--quiet"]) == 0, words
        else:
            program = [sys.executable, *words[1:]] if words[0] == "python" else words
            subprocess.run(program, check=True, timeout=120)


def test_every_tutorial_has_a_picture() -> None:
    assert len(TUTORIALS) == 4
    for page in TUTORIALS:
        pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
        assert pictures
        assert all((page.parent / name).is_file() for name in pictures)


@pytest.mark.proof
def test_pictures_are_current(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A redrawn picture has the same kinds of shapes, their number within two percent,
    and the same words except numbers."""
    monkeypatch.syspath_prepend(str(DOCS))
    spec = importlib.util.spec_from_file_location("make_pictures", DOCS / "make_pictures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)
    names = {p.name for p in (DOCS / "pictures").glob("*.svg")}
    assert {p.name for p in tmp_path.glob("*.svg")} == names
    for name in names:
        old, new = (ET.parse(folder / name).getroot() for folder in (DOCS / "pictures", tmp_path))
        counts = [Counter(str(e.tag) for e in root.iter()) for root in (old, new)]
        assert counts[0].keys() == counts[1].keys(), name
        for tag, count in counts[0].items():
            assert abs(count - counts[1][tag]) <= max(2, 0.02 * count), (name, tag)
        words = [
            {re.sub(r"[\d.,−-]+", "#", e.text or "") for e in root.iter() if str(e.tag).endswith("text")}
            for root in (old, new)
        ]
        assert words[0] == words[1], name
