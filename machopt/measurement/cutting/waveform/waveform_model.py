"""Forces of all samples and their exact derivatives by every unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.measurement.cutting.coefficient_fit import UNITS
from machopt.measurement.cutting.waveform.chip_integrals import ChipIntegrals, build_chip_integrals
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.process.milling.mean_force import get_axial_hand
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter

COEFFICIENTS = 6
RUNOUT = slice(6, 8)  # of the unknowns, µm
MICRO = 1e-6


@dataclass(frozen=True, kw_only=True)
class WaveformCut:
    """One cut: its integrals, its samples, and the rotation by the stated speed or the encoder."""

    chips: ChipIntegrals
    feed_per_tooth: float  # m
    rotation: Array  # (S_c,) rad, about the middle of the cut (time) or from the encoder's zero (angle)
    force: Array  # (S_c, 3) N, travel, normal, axial, on the tool
    mixing: Array  # (3, 6, 6) force per coefficient and integral, N/mm² and N/mm

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True)
class WaveformModel:
    """Unknowns: six coefficients (N/mm², N/mm), run-out (µm), offsets (rad), speed errors (relative)."""

    cuts: tuple[WaveformCut, ...]
    teeth: int
    has_own_offset: bool  # of each cut, with a speed error (time); else one offset for all (angle)

    @property
    def size(self) -> int:
        """Number of unknowns P."""
        return 8 + (2 * len(self.cuts) if self.has_own_offset else 1)

    def get_offset_index(self, cut: int) -> int:
        """Return the index of a cut's angular offset among the unknowns.

        Args:
            cut: Number of the cut, from 0.
        """
        return 8 + (cut if self.has_own_offset else 0)

    def compute_phase(self, x: Array, cut: int) -> Array:
        """Return the rotation φ of tooth 0 at the tip, (S_c,) rad.

        Args:
            x: (P,) unknowns.
            cut: Number of the cut, from 0.
        """
        speed = 1.0 + x[8 + len(self.cuts) + cut] if self.has_own_offset else 1.0
        return np.asarray(speed * self.cuts[cut].rotation + x[self.get_offset_index(cut)])

    def evaluate(self, x: Array, cut: int) -> tuple[Array, Array]:
        """Return the forces of a cut and their derivatives.

        Args:
            x: (P,) unknowns.
            cut: Number of the cut, from 0.

        Returns:
            (S_c, 3) N and (S_c, 3, P).
        """
        one = self.cuts[cut]
        B, dB = one.chips.evaluate(self.compute_phase(x, cut), one.feed_per_tooth, MICRO * x[RUNOUT])
        design = np.einsum("fqb,sb->sfq", one.mixing, B)
        slope = np.einsum("fqb,q,sbk->sfk", one.mixing, x[:COEFFICIENTS], dB, optimize=True)
        J = np.zeros((len(B), 3, self.size))
        J[..., :COEFFICIENTS], J[..., RUNOUT] = design, MICRO * slope[..., 1:]
        J[..., self.get_offset_index(cut)] = slope[..., 0]
        if self.has_own_offset:
            J[..., 8 + len(self.cuts) + cut] = one.rotation[:, None] * slope[..., 0]
        return design @ x[:COEFFICIENTS], J

    def fold(self, bins: int) -> WaveformModel:
        """Return the same cuts with the mean forces over ``bins`` parts of one revolution as samples.

        Args:
            bins: Number of parts.
        """
        return WaveformModel(tuple(_fold_cut(cut, bins) for cut in self.cuts), self.teeth, self.has_own_offset)


def build_waveform_model(
    recording: WaveformRecording, cutter: MillingCutter, force: Array, speeds: Array
) -> WaveformModel:
    """Return the model of a recording.

    Args:
        recording: Samples of all cuts.
        cutter: Flat end mill.
        force: (S, 3) N, travel, normal, axial, on the tool.
        speeds: (C,) rev/s, spindle speed by which the samples are folded; not used with an encoder.
    """
    one, cuts = recording.samples, []
    for n in range(recording.cuts):
        rows = recording.get_rows(n)
        row = rows.start
        side: CutSide = one.side[row]
        cut = MillingCut(side, one.spindle)
        ae = cutter.diameter if side == "slot" and np.isnan(one.ae[row]) else float(one.ae[row])
        if recording.angle is not None:
            rotation = recording.angle[rows]
        else:
            assert recording.time is not None
            time = recording.time[rows]
            rotation = 2.0 * math.pi * speeds[n] * (time - 0.5 * (time[0] + time[-1]))
        cuts.append(
            WaveformCut(
                chips=build_chip_integrals(cutter, cut, ae, float(one.ap[row])),
                feed_per_tooth=float(one.feed[row] / (one.spindle_speed[row] * cutter.teeth)),
                rotation=np.array(rotation),
                force=np.array(force[rows]),
                mixing=_build_mixing(cut.mirror, get_axial_hand(cutter, cut)),
            )
        )
    return WaveformModel(tuple(cuts), cutter.teeth, recording.angle is None)


def _build_mixing(mirror: float, hand: float) -> Array:
    """Return (3, 6, 6): forces per Ktc, Krc, Kac, Kte, Kre, Kae and per h sin, h cos, h, sin, cos, 1."""
    out = np.zeros((3, 6, 6))
    for chip, first in ((0, 0), (3, 3)):  # cutting terms and chip integrals, edge terms and edge integrals
        out[0, first, chip + 1], out[0, first + 1, chip] = -1.0, -1.0
        out[1, first, chip], out[1, first + 1, chip + 1] = mirror, -mirror
        out[2, first + 2, chip + 2] = -hand
    return np.asarray(out * np.array(UNITS)[:, None])


def _fold_cut(cut: WaveformCut, bins: int) -> WaveformCut:
    turn = 2.0 * math.pi
    number: NDArray[np.intp] = np.floor(cut.rotation / turn * bins).astype(np.intp) % bins
    count = np.maximum(np.bincount(number, minlength=bins), 1)
    mean = np.stack([np.bincount(number, cut.force[:, f], bins) / count for f in range(3)], axis=1)
    return replace(cut, rotation=np.asarray((np.arange(bins) + 0.5) * (turn / bins), float), force=mean)
