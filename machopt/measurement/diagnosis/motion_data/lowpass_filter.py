"""Zero-phase low-pass filter. ``scipy.signal`` takes seconds to import, so it is imported for motions only."""

from __future__ import annotations

from machopt.numerics.array_types import Array


def apply_zero_phase_filter(x: Array, order: int, cutoff: float, rate: float, padding: int | None = None) -> Array:
    """Apply a Butterworth low-pass along the first axis, forwards and backwards.

    Args:
        x: (M, …) evenly sampled signal.
        order: Order of a single pass.
        cutoff: Cutoff frequency, Hz, below half the sampling rate.
        rate: Sampling rate, Hz.
        padding: Samples mirrored at either end; None uses the default of scipy.

    Returns:
        (M, …) filtered signal without phase delay.
    """
    from scipy.signal import butter, sosfiltfilt

    return sosfiltfilt(butter(order, cutoff, fs=rate, output="sos"), x, axis=0, padlen=padding)  # type: ignore[no-any-return]
