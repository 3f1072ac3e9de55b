"""Whole turns of a sequence that was found without distinguishing them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions

Ints = NDArray[np.int32]
Counts = NDArray[np.int_]
TWO_PI = 2.0 * np.pi


def count_whole_turns(turns: Array) -> Counts:
    """Return turns in rad as integers.

    Args:
        turns: (…,) rad, multiples of 2π.
    """
    return np.asarray(np.round(turns / TWO_PI).astype(int))


def compute_shortest_turns(c: CandidateGrid, rows: slice, vertex: Ints) -> Counts:
    """Return (S, 6) whole turns with which every joint takes the shorter way from station to station.

    Args:
        c: candidate grid.
        rows: stations of the sequence.
        vertex: (S, 3) rotation, branch and turn at the stations ``rows``, −1 where one is skipped.
    """
    with_vertex = np.flatnonzero(vertex[:, 0] >= 0)
    q = c.q[rows][with_vertex, vertex[with_vertex, 0], vertex[with_vertex, 1]]
    out = np.zeros((len(vertex), 6), int)
    if len(with_vertex):
        out[with_vertex[1:]] = -np.cumsum(count_whole_turns(np.diff(q, axis=0)), axis=0)
    return out


def fit_turns(
    c: CandidateGrid,
    rows: slice,
    vertex: Ints,
    requested: Counts,
    mask: Bools,
    edges: ForbiddenTransitions,
    home: Array | None = None,
) -> Ints | None:
    """Return a sequence (S, 3) with given turns, shifted as a whole so that all vertices and edges are allowed.

    Args:
        c: candidate grid.
        rows: stations of the sequence.
        vertex: (S, 3) rotation, branch and turn, −1 where a station is skipped.
        requested: (S, 6) whole turns relative to each other.
        mask: (S, R, B, T) vertices that may be used.
        edges: forbidden edges.
        home: (6,) rad, where the motion begins and ends; None: it is not known.

    Returns:
        Among the allowed ones the sequence whose ends are nearest to home, or whose end is nearest to zero; or None.
    """
    with_vertex = np.flatnonzero(vertex[:, 0] >= 0)
    if not len(with_vertex):
        return vertex
    turns = count_whole_turns(c.turns)
    index = np.full((3,) * 6, -1)
    index[tuple((turns + 1).T)] = np.arange(len(turns))
    (r, b), requested = vertex[with_vertex, :2].T, requested[with_vertex]
    moved = turns - requested[-1]  # shift of the whole sequence, for each turn of its end
    inside = ((requested.min(axis=0) + moved >= -1) & (requested.max(axis=0) + moved <= 1)).all(axis=1)
    end = c.q[rows][with_vertex[-1], r[-1], b[-1]] + c.turns
    away = np.ceil((end - np.pi) / TWO_PI - 1e-12).astype(int)  # (T, 6) turns from (−π, π]
    way = np.zeros(len(turns))
    if home is not None:
        start = c.q[rows][with_vertex[0], r[0], b[0]] + (requested[0] + moved) * TWO_PI
        way = np.abs(np.concatenate([start, end], axis=1) - np.tile(home, 2)).sum(axis=1).round(6)
    for t in sorted(
        np.flatnonzero(inside).tolist(), key=lambda t: (way[t], int(np.abs(away[t]).sum()), *(-away[t] % 3))
    ):
        turn = index[tuple((requested + moved[t] + 1).T)]
        if (turn >= 0).all() and mask[with_vertex, r, b, turn].all():
            out = vertex.copy()
            out[with_vertex, 2] = turn
            flat = np.full(len(vertex), -1)
            flat[with_vertex] = np.ravel_multi_index((r, b, turn), mask.shape[1:])
            if not edges.taken(rows, flat, mask.shape[3]):
                return out
    return None
