"""Operation of process.yaml that each toolpath point belongs to, and its spindle speed."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.toolpath import Toolpath
from machopt.errors import ConfigurationKeyError, suggest_nearest_word
from machopt.numerics.array_types import Array

_TURNS_LEFT = re.compile(r"(?:^|\W)(?:M0?4|M14|CCLW)(?:\W|$)", re.IGNORECASE)
_SPEED_ALONE = re.compile(r"\s*S[0-9.]+\s*", re.IGNORECASE)  # changes the speed, not the direction
DEFAULT = "default"  # label of the operation that applies to every other one
NO_OPERATION = -1


def attach_process(process: CuttingProcess | None, toolpath: Toolpath) -> Toolpath:
    """Return the toolpath with the process operation of each point.

    Args:
        process: Content of process.yaml, or None.
        toolpath: The whole toolpath of the job.

    Raises:
        ConfigurationKeyError: a label or point range matches nothing, or a milling or drilling operation has no
            spindle speed.
    """
    if process is None:
        return toolpath
    return replace(toolpath, process_operation=match_operations(process, toolpath))


def match_operations(process: CuttingProcess, toolpath: Toolpath) -> NDArray[np.int32]:
    """Return (N,) the index of the process operation of each point; ``NO_OPERATION`` where none is stated.

    A point outside the range ``points`` of its operation belongs to ``default``, where that is stated.

    Args:
        process: Content of process.yaml.
        toolpath: The whole toolpath of the job.

    Raises:
        ConfigurationKeyError: a label or a range of points matches nothing.
    """
    labels = [operation.label for operation in toolpath.operations]
    label_of_point = np.array(labels, dtype=object)[toolpath.operation]
    named = {one.label: k for k, one in enumerate(process.operations)}
    out = np.full(len(toolpath), named.get(DEFAULT, NO_OPERATION), np.int32)
    for label, k in named.items():
        one = process.operations[k]
        mine = _find_points(one, label_of_point)
        if label != DEFAULT and (not mine.any() or (one.points is not None and one.points[1] >= len(toolpath))):
            _refuse_unmatched(process, one, label_of_point)
        if label != DEFAULT:
            out[mine] = k
    _check_spindle_directions(process, toolpath, out)
    return out


def _check_spindle_directions(process: CuttingProcess, toolpath: Toolpath, operation: NDArray[np.int32]) -> None:
    """Refuse an operation with ``spindle: cw`` whose spindle the file turns counter-clockwise (M4)."""
    left = np.zeros(len(toolpath), bool)
    words = [""] * len(toolpath)
    for event in toolpath.events:
        if event.kind == "spindle" and event.value > 0 and not _SPEED_ALONE.fullmatch(event.text):
            left[event.index :] = _TURNS_LEFT.search(event.text) is not None
            words[event.index :] = [event.text] * (len(toolpath) - event.index)
    for k, one in enumerate(process.operations):
        wrong = np.flatnonzero(toolpath.cutting & (operation == k) & left)
        if len(wrong) and one.spindle == "cw" and one.kind != "force":
            raise ConfigurationKeyError(
                f"the toolpath turns the spindle counter-clockwise ({words[wrong[0]]}) at point {wrong[0]}, and the "
                "operation is for clockwise, seen from the shank; spindle: ccw would work",
                file=process.file,
                where=f"operations.{one.label}.spindle",
                key="spindle",
            )


def compute_spindle_speeds(process: CuttingProcess, toolpath: Toolpath) -> Array:
    """Return the (N,) spindle speed in rev/s; NaN where neither process.yaml nor the file states one.

    Args:
        process: Content of process.yaml.
        toolpath: A toolpath with its process operations.
    """
    out = np.full(len(toolpath), np.nan)
    for event in toolpath.events:
        if event.kind == "spindle":
            out[event.index :] = event.value / 60.0 if event.value > 0 else np.nan
    if toolpath.process_operation is None:
        return out
    stated = [np.nan if one.spindle_speed is None else one.spindle_speed for one in process.operations]
    own = np.array([*stated, np.nan])[toolpath.process_operation]
    return np.where(np.isnan(own), out, own)


def _find_points(one: ProcessOperation, label_of_point: NDArray[np.object_]) -> NDArray[np.bool_]:
    mine = np.asarray(label_of_point == one.label)
    if one.points is not None:
        rows = np.arange(len(mine))
        mine &= (rows >= one.points[0]) & (rows <= one.points[1])
    return mine


def _refuse_unmatched(process: CuttingProcess, one: ProcessOperation, label_of_point: NDArray[np.object_]) -> None:
    known = list(dict.fromkeys(label_of_point.tolist()))
    if one.label in known:
        first, last = one.points or (0, 0)
        own = np.flatnonzero(label_of_point == one.label)
        raise ConfigurationKeyError(
            f"points [{first}, {last}] do not lie in operation {one.label!r}; it has points between {own[0]} and "
            f"{own[-1]}, and the toolpath 0 to {len(label_of_point) - 1}",
            file=process.file,
            where=f"operations.{one.label}.points",
            key="points",
        )
    raise ConfigurationKeyError(
        f"the toolpath has no operation {one.label!r}; {suggest_nearest_word(one.label, known)} (or {DEFAULT})",
        file=process.file,
        where=f"operations.{one.label}",
        key=one.label,
    )
