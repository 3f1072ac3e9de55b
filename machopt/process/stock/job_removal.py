"""The moves of a whole job removed from its stock in program order, tool after tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt, tan

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess
from machopt.data_types.stock import StockBody, StockEngagement
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array
from machopt.process.stock.contact_kernels import THIN
from machopt.process.stock.distance_field import DistanceField, build_distance_field
from machopt.process.stock.end_cutting import ROUNDING, THROUGH, find_end_cuts, find_plunges, measure_descents
from machopt.process.stock.field_path import remove_field_path
from machopt.process.stock.height_map import HeightMap, build_height_map
from machopt.process.stock.path_removal import NOTHING, remove_path

SAME_AXIS = np.cos(np.radians(0.05))
_UNIFORM = 1.0 / sqrt(12.0)  # 1 sigma of a place that is known to one cell


StockModel = HeightMap | DistanceField


@dataclass(frozen=True)
class JobRemoval:
    """Stock after a job, and the contact of each tool's part of it."""

    engagements: tuple[StockEngagement, ...]  # one for each segment
    remaining: StockModel
    volume_before: float  # m³


def remove_job(process: CuttingProcess, segments: Sequence[ToolSegment]) -> JobRemoval:
    """Remove all moves of a job from its stock and return the contact of the operations that want it.

    A job with one tool axis uses heights along it, any other job signed distances.

    Args:
        process: Content of process.yaml, with a stock.
        segments: Segments of the job, in order, with their process operations.

    Raises:
        CuttingInputError: a tool has no cutter, no cut move meets the stock, or the number of cells is out of range.
    """
    body = process.stock
    assert body is not None
    axis = _find_axis(segments)
    stock = build_distance_field(body) if axis is None else build_height_map(body, axis)
    before = stock.volume
    found = []
    for segment in segments:
        found.append(_remove_segment(process, segment, stock, body.cell_size))
    _check_contact(body, segments, found)
    return JobRemoval(tuple(found), stock, before)


def find_wanted_points(process: CuttingProcess, toolpath: Toolpath) -> NDArray[np.bool_]:
    """Return (N,) whether the contact of a point comes from the stock.

    Args:
        process: Content of process.yaml.
        toolpath: A toolpath with its process operations.
    """
    assert toolpath.process_operation is not None
    wants = np.array([*(one.takes_stock for one in process.operations), False])
    return np.asarray(toolpath.cutting & wants[toolpath.process_operation])


def _find_axis(segments: Sequence[ToolSegment]) -> Array | None:
    """Return (3,) the tool axis that all cut moves share; None where it turns."""
    axes = np.concatenate([s.toolpath.axis[s.toolpath.cutting] for s in segments])
    if not len(axes):
        raise CuttingInputError("the toolpath has no cut move; engagement from the stock needs one", key="engagement")
    return None if (axes @ axes[0] < SAME_AXIS).any() else np.asarray(axes[0])


def _remove_segment(
    process: CuttingProcess, segment: ToolSegment, stock: StockModel, cell_size: float
) -> StockEngagement:
    path = segment.toolpath
    cutter = segment.cell.tool.cutter
    if cutter is None:
        raise CuttingInputError(
            f"the tool{' ' + segment.tool if segment.tool else ''} has no cutter, so that what it removes from the "
            "stock is unknown: tool.cutter in cell.yaml would work",
            key="engagement",
        )
    wanted = find_wanted_points(process, path)
    tip = _build_tip(cutter)
    descends = wanted & (measure_descents(path.position, path.axis, path.cutting)[2] > THIN + ROUNDING)
    by_end = descends.astype(float)
    if isinstance(stock, HeightMap):
        volume, point, rows = remove_path(
            stock, stock.convert_points(path.position), wanted, tip, cutter.length, by_end
        )
    else:
        volume, point, rows = remove_field_path(stock, path.position, path.axis, wanted, (*tip, cutter.length), by_end)
    start, end = rows[:, 2].copy(), rows[:, 3].copy()
    assert path.process_operation is not None
    ccw = np.array([*(one.spindle == "ccw" for one in process.operations), False])[path.process_operation[point]]
    start, end = np.where(ccw, np.pi - end, start), np.where(ccw, np.pi - start, end)
    found = StockEngagement(
        point=point,
        low=rows[:, 0].copy(),
        high=rows[:, 1].copy(),
        start=start,
        end=end,
        is_computed=wanted,
        volume=volume,
        is_end_cut=np.zeros(len(path), bool),
        edge_sigma=_UNIFORM * cell_size,
    )
    found = replace(found, is_end_cut=find_end_cuts(path.position, path.axis, path.cutting, found, by_end, tip[0]))
    found = _leave_out_plunges(found, find_plunges(path.position, path.axis, path.cutting))
    return replace(found, notes=tuple(_list_notes(path, found, stock)))


def _leave_out_plunges(stock_engagement: StockEngagement, plunges: NDArray[np.bool_]) -> StockEngagement:
    """Return the contact without arcs of plunges, whose side has no feed across the axis to speak of."""
    keep = ~plunges[stock_engagement.point]
    return replace(
        stock_engagement,
        **{name: getattr(stock_engagement, name)[keep] for name in ("point", "low", "high", "start", "end")},
    )


def _build_tip(cutter: CutterGeometry) -> tuple[float, float, float]:
    """Return radius, corner radius and slope of the cone of a drill's point."""
    cone = 0.0 if cutter.point_angle is None else 1.0 / tan(0.5 * cutter.point_angle)
    return 0.5 * cutter.diameter, min(cutter.corner, 0.5 * cutter.diameter), cone


def _list_notes(path: Toolpath, stock_engagement: StockEngagement, stock: StockModel) -> list[str]:
    """Return what the contact does not cover, and the moves that a user should look at."""
    out: list[str] = []
    cuts, removes = stock_engagement.is_computed, stock_engagement.volume > THROUGH
    if not cuts.any():
        return out
    air = cuts & (stock_engagement.volume <= NOTHING)
    out.append(
        f"engagement from the stock at {1e3 * stock.size:.3g} mm cells: 1 sigma of a boundary is "
        f"{1e3 * stock_engagement.edge_sigma:.2g} mm; the spread of a force grows by that over ae_mm"
    )
    if air.any():
        out.append(f"{int(air.sum())} of {int(cuts.sum())} cut moves remove nothing: they have no force")
    if stock_engagement.is_end_cut.any():
        out.append(
            f"{int(stock_engagement.is_end_cut.sum())} cut moves remove material with the end of the cutter (first at "
            f"point {int(np.argmax(stock_engagement.is_end_cut))}): the force of plunges and ramps is unknown"
        )
    rapid = ~path.cutting & removes
    if rapid.any():
        worst = int(np.argmax(np.where(rapid, stock_engagement.volume, 0.0)))
        out.append(
            f"{int(rapid.sum())} moves that are no cuts go through material, most of all the move to point {worst} "
            f"({1e9 * stock_engagement.volume[worst]:.3g} mm³); it counts as removed"
        )
    if stock.gap_volume > 0:
        out.append(f"the stock has gaps along the tool axis of {1e9 * stock.gap_volume:.3g} mm³ that count as filled")
    return out


def _check_contact(body: StockBody, segments: Sequence[ToolSegment], found: Sequence[StockEngagement]) -> None:
    """Refuse a stock that no cut with engagement from the stock touches: it lies elsewhere, or has another unit."""
    if any(len(part.point) for part in found):
        return
    if any(part.is_end_cut.any() for part in found):
        raise CuttingInputError(
            "every cut move that meets the stock is a plunge or a ramp, whose force is unknown; an operation of "
            "kind: force with force_N would work",
            key="engagement",
        )
    points = np.concatenate([s.toolpath.position[e.is_computed] for s, e in zip(segments, found, strict=True)])
    raise CuttingInputError(
        f"no cut move meets the stock {'' if body.file is None else body.file.name}: the stock lies at "
        f"{_format_box(body.vertices)}, the cut points at {_format_box(points)} mm in the CAM frame; a stock in CAM "
        "coordinates, or a scale for another unit, would work",
        key="mesh",
    )


def _format_box(points: Array) -> str:
    low, high = 1e3 * points.min(axis=0), 1e3 * points.max(axis=0)
    return ", ".join(f"{n} {a:.4g} … {b:.4g}" for n, a, b in zip("xyz", low, high, strict=True))
