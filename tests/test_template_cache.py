"""Compiled templates are cached, and a missing cache is not a failure."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from jinja2 import DictLoader, Environment

from machopt.report.template_cache import TemplateCache

TEXT = "hello {{ name }}"


def build_environment(folder: Path, text: str = TEXT, options: str = "none") -> Environment:
    return Environment(loader=DictLoader({"a.html": text}), bytecode_cache=TemplateCache(folder, options))


@pytest.fixture(autouse=True)
def _writing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)


def test_template_is_compiled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "stored"
    assert build_environment(folder).get_template("a.html").render(name="you") == "hello you"
    (file,) = folder.iterdir()
    assert sys.implementation.cache_tag in file.name
    monkeypatch.setattr(Environment, "compile", None)  # any compilation fails
    assert build_environment(folder).get_template("a.html").render(name="me") == "hello me"


def test_template_is_compiled_again_after_any_change(tmp_path: Path) -> None:
    build_environment(tmp_path).get_template("a.html")
    assert build_environment(tmp_path, "bye {{ name }}").get_template("a.html").render(name="you") == "bye you"
    build_environment(tmp_path, options="other").get_template("a.html")
    assert len(list(tmp_path.iterdir())) == 2


def test_damaged_cache_file_is_rebuilt(tmp_path: Path) -> None:
    build_environment(tmp_path).get_template("a.html")
    (file,) = tmp_path.iterdir()
    good = file.read_bytes()
    for bad in (b"", good[:9], b"x" * len(good)):
        file.write_bytes(bad)
        assert build_environment(tmp_path).get_template("a.html").render(name="you") == "hello you"
        assert file.read_bytes() == good


def test_nothing_is_stored_where_impossible_or_forbidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    assert build_environment(tmp_path / "file").get_template("a.html").render(name="you") == "hello you"
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    build_environment(tmp_path / "folder").get_template("a.html")
    assert not (tmp_path / "folder").exists()
