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
    stands: tuple[AxisPositionWish, ...] = ()  # position requests of the user

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
    for axis in axes:
        for label, _ in (*axis.operations, *axis.at_operations):
            if label not in labels:
                raise CellError(
                    f"{label!r} is no operation of the toolpath; {suggest_nearest_word(label, labels)}",
                    file="options",
                    where=f"external.{axis.joint}.operations",
                )
    of_row = toolpath.operation[np.ceil(path.index - 1e-12).astype(int)]
    group = np.arange(len(labels))
    for first, last in path.runs:
        own = np.unique(group[of_row[first : last + 1]])
        group[np.isin(group, own)] = own[0]
    out = []
    for g in dict.fromkeys(group[of_row[first]] for first, _ in path.runs):
        operations = np.flatnonzero(group == g)
        runs = tuple(k for k, (first, _) in enumerate(path.runs) if group[of_row[first]] == g)
        low, high, moving = np.empty(len(axes)), np.empty(len(axes)), np.zeros(len(axes), bool)
        mine = tuple(
            s
            for s in position_wishes
            if any(s.rows[0] <= path.runs[r][1] and path.runs[r][0] <= s.rows[1] for r in runs)
        )
        least, most, must = low.copy(), high.copy(), moving.copy()
        allowed: list[tuple[Interval, ...]] = []
        for k, axis in enumerate(axes):
            modes = {dict(axis.operations).get(labels[o], axis.mode or MOVING): labels[o] for o in operations}
            if len(modes) > 1:
                message = ", ".join(f"{label!r} {mode}" for mode, label in modes.items())
                raise CellError(
                    f"{message}: they share a run without a rapid move, so they share a mode; one mode would work",
                    file="options",
                    where=f"external.{axis.joint}.operations",
                )
            mode = next(iter(modes))
            moving[k] = mode == MOVING
            requested = _given(axis, [labels[o] for o in operations])
            axis_options = axis if requested is None else replace(axis, at=requested)
            locked = mode == "locked" or requested is not None
            moving[k] &= requested is None
            left = _room(cell, k, axis_options, [s for s in mine if s.joint == k], locked=locked, moves=bool(moving[k]))
            must[k], allowed_here, (least[k], most[k]) = left
            allowed.append(allowed_here)
            low[k], high[k] = allowed_here[0][0], allowed_here[-1][1]
        chosen = np.flatnonzero((high > low) | (moving & (most > least)))
        if len(chosen) > MOST:
            names = [axes[k].joint for k in chosen.tolist()]
            raise CellError(
                f"places are to be chosen for {len(chosen)} external joints ({', '.join(names)}), and {MOST} are the "
                f"most; one that stays at home would work: {names[-1]}: {{mode: locked}}",
                file="options",
                where="external",
            )
        share = float(path.weight[list_run_points(path, runs)].sum())
        some = tuple(operations.tolist())
        out.append(
            OperationGroup(
                runs=runs,
                operations=some,
                moving=moving,
                low=low,
                high=high,
                share=share,
                least=least,
                most=most,
                allowed=tuple(allowed),
                must=must,
                stands=mine,
            )
        )
    return out


def _room(
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
    origin = " and ".join(s.said for s in wishes) or f"{axis.joint!r} locked"
    raise CellError(
        f"{origin}: they are in operations that share a run without a rapid move, where {cell.external_joints[k]!r} "
        "stands in one place, and none keeps all of that; one of them, or mode: moving, would work",
        file="options",
        where="steer",
    )


def _given(axis: ExternalJointOptions, labels: Sequence[str]) -> float | None:
    """Return the requested value of a joint in operations that share it, m or rad; None where the plan is free to
    choose.
    """
    requested = {value: label for label, value in axis.at_operations if label in labels}
    if len(requested) > 1:
        message = " and ".join(repr(label) for label in requested.values())
        raise CellError(
            f"{message} share a run without a rapid move, so the joint stands in one place; one value would work",
            file="options",
            where=f"external.{axis.joint}.at_operations_{axis.unit}",
        )
    return next(iter(requested), None)
