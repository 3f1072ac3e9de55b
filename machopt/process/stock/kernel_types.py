"""Types of the arguments that the compiled functions of the stock share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Heights = NDArray[np.float32]
Grid = tuple[Heights, Heights, Heights, Heights]  # high, low, share, bottom of a height map, each (nv, nu)
Pair = tuple[float, float]  # along u and v
Tip = tuple[float, float, float]  # radius m, corner radius m, slope of the cone
