"""The one name for an array of numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Float64; shape, unit and frame stand where it is used."""
