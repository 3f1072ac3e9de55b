"""Costs of the search over external joint values compared with a plain search over all pairs of vertices."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.planning.external_axis_optimization import value_grid_search_kernels as kernels
from machopt.planning.external_axis_optimization.value_grid_search_kernels import JOINED, KEPT, SAME

STATIONS = 5
GRIDS = 300


def compute_plain_costs(
    node: np.ndarray,
    q: np.ndarray,
    e: np.ndarray,
    phi: np.ndarray,
    number: np.ndarray,
    branches: int,
    stable: bool,
    kind: np.ndarray,
    priced: np.ndarray,
    slowness: np.ndarray,
) -> np.ndarray:
    """Return (S, V) costs by testing every source of every vertex; the joints have no further whole turns."""
    (S, V), B, R = node.shape, branches, phi.shape[1]
    b, r, g = np.arange(V) % B, np.arange(V) // B % R, np.arange(V) // (B * R)
    none, own = np.zeros((V, 6), np.int8), np.zeros((V, 6), np.int8)
    out = np.full((S, V), np.inf)
    out[0] = node[0]
    for s in range(1, S):
        for v in range(V):
            for u in range(V):
                change = np.abs(e[s, g[v]] - e[s - 1, g[u]])
                turn = phi[s, r[v]] - phi[s - 1, r[u]]
                turn = abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))
                barred = kind[s, SAME] and number[s, g[v]] != number[s - 1, g[u]]
                if kind[s, KEPT]:
                    barred = barred or u != v
                elif stable and kind[s, JOINED]:
                    barred = barred or b[u] != b[v]
                if barred or not np.isfinite(out[s - 1, u] + node[s, v]):
                    continue
                step = kernels._step(
                    q[s],
                    own,
                    v,
                    q[s - 1],
                    none,
                    u,
                    float(change.sum()),
                    float((change * slowness[6:]).max()),
                    float(turn),
                    slowness,
                    priced[s],
                    np.inf,
                )
                out[s, v] = min(out[s, v], out[s - 1, u] + step + node[s, v])
    return out


@pytest.mark.slow
@pytest.mark.parametrize("stable", [True, False])
def test_costs_equal_those_of_a_plain_search(*, stable: bool) -> None:
    """Up to four of five vertices of the grid are infeasible; runs, rapid moves and plunges are in any order."""
    rng = np.random.default_rng(7)
    for _ in range(GRIDS):
        G, R, B = (int(rng.integers(1, n)) for n in (4, 5, 4))
        V = G * R * B
        node = rng.uniform(0.0, 1.0, (STATIONS, V))
        node[rng.random(node.shape) < rng.uniform(0.0, 0.8)] = np.inf
        q, e = rng.uniform(-3.0, 3.0, (STATIONS, V, 6)), rng.uniform(0.0, 1.0, (STATIONS, G, 1))
        phi = np.sort(rng.uniform(-3.0, 3.0, (STATIONS, R)), axis=1)
        number = rng.integers(0, 2, (STATIONS, G))
        kind = rng.random((STATIONS, 3)) < [0.2, 0.6, 0.2]
        priced, slowness = rng.uniform(0.0, 1.0, (STATIONS, 4)), rng.uniform(0.0, 1.0, 7)
        more, onward = np.zeros((STATIONS, V, 6), np.int8), np.zeros((STATIONS, V))
        found = kernels.compute_reach_costs(
            node, q, more, e, phi, number, B, stable, kind, priced, slowness, 1, onward, 1e9
        )
        plain = compute_plain_costs(node, q, e, phi, number, B, stable, kind, priced, slowness)
        np.testing.assert_allclose(found, plain, rtol=1e-12, atol=1e-12)
