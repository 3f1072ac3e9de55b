"""Contact of the cutter with the stock at some points, recomputed from exact shapes instead of cells.

A line through a point of the cutter's outline along the tool axis leaves the stock mesh at exact heights. What earlier
moves left on it is the least surface height of the cutter over poses along those moves, ``STEP`` apart. The outline is
sampled at ``BINS`` angles; where the tool axis turns between cut moves, it is sampled by :mod:`turning_contact`.
The same is done with the outline moved in and out by ``SHIFT`` cells, without the last part of the path, and without
chips thinner than ``THIN`` or narrower than ``NARROW`` cells: a stated force must lie between what these give.

The planner leaves out chips thinner than that. Where a cut ends at a face across travel, the chip x before it has the
depth x² / 2R, so that the planner's cut ends √(2 THIN h R) early: 0.65 mm at R = 8.5 mm and cells of h = 0.25 mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import ProcessOperation
from machopt.data_types.stock import StockBody, StockEngagement
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.process.contact_load import compute_contact_load, find_slice_shapes
from machopt.verification.motion.process.end_contact import EndDisc, find_descents, list_wrong_forces
from machopt.verification.motion.process.lines_through_mesh import build_axis_frame, find_mesh_heights
from machopt.verification.motion.process.turning_contact import (
    TurningCut,
    TurningPoses,
    find_turning_arcs,
    list_turning_poses,
    measure_turning_material,
)

POINTS, TURNING_POINTS = 40, 24
BINS, CORNER_SLICES = 180, 48
STEP = 0.25e-3  # m
SAME = 1e-9  # rad or m
SHIFT = 0.75  # cells
THIN = 0.1  # cells of depth: the planner leaves out contacts that are thinner
NARROW = 2.0  # cells along the outline: the planner samples it so, away from its sides
LAG = 8.0  # shifts of path before a point that are not counted where the outline is moved
SHARE, FORCE_N = 0.03, 1.0  # of the force, and N: angles in steps of 1°
TYPICAL_BITE = 1e-4  # m, where a point has no feed
TOUCHED = 5e-6  # m of height
ONE_AXIS = math.cos(math.radians(0.05))  # of the angle between the tool axes of cut moves that count as one


@dataclass(frozen=True, kw_only=True)
class _Poses:
    """Earlier poses of all tools, along the tool axis."""

    place: Array  # (P, 2) m across the axis
    height: Array  # (P,) m along it
    radius: Array  # (P,)
    corner: Array  # (P,)
    cone: Array  # (P,) slope of a drill's point
    length: Array  # (P,) m, path from the start of the job
    begins: np.ndarray  # (N,) first pose of the move that ends at each point of the job


_Scene = tuple[_Poses | TurningPoses, Array, Array]  # poses, corners of the stock, rows of the frame of both


def check_stock_contact(segments: Sequence[ToolSegment]) -> list[VerificationCheck]:
    """Return the check of the stated contact against exact shapes; none where no contact comes from the stock.

    Args:
        segments: Segments of the job; their toolpaths have the arcs of engagement.csv.
    """
    process = segments[0].cell.process
    if process is None or process.stock is None or all(s.toolpath.engagement is None for s in segments):
        return []
    scene = _build_scene(segments, process.stock)
    rows = [(n, int(k)) for n, s in enumerate(segments) for k in _list_wanted(s)]
    most = TURNING_POINTS if isinstance(scene[0], TurningPoses) else POINTS
    chosen = [rows[k] for k in np.unique(np.linspace(0, len(rows) - 1, most).round().astype(int))] if rows else []
    if not chosen:
        return []
    off, names = np.zeros(len(chosen)), []
    for n, (which, k) in enumerate(chosen):
        segment = segments[which]
        assert segment.toolpath.process_operation is not None
        one = process.operations[segment.toolpath.process_operation[k]]
        off[n] = _compare_point(segment, k, one, scene, process.stock)
        names.append(f"point {segment.first + k}")
    return [
        build_worst_value_check("engagement.csv against exact shapes", "of its limit", off, 1.0, names),
        _check_ends(segments, scene, process.stock.cell_size, most),
    ]


def _check_ends(segments: Sequence[ToolSegment], scene: _Scene, cell_size: float, most: int) -> VerificationCheck:
    """Compare the points without a force with where the end of the cutter meets the exact stock."""
    wrong: list[str] = []
    for segment in segments:
        cutter = segment.cell.tool.cutter
        assert cutter is not None
        measure = partial(_measure_material, segment, scene)
        wrong += list_wrong_forces(segment.toolpath, segment.first, cutter, measure, (SHIFT * cell_size, most))
    return build_count_check("points.csv forces of plunges and ramps", wrong, "points")


def _measure_material(segment: ToolSegment, scene: _Scene, k: int, disc: EndDisc) -> Array:
    """Return (P,) m of material that a move removes on lines through a disc, before its side does."""
    poses, triangles, frame = scene
    path, cutter = segment.toolpath, segment.cell.tool.cutter
    assert cutter is not None
    before = slice(0, poses.begins[segment.first + k])
    tip, axis, places = disc.locate(path, k)
    if isinstance(poses, TurningPoses):
        ranges = disc.list_ranges(path, k, cutter)
        return measure_turning_material(axis, places, ranges, (poses, before), triangles)
    flat = places @ frame.T
    bottom, top = find_mesh_heights(flat[:, :2], triangles)
    top = _cut_by_poses(flat[:, :2], top, poses, before, ((tip @ frame.T)[:2], disc.radius))
    low, high = disc.list_ranges(path, k, cutter) + float(tip @ frame[2])
    return np.asarray(np.maximum(np.minimum(top, high) - np.maximum(bottom, low), 0.0))


def _build_scene(segments: Sequence[ToolSegment], stock: StockBody) -> _Scene:
    axes = np.concatenate([s.toolpath.axis[s.toolpath.move == MoveKind.CUT] for s in segments])
    if (axes @ axes[0]).min() < ONE_AXIS:
        return list_turning_poses(segments), stock.vertices[stock.faces], np.eye(3)
    frame = build_axis_frame(axes[0])
    return _list_poses(segments, frame), (stock.vertices @ frame.T)[stock.faces], frame


def _list_wanted(segment: ToolSegment) -> np.ndarray:
    """Return the points whose contact is compared: cuts, without plunges that have no force and state no arcs."""
    found = segment.toolpath.engagement
    if found is None:
        return np.zeros(0, int)
    has_arcs = np.bincount(found.point, minlength=len(segment.toolpath)) > 0
    is_plunge = find_descents(segment.toolpath).is_steep & found.is_end_cut
    return np.flatnonzero(found.is_computed & (has_arcs | ~is_plunge))


def _list_poses(segments: Sequence[ToolSegment], frame: Array) -> _Poses:
    columns: list[Array] = []
    begins: list[int] = []
    count, before = 0, 0.0
    for segment in segments:
        cutter = segment.cell.tool.cutter
        assert cutter is not None
        cone = 0.0 if cutter.point_angle is None else 1.0 / math.tan(0.5 * cutter.point_angle)
        p = segment.toolpath.position @ frame.T
        for k in range(len(p)):
            begins.append(count)
            a = p[k - 1] if k else p[k]
            size = float(np.linalg.norm(p[k] - a))
            n = max(math.ceil(size / STEP), 1)
            share = np.arange(1, n + 1) / n
            tip = np.tile([0.5 * cutter.diameter, cutter.corner, cone], (n, 1))
            columns.append(np.column_stack([a + share[:, None] * (p[k] - a), tip, before + share * size]))
            count, before = count + n, before + size
    table = np.concatenate(columns)
    names = ("height", "radius", "corner", "cone", "length")
    return _Poses(place=table[:, :2], begins=np.array(begins), **{n: table[:, 2 + k] for k, n in enumerate(names)})


def _compare_point(
    segment: ToolSegment,
    k: int,
    one: ProcessOperation,
    scene: _Scene,
    stock: StockBody,
) -> float:
    """Return how far the stated force lies outside of what the exact shapes allow, over its limit."""
    path, cutter, process = segment.toolpath, segment.cell.tool.cutter, segment.cell.process
    assert cutter is not None
    assert process is not None
    assert path.engagement is not None
    coefficients = process.materials[one.material].milling
    assert coefficients is not None
    stated = path.engagement.take_range(k, k + 1)
    shift = SHIFT * stock.cell_size
    forces = []
    for moved, lag in ((0.0, 0.0), (shift, LAG * shift), (-shift, LAG * shift)):
        forces.append(_find_contact(segment, k, one, scene, (moved, lag), stated))
    forces.append(_leave_out_thin_chips(forces[0], cutter, stock.cell_size, isinstance(scene[0], TurningPoses)))
    loads = []
    for arcs in (stated, *forces):
        edge, slope = compute_contact_load(coefficients, cutter, one.spindle, arcs)
        loads.append((edge + TYPICAL_BITE * slope)[0, :3])
    own = np.stack(loads[1:])
    limit = FORCE_N + SHARE * float(np.linalg.norm(own[0]))
    return float(np.abs(loads[0] - np.clip(loads[0], own.min(axis=0), own.max(axis=0))).max() / limit)


def _find_contact(
    segment: ToolSegment,
    k: int,
    one: ProcessOperation,
    scene: _Scene,
    variant: tuple[float, float],
    stated: StockEngagement,
) -> StockEngagement:
    """Return the arcs of one point, of an outline that is moved outwards, without the last part of the path."""
    rows = _sample_arcs(segment, k, scene, variant, stated)
    table = np.array(rows).reshape(-1, 4)
    start, end = table[:, 2], table[:, 3]
    if one.spindle == "ccw":
        start, end = math.pi - end, math.pi - start
    return StockEngagement(
        point=np.zeros(len(table), np.int64),
        low=table[:, 0].copy(),
        high=table[:, 1].copy(),
        start=start.copy(),
        end=end.copy(),
        is_computed=stated.is_computed,
        volume=np.zeros(1),
        is_end_cut=np.zeros(1, bool),
        edge_sigma=stated.edge_sigma,
    )


def _leave_out_thin_chips(
    stock_engagement: StockEngagement, cutter: CutterGeometry, cell_size: float, has_slices: bool
) -> StockEngagement:
    """Return sampled arcs without those that may be thinner or narrower than the planner finds, within one sample.

    Without slices above the corner, the samples there belong to one slice.
    """
    radius = find_slice_shapes(cutter, stock_engagement)[0]
    own = has_slices | (stock_engagement.low < cutter.corner - SAME)
    group = np.where(own, stock_engagement.low, cutter.corner)
    order = np.lexsort((stock_engagement.start, group))
    keep, first = np.ones(len(order), bool), 0
    for n in range(1, len(order) + 1):
        last, begin = order[n - 1], order[first]
        if (
            n < len(order)
            and group[order[n]] == group[last]
            and stock_engagement.start[order[n]] - stock_engagement.end[last] < SAME
        ):
            continue
        width = stock_engagement.end[last] - stock_engagement.end[begin]  # less one sample
        is_side = stock_engagement.start[begin] < SAME or stock_engagement.end[last] > math.pi - SAME
        depth = radius[begin] * (1.0 - math.cos(width if is_side else 0.5 * width))
        keep[order[first:n]] = depth >= THIN * cell_size and (is_side or radius[begin] * width >= NARROW * cell_size)
        first = n
    return replace(
        stock_engagement,
        **{name: getattr(stock_engagement, name)[keep] for name in ("point", "low", "high", "start", "end")},
    )


def _sample_arcs(
    segment: ToolSegment, k: int, scene: _Scene, variant: tuple[float, float], stated: StockEngagement
) -> list[tuple[float, float, float, float]]:
    """Return low, high, start and end of the contact, one row for each sample; the spindle turns clockwise."""
    poses, triangles, frame = scene
    moved, lag = variant
    cutter = segment.cell.tool.cutter
    assert cutter is not None
    before = poses.begins[segment.first + k]
    reach = poses.length[before - 1] - lag if before else -math.inf
    counted = slice(0, int(np.searchsorted(poses.length[:before], reach, side="right")))
    path = segment.toolpath
    tip, step = path.position[k], path.position[k] - path.position[max(k - 1, 0)]
    if isinstance(poses, TurningPoses):
        axis = path.axis[k]
        step = step - (step @ axis) * axis
        if np.linalg.norm(step) <= 1e-9:
            return []
        travel = step / np.linalg.norm(step)
        if not lag:  # a rounded end that rises along its axis has left places in the same move
            counted = slice(0, poses.find_end(segment.first + k))
        cut = TurningCut(
            cutter=cutter,
            tip=tip,
            axis=axis,
            travel=travel,
            poses=poses,
            counted=counted,
            triangles=triangles,
        )
        return find_turning_arcs(cut, moved, np.r_[stated.low, stated.high])
    tip, step = tip @ frame.T, step @ frame.T
    rows: list[tuple[float, float, float, float]] = []
    if np.hypot(*step[:2]) > 1e-9:
        travel = step[:2] / np.hypot(*step[:2])
        for low, high, radius in _divide_cutter(cutter):
            rows += _find_arcs(tip, travel, radius + moved, (low, high), poses, counted, triangles)
    return rows


def _divide_cutter(cutter: CutterGeometry) -> list[tuple[float, float, float]]:
    """Return low, high and radius of slices, thin ones in the corner and one above it."""
    R, rc, out = 0.5 * cutter.diameter, cutter.corner, []
    for n in range(CORNER_SLICES if rc > 0 else 0):
        a, b = (0.5 * math.pi * m / CORNER_SLICES for m in (n, n + 1))
        out.append((rc * (1 - math.cos(a)), rc * (1 - math.cos(b)), R - rc + rc * math.sin(0.5 * (a + b))))
    return [*out, (rc, cutter.length, R)]


def _find_arcs(
    tip: Array,
    travel: Array,
    radius: float,
    heights: tuple[float, float],
    poses: _Poses,
    counted: slice,
    triangles: Array,
) -> list[tuple[float, float, float, float]]:
    """Return low, high, start and end of the contact of one slice, one row for each sampled angle."""
    left = np.array([-travel[1], travel[0]])
    turn = math.pi / BINS
    phi = (np.arange(BINS) + 0.5) * turn
    outline = tip[:2] + radius * (np.cos(phi)[:, None] * left + np.sin(phi)[:, None] * travel)
    bottom, top = find_mesh_heights(outline, triangles)
    top = _cut_by_poses(outline, top, poses, counted, (tip[:2], radius))
    out = []
    least = min(TOUCHED, 0.5 * (heights[1] - heights[0]))  # the lowest slices of a corner are thinner
    for m in range(BINS):
        low, high = max(bottom[m] - tip[2], heights[0]), min(top[m] - tip[2], heights[1])
        if high - low > least:
            out.append((low, high, m * turn, (m + 1) * turn))
    return out


def _cut_by_poses(places: Array, top: Array, poses: _Poses, counted: slice, disc: tuple[Array, float]) -> Array:
    """Return the heights that poses leave of material up to ``top`` at places on a disc, (n,)."""
    out = top.copy()
    place, w = poses.place[counted], poses.height[counted]
    R, rc, cone = poses.radius[counted], poses.corner[counted], poses.cone[counted]
    near = np.flatnonzero(np.hypot(*(place - disc[0]).T) < disc[1] + R)
    x, y, least = *place[near].T.copy(), (R[near] - 1e-9) ** 2
    for m, (a, b) in enumerate(places.tolist()):
        square = (x - a) ** 2 + (y - b) ** 2
        inside = np.flatnonzero(square < least)
        if len(inside):
            some, d = near[inside], np.sqrt(square[inside])
            beyond = np.clip(d - R[some] + rc[some], 0.0, rc[some])
            left_over = w[some] + rc[some] - np.sqrt(rc[some] ** 2 - beyond**2) + cone[some] * d
            out[m] = min(out[m], float(left_over.min()))
    return out
