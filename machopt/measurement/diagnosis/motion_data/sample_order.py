"""Samples of a motion in time order, and its segments without gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True, kw_only=True)
class OrderedSamples:
    """S samples in the order of session and time, without those of short segments."""

    index: Ints  # (S,) rows of the recording
    time: Array  # (S,) s
    session: Ints  # (S,)
    segment: Ints  # (S,) segment without gaps
    dt: float  # s, median sampling interval
    uneven: bool  # samples are missing, or sampling intervals vary
    notes: tuple[str, ...]


def sort_samples(recording: Recording) -> OrderedSamples:
    """Sort samples by session and time, and drop segments that are too short.

    Args:
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        The sorted samples with notes.

    Raises:
        InputError: No time, non-increasing time, or no segment of sufficient length.
    """
    if recording.time is None:
        raise RecordingError(f"{recording.source}: a motion needs the column time_s")
    session = np.unique(recording.session, return_inverse=True)[1].astype(np.int64)
    index = np.lexsort((recording.time, session)).astype(np.int64)
    time, session = recording.time[index], session[index]
    steps = np.diff(time)
    same = np.diff(session) == 0
    if not same.any():
        raise RecordingError(f"{recording.source}: one sample a session; a motion needs a few seconds")
    if (steps[same] <= 0).any():
        k = int(np.flatnonzero(same & (steps <= 0))[0]) + 1
        raise RecordingError(
            f"{recording.source}: time does not advance at {recording.place(int(index[k]))}; "
            "every sample needs its own time_s"
        )
    dt = float(np.median(steps[same]))
    breaks = ~same | (steps > max(thresholds.RATIOS.stiffness_error * dt, thresholds.LIMITS.pause))
    segment = np.r_[0, np.cumsum(breaks)].astype(np.int64)
    inside = steps[same & ~breaks]
    scatter = float(np.mean(np.abs(inside - dt))) / dt
    dropped = int(np.sum(inside > (1.0 + thresholds.SHARES.majority) * dt))
    notes = []
    gaps = int(np.sum(breaks & same))
    if gaps:
        notes.append(f"{gaps} gap{'s' if gaps > 1 else ''} in time; velocities are not taken across")
    if scatter > thresholds.SHARES.small:
        notes.append(f"sampling intervals scatter by {100 * scatter:.0f} %; filters run on an even grid between them")
    elif dropped:
        notes.append(
            f"{dropped} time{'s' if dropped > 1 else ''} a sample or two are missing; filters run on an even grid"
        )
    least = max(round(thresholds.LIMITS.segment_time / dt), thresholds.COUNTS.min_rows_per_column)
    long = np.bincount(segment)[segment] >= least
    if not long.any():
        raise RecordingError(
            f"{recording.source}: no stretch without a gap lasts {least * dt:.2g} s; nothing to diagnose"
        )
    if not long.all():
        notes.append(f"{int(np.sum(~long))} samples in stretches shorter than {least * dt:.2g} s are left out")
    return OrderedSamples(
        index=index[long],
        time=time[long],
        session=session[long],
        segment=segment[long],
        dt=dt,
        uneven=scatter > thresholds.SHARES.small or dropped > 0,
        notes=tuple(notes),
    )
