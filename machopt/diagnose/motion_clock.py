"""Clocks: one channel early or late against the others.

A delay is not linear, so its column is a secant: (f(t − d̂) − f(t)) / d̂ at the delay d̂ that fits best, exact where the
coefficient comes out as d̂, beside the tangent −ḟ for delays near zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.motion_frame import Scene
from machopt.diagnose.problem import Hypothesis, Quantity, RecordCorrection, Shape

LONGEST, GRID = 0.06, 31  # s, and how many delays are tried within ± that
REFINE = 10  # thirds taken from a valley: below a tenth of a millisecond
VALLEYS = 2
STILL = 2e-5  # s; a secant over less is the tangent


def valley(misfit: Callable[[float], float]) -> float:
    """The delay (s) of the least misfit within ± LONGEST: a grid, then thirds of the best interval."""
    grid = np.linspace(-LONGEST, LONGEST, GRID)
    rough = np.array([misfit(float(d)) for d in grid])
    found = []
    for k in np.argsort(rough)[:VALLEYS]:
        low, high = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, GRID - 1)])
        for _ in range(REFINE):
            third = (high - low) / 3.0
            if misfit(low + third) < misfit(high - third):
                high -= third
            else:
                low += third
        found.append((misfit(0.5 * (low + high)), 0.5 * (low + high)))
    return min(found)[1]


def skew(
    scene: Scene, sensor: str, model: Callable[[float], Array], best: float, *, sign: float = 1.0, penalty: float = 0.0
) -> Hypothesis:
    """``sensor`` is late by the coefficient.

    Args:
        scene: of the motion.
        sensor: word of the channel: tau, qse, position, q.
        model: (N, D) f(t − d) − f(t), f what the channel should have shown.
        best: d̂ in s.
        sign: −1 where a channel that is late makes the difference look early.
        penalty: so that of two clocks that differ in name only the more ordinary one comes first.
    """

    def columns(s: Shape) -> Array:
        d = s[0] if abs(s[0]) > STILL else 0.25 / scene.motion.rate
        secant = model(d) / d if abs(s[0]) > STILL else (model(d) - model(-d)) / (2.0 * d)
        return sign * secant[:, :, None]

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return {"late": Quantity(1e3 * float(x[0]), "ms")}

    # one column, so that two names of one difference of clocks are one and the same
    shapes: tuple[Shape, ...] = ((best if abs(best) > STILL else 0.0,),)
    return Hypothesis(
        "time_skew",
        f"sensor:{sensor}",
        "clock of its own",
        "f_recorded(t) = f(t − d)",
        columns,
        sizes,
        shapes,
        correction=lambda x, s: RecordCorrection("time_skew", f"sensor:{sensor}", {"late_ms": 1e3 * float(x[0])}),
        note="in proportion to speed, all joints by the same time",
        family="sensor",
        penalty=penalty,
        exact=True,
    )
