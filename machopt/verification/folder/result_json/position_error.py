"""Position error section of result.json, compared with the cell's stiffness file and points.csv."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from machopt.data_types.stiffness import PositionError
from machopt.numerics.array_types import Array
from machopt.verification.folder.result_json.comparison_inputs import (
    RELATIVE_TOLERANCE,
    CheckedPoints,
    ResultComparison,
    check_close,
    check_equal,
)

COVERED_RANGE_DEG = 1.0  # beyond the last measured angle: poses are rounded and sag, as the planner counts it too
PRINTED_ANGLE_DEG = 0.3  # between encoder angles and true angles, and of digits: no side of the edge is sure


def check_position_error(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the position error, and with the joints that exceed its measured range.

    Args:
        t: Result.json and everything that it is compared with.
    """
    stated, known = t.result.position_error, None if t.cell.stiffness is None else t.cell.stiffness.position
    q = _list_cut_joints(t)
    if known is None or not len(q):
        yield from check_equal("position_error", stated, None)
        return
    if stated is None:
        yield "position_error is null, yet the cell's stiffness holds one"
        return
    corrected = bool(t.cell.kinematics)
    yield from check_equal("position_error.corrected", stated.corrected, corrected)
    std, beyond = (known.std if corrected else known.plain), max(known.plain, known.std)
    for name, found, expected in (
        ("std_mm", stated.std_mm, std),
        ("beyond_mm", stated.beyond_mm, beyond),
        ("noise_mm", stated.noise_mm, known.noise),
    ):
        yield from check_close(f"position_error.{name}", found, 1e3 * expected, RELATIVE_TOLERANCE, RELATIVE_TOLERANCE)
    yield from check_equal("position_error.poses", stated.poses, known.poses)
    yield from _check_outside_range(stated.outside_joints, stated.outside_percent or 0.0, q, known)


def _list_cut_joints(t: ResultComparison) -> Array:
    """(N, 6) deg at the points that are cut to and have a configuration."""
    points = CheckedPoints.from_file(t)
    rows = points.is_ok & t.toolpath.cutting
    return np.stack([points.get_column(f"q{j + 1}_deg")[rows] for j in range(6)], axis=1)


def _check_outside_range(
    stated_joints: tuple[int, ...], percent: float, q: Array, known: PositionError
) -> Iterable[str]:
    """The planner counts places of its own between the points: what all or none of the points show, it shows too."""
    low, high = np.degrees(known.joints).T
    far = np.maximum(low - q, q - high) - COVERED_RANGE_DEG  # > 0: outside
    surely = np.flatnonzero((far > PRINTED_ANGLE_DEG).any(axis=0)) + 1
    if missing := [int(j) for j in surely if j not in stated_joints]:
        yield f"position_error.outside_joints lacks joint {', '.join(map(str, missing))}: beyond, in points.csv"
    if not 0.0 <= percent <= 100.0 or bool(stated_joints) != (percent > 0.0):
        yield f"position_error.outside_percent is {percent:.6g} for joints {list(stated_joints)}"
    if (far.max(axis=1) > PRINTED_ANGLE_DEG).all() and percent < 100.0 - 1e-9 and len(q) > 1:
        yield f"position_error.outside_percent is {percent:.6g}, yet every point of points.csv is outside"
