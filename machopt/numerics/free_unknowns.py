"""Least squares over some of the unknowns of a model, where residuals and derivatives come from one evaluation."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array


class FreeUnknownSystem(ABC):
    """Residuals and derivatives of the free unknowns; one evaluation serves both.

    Args:
        x: (n,) all unknowns; those that are not free keep these values.
        free: selects the free unknowns: (n,) mask, or their numbers.
    """

    def __init__(self, x: Array, free: NDArray[np.bool_] | NDArray[np.int64]) -> None:
        self.x, self.free = np.array(x), free
        self._values: Array | None = None

    @abstractmethod
    def evaluate(self, x: Array) -> tuple[Array, Array]:
        """Return the residuals (r,) and their derivatives by the free unknowns (r, f).

        Args:
            x: (n,) all unknowns.
        """

    def expand(self, values: Array) -> Array:
        """Return all unknowns (n,).

        Args:
            values: (f,) the free ones.
        """
        out = np.array(self.x)
        out[self.free] = values
        return out

    def compute_residuals(self, values: Array) -> Array:
        """Return the residuals (r,).

        Args:
            values: (f,) the free unknowns.
        """
        return self._get(values)[0]

    def compute_jacobian(self, values: Array) -> Array:
        """Return the derivatives of the residuals (r, f).

        Args:
            values: (f,) the free unknowns.
        """
        return self._get(values)[1]

    def _get(self, values: Array) -> tuple[Array, Array]:
        if self._values is None or not np.array_equal(self._values, values):
            self._values = np.array(values)
            self._found = self.evaluate(self.expand(values))
        return self._found
