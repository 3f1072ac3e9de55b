"""Scrambled Sobol sequence, bit by bit that of ``scipy.stats.qmc.Sobol``, without the time to load ``scipy.stats``.

A point is an exclusive or of direction numbers, chosen by the Gray code of its index. The direction numbers of Joe and
Kuo are multiplied by random lower triangular binary matrices, and the points are shifted by a random number.

Source:
    S. Joe, F. Y. Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30
    (2008) 2635, direction numbers new-joe-kuo-6; J. Matoušek, On the L2-discrepancy for anchored boxes, J. Complexity
    14 (1998) 527, scrambling.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

BITS = 30
Words = NDArray[np.uint32]
# of each dimension but the first: primitive polynomial, and the first direction numbers
_DIRECTIONS = (
    (3, (1,)),
    (7, (1, 3)),
    (11, (1, 3, 1)),
    (13, (1, 1, 1)),
    (19, (1, 1, 3, 3)),
    (25, (1, 3, 5, 13)),
    (37, (1, 1, 5, 5, 17)),
    (41, (1, 1, 5, 5, 5)),
    (47, (1, 1, 7, 11, 19)),
    (55, (1, 1, 5, 1, 1)),
    (59, (1, 1, 1, 3, 11)),
    (61, (1, 3, 5, 5, 31)),
    (67, (1, 3, 3, 9, 7, 49)),
    (91, (1, 1, 1, 15, 21, 21)),
    (97, (1, 3, 1, 13, 27, 49)),
    (103, (1, 1, 1, 15, 7, 5)),
    (109, (1, 3, 1, 15, 13, 25)),
    (115, (1, 1, 5, 5, 19, 61)),
    (131, (1, 3, 7, 11, 23, 15, 103)),
    (137, (1, 3, 7, 13, 13, 15, 69)),
    (143, (1, 1, 3, 13, 7, 35, 63)),
    (145, (1, 3, 5, 9, 1, 25, 53)),
    (157, (1, 3, 1, 13, 9, 35, 107)),
    (167, (1, 3, 1, 5, 27, 61, 31)),
    (171, (1, 1, 5, 11, 19, 41, 61)),
    (185, (1, 3, 5, 3, 3, 13, 69)),
    (191, (1, 1, 7, 13, 1, 19, 1)),
    (193, (1, 3, 7, 5, 13, 19, 59)),
    (203, (1, 1, 3, 9, 25, 29, 41)),
    (211, (1, 3, 5, 13, 23, 1, 55)),
    (213, (1, 3, 7, 3, 13, 59, 17)),
    (229, (1, 3, 1, 3, 5, 53, 69)),
    (239, (1, 1, 5, 5, 23, 33, 13)),
    (241, (1, 1, 7, 7, 1, 61, 123)),
    (247, (1, 1, 7, 9, 13, 61, 49)),
    (253, (1, 3, 3, 5, 3, 55, 33)),
    (285, (1, 3, 1, 15, 31, 13, 49, 245)),
    (299, (1, 3, 5, 15, 31, 59, 63, 97)),
    (301, (1, 3, 1, 11, 11, 11, 77, 249)),
    (333, (1, 3, 1, 11, 27, 43, 71, 9)),
    (351, (1, 1, 7, 15, 21, 11, 81, 45)),
    (355, (1, 3, 7, 3, 25, 31, 65, 79)),
    (357, (1, 3, 1, 1, 19, 11, 3, 205)),
    (361, (1, 1, 5, 9, 19, 21, 29, 157)),
    (369, (1, 3, 7, 11, 1, 33, 89, 185)),
    (391, (1, 3, 3, 3, 15, 9, 79, 71)),
    (397, (1, 3, 7, 11, 15, 39, 119, 27)),
    (425, (1, 1, 3, 1, 11, 31, 97, 225)),
    (451, (1, 1, 1, 3, 23, 43, 57, 177)),
    (463, (1, 3, 7, 7, 17, 17, 37, 71)),
    (487, (1, 3, 1, 5, 27, 63, 123, 213)),
    (501, (1, 1, 3, 5, 11, 43, 53, 133)),
    (529, (1, 3, 5, 5, 29, 17, 47, 173, 479)),
    (539, (1, 3, 3, 11, 3, 1, 109, 9, 69)),
    (545, (1, 1, 1, 5, 17, 39, 23, 5, 343)),
    (557, (1, 3, 1, 5, 25, 15, 31, 103, 499)),
    (563, (1, 1, 1, 11, 11, 17, 63, 105, 183)),
    (601, (1, 1, 5, 11, 9, 29, 97, 231, 363)),
    (607, (1, 1, 5, 15, 19, 45, 41, 7, 383)),
    (617, (1, 3, 7, 7, 31, 19, 83, 137, 221)),
    (623, (1, 1, 1, 3, 23, 15, 111, 223, 83)),
    (631, (1, 1, 5, 13, 31, 15, 55, 25, 161)),
    (637, (1, 1, 3, 13, 25, 47, 39, 87, 257)),
)
LARGEST_DIMENSION = len(_DIRECTIONS) + 1


def draw_scrambled_sobol(dimension: int, count: int, rng: np.random.Generator) -> Array:
    """Return (count, dimension) numbers in 0 ≤ u < 1.

    Args:
        dimension: Numbers per point.
        count: Number of points, a power of two.
        rng: Generator of the scrambling.
    """
    if dimension > LARGEST_DIMENSION:
        from scipy.stats import qmc

        return np.asarray(qmc.Sobol(dimension, scramble=True, rng=rng).random(count))
    own = rng.spawn(1)[0]  # as SciPy does
    shift, columns = _scramble(_build_direction_numbers(dimension), own)
    words = shift[None]
    for bit in range(count.bit_length() - 1):  # the Gray code counts down where the next bit is set
        words = np.concatenate([words, words[::-1] ^ columns[:, bit]])
    return np.asarray(words * (1.0 / 2**BITS))


def _build_direction_numbers(dimension: int) -> Words:
    """Return (dimension, BITS) direction numbers, the first bit of a point highest."""
    out = np.ones((dimension, BITS), np.uint64)
    for d, (polynomial, first) in enumerate(_DIRECTIONS[: dimension - 1], start=1):
        degree, v = len(first), list(first)
        for j in range(degree, BITS):
            value = v[j - degree]
            for k in range(degree):
                if polynomial >> (degree - 1 - k) & 1:
                    value ^= v[j - k - 1] << (k + 1)
            v.append(value)
        out[d] = v
    return (out << np.arange(BITS - 1, -1, -1, dtype=np.uint64)).astype(np.uint32)


def _scramble(directions: Words, rng: np.random.Generator) -> tuple[Words, Words]:
    """Return (dimension,) the shift of the points and (dimension, BITS) scrambled direction numbers."""
    dimension = len(directions)
    power = 1 << np.arange(BITS, dtype=np.uint32)
    shift = rng.integers(2, size=(dimension, BITS), dtype=np.uint32) @ power
    lower = np.tril(rng.integers(2, size=(dimension, BITS, BITS), dtype=np.uint32))
    lower[:, np.arange(BITS), np.arange(BITS)] = 1
    bits = directions[:, :, None] >> np.arange(BITS - 1, -1, -1, dtype=np.uint32) & 1  # (dimension, BITS, BITS)
    mixed = np.matmul(bits.astype(float), np.swapaxes(lower, 1, 2).astype(float)).astype(np.uint32) & 1
    return shift.astype(np.uint32), (mixed @ power[::-1]).astype(np.uint32)
