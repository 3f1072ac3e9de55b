"""What a job does to its stock, and the comparison with the finished part: the workpiece of the cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from machopt.cell.mesh.stock_mesh import read_stock_mesh
from machopt.data_types.cell import Cell
from machopt.data_types.stock import StockBody, StockSummary
from machopt.data_types.tool_segments import ToolSegment
from machopt.errors import InputError, MeshError
from machopt.process.binding.job_binding import remove_stock
from machopt.process.stock.height_map_comparison import compare_with_finished_part
from machopt.process.stock.path_removal import NOTHING


def summarise_stock(cell: Cell, segments: Sequence[ToolSegment]) -> StockSummary | None:
    """Return what a job does to its stock; None where no engagement comes from there.

    Args:
        cell: The cell with the finished part as its workpiece.
        segments: Segments of the job, with their contact.
    """
    process = segments[0].cell.process
    found = [s.toolpath.engagement for s in segments]
    if process is None or process.stock is None or any(one is None for one in found):
        return None
    removal = remove_stock(process, segments)
    parts = list(zip(segments, removal.engagements, strict=True))
    part = _read_finished_part(cell, process.stock.cell_size)
    return StockSummary(
        cell_size=process.stock.cell_size,
        volume=removal.volume_before,
        removed=float(sum(e.volume.sum() for _, e in parts)),
        removed_by_other_moves=float(sum(e.volume[~s.toolpath.cutting].sum() for s, e in parts)),
        cut_moves=int(sum(e.is_computed.sum() for _, e in parts)),
        air_cuts=int(sum((e.is_computed & (e.volume <= NOTHING)).sum() for _, e in parts)),
        finished=None if part is None else compare_with_finished_part(removal.remaining, part),
    )


def _read_finished_part(cell: Cell, cell_size: float) -> StockBody | None:
    """Return the workpiece in the CAM frame; None where it is not one closed mesh."""
    shapes = cell.workpiece.geometry
    if len(shapes) != 1 or shapes[0].mesh is None:
        return None
    shape = shapes[0]
    assert shape.mesh is not None
    file = shape.mesh

    def fail(message: str) -> InputError:
        return MeshError(message, file=file)

    try:
        body = read_stock_mesh(file, shape.size[0], cell_size, fail)
    except MeshError:  # open or inside out, of which the cell's warnings tell
        return None
    T = shape.T_parent_shape
    return replace(body, vertices=body.vertices @ T[:3, :3].T + T[:3, 3])
