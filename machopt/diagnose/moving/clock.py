"""What comes late in a motion: one channel against the others, the arm behind its command. Laws of the registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.laws.motion_frame import Scene
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.domain.location import sensor_at
from machopt.effects import files, registry
from machopt.effects.protocol import Delayed, DelayLaw, Effect

LONGEST, GRID = 0.06, 31  # s, and how many delays are tried within ± that
REFINE = 10  # thirds taken from a valley: below a tenth of a millisecond
VALLEYS = 2


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


def clocks(
    scene: Scene, sensor: str, change: Callable[[float], Array], best: float, *, sign: float = 1.0, penalty: float = 0.0
) -> list[Hypothesis]:
    """``sensor`` is late by the coefficient: the laws of every clock.

    Args:
        scene: of the motion.
        sensor: word of the channel: tau, qse, position, q.
        change: s → (N, D) f(t − d) − f(t), f what the channel should have shown.
        best: d̂ in s.
        sign: −1 where a channel that is late makes the difference look early.
        penalty: so that of two clocks that differ in name only the more ordinary one comes first.
    """
    seen = Delayed(change=change, best=best, step=0.25 / scene.motion.rate, sign=sign)
    where = sensor_at(sensor)
    return [_late(seen, e, law, where, "sensor", penalty) for e in registry.of_clocks() for law in e.delays]


def followers(
    scene: Scene, change: Callable[[float], Array], best: float, followed: Array, delays: Array
) -> list[Hypothesis]:
    """The arm comes behind its command: the laws of every lag.

    Args:
        scene, change, best: see :func:`clocks`; f is the TCP by the commanded joints.
        followed: (N, D, 1) m, what the encoders say of following the command.
        delays: (n,) s by which each encoder follows.
    """
    seen = Delayed(
        change=change,
        best=best,
        step=0.25 / scene.motion.rate,
        sign=1.0,
        followed=followed,
        delays=tuple(delays.tolist()),
    )
    laws = ((e, law) for e in registry.of_followers() for law in e.delays if law.grid(seen))
    return [_late(seen, e, law, e.places[0], "controller") for e, law in laws]


def _late(seen: Delayed, effect: Effect, law: DelayLaw, where: str, family: str, penalty: float = 0.0) -> Hypothesis:
    lower = tuple(least for _, _, least in files.named(law, len(law.coefficients)))

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(s), seen)

    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=lambda s: law.columns(np.array(s), seen),
        quantities=sizes,
        shapes=law.grid(seen),
        lower=lower if np.isfinite(lower).any() else (),
        correction=lambda x, s: RecordCorrection(effect.called, where, law.stated(x, seen)),
        note=effect.note,
        family=family,
        penalty=penalty,
        exact=law.exact,
    )
