"""Check of re-entries: lifts inside of a cut, which leave a mark and are made only where the user permits them.

A re-entry is a retract, a link and an approach at one point of a closed contour. The same operation cuts on behind it,
in another posture. The checks of the path show that every part of the cut is driven.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.verification.check_results import VerificationCheck, build_count_check
from machopt.verification.tables.exported_tables import ExportedMotion

CLOSED_M, STILL_M = 0.0021, 1e-9  # ends of a closed contour lie within 2 mm; a shorter move has no direction
WINDING_RAD = np.radians(325.0)  # turn of the travel from which a cut winds around; 330° by another sum in the planner
LEAST_CHANGE_RAD = np.radians(1.0)  # of the joint that moves most across a lift


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
    wrong = [f"point {k} is not inside of a closed contour" for k in points if not _is_inside_contour(toolpath, k)]
    wrong += [f"at point {k} the posture stays" for k in _list_lifts_without_change(motion)]
    if len(points) > options.max_reentries:
        wrong.append(f"{len(points)} re-entries, max_reentries is {options.max_reentries}")
    return [build_count_check("re-entries", wrong, "places")]


def _is_inside_contour(toolpath: Toolpath, point: int) -> bool:
    """Whether one operation cuts to the point and on from it, along a path that closes or winds around."""
    if not 0 < point < len(toolpath) - 1 or toolpath.operation[point] != toolpath.operation[point + 1]:
        return False
    if toolpath.operations[int(toolpath.operation[point])].kind != "trajectory":
        return False
    cut = toolpath.cutting
    if not (cut[point] and cut[point + 1]):
        return False
    first, last = point, point
    while first > 0 and cut[first]:
        first -= 1
    while last + 1 < len(toolpath) and cut[last + 1]:
        last += 1
    places, axis = toolpath.position[first : last + 1], toolpath.axis[first : last + 1]
    if np.linalg.norm(places[-1] - places[0]) <= CLOSED_M:
        return True
    step = np.diff(places, axis=0)
    step -= np.einsum("ij,ij->i", step, axis[1:])[:, None] * axis[1:]
    keep = np.linalg.norm(step, axis=1) > STILL_M
    step, axis = step[keep], axis[1:][keep]
    turn = np.arctan2(
        np.einsum("ij,ij->i", np.cross(step[:-1], step[1:]), axis[1:]), np.einsum("ij,ij->i", step[:-1], step[1:])
    )
    return bool(abs(turn.sum()) >= WINDING_RAD)


def _list_lifts_without_change(motion: ExportedMotion) -> list[int]:
    """Points at which the arm enters again in the posture in which it left: no lift was needed."""
    out = []
    lifted = np.zeros(len(motion.time), bool) if motion.lifted is None else motion.lifted
    for row in np.flatnonzero(lifted & ~np.r_[False, lifted[:-1]]).tolist():
        before, after = row, row
        while before > 0 and motion.move[before] != MoveKind.CUT:
            before -= 1
        while after + 1 < len(lifted) and (lifted[after + 1] or motion.move[after + 1] == MoveKind.APPROACH):
            after += 1
        if np.abs(motion.q[after] - motion.q[before]).max() < LEAST_CHANGE_RAD:
            out.append(round(motion.point[row]))
    return out
