"""The operations that share where the external joints stand, and what the user asked of these there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array, Bools
from machopt.domain.cell import Cell
from machopt.domain.options import ExternalAxis
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError, nearest
from machopt.plan.axes import range_of
from machopt.plan.part import rows_of
from machopt.plan.path import Path

MOVING = "moving"


@dataclass(frozen=True)
class Group:
    """Operations that share their values."""

    runs: tuple[int, ...]
    operations: tuple[int, ...]
    moving: Bools  # (E,) the joint may move along the path
    low: Array  # (E,) m or rad; equal to ``high`` where the joint is locked
    high: Array  # (E,)
    share: float  # of the length cut


def groups_of(cell: Cell, toolpath: Toolpath, path: Path, axes: Sequence[ExternalAxis]) -> list[Group]:
    """Operations joined by runs that they share, in the order of the path."""
    labels = [o.label for o in toolpath.operations]
    for axis in axes:
        for label, _ in (*axis.operations, *axis.at_operations):
            if label not in labels:
                raise InputError(
                    f"{label!r} is no operation of the toolpath; {nearest(label, labels)}",
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
        for k, axis in enumerate(axes):
            modes = {dict(axis.operations).get(labels[o], axis.mode or MOVING): labels[o] for o in operations}
            if len(modes) > 1:
                told = ", ".join(f"{label!r} {mode}" for mode, label in modes.items())
                raise InputError(
                    f"{told}: they share a run without a rapid move, so they share a mode; one mode would work",
                    file="options",
                    where=f"external.{axis.joint}.operations",
                )
            mode = next(iter(modes))
            moving[k] = mode == MOVING
            given = _given(axis, [labels[o] for o in operations])
            asked = axis if given is None else replace(axis, at=given)
            locked = mode == "locked" or given is not None
            moving[k] &= given is None
            low[k], high[k] = range_of(cell, k, asked, locked=locked)
        share = float(path.weight[rows_of(path, runs)].sum())
        out.append(Group(runs, tuple(operations.tolist()), moving, low, high, share))
    return out


def _given(axis: ExternalAxis, labels: Sequence[str]) -> float | None:
    """Where the user wants a joint in operations that share it, m or rad; None where that is left to the plan."""
    asked = {value: label for label, value in axis.at_operations if label in labels}
    if len(asked) > 1:
        told = " and ".join(repr(label) for label in asked.values())
        raise InputError(
            f"{told} share a run without a rapid move, so the joint stands in one place; one value would work",
            file="options",
            where=f"external.{axis.joint}.at_operations_{axis.unit}",
        )
    return next(iter(asked), None)
