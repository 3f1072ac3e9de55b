"""Contact checks of the ends of stretches and of the straight rapid moves between them, all in one batch.

A drilling job has hundreds of rapid moves, most of them free. One batch costs little more than a few single checks:
poses and bounds are computed together, and distances known at one pose bound those at the next.
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
    """Contacts at the ends of stretches."""

    checked_rows: frozenset[int]  # rows that were checked
    rapid: frozenset[int]  # rows with a contact that is forbidden in a rapid move
    cut: frozenset[int]  # those of them with a contact that is forbidden in a cut as well

    @classmethod
    def build(cls, model: CollisionModel, q: Array, rows: Iterable[int]) -> EndContacts:
        """Return the contacts at some rows.

        Args:
            model: collision model.
            q: (P, 6 + E) rad or m, joints.
            rows: rows to check.
        """
        checked = np.unique(np.fromiter(rows, np.int64))
        hit = checked[model.check_configurations(q[checked], np.zeros(len(checked), bool)).hit]
        worse = hit[model.check_configurations(q[hit], np.ones(len(hit), bool)).hit] if len(hit) else hit
        return cls(frozenset(checked.tolist()), frozenset(hit.tolist()), frozenset(worse.tolist()))


def build_rapid_key(a: Array, b: Array) -> Way:
    """Return the cache key of a straight rapid move: the joints at its ends, to the last bit.

    Args:
        a: (6 + E,) rad or m, start.
        b: (6 + E,) rad or m, end.
    """
    return np.asarray(a, float).tobytes(), np.asarray(b, float).tobytes()


def find_free_rapids(model: CollisionModel, ends: Sequence[tuple[Array, Array]], step: float) -> frozenset[Way]:
    """Return those of some straight rapid moves that are free, ends included.

    Args:
        model: collision model.
        ends: joints (6 + E,) at both ends of each, in driving order, so that one begins near the end of the last one.
        step: rad, as for :meth:`CollisionModel.check_motion`.
    """
    known = get_known_rapids(model, step)
    every = {build_rapid_key(a, b): (a, b) for a, b in ends}
    if new := [pair for way, pair in every.items() if way not in known]:
        known |= _check_ways(model, new, step)
    return frozenset(way for way in every if known[way])


def get_known_rapids(model: CollisionModel, step: float) -> dict[Way, bool]:
    """Return the straight moves checked so far, with whether each is free; the cache shares this dictionary between
    plans.

    Args:
        model: collision model.
        step: rad, joint step between collision checks.
    """
    return compute_cached("ways", lambda: (model, step), dict)


def _check_ways(model: CollisionModel, ends: Sequence[tuple[Array, Array]], step: float) -> dict[Way, bool]:
    rows = np.array([row for pair in ends for row in pair], float)
    starts = np.arange(len(rows)) % 2 == 0
    starts_in_contact = model.check_configurations(rows[starts], np.zeros(len(ends), bool)).hit
    # The contact at a start belongs to the move before it: the cutter may be in the part there.
    driven = model.check_motion(rows, starts, step).hit[~starts]
    return {
        build_rapid_key(a, b): not blocked
        for (a, b), blocked in zip(ends, (starts_in_contact | driven).tolist(), strict=True)
    }
