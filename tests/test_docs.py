"""The pages of docs/ say what the schemas say."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", DOCS / "make_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_is_current(reference: ModuleType) -> None:
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(), "run python docs/make_reference.py"


def test_every_key_says_what_it_is(reference: ModuleType) -> None:
    silent = [
        f"{title}: {name}"
        for title, _, model in reference.FILES
        for name, info in reference.keys(model)
        if not info.description
    ]
    assert silent == []
