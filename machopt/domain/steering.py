"""What the user decided about single places of a plan: pins, zones, preferences, branches, by operation or by points.

:func:`steered` turns operations into toolpath points, so that planner and verifier agree on which points are meant
without sharing more than this.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import degrees, pi

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Bools
from machopt.domain.options import FixedRotation, PlanOptions, Steer
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError, nearest

MOST_KEPT = 3000  # points of zones whose rotation is chosen at each of them; of longer zones at the stations inside
EDGE = 1e-9  # rad, round-off of the degrees: a zone's own ends are allowed
SAME = 1e-9  # of an index along the toolpath


def steered(options: PlanOptions, toolpath: Toolpath) -> PlanOptions:
    """The options with every wish laid down at points.

    Pins of operations and of several points become fixed rotations of each point, where it cuts if an operation is
    meant: what leads to and from it stays free. A point's own fixed rotation goes before that of its operation. All
    other wishes then name the first and the last of the points they are about; so does a pin of neighbouring points,
    for what lies between them.

    Raises:
        InputError: places that the toolpath has not, or two rotations of one point, and what would work.
    """
    if not options.steer:
        return options
    own = {f.point: f.gamma for f in options.fixed}
    pins: dict[int, tuple[float, str]] = {}
    laid: list[Steer] = []
    for n, wish in enumerate(options.steer):
        _possible(wish, n, toolpath)
        for first, last in stretches(wish, toolpath):
            if wish.gamma is not None:
                for point in range(first, last + 1):
                    _agree(pins, point, wish.gamma, said(wish))
                    pins[point] = wish.gamma, said(wish)
                laid += [Steer(points=part, gamma=wish.gamma) for part in _unbroken(own, first, last, wish.gamma)]
            if wish.joint:
                laid.append(replace(wish, operation="", points=(first, last)))
            elif wish.forbid is not None or wish.prefer is not None or wish.branch is not None:
                laid.append(replace(wish, operation="", points=(first, last), gamma=None))
    fixed = [*options.fixed, *(FixedRotation(p, gamma) for p, (gamma, _) in sorted(pins.items()) if p not in own)]
    return replace(options, fixed=tuple(fixed), steer=tuple(laid))


def refuse_narrow(options: PlanOptions) -> None:
    """Refuse zones that lie between two rotations of the grid, and pins beyond the range of rotations.

    Raises:
        InputError: with what would work.
    """
    low, high = options.rotation_range
    pins = [(f"fixed at point {f.point}", f.gamma, "fixed") for f in options.fixed]
    pins += [(said(w), w.gamma, f"steer[{n}].gamma_deg") for n, w in enumerate(options.steer) if w.gamma is not None]
    for text, gamma, where in pins:
        if not any(low - EDGE <= gamma + turn <= high + EDGE for turn in (-2 * pi, 0.0, 2 * pi)):
            raise InputError(
                f"{_deg(gamma)} ({text}) is beyond rotation_range_deg [{_deg(low)}, {_deg(high)}]; one within it "
                "or a wider range would work",
                file="options",
                where=where,
            )
    for n, wish in enumerate(options.steer):
        if wish.forbid is not None and (wish.forbid[1] - wish.forbid[0]) % (2 * pi) < options.rotation_step - EDGE:
            raise InputError(
                f"the zone from {_deg(wish.forbid[0])} to {_deg(wish.forbid[1])} is narrower than rotation_step_deg "
                f"({degrees(options.rotation_step):g}), so a plan could step over it; a wider zone or a finer step "
                "would work",
                file="options",
                where=f"steer[{n}].forbid_deg",
            )


def kept(options: PlanOptions) -> tuple[int, ...]:
    """Points at which the rotation must be chosen, of options that are laid down: pinned, or in a zone."""
    zones = [w.points for w in options.steer if w.points is not None and (w.forbid is not None or w.branch is not None)]
    inside = sorted({p for first, last in zones for p in range(first, last + 1)})
    return (*(f.point for f in options.fixed), *(inside if len(inside) <= MOST_KEPT else ()))


def among(wish: Steer, index: Array | NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows of toolpath indices (n,), fractional ones too, that a wish is about, once it is laid down."""
    first, last = wish.points if wish.points is not None else (-np.inf, np.inf)
    return np.flatnonzero((index >= first - SAME) & (index <= last + SAME))


def inside(gamma: Array, zone: tuple[float, float]) -> Bools:
    """Where rotations (…) rad lie inside a zone from its first to its second angle, which may lead through ±π."""
    width = (zone[1] - zone[0]) % (2 * pi)
    beyond = (gamma - zone[0]) % (2 * pi)
    return np.asarray((beyond > EDGE) & (beyond < width - EDGE))


def said(wish: Steer) -> str:
    """A wish in the user's words and units."""
    what = []
    if wish.gamma is not None:
        what.append(f"the rotation {_deg(wish.gamma)}")
    if wish.forbid is not None:
        what.append(f"no rotation from {_deg(wish.forbid[0])} to {_deg(wish.forbid[1])}")
    if wish.prefer is not None:
        what.append(f"rather {_deg(wish.prefer)}")
    if wish.branch is not None:
        what.append(f"branch {wish.branch}")
    if wish.at is not None:
        what.append(f"{wish.joint} at {in_unit(wish.at, wish.unit)}")
    if wish.away is not None:
        low, high = (in_unit(v, wish.unit) for v in wish.away)
        what.append(f"{wish.joint} not between {low} and {high}")
    return f"{' and '.join(what)} {_where(wish)}"


def numbered(name: str, names: Sequence[str]) -> int | None:
    """Which of a cell's external joints a name means, its own or e1, e2 …; None: none of them."""
    if name in names:
        return list(names).index(name)
    counts = name[:1] == "e" and name[1:].isdigit() and 1 <= int(name[1:]) <= len(names)
    return int(name[1:]) - 1 if counts else None


def in_unit(value: float, unit: str) -> str:
    """A place of an external joint, m or rad, as the user says it."""
    return f"{float(f'{value * 1e3:.9g}'):g} mm" if unit == "mm" else _deg(value)


def _where(wish: Steer) -> str:
    if wish.operation:
        return f"for operation {wish.operation!r}"
    if wish.points is None:
        return "for the whole path"
    first, last = wish.points
    return f"at point {first}" if first == last else f"at points {first} to {last}"


def _possible(wish: Steer, n: int, toolpath: Toolpath) -> None:
    where, count = f"steer[{n}]", len(toolpath)
    if wish.operation:
        labels = [o.label for o in toolpath.operations]
        if wish.operation not in labels:
            raise InputError(
                f"{wish.operation!r} is no operation of the toolpath; {nearest(wish.operation, labels)}",
                file="options",
                where=f"{where}.operation",
            )
        if not any(True for _ in stretches(wish, toolpath)):
            raise InputError(
                f"nothing is cut in {wish.operation!r}; points would name what else is meant",
                file="options",
                where=f"{where}.operation",
            )
    elif wish.points is not None and wish.points[1] >= count:
        raise InputError(
            f"found points {wish.points[0]} to {wish.points[1]}, but {toolpath.source} has points 0 to {count - 1}",
            file="options",
            where=f"{where}.points",
        )


def stretches(wish: Steer, toolpath: Toolpath) -> Iterable[tuple[int, int]]:
    """First and last point of each stretch that a wish is about; of an operation, what it cuts."""
    if not wish.operation:
        yield (0, len(toolpath) - 1) if wish.points is None else wish.points
        return
    mine = [k for k, o in enumerate(toolpath.operations) if o.label == wish.operation]
    cut = np.flatnonzero(np.isin(toolpath.operation, mine) & toolpath.cutting)
    if len(cut):
        for part in np.split(cut, np.flatnonzero(np.diff(cut) > 1) + 1):
            yield int(part[0]), int(part[-1])


def _unbroken(own: dict[int, float], first: int, last: int, gamma: float) -> Iterable[tuple[int, int]]:
    """Neighbouring points, two or more, among which none has a rotation of its own."""
    free = np.array([p for p in range(first, last + 1) if p not in own or abs(own[p] - gamma) <= EDGE], int)
    for part in np.split(free, np.flatnonzero(np.diff(free) > 1) + 1):
        if len(part) > 1:
            yield int(part[0]), int(part[-1])


def _agree(pins: dict[int, tuple[float, str]], point: int, gamma: float, by: str) -> None:
    if point in pins and abs(_turned(pins[point][0] - gamma)) > EDGE:
        raise InputError(
            f"point {point} cannot have both {pins[point][1]} and {by}; one of them, or the point's own under 'fixed', "
            "would work",
            file="options",
            where="steer",
        )


def _turned(angle: float) -> float:
    """The same rotation within -π … π: 180° and -180° are one."""
    return (angle + pi) % (2 * pi) - pi


def _deg(angle: float) -> str:
    return f"{float(f'{degrees(angle):.12g}'):g}°"
