"""Position requests of the user for single external joints, resolved to planning points.

A pin allows one value, a zone the values to either side of it. Operations that share a run share the joint position,
so a joint that may not move along the path needs a position allowed by all requests about its group. A moving joint
gets the permitted range of each request near its points and its full range elsewhere
(:func:`compute_axis_range_along_path`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import SteeringRule
from machopt.data_types.steering_rules import (
    find_external_joint,
    format_external_value,
    format_steering_rule,
    select_steered_rows,
)
from machopt.errors import CellError, suggest_nearest_word
from machopt.numerics.array_types import Array
from machopt.planning.stations.planning_path import PlanningPath

Interval = tuple[float, float]  # m or rad, both ends are allowed
MET = 1e-9  # m or rad, round-off of the file's numbers


@dataclass(frozen=True)
class AxisPositionWish:
    """One position request for one external joint."""

    joint: int
    rows: tuple[int, int]  # first and last planning point concerned
    at: float | None  # m or rad
    away: Interval | None
    description: str

    def allowed(self, within: Sequence[Interval]) -> tuple[Interval, ...]:
        """Return the parts of some intervals that the request allows.

        Args:
            within: intervals in m or rad.
        """
        if self.at is not None:
            return ((self.at, self.at),) if any(a - MET <= self.at <= b + MET for a, b in within) else ()
        if self.away is None:
            return tuple(within)
        low, high = self.away
        parts = [(a, min(b, low)) for a, b in within] + [(max(a, high), b) for a, b in within]
        return tuple(sorted((a, b) for a, b in parts if a <= b))


@dataclass(frozen=True)
class AxisBound:
    """Range of one moving joint at some of a group's planning points."""

    joint: int
    rows: tuple[int, int]  # first and last, among those of the group
    low: float  # m or rad
    high: float


def build_axis_position_wishes(
    cell: Cell, path: PlanningPath, wishes: Sequence[SteeringRule]
) -> tuple[AxisPositionWish, ...]:
    """Return the requests about external joints from the steering rules.

    Args:
        cell: cell with the external joints.
        path: planning points.
        wishes: steering rules with resolved points.

    Raises:
        InputError: a joint the cell does not have, another unit than its own, or a place out of its range.
    """
    out = []
    for wish in wishes:
        if wish.joint:
            k = _find_joint(cell, wish)
            rows = select_steered_rows(wish, path.index)
            if len(rows):
                out.append(
                    AxisPositionWish(k, (int(rows[0]), int(rows[-1])), wish.at, wish.away, format_steering_rule(wish))
                )
    return tuple(out)


def check_known_axes_and_places(cell: Cell, wishes: Sequence[SteeringRule]) -> None:
    """Refuse requests about joints and places that the cell does not have.

    Args:
        cell: cell with the external joints.
        wishes: steering rules.

    Raises:
        InputError: with what would work.
    """
    for wish in wishes:
        if wish.joint:
            _find_joint(cell, wish)


def find_nearest_allowed(intervals: Sequence[Interval], value: float) -> float:
    """Return the allowed value nearest to a given one.

    Args:
        intervals: allowed intervals in m or rad.
        value: m or rad.
    """
    return min((min(max(value, a), b) for a, b in intervals), key=lambda v: abs(v - value))


def compute_allowed_side(wish: AxisPositionWish, value: Array) -> Interval:
    """Return the half-open range that a zone leaves on the side of the joint's values.

    Args:
        wish: request with a zone.
        value: (n,) m or rad, values of the joint.

    Raises:
        AssertionError: the request is a pin.
    """
    if wish.away is None:
        raise AssertionError("a pin has no sides")
    below = float(np.max(value)) <= 0.5 * (wish.away[0] + wish.away[1])
    return (-np.inf, wish.away[0]) if below else (wish.away[1], np.inf)


def intersect_wishes(wishes: Sequence[AxisPositionWish], within: Sequence[Interval]) -> tuple[Interval, ...]:
    """Return the parts of some intervals that all requests allow.

    Args:
        wishes: requests about one joint.
        within: intervals in m or rad.
    """
    remaining = tuple(within)
    for wish in wishes:
        remaining = wish.allowed(remaining)
    return remaining


def check_compatible_wishes(wishes: Sequence[AxisPositionWish], within: Interval) -> None:
    """Refuse requests that leave a joint no position at one planning point.

    Args:
        wishes: requests about one joint.
        within: range of the joint in m or rad.

    Raises:
        InputError: naming them.
    """
    for start in sorted({s.rows[0] for s in wishes}):
        overlapping = [s for s in wishes if s.rows[0] <= start <= s.rows[1]]
        if not intersect_wishes(overlapping, (within,)):
            raise CellError(
                f"{' and '.join(s.description for s in overlapping)} leave the joint no place; one of them would work",
                file="options",
                where="steer",
            )


def compute_axis_range_along_path(
    path: PlanningPath, low: Array, high: Array, bounds: Sequence[AxisBound], near: Sequence[float]
) -> tuple[Array, Array]:
    """Return the lowest and highest values (n, E) at the planning points of a group.

    Away from all bounds the range is ``low`` … ``high``. Towards a bound it narrows with a continuous second
    derivative, so
    that a smooth curve in a share of the range is a smooth curve of the joint. No bound extends into the points of
    another.
    Where two overlap, the range is their intersection.

    Args:
        path: planning points of the group alone.
        low: (E,) m or rad, lower end away from all bounds.
        high: (E,) m or rad, upper end away from all bounds.
        bounds: ranges of single joints at some of the points.
        near: for each of the path's runs, m of path over which the range narrows; infinite: the run keeps one value.
    """
    n = len(path.index)
    least, most = np.tile(low, (n, 1)), np.tile(high, (n, 1))
    for bound in sorted(bounds, key=lambda b: b.rows[0] - b.rows[1]):  # the longest first
        k = bound.joint
        for (first, last), length in zip(path.runs, near, strict=True):
            a, b = max(bound.rows[0], first), min(bound.rows[1], last)
            if a > b:
                continue
            rows = slice(first, last + 1)
            others = [
                path.s[a] - path.s[o.rows[1]] if o.rows[1] < a else path.s[o.rows[0]] - path.s[b]
                for o in bounds
                if o.joint == k and (first <= o.rows[1] < a or b < o.rows[0] <= last)
            ]
            reach = min([length, *(float(v) for v in others)])
            s = path.s[rows]
            away = np.maximum(np.maximum(path.s[a] - s, s - path.s[b]), 0.0)
            free = (
                _compute_smooth_step(away / reach)
                if 0 < reach < np.inf
                else np.zeros(len(s))
                if reach
                else (away > 0) * 1.0
            )
            there = np.arange(first, last + 1)
            free = np.where((there >= a) & (there <= b), 0.0, free)
            low_end, high_end = (np.clip(v, least[rows, k], most[rows, k]) for v in (bound.low, bound.high))
            least[rows, k] = free * least[rows, k] + (1.0 - free) * low_end
            most[rows, k] = free * most[rows, k] + (1.0 - free) * high_end
    return least, most


def _compute_smooth_step(share: Array) -> Array:
    """Return a smooth step: 0 at 0, 1 from 1 on, with zero first and second derivatives at both ends."""
    x = np.clip(share, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def _find_joint(cell: Cell, wish: SteeringRule) -> int:
    names = list(cell.external_joints)
    k = find_external_joint(wish.joint, names)
    if k is None:
        what = suggest_nearest_word(wish.joint, [*names, *(f"e{n + 1}" for n in range(len(names)))])
        raise CellError(
            f"{wish.joint!r} is no external joint of the cell; {what if names else 'it has none'}",
            file="options",
            where="steer",
        )
    unit = "mm" if cell.external_prismatic[k] else "deg"
    if wish.unit != unit:
        raise CellError(
            f"{format_steering_rule(wish)}: {names[k]!r} {'slides' if unit == 'mm' else 'turns'}; a place in "
            f"{unit} would work",
            file="options",
            where="steer",
        )
    low, high = float(cell.limits.lower[6 + k]), float(cell.limits.upper[6 + k])
    out_of_range = wish.at is not None and not low - MET <= wish.at <= high + MET
    all_of_it = wish.away is not None and wish.away[0] < low and wish.away[1] > high
    if out_of_range or all_of_it:
        raise CellError(
            f"{format_steering_rule(wish)}: the range of {names[k]!r} is {format_external_value(low, unit)} to "
            f"{format_external_value(high, unit)}",
            file="options",
            where="steer",
        )
    return k
