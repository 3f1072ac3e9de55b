"""Peak memory of a job with many holes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
from drilling_memory import measure

BASE = 400.0  # MiB of a job with a few holes, including compiled code and the bodies of the cell
PER_HOLE = 0.6  # MiB, six stations with a grid of 72 rotations and 8 branches
PER_SAMPLE = 1.1e-3  # MiB per sample of the motion


@pytest.mark.slow
@pytest.mark.parametrize(("holes", "feed_mm_min"), [(200, 500.0), (20, 10.0)])
def test_peak_memory_grows_slowly_with_the_holes(tmp_path: Path, holes: int, feed_mm_min: float) -> None:
    code, peak, _, _ = measure(holes, feed_mm_min, tmp_path)
    assert code == 0
    (table,) = tmp_path.glob("out_*/trajectory.csv")
    samples = table.read_bytes().count(b"\n")
    assert peak < BASE + PER_HOLE * holes + PER_SAMPLE * samples
