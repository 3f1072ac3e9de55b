"""Products of long, narrow matrices without the threads of the linear algebra library.

A product of 20,000 × 6 by 6 × 6 takes less time than it takes to wake a thread: OpenBLAS divides it all the same, and
its threads then wait for each other. Products below its threshold stay in the calling thread.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array

SINGLE_THREAD = 200_000  # multiplications; OpenBLAS divides products above 262,144 (GEMM_MULTITHREAD_THRESHOLD = 4)


def multiply_tall(a: Array, b: Array) -> Array:
    """Return the product a b, block after block of the rows of a.

    Args:
        a: (M, K).
        b: (K, N).
    """
    rows = max(SINGLE_THREAD // max(b.size, 1), 1)
    if len(a) <= rows:
        return np.asarray(a @ b)
    out = np.empty((len(a), b.shape[1]))
    for first in range(0, len(a), rows):
        np.matmul(a[first : first + rows], b, out=out[first : first + rows])
    return out
