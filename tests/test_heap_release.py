"""Freed memory is returned to the operating system."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from machopt.numerics.heap_release import release_free_memory


def resident_mib() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_freed_blocks_below_a_live_one_are_returned() -> None:
    blocks = [np.ones(1 << 13) for _ in range(2000)]  # 64 KiB each: below the size that is returned immediately
    last = blocks[-1]
    full = resident_mib()
    del blocks
    assert release_free_memory()
    assert resident_mib() < full - 60
    assert last.sum() == 1 << 13
