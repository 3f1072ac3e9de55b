"""Check of re-entries: lifts inside of a cut, which leave a mark and are made only where the user permits them.

A re-entry is a retract, a link and an approach at one point of a cut. The cut leads to the point before it and goes on
from the point after it; that every part of the cut is driven is seen by the checks of the path.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.verification.checks import VerificationCheck, build_count_check
from machopt.verification.tables.exported_tables import ExportedMotion


def find_reentry_points(motion: ExportedMotion) -> tuple[int, ...]:
    """Return the toolpath point of each lift inside of a cut, in the order of the motion.

    Args:
        motion: The exported motion (trajectory.csv), SI.
    """
    if motion.lifted is None:
        return ()
    begins = np.flatnonzero(motion.lifted & ~np.r_[False, motion.lifted[:-1]])
    return tuple(round(motion.point[row]) for row in begins.tolist())


def check_reentries(motion: ExportedMotion, toolpath: Toolpath, options: PlanOptions) -> list[VerificationCheck]:
    """Check number and places of the re-entries; no check where there are none and none is permitted.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        options: The planning options in force; ``max_reentries`` is for one tool, and each tool has its own motion.
    """
    points = find_reentry_points(motion)
    if not points and not options.max_reentries:
        return []
    wrong = [f"point {k} is not inside of a cut along a path" for k in points if not _is_inside_cut(toolpath, k)]
    if len(points) > options.max_reentries:
        wrong.append(f"{len(points)} re-entries, max_reentries is {options.max_reentries}")
    return [build_count_check("re-entries", wrong, "places")]


def _is_inside_cut(toolpath: Toolpath, point: int) -> bool:
    if not 0 < point < len(toolpath) - 1:
        return False
    cut = bool((toolpath.move[point : point + 2] == MoveKind.CUT).all())
    same = toolpath.operation[point] == toolpath.operation[point + 1]
    return cut and bool(same) and toolpath.operations[int(toolpath.operation[point])].kind == "trajectory"
