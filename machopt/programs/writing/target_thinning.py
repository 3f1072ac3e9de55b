"""Removal of targets that lie too close together, where the line without them keeps to the tolerance.

A controller plans its speed from target to target and needs some milliseconds per move. CAM systems with small
tolerances write moves of a few hundredths of a millimetre. The controller then brakes at every point, and the blend
zones become too short. Of targets nearer than :data:`APART` only those remain that the path shape needs.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.programs.writing.target_insertion import APART, ProgramTolerance, compare_with_line

SHARE = 0.75  # of the tolerance: targets are printed, and corners rounded, on top
PATH = ProgramTolerance(
    position=2e-5, axis=float(np.radians(0.05))
)  # the CAM file's own points, whatever the program may do
INTERPOLATION = 0.012  # s, a usual interpolation cycle: a shorter move cannot be separated from its neighbours


def find_needed_targets(
    targets: Array,
    external: Array,
    feed: Array,
    fixed: NDArray[np.bool_],
    tolerance: ProgramTolerance,
) -> NDArray[np.intp]:
    """Find the targets that a program needs.

    Args:
        targets: (M, 4, 4) poses at the ends of the moves, m.
        external: (M, E) rad or m, external joints there.
        feed: (M,) m/s of the move that ends there, NaN on joint moves.
        fixed: (M,) True: the target stays; so do the first and the last, and both ends of joint moves.
        tolerance: of the program; that of the CAM points, :data:`PATH`, holds where it is narrower.

    Returns:
        (K,) indices, rising.
    """
    count = len(targets)
    if count < 3:
        return np.arange(count)
    linear = np.isfinite(feed)
    stays = fixed | ~linear
    stays[0] = stays[-1] = True
    stays[:-1] |= ~linear[1:]
    length = np.linalg.norm(np.diff(targets[:, :3, 3], axis=0), axis=1)
    if not (length[linear[1:]] < APART).any():
        return np.arange(count)
    within = ProgramTolerance(*(SHARE * min(getattr(tolerance, n), getattr(PATH, n)) for n in _FIELDS))
    needed, ends = [0], np.flatnonzero(stays)
    for a, b in itertools.pairwise(ends.tolist()):
        inner = _thin_stretch(targets, external, feed, length, a, b, within) if b - a > 1 else []
        needed += [*inner, b]
    return np.array(needed, np.intp)


_FIELDS = ("position", "axis", "turn", "external")


def _thin_stretch(
    targets: Array, external: Array, feed: Array, length: Array, first: int, last: int, within: ProgramTolerance
) -> list[int]:
    """The targets to keep between two that stay."""
    needed = [first]
    while needed[-1] < last:
        start = needed[-1]
        end = start + 1
        wanted = max(APART, float(feed[end]) * INTERPOLATION)
        while end < last and length[end - 1 : end + 1].min() < APART:
            way = float(np.linalg.norm(targets[end, :3, 3] - targets[start, :3, 3]))
            if way >= wanted or not _is_within_tolerance(targets, external, start, end + 1, within):
                break
            end += 1
        needed.append(end)
    # a short move may be left over ahead of the last target
    while len(needed) > 2 and np.linalg.norm(targets[last, :3, 3] - targets[needed[-2], :3, 3]) < APART:
        if not _is_within_tolerance(targets, external, needed[-3], last, within):
            break
        del needed[-2]
    return needed[1:-1]


def _is_within_tolerance(targets: Array, external: Array, start: int, end: int, within: ProgramTolerance) -> bool:
    """Whether all targets between two lie on the line between these."""
    rows = np.arange(start + 1, end)
    ends = np.full(len(rows), start), np.full(len(rows), end)
    off = compare_with_line(targets[rows], targets[ends[0]], targets[ends[1]])
    even = external[start] + off[:, 3:] * (external[end] - external[start])
    aside = np.abs(external[rows] - even).max(initial=0.0)
    return bool(
        (off[:, 0] <= within.position).all()
        and (off[:, 1] <= within.axis).all()
        and (off[:, 2] <= within.turn).all()
        and aside <= within.external
    )
