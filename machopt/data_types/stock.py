"""Stock of a job, and the contact of the cutter with it at the points of a toolpath. SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, make_arrays_read_only


@dataclass(frozen=True, kw_only=True, eq=False)
class StockBody:
    """The part before machining: a closed triangle mesh in the CAM frame."""

    vertices: Array  # (V, 3) m
    faces: NDArray[np.int64]  # (F, 3), counter-clockwise seen from outside
    cell_size: float  # m, of the stock model
    file: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True, kw_only=True)
class StockEngagement:
    """Contact of the cutter with the stock at N toolpath points.

    The contact of a point is a list of arcs. Each holds for a slice of the cutter between two heights above the tip.
    The angle φ is zero at axis × travel and grows towards travel (spindle cw); it is mirrored for ccw.
    """

    point: NDArray[np.int64]  # (M,) point of each arc, ascending
    low: Array  # (M,) m above the tip, lower end of the slice
    high: Array  # (M,) m, upper end
    start: Array  # (M,) rad, φ of entry
    end: Array  # (M,) rad, φ of exit
    is_computed: NDArray[np.bool_]  # (N,) the contact is known: cut moves of operations with engagement from the stock
    volume: Array  # (N,) m³ removed by the move that ends at each point
    is_end_cut: NDArray[np.bool_]  # (N,) the end of the cutter removes material too (plunge, ramp): force unknown
    edge_sigma: float  # m, 1 sigma of the place of a boundary, across it
    notes: tuple[str, ...] = ()  # limits of validity, for the report

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    def select_points(self, wanted: NDArray[np.bool_]) -> StockEngagement:
        """Return the contact of some points alone; the others touch nothing.

        Args:
            wanted: (N,) which points.
        """
        rows = wanted[self.point]
        return replace(
            self,
            point=self.point[rows],
            low=self.low[rows],
            high=self.high[rows],
            start=self.start[rows],
            end=self.end[rows],
            is_computed=self.is_computed & wanted,
            is_end_cut=self.is_end_cut & wanted,
        )

    def take_range(self, first: int, stop: int) -> StockEngagement:
        """Return the contact of some consecutive points, counted from the first of them.

        Args:
            first: First point.
            stop: Point after the last one.
        """
        a, b = np.searchsorted(self.point, (first, stop))
        return StockEngagement(
            point=self.point[a:b] - first,
            low=self.low[a:b].copy(),
            high=self.high[a:b].copy(),
            start=self.start[a:b].copy(),
            end=self.end[a:b].copy(),
            is_computed=self.is_computed[first:stop].copy(),
            volume=self.volume[first:stop].copy(),
            is_end_cut=self.is_end_cut[first:stop].copy(),
            edge_sigma=self.edge_sigma,
            notes=self.notes,
        )


@dataclass(frozen=True, kw_only=True)
class StockComparison:
    """Stock after a job against the finished part."""

    gouge_depth: float  # m, largest depth into the part along the tool axis or its own normal, away from walls
    gouge_place: tuple[float, float, float] | None  # m, CAM frame
    gouge_volume: float  # m³
    left_depth: float  # m, largest height of material left, away from walls
    left_place: tuple[float, float, float] | None
    left_volume: float  # m³


@dataclass(frozen=True, kw_only=True)
class StockSummary:
    """What a job does to its stock."""

    cell_size: float  # m
    volume: float  # m³ before the job
    removed: float  # m³ by all moves
    removed_by_other_moves: float  # m³ of it, by moves that are no cuts
    cut_moves: int  # with engagement from the stock
    air_cuts: int  # of them, that remove nothing
    finished: StockComparison | None = None  # None without a mesh of the finished part


def join_stock_engagements(parts: Sequence[StockEngagement | None]) -> StockEngagement | None:
    """Return the contact of a job from that of its tools; None where no tool has one.

    Args:
        parts: Contact of each tool's part of the job, in order.
    """
    known = [part for part in parts if part is not None]
    if len(known) < len(parts) or not known:
        return None
    first = np.cumsum([0, *(len(part.volume) for part in known)])
    return StockEngagement(
        point=np.concatenate([part.point + n for part, n in zip(known, first, strict=False)]),
        **{name: np.concatenate([getattr(part, name) for part in known]) for name in _ARC_COLUMNS},
        edge_sigma=known[0].edge_sigma,
        notes=tuple(dict.fromkeys(note for part in known for note in part.notes)),
    )


_ARC_COLUMNS = ("low", "high", "start", "end", "is_computed", "volume", "is_end_cut")
