"""Readings of one pose that stand in the row of another: the same to the last digit, though the arm was elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.reflectors import points, registered
from machopt.diagnose.record.sessions import equations, typical
from machopt.domain.recording import Recording
from machopt.model.robot import Robot

Flags = NDArray[np.bool_]


def coarse(values: Array) -> bool:
    """Whether (N, 3) m are all whole steps, of at least the resolution at which readings agree by chance."""
    return bool(np.abs(values / calibrated.RESTING.fine - np.round(values / calibrated.RESTING.fine)).max() < 0.02)


def pasted(recording: Recording, robot: Robot, T_flange_tcp: Array) -> Flags:
    """(N,) rows whose measured position is that of another row, of two the one that lies farther from the arm.

    Args:
        recording: kind absolute, units mended; of load tests whole visits are compared elsewhere.
        robot, T_flange_tcp: the arm.
    """
    out = np.zeros(len(recording), bool)
    if recording.kind != "absolute" or recording.position is None or coarse(recording.position):
        return out
    _, label, count = np.unique(recording.position, axis=0, return_inverse=True, return_counts=True)
    label = label.reshape(-1)
    twice = np.flatnonzero(count > 1)
    if not len(twice):
        return out
    whole = equations(registered(recording, robot, T_flange_tcp), robot, T_flange_tcp)
    error = whole.error(whole.fit())
    there, _ = points(recording, robot, T_flange_tcp)
    most = calibrated.RECORD.apart * typical(error)
    off = np.linalg.norm(error, axis=1)
    for k in twice:
        rows = np.flatnonzero(label == k)
        own = rows[np.argmin(off[rows])]
        out[rows] = (np.linalg.norm(there[rows] - there[own], axis=1) > most) & (off[rows] > most)
    return out
