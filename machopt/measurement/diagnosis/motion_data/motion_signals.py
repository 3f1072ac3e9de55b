"""Signals of a recorded motion: velocity, acceleration, periods, and cross-validation groups.

Velocities and accelerations come from zero-phase filters at the sampling rate. Everything nonlinear is evaluated at
that rate and then averaged over blocks of samples. A recording of 100 000 samples becomes a few thousand readings
without time shifts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Ints
from machopt.measurement.diagnosis.motion_data.motion_derivatives import compute_derivatives, is_evenly_sampled
from machopt.measurement.diagnosis.motion_data.sample_order import sort_samples
from machopt.numerics.array_types import Array

READINGS = 6000  # most rows of a problem
STRETCHES = 24  # number of time blocks of a long recording


@dataclass(frozen=True, kw_only=True)
class MotionSignals:
    """M samples in the order of session and time, and the N readings that they are averaged to, SI."""

    index: Ints  # (M,) rows of the recording
    rate: float  # Hz
    time: Array  # (M,) s
    session: Ints  # (M,) 0, 1 …
    segment: Ints  # (M,) segment without time gaps
    period: Ints  # (M,) index of the period, unique over sessions; −1: not periodic
    cutoff: float  # Hz, low-pass of velocity and acceleration
    q: Array  # (M, n) rad, encoder as recorded
    v: Array  # (M, n) rad/s
    a: Array  # (M, n) rad/s²
    starts: Ints  # (N,) first sample of each reading's block
    kept_blocks: NDArray[np.bool_]  # blocks that are used: away from the ends of segments, where filters ring
    group: Ints  # (N,) for used readings, as the following labels
    visit: Ints
    cycle: Ints
    replicate: Ints
    block_length: int  # samples in a block
    length: float  # s of one period; 0: not periodic
    notes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.group)

    def average_blocks(self, x: Array) -> Array:
        """Average a signal over blocks of samples.

        Args:
            x: (M, …) signal.

        Returns:
            (N, …) block averages.
        """
        counts = np.diff(np.r_[self.starts, len(self.q)]).astype(float)
        total = np.add.reduceat(x, self.starts, axis=0)
        return np.asarray((total / counts.reshape(-1, *[1] * (x.ndim - 1)))[self.kept_blocks])

    def select_block_labels(self, x: Ints) -> Ints:
        """Select the labels of each block's first sample.

        Args:
            x: (M,) labels.

        Returns:
            (N,) labels.
        """
        return np.asarray(x[self.starts][self.kept_blocks])

    def subtract_period_mean(self, x: Array) -> Array:
        """Subtract the deviation of each period's (or session's) mean from the overall mean.

        Errors common to all samples of a period would otherwise imitate effects that change between periods. The
        overall mean is preserved, so that a constant stays constant.

        Args:
            x: (N, …) block values.

        Returns:
            (N, …).
        """
        inverse, count = self._count_period_readings
        if len(count) < 2:
            return x
        flat = x.reshape(len(x), -1)
        mean = np.stack([np.bincount(inverse, column) for column in flat.T], axis=1) / count[:, None]
        return np.asarray((flat - mean[inverse] + flat.mean(axis=0)).reshape(x.shape))

    @cached_property
    def _count_period_readings(self) -> tuple[Ints, Array]:
        """Index (N,) of the period or session, and its number of readings."""
        label = self.select_block_labels(np.where(self.period >= 0, self.period, 10**6 + self.session))
        _, inverse = np.unique(label, return_inverse=True)
        return inverse, np.bincount(inverse).astype(float)

    def differentiate(self, x: Array) -> Array:
        """Differentiate a smooth signal with respect to time, segment by segment.

        Args:
            x: (M, …) signal.

        Returns:
            (M, …) per s.
        """
        out = np.zeros_like(x)
        for rows in self.segments():
            out[rows] = np.gradient(x[rows], self.time[rows], axis=0)
        return out

    def delay_cubic(self, x: Array, delay: float) -> Array:
        """Delay a signal, x(t − delay), with constant ends, by cubic interpolation where samples are even.

        Linear interpolation would reduce the noise of a signal delayed by a fraction of a sample, and any delay would
        seem to improve the fit.

        Args:
            x: (M, …) signal.
            delay: Delay, s.

        Returns:
            (M, …) delayed signal.
        """
        out = np.empty_like(x)
        flat, to = x.reshape(len(x), -1), out.reshape(len(x), -1)
        for rows in self.segments():
            t = self.time[rows]
            if is_evenly_sampled(t):
                to[rows] = _delay_samples(flat[rows], delay * (len(t) - 1) / (t[-1] - t[0]))
                continue
            for c in range(flat.shape[1]):
                to[rows, c] = np.interp(t - delay, t, flat[rows, c])
        return out

    def delay_linear(self, x: Array, delay: float) -> Array:
        """Delay a signal, x(t − delay), by linear interpolation, as recorders do that align two clocks.

        Args:
            x: (M,) signal.
            delay: Delay, s.

        Returns:
            (M,) delayed signal.
        """
        out = np.empty_like(x)
        for rows in self.segments():
            out[rows] = np.interp(self.time[rows] - delay, self.time[rows], x[rows])
        return out

    def segments(self) -> list[slice]:
        starts = np.flatnonzero(np.diff(self.segment, prepend=self.segment[0] - 1))
        return [slice(int(a), int(b)) for a, b in zip(starts, np.r_[starts[1:], len(self.segment)], strict=True)]


def build_motion_signals(
    recording: Recording, joints: int, readings: int = READINGS, *, repeats: bool = True
) -> MotionSignals:
    """Sort and differentiate a motion, find its periods, and divide it into time blocks.

    Args:
        recording: Recording of kind motion.
        joints: Number n of moving joints of the arm.
        readings: Largest number N of block averages.
        repeats: Whether to find periods; a phase then forms a cross-validation group over all periods.

    Returns:
        The signals.

    Raises:
        InputError: No time, non-increasing time, or too short a recording.
    """
    order = sort_samples(recording)
    index, time, session, segment, notes = order.index, order.time, order.session, order.segment, list(order.notes)
    q = np.ascontiguousarray(recording.q[index, :joints])
    rate, spans = 1.0 / order.dt, _list_segment_slices(segment)
    v, a, cutoff = compute_derivatives(recording, order, q, spans)
    period, length = np.full(len(q), -1, np.int64), 0.0
    if repeats:
        period, length = _find_periods(recording, index, time, session, q, spans, rate)
    step = max(1, -(-len(q) // readings), int(rate / thresholds.LIMITS.reading_rate))
    starts = _split_into_blocks(segment, period, step)
    ends = np.r_[starts[1:], len(q)]
    edge = 0.5 / cutoff
    first, last = np.empty(len(q)), np.empty(len(q))
    for s in spans:
        first[s], last[s] = time[s][0] + edge, time[s][-1] - edge
    keep = (time[starts] >= first[starts]) & (time[ends - 1] <= last[starts])
    source = "recorded" if recording.velocity is not None else "differentiated"
    notes.insert(
        0,
        f"{len(q)} samples at {rate:.4g} Hz, averaged by {step} to {int(keep.sum())} readings at "
        f"{rate / step:.4g} Hz; velocity {source}, it and acceleration through a zero-phase low-pass of "
        f"fourth order at {cutoff:.3g} Hz",
    )
    group, visit, cycle, replicate = _build_block_labels(
        time, session, segment, period, length, starts, keep, step * order.dt, notes
    )
    return MotionSignals(
        index=index,
        rate=rate,
        time=time,
        session=session,
        segment=segment,
        period=period,
        cutoff=cutoff,
        q=q,
        v=v,
        a=a,
        starts=starts,
        kept_blocks=keep,
        group=group,
        visit=visit,
        cycle=cycle,
        replicate=replicate,
        block_length=step,
        length=length,
        notes=tuple(notes),
    )


def _delay_samples(x: Array, by: float) -> Array:
    """Delay even samples (M, C) by a number of intervals with a cubic Lagrange polynomial of four neighbours."""
    whole = int(np.floor(by))
    u = by - whole  # x(n − whole − u), between n − whole − 1 and n − whole
    weights = (
        -u * (1.0 - u) * (2.0 - u) / 6.0,
        (1.0 + u) * (1.0 - u) * (2.0 - u) / 2.0,
        u * (1.0 + u) * (2.0 - u) / 2.0,
        -u * (1.0 - u) * (1.0 + u) / 6.0,
    )
    out = np.zeros_like(x)
    for k, w in zip((1, 0, -1, -2), weights, strict=True):
        if w != 0.0:
            _add_delayed_rows(out, w * x, whole - k)
    return out


def _add_delayed_rows(out: Array, x: Array, by: int) -> None:
    """Add x (M, C), delayed by a number of rows with constant ends."""
    by = max(-len(x), min(by, len(x)))
    if by > 0:
        out[:by] += x[0]
        out[by:] += x[:-by]
    elif by < 0:
        out[:by] += x[-by:]
        out[by:] += x[-1]
    else:
        out += x


def _list_segment_slices(segment: Ints) -> list[slice]:
    starts = np.flatnonzero(np.diff(segment, prepend=segment[0] - 1))
    return [slice(int(a), int(b)) for a, b in zip(starts, np.r_[starts[1:], len(segment)], strict=True)]


def _find_periods(
    recording: Recording, index: Ints, time: Array, session: Ints, q: Array, spans: list[slice], rate: float
) -> tuple[Ints, float]:
    """Return the period index of each sample and the period length; −1 and 0 if the motion does not repeat."""
    none = np.full(len(q), -1, np.int64)
    spread = np.maximum(np.ptp(q, axis=0), 1e-9)
    if "cycle" in recording.stated_labels:
        label = np.unique(np.stack([session, recording.cycle[index]]), axis=1, return_inverse=True)[1].reshape(-1)
        counts = np.bincount(label)
        usual = int(np.median(counts))
        alike = np.abs(counts - usual) <= max(2, thresholds.SHARES.negligible * usual)
        if usual > thresholds.COUNTS.min_rows_per_column and alike.all() and len(counts) > 1:
            starts = np.flatnonzero(np.diff(label, prepend=label[0] - 1))
            if len(starts) == len(counts) and _is_periodic(q, session[starts], starts, usual - 2, spread):
                return label.astype(np.int64), usual / rate
    for s in spans[:1]:
        n = s.stop - s.start
        thin = max(1, n // 1500)
        x = q[s][::thin] / spread
        best = 0
        for lag in range(max(round(2.0 * rate / thin), 8), len(x) // 2 + 1):
            if np.mean(np.abs(x[lag:] - x[:-lag])) < 2.0 * thresholds.SHARES.negligible:
                best = lag
                break
        if not best:
            return none, 0.0
        # the first sufficiently small lag precedes the minimum, which follows shortly
        fine = np.arange(max(1, (best - 1) * thin), min(n // 2, int(1.15 * best + 3) * thin) + 1)
        part = q[s] / spread
        off = [float(np.mean(np.abs(part[k:] - part[:-k]))) for k in fine]
        lag = int(fine[int(np.argmin(off))])
        if min(off) > thresholds.SHARES.negligible:
            return none, 0.0
        out = none.copy()
        offset = 0
        for t in spans:
            k = (np.arange(t.stop - t.start) // lag).astype(np.int64)
            out[t] = offset + k
            offset += int(k[-1]) + 1
        return out, lag / rate
    return none, 0.0


def _is_periodic(q: Array, session: Ints, starts: Ints, n: int, spread: Array) -> bool:
    """Return whether the periods of one session have equal joint paths."""
    off = [
        float(np.mean(np.abs(q[b : b + n] - q[a : a + n]) / spread))
        for a, b, s, t in zip(starts[:-1], starts[1:], session[:-1], session[1:], strict=True)
        if s == t and b + n <= len(q)
    ]
    return bool(off) and max(off) < thresholds.SHARES.negligible


def _split_into_blocks(segment: Ints, period: Ints, step: int) -> Ints:
    """Return the first samples of blocks; a block crosses neither a gap nor the end of a period."""
    change = np.flatnonzero((np.diff(segment, prepend=segment[0] - 1) != 0) | (np.diff(period, prepend=-2) != 0))
    ends = np.r_[change[1:], len(segment)]
    return np.concatenate([np.arange(a, b, step) for a, b in zip(change, ends, strict=True)]).astype(np.int64)


def _build_block_labels(
    time: Array,
    session: Ints,
    segment: Ints,
    period: Ints,
    length: float,
    starts: Ints,
    keep: NDArray[np.bool_],
    block: float,
    notes: list[str],
) -> tuple[Ints, Ints, Ints, Ints]:
    """Return groups, visits, cycles and replicates of the used blocks."""
    at = starts[keep]
    sessions = int(session.max()) + 1
    if length > 0:
        change = np.flatnonzero(np.diff(period, prepend=-2))
        zero = np.empty(int(period.max()) + 1)
        zero[period[change]] = time[change]
        phase = time[at] - zero[period[at]]
        per_session = max(-(-STRETCHES // sessions), 2)
        wanted = min(per_session, int(length / thresholds.LIMITS.holdout_time))
        bins = max(wanted, min(-(-12 // sessions), int(length / 0.25)), 1)
        place = np.minimum((phase / length * bins).astype(np.int64), bins - 1)
        group = session[at] * bins + place
        visit = period[at] * bins + place
        slot = np.rint(phase / block).astype(np.int64)
        near = np.abs(phase / block - slot) < thresholds.SHARES.small
        replicate = np.where(near, session[at] * (int(slot.max()) + 1) + slot, -1)
        notes.append(
            f"the motion repeats every {length:.4g} s; held out together: the same {length / bins:.2g} s of "
            f"all periods of a session ({len(np.unique(group))} groups)"
        )
    else:
        total = float(sum(time[s][-1] - time[s][0] for s in _list_segment_slices(segment)))
        width = float(np.clip(total / STRETCHES, thresholds.LIMITS.holdout_time, 4.0))
        begin = {int(segment[s.start]): float(time[s.start]) for s in _list_segment_slices(segment)}
        local = time[at] - np.array([begin[int(k)] for k in segment[at]])
        place = (local / width).astype(np.int64)
        _, group = np.unique(np.stack([segment[at], place]), axis=1, return_inverse=True)
        group = group.reshape(-1).astype(np.int64)
        visit, replicate = group.copy(), np.full(len(at), -1, np.int64)
        phase = local
        notes.append(
            f"no repeats are used; held out together: {width:.2g} s at a time ({len(np.unique(group))} groups)"
        )
    part = (phase / max(thresholds.LIMITS.correlation_time, 4.0 * block)).astype(np.int64)
    cycle = np.unique(np.stack([visit, part]), axis=1, return_inverse=True)[1].reshape(-1).astype(np.int64)
    return group.astype(np.int64), visit.astype(np.int64), cycle, replicate.astype(np.int64)
