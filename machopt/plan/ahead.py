"""What lies near a known contact, looked at ahead: from vertex to neighbouring vertex as long as the same bodies touch.

A contact seldom comes alone: the next station, the next rotation and the same pose in another branch mostly touch the
same two bodies, and whether they do is much quicker to tell than that nothing at all touches. A vertex is struck
out for a contact of its own pose only, so looking ahead changes what has to be asked, never the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Bools, any_last
from machopt.domain.reason import Reason
from machopt.model.collision import CollisionModel
from machopt.plan.candidates import Candidates

Rows = NDArray[np.intp]
BRANCHES = (
    8  # of the vertices, every so many asks the other branches of its pose: what is found there goes on by itself
)


@dataclass
class Ahead:
    """The contacts known on one grid; ``candidates`` lose what collides, in place."""

    candidates: Candidates
    model: CollisionModel
    may_touch: Bools  # (S,) the cutter may be in the workpiece there
    external: Array  # (S, E) m or rad, where the external joints stand
    pairs: NDArray[np.int32]  # (S, R, B) pair that a vertex was struck out for, −1 else; filled here
    asked: dict[int, Bools] = field(default_factory=dict)  # pair → (S·R·B,) vertices it was looked at for

    def whole(self, s: Rows, r: NDArray[Any], b: NDArray[Any]) -> Array:
        """(n, 6 + E) joints of the machine at vertices (n,)."""
        return np.hstack([self.candidates.q[s, r, b], self.external[s]])

    def strike(self, vertices: Rows, pair: NDArray[np.int32]) -> None:
        """Strike out vertices (n,), flat over (S, R, B), each for its own contact between a pair (n,) of bodies."""
        s, r, b = np.unravel_index(vertices, self.pairs.shape)
        self.candidates.feasible[s, r, b] = False
        self.candidates.reason[s, r, b] = Reason.COLLIDING
        self.pairs[s, r, b] = pair

    def look(self, vertices: Rows, pair: NDArray[np.int32], budget: int) -> int:
        """Look from contacts at vertices (n,) on, ring by ring, and strike out what touches alike.

        Args:
            pair: (n,) whose contact it is.
            budget: vertices after which no further ring is begun, shared by the pairs as their contacts are.

        Returns:
            how many were looked at.
        """
        if not len(vertices):
            return 0
        share = np.bincount(pair, minlength=len(self.model.pairs)) / len(pair)
        left = np.ceil(budget * share).astype(int)  # (P,) a pair is followed as far as it is in the way
        looked = 0
        while len(vertices):
            vertices, pair = self._ring(vertices, pair)
            if len(vertices):
                s, r, b = np.unravel_index(vertices, self.pairs.shape)
                order = np.lexsort((s, r, b))  # along the path: there the same two triangles often touch on
                vertices, pair = vertices[order], pair[order]
                s, r, b = np.unravel_index(vertices, self.pairs.shape)
                hit = self.model.touching(self.whole(s, r, b), pair)
                looked += len(vertices)
                left -= np.bincount(pair, minlength=len(left))
                vertices, pair = vertices[hit], pair[hit]
                vertices, first = np.unique(vertices, return_index=True)  # for two pairs at once: one is told
                pair = pair[first]
                self.strike(vertices, pair)
                on = left[pair] > 0
                vertices, pair = vertices[on], pair[on]
        return looked

    def _ring(self, vertices: Rows, pair: NDArray[np.int32]) -> tuple[Rows, NDArray[np.int32]]:
        """The neighbours not yet looked at for the same pair, and the pair of each."""
        S, R, B = self.pairs.shape
        feasible = self.candidates.feasible.reshape(S * R * B, -1)
        out, which = [], []
        for p in np.unique(pair).tolist():
            asked = self.asked.setdefault(p, np.zeros(S * R * B, bool))
            mine = vertices[pair == p]
            asked[mine] = True
            s, r, b = np.unravel_index(mine, (S, R, B))
            near = [(np.maximum(s - 1, 0), r, b), (np.minimum(s + 1, S - 1), r, b)]
            near += [(s, (r - 1) % R, b), (s, (r + 1) % R, b)]
            few = (s + r) % BRANCHES == 0
            near += [(s[few], r[few], (b[few] + k) % B) for k in range(1, B)]
            found = np.unique(np.concatenate([np.ravel_multi_index(v, (S, R, B)) for v in near]))
            found = found[~asked[found] & any_last(feasible[found])]
            asked[found] = True
            if self.model.pairs[p].unless_cutting:
                found = found[~self.may_touch[found // (R * B)]]
            out.append(found)
            which.append(np.full(len(found), p, np.int32))
        return np.concatenate(out), np.concatenate(which)
