"""The table of thresholds: each says what it is and where it comes from, and what it names is there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from machopt.diagnose import calibrated

ROOT = Path(__file__).resolve().parent.parent


def test_every_threshold_says_what_it_is_and_where_its_number_comes_from() -> None:
    rows = list(calibrated.every())
    assert len({(r.concern, r.name) for r in rows}) == len(rows) > 50
    for row in rows:
        assert row.why
        assert row.value == row.value  # a number
        assert row.origin.how in ("measured", "statistics", "judgement")
        if row.origin.how == "measured":
            assert (ROOT / row.origin.script).is_file()
            assert row.origin.cases in ("dev", "sealed")
            assert len(row.origin.date) == len("2026-11-21")


def test_the_script_prints_the_table_again() -> None:
    said = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "thresholds.py")],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout
    for row in calibrated.every():
        assert f"{row.concern.lower()}.{row.name}" in said
