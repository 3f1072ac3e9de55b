"""Sequences in which whole turns of the arm's joints fit together.

A :class:`~.sequences.Lattice` gives each step the turns that suit it best. That costs no more than what can be driven,
and mostly just as much; over many rapid moves a joint might wind itself up that way without its limits telling. Then
the turns are part of the vertices: each pose stands there as often as the limits leave it, a step costs what it costs
from the one to the other, and what a plunge keeps are values and rotation, whichever turn that is. There are several
times as many vertices, so only those are kept that a sequence as good as one already known may take.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.planning.external_axis_optimization.value_grid_sequences import ValueGridSequences

TURN = 2.0 * np.pi


@dataclass(frozen=True)
class TurnResolvedGrid:
    """A lattice with the turns told apart."""

    lattice: ValueGridSequences
    vertex: NDArray[np.int64]  # (V,) of the lattice that it is made of


def is_turn_consistent(x: ValueGridSequences, vertex: NDArray[np.int64]) -> bool:
    """The turns of all steps of a sequence (S,) can be had in one motion."""
    at = np.arange(len(vertex))
    q, more = x.q[at, vertex], x.more[at, vertex].astype(float)
    steps = np.clip(np.round(-np.diff(q, axis=0) / TURN), -more[:-1], more[1:])
    turns = np.vstack([np.zeros(6), np.cumsum(steps, axis=0)])  # of each, where the first has none
    return bool(((-turns).max(axis=0) <= (more - turns).min(axis=0)).all())


def resolve_turns(x: ValueGridSequences, through: Array, most: int) -> TurnResolvedGrid | None:
    """The vertices that sequences of a finite price ``through`` (S, V) take, at each of their turns.

    None where that would be more than ``most`` at all stations together, or none at all.
    """
    S, R, B = len(x.node), x.phi.shape[1], x.branches
    alive = np.isfinite(through).reshape(S, -1, R, B)
    g, r, b = (np.flatnonzero(alive.any(axis=others)) for others in ((0, 2, 3), (0, 1, 3), (0, 1, 2)))
    vertex = ((g[:, None, None] * R + r[:, None]) * B + b).reshape(-1)
    node = np.where(np.isfinite(through), x.node, np.inf)[:, vertex]
    more = x.more[:, vertex]
    told = np.where(np.isfinite(node)[..., None], more, 0).max(axis=(0, 1), initial=0)
    T = int(np.prod(told.astype(np.int64) + 1))
    count = T * len(vertex)
    if not 0 < S * count <= most:
        return None
    turns = np.array(list(itertools.product(*(range(int(n) + 1) for n in told))), np.int8)
    exists = (turns[:, None] <= more[:, None]).all(axis=-1)  # (S, T, V)
    found = replace(
        x,
        node=np.where(exists, node[:, None], np.inf).reshape(S, count),
        raw=np.tile(x.raw[:, vertex], (1, T)),
        q=(x.q[:, None, vertex] + TURN * turns[:, None]).reshape(S, count, 6),
        more=np.zeros((S, count, 6), np.int8),
        e=np.tile(x.e[:, g], (1, T, 1)),
        phi=np.ascontiguousarray(x.phi[:, r]),
        held=np.tile(x.held[:, g], (1, T)),
        branches=len(b),
        turns=T,
    )
    return TurnResolvedGrid(found, np.tile(vertex, T))
