"""In which order the torques of resting readings came to a gear, as far as it remembers them.

Gears remember differently, and no recording says how: ``cycle``: each cycle starts relaxed; ``visit``: with what the
cycle before left in the gear; ``arrival``: weight winds the gear up on arrival, from rest; ``session``: the same, from
what the pose before left; ``approach``: as on arrival, but the arm comes to the pose anew for every cycle. Each is
another drive over the same law.
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
    """The states as a gear with this memory lives through them.

    Loads change right after the last reading. The unloaded state of a cycle stands as long before its first reading as
    its readings stand apart; of a lone reading that is not known.
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
        weight = r.weight_torque[rows[0]] if memory > 1 else np.zeros(6)
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


def _compute_time_gaps(time: Array, last: float, stood: bool = False) -> Array:
    """Seconds before the unloaded state of a cycle and before each of its readings.

    Args:
        time: of the readings.
        last: of the last reading that still counts; NaN: there is none.
        stood: the arm has stood so, under its weight, for longer than anything in it lasts.
    """
    gaps = np.maximum(np.diff(time), 0.0)
    wait = float(np.median(gaps)) if len(gaps) else np.nan
    away = wait
    if np.isfinite(last) and len(gaps):
        away = max(float(time[0]) - wait - last, 0.0)
    elif np.isfinite(last):  # a lone reading: how much of it was before the load came is the law's to say
        away = -max(float(time[0]) - last, 0.0)
    elif stood:
        away = np.inf
    return np.concatenate([[away, wait], gaps])
