"""Types of the arguments that the compiled functions of the stock share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Heights = NDArray[np.float32]
Grid = Heights  # (4, nv, nu) of a height map; one array, because a compiled call counts references of each array
HIGH, LOW, SHARE, BOTTOM = 0, 1, 2, 3  # places along the first axis of a grid
Pair = tuple[float, float]  # along u and v
Tip = tuple[float, float, float]  # radius m, corner radius m, slope of the cone
