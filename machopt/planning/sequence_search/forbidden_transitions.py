"""Forbidden edges between neighbouring stations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Bools

Ints = NDArray[np.int32]


@dataclass(frozen=True)
class ForbiddenTransitions:
    """Edges from a station to the next that were checked and are blocked (a contact, or no pose in between).

    A contact does not depend on whole turns: such edges are stored once in ``closed``, and not turn by turn.
    """

    station: Ints  # (E,) the station they lead into, not decreasing
    source: Ints  # (E,) vertex at the station before, (rotation · B + branch) · T + turn
    target: Ints  # (E,) vertex at the station
    closed: Ints  # (W, 3) edges blocked in every turn: station, not decreasing, source and target without turns

    @classmethod
    def none(cls) -> ForbiddenTransitions:
        """Return an empty set."""
        nothing = np.zeros(0, np.int32)
        return cls(nothing, nothing, nothing, np.zeros((0, 3), np.int32))

    def plus(self, station: Ints, source: Ints, target: Ints) -> ForbiddenTransitions:
        """Return the union with more edges, each once.

        Args:
            station: (n,) station they lead into.
            source: (n,) vertex at the previous station.
            target: (n,) vertex at the station.
        """
        rows = _sort_unique(
            np.column_stack([np.r_[self.station, station], np.r_[self.source, source], np.r_[self.target, target]])
        )
        return replace(self, station=rows[0], source=rows[1], target=rows[2])

    def plus_closed(self, ways: NDArray[np.integer[Any]]) -> ForbiddenTransitions:
        """Return the union with more edges that are blocked in every turn.

        Args:
            ways: (n, 3) station, source and target without turns.
        """
        return replace(self, closed=np.ascontiguousarray(_sort_unique(np.vstack([self.closed, ways])).T))

    def __len__(self) -> int:
        return len(self.station) + len(self.closed)

    def into(self, vertex: NDArray[np.int_], turns: int) -> Bools:
        """Return (S,) stations into which a sequence uses one of the edges.

        Args:
            vertex: (S,) as ``target``.
            turns: number of turns T.
        """
        is_forbidden = np.zeros(len(vertex), bool)
        s = self.station
        is_forbidden[s[(vertex[s - 1] == self.source) & (vertex[s] == self.target)]] = True
        (s, u, v), plain = self.closed.T, vertex // turns
        is_forbidden[s[(plain[s - 1] == u) & (plain[s] == v)]] = True
        return is_forbidden

    def taken(self, rows: slice, vertex: NDArray[np.int_], turns: int) -> bool:
        """Return whether a sequence over the stations ``rows`` uses one of the edges.

        Args:
            rows: stations of the sequence.
            vertex: (S,) as ``target``, −1 where a station is skipped.
            turns: number of turns T.
        """
        with_vertex = np.flatnonzero(vertex >= 0)
        before = np.full(len(vertex), -1)
        before[with_vertex[1:]] = vertex[with_vertex[:-1]]
        for station, source, target, among in (
            (self.station, self.source, self.target, 1),
            (*self.closed.T, turns),
        ):
            s = station - rows.start
            mine = (s >= 0) & (s < len(vertex))
            s = s[mine]
            if ((vertex[s] // among == target[mine]) & (before[s] // among == source[mine])).any():
                return True
        return False

    def in_every_turn(self, feasible: Bools) -> ForbiddenTransitions:
        """Return the edges blocked in all feasible turns, as ``closed`` ones.

        Args:
            feasible: (S, R, B, T) of the whole path.
        """
        if not len(self.station):
            return self
        _, _, B, T = feasible.shape
        ways = np.column_stack([self.station, self.source // T, self.target // T])
        way, which = np.unique(ways, axis=0, return_inverse=True)
        s, u = np.maximum(self.station - 1, 0), self.source // T
        left = feasible[s, u // B, u % B, self.source % T]  # an infeasible turn needs no exclusion
        count = np.bincount(which.ravel(), weights=left, minlength=len(way))
        s, u = np.maximum(way[:, 0] - 1, 0), way[:, 1]
        turns = feasible[s, u // B, u % B].sum(axis=1) * T
        return replace(ForbiddenTransitions.none(), closed=self.closed).plus_closed(way[count >= np.maximum(turns, 1)])


class TransitionCollector:
    """Edges blocked in every turn, collected over many stations and merged once."""

    def __init__(self, edges: ForbiddenTransitions, stations: int) -> None:
        self.edges = edges
        self._begins = np.searchsorted(edges.closed[:, 0], np.arange(stations + 1))
        self._found: dict[int, list[NDArray[np.int64]]] = {}

    def open(self, s: int, source: NDArray[np.integer[Any]], target: NDArray[np.integer[Any]]) -> Bools:
        """Return (n,) which edges into station s are not among them.

        Args:
            s: station.
            source: (n,) vertex at the previous station, without turns.
            target: (n,) vertex at the station, without turns.
        """
        known = self.edges.closed[self._begins[s] : self._begins[s + 1]]
        return np.isin(
            _encode_way(source, target),
            np.concatenate([_encode_way(*known.T[1:]), *self._found.get(s, [])]),
            invert=True,
        )

    def add(self, s: int, source: NDArray[np.integer[Any]], target: NDArray[np.integer[Any]]) -> None:
        """Add blocked edges into station s.

        Args:
            s: station.
            source: (n,) vertex at the previous station, without turns.
            target: (n,) vertex at the station, without turns.
        """
        self._found.setdefault(s, []).append(_encode_way(source, target))

    def merged(self) -> ForbiddenTransitions:
        """Return the original set with all added edges."""
        if not self._found:
            return self.edges
        way = np.concatenate([w for found in self._found.values() for w in found])
        station = np.repeat(list(self._found), [sum(map(len, found)) for found in self._found.values()])
        return self.edges.plus_closed(np.column_stack([station, way >> 32, way & 0xFFFFFFFF]))


def _encode_way(source: NDArray[np.integer[Any]], target: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Return source and target in one number, ordered as the two are."""
    return np.asarray(source, np.int64) << 32 | np.asarray(target, np.int64)


def _sort_unique(rows: NDArray[np.integer[Any]]) -> Ints:
    """(3, n) of rows (n, 3), sorted."""
    station, way = rows[:, 0], _encode_way(rows[:, 1], rows[:, 2])
    order = np.lexsort((way, station))
    station, way = station[order], way[order]
    first = np.ones(len(order), bool)
    first[1:] = (station[1:] != station[:-1]) | (way[1:] != way[:-1])
    return np.ascontiguousarray(rows[order[first]].T, np.int32)
