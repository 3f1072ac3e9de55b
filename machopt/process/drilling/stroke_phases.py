"""Thrust and torque along the depth of a stroke: entry, full diameter, change of layer, exit.

At the tip depth z the lips at the radius ρ are at the depth z − (ρ − d/2) / tan κ, and cut what lies there. The thrust
of the lips is spread evenly over the radius and the torque in proportion to the radius, so that each layer counts with
its share of the ring's width, and of its area. The chisel edge cuts the layer at the tip. Entry, change of layer and
exit then are ramps over the point length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array
from machopt.process.drilling.drilling_tools import DrillingTool, MaterialLayer
from machopt.process.drilling.thrust_and_torque import (
    DrillingLoad,
    FeedPowerLaw,
    build_feed_power_law,
    check_feed_per_revolution,
)

StrokePhase = Literal["outside", "entry", "full", "layer change", "exit"]


@dataclass(frozen=True)
class DrillingStroke:
    """A tool and the layers below the first surface, from the top, with the load of each."""

    tool: DrillingTool
    boundaries: tuple[float, ...]  # m, depths of the layers' surfaces: 0, end of the first layer, …
    laws: tuple[FeedPowerLaw, ...]  # one a layer

    @property
    def through_depth(self) -> float:
        """Depth of the tip at which the lips have left the last layer, m; inf: the hole ends in it."""
        return self.boundaries[-1] + self.tool.point_length


def build_drilling_stroke(tool: DrillingTool, layers: tuple[MaterialLayer, ...]) -> DrillingStroke:
    """Return the stroke of a tool through a stack.

    Args:
        tool: drill, countersink or reamer.
        layers: from the first surface on; the last may be infinitely thick.

    Raises:
        CuttingInputError: no layer, a thickness that is not positive, or impossible coefficients or tool.
    """
    if not layers:
        raise CuttingInputError("a stroke needs one layer or more", key="layers")
    depth, boundaries = 0.0, [0.0]
    for n, layer in enumerate(layers, 1):
        if not layer.thickness > 0.0 or (math.isinf(layer.thickness) and n < len(layers)):
            raise CuttingInputError(
                f"layer {n} has a thickness of {layer.thickness * 1e3:g} mm; a finite value above 0 is expected",
                key="thickness_mm",
            )
        depth += layer.thickness
        boundaries.append(depth)
    return DrillingStroke(
        tool, tuple(boundaries), tuple(build_feed_power_law(layer.coefficients, tool) for layer in layers)
    )


def get_stroke_phase(stroke: DrillingStroke, depth: float) -> StrokePhase:
    """Return the phase at a depth of the tip.

    Args:
        stroke: tool and layers.
        depth: m, tip below the first surface (for a tool with an inner diameter: its first point of contact).
    """
    length = stroke.tool.point_length
    if depth <= 0.0 or depth >= stroke.boundaries[-1] + length:
        return "outside"
    if depth > stroke.boundaries[-1]:
        return "exit"
    if depth < length:
        return "entry"
    inner = stroke.boundaries[1:-1]
    return "layer change" if any(b < depth < b + length for b in inner) else "full"


def compute_load_at_depth(stroke: DrillingStroke, depth: Array | float, feed: Array | float) -> DrillingLoad:
    """Return thrust and torque at depths of the tip.

    Args:
        stroke: tool and layers.
        depth: (P,) or one value, m, tip below the first surface.
        feed: (P,) or one value, m per revolution.

    Raises:
        CuttingInputError: a feed that is not positive.
    """
    z, f = (np.atleast_1d(x) for x in np.broadcast_arrays(np.asarray(depth, float), np.asarray(feed, float)))
    check_feed_per_revolution(f)
    thrust, torque = np.zeros(len(z)), np.zeros(len(z))
    for n, law in enumerate(stroke.laws):
        width, area, tip = _compute_shares(stroke, n, z)
        power = f**law.exponent
        thrust += law.lips * power * width + law.chisel * f * tip
        torque += law.torque_factor * power * area
    return DrillingLoad(thrust, torque)


def compute_stroke_maximum(
    stroke: DrillingStroke, feed: Array | float, last_depth: float = math.inf, first_depth: float = 0.0
) -> DrillingLoad:
    """Return the largest thrust and the largest torque of a stroke, each wherever it occurs.

    Thrust is piecewise linear and torque piecewise quadratic in the depth; both are evaluated at the ends and at the
    vertex of every piece.

    Args:
        stroke: tool and layers.
        feed: (P,) or one value, m per revolution.
        last_depth: m, deepest position of the tip; inf: through all layers.
        first_depth: m, where the stroke starts (the depth of the peck before, say).

    Raises:
        CuttingInputError: a feed that is not positive, or no stroke.
    """
    f = np.atleast_1d(np.asarray(feed, float))
    check_feed_per_revolution(f)
    ends = list_stroke_depths(stroke, last_depth, first_depth)
    loads = [compute_load_at_depth(stroke, z, f) for z in ends]
    torque = np.array([load.torque for load in loads])
    for a, b, low, high in zip(ends[:-1], ends[1:], torque[:-1], torque[1:], strict=True):
        middle = compute_load_at_depth(stroke, 0.5 * (a + b), f).torque
        bend = low - 2.0 * middle + high  # half the second difference
        safe = np.where(bend < 0.0, bend, -1.0)
        at = 0.5 - 0.25 * (high - low) / safe  # vertex as a share of the piece
        inside = (bend < 0.0) & (at > 0.0) & (at < 1.0)
        peak = low + at * (-3.0 * low + 4.0 * middle - high) + 2.0 * at**2 * bend
        torque = np.vstack([torque, np.where(inside, peak, -np.inf)])
    return DrillingLoad(np.max([load.thrust for load in loads], axis=0), torque.max(axis=0))


def list_stroke_depths(stroke: DrillingStroke, last_depth: float = math.inf, first_depth: float = 0.0) -> list[float]:
    """Return the depths between which thrust is linear; at a boundary just before and just after it, m.

    Args:
        stroke: tool and layers.
        last_depth: m, deepest position of the tip.
        first_depth: m, where the stroke starts.

    Raises:
        CuttingInputError: no stroke between the depths.
    """
    length = stroke.tool.point_length
    through = stroke.through_depth
    if math.isinf(through):  # the load is constant once the lips are in the last layer
        through = max(stroke.boundaries[-2], first_depth) + length
    last = min(last_depth, through)
    if not last > first_depth:
        raise CuttingInputError(
            f"a stroke from {first_depth * 1e3:g} to {last_depth * 1e3:g} mm cuts nothing", key="depth_mm"
        )
    step = 1e-9 * max(length, 1e-6)  # the chisel edge enters and leaves a layer at once
    bends = [b + d for b in stroke.boundaries for d in (-step, step, length) if math.isfinite(b)]
    return sorted({first_depth, last, *(z for z in bends if first_depth < z < last)})


def _compute_shares(stroke: DrillingStroke, layer: int, z: Array) -> tuple[Array, Array, Array]:
    """Return the shares of the lips' width and area in a layer, and whether the tip is in it, (P,)."""
    tool = stroke.tool
    inner, outer = 0.5 * tool.inner_diameter, 0.5 * tool.diameter
    top, bottom = stroke.boundaries[layer], stroke.boundaries[layer + 1]
    slope = math.tan(tool.half_point_angle) if tool.half_point_angle < math.pi / 2 - 1e-9 else 1e9
    low = np.clip(inner + (z - bottom) * slope if math.isfinite(bottom) else inner, inner, outer)
    high = np.clip(inner + (z - top) * slope, inner, outer)
    width = (high - low) / (outer - inner)
    area = (high**2 - low**2) / (outer**2 - inner**2)
    return width, area, ((z > top) & (z <= bottom)).astype(float)
