"""Courses of heat: measured temperature, warm-up with a time constant, and linear drift with time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.effects.protocol import LawParameter, Shape, ThermalState
from machopt.numerics.array_types import Array

WARM = (
    600.0,
    1800.0,
    3600.0,
    7200.0,
    14400.0,
)  # s, time constants that a search tries: gearboxes minutes, castings hours
LEAST_WARM, MOST_WARM = (
    0.05,
    3.0,
)  # relative to the longest session: faster courses look like a step, slower ones like a straight line
LEAST_SPAN = 300.0  # s, shortest session in which thermal drift is observable


@dataclass(frozen=True)
class TemperatureCourse:
    """Course s = T − T₀ of the recorded temperature."""

    words = "with the temperature"
    equation = "s = T − T at the start"
    shape: tuple[LawParameter, ...] = ()
    warms = True  # castings expand

    def course(self, shape: Array, thermal_state: ThermalState) -> Array:
        """Return the recorded temperature rise.

        Args:
            shape: Empty; the course has no shape parameters.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N,) K.
        """
        assert thermal_state.temperature_rise is not None  # ensured by grid
        return thermal_state.temperature_rise

    def grid(self, thermal_state: ThermalState) -> tuple[Shape, ...]:
        """Return one empty shape; none if no temperature was recorded.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            The shapes that a search tries.
        """
        return ((),) if thermal_state.temperature_rise is not None else ()


@dataclass(frozen=True)
class WarmUpCourse:
    """Course s = 1 − exp(−t/T): motors warm up gearboxes and castings."""

    words = "after the start of a session"
    equation = "s = 1 − exp(−t/T), t since the session began"
    shape = (LawParameter(key="time_constant_s", unit="s", positive=True),)
    warms = True

    def course(self, shape: Array, thermal_state: ThermalState) -> Array:
        """Return the warm-up state of each reading relative to its reference state.

        Args:
            shape: (1,) time constant T, s.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N,) dimensionless.
        """
        return _subtract_unloaded_state(thermal_state, lambda t: -np.expm1(-t / shape[0]))

    def grid(self, thermal_state: ThermalState) -> tuple[Shape, ...]:
        """Return the time constants that a search tries, matched to the longest session.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            Shapes (time constant,) in s.
        """
        longest = thermal_state.longest_session
        if longest <= LEAST_SPAN:
            return ()
        return tuple((t,) for t in WARM if LEAST_WARM * longest <= t <= MOST_WARM * longest)


@dataclass(frozen=True)
class LinearTimeCourse:
    """Course s = t: daily temperature change of the hall, or cooling."""

    words = "evenly over a session"
    equation = "s = t since the session began"
    shape: tuple[LawParameter, ...] = ()
    warms = False  # expansion or contraction

    def course(self, shape: Array, thermal_state: ThermalState) -> Array:
        """Return the time of each reading relative to its reference state, in units of the longest session.

        Args:
            shape: Empty; the course has no shape parameters.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N,) dimensionless.
        """
        return _subtract_unloaded_state(thermal_state, lambda t: t / thermal_state.longest_session)

    def grid(self, thermal_state: ThermalState) -> tuple[Shape, ...]:
        """Return one empty shape; none for short sessions.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            The shapes that a search tries.
        """
        return ((),) if thermal_state.longest_session > LEAST_SPAN else ()


class HeatCourse(Protocol):
    """Course of a thermal drift over time or temperature."""

    @property
    def words(self) -> str:
        """Wording in reports, for example "with the temperature"."""
        ...

    @property
    def equation(self) -> str: ...

    @property
    def shape(self) -> tuple[LawParameter, ...]: ...

    @property
    def warms(self) -> bool:
        """Whether castings can only expand along this course."""
        ...

    def course(self, shape: Array, thermal_state: ThermalState) -> Array:
        """Return the course at each reading relative to its reference state.

        Args:
            shape: (S,) shape parameters of the course, SI.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N,) in the unit of the course.
        """
        ...

    def grid(self, thermal_state: ThermalState) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            Shapes in SI; empty if the readings cannot show the course.
        """
        ...


def _subtract_unloaded_state(thermal_state: ThermalState, law: Callable[[Array], Array]) -> Array:
    """Return the course (N,) of each reading minus that of its unloaded reference state."""
    assert thermal_state.time_since_start is not None  # ensured by grid
    return np.asarray(
        law(thermal_state.time_since_start)
        - (0.0 if thermal_state.unloaded_time_since_start is None else law(thermal_state.unloaded_time_since_start))
    )
