"""What heat does to arm and set-up: castings grow, the stand creeps, with the temperature or with the time.

A law is what heat follows times which way it moves the TCP. A reading that counts from a state without load shows
what has moved since.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.effects.protocol import DriftLaw, Effect, LawParameter, Quantity, Shape, ThermalState
from machopt.numerics.array_types import Array

WARM = (600.0, 1800.0, 3600.0, 7200.0, 14400.0)  # s, time constants of arms: gear boxes in minutes, castings in hours
LEAST_WARM, MOST_WARM = 0.05, 3.0  # of the longest session: faster looks like a jump, slower like a straight line
LEAST_SPAN = 300.0  # s, of a session in which heat shows
STEEL = 11.5e-6  # 1/K, thermal expansion of steel and cast iron


@dataclass(frozen=True)
class TemperatureCourse:
    """s = T − T₀ of the temperature that was recorded."""

    words = "with the temperature"
    equation = "s = T − T at the start"
    shape: tuple[LawParameter, ...] = ()
    warms = True  # castings grow

    def course(self, shape: Array, seen: ThermalState) -> Array:
        assert seen.temperature_rise is not None  # grid looks
        return seen.temperature_rise

    def grid(self, seen: ThermalState) -> tuple[Shape, ...]:
        return ((),) if seen.temperature_rise is not None else ()


@dataclass(frozen=True)
class WarmUpCourse:
    """s = 1 − exp(−t/T): motors have begun to warm gear boxes and castings."""

    words = "after the start of a session"
    equation = "s = 1 − exp(−t/T), t since the session began"
    shape = (LawParameter(key="time_constant_s", unit="s", positive=True),)
    warms = True

    def course(self, shape: Array, seen: ThermalState) -> Array:
        return _subtract_unloaded_state(seen, lambda t: -np.expm1(-t / shape[0]))

    def grid(self, seen: ThermalState) -> tuple[Shape, ...]:
        longest = seen.longest_session
        if longest <= LEAST_SPAN:
            return ()
        return tuple((t,) for t in WARM if LEAST_WARM * longest <= t <= MOST_WARM * longest)


@dataclass(frozen=True)
class LinearTimeCourse:
    """s = t: the hall's day, or what cools."""

    words = "evenly over a session"
    equation = "s = t since the session began"
    shape: tuple[LawParameter, ...] = ()
    warms = False  # it may as well shrink

    def course(self, shape: Array, seen: ThermalState) -> Array:
        return _subtract_unloaded_state(seen, lambda t: t / seen.longest_session)

    def grid(self, seen: ThermalState) -> tuple[Shape, ...]:
        return ((),) if seen.longest_session > LEAST_SPAN else ()


class HeatCourse(Protocol):
    """What heat follows."""

    @property
    def words(self) -> str:
        """After which way it moves: "with the temperature"."""
        ...

    @property
    def equation(self) -> str: ...

    @property
    def shape(self) -> tuple[LawParameter, ...]: ...

    @property
    def warms(self) -> bool:
        """Castings only grow; else they may as well shrink."""
        ...

    def course(self, shape: Array, seen: ThermalState) -> Array:
        """(N,) since the state that a reading counts from."""
        ...

    def grid(self, seen: ThermalState) -> tuple[Shape, ...]: ...


class ThermalMotion(Protocol):
    """Which way heat moves the TCP."""

    @property
    def words(self) -> str:
        """ "the stand shifts"."""
        ...

    @property
    def penalty(self) -> float: ...

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        """Of strains none below ``least``."""
        ...

    def patterns(self, seen: ThermalState) -> Array:
        """(N, D, P) m, rad of the TCP per unit of each coefficient, where the course is 1."""
        ...

    def is_testable(self, seen: ThermalState) -> bool:
        """Whether such readings can tell it from others."""
        ...

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """How much warmer castings would be, of what tells that."""
        ...


@dataclass(frozen=True)
class CastingExpansion:
    """Castings are longer by a strain, alike or each by itself."""

    per_casting: bool = False
    penalty = 0.0

    @property
    def words(self) -> str:
        return "links grow each by itself" if self.per_casting else "the arm grows"

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        parts = ("carousel", "upper_arm", "forearm") if self.per_casting else ("arm",)
        return tuple(LawParameter(key=f"strain_{p}", unit="1", lower_limit=least) for p in parts)

    def patterns(self, seen: ThermalState) -> Array:
        return seen.casting_columns if self.per_casting else seen.casting_columns.sum(axis=2, keepdims=True)

    def is_testable(self, seen: ThermalState) -> bool:
        """Castings take their time: between a load and the state without it, a minute before, none grows."""
        if not seen.is_relative or seen.time_since_start is None or seen.unloaded_time_since_start is None:
            return True
        return float((seen.time_since_start - seen.unloaded_time_since_start).max(initial=0.0)) > LEAST_SPAN

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """If they are of iron or steel."""
        return {"rise": Quantity(float(np.abs(course).max() * np.abs(values).max()) / STEEL, "K")}


@dataclass(frozen=True)
class StandDrift:
    """The stand moves, and tilts."""

    includes_tilt: bool = True

    @property
    def words(self) -> str:
        return "the stand shifts and tilts" if self.includes_tilt else "the stand shifts"

    @property
    def penalty(self) -> float:
        return 6.0 if self.includes_tilt else 0.0

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        turns = tuple(LawParameter(key=f"turn_{a}", unit="rad") for a in "xyz") if self.includes_tilt else ()
        return (*(LawParameter(key=f"shift_{a}", unit="m") for a in "xyz"), *turns)

    def patterns(self, seen: ThermalState) -> Array:
        return seen.stand_columns if self.includes_tilt else seen.stand_columns[:, :, :3]

    def is_testable(self, seen: ThermalState) -> bool:
        # measured poses have a frame that is fitted: what shifts alone is hardly told from a stand that also tilts
        return self.includes_tilt or seen.is_relative

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        return {}


@dataclass(frozen=True)
class ExpansionAndStandDrift:
    """Hall and arm warm together: the stand moves while the castings grow."""

    expansion: CastingExpansion = CastingExpansion()
    stand_drift: StandDrift = StandDrift()

    @property
    def words(self) -> str:
        return f"{self.stand_drift.words}, and {self.expansion.words}"

    @property
    def penalty(self) -> float:
        return self.stand_drift.penalty

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        return (*self.expansion.coefficients(least), *self.stand_drift.coefficients(least))

    def patterns(self, seen: ThermalState) -> Array:
        return np.concatenate([self.expansion.patterns(seen), self.stand_drift.patterns(seen)], axis=2)

    def is_testable(self, seen: ThermalState) -> bool:
        return not seen.is_relative  # a load test has one place of the TCP for many readings

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        return self.expansion.estimate_temperature_rise(values[:1], course)


@dataclass(frozen=True)
class ThermalDrift:
    """One way of moving by one course of heat."""

    motion: ThermalMotion
    course: HeatCourse
    word = ""
    has_memory = False

    @property
    def penalty(self) -> float:
        return self.motion.penalty

    @property
    def name(self) -> str:
        return f"{self.motion.words} {self.course.words}"

    @property
    def equation(self) -> str:
        return f"α L ΔT: {self.course.equation}"

    @property
    def shape(self) -> tuple[LawParameter, ...]:
        return self.course.shape

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        return self.motion.coefficients(0.0 if self.course.warms else -np.inf)

    def columns(self, shape: Array, seen: ThermalState) -> Array:
        return np.asarray(self.motion.patterns(seen) * self.course.course(shape, seen)[:, None, None])

    def sizes(self, values: Array, shape: Array, seen: ThermalState) -> Mapping[str, Quantity]:
        moved = np.linalg.norm((self.columns(shape, seen) @ values)[:, :3], axis=1)
        size = {"drift": Quantity(1e3 * float(moved.max()), "mm")}
        warmed = self.motion.estimate_temperature_rise(values, self.course.course(shape, seen))
        slow = {"time_constant": Quantity(float(shape[0]), "s")} if len(shape) else {}
        return {**size, **warmed, **slow}

    def grid(self, seen: ThermalState) -> tuple[Shape, ...]:
        return self.course.grid(seen) if self.motion.is_testable(seen) else ()


def _subtract_unloaded_state(seen: ThermalState, law: Callable[[Array], Array]) -> Array:
    """(N,) since the state that a reading counts from."""
    assert seen.time_since_start is not None  # grids look
    return np.asarray(
        law(seen.time_since_start)
        - (0.0 if seen.unloaded_time_since_start is None else law(seen.unloaded_time_since_start))
    )


def _build_drift_laws(course: HeatCourse) -> tuple[DriftLaw, ...]:
    return tuple(
        ThermalDrift(way, course)
        for way in (
            CastingExpansion(),
            CastingExpansion(per_casting=True),
            StandDrift(),
            StandDrift(includes_tilt=False),
            ExpansionAndStandDrift(),
        )
    )


THERMAL = Effect(
    name="thermal_drift",
    noun="thermal drift",
    sentence="The arm or the set-up grows with temperature or time, load or not.",
    port="body",
    places=("environment",),
    drift_laws=(
        *_build_drift_laws(TemperatureCourse()),
        *_build_drift_laws(WarmUpCourse()),
        *_build_drift_laws(LinearTimeCourse()),
    ),
    form_uncertainty=0.2,
    plausible_sizes={"mm": 5.0},
    preposition="",
    note="with time and temperature, whatever the pose and load",
)
