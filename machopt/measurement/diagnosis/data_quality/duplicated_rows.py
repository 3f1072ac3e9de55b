"""Readings that are copied into the row of another pose: equal to the last digit although the arm was elsewhere."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.session_corrections import (
    RecordEquations,
    build_record_equations,
    compute_typical_error,
)
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import (
    compute_nominal_points,
    register_positions,
)
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]
MOST_ALIKE = 8  # most readings with equal value that are compared; more indicate a frequent value


def is_coarsely_rounded(values: Array) -> bool:
    """Return whether values are rounded so coarsely that equal readings occur by chance.

    Args:
        values: (N, 3) m.

    Returns:
        True if all values are multiples of the coarse resolution.
    """
    steps = values / thresholds.LIMITS.reading_step
    return bool(np.abs(steps - np.round(steps)).max() < thresholds.SHARES.negligible)


def find_duplicated_rows(recording: Recording, robot: Robot, T_flange_tcp: Array) -> Flags:
    """Find rows whose measured position equals that of another row. Of two equal rows the one with the larger model
    error is

    flagged.

    Args:
        recording: Recording with corrected units; for load tests complete cycles.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        (N,) True for duplicated rows.
    """
    out = np.zeros(len(recording), bool)
    if recording.kind == "deflection" and recording.displacement is not None and recording.wrench is not None:
        return _find_duplicated_visits(recording, build_record_equations(recording, robot, T_flange_tcp))
    if recording.kind != "absolute" or recording.position is None or is_coarsely_rounded(recording.position):
        return out
    _, label, count = np.unique(recording.position, axis=0, return_inverse=True, return_counts=True)
    label = label.reshape(-1)
    twice = np.flatnonzero(count > 1)
    if not len(twice):
        return out
    whole = build_record_equations(register_positions(recording, robot, T_flange_tcp), robot, T_flange_tcp)
    error = whole.error(whole.fit())
    there, _ = compute_nominal_points(recording, robot, T_flange_tcp)
    most = thresholds.RATIOS.implausible * compute_typical_error(error)
    off = np.linalg.norm(error, axis=1)
    for k in twice:
        rows = np.flatnonzero(label == k)
        own = rows[np.argmin(off[rows])]
        out[rows] = (np.linalg.norm(there[rows] - there[own], axis=1) > most) & (off[rows] > most)
    return out


def _find_duplicated_visits(recording: Recording, equations: RecordEquations) -> Flags:
    """Return rows (N,) of a load-test visit whose displacements repeat, in order, those of a visit at another pose.

    Coarsely rounded readings agree by chance. Rows are therefore weighted by how rare their values are.
    """
    out = np.zeros(len(recording), bool)
    assert recording.displacement is not None  # checked by the caller
    d = recording.displacement[:, :3]
    _, visit = np.unique(np.stack([recording.pose, recording.session], axis=1), axis=0, return_inverse=True)
    visit = visit.reshape(-1)
    rank = np.zeros(len(d), np.int64)
    for v in np.unique(visit):
        rank[visit == v] = np.arange(int((visit == v).sum()))
    _, place, count = np.unique(np.column_stack([rank, d]), axis=0, return_inverse=True, return_counts=True)
    place = place.reshape(-1)
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for k in np.flatnonzero((count > 1) & (count <= MOST_ALIKE)):
        rows = np.flatnonzero(place == k)
        for a, b in combinations(rows.tolist() if d[rows[0]].any() else [], 2):
            if recording.pose[a] != recording.pose[b]:
                pairs.setdefault((int(visit[a]), int(visit[b])), []).append((a, b))
    if not pairs:
        return out
    error = equations.error(equations.fit())
    off, predicted = np.linalg.norm(error, axis=1), equations.y - error
    most = thresholds.RATIOS.implausible * compute_typical_error(error)
    for alike in pairs.values():
        one, two = np.array(alike).T
        if _compute_chance_of_duplicates(d, one) < thresholds.LEVELS.duplicate_probability and (
            np.median(np.linalg.norm(predicted[one] - predicted[two], axis=1)) > most
        ):
            out[one if np.median(off[one]) > np.median(off[two]) else two] = True
    return out


def _compute_chance_of_duplicates(d: Array, rows: Ints) -> float:
    """Return the probability that other readings equal rows (n,) of d (N, 3) by chance."""
    values = np.unique(d[rows], axis=0)
    return float(np.prod([np.mean(d[:, axis] == v[axis]) for v in values for axis in range(3)]))
