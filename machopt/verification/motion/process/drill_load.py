"""Thrust and torque of a drill over a stroke, summed over thin rings of its lips at many depths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.numerics.array_types import Array

RINGS, DEPTHS = 400, 400


@dataclass(frozen=True)
class LipEngagement:
    """Parts of the lips in each of L layers at D depths of a stroke."""

    width: Array  # (L, D) m
    area: Array  # (L, D) m²
    tip: Array  # (L, D) 1 where the tip is in the layer
    kappa: float  # rad, half the point angle
    lips: int


def measure_engagement(one: ProcessOperation, cutter: CutterGeometry, start: float, end: float) -> LipEngagement:
    """Return how much of the lips cuts during a stroke, whatever the feed.

    Args:
        one: The operation.
        cutter: The cutter of the tool.
        start: m below the surface, where the stroke begins.
        end: m, where it ends.
    """
    inner, outer, kappa, lips = _get_lips(one, cutter)
    edges = np.linspace(inner, outer, RINGS + 1)
    slope = math.tan(kappa) if kappa < math.pi / 2 - 1e-9 else math.inf
    point = (outer - inner) / math.tan(kappa) if kappa < math.pi / 2 - 1e-9 else 0.0
    tops = np.cumsum([0.0, *(layer.thickness for layer in one.layers)])
    last = min(end, tops[-1] + point)
    depths = np.linspace(start, last, DEPTHS)
    bends = [t + d for t in tops if math.isfinite(t) for d in (0.0, 1e-9, point)]
    depths = np.unique([*depths, *(b for b in bends if start < b < last)])
    parts = [_cut_rings(edges, inner, slope, depths, (tops[n], tops[n + 1])) for n in range(len(one.layers))]
    tip = [(depths > tops[n]) & (depths <= tops[n + 1]) for n in range(len(one.layers))]
    return LipEngagement(
        width=np.array([np.sum(b - a, axis=1) for a, b in parts]),
        area=np.array([math.pi * np.sum(b**2 - a**2, axis=1) for a, b in parts]),
        tip=np.array(tip, float),
        kappa=kappa,
        lips=lips,
    )


def _cut_rings(
    edges: Array, inner: float, slope: float, depths: Array, layer: tuple[float, float]
) -> tuple[Array, Array]:
    """Return (D, RINGS) inner and outer radius in m of the part of each ring that is in a layer.

    A lip at radius r lies (r − inner) / slope above the tip: a ring may be in the layer with a part of its width.
    """
    top, bottom = layer
    if math.isinf(slope):
        is_in = ((depths > top) & (depths <= bottom))[:, None]
        return np.where(is_in, edges[:-1], 0.0), np.where(is_in, edges[1:], 0.0)
    low = (inner + (depths - bottom) * slope)[:, None]
    high = (inner + (depths - top) * slope)[:, None]
    a = np.clip(edges[:-1], low, high)
    return a, np.maximum(np.clip(edges[1:], low, high), a)


def compute_drill_load(
    process: CuttingProcess, one: ProcessOperation, cutter: CutterGeometry, feed: float, engaged: LipEngagement
) -> tuple[float, float]:
    """Return the largest thrust in N and the largest torque in N·m of a stroke, without wear.

    Args:
        process: Content of process.yaml.
        one: The operation.
        cutter: The cutter of the tool.
        feed: m per revolution.
        engaged: What of the lips cuts.
    """
    thrust, torque = np.zeros(engaged.width.shape[1]), np.zeros(engaged.width.shape[1])
    for n, layer in enumerate(one.layers):
        c = process.materials[layer.material].drilling
        assert c is not None
        chip = feed / engaged.lips * math.sin(engaged.kappa) * 1e3  # mm
        pressure = c.kc1_Pa * chip**-c.mc * (1.0 - one.rake / 100.0)
        thrust += 0.5 * pressure * feed * math.sin(engaged.kappa) * engaged.width[n]
        torque += pressure * feed / (2.0 * math.pi) * engaged.area[n]
        if _get_lips(one, cutter)[0] == 0.0 and c.chisel_Pa and cutter.web and one.kind == "drilling":
            thrust += c.chisel_Pa * cutter.web * feed * engaged.tip[n]
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
