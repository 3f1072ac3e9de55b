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

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.sampling.configurations import CandidateGrid

Rows = NDArray[np.intp]
BRANCHES = (
    8  # of the vertices, every so many asks the other branches of its pose: what is found there goes on by itself
)


@dataclass(kw_only=True)
class ContactLookahead:
    """The contacts known on one grid; ``candidates`` lose what collides, in place."""

    candidates: CandidateGrid
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
        self.candidates.reason[s, r, b] = InfeasibilityReason.COLLIDING
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
                hit = self.model.check_single_pairs(self.whole(s, r, b), pair)
                looked += len(vertices)
                left -= np.bincount(pair, minlength=len(left))
                vertices, pair = vertices[hit], pair[hit]
                if len(pair) and pair[0] != pair[-1]:  # of a vertex found for two pairs at once the first one is told
                    vertices, first = np.unique(vertices, return_index=True)
                    pair = pair[first]
                self.strike(vertices, pair)
                on = left[pair] > 0
                vertices, pair = vertices[on], pair[on]
        return looked

    def _ring(self, vertices: Rows, pair: NDArray[np.int32]) -> tuple[Rows, NDArray[np.int32]]:
        """The neighbours not yet looked at for the same pair, and the pair of each.

        Pair by pair, and along the path: there the same two triangles often touch on.
        """
        S, R, B = self.pairs.shape
        feasible = self.candidates.feasible.reshape(S * R * B, -1)
        none = np.zeros(S, bool)
        out, which = [], []
        for p in np.unique(pair).tolist():
            asked = self.asked.setdefault(p, np.zeros(S * R * B, bool))
            spared = self.may_touch if self.model.pairs[p].unless_cutting else none
            along = np.sort(_neighbours(vertices[pair == p], asked, feasible, spared, R, B))
            out.append(along % S * (R * B) + along // S % R * B + along // (S * R))
            which.append(np.full(len(along), p, np.int32))
        return np.concatenate(out), np.concatenate(which)


@jit_compile
def _neighbours(vertices: Rows, asked: Bools, feasible: Bools, spared: Bools, R: int, B: int) -> Rows:
    """The neighbours of vertices (n,), flat over (S, R, B), that nobody asked for yet, which is noted in ``asked``.

    Args:
        asked: (S·R·B,) changed.
        feasible: (S·R·B, T).
        spared: (S,) where nothing is looked at.

    Returns:
        (m,) each as (b · R + r) · S + s.
    """
    S = len(spared)
    for v in vertices:
        asked[v] = True
    out = np.empty(len(vertices) * (3 + B), np.int64)
    m = 0
    for v in vertices:
        s, r, b = v // (R * B), v // B % R, v % B
        for k in range(4 + (B - 1 if (s + r) % BRANCHES == 0 else 0)):
            x, y, z = s, r, b
            if k == 0:
                x = max(s - 1, 0)
            elif k == 1:
                x = min(s + 1, S - 1)
            elif k == 2:
                y = (r - 1) % R
            elif k == 3:
                y = (r + 1) % R
            else:
                z = (b + k - 3) % B
            n = (x * R + y) * B + z
            if asked[n]:
                continue
            for t in range(feasible.shape[1]):
                if feasible[n, t]:
                    asked[n] = True
                    if not spared[x]:
                        out[m] = (z * R + y) * S + x
                        m += 1
                    break
    return out[:m]
