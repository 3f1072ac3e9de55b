"""Load of a cutter by the arcs of engagement.csv, by Gauss quadrature over each arc."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.process import SpindleDirection
from machopt.data_types.stock import StockEngagement
from machopt.numerics.array_types import Array

NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)  # sines of twice the angle over a full turn to 1e-15
BLOCK = 2048  # arcs at a time
HEIGHTS, WALL_SLICES = 33, 800


def find_slice_shapes(cutter: CutterGeometry, arcs: StockEngagement) -> tuple[Array, Array, Array]:
    """Return radius, κ and length of the cutting edge of the slice of each arc, (M,) each.

    Args:
        cutter: The cutter.
        arcs: The arcs.
    """
    R, rc = 0.5 * cutter.diameter, cutter.corner
    radius, kappa, edge = (np.empty(len(arcs.low)) for _ in range(3))
    for n, (low, high) in enumerate(zip(arcs.low.tolist(), arcs.high.tolist(), strict=True)):
        radius[n], kappa[n], edge[n] = R, 0.5 * math.pi, high - low
        if rc > 0 and low < rc - 1e-9:
            first, last = (math.acos(max(1.0 - h / rc, -1.0)) for h in (low, min(high, rc)))
            kappa[n] = 0.5 * (first + last)
            radius[n], edge[n] = R - rc + rc * math.sin(kappa[n]), rc * (last - first)
    return radius, kappa, edge


def compute_contact_load(
    coefficients: MillingCoefficients, cutter: CutterGeometry, spindle: SpindleDirection, arcs: StockEngagement
) -> tuple[Array, Array]:
    """Return the load for a feed per tooth of zero, and its change per m of it: (N, 4) travel, normal, axial, torque.

    Args:
        coefficients: Milling coefficients.
        cutter: The cutter.
        spindle: Direction of the spindle.
        arcs: Contact of N points.
    """
    assert cutter.teeth is not None
    mirror = 1.0 if spindle == "cw" else -1.0
    hand = mirror * math.copysign(1.0, cutter.helix) if cutter.helix else 0.0
    radius, kappa, length = find_slice_shapes(cutter, arcs)
    edge, slope = np.zeros((len(arcs.volume), 4)), np.zeros((len(arcs.volume), 4))
    c = coefficients
    for first in range(0, len(arcs.point), BLOCK):
        rows = slice(first, first + BLOCK)
        width = (arcs.end - arcs.start)[rows, None]
        phi = arcs.start[rows, None] + 0.5 * (NODES + 1.0) * width
        weight = 0.5 * width[:, 0] * cutter.teeth / (2.0 * math.pi)
        sk, ck, r = np.sin(kappa[rows]), np.cos(kappa[rows]), radius[rows]
        s, k = np.sin(phi), np.cos(phi)
        dz = (arcs.high - arcs.low)[rows, None] * s
        for target, (Ft, Fr, Fa) in (
            (edge, (length[rows, None] * np.ones_like(phi) * K for K in (c.Kte_N_m, c.Kre_N_m, c.Kae_N_m))),
            (slope, (dz * K for K in (c.Ktc_Pa, c.Krc_Pa, c.Kac_Pa))),
        ):
            radial = Fr * sk[:, None] + hand * Fa * ck[:, None]
            part = np.column_stack(
                [
                    (-Ft * k - radial * s) @ WEIGHTS,
                    mirror * ((Ft * s - radial * k) @ WEIGHTS),
                    (Fr * ck[:, None] - hand * Fa * sk[:, None]) @ WEIGHTS,
                    mirror * (Ft @ WEIGHTS) * r,
                ]
            )
            np.add.at(target, arcs.point[rows], weight[:, None] * part)
    return edge, slope


def find_contact_sides(cutter: CutterGeometry, arcs: StockEngagement) -> tuple[np.ndarray, Array]:
    """Return (N,) 1 for up, −1 for down, 0 for full width or none, and (N,) 1 sigma of the logarithm of the force.

    Args:
        cutter: The cutter.
        arcs: Contact of N points.
    """
    radius = find_slice_shapes(cutter, arcs)[0]
    side, sigma = np.zeros(len(arcs.volume), int), np.zeros(len(arcs.volume))
    for p in np.unique(arcs.point).tolist():
        mine = arcs.point == p if len(arcs.point) < BLOCK else slice(*np.searchsorted(arcs.point, (p, p + 1)))
        start, end = arcs.start[mine], arcs.end[mine]
        width = float(np.max(radius[mine] * np.cos(start)) - np.min(radius[mine] * np.cos(end)))
        if width >= cutter.diameter - 2.0 * arcs.edge_sigma:
            continue
        area = (arcs.high - arcs.low)[mine] * (end - start)
        side[p] = 1 if np.sum(area * (start + end)) < math.pi * np.sum(area) else -1
        sigma[p] = min(arcs.edge_sigma / width, 1.0) if width > 0 else 0.0
    return side, sigma


def compute_contact_wall_force(
    coefficients: MillingCoefficients,
    cutter: CutterGeometry,
    side: int,
    spindle: SpindleDirection,
    parts: list[tuple[float, float, float, float]],
) -> tuple[Array, Array]:
    """Return the force along axis × travel while a tooth makes the wall, at ``HEIGHTS`` heights: for a feed per tooth
    of zero, and its change per metre of it. Flat end mills.

    Args:
        coefficients: Milling coefficients.
        cutter: The cutter.
        side: −1 for a wall made at φ = π, else φ = 0.
        spindle: Direction of the spindle.
        parts: low, high m and start, end rad of each arc of one point.
    """
    assert cutter.teeth is not None
    mirror = 1.0 if spindle == "cw" else -1.0
    lag = math.tan(cutter.helix or 0.0) / (0.5 * cutter.diameter) * mirror
    heights = np.linspace(0.0, max(part[1] for part in parts), HEIGHTS)
    begin = math.pi if side < 0 else 0.0
    edge, slope = np.zeros(HEIGHTS), np.zeros(HEIGHTS)
    for low, high, first, last in parts:
        dz = (high - low) / WALL_SLICES
        z = low + (np.arange(WALL_SLICES) + 0.5) * dz
        for tooth in range(cutter.teeth):
            phi = begin + 2.0 * math.pi * tooth / cutter.teeth - lag * (z[None] - heights[:, None])
            phi = np.mod(phi + 1e-12, 2.0 * math.pi) - 1e-12
            cuts = (phi >= first - 1e-9) & (phi <= last + 1e-9)
            s, c = np.sin(phi), np.cos(phi)
            edge += np.where(cuts, coefficients.Kte_N_m * s - coefficients.Kre_N_m * c, 0.0).sum(axis=1) * dz
            slope += np.where(cuts, (coefficients.Ktc_Pa * s - coefficients.Krc_Pa * c) * s, 0.0).sum(axis=1) * dz
    return mirror * edge, mirror * slope
