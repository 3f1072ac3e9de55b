"""Values cached with the object from which they are computed."""

from __future__ import annotations

import gc
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.identity_cache import IdentityCache


@dataclass(frozen=True)
class Owner:
    """An object without a hash."""

    numbers: NDArray[np.float64]


def test_value_is_computed_once_per_object_and_dropped_with_it() -> None:
    calls: list[Owner] = []
    cache: IdentityCache[Owner, float] = IdentityCache()

    def compute(owner: Owner) -> float:
        calls.append(owner)
        return float(owner.numbers.sum())

    one = Owner(np.ones(3))
    other = replace(one, numbers=np.ones(4))
    assert [cache.get(one, compute), cache.get(one, compute), cache.get(other, compute)] == [3.0, 3.0, 4.0]
    assert len(calls) == 2
    assert len(cache) == 2
    calls.clear()
    del one
    gc.collect()
    assert len(cache) == 1
    del other
    gc.collect()
    assert len(cache) == 0
