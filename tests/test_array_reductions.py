"""Fast array reductions against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.numerics.array_types import SHORT, compute_any_last


@pytest.mark.parametrize(
    "shape",
    [(3, 5, 0), (0, 4), (7, 1), (6, 5, 4), (9, 6), (8, 5), (3, 7, 16), (40, SHORT), (40, SHORT + 1), (3,), (8,)],
)
def test_any_along_last_axis_equals_numpy(shape: tuple[int, ...]) -> None:
    flags = np.random.default_rng(0).random(shape) < 0.2
    assert np.array_equal(compute_any_last(flags), flags.any(axis=-1))
    assert np.array_equal(compute_any_last(flags[::2]), flags[::2].any(axis=-1)) if len(shape) > 1 else True
    assert compute_any_last(flags).dtype == bool
