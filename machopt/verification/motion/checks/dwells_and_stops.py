"""Check that the arm is at rest where the file dwells or stops, at that very point and as long as the file says.

A rest between samples is detected by the steps next to it: from rest, an axis with jerk limit J moves at most J h³ /
6 within a sample period h.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import VerificationCheck, build_count_check
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

STILL_TOLERANCE = 1e-9  # rad or m between two rows of a standing machine: less than the table's decimals
REST_STEP_FACTOR = 1.1  # of the way an axis can make from rest within a sample
PRINTED_TOLERANCE = 2e-8  # rad or m: two roundings of the table's decimals
SAME_PLACE_UM = 2  # of one place: points that lie closer than this (µm) to the point are that place
TIME_TOLERANCE_S = 1e-6  # s


def check_dwells_and_stops(
    motion: ExportedMotion,
    toolpath: Toolpath,
    points: ExportedPoints,
    locations: SampleLocations,
    place: tuple[Array, Array],
    cell: Cell,
) -> list[VerificationCheck]:
    """One check where the file dwells or stops, none elsewhere.

    Args:
        motion: trajectory.csv.
        toolpath: with its events.
        points: points.csv; points that it gives up have no values.
        locations: the motion against the toolpath.
        place: (P,), (P, 3) m: fractional index and place of the commanded polyline's corners.
        cell: its limits of jerk.
    """
    programmed = _list_dwells(toolpath)
    if not programmed:
        return []
    given_up = set(points.point[~points.ok].tolist())
    step = np.abs(np.diff(motion.joints, axis=0))
    still = np.append(False, (step <= STILL_TOLERANCE).all(axis=1))  # (S,) the step that ends here
    reach = REST_STEP_FACTOR * cell.limits.jerk[: step.shape[1]] * motion.sample_time**3 / 6.0 + PRINTED_TOLERANCE
    slow = (step <= reach).all(axis=1)
    rest = np.append(True, slow) & np.append(slow, True)
    rows = np.flatnonzero(rest & np.isfinite(motion.point))
    rows = rows[np.argsort(motion.point[rows], kind="stable")]
    known = motion.point[rows]
    wrong: list[str] = []
    for k, seconds in sorted(programmed.items()):
        if k in given_up:
            continue
        if k < 0:
            rest_time, there = _count_still_steps(still) * motion.sample_time, True
            name = "before the first point"
        else:
            at = np.array([np.interp(k, place[0], place[1][:, c]) for c in range(3)])
            near = rows[
                np.searchsorted(known, k - _count_equal_points_before(toolpath, k) - 0.5) : np.searchsorted(
                    known, k + 0.5
                )
            ]
            near = near[np.linalg.norm(locations.tcp[near, :3, 3] - at, axis=1) <= locations.path_limit]
            there, rest_time, name = (
                bool(len(near)),
                _find_longest_rest(np.sort(near), still) * motion.sample_time,
                f"at point {k}",
            )
        if not there:
            wrong.append(f"{name} the file dwells or stops, and the motion is not at rest there")
        elif rest_time < seconds - TIME_TOLERANCE_S:
            wrong.append(f"{name} the file dwells {seconds:g} s, and the motion rests there {rest_time:.3f} s")
    return [build_count_check("dwells and stops", wrong, "places")]


def _list_dwells(toolpath: Toolpath) -> dict[int, float]:
    """Return the dwell time at each point with a dwell or stop, s, 0 without a stated time; −1: before the first."""
    out: dict[int, float] = {}
    for event in toolpath.events:
        if event.kind in ("dwell", "stop"):
            at = min(event.index, len(toolpath)) - 1
            stated = event.kind == "dwell" and event.value > 0
            out[at] = out.get(at, 0.0) + (event.value if stated else 0.0)
    return out


def _count_equal_points_before(toolpath: Toolpath, k: int) -> int:
    """Return how many points before point k lie at its place: the motion may pass them all while at rest."""
    count = 0
    while (
        count < k
        and np.linalg.norm(toolpath.position[k] - toolpath.position[k - count - 1]) <= SAME_PLACE_UM * 1e-6
        and np.abs(toolpath.axis[k] - toolpath.axis[k - count - 1]).max() <= SAME_PLACE_UM * 1e-5
    ):
        count += 1
    return count


def _count_still_steps(still: Bools) -> int:
    """How many steps from the motion's first row on nothing moves."""
    moving = np.flatnonzero(~still[1:])
    return int(moving[0]) if len(moving) else len(still) - 1


def _find_longest_rest(rows: Array, still: Bools) -> int:
    """Most steps on end, among the rising rows, on which nothing moves."""
    best = count = 0
    for n, row in enumerate(rows.tolist()):
        count = count + 1 if still[row] and n and rows[n - 1] == row - 1 else 0
        best = max(best, count)
    return best
