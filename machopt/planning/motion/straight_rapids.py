"""Which ends of stretches, and which straight rapid moves between them, are free: asked for all of them at once.

A drilling job has hundreds of rapid moves, most of them free as they are. One question about all of them costs little
more than one about a few: poses and bounds are computed together, and distances known at one hold on at the next.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.numerics.array_types import Array
from machopt.planning.cache import compute_cached

Way = tuple[bytes, bytes]


@dataclass(frozen=True)
class EndContacts:
    """What touches at the ends of stretches."""

    asked: frozenset[int]  # rows that were looked at
    rapid: frozenset[int]  # rows where something touches, were the tool to move off in rapid
    cut: frozenset[int]  # those of them where something touches that may not in a cut either

    @classmethod
    def of(cls, model: CollisionModel, q: Array, rows: Iterable[int]) -> EndContacts:
        """Of some rows of q (P, 6 + E) rad or m."""
        asked = np.unique(np.fromiter(rows, np.int64))
        hit = asked[model.check_configurations(q[asked], np.zeros(len(asked), bool)).hit]
        worse = hit[model.check_configurations(q[hit], np.ones(len(hit), bool)).hit] if len(hit) else hit
        return cls(frozenset(asked.tolist()), frozenset(hit.tolist()), frozenset(worse.tolist()))


def build_rapid_key(a: Array, b: Array) -> Way:
    """What a straight rapid move is known by: the joints (6 + E,) at its ends, to the last bit."""
    return np.asarray(a, float).tobytes(), np.asarray(b, float).tobytes()


def find_free_rapids(model: CollisionModel, ends: Sequence[tuple[Array, Array]], step: float) -> frozenset[Way]:
    """Of straight rapid moves, each from joints (6 + E,) to joints (6 + E,), those that are free, ends included.

    Args:
        ends: in the order in which they are driven, so that one begins near where the last one ended.
        step: rad, as for :meth:`CollisionModel.check_motion`.
    """
    known = get_known_rapids(model, step)
    every = {build_rapid_key(a, b): (a, b) for a, b in ends}
    if new := [pair for way, pair in every.items() if way not in known]:
        known |= _asked(model, new, step)
    return frozenset(way for way in every if known[way])


def get_known_rapids(model: CollisionModel, step: float) -> dict[Way, bool]:
    """Whether straight moves are free, of those that were asked for; a store of earlier plans adds to it in place."""
    return compute_cached("ways", lambda: (model, step), dict)


def _asked(model: CollisionModel, ends: Sequence[tuple[Array, Array]], step: float) -> dict[Way, bool]:
    rows = np.array([row for pair in ends for row in pair], float)
    starts = np.arange(len(rows)) % 2 == 0
    begun = model.check_configurations(rows[starts], np.zeros(len(ends), bool)).hit
    # What the model says of a start is of the way to it, which nobody drives straight: the cutter may be in the part.
    driven = model.check_motion(rows, starts, step).hit[~starts]
    return {build_rapid_key(a, b): not blocked for (a, b), blocked in zip(ends, (begun | driven).tolist(), strict=True)}
