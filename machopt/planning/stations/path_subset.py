"""Some runs of a path as a separate path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.planning.stations.planning_path import PlanningPath

_ROWS = (  # one entry per planning point
    *("index", "position", "axis", "move", "feed", "time", "s", "travel", "is_point", "is_drilling", "plunge"),
    *("reference", "offset", "external"),
)


def list_run_points(path: PlanningPath, runs: Sequence[int]) -> NDArray[np.intp]:
    """Return the planning points of some runs, in order.

    Args:
        path: planning points.
        runs: numbers of the runs.
    """
    return np.concatenate([np.arange(path.runs[k][0], path.runs[k][1] + 1) for k in runs])


def select_path_runs(path: PlanningPath, runs: Sequence[int], stations: int, busy: Array | None = None) -> PlanningPath:
    """Return the path without its other runs, with about the given number of stations; both ends of each run are
    stations.

    So are the cut places where they are few: of holes, every n-th station might never be one at the bottom.
    Weights and shares are relative to the part.

    Args:
        path: planning points.
        runs: numbers of the runs to keep.
        stations: approximate number of stations.
        busy: (P,) additional share of the stations for each planning point, besides an even share; None: all are even.
    """
    rows = list_run_points(path, runs)
    size = [path.runs[k][1] - path.runs[k][0] + 1 for k in runs]
    ends = np.cumsum(size)
    own = np.flatnonzero(np.isin(rows, path.stations))
    cuts = own[path.counted[rows[own]]]
    if len(cuts) > stations and len(cuts) > 0.5 * len(own):  # too many: distributed with the others
        cuts = cuts[:0]
    keep = np.unique(
        np.concatenate(
            [
                _spread(own, stations) if busy is None else _select_by_share(own, stations, busy[rows[own]]),
                cuts if len(cuts) <= stations else _spread(cuts, stations // 2),
                ends - 1,
                ends - np.array(size),
            ]
        )
    )
    fields = {name: getattr(path, name)[rows] for name in _ROWS}
    for name in ("time", "s"):  # they do not increase over rapid moves
        fields[name] = np.cumsum(np.diff(getattr(path, name), prepend=getattr(path, name)[:1])[rows])
    return replace(
        path,
        **fields,
        force=None if path.force is None else path.force[rows],
        run=np.repeat(np.arange(len(runs), dtype=np.int32), size),
        stations=keep.astype(np.int32),
        runs=tuple((int(b - n), int(b) - 1) for b, n in zip(ends, size, strict=True)),
    )


def _spread(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Return at most the given number of rows, evenly spaced."""
    return np.asarray(rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), count)).round().astype(int))])


def _select_by_share(rows: NDArray[np.intp], count: int, busy: Array) -> NDArray[np.intp]:
    """Return at most the given number of rows, half of them evenly and half by shares (n,)."""
    n = len(rows)
    if n <= count:
        return rows
    even = np.arange(n) / (n - 1)
    much = np.cumsum(busy) / max(float(busy.sum()), 1e-300) if busy.any() else even
    at = np.interp(np.linspace(0.0, 1.0, count), 0.5 * (even + much), np.arange(n))
    return np.asarray(rows[np.unique(at.round().astype(int))])
