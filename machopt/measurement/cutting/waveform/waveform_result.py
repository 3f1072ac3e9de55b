"""Result of a waveform fit beyond the coefficients: run-out, offsets, folded forces, range of chip thickness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.process.milling.engagement_angles import compute_chip_thickness, compute_contact_arc
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter


@dataclass(frozen=True, kw_only=True)
class RunoutEstimate:
    """Radial run-out; without a significant one the upper bound holds and the angle is not determined."""

    amplitude: float  # m
    interval: tuple[float, float]  # m
    angle: float | None  # rad from tooth 0, in the sense of rotation, |angle| ≤ π/N; None: not determined
    angle_interval: tuple[float, float] | None  # rad


@dataclass(frozen=True, kw_only=True)
class FoldedWaveform:
    """One cut over a revolution: mean measured and fitted force in parts of the rotation of tooth 0."""

    angle: Array  # (n,) rad
    measured: Array  # (n, 3) N
    predicted: Array  # (n, 3) N

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True, kw_only=True)
class WaveformResult:
    """What a waveform shows beyond the coefficients."""

    runout: RunoutEstimate | None  # None: a cutter of one tooth shows none
    offset: Array  # (C,) rad, rotation of tooth 0 at the first sample (time) or at the encoder's zero (angle)
    offset_sigma: Array  # (C,) rad
    spindle_speed: Array  # (C,) rev/s, fitted (time) or stated (angle)
    samples: int
    noise_order: int  # of the autoregression
    misfit_ratio: float
    has_misfit: bool
    folded: tuple[FoldedWaveform, ...]

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


def compute_chip_range(
    recording: CuttingRecording, cutter: MillingCutter, feed_per_tooth: Array
) -> tuple[float, float]:
    """Return the least mean and the largest chip thickness of the cuts, m.

    Args:
        recording: One row a cut.
        cutter: Flat end mill.
        feed_per_tooth: (C,) m.
    """
    means, peaks = [], []
    for n, fz in enumerate(feed_per_tooth):
        side: CutSide = recording.side[n]  # type: ignore[assignment]
        ae = cutter.diameter if side == "slot" else recording.ae[n]
        arc = compute_contact_arc(cutter, MillingCut(side, recording.spindle), np.array(ae), cutter.radius)
        mean, peak = compute_chip_thickness(np.array(fz), arc)
        means.append(float(mean))
        peaks.append(float(peak))
    return min(means), max(peaks)
