"""Compiled search over values, rotations and branches compared with a plain one, and cached distances."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.collision.distance_bounds import _find_farther
from machopt.planning.external_axes.moving_axis_kernels import find_cheapest_value_sequence
from machopt.planning.external_axes.moving_axis_search import _number_neighbours


@pytest.mark.parametrize("seed", range(6))
def test_cheapest_sequence_equals_that_of_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    S, R, B = 6, 4 + seed % 3, 1 + seed % 2
    near = _number_neighbours([3, 2] if seed % 2 else [4])
    G, size = len(near), R * B
    node, e = rng.uniform(0.0, 1.0, (S, G * size)), rng.uniform(-1.0, 1.0, (S, G, 2))
    edges = rng.uniform(0.0, 1.0, (S, 3 * near.shape[1], G * size)).astype(np.float32)
    joined, flown = np.array([False, True, True, seed < 3, True, True]), rng.uniform(0.0, 0.3, S)

    def price(s: int, u: int, v: int) -> float:
        """Return the cost of the step from vertex u to vertex v, by hand."""
        g, h, (r, b), (p, a) = v // size, u // size, divmod(v % size, B), divmod(u % size, B)
        way = flown[s] * np.abs(e[s, g] - e[s - 1, h]).sum()
        if not joined[s]:
            return float(way)
        steps = [dr for dr in (-1, 0, 1) if (r + dr) % R == p]
        if a != b or h not in near[g] or not steps:
            return float("inf")
        k = near[g].tolist().index(h)
        return float(way + edges[s, 3 * k + steps[0] + 1, v])

    least = node[0]
    for s in range(1, S):
        least = np.array(
            [min(least[u] + price(s, u, v) for u in range(len(least))) + node[s, v] for v in range(len(least))]
        )
    vertex, total = find_cheapest_value_sequence(node, edges, near, e, R, B, joined, flown)
    assert total == pytest.approx(least.min(), rel=1e-9)
    own = node[0, vertex[0]] + sum(price(s, vertex[s - 1], vertex[s]) + node[s, vertex[s]] for s in range(1, S))
    assert own == pytest.approx(total, rel=1e-9)


def test_cached_distances_prove_what_each_of_them_proves() -> None:
    rng = np.random.default_rng(3)
    q, at, distance, levers = (
        rng.normal(size=(50, 2)),
        rng.normal(size=(9, 2)),
        rng.uniform(0, 2, 9),
        np.array([0.3, 1.0]),
    )
    bound = (distance[:, None] - np.abs(at[:, None] - q) @ levers).max(axis=0)
    least = bound + rng.choice([-0.01, 0.01], 50)
    assert np.array_equal(_find_farther(q, least, at, distance, levers), bound >= least)
    assert not _find_farther(q, least, at[:0], distance[:0], levers).any()
