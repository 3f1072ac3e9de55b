"""Time delays in a motion: one channel relative to the others, or the arm behind its command. Laws of the registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from machopt.data_types.effect_locations import format_sensor_location
from machopt.effects import parameter_conversion, registry
from machopt.effects.protocol import DelayedChannel, DelayLaw, Effect
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    Quantity,
    RecordCorrection,
    Shape,
)
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel
from machopt.numerics.array_types import Array

LONGEST, GRID = 0.06, 31  # s, and number of delays tried within ± that
REFINE = 10  # ternary-search steps: resolves 0.1 ms
VALLEYS = 2


def find_best_delay(misfit: Callable[[float], float]) -> float:
    """Find the delay of the least misfit within ± :data:`LONGEST`: grid search, then ternary search of the best
    intervals.

    Args:
        misfit: Misfit as a function of the delay in s.

    Returns:
        Delay, s.
    """
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


def build_channel_delay_hypotheses(
    scene: MotionModel,
    sensor: str,
    change: Callable[[float], Array],
    best: float,
    *,
    sign: float = 1.0,
    penalty: float = 0.0,
) -> list[EffectHypothesis]:
    """Build the delay laws of one recorded channel.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        sensor: Name of the channel: tau, qse, position, q.
        change: Function of a delay d in s that returns (N, D) f(t − d) − f(t), where f is the undelayed signal.
        best: Best-fitting delay d̂, s.
        sign: −1 if a late channel makes the difference appear early.
        penalty: Penalty that ranks the less common of two equivalent clock errors second.

    Returns:
        The hypotheses.
    """
    seen = DelayedChannel(compute_change=change, best_delay=best, tangent_step=0.25 / scene.motion.rate, sign=sign)
    where = format_sensor_location(sensor)
    return [
        _build_delay_hypothesis(seen, e, law, where, "sensor", penalty)
        for e in registry.select_channel_delay_effects()
        for law in e.delay_laws
    ]


def build_command_delay_hypotheses(
    scene: MotionModel, change: Callable[[float], Array], best: float, followed: Array, delays: Array
) -> list[EffectHypothesis]:
    """Build the laws of an arm that follows its command late.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        change: Function of a delay d in s that returns (N, D) f(t − d) − f(t), where f is the undelayed signal.
        best: Best-fitting delay d̂, s.
        followed: (N, D, 1) following error of the TCP by the encoders, m.
        delays: (n,) delay of each encoder behind its command, s.

    Returns:
        The hypotheses.
    """
    seen = DelayedChannel(
        compute_change=change,
        best_delay=best,
        tangent_step=0.25 / scene.motion.rate,
        sign=1.0,
        following_columns=followed,
        delays=tuple(delays.tolist()),
    )
    laws = ((e, law) for e in registry.select_command_delay_effects() for law in e.delay_laws if law.grid(seen))
    return [_build_delay_hypothesis(seen, e, law, e.places[0], "controller") for e, law in laws]


def _build_delay_hypothesis(
    delayed_channel: DelayedChannel, effect: Effect, law: DelayLaw, where: str, family: str, penalty: float = 0.0
) -> EffectHypothesis:
    lower = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, len(law.coefficients)))

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(s), delayed_channel)

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=lambda s: law.columns(np.array(s), delayed_channel),
        quantities=sizes,
        shapes=law.grid(delayed_channel),
        lower=lower if np.isfinite(lower).any() else (),
        correction=lambda x, s: RecordCorrection(effect.file_word, where, law.to_file_parameters(x, delayed_channel)),
        note=effect.note,
        family=family,
        penalty=penalty,
        is_exact=law.exact,
    )
