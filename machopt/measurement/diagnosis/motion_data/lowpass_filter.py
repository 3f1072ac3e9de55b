"""Low-pass without delay. ``scipy.signal`` takes seconds to import, which only a motion should wait for."""

from __future__ import annotations

from machopt.numerics.array_types import Array


def apply_zero_phase_filter(x: Array, order: int, cutoff: float, rate: float, padding: int | None = None) -> Array:
    """A Butterworth filter along the first axis, run forwards and backwards.

    Args:
        x: (M, …) even samples.
        order: of one run; it counts twice.
        cutoff, rate: Hz; the cutoff lies below half the rate.
        padding: samples that are mirrored at either end; None: as scipy chooses.

    Returns:
        (M, …), not late.
    """
    from scipy.signal import butter, sosfiltfilt

    return sosfiltfilt(butter(order, cutoff, fs=rate, output="sos"), x, axis=0, padlen=padding)  # type: ignore[no-any-return]
