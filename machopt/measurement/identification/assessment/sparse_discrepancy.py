"""Models of the discrepancy in which few places of the machine are compliant, and the others are as stated.

One common size of all missing effects spreads what a single soft base does over every link and gear. Its posterior is
then wide everywhere. Here each place (base, a link, the tool, a gear, a pair of joints) has a size of its own, found by
marginal likelihood over the same grid, the others are zero (sparse Bayesian learning, Tipping 2001). Places are added
one by one while the likelihood of the best model rises by more than the number of places to choose from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.discrepancy_names import COS, LOADED, SIN, parse_discrepancy_name
from machopt.numerics.array_types import Array
from machopt.stiffness.discrepancy_columns import CURVE_SMOOTHING

MOST_PLACES = 3  # most places that are compliant together

Columns = NDArray[np.intp]


def list_places(names: Sequence[str], own: int) -> list[Columns]:
    """Return the columns of each place, without the model's own coefficients.

    Args:
        names: Names of all columns.
        own: Number of the model's own coefficients, which come first.
    """
    found: dict[str, list[int]] = {}
    for n, name in enumerate(names[own:], start=own):
        part = parse_discrepancy_name(name)
        if part.kind == LOADED:
            continue
        kind = "angle" if part.kind in (COS, SIN) else "gear" if part.kind in CURVE_SMOOTHING else part.kind
        found.setdefault(f"{kind} {part.numbers}" if part.numbers else kind, []).append(n)
    return [np.array(at, dtype=np.intp) for at in found.values()]


def generate_sparse_spreads(
    plain: Array, places: Sequence[Columns], grid: Array, score: Callable[[Array], float]
) -> Iterator[tuple[float, Array]]:
    """Yield log-likelihood and prior sizes (K,) of models with one to three compliant places.

    Args:
        plain: (K,) prior sizes of springs and load effect alone.
        places: Columns of each place.
        grid: Sizes to be tried, above zero.
        score: Log-likelihood of the readings for prior sizes (K,).
    """
    start, taken, level = plain, set[int](), score(plain)
    for _ in range(MOST_PLACES):
        best: tuple[float, int, Array] | None = None
        for n, at in enumerate(places):
            if n in taken:
                continue
            for size in grid:
                spread = start.copy()
                spread[at] = size
                found = score(spread)
                yield found - float(np.log(len(places))), spread
                if best is None or found > best[0]:
                    best = (found, n, spread)
        if best is None or best[0] - level < np.log(len(places)):
            return
        level, start = best[0], best[2]
        taken.add(best[1])
