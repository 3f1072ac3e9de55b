"""Pairs of bodies that are checked against each other or excluded, and the contacts found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bodies import BodyKind
from machopt.numerics.array_types import Array, Bools


@dataclass(frozen=True)
class CollisionPair:
    """Two bodies that are checked against each other."""

    a: str
    b: str
    kinds: tuple[BodyKind, BodyKind]
    clearance: float  # m, required
    unless_cutting: bool  # the cutter and the workpiece: only in moves that do not cut

    @property
    def name(self) -> str:
        """Name of the pair, "a ~ b"."""
        return f"{self.a} ~ {self.b}"


@dataclass(frozen=True)
class ExcludedCollisionPair:
    """Two bodies that are not checked, with the reason."""

    a: str
    b: str
    reason: str
    share: float  # of random poses in touch; NaN where not sampled


@dataclass(frozen=True)
class CollisionContacts:
    """Rows with a collision or a distance below the clearance."""

    hit: Bools  # (S,)
    pair: NDArray[np.int32]  # (S,) index into CollisionModel.pairs of the first pair found, −1 where free
    row: Array  # (S,) fractional row of the contact (on the motion from the previous row), NaN where free

    @property
    def any(self) -> bool:
        """Whether any row is hit."""
        return bool(self.hit.any())

    @property
    def first(self) -> int:
        """First row hit, −1 if none."""
        return int(np.argmax(self.hit)) if self.any else -1


def build_no_contacts(count: int) -> CollisionContacts:
    """Return contacts without a hit.

    Args:
        count: Number of rows.
    """
    return CollisionContacts(np.zeros(count, bool), np.full(count, -1, np.int32), np.full(count, np.nan))


def suggest_remedy(pair: CollisionPair) -> str:
    """Return what would allow two bodies of the robot itself to touch; empty for other pairs.

    Args:
        pair: pair in contact.
    """
    if not set(pair.kinds) <= {"link", "tool"}:
        return ""
    return f" (if they are built so, `ignore_pairs: [[{pair.a}, {pair.b}]]` in cell.yaml would let them)"
