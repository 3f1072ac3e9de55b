"""Noise model of a reading before the measurement, including the errors shared by the readings of a pose.

A reading is d = δ + b(pose) + e. b is common to all loads at a pose and is not removed by unloading: encoder and
registration errors, slow drift. e contains the instrument (the loaded state and the mean of the unloaded states
before and after it: 1.5 times the variance of one), the load cycle, and the relative error of the load and thus of
the displacement. Further cycles of the same load average the first two parts of e, but neither b nor the load error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array

UNLOADED_TWICE = 1.5  # variance of (loaded − mean of two unloaded readings), in variances of one


@dataclass(frozen=True, kw_only=True)
class ReadingNoise:
    """Standard uncertainties of a displacement reading."""

    displacement: float  # m per coordinate, single reading of the instrument
    cycle: float = 0.0  # m per coordinate, independent between load cycles
    pose: float = 0.0  # m per coordinate, shared by all readings at a pose
    force: float = 0.0  # relative, of the load
    targets: float | None = None  # m, distance of the targets from the TCP for rotations; None: translations only
    cycles: int = 1  # load cycles averaged into a reading

    @property
    def dimensions(self) -> int:
        """Number of coordinates: 3 translations, or 6 with rotations."""
        return 3 if self.targets is None else 6

    @property
    def reading(self) -> float:
        """Standard uncertainty (m) of one coordinate of one cycle's reading, without load error."""
        return float(np.sqrt(UNLOADED_TWICE * self.displacement**2 + self.cycle**2 + self.pose**2))

    def covariance(self, displacement: Array) -> Array:
        """Return the covariance of e.

        Args:
            displacement: (N, D) expected displacements, m and rad.

        Returns:
            (N, D, D) m², m·rad, rad².
        """
        own = (UNLOADED_TWICE * self.displacement**2 + self.cycle**2) / self.cycles
        out = self.force**2 * displacement[:, :, None] * displacement[:, None, :]
        out[:, np.arange(self.dimensions), np.arange(self.dimensions)] += own * self._compute_row_scales() ** 2
        return np.asarray(out)

    def shared(self) -> Array:
        """Return the covariance (D, D) of b."""
        return np.diag(self.pose**2 * self._compute_row_scales() ** 2)

    def _compute_row_scales(self) -> Array:
        """Return 1 for translations and 1/distance for rotations (measured as displacements of the targets)."""
        return np.ones(3) if self.targets is None else np.repeat([1.0, 1.0 / self.targets], 3)


HOLD = 10.0  # s between the readings of a cycle
