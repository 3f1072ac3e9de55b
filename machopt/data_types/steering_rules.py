"""Steering of a plan by the user: pins, zones, preferences and branches, by operation or by points.

:func:`resolve_steering` converts operations into toolpath points, so that planner and verifier use the same points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import degrees, pi

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import FixedRotation, PlanOptions, SteeringRule
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CellError, suggest_nearest_word
from machopt.numerics.array_types import Array, Bools

MAX_CONSTRAINED_POINTS = (
    3000  # points of zones whose rotation is chosen at each of them; of longer zones at the stations inside
)
EDGE = 1e-9  # rad, round-off of the degrees: a zone's own ends are allowed
SAME = 1e-9  # of an index along the toolpath


def resolve_steering(options: PlanOptions, toolpath: Toolpath) -> PlanOptions:
    """Return the options with every steering rule converted to points.

    Pins of operations and of several points become fixed rotations of each point. A pin of an operation holds at its
    cutting points only, so the moves to and from it stay free. A point's own fixed rotation overrides that of its
    operation. All other rules then name first and last point of their range; so does a pin of neighbouring points.

    Args:
        options: The planning options in force.
        toolpath: The toolpath, points in the workpiece frame, SI.

    Raises:
        InputError: a rule names places that the toolpath does not have, or a point has two rotations.
    """
    if not options.steer:
        return options
    own = {f.point: f.gamma for f in options.fixed}
    pins: dict[int, tuple[float, str]] = {}
    laid: list[SteeringRule] = []
    for n, wish in enumerate(options.steer):
        _check_steering_rule(wish, n, toolpath)
        for first, last in list_steered_stretches(wish, toolpath):
            if wish.gamma is not None:
                for point in range(first, last + 1):
                    _refuse_conflicting_pins(pins, point, wish.gamma, format_steering_rule(wish))
                    pins[point] = wish.gamma, format_steering_rule(wish)
                laid += [
                    SteeringRule(points=part, gamma=wish.gamma)
                    for part in _list_free_runs(own, first, last, wish.gamma)
                ]
            if wish.joint:
                laid.append(replace(wish, operation="", points=(first, last)))
            elif wish.forbid is not None or wish.prefer is not None or wish.branch is not None:
                laid.append(replace(wish, operation="", points=(first, last), gamma=None))
    fixed = [*options.fixed, *(FixedRotation(p, gamma) for p, (gamma, _) in sorted(pins.items()) if p not in own)]
    return replace(options, fixed=tuple(fixed), steer=tuple(laid))


def refuse_narrow_zones(options: PlanOptions) -> None:
    """Refuse zones that lie between two rotations of the grid, and pins beyond the range of rotations.

    Args:
        options: The planning options in force.

    Raises:
        InputError: a zone is too narrow, or a pin is out of range; the message says what would be accepted.
    """
    low, high = options.rotation_range
    pins = [(f"fixed at point {f.point}", f.gamma, "fixed") for f in options.fixed]
    pins += [
        (format_steering_rule(w), w.gamma, f"steer[{n}].gamma_deg")
        for n, w in enumerate(options.steer)
        if w.gamma is not None
    ]
    for text, gamma, where in pins:
        if not any(low - EDGE <= gamma + turn <= high + EDGE for turn in (-2 * pi, 0.0, 2 * pi)):
            raise CellError(
                f"{_format_deg(gamma)} ({text}) is beyond rotation_range_deg [{_format_deg(low)}, "
                f"{_format_deg(high)}]; one within it "
                "or a wider range would work",
                file="options",
                where=where,
            )
    for n, wish in enumerate(options.steer):
        if wish.forbid is not None and (wish.forbid[1] - wish.forbid[0]) % (2 * pi) < options.rotation_step - EDGE:
            raise CellError(
                f"the zone from {_format_deg(wish.forbid[0])} to {_format_deg(wish.forbid[1])} is narrower than "
                f"rotation_step_deg "
                f"({degrees(options.rotation_step):g}), so a plan could step over it; a wider zone or a finer step "
                "would work",
                file="options",
                where=f"steer[{n}].forbid_deg",
            )


def list_constrained_points(options: PlanOptions) -> tuple[int, ...]:
    """Return the points whose rotation is pinned or restricted by a zone, of resolved options.

    Args:
        options: The planning options in force.
    """
    zones = [w.points for w in options.steer if w.points is not None and (w.forbid is not None or w.branch is not None)]
    inside = sorted({p for first, last in zones for p in range(first, last + 1)})
    return (*(f.point for f in options.fixed), *(inside if len(inside) <= MAX_CONSTRAINED_POINTS else ()))


def select_steered_rows(wish: SteeringRule, index: Array | NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the rows that a resolved rule applies to.

    Args:
        wish: The steering rule.
        index: (n,) toolpath indices of the rows, which may be fractional.
    """
    first, last = wish.points if wish.points is not None else (-np.inf, np.inf)
    return np.flatnonzero((index >= first - SAME) & (index <= last + SAME))


def is_inside_zone(gamma: Array, zone: tuple[float, float]) -> Bools:
    """Return whether rotations lie inside a zone.

    Args:
        gamma: (…) rotations, rad.
        zone: First and last angle of the zone, rad; it may cross ±π.
    """
    width = (zone[1] - zone[0]) % (2 * pi)
    beyond = (gamma - zone[0]) % (2 * pi)
    return np.asarray((beyond > EDGE) & (beyond < width - EDGE))


def format_steering_rule(wish: SteeringRule) -> str:
    """Return a rule in the user's words and units.

    Args:
        wish: The steering rule.
    """
    what = []
    if wish.gamma is not None:
        what.append(f"the rotation {_format_deg(wish.gamma)}")
    if wish.forbid is not None:
        what.append(f"no rotation from {_format_deg(wish.forbid[0])} to {_format_deg(wish.forbid[1])}")
    if wish.prefer is not None:
        what.append(f"rather {_format_deg(wish.prefer)}")
    if wish.branch is not None:
        what.append(f"branch {wish.branch}")
    if wish.at is not None:
        what.append(f"{wish.joint} at {format_external_value(wish.at, wish.unit)}")
    if wish.away is not None:
        low, high = (format_external_value(v, wish.unit) for v in wish.away)
        what.append(f"{wish.joint} not between {low} and {high}")
    return f"{' and '.join(what)} {_format_place(wish)}"


def find_external_joint(name: str, names: Sequence[str]) -> int | None:
    """Return the number of the external joint that a name means, from 0; None if there is none.

    Args:
        name: The joint's own name, or e1, e2 …
        names: Names of the cell's external joints.
    """
    if name in names:
        return list(names).index(name)
    counts = name[:1] == "e" and name[1:].isdigit() and 1 <= int(name[1:]) <= len(names)
    return int(name[1:]) - 1 if counts else None


def format_external_value(value: float, unit: str) -> str:
    """Return a position of an external joint as text.

    Args:
        value: The position, m or rad.
        unit: ``mm``, or any other unit for degrees.
    """
    return f"{float(f'{value * 1e3:.9g}'):g} mm" if unit == "mm" else _format_deg(value)


def _format_place(wish: SteeringRule) -> str:
    if wish.operation:
        return f"for operation {wish.operation!r}"
    if wish.points is None:
        return "for the whole path"
    first, last = wish.points
    return f"at point {first}" if first == last else f"at points {first} to {last}"


def _check_steering_rule(wish: SteeringRule, n: int, toolpath: Toolpath) -> None:
    where, count = f"steer[{n}]", len(toolpath)
    if wish.operation:
        labels = [o.label for o in toolpath.operations]
        if wish.operation not in labels:
            raise CellError(
                f"{wish.operation!r} is no operation of the toolpath; {suggest_nearest_word(wish.operation, labels)}",
                file="options",
                where=f"{where}.operation",
            )
        if not any(True for _ in list_steered_stretches(wish, toolpath)):
            raise CellError(
                f"nothing is cut in {wish.operation!r}; points would name what else is meant",
                file="options",
                where=f"{where}.operation",
            )
    elif wish.points is not None and wish.points[1] >= count:
        raise CellError(
            f"found points {wish.points[0]} to {wish.points[1]}, but {toolpath.source} has points 0 to {count - 1}",
            file="options",
            where=f"{where}.points",
        )


def list_steered_stretches(wish: SteeringRule, toolpath: Toolpath) -> Iterable[tuple[int, int]]:
    """Return first and last point of each stretch that a rule applies to; of an operation, its cutting points.

    Args:
        wish: The steering rule.
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    if not wish.operation:
        yield (0, len(toolpath) - 1) if wish.points is None else wish.points
        return
    mine = [k for k, o in enumerate(toolpath.operations) if o.label == wish.operation]
    cut = np.flatnonzero(np.isin(toolpath.operation, mine) & toolpath.cutting)
    if len(cut):
        for part in np.split(cut, np.flatnonzero(np.diff(cut) > 1) + 1):
            yield int(part[0]), int(part[-1])


def _list_free_runs(own: dict[int, float], first: int, last: int, gamma: float) -> Iterable[tuple[int, int]]:
    """Neighbouring points, two or more, among which none has a rotation of its own."""
    free = np.array([p for p in range(first, last + 1) if p not in own or abs(own[p] - gamma) <= EDGE], int)
    for part in np.split(free, np.flatnonzero(np.diff(free) > 1) + 1):
        if len(part) > 1:
            yield int(part[0]), int(part[-1])


def _refuse_conflicting_pins(pins: dict[int, tuple[float, str]], point: int, gamma: float, by: str) -> None:
    if point in pins and abs(_wrap_half_turn(pins[point][0] - gamma)) > EDGE:
        raise CellError(
            f"point {point} cannot have both {pins[point][1]} and {by}; one of them, or the point's own under 'fixed', "
            "would work",
            file="options",
            where="steer",
        )


def _wrap_half_turn(angle: float) -> float:
    """The same rotation within -π … π: 180° and -180° are one."""
    return (angle + pi) % (2 * pi) - pi


def _format_deg(angle: float) -> str:
    return f"{float(f'{degrees(angle):.12g}'):g}°"
