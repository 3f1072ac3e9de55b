"""Load histories of a gear in a static recording, for laws with memory.

Recordings do not tell how a gear was loaded before a reading. Five assumptions are distinguished. ``cycle``: each
load cycle starts with a relaxed gear. ``visit``: a cycle starts with the state that the previous cycle left.
``arrival``: the weight loads the gear on arrival at the pose, from rest. ``session``: the same, from the state of the
previous pose. ``approach``: as arrival, but the arm moves to the pose again for every cycle. Each is a different
input to the same law.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.effects.protocol import MEMORIES
from machopt.measurement.diagnosis.data_types.static_readings import GearLoadHistory, StaticReadings
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
EACH_CYCLE = (MEMORIES.index("cycle"), MEMORIES.index("approach"))  # begin anew


def build_load_history(r: StaticReadings, memory: str) -> GearLoadHistory:
    """Build the sequence of states that a gear passes under an assumed load history.

    Loads are assumed to change right after the last reading. The unloaded state of a cycle precedes its first reading
    by the time between its readings. For a single reading that time is unknown.

    Args:
        r: Static readings.
        memory: One of ``MEMORIES``.

    Returns:
        The states of all joints and the states of the readings.
    """
    if memory not in r.histories:
        r.histories[memory] = _build_load_history(r, MEMORIES.index(memory))
    return r.histories[memory]


def _build_load_history(r: StaticReadings, memory: int) -> GearLoadHistory:
    time = r.recording.time
    torque: list[Array] = []
    gap: list[Array] = []
    first: list[int] = []
    at, start = np.zeros(len(r), np.int64), np.zeros(len(r), np.int64)
    visit, session, last, count = -1, -1, np.nan, 0
    for rows in r.cycles:
        here, now = int(r.visit[rows[0]]), int(r.session[rows[0]])
        arrived, same = here != visit, now == session
        weight = r.weight_torque[rows[0]] if memory > 1 else np.zeros(r.joint_count)
        first += [int(memory in EACH_CYCLE or (arrived and not (memory == 3 and same))), *(0 for _ in rows)]
        torque += [weight[None], r.load_torque[rows] + weight]
        if time is not None:
            began = memory > 1 and not same
            gap.append(_compute_time_gaps(time[rows], last if same and (not arrived or memory > 1) else np.nan, began))
            last = float(time[rows[-1]])
        start[rows], at[rows] = count, count + 1 + np.arange(len(rows))
        visit, session, count = here, now, count + 1 + len(rows)
    return GearLoadHistory(
        np.concatenate(torque),
        np.concatenate(gap) if gap else np.full(count, np.nan),
        np.array(first, np.int64),
        at,
        start,
    )


def _compute_time_gaps(time: Array, last: float, rested: bool = False) -> Array:
    """Return the time before the unloaded state of a cycle and before each of its readings, s.

    Args:
        time: Time of the readings, s.
        last: Time of the last reading that still matters; NaN if there is none.
        rested: Whether the arm has rested under its weight longer than any memory lasts.
    """
    gaps = np.maximum(np.diff(time), 0.0)
    wait = float(np.median(gaps)) if len(gaps) else np.nan
    away = wait
    if np.isfinite(last) and len(gaps):
        away = max(float(time[0]) - wait - last, 0.0)
    elif np.isfinite(last):  # a single reading: the time without load is unknown
        away = -max(float(time[0]) - last, 0.0)
    elif rested:
        away = np.inf
    return np.concatenate([[away, wait], gaps])
