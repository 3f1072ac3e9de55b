"""Ways between neighbouring stations that must not be taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Bools

Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Edges:
    """Ways from a station to the next that were looked at and do not work (a contact, or no pose in between)."""

    station: Ints  # (E,) the station they lead into, not falling
    source: Ints  # (E,) vertex at the station before, (rotation · B + branch) · T + turn
    target: Ints  # (E,) vertex at the station

    @classmethod
    def none(cls) -> Edges:
        return cls(*(np.zeros(0, np.int32) for _ in range(3)))

    def plus(self, station: Ints, source: Ints, target: Ints) -> Edges:
        """These and more, each once."""
        rows = np.column_stack(
            [np.r_[self.station, station], np.r_[self.source, source], np.r_[self.target, target]]
        ).astype(np.int32)
        return Edges(*np.ascontiguousarray(np.unique(rows, axis=0).T))

    def __len__(self) -> int:
        return len(self.station)

    def taken(self, rows: slice, vertex: NDArray[np.int_]) -> bool:
        """One of them is in a sequence over the stations ``rows``.

        Args:
            vertex: (S,) as ``target``, −1 where a station is passed over.
        """
        kept = np.flatnonzero(vertex >= 0)
        before = np.full(len(vertex), -1)
        before[kept[1:]] = vertex[kept[:-1]]
        s = self.station - rows.start
        mine = (s >= 0) & (s < len(vertex))
        s = s[mine]
        return bool(((vertex[s] == self.target[mine]) & (before[s] == self.source[mine])).any())

    def in_every_turn(self, feasible: Bools) -> Edges:
        """Those of which no turn is left, with vertices counted without turns.

        Args:
            feasible: (S, R, B, T) of the whole path.
        """
        if not len(self):
            return self
        _, _, B, T = feasible.shape
        ways = np.column_stack([self.station, self.source // T, self.target // T])
        way, which = np.unique(ways, axis=0, return_inverse=True)
        s, u = np.maximum(self.station - 1, 0), self.source // T
        left = feasible[s, u // B, u % B, self.source % T]  # a turn that is gone by itself needs no ban
        count = np.bincount(which.ravel(), weights=left, minlength=len(way))
        s, u = np.maximum(way[:, 0] - 1, 0), way[:, 1]
        turns = feasible[s, u // B, u % B].sum(axis=1) * T
        return Edges(*np.ascontiguousarray(way[count >= np.maximum(turns, 1)].T.astype(np.int32)))
