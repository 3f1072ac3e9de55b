"""Velocities and accelerations of a motion, by a low-pass filter on an even grid of time."""

from __future__ import annotations

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.motion_data.lowpass_filter import apply_zero_phase_filter
from machopt.measurement.diagnosis.motion_data.sample_order import OrderedSamples
from machopt.numerics.array_types import Array


def compute_derivatives(
    recording: Recording, o: OrderedSamples, q: Array, spans: list[slice]
) -> tuple[Array, Array, float]:
    """Return velocity and acceleration (S, n) of joint positions, rad/s and rad/s², and the cutoff frequency, Hz."""
    given = recording.velocity
    speed = np.zeros_like(q) if given is None else given[o.index, : q.shape[1]]
    if given is None:
        for s in spans:
            speed[s] = np.gradient(q[s], o.time[s], axis=0)
    rate, step = 1.0 / o.dt, o.dt if o.uneven else 0.0
    longest = max(spans, key=lambda s: s.stop - s.start)
    known, window = (q, "blackmanharris") if given is None else (speed, "hann")
    cutoff = _find_cutoff_frequency(_resample_evenly(o.time[longest], known[longest], step)[1], rate, window)
    v, a = np.empty_like(q), np.empty_like(q)
    for s in spans:
        grid, on_grid = _resample_evenly(o.time[s], speed[s], step)
        padding = min(len(grid) - 1, 3 * round(rate / cutoff))
        smooth = apply_zero_phase_filter(on_grid, 4, min(cutoff, 0.45 * rate), rate, padding)
        v[s] = _interpolate_at(o.time[s], grid, smooth)
        a[s] = _interpolate_at(o.time[s], grid, np.gradient(smooth, grid, axis=0))
    return v, a, cutoff


def is_evenly_sampled(time: Array) -> bool:
    """Return whether samples are even enough for digital filters."""
    steps = np.diff(time)
    return len(time) > 1 and bool(np.abs(steps - steps.mean()).max() < thresholds.SHARES.small * steps.mean())


def _resample_evenly(time: Array, x: Array, dt: float) -> tuple[Array, Array]:
    """Resample values (…, n) to steps of ``dt`` by linear interpolation; unchanged for ``dt`` = 0."""
    if dt <= 0:
        return time, x
    grid = time[0] + dt * np.arange(int(np.ceil((time[-1] - time[0]) / dt - 1e-6)) + 1)
    return grid, _interpolate_at(grid, time, x)


def _interpolate_at(t: Array, time: Array, x: Array) -> Array:
    return x if t is time else np.stack([np.interp(t, time, c) for c in x.T], axis=1)


def _find_cutoff_frequency(x: Array, rate: float, window: str) -> float:
    """Return the cutoff (Hz): half above the highest frequency with joint velocity ten times above the noise.

    With encoders only, the positions (M, n) decide: their noise is white, but grows with frequency in the derivative.
    """
    from scipy.signal import welch  # takes seconds to import

    f, power = welch(x, rate, window=window, nperseg=min(len(x), 1024), axis=0)
    floor = np.median(power[2 * len(f) // 3 :], axis=0)
    above = np.flatnonzero((power > thresholds.RATIOS.implausible * floor).any(axis=1) & (f > 0))
    highest = float(f[above[-1]]) if len(above) else thresholds.LIMITS.cut_off_frequency
    return float(np.clip(1.5 * highest, 3.0, min(thresholds.LIMITS.cut_off_frequency, 0.4 * rate)))
