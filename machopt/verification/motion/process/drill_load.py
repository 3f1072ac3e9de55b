"""Thrust and torque of a drill over a stroke, summed over thin rings of its lips at many depths."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess, ProcessOperation

RINGS, DEPTHS = 400, 400


def compute_drill_load(
    process: CuttingProcess, one: ProcessOperation, cutter: CutterGeometry, feed: float, start: float, end: float
) -> tuple[float, float]:
    """Return the largest thrust in N and the largest torque in N·m of a stroke, without wear.

    Args:
        process: Content of process.yaml.
        one: The operation.
        cutter: The cutter of the tool.
        feed: m per revolution.
        start: m below the surface, where the stroke begins.
        end: m, where it ends.
    """
    inner, outer, kappa, lips = _get_lips(one, cutter)
    edges = np.linspace(inner, outer, RINGS + 1)
    radius = 0.5 * (edges[1:] + edges[:-1])
    width = np.diff(edges)
    area = math.pi * (edges[1:] ** 2 - edges[:-1] ** 2)
    lag = (radius - inner) / math.tan(kappa) if kappa < math.pi / 2 - 1e-9 else np.zeros(RINGS)
    point = (outer - inner) / math.tan(kappa) if kappa < math.pi / 2 - 1e-9 else 0.0
    tops = np.cumsum([0.0, *(layer.thickness for layer in one.layers)])
    last = min(end, tops[-1] + point)
    depths = np.linspace(start, last, DEPTHS)
    bends = [t + d for t in tops if math.isfinite(t) for d in (0.0, 1e-9, point)]
    depths = np.unique([*depths, *(b for b in bends if start < b < last)])
    thrust, torque = np.zeros(len(depths)), np.zeros(len(depths))
    for n, layer in enumerate(one.layers):
        c = process.materials[layer.material].drilling
        assert c is not None
        chip = feed / lips * math.sin(kappa) * 1e3  # mm
        pressure = c.kc1_Pa * chip**-c.mc * (1.0 - one.rake / 100.0)
        at = depths[:, None] - lag
        inside = (at > tops[n]) & (at <= tops[n + 1])
        thrust += 0.5 * pressure * feed * math.sin(kappa) * (inside @ width)
        torque += pressure * feed / (2.0 * math.pi) * (inside @ area)
        if inner == 0.0 and c.chisel_Pa and cutter.web and one.kind == "drilling":
            thrust += np.where((depths > tops[n]) & (depths <= tops[n + 1]), c.chisel_Pa * cutter.web * feed, 0.0)
    return float(thrust.max()), float(torque.max())


def compute_through_depth(one: ProcessOperation, cutter: CutterGeometry | None) -> float:
    """Return the depth of the tip at which the tool has left the stack, m.

    Args:
        one: The operation.
        cutter: The cutter of the tool; None for a given force.
    """
    if one.kind == "force" or cutter is None:
        return math.inf
    inner, outer, kappa, _ = _get_lips(one, cutter)
    point = (outer - inner) / math.tan(kappa) if kappa < math.pi / 2 - 1e-9 else 0.0
    return sum(layer.thickness for layer in one.layers) + point


def _get_lips(one: ProcessOperation, cutter: CutterGeometry) -> tuple[float, float, float, int]:
    """Return inner and outer radius in m, half the point angle in rad, and the number of lips."""
    if one.kind == "countersinking":
        assert one.countersink is not None
        assert one.countersink_angle is not None
        return (
            0.5 * (one.pilot or cutter.diameter),
            0.5 * one.countersink,
            0.5 * one.countersink_angle,
            cutter.teeth or 3,
        )
    if one.kind == "reaming":
        assert one.reaming_stock is not None
        return 0.5 * (cutter.diameter - one.reaming_stock), 0.5 * cutter.diameter, math.pi / 4, cutter.teeth or 6
    assert cutter.point_angle is not None
    return 0.5 * one.pilot, 0.5 * cutter.diameter, 0.5 * cutter.point_angle, cutter.teeth or 2
