"""Limits of validity of the loads of holes: what in feed, depth or spindle speed is outside of the force models."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from machopt.data_types.process import ProcessOperation
from machopt.numerics.array_types import Array
from machopt.process.binding.holes import DEEPER, DrilledHole
from machopt.process.drilling.stroke_phases import DrillingStroke

PLOUGHING = 5e-6  # m; a thinner chip is ploughed, not cut
RELIEF_ANGLE = math.radians(8.0)  # least lip relief of a twist drill at its periphery


def list_hole_notes(
    one: ProcessOperation, stroke: DrillingStroke, holes: Sequence[DrilledHole], bite: Array
) -> list[str]:
    """Return the limits of validity of the holes of one operation.

    A lip cuts as long as the helix of its feed, f / (π D) at the periphery, is flatter than the relief of the lip:
    beyond it the flank rubs, and no coefficient holds. Such a feed is a wrong spindle speed or a wrong unit.

    Args:
        one: The operation.
        stroke: Its tool and layers.
        holes: Its holes.
        bite: (N,) m, feed per revolution of each toolpath point.
    """
    out: list[str] = []
    rows = np.concatenate([hole.rows[hole.is_cutting] for hole in holes]) if holes else np.zeros(0, int)
    per_turn = bite[rows]
    per_turn = per_turn[np.isfinite(per_turn)]
    if not len(per_turn):
        return out
    shown = f"{1e3 * per_turn.min():.3g} … {1e3 * per_turn.max():.3g} mm per revolution"
    most = math.pi * stroke.tool.diameter * math.tan(RELIEF_ANGLE)
    if per_turn.max() > most:
        out.append(
            f"{one.label}: the feed of {shown} is more than a lip with a relief of 8° can cut ({1e3 * most:.3g} mm): "
            "check spindle_rpm and the feed"
        )
    chip = per_turn.min() / stroke.tool.lips * math.sin(stroke.tool.half_point_angle)
    if chip < PLOUGHING:
        out.append(
            f"{one.label}: the chip of {1e6 * chip:.3g} µm at {shown} is thinner than 5 µm, where the coefficients do "
            "not hold: check spindle_rpm and the feed"
        )
    below = [float(h.start_depth[np.argmax(h.is_cutting)]) for h in holes if h.is_cutting.any()]
    late = [depth for depth in below if depth > DEEPER]
    if late:
        out.append(
            f"{one.label}: the feed of {len(late)} of {len(holes)} holes starts up to {1e3 * max(late):.3g} mm below "
            f"the surface that depth_mm states; the material above it counts as removed"
        )
    return out
