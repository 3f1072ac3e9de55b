"""Section ``tilt`` of result.json against points.csv."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from machopt.verification.folder.result_json.comparison_inputs import (
    CheckedPoints,
    ResultComparison,
    check_close,
    check_equal,
)

PRINTED_DEG = 1e-8  # nine decimals
RELATIVE = 1e-9


def check_tilt_section(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the tilts that result.json states.

    Args:
        t: Result.json and everything that it is compared with.
    """
    stated = t.result.tilt
    if "lead_deg" not in t.points:
        yield from check_equal("tilt", stated, None)
        return
    if stated is None:
        yield "tilt is null, yet points.csv has lead_deg"
        return
    table = CheckedPoints.from_file(t)
    for name in ("lead_deg", "side_deg"):
        column = table.get_column(name)
        used = column[t.toolpath.cutting & np.isfinite(column)]
        ends = (float(used.min()), float(used.max())) if len(used) else (0.0, 0.0)
        for end, have, wanted in zip(("lowest", "highest"), getattr(stated, name), ends, strict=True):
            yield from check_close(f"tilt.{name}, {end}", have, wanted, RELATIVE, PRINTED_DEG)
    if stated.bound is not None and not 0.0 <= stated.bound.mean <= stated.bound.worst:
        yield "tilt.bound.mean is not between 0 and tilt.bound.worst"
