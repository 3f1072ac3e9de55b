"""Turn-resolved grid: consistent whole turns compared with every sequence with every permitted turn."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from test_external_search_bound import EXACT, TURN, prices, random_lattice

from machopt.planning.external_axis_optimization.turn_resolved_grid import is_turn_consistent, resolve_turns
from machopt.planning.external_axis_optimization.value_grid_sequences import ValueGridSequences
from machopt.planning.sequence_search.worst_value_constraint import GAP

MANY = 10**6


def build_small_grid(
    seed: int, priced: tuple[float, float, float, float], flags: int, stable: bool
) -> ValueGridSequences:
    """Three stations; two of six joints have whole turns to choose from."""
    x = random_lattice(seed, priced, flags, stable)
    more = np.minimum(x.more, np.array([1, 0, 0, 0, 0, 2], np.int8))
    few = {name: getattr(x, name)[:3] for name in ("node", "raw", "q", "e", "phi", "held", "kind", "priced")}
    return replace(x, more=more[:3], **few)


def every_price_with_turns(x: ValueGridSequences) -> dict[tuple[int, ...], float]:
    """Return the minimum J of each sequence of existing vertices over all turns within the limits, one by one."""
    R, B = x.phi.shape[1], x.branches

    def poses(s: int) -> list[tuple[int, np.ndarray]]:
        return [
            (v, x.q[s, v] + TURN * np.array(turn))
            for v in np.flatnonzero(np.isfinite(x.node[s])).tolist()
            for turn in itertools.product(*(range(int(n) + 1) for n in x.more[s, v]))
        ]

    def step(s: int, u: tuple[int, np.ndarray], v: tuple[int, np.ndarray]) -> float:
        (g, r, b), (h, p, a) = (np.unravel_index(w[0], (x.node.shape[1] // (R * B), R, B)) for w in (v, u))
        same, joined, retained = x.kind[s]
        if same and x.held[s, g] != x.held[s - 1, h]:
            return np.inf
        if (joined and x.stable and a != b) or (retained and u[0] != v[0]):
            return np.inf
        way = np.r_[np.abs(v[1] - u[1]), np.abs(x.e[s, g] - x.e[s - 1, h])]
        turn = abs(np.angle(np.exp(1j * (x.phi[s, r] - x.phi[s - 1, p]))))
        seconds, travel, rotation, feed = x.priced[s]
        return float(travel * way.sum() + rotation * turn + feed * max(float((way * x.slowness).max()) - seconds, 0.0))

    message: dict[tuple[int, ...], float] = {}
    all_ = [poses(s) for s in range(len(x.node))]
    first = np.array([[step(1, u, v) for v in all_[1]] for u in all_[0]]).reshape(len(all_[0]), len(all_[1]))
    second = np.array([[step(2, u, v) for v in all_[2]] for u in all_[1]]).reshape(len(all_[1]), len(all_[2]))
    for i, (u, _) in enumerate(all_[0]):
        for j, (v, _) in enumerate(all_[1]):
            for k, (w, _) in enumerate(all_[2]):
                cost = x.node[0, u] + x.node[1, v] + x.node[2, w] + first[i, j] + second[j, k]
                cost += x.worst * max(x.raw[0, u], x.raw[1, v], x.raw[2, w])
                message[u, v, w] = min(message.get((u, v, w), np.inf), float(cost))
    return message


@given(st.integers(0, 10**6), prices, st.integers(0, 511), st.booleans())
@settings(max_examples=scale_example_count(25), deadline=None)
def test_bound_and_best_equal_those_of_every_sequence_with_every_turn(
    seed: int, priced: tuple[float, float, float, float], flags: int, stable: bool
) -> None:
    problem = build_small_grid(seed, priced, flags, stable)
    message = every_price_with_turns(problem)
    ideal = min(message.values(), default=np.inf)
    apart = resolve_turns(problem, np.zeros_like(problem.node), MANY)
    assert apart is not None
    found = apart.lattice.best()
    if not np.isfinite(ideal):
        assert found is None
        return
    assert found is not None
    total, bound, vertex = found
    assert bound <= ideal * (1 + EXACT)
    assert bound >= ideal * (1 - 1.01 * GAP)
    assert message[tuple(apart.vertex[vertex].tolist())] <= total * (1 + EXACT)
    assert ideal * (1 - EXACT) <= total <= ideal * (1 + 1.01 * GAP)
    at = np.arange(3)
    turns = (apart.lattice.q[at, vertex] - problem.q[at, apart.vertex[vertex]]) / TURN
    assert turns == pytest.approx(np.round(turns), abs=1e-9)
    assert ((turns > -0.5) & (turns < problem.more[at, apart.vertex[vertex]] + 0.5)).all()
    # without vertices that cannot be part of an equally good sequence, the result is the same
    known = ideal * (1 + EXACT)
    fewer = resolve_turns(problem, problem.through(problem.onward(known), known), MANY)
    assert fewer is not None
    assert fewer.lattice.node.size <= apart.lattice.node.size
    again = fewer.lattice.best()
    assert again is not None
    assert again[0] == pytest.approx(ideal, rel=1.01 * GAP)


@given(st.integers(0, 10**6), prices, st.integers(0, 511), st.booleans())
@settings(max_examples=scale_example_count(25), deadline=None)
def test_turns_are_consistent_where_the_best_steps_can_be_driven(
    seed: int, priced: tuple[float, float, float, float], flags: int, stable: bool
) -> None:
    """The bound with free choice of turns in each step is never above the true J, and equals it if the turns agree."""
    problem = build_small_grid(seed, priced, flags, stable)
    found = problem.best()
    if found is None:
        return
    total, _, vertex = found
    driven = every_price_with_turns(problem)[tuple(vertex.tolist())]
    assert total <= driven * (1 + EXACT)
    if is_turn_consistent(problem, vertex):
        assert driven == pytest.approx(total, rel=EXACT)


def test_winding_joint_has_to_unwind() -> None:
    """Three steps of 1/3 turn each exceed limits of little more than one turn."""
    x = build_small_grid(0, (1.0, 0.3, 0.0, 0.0), 0, False)
    third = TURN / 3.0
    q = np.zeros((3, 1, 6))
    q[:, 0, 5] = np.array([2.0, 0.1, 1.0]) * third
    one = replace(
        x,
        node=np.ones((3, 1)),
        raw=np.ones((3, 1)),
        q=q,
        more=np.array([[[0] * 6], [[0] * 5 + [1]], [[0] * 6]], np.int8),
        e=np.zeros((3, 1, 2)),
        phi=np.zeros((3, 1)),
        held=np.zeros((3, 1), np.int64),
        branches=1,
    )
    vertex = np.zeros(3, np.int64)
    assert not is_turn_consistent(
        one, vertex
    )  # 1.1 thirds up to the second turn of the middle station, and on from its first turn
    apart = resolve_turns(one, np.zeros((3, 1)), MANY)
    assert apart is not None
    found, loose = apart.lattice.best(), one.best()
    assert found is not None
    assert loose is not None
    assert found[0] > loose[0] + 0.1
    assert resolve_turns(one, np.zeros((3, 1)), 5) is None  # three stations with two turns each exceed the number
    assert resolve_turns(one, np.full((3, 1), np.inf), MANY) is None  # no sequence is as good as the plan
