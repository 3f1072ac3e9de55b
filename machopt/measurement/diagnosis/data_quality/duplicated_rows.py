"""Readings of one pose that stand in the row of another: the same to the last digit, though the arm was elsewhere."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot
from machopt.measurement.diagnosis import thresholds
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
MOST_ALIKE = 8  # readings of one value that are compared: more are a common value


def is_coarsely_rounded(values: Array) -> bool:
    """Whether (N, 3) m are all whole steps, of at least the resolution at which readings agree by chance."""
    steps = values / thresholds.RESTING.fine
    return bool(np.abs(steps - np.round(steps)).max() < thresholds.RESTING.whole_step)


def find_duplicated_rows(recording: Recording, robot: Robot, T_flange_tcp: Array) -> Flags:
    """(N,) rows whose measured position is that of another row, of two the one that lies farther from the arm.

    Args:
        recording: units mended; of load tests whole visits.
        robot, T_flange_tcp: the arm.
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
    most = thresholds.RECORD.apart * compute_typical_error(error)
    off = np.linalg.norm(error, axis=1)
    for k in twice:
        rows = np.flatnonzero(label == k)
        own = rows[np.argmin(off[rows])]
        out[rows] = (np.linalg.norm(there[rows] - there[own], axis=1) > most) & (off[rows] > most)
    return out


def _find_duplicated_visits(recording: Recording, whole: RecordEquations) -> Flags:
    """(N,) rows of a visit of a load test that hold, one after the other, the displacements of a visit elsewhere.

    Coarse readings agree now and then: rows count by how rare their values are, each value of a visit once.
    """
    out = np.zeros(len(recording), bool)
    assert recording.displacement is not None  # the caller has looked
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
    error = whole.error(whole.fit())
    off, predicted = np.linalg.norm(error, axis=1), whole.y - error
    most = thresholds.RECORD.apart * compute_typical_error(error)
    for alike in pairs.values():
        one, two = np.array(alike).T
        if _compute_chance_of_duplicates(d, one) < thresholds.RECORD.copied and (
            np.median(np.linalg.norm(predicted[one] - predicted[two], axis=1)) > most
        ):
            out[one if np.median(off[one]) > np.median(off[two]) else two] = True
    return out


def _compute_chance_of_duplicates(d: Array, rows: Ints) -> float:
    """Chance that other readings hold the very values of rows (n,) of d (N, 3), whose neighbours hold the like."""
    values = np.unique(d[rows], axis=0)
    return float(np.prod([np.mean(d[:, axis] == v[axis]) for v in values for axis in range(3)]))
