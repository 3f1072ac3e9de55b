"""Predicted errors of milled walls hold for newly drawn arms of an independent simulation."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.mark.proof
@pytest.mark.parametrize("words", [("--tolerances", "0.04"), ("--tolerances", "0.04", "--compensate")])
def test_intervals_and_probabilities_hold_on_an_independent_arm(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("wall_closed_loop", BENCHMARKS / "wall_closed_loop.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    assert module.main(["--truths", "60", "--points", "50", *words]) == 0
