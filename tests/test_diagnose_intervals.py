"""Intervals of findings: what another law of the same effect may add to them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import machopt

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "concealed"))
import generate


@pytest.mark.parametrize("size", ["medium", "large"])
def test_a_law_that_nothing_holds_does_not_widen_the_interval_of_one_that_is_sure(tmp_path: Path, size: str) -> None:
    """A full matrix at the tool fits as well as a body of revolution; it said 0.04 µm/N with −131 … 131."""
    ((name, case, seed),) = generate.chosen("dev", [f"deflection/tool_compliance.9/{size}"], False, 1)
    generate.generate((name, case, seed, "dev", tmp_path, True))
    found = machopt.diagnose(tmp_path / name / "cell", tmp_path / name / "recording")
    finding = next(f for f in found.result.findings if f.effect == "tool_compliance")
    true = json.loads((tmp_path / f"{name}.truth.json").read_text(encoding="utf-8"))["effects"][0]["size"]["value"]
    low, high = finding.parameters["lateral_compliance"].ci95
    assert 0.0 < low < true < high < 3.0 * true
