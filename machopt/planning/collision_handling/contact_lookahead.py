"""Collision checks of the grid neighbours of a known contact, from vertex to vertex as long as the same bodies touch.

Contacts come in groups: the next station, the next rotation and the same pose in another branch usually touch with the
same two bodies. Checking one pair is much faster than proving that no pair touches. A vertex is excluded
only for a contact of its own pose. The look-ahead therefore changes the number of checks, never the result.
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
from machopt.planning.sampling.candidate_grid import CandidateGrid

Rows = NDArray[np.intp]
BRANCHES = 8  # every n-th vertex also checks the other branches of its pose; contacts found there spread further


@dataclass(kw_only=True)
class ContactLookahead:
    """Known contacts on one grid; ``candidates`` loses the colliding vertices, in place."""

    candidates: CandidateGrid
    model: CollisionModel
    may_touch: Bools  # (S,) the cutter may be in the workpiece there
    external: Array  # (S, E) m or rad, external joints
    pairs: NDArray[np.int32]  # (S, R, B) pair for which a vertex was excluded, else −1; filled here
    checked_by_pair: dict[int, Bools] = field(default_factory=dict)  # pair → (S·R·B,) vertices checked for it

    def whole(self, s: Rows, r: NDArray[Any], b: NDArray[Any]) -> Array:
        """Return the (n, 6 + E) machine joints at vertices (n,), in rad or m.

        Args:
            s: (n,) station index.
            r: (n,) rotation index.
            b: (n,) branch index.
        """
        return np.hstack([self.candidates.q[s, r, b], self.external[s]])

    def strike(self, vertices: Rows, pair: NDArray[np.int32]) -> None:
        """Exclude vertices, each for a contact of one pair of bodies.

        Args:
            vertices: (n,) flat index over (S, R, B).
            pair: (n,) index into the model's pairs.
        """
        s, r, b = np.unravel_index(vertices, self.pairs.shape)
        self.candidates.feasible[s, r, b] = False
        self.candidates.reason[s, r, b] = InfeasibilityReason.COLLIDING
        self.pairs[s, r, b] = pair

    def look(self, vertices: Rows, pair: NDArray[np.int32], budget: int) -> int:
        """Check the neighbours of contacts, ring by ring, and exclude those where the same pair touches.

        Args:
            vertices: (n,) flat index over (S, R, B) of the known contacts.
            pair: (n,) index of the pair that touches there.
            budget: number of vertices after which no further ring is started; shared among the pairs in proportion to
                their contacts.

        Returns:
            Number of vertices checked.
        """
        if not len(vertices):
            return 0
        share = np.bincount(pair, minlength=len(self.model.pairs)) / len(pair)
        remaining = np.ceil(budget * share).astype(int)  # (P,) the budget of a pair is proportional to its contacts
        checked = 0
        while len(vertices):
            vertices, pair = self._find_ring(vertices, pair)
            if len(vertices):
                s, r, b = np.unravel_index(vertices, self.pairs.shape)
                hit = self.model.check_single_pairs(self.whole(s, r, b), pair)
                checked += len(vertices)
                remaining -= np.bincount(pair, minlength=len(remaining))
                vertices, pair = vertices[hit], pair[hit]
                if len(pair) and pair[0] != pair[-1]:  # a vertex found for two pairs keeps the first one
                    vertices, first = np.unique(vertices, return_index=True)
                    pair = pair[first]
                self.strike(vertices, pair)
                continued = remaining[pair] > 0
                vertices, pair = vertices[continued], pair[continued]
        return checked

    def _find_ring(self, vertices: Rows, pair: NDArray[np.int32]) -> tuple[Rows, NDArray[np.int32]]:
        """Return the neighbours not yet checked for the same pair, and the pair of each.

        They are sorted by pair and along the path: successive stations often touch with the same two triangles.
        """
        S, R, B = self.pairs.shape
        feasible = self.candidates.feasible.reshape(S * R * B, -1)
        none = np.zeros(S, bool)
        out, which = [], []
        for p in np.unique(pair).tolist():
            checked = self.checked_by_pair.setdefault(p, np.zeros(S * R * B, bool))
            skipped = self.may_touch if self.model.pairs[p].unless_cutting else none
            along = np.sort(_find_neighbours(vertices[pair == p], checked, feasible, skipped, R, B))
            out.append(along % S * (R * B) + along // S % R * B + along // (S * R))
            which.append(np.full(len(along), p, np.int32))
        return np.concatenate(out), np.concatenate(which)


@jit_compile
def _find_neighbours(vertices: Rows, checked: Bools, feasible: Bools, skipped: Bools, R: int, B: int) -> Rows:
    """Return the unchecked neighbours of vertices (n,), flat over (S, R, B), and mark them in ``checked``.

    Args:
        vertices: (n,) flat index over (S, R, B).
        checked: (S·R·B,) vertices already checked; changed.
        feasible: (S·R·B, T) feasible turns of each vertex.
        skipped: (S,) stations where nothing is checked.
        R: number of rotations.
        B: number of branches.

    Returns:
        (m,) each as (b · R + r) · S + s.
    """
    S = len(skipped)
    for v in vertices:
        checked[v] = True
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
            if checked[n]:
                continue
            for t in range(feasible.shape[1]):
                if feasible[n, t]:
                    checked[n] = True
                    if not skipped[x]:
                        out[m] = (z * R + y) * S + x
                        m += 1
                    break
    return out[:m]
