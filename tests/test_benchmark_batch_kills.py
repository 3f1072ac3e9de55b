"""Short run of the benchmark of killed batches: finished jobs are preserved."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.proof
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_killed_batches_lose_nothing() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "batch_kills.py"), "--kills", "6"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WRONG" not in done.stdout
    assert "killed" in done.stdout  # otherwise nothing was tested
