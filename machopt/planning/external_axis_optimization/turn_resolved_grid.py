"""Sequences in which whole turns of the arm's joints are consistent.

A :class:`~machopt.planning.external_axis_optimization.value_grid_sequences.ValueGridSequences` uses for each step the
turns that suit it best. That costs no more than a drivable motion, and mostly the same. Over many rapid moves, however,
a joint could exceed its limits unnoticed. Here the turns are part of the vertices: each pose occurs once for every turn
inside the limits, a step has the price between two such turns, and a plunge keeps value and rotation at any turn. There
are several times as many vertices, so only those are kept that may belong to a sequence as good as a known one.
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
    """Value grid with one vertex per whole turn."""

    lattice: ValueGridSequences
    vertex: NDArray[np.int64]  # (V,) vertex of the original grid


def is_turn_consistent(x: ValueGridSequences, vertex: NDArray[np.int64]) -> bool:
    """Return whether the turns of all steps of a sequence are possible in one motion.

    Args:
        x: sequences over values, rotations and branches.
        vertex: (S,) vertices of the sequence.
    """
    at = np.arange(len(vertex))
    q, more = x.q[at, vertex], x.more[at, vertex].astype(float)
    steps = np.clip(np.round(-np.diff(q, axis=0) / TURN), -more[:-1], more[1:])
    turns = np.vstack([np.zeros(6), np.cumsum(steps, axis=0)])  # turns of each station relative to the first
    return bool(((-turns).max(axis=0) <= (more - turns).min(axis=0)).all())


def resolve_turns(x: ValueGridSequences, through: Array, most: int) -> TurnResolvedGrid | None:
    """Return the grid with one vertex per turn; None where it would be larger than ``most``, or empty.

    Args:
        x: sequences over values, rotations and branches.
        through: (S, V) least price of a sequence through each vertex; only finite ones are kept.
        most: maximum number of vertices at all stations together.
    """
    S, R, B = len(x.node), x.phi.shape[1], x.branches
    alive = np.isfinite(through).reshape(S, -1, R, B)
    g, r, b = (np.flatnonzero(alive.any(axis=others)) for others in ((0, 2, 3), (0, 1, 3), (0, 1, 2)))
    vertex = ((g[:, None, None] * R + r[:, None]) * B + b).reshape(-1)
    node = np.where(np.isfinite(through), x.node, np.inf)[:, vertex]
    more = x.more[:, vertex]
    turn_counts = np.where(np.isfinite(node)[..., None], more, 0).max(axis=(0, 1), initial=0)
    T = int(np.prod(turn_counts.astype(np.int64) + 1))
    count = T * len(vertex)
    if not 0 < S * count <= most:
        return None
    turns = np.array(list(itertools.product(*(range(int(n) + 1) for n in turn_counts))), np.int8)
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
