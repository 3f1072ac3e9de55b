"""A second, small reader of CAM files and robot programs, by other means than machopt's.

It imports nothing of machopt and was written from the formats' manuals and real files without a look at machopt's
readers. It is a line scanner with regular expressions and modal state, on purpose simple: what it does not know it
refuses with a reason. It serves to judge: ``benchmarks/cam_reader_comparison.py`` compares extents, counts, lengths and
feeds of both readers, ``tests/test_benchmark_second_cam_reader.py`` does the same on samples made by hand.
"""

from __future__ import annotations

from pathlib import Path

from second_cam_reader.format_detection import reader_for
from second_cam_reader.sampled_path import NotReadError, Path3

__all__ = ["NotReadError", "Path3", "read"]


def read(file: Path) -> Path3:
    """The path of one file.

    Raises:
        NotReadError: The file is of no family known here, or holds something this reader does not do.
    """
    raw = file.read_bytes()
    if b"\0" in raw:
        raise NotReadError("binary")
    return reader_for(file, raw.decode("latin-1"))
