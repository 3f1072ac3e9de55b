"""Transport of a direction normal to the tool axis along a path by minimal rotation (compiled, because it is
sequential).
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

OPPOSITE = -0.999  # cosine between neighbouring axes without a unique minimal rotation


def transport_reference(natural: Array, axis: Array, runs: tuple[tuple[int, int], ...]) -> Array:
    """Transport each run's first reference along its tool axes by minimal rotation.

    Args:
        natural: (P, 3) directions; the first of each run is transported, others are used where axes reverse.
        axis: (P, 3) unit.
        runs: first and last point of each.
    """
    out = np.array(natural)
    for first, last in runs:
        _carry(out[first : last + 1], np.ascontiguousarray(axis[first : last + 1]))
    return out


@jit_compile
def _carry(x: Array, axis: Array) -> None:
    """In place; x' = x + v × x + v × (v × x) / (1 + c) with v = a × b, c = a · b turns a onto b (Rodrigues)."""
    for i in range(1, len(x)):
        a0, a1, a2 = axis[i - 1, 0], axis[i - 1, 1], axis[i - 1, 2]
        b0, b1, b2 = axis[i, 0], axis[i, 1], axis[i, 2]
        x0, x1, x2 = x[i - 1, 0], x[i - 1, 1], x[i - 1, 2]
        if a0 != b0 or a1 != b1 or a2 != b2:
            c = a0 * b0 + a1 * b1 + a2 * b2
            if c > OPPOSITE:
                v0, v1, v2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
                w0, w1, w2 = v1 * x2 - v2 * x1, v2 * x0 - v0 * x2, v0 * x1 - v1 * x0
                x0 += w0 + (v1 * w2 - v2 * w1) / (1.0 + c)
                x1 += w1 + (v2 * w0 - v0 * w2) / (1.0 + c)
                x2 += w2 + (v0 * w1 - v1 * w0) / (1.0 + c)
            else:
                x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
            along = x0 * b0 + x1 * b1 + x2 * b2
            x0, x1, x2 = x0 - along * b0, x1 - along * b1, x2 - along * b2
            size = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
            x0, x1, x2 = x0 / size, x1 / size, x2 / size
        x[i, 0], x[i, 1], x[i, 2] = x0, x1, x2
