"""Simulated milling forces with true trochoidal chips, independent of machopt: no import of the package.

The tool's centre is offset from the spindle's axis by ρ in a direction that turns with the spindle, and the spindle's
axis moves along x. Every edge element is a point that moves on an exact trochoid. Its chip is the distance, along the
line from the spindle's axis through the element, to the nearest curve that an earlier tooth has left. The time at which
an earlier tooth crossed that line comes from Newton steps. An element cuts where its chip is positive and it is beyond
the flat wall of the pass before.

Axes: x along travel, y left of travel (axis from tip to shank × travel), z from tip to shank; forces on the tool.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

SLICES = 80


@dataclass(frozen=True, kw_only=True)
class SimulatedCut:
    """One cut with a spindle that turns clockwise seen from the shank."""

    teeth: int
    diameter: float  # m
    helix: float  # rad, right-hand positive
    feed_per_tooth: float  # m
    ae: float  # m
    ap: float  # m
    side: str  # up, down, slot
    speed: float  # rev/s, the true one
    offset: float  # rad, rotation of tooth 0 at t = 0
    runout: float  # m
    runout_angle: float  # rad from tooth 0, in the sense of rotation
    coefficients: np.ndarray  # (6,) Ktc, Krc, Kac in N/mm², Kte, Kre, Kae in N/mm


def simulate_forces(cut: SimulatedCut, time: np.ndarray) -> np.ndarray:
    """Return travel, normal and axial force on the tool, (S, 3) N.

    Args:
        cut: conditions.
        time: (S,) s.
    """
    R, N = 0.5 * cut.diameter, cut.teeth
    rate, velocity = 2.0 * math.pi * cut.speed, cut.feed_per_tooth * N * cut.speed
    z = (np.arange(SLICES) + 0.5) * cut.ap / SLICES
    lag = math.tan(cut.helix) / R * z
    Ktc, Krc, Kac = cut.coefficients[:3] * 1e6
    Kte, Kre, Kae = cut.coefficients[3:] * 1e3
    dz = cut.ap / SLICES
    out = np.zeros((len(time), 3))

    def locate(t, tooth):
        """Place of an edge element, (…, 2) m, and its velocity."""
        edge = rate * t + cut.offset + 2.0 * math.pi * tooth / N - lag
        axis = rate * t + cut.offset + cut.runout_angle
        x = velocity * t + cut.runout * np.sin(axis) + R * np.sin(edge)
        y = cut.runout * np.cos(axis) + R * np.cos(edge)
        vx = velocity + rate * (cut.runout * np.cos(axis) + R * np.cos(edge))
        vy = -rate * (cut.runout * np.sin(axis) + R * np.sin(edge))
        return x, y, vx, vy

    t = time[:, None]
    for tooth in range(N):
        x, y, _, _ = locate(t, tooth)
        rx, ry = x - velocity * t, y
        r = np.hypot(rx, ry)
        ux, uy = rx / r, ry / r  # sin ψ, cos ψ
        chip = np.full(r.shape, np.inf)
        for m in range(1, 2 * N + 1):
            before = t - m / (N * cut.speed) + 0.0 * r
            for _ in range(4):
                px, py, vx, vy = locate(before, tooth + m)
                off = (px - velocity * t) * uy - py * ux
                before = before - off / (vx * uy - vy * ux)
            px, py, _, _ = locate(before, tooth + m)
            chip = np.minimum(chip, r - ((px - velocity * t) * ux + py * uy))
        cuts = (chip > 0.0) & (ux > -0.5)
        if cut.side == "up":
            cuts &= y > R - cut.ae
        elif cut.side == "down":
            cuts &= y < -(R - cut.ae)
        h = np.where(cuts, chip, 0.0)
        tangential = (Ktc * h + Kte * cuts) * dz
        radial = (Krc * h + Kre * cuts) * dz
        axial = (Kac * h + Kae * cuts) * dz
        out[:, 0] += np.sum(-tangential * uy - radial * ux, axis=1)
        out[:, 1] += np.sum(tangential * ux - radial * uy, axis=1)
        out[:, 2] -= math.copysign(1.0, cut.helix) * np.sum(axial, axis=1)
    return out
