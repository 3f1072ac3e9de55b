"""Curves through the nodes of a run: natural cubic splines."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def interpolate_naturally(at: Array, values: Array, wanted: Array) -> Array:
    """Return the natural cubic spline through values; a constant or a line through one or two of them.

    scipy's own splines would import scipy.spatial while a thread does
    (:mod:`machopt.planning.kernel_precompilation`), which was seen to hang once.

    Args:
        at: (K,) rising.
        values: (K, …) at these places.
        wanted: (W,) places within them.

    Returns:
        (W, …).
    """
    flat = np.asarray(values, float).reshape(len(at), -1)
    shape = (len(wanted), *np.shape(values)[1:])
    if len(at) == 1:
        return np.broadcast_to(flat[0], (len(wanted), flat.shape[1])).reshape(shape).copy()
    h = np.diff(at)
    bend = np.zeros_like(flat)
    if len(at) > 2:
        from scipy.linalg import solveh_banded

        diagonal = (h[1:] + h[:-1]) / 3.0
        banded = np.zeros((2, len(at) - 2))
        banded[1], banded[0, 1:] = diagonal, h[1:-1] / 6.0
        slope = np.diff(flat, axis=0) / h[:, None]
        change = np.diff(slope, axis=0)
        bend[1:-1] = solveh_banded(banded, change) if len(at) > 3 else change / diagonal[:, None]
    k = np.clip(np.searchsorted(at, wanted, side="right") - 1, 0, len(at) - 2)
    b = ((wanted - at[k]) / h[k])[:, None]
    a, width = 1.0 - b, h[k][:, None] ** 2 / 6.0
    out = a * flat[k] + b * flat[k + 1] + width * ((a**3 - a) * bend[k] + (b**3 - b) * bend[k + 1])
    return np.asarray(out).reshape(shape)
