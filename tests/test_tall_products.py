"""Products of long matrices, computed in blocks."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.numerics import tall_products
from machopt.numerics.tall_products import multiply_tall


@pytest.mark.parametrize("shape", [(0, 6, 6), (1, 6, 6), (7, 1, 3), (20_001, 6, 6), (3, 8, 40_000), (501, 9, 1024)])
def test_blocks_give_the_product(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(1)
    a, b = rng.standard_normal(shape[:2]), rng.standard_normal(shape[1:])
    np.testing.assert_allclose(multiply_tall(a, b), a @ b, rtol=0, atol=1e-12)


def test_no_block_exceeds_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []
    product = np.matmul

    def keep(a: np.ndarray, b: np.ndarray, **more: object) -> np.ndarray:
        sizes.append(a.size * b.shape[1])
        return product(a, b, **more)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(tall_products.np, "matmul", keep)
    multiply_tall(np.ones((50_000, 6)), np.ones((6, 21)))
    assert len(sizes) > 1
    assert max(sizes) <= tall_products.SINGLE_THREAD
