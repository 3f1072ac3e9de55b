"""Force waveforms of measured cuts: samples over time or over the rotation of the spindle, SI."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.numerics.array_types import Array, Ints, make_arrays_read_only


@dataclass(frozen=True, kw_only=True)
class WaveformRecording:
    """C cuts of S samples in all. The samples of a cut are consecutive rows, evenly spaced."""

    samples: CuttingRecording  # one row a sample: its force; the conditions are constant within a cut
    first: Ints  # (C + 1,) row at which each cut starts; the last is S
    time: Array | None  # (S,) s, ascending within a cut; None: ``angle`` is given
    angle: Array | None  # (S,) rad, rotation of the spindle in its own sense, ascending; zero anywhere

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    @property
    def cuts(self) -> int:
        """Number of cuts C."""
        return len(self.first) - 1

    def get_rows(self, cut: int) -> slice:
        """Return the rows of a cut.

        Args:
            cut: Number of the cut, from 0.
        """
        return slice(int(self.first[cut]), int(self.first[cut + 1]))

    def list_cuts(self) -> CuttingRecording:
        """Return one row a cut: its conditions and mean force."""
        one, rows = self.samples, self.first[:-1]
        mean = [one.force[self.get_rows(n)].mean(axis=0) for n in range(self.cuts)]
        return replace(
            one,
            file=one.file[rows],
            line=one.line[rows],
            spindle_speed=one.spindle_speed[rows],
            feed=one.feed[rows],
            ae=one.ae[rows],
            ap=one.ap[rows],
            side=tuple(one.side[n] for n in rows),
            force=np.array(mean),
            travel=None if one.travel is None else one.travel[rows],
            q=None if one.q is None else one.q[rows],
        )
