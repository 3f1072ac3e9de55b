"""Mean load of an end mill over one revolution, by quadrature over its height and its rotation."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.process import CutSide, SpindleDirection

SLICES = 1600  # then the load of ball cutters is right to 5e-7: deflections are compared to 5e-6
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)  # sines of twice the angle over half a turn to 1e-15
HEIGHTS, WALL_SLICES = 33, 800


def compute_mill_load(
    coefficients: MillingCoefficients,
    cutter: CutterGeometry,
    side: CutSide,
    spindle: SpindleDirection,
    depths: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the load for a feed per tooth of zero, and its change per metre of it: travel, normal, axial, torque.

    Args:
        coefficients: Milling coefficients.
        cutter: The cutter.
        side: Side of the cut.
        spindle: Direction of the spindle.
        depths: m, radial and axial depth of cut.
    """
    ae, ap = depths
    assert cutter.teeth is not None
    R, rc = 0.5 * cutter.diameter, cutter.corner
    edge, slope = np.zeros(4), np.zeros(4)
    for dz, r, kappa in _cut_into_slices(R, rc, ap, ae):
        reach = 1.0 - ae / r if side != "slot" else -1.0  # material beyond r − ae, after a pass of the same tool
        theta = math.acos(min(max(reach, -1.0), 1.0))
        phi = 0.5 * (NODES + 1.0) * theta + (math.pi - theta if side == "down" else 0.0)
        weight = 0.5 * theta * cutter.teeth / (2.0 * math.pi)
        db = dz / math.sin(kappa)
        hand = math.copysign(1.0, cutter.helix) if cutter.helix else 0.0
        hand *= 1.0 if spindle == "cw" else -1.0
        c = coefficients
        for target, forces in (
            (edge, (c.Kte_N_m * db, c.Kre_N_m * db, c.Kae_N_m * db)),
            (slope, tuple(k * dz * np.sin(phi) for k in (c.Ktc_Pa, c.Krc_Pa, c.Kac_Pa))),
        ):
            Ft, Fr, Fa = (np.broadcast_to(f, phi.shape) for f in forces)
            radial = Fr * math.sin(kappa) + hand * Fa * math.cos(kappa)
            target[0] += weight * float((-Ft * np.cos(phi) - radial * np.sin(phi)) @ WEIGHTS)
            target[1] += weight * float((Ft * np.sin(phi) - radial * np.cos(phi)) @ WEIGHTS)
            target[2] += weight * float((Fr * math.cos(kappa) - hand * Fa * math.sin(kappa)) @ WEIGHTS)
            target[3] += weight * float(Ft @ WEIGHTS) * r
    if spindle == "ccw":
        for load in (edge, slope):
            load[[1, 3]] *= -1.0
    return edge, slope


def _cut_into_slices(R: float, rc: float, ap: float, ae: float) -> list[tuple[float, float, float]]:
    """Return thickness, radius and κ of slices: thin ones in the corner, one above it.

    Slices get thinner towards the radius ae / 2: below it the whole turn cuts, and the arc changes like a root there.
    """
    out = []
    top = min(ap, rc)
    if rc > 0 and top > 0:
        last = math.acos(1.0 - top / rc)
        kink = min(math.asin(min(max((0.5 * ae - R + rc) / rc, 0.0), 1.0)), last)
        for end in (0.0, last):
            for n in range(SLICES if end != kink else 0):
                a, b = (kink + (end - kink) * (s / SLICES) ** 2 for s in (n, n + 1))
                middle = 0.5 * (a + b)
                out.append((rc * abs(math.cos(a) - math.cos(b)), R - rc + rc * math.sin(middle), middle))
    if ap > rc:
        out.append((ap - rc, R, 0.5 * math.pi))
    return out


def compute_wall_force(
    coefficients: MillingCoefficients,
    cutter: CutterGeometry,
    side: CutSide,
    spindle: SpindleDirection,
    depths: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the force along axis × travel while a tooth makes the wall, at ``HEIGHTS`` heights: for a feed per tooth
    of zero, and its change per metre of it. Flat end mills.

    Args:
        coefficients: Milling coefficients.
        cutter: The cutter.
        side: Side of the cut.
        spindle: Direction of the spindle.
        depths: m, radial and axial depth of cut.
    """
    ae, ap = depths
    assert cutter.teeth is not None
    R, mirror = 0.5 * cutter.diameter, 1.0 if spindle == "cw" else -1.0
    theta = math.acos(min(max(1.0 - ae / R, -1.0), 1.0)) if side != "slot" else math.pi
    first, last = (math.pi - theta, math.pi) if side == "down" else (0.0, theta)
    lag = math.tan(cutter.helix or 0.0) / R * mirror
    z = (np.arange(WALL_SLICES) + 0.5) / WALL_SLICES * ap
    heights = np.linspace(0.0, ap, HEIGHTS)
    start = math.pi if side == "down" else 0.0
    edge, slope = np.zeros(HEIGHTS), np.zeros(HEIGHTS)
    for tooth in range(cutter.teeth):
        phi = start + 2.0 * math.pi * tooth / cutter.teeth - lag * (z[None] - heights[:, None])
        phi = np.mod(phi + 1e-12, 2.0 * math.pi) - 1e-12
        cuts = (phi >= first - 1e-9) & (phi <= last + 1e-9)
        s, c = np.sin(phi), np.cos(phi)
        dz = ap / WALL_SLICES
        edge += np.where(cuts, coefficients.Kte_N_m * s - coefficients.Kre_N_m * c, 0.0).sum(axis=1) * dz
        slope += np.where(cuts, (coefficients.Ktc_Pa * s - coefficients.Krc_Pa * c) * s, 0.0).sum(axis=1) * dz
    return mirror * edge, mirror * slope
