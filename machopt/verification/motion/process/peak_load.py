"""Largest force of an end mill across its axis over one revolution: a sum over teeth, heights and rotations.

The edge of tooth j at the height z is at ψ = φ + 2π j/N − k z, k = tan β / R. With run-out its radius differs by
r_j(z) = ρ cos(k z − 2π j/N), and the chip is min over m = 1 … N of m c sin ψ + r_j − r_{j+m}; it cuts where that is
above 0.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell, CutterGeometry
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.process import CutSide, ProcessOperation, SpindleDirection
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.process.contact_load import find_slice_shapes
from machopt.verification.motion.process.point_loads import RecomputedLoads

ROTATIONS, LAYERS = 720, 160  # of a revolution; of a slice of the cutter
CORNER_SLICES = 60
FEEDS = 3  # of an operation; linear between them
STOCK_POINTS = 24  # whose contact comes from the stock, and which are recomputed
GIVEN_SHARE, STOCK_SHARE, PEAK_N = 0.01, 0.06, 0.5  # layers of finite height; contacts that the plan takes for equal
_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


@dataclass(frozen=True, kw_only=True)
class EdgeSlice:
    """Part of the cutter between two heights with one arc of contact."""

    low: float  # m
    high: float
    radius: float
    kappa: float  # rad
    start: float  # rad
    end: float


def compute_peak_force(
    coefficients: MillingCoefficients,
    cutter: CutterGeometry,
    spindle: SpindleDirection,
    slices: list[EdgeSlice],
    feed: float,
) -> float:
    """Return the largest resultant of travel and normal force over a revolution, N.

    Args:
        coefficients: Milling coefficients.
        cutter: The cutter.
        spindle: Direction of the spindle.
        slices: Parts of the cutter.
        feed: m per tooth.
    """
    assert cutter.teeth is not None
    N, c, mirror = cutter.teeth, coefficients, 1.0 if spindle == "cw" else -1.0
    lag = math.tan(cutter.helix or 0.0) / (0.5 * cutter.diameter) * mirror
    hand = mirror * math.copysign(1.0, cutter.helix) if cutter.helix else 0.0
    count = ROTATIONS if cutter.runout else math.ceil(ROTATIONS / N)  # without run-out a tooth is like the next one
    phi = 2.0 * math.pi * np.arange(count) / ROTATIONS
    total = np.zeros((count, 2))
    for part in slices:
        layers = LAYERS if lag and part.kappa > 1.5 else max(LAYERS // CORNER_SLICES, 1)
        dz = (part.high - part.low) / layers
        z = part.low + (np.arange(layers) + 0.5) * dz
        sk, ck = math.sin(part.kappa), math.cos(part.kappa)
        for j in range(N):
            psi = np.mod(phi[:, None] + 2.0 * math.pi * j / N - lag * z, 2.0 * math.pi)
            s, k = np.sin(psi), np.cos(psi)
            radius = [cutter.runout * np.cos(lag * z - 2.0 * math.pi * (j + m) / N) for m in range(N + 1)]
            chip = np.min([m * feed * s + radius[0] - radius[m] for m in range(1, N + 1)], axis=0)
            cuts = (psi >= part.start) & (psi < part.end) & (chip > 0.0)
            t, r, a = ((K * chip + E / sk) * cuts for K, E in ((c.Ktc_Pa, c.Kte_N_m), (c.Krc_Pa, c.Kre_N_m),
                                                               (c.Kac_Pa, c.Kae_N_m)))  # fmt: skip
            K_radial = r * sk + hand * a * ck
            total[:, 0] += np.sum(-t * k - K_radial * s, axis=1) * dz
            total[:, 1] += np.sum(t * s - K_radial * k, axis=1) * dz
    return float(np.hypot(*total.T).max())


def recompute_peaks(cell: Cell, toolpath: Toolpath, loads: RecomputedLoads, stated: Array) -> tuple[Array, Array]:
    """Return (N,) N the peak forces, NaN where none follows, and (N,) by how much a stated one may differ.

    Args:
        cell: The cell with the tool of this part of the job.
        toolpath: Its toolpath.
        loads: Its recomputed loads.
        stated: (N,) N, taken over at points whose contact comes from the stock and which are not recomputed.
    """
    wanted, share = np.full(len(toolpath), np.nan), np.full(len(toolpath), GIVEN_SHARE)
    assert cell.process is not None
    for k, one in enumerate(cell.process.operations):
        rows = np.flatnonzero((loads.operation == k) & (toolpath.move == MoveKind.CUT))
        if one.kind != "milling" or not len(rows):
            continue
        if one.takes_stock:
            wanted[rows], share[rows] = _find_stock_peaks(cell, one, toolpath, loads, rows, stated[rows]), STOCK_SHARE
            continue
        for side in np.unique(loads.side[rows]).tolist():
            mine = rows[loads.side[rows] == side]
            wanted[mine] = _find_given_peaks(cell, one, _SIDES[int(side)], loads.bite[mine])
    wanted[loads.is_unknown] = np.nan
    return wanted, PEAK_N + share * np.abs(np.nan_to_num(wanted))


def _find_given_peaks(cell: Cell, one: ProcessOperation, side: CutSide, bite: Array) -> Array:
    cutter, process = cell.tool.cutter, cell.process
    assert cutter is not None
    assert process is not None
    coefficients = process.materials[one.material].milling
    assert coefficients is not None
    assert one.ap is not None
    slices = _cut_into_slices(cutter, cutter.diameter if one.ae is None else one.ae, one.ap, side)
    feeds = np.unique(np.linspace(bite.min(), bite.max(), FEEDS))
    found = [compute_peak_force(coefficients, cutter, one.spindle, slices, float(f)) for f in feeds]
    return 0.5 * (one.wear[0] + one.wear[1]) * np.interp(bite, feeds, found)


def _cut_into_slices(cutter: CutterGeometry, ae: float, ap: float, side: CutSide) -> list[EdgeSlice]:
    """Return the corner in slices of equal angle, and the cylinder above it."""
    R, rc = 0.5 * cutter.diameter, cutter.corner
    heights = []
    if rc > 0:
        last = math.acos(max(1.0 - min(ap, rc) / rc, 0.0))
        turns = np.linspace(0.0, last, CORNER_SLICES + 1)
        for a, b in itertools.pairwise(turns):
            middle = 0.5 * (a + b)
            low, high = (rc * (1.0 - math.cos(v)) for v in (a, b))
            heights.append(
                (low, high, R - rc + rc * math.sin(middle), math.asin(min((high - low) / rc / (b - a), 1.0)))
            )
    if ap > rc:
        heights.append((rc, ap, R, 0.5 * math.pi))
    out = []
    for low, high, r, kappa in heights:
        theta = math.pi if side == "slot" else math.acos(min(max(1.0 - ae / r, -1.0), 1.0))
        start = math.pi - theta if side == "down" else 0.0
        out.append(EdgeSlice(low=low, high=high, radius=r, kappa=kappa, start=start, end=start + theta))
    return out


def _find_stock_peaks(
    cell: Cell, one: ProcessOperation, toolpath: Toolpath, loads: RecomputedLoads, rows: np.ndarray, stated: Array
) -> Array:
    cutter, process, arcs = cell.tool.cutter, cell.process, toolpath.engagement
    assert cutter is not None
    assert process is not None
    assert arcs is not None
    coefficients = process.materials[one.material].milling
    assert coefficients is not None
    out, touched = stated.copy(), np.isin(rows, arcs.point)
    out[~touched] = np.nan
    open_rows = np.flatnonzero(touched & np.isfinite(stated))
    out[touched & ~np.isfinite(stated)] = 0.0  # a peak is missing
    picked = np.unique(np.linspace(0, len(open_rows) - 1, min(len(open_rows), STOCK_POINTS)).round().astype(int))
    for n in open_rows[picked].tolist():
        own = arcs.take_range(int(rows[n]), int(rows[n]) + 1)
        radius, kappa, _ = find_slice_shapes(cutter, own)
        names = ("low", "high", "radius", "kappa", "start", "end")
        columns = np.column_stack([own.low, own.high, radius, kappa, own.start, own.end]).tolist()
        slices = [EdgeSlice(**dict(zip(names, values, strict=True))) for values in columns]
        feed = float(loads.bite[rows[n]])
        wear = 0.5 * (one.wear[0] + one.wear[1])
        out[n] = wear * compute_peak_force(coefficients, cutter, one.spindle, slices, feed)
    return out
