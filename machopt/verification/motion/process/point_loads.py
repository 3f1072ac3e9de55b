"""Load of each toolpath point, recomputed from process.yaml, the cutter and a feed for each move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.process.contact_load import compute_contact_load, find_contact_sides
from machopt.verification.motion.process.drill_load import (
    LipEngagement,
    compute_drill_load,
    compute_through_depth,
    measure_engagement,
)
from machopt.verification.motion.process.hole_strokes import HoleVisit, list_holes
from machopt.verification.motion.process.mill_load import compute_mill_load

SAME_DEPTH = 12  # decimals of a depth in m
_OTHER_SIDE: dict[str, Literal["up", "down", "slot"]] = {"up": "down", "down": "up", "slot": "slot"}


@dataclass(frozen=True, kw_only=True)
class RecomputedLoads:
    """Loads of N points; NaN where no operation of process.yaml holds."""

    force: Array  # (N, 3) N on the tool along travel, normal, axis
    moment: Array  # (N,) N·m
    arm_force: Array  # (N, 3) N on the arm
    operation: np.ndarray  # (N,) operation of process.yaml, −1 for none
    side: np.ndarray  # (N,) 1 up, −1 down, 0 else
    bite: Array  # (N,) m, feed per tooth of milling; NaN elsewhere
    speed: Array  # (N,) rev/s, NaN where none is stated
    contact_sigma: Array  # (N,) 1 sigma of the logarithm of a milling force from the cells of the stock
    is_unknown: np.ndarray  # (N,) the end of a milling cutter cuts: forces count its side alone
    holes: tuple[HoleVisit, ...]


def find_operations(process: CuttingProcess, toolpath: Toolpath) -> np.ndarray:
    """Return (N,) the operation of process.yaml of each point, −1 for none.

    Args:
        process: Content of process.yaml.
        toolpath: The whole toolpath.
    """
    out = np.full(len(toolpath), -1)
    for point in range(len(toolpath)):
        label = toolpath.operations[toolpath.operation[point]].label
        for k, one in enumerate(process.operations):
            first, last = one.points or (0, len(toolpath))
            if one.label == label and label != "default" and first <= point <= last:
                out[point] = k
        if out[point] < 0:
            out[point] = next((k for k, one in enumerate(process.operations) if one.label == "default"), -1)
    return out


def recompute_loads(cell: Cell, toolpath: Toolpath, feed: Array, operation: np.ndarray) -> RecomputedLoads:
    """Return the loads of a toolpath of one tool.

    Args:
        cell: The cell with the tool and the process.
        toolpath: The toolpath.
        feed: (N,) m/s of the move that ends at each point.
        operation: (N,) operation of process.yaml of each point.
    """
    process = cell.process
    assert process is not None
    n = len(toolpath)
    force = np.where((operation < 0)[:, None], np.nan, np.zeros((n, 3)))
    moment = np.where(operation < 0, np.nan, np.zeros(n))
    clamp, side, bite, sigma = np.zeros(n), np.zeros(n, int), np.full(n, np.nan), np.zeros(n)
    speed = _find_speeds(process, toolpath, operation)
    holes = list_holes(process, toolpath, operation)
    engaged: dict[tuple[int, float, float], LipEngagement] = {}  # of equal strokes
    for hole in holes:
        one = process.operations[hole.operation]
        through = compute_through_depth(one, cell.tool.cutter)
        for stroke in hole.strokes:
            p = stroke.point
            if one.force is not None:
                force[p] = _mean_wear(one) * np.array([one.force.travel, one.force.normal, one.force.axial])
                clamp[p] = one.clamp
                continue
            assert cell.tool.cutter is not None
            if stroke.start >= through:  # below the stack
                continue
            key = hole.operation, round(stroke.start, SAME_DEPTH), round(stroke.end, SAME_DEPTH)
            if key not in engaged:
                engaged[key] = measure_engagement(one, cell.tool.cutter, stroke.start, stroke.end)
            load = compute_drill_load(process, one, cell.tool.cutter, feed[p] / speed[p], engaged[key])
            force[p, 2], moment[p] = (_mean_wear(one) * value for value in load)
            moment[p] *= 1.0 if one.spindle == "cw" else -1.0
            clamp[p] = one.clamp
    for k, one in enumerate(process.operations):
        points = np.flatnonzero((operation == k) & (toolpath.move == MoveKind.CUT))
        if one.force is not None and not one.is_hole:
            force[points] = _mean_wear(one) * np.array([one.force.travel, one.force.normal, one.force.axial])
            clamp[points] = one.clamp
        elif one.takes_stock:
            side[points], sigma[points] = _add_stock_milling(cell, one, toolpath, points, feed / speed, force, moment)
            assert cell.tool.cutter is not None
            bite[points] = (feed / speed)[points] / (cell.tool.cutter.teeth or 1)
        elif one.kind == "milling":
            side[points] = _add_milling(cell, one, toolpath, points, feed / speed, force, moment)
            assert cell.tool.cutter is not None
            bite[points] = (feed / speed)[points] / (cell.tool.cutter.teeth or 1)
    arm = force.copy()
    pressed = clamp > 0
    arm[pressed, 2] = np.maximum(arm[pressed, 2], clamp[pressed])
    return RecomputedLoads(
        force=force,
        moment=moment,
        arm_force=arm,
        operation=operation,
        side=side,
        bite=bite,
        speed=speed,
        contact_sigma=sigma,
        is_unknown=np.zeros(n, bool) if toolpath.engagement is None else toolpath.engagement.is_end_cut,
        holes=tuple(holes),
    )


def _add_milling(
    cell: Cell,
    one: ProcessOperation,
    toolpath: Toolpath,
    points: np.ndarray,
    per_turn: Array,
    force: Array,
    moment: Array,
) -> np.ndarray:
    """Write the loads of milled points; returns 1 for up, −1 for down, 0 for a slot."""
    cutter, process = cell.tool.cutter, cell.process
    assert cutter is not None
    assert process is not None
    coefficients = process.materials[one.material].milling
    assert coefficients is not None
    assert one.cut is not None
    assert one.ap is not None
    assert cutter.teeth is not None
    signs = np.zeros(len(points), int)
    turned = _find_turned(one, toolpath, points)
    for flag in (False, True):
        mine = turned == flag
        if not mine.any():
            continue
        cut = _OTHER_SIDE[one.cut] if flag else one.cut
        ae = cutter.diameter if one.ae is None else one.ae
        edge, slope = compute_mill_load(coefficients, cutter, cut, one.spindle, (ae, one.ap))
        rows = points[mine]
        load = _mean_wear(one) * (edge + slope * (per_turn[rows] / cutter.teeth)[:, None])
        force[rows], moment[rows] = load[:, :3], load[:, 3]
        signs[mine] = {"up": 1, "down": -1, "slot": 0}[cut]
    return signs


def _add_stock_milling(
    cell: Cell,
    one: ProcessOperation,
    toolpath: Toolpath,
    points: np.ndarray,
    per_turn: Array,
    force: Array,
    moment: Array,
) -> tuple[np.ndarray, Array]:
    """Write the loads of points with stated arcs of contact; returns the sides, and the spread by the stock's cells."""
    cutter, process, arcs = cell.tool.cutter, cell.process, toolpath.engagement
    assert cutter is not None
    assert cutter.teeth is not None
    assert process is not None
    assert arcs is not None
    coefficients = process.materials[one.material].milling
    assert coefficients is not None
    edge, slope = compute_contact_load(coefficients, cutter, one.spindle, arcs)
    load = _mean_wear(one) * (edge[points] + slope[points] * (per_turn[points] / cutter.teeth)[:, None])
    force[points], moment[points] = load[:, :3], load[:, 3]
    side, sigma = find_contact_sides(cutter, arcs)
    return side[points], sigma[points]


def _find_turned(one: ProcessOperation, toolpath: Toolpath, points: np.ndarray) -> np.ndarray:
    """Return whether each move runs against the first one; a step to the next pass counts like that pass."""
    turned = np.zeros(len(points), bool)
    if not one.is_alternating:
        return turned
    steps = [toolpath.position[p] - toolpath.position[max(p - 1, 0)] for p in points]
    units = [s / np.linalg.norm(s) if np.linalg.norm(s) > 0 else np.zeros(3) for s in steps]
    first = next((u for u in units if u.any()), None)
    if first is None:
        return turned
    cosines = [float(u @ first) for u in units]
    last = False
    for n in range(len(points) - 1, -1, -1):
        if abs(cosines[n]) >= 0.5:
            last = cosines[n] < 0
        turned[n] = last
    ahead = [n for n in range(len(points)) if abs(cosines[n]) >= 0.5]
    if ahead:
        turned[ahead[-1] + 1 :] = cosines[ahead[-1]] < 0
    return turned


def _find_speeds(process: CuttingProcess, toolpath: Toolpath, operation: np.ndarray) -> Array:
    out = np.full(len(toolpath), np.nan)
    for event in sorted((e for e in toolpath.events if e.kind == "spindle"), key=lambda e: e.index):
        out[event.index :] = event.value / 60.0 if event.value > 0 else np.nan
    for point, k in enumerate(operation):
        if k >= 0 and process.operations[k].spindle_speed is not None:
            out[point] = process.operations[k].spindle_speed
    return out


def _mean_wear(one: ProcessOperation) -> float:
    return 0.5 * (one.wear[0] + one.wear[1])
