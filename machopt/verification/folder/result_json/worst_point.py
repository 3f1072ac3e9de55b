"""Worst point of result.json, compared with points.csv."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from machopt.data_types.documents.optimize_document import WorstPointSection
from machopt.verification.folder.result_json.comparison_inputs import (
    CheckedPoints,
    ResultComparison,
    check_close,
    check_equal,
    require_number,
)
from machopt.verification.folder.result_json.objective_and_gains import PRINTED_TOLERANCE

LAST_DIGITS = {
    "k_axial_N_mm": 6e-5,
    "k_normal_N_mm": 6e-5,
    "k_jiao_x_N_mm": 6e-5,
    "deflection_mm": 1e-6,
    "gamma_deg": 1e-6,
}
Z_90_PERCENT = 1.6448536269514722  # standard deviations of a 90 % interval


def check_worst_point(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the worst point.

    Args:
        t: Result.json and everything that it is compared with.
    """
    points = CheckedPoints.from_file(t)
    worst = t.result.worst_point
    cost = points.compute_cost(t)
    if not np.isfinite(cost).any():
        yield from check_equal("worst_point", worst, None)
        return
    if worst is None:
        yield "worst_point is null, yet points are cut to"
        return
    n, most = worst.point, float(np.nanmax(cost))
    rounding = points.cost_rounding(t)
    if not cost[n] >= most * (1 - PRINTED_TOLERANCE) - rounding[n] - rounding[int(np.nanargmax(cost))]:
        yield f"worst_point is {n}, but point {int(np.nanargmax(cost))} is softer"
    for key in ("k_axial_N_mm", "k_normal_N_mm", "deflection_mm", "k_jiao_x_N_mm", "gamma_deg"):
        yield from check_close(
            f"worst_point.{key}", getattr(worst, key), points.get_column(key)[n], PRINTED_TOLERANCE, LAST_DIGITS[key]
        )
    yield from _check_worst_deflection(t, worst)
    for joint, degrees in enumerate(worst.q_deg, 1):  # to four decimals
        yield from check_close(f"worst_point.q{joint}", degrees, points.get_column(f"q{joint}_deg")[n], 0.0, 6e-5)
    yield from check_equal("worst_point.q_deg", len(worst.q_deg), 6)


def _check_worst_deflection(t: ResultComparison, worst: WorstPointSection) -> Iterable[str]:
    """Both parts make up the whole, and every interval lies about its value; how it divides is the planner's alone."""
    parts = worst.deflection_along_mm, worst.deflection_across_mm
    if worst.deflection_mm is None or None in parts:
        intervals = (worst.deflection_ci90_mm, worst.deflection_along_ci90_mm, worst.deflection_across_ci90_mm)
        yield from check_equal("worst_point.deflection", [worst.deflection_mm, *parts, *intervals], [None] * 6)
        return
    points, room = CheckedPoints.from_file(t), LAST_DIGITS["deflection_mm"]
    whole, along, across = (require_number("worst_point.deflection", v) for v in (worst.deflection_mm, *parts))
    yield from check_close(
        "worst_point.deflection_mm of its parts", math.hypot(along, across), whole, PRINTED_TOLERANCE, room
    )
    std = points.get_column("deflection_std_mm")[worst.point] if "deflection_std_mm" in points.table else math.nan
    if worst.deflection_ci90_mm is None or not math.isfinite(std):
        yield from check_equal(
            "worst_point.deflection_ci90_mm", worst.deflection_ci90_mm is None, not math.isfinite(std)
        )
    else:
        for found, wanted in zip(
            worst.deflection_ci90_mm, (whole - Z_90_PERCENT * std, whole + Z_90_PERCENT * std), strict=True
        ):
            yield from check_close("worst_point.deflection_ci90_mm", found, wanted, PRINTED_TOLERANCE, 3.0 * room)
    for name, interval, value in (
        ("along", worst.deflection_along_ci90_mm, along),
        ("across", worst.deflection_across_ci90_mm, across),
    ):
        if interval is not None:
            yield from check_close(
                f"worst_point.deflection_{name}_ci90_mm", sum(interval) / 2.0, value, PRINTED_TOLERANCE, room
            )
