"""Names of array types; shape, unit and frame are documented where they are used."""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]


def make_arrays_read_only(found: object) -> None:
    """Make the arrays of a dataclass read-only, called from its ``__post_init__``.

    Args:
        found: dataclass instance.
    """
    for value in vars(found).values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)


WORDS = 8, 4, 2  # bytes
SHORT = 32  # length of a last axis up to which a loop is faster than NumPy


def compute_any_last(flags: Bools) -> Bools:
    """Return (...,) ``flags.any(axis=-1)``: NumPy takes 10 to 60 times as long where n is small.

    Args:
        flags: (..., n).
    """
    n = flags.shape[-1]
    if n > SHORT:
        return np.asarray(flags.any(axis=-1))
    word = next((k for k in WORDS if n > 0 and n % k == 0), 1)
    if word > 1 and flags.flags.c_contiguous:  # several flags at once, as the bytes of one number
        words = np.moveaxis(flags.view(f"u{word}"), -1, 0)
        return np.asarray(reduce(np.bitwise_or, words) != 0)
    return np.asarray(reduce(np.logical_or, np.moveaxis(flags, -1, 0), np.zeros(flags.shape[:-1], bool)))
