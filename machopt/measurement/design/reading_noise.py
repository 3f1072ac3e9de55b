"""How uncertain a reading will be, before any is taken, and what readings at one pose have in common.

A reading is d = δ + b(pose) + e. b, the same for every load at one pose, is what unloading does not remove: encoder and
registration errors, slow drift. e holds the instrument (the loaded state and the mean of the unloaded states before
and after it: 1.5 times the variance of one), the load cycle, and the load's own error, a share of it and therefore
of the displacement. Further cycles of the same load average the first two of e, not b and not the load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array

UNLOADED_TWICE = 1.5  # variance of (loaded − mean of two unloaded readings), in variances of one


@dataclass(frozen=True, kw_only=True)
class ReadingNoise:
    """Standard uncertainties of a displacement reading."""

    displacement: float  # m, one coordinate read once by the instrument
    cycle: float = 0.0  # m, one coordinate, new in each load cycle
    pose: float = 0.0  # m, one coordinate, shared by all readings at a pose
    force: float = 0.0  # share of the load
    targets: float | None = None  # m from the TCP to the targets that give rotations; None: translations only
    cycles: int = 1  # load cycles averaged into a reading

    @property
    def dimensions(self) -> int:
        """3 translations, or 6 with rotations."""
        return 3 if self.targets is None else 6

    @property
    def reading(self) -> float:
        """m, 1 sigma of one coordinate of one cycle's reading, without the load's own error."""
        return float(np.sqrt(UNLOADED_TWICE * self.displacement**2 + self.cycle**2 + self.pose**2))

    def covariance(self, displacement: Array) -> Array:
        """(N, D, D) m², m·rad, rad² of e for expected displacements (N, D)."""
        own = (UNLOADED_TWICE * self.displacement**2 + self.cycle**2) / self.cycles
        out = self.force**2 * displacement[:, :, None] * displacement[:, None, :]
        out[:, np.arange(self.dimensions), np.arange(self.dimensions)] += own * self._per_row() ** 2
        return np.asarray(out)

    def shared(self) -> Array:
        """(D, D) of b."""
        return np.diag(self.pose**2 * self._per_row() ** 2)

    def _per_row(self) -> Array:
        """1 for translations; 1/distance for rotations, which are seen as displacements of the targets."""
        return np.ones(3) if self.targets is None else np.repeat([1.0, 1.0 / self.targets], 3)


HOLD = 10.0  # s between the readings of a cycle
