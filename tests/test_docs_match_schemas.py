"""docs/ agrees with the schemas."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
# folders of the repository that contain pages
PLACES = ("docs", "cells", "toolpaths", "benchmarks", "machopt", "tests")


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", DOCS / "make_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_reference_is_current(reference: ModuleType) -> None:
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(), "run python docs/make_reference.py"


def test_every_key_is_described(reference: ModuleType) -> None:
    silent = [
        f"{title}: {name}"
        for title, _, model in reference.FILES
        for name, info in reference.keys(model)
        if not info.description
    ]
    assert silent == []


def test_every_page_is_listed_once_in_the_contents() -> None:
    """`make docs` also detects this and checks anchors; this test needs no Sphinx."""
    folder = DOCS / "site"
    listed: list[Path] = []
    for block in re.findall(r"```\{toctree\}\n(.*?)```", (folder / "index.md").read_text(encoding="utf-8"), re.DOTALL):
        lines = [line for line in block.splitlines() if line and not line.startswith(":")]
        listed += [(folder / (re.sub(r".*<(.*)>", r"\1", line) + ".md")).resolve() for line in lines]
    there = [p for place in PLACES for p in (ROOT / place).rglob("*.md")] + [
        ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")
    ]
    assert sorted(listed) == sorted(p for p in there if p != folder / "index.md")
