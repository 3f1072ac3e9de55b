"""Groups of operations that share the positions of the external joints, and the user's requests about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, SteeringRule
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CellError, suggest_nearest_word
from machopt.numerics.array_types import Array, Bools
from machopt.planning.external_axes.axis_modes import compute_axis_range
from machopt.planning.external_axes.position_constraints import (
    AxisPositionWish,
    Interval,
    build_axis_position_wishes,
    check_compatible_wishes,
    find_nearest_allowed,
    intersect_wishes,
)
from machopt.planning.stations.path_subset import list_run_points
from machopt.planning.stations.planning_path import PlanningPath

MOVING = "moving"
MOST = 3  # maximum number of external joints whose positions are chosen together


@dataclass(frozen=True, kw_only=True)
class OperationGroup:
    """Operations that share their external joint values."""

    runs: tuple[int, ...]
    operations: tuple[int, ...]
    moving: Bools  # (E,) the joint may move along the path
    low: Array  # (E,) m or rad, range of a fixed position; equal to ``high`` where that is given
    high: Array  # (E,)
    share: float  # of the length cut
    least: Array  # (E,) m or rad, range of a moving joint
    most: Array  # (E,)
    allowed: tuple[tuple[Interval, ...], ...]  # (E,) parts of ``low`` … ``high`` outside the zones
    must: Bools  # (E,) no single position satisfies the requests: the joint has to move
    position_wishes: tuple[AxisPositionWish, ...] = ()  # position requests of the user

    @property
    def moves(self) -> Bools:
        """(E,) the joint can move along the path."""
        return self.moving & (self.most > self.least)

    def around(self, value: Array) -> OperationGroup:
        """Return the group with ``low`` and ``high`` restricted to the interval around given values.

        A moving joint gets its full range, a fixed one the interval between two zones that contains the value.

        Args:
            value: (E,) m or rad.
        """
        own = [
            min(parts, key=lambda ab: max(ab[0] - v, v - ab[1])) for parts, v in zip(self.allowed, value, strict=True)
        ]
        low, high = np.array(own).T
        return replace(self, low=np.where(self.moving, self.least, low), high=np.where(self.moving, self.most, high))

    def snapped(self, value: Array) -> Array:
        """Return the (E,) allowed values nearest to given ones.

        Args:
            value: (E,) m or rad.
        """
        return np.array([find_nearest_allowed(own, float(v)) for own, v in zip(self.allowed, value, strict=True)])


def build_operation_groups(
    cell: Cell,
    toolpath: Toolpath,
    path: PlanningPath,
    axes: Sequence[ExternalJointOptions],
    wishes: Sequence[SteeringRule] = (),
) -> list[OperationGroup]:
    """Return the groups of operations that share a run, in the order of the path.

    Args:
        cell: cell with the external joints.
        toolpath: toolpath with the operations.
        path: planning points.
        axes: options of each external joint.
        wishes: steering rules with resolved points; those about external joints count.

    Raises:
        InputError: operations that share a run request two modes or places, or no place satisfies all wishes.
    """
    position_wishes = build_axis_position_wishes(cell, path, wishes)
    labels = [o.label for o in toolpath.operations]
    _refuse_unknown_operations(axes, labels)
    out = []
    for operations, runs in _list_operations_by_run(toolpath, path):
        mine = tuple(
            s
            for s in position_wishes
            if any(s.rows[0] <= path.runs[r][1] and path.runs[r][0] <= s.rows[1] for r in runs)
        )
        own = [labels[o] for o in operations]
        ranges = [_find_axis_range(cell, k, axis, own, mine) for k, axis in enumerate(axes)]
        group = OperationGroup(
            runs=runs,
            operations=operations,
            moving=np.array([r.moving for r in ranges], bool),
            low=np.array([r.allowed[0][0] for r in ranges], float),
            high=np.array([r.allowed[-1][1] for r in ranges], float),
            share=float(path.weight[list_run_points(path, runs)].sum()),
            least=np.array([r.least for r in ranges], float),
            most=np.array([r.most for r in ranges], float),
            allowed=tuple(r.allowed for r in ranges),
            must=np.array([r.must for r in ranges], bool),
            position_wishes=mine,
        )
        _refuse_too_many_choices(group, axes)
        out.append(group)
    return out


@dataclass(frozen=True, kw_only=True)
class _AxisRange:
    """Where one external joint may be in one group of operations, m or rad."""

    moving: bool
    allowed: tuple[Interval, ...]  # values of a joint that keeps one
    least: float  # range of a joint that moves
    most: float
    must: bool


def _refuse_unknown_operations(axes: Sequence[ExternalJointOptions], labels: list[str]) -> None:
    for axis in axes:
        for label, _ in (*axis.operations, *axis.at_operations):
            if label not in labels:
                raise CellError(
                    f"{label!r} is no operation of the toolpath; {suggest_nearest_word(label, labels)}",
                    file="options",
                    where=f"external.{axis.joint}.operations",
                )


def _list_operations_by_run(toolpath: Toolpath, path: PlanningPath) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return the operations that share runs, and these runs, in the order of the path."""
    of_row = toolpath.operation[np.ceil(path.index - 1e-12).astype(int)]
    group = np.arange(len(toolpath.operations))
    for first, last in path.runs:
        own = np.unique(group[of_row[first : last + 1]])
        group[np.isin(group, own)] = own[0]
    return [
        (
            tuple(np.flatnonzero(group == g).tolist()),
            tuple(k for k, (first, _) in enumerate(path.runs) if group[of_row[first]] == g),
        )
        for g in dict.fromkeys(group[of_row[first]] for first, _ in path.runs)
    ]


def _find_axis_range(
    cell: Cell, k: int, axis: ExternalJointOptions, labels: list[str], wishes: tuple[AxisPositionWish, ...]
) -> _AxisRange:
    """Return where external joint k may be in the operations ``labels``.

    Raises:
        InputError: the operations request two modes, or no place satisfies all wishes.
    """
    modes = {dict(axis.operations).get(label, axis.mode or MOVING): label for label in labels}
    if len(modes) > 1:
        message = ", ".join(f"{label!r} {mode}" for mode, label in modes.items())
        raise CellError(
            f"{message}: they share a run without a rapid move, so they share a mode; one mode would work",
            file="options",
            where=f"external.{axis.joint}.operations",
        )
    mode = next(iter(modes))
    requested = _get_requested_value(axis, labels)
    moving = mode == MOVING and requested is None
    must, allowed, (least, most) = _find_room(
        cell,
        k,
        axis if requested is None else replace(axis, at=requested),
        [s for s in wishes if s.joint == k],
        locked=mode == "locked" or requested is not None,
        moves=moving,
    )
    return _AxisRange(moving=moving, allowed=allowed, least=least, most=most, must=must)


def _refuse_too_many_choices(group: OperationGroup, axes: Sequence[ExternalJointOptions]) -> None:
    chosen = np.flatnonzero((group.high > group.low) | (group.moving & (group.most > group.least)))
    if len(chosen) > MOST:
        names = [axes[k].joint for k in chosen.tolist()]
        raise CellError(
            f"places are to be chosen for {len(chosen)} external joints ({', '.join(names)}), and {MOST} are the "
            f"most; one that stays at home would work: {names[-1]}: {{mode: locked}}",
            file="options",
            where="external",
        )


def _find_room(
    cell: Cell, k: int, axis: ExternalJointOptions, wishes: Sequence[AxisPositionWish], *, locked: bool, moves: bool
) -> tuple[bool, tuple[Interval, ...], Interval]:
    """Return whether joint ``k`` has to move, the places allowed where it does not, and its range where it does.

    A pin overrides the place of a locked joint, and the general range of the options.
    """
    low, high = compute_axis_range(cell, k, axis, locked=locked)
    pins = [s.at for s in wishes if s.at is not None]
    base = (min([low, *pins]), max([high, *pins]))
    check_compatible_wishes(wishes, base)
    whole = (low, high) if not pins or not locked else (min(pins), max(pins))
    left = intersect_wishes(wishes, (base if pins else whole,))
    if left:
        return False, left, base
    if moves:
        return True, (whole,), base
    origin = " and ".join(s.description for s in wishes) or f"{axis.joint!r} locked"
    raise CellError(
        f"{origin}: they are in operations that share a run without a rapid move, where {cell.external_joints[k]!r} "
        "has one position, and none satisfies all of that; one of them, or mode: moving, would work",
        file="options",
        where="steer",
    )


def _get_requested_value(axis: ExternalJointOptions, labels: Sequence[str]) -> float | None:
    """Return the requested value of a joint in operations that share it, m or rad; None where the plan is free to
    choose.
    """
    requested = {value: label for label, value in axis.at_operations if label in labels}
    if len(requested) > 1:
        message = " and ".join(repr(label) for label in requested.values())
        raise CellError(
            f"{message} share a run without a rapid move, so the joint has one position; one value would work",
            file="options",
            where=f"external.{axis.joint}.at_operations_{axis.unit}",
        )
    return next(iter(requested), None)
