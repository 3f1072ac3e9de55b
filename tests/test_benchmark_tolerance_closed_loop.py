"""Predicted tolerances hold for newly drawn arms of an independent simulation."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[1] / "benchmarks" / "tolerance_closed_loop.py"


@pytest.mark.proof
@pytest.mark.parametrize("words", [("--positions", "0.3", "0.45"), ("--positions", "0.15", "--compensate")])
def test_intervals_and_probabilities_hold_on_an_independent_arm(words: tuple[str, ...]) -> None:
    spec = importlib.util.spec_from_file_location("tolerance_closed_loop", BENCHMARK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    assert module.main(["--truths", "100", *words]) == 0
