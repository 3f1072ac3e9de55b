"""Coordinates that a program does not give: at its start, or after moves in the machine frame."""

from __future__ import annotations

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.path_building.point_collector import PathBuilder


def fill_unknown(p: Array, out: PathBuilder) -> Array:
    """Replace NaN coordinates by the next known value of the same coordinate.

    For Z between two known values the higher one is taken, because the machine was above both. A coordinate
    that is never given is zero. Rapids at the end are removed where a coordinate was lost and is not given again.
    Each kind of replacement is reported once.

    Args:
        p: Positions (N, 3), mm; NaN where not known.
        out: Path builder that takes the warnings and removes points.

    Returns:
        Positions (N, 3), mm.
    """
    p = p.copy()
    p = p[: _count_known_points(p, out)]
    for k, letter in enumerate("XYZ"):
        column = p[:, k]
        unknown = np.isnan(column)
        if not unknown.any():
            continue
        known = np.flatnonzero(~unknown)
        if not len(known):
            column[:] = 0.0
            out.warn(f"{letter} is never programmed; it is taken as 0")
            continue
        rows = np.flatnonzero(unknown)
        after = np.searchsorted(known, rows)
        has_next, has_last = after < len(known), after > 0
        following = column[known[np.minimum(after, len(known) - 1)]]  # a tail of cuts takes the last one
        last = column[known[np.maximum(after - 1, 0)]]
        value = np.where(has_next, following, last)
        if letter == "Z":
            value = np.where(has_next & has_last, np.maximum(following, last), value)
        column[rows] = value
        out.warn(f"{letter} of {len(rows)} points is given only later in the file; they take that value")
    return p


def _count_known_points(p: Array, out: PathBuilder) -> int:
    """How many points there are before the last rapids of which a coordinate was lost for good."""
    n = len(p)
    for k, letter in enumerate("XYZ"):
        known = np.flatnonzero(~np.isnan(p[:, k]))
        end = int(known[-1]) + 1 if len(known) else len(p)
        if end < n and (out.moves()[end:] == MoveKind.RAPID).all():
            n = end
            why = letter
    if n < len(p):
        out.warn(f"the last {len(p) - n} rapids are left out: {why} is not known after a move in the machine's frame")
        out.keep_first(n)
    return n
