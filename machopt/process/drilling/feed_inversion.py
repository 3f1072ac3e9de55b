"""Largest feed for which a thrust is not exceeded."""

from __future__ import annotations

import math

import numpy as np

from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array, Bools
from machopt.process.drilling.stroke_phases import DrillingStroke, compute_load_at_depth, list_stroke_depths

_STEPS = 200  # of a bisection of the logarithm; it ends earlier, at rounding
_SMALLEST, _LARGEST = 1e-12, 1.0  # m per revolution


def find_largest_feed(
    stroke: DrillingStroke, thrust: Array | float, last_depth: float = math.inf, factor: float = 1.0
) -> Array:
    """Return the largest feed for which the thrust of a whole stroke stays within a limit, (P,) m per revolution.

    The thrust of the lips grows with f^(1−mc) and that of the chisel edge with f, so that the largest thrust over the
    depth grows with the feed: its inverse is found by bisection of ln f, to rounding.

    Args:
        stroke: tool and layers.
        thrust: (P,) or one value, N, limit of the thrust.
        last_depth: m, deepest position of the tip.
        factor: factor on the thrust (wear, spread), > 0.

    Returns:
        0 where the limit is 0 or less; inf where no feed up to 1 m per revolution reaches it.

    Raises:
        CuttingInputError: a factor that is not positive, or a stroke that cuts nothing.
    """
    if not (math.isfinite(factor) and factor > 0.0):
        raise CuttingInputError(f"factor {factor:g} on the thrust; more than 0 is expected", key="wear")
    limit = np.atleast_1d(np.asarray(thrust, float)) / factor
    depths = list_stroke_depths(stroke, last_depth)

    def exceeds(log_feed: Array) -> Bools:
        feed = np.exp(log_feed)
        return np.asarray(np.max([compute_load_at_depth(stroke, z, feed).thrust for z in depths], axis=0) > limit)

    low, high = (np.full(len(limit), math.log(f)) for f in (_SMALLEST, _LARGEST))
    never = ~exceeds(high)
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if np.all((middle <= low) | (middle >= high)):
            break
        over = exceeds(middle)
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return np.where(limit <= 0.0, 0.0, np.where(never, np.inf, np.exp(low)))
