"""Pose visits: which readings were taken during one stay at a pose, and which stays repeat each other.

A visit is an unbroken run of rows of one pose in one session. Readings inside a visit show the noise of a reading.
Two visits under the same load are replicates. Where no pose was left and visited again, load cycles of one stay are
compared instead: they leave the return to the pose unmeasured, which the diagnosis says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


def label_unbroken_runs(labels: Sequence[Ints]) -> Ints:
    """Number the unbroken runs of rows with equal labels, 0, 1, … in the order of the rows.

    Args:
        labels: Label columns (N,) each.

    Returns:
        (N,) number of the run.
    """
    table = np.stack([np.asarray(column) for column in labels], axis=1)
    if not len(table):
        return np.zeros(0, np.int64)
    changes = np.any(np.diff(table, axis=0) != 0, axis=1)
    return np.concatenate([[0], np.cumsum(changes)]).astype(np.int64)


def nest_labels(outer: Ints, inner: Ints) -> Ints:
    """Number the pairs of two labels, so that no inner label spans two outer ones.

    Args:
        outer: (N,) outer label.
        inner: (N,) inner label.

    Returns:
        (N,) number of the pair.
    """
    pairs = np.stack([outer, inner], axis=1)
    return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def count_replicated_readings(replicate: Ints, visit: Ints) -> int:
    """Count the readings with a replicate in another visit.

    Args:
        replicate: (N,) label of equal pose and load; −1 without one.
        visit: (N,) visit of each reading.

    Returns:
        Number of readings.
    """
    rows = np.flatnonzero(replicate >= 0)
    if not len(rows):
        return 0
    kinds, label = np.unique(replicate[rows], return_inverse=True)
    pairs = np.unique(np.stack([label, visit[rows]]), axis=1)
    visits = np.bincount(pairs[0], minlength=len(kinds))
    return int(np.sum(visits[label] > 1))
