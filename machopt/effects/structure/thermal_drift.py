"""Thermal drift of arm and set-up: castings expand, the stand moves, with temperature or with time.

A law is the product of a course (over time or temperature) and a motion pattern of the TCP. A reading relative to an
unloaded reference state shows the change since that state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.effects.protocol import DriftLaw, Effect, LawParameter, Quantity, Shape, ThermalState
from machopt.effects.structure.heat_courses import (
    LEAST_SPAN,
    HeatCourse,
    LinearTimeCourse,
    TemperatureCourse,
    WarmUpCourse,
)
from machopt.numerics.array_types import Array

STEEL = 11.5e-6  # 1/K, thermal expansion of steel and cast iron


class ThermalMotion(Protocol):
    """Motion pattern of the TCP under thermal drift."""

    @property
    def words(self) -> str:
        """Wording in reports, for example "the stand shifts"."""
        ...

    @property
    def penalty(self) -> float: ...

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        """Return the coefficients of the pattern.

        Args:
            least: Lower limit of strain coefficients.
        """
        ...

    def patterns(self, thermal_state: ThermalState) -> Array:
        """Return the TCP motion per unit of each coefficient for a course value of 1.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N, D, P) m, rad per unit of each coefficient.
        """
        ...

    def is_testable(self, thermal_state: ThermalState) -> bool:
        """Return whether the readings can distinguish the pattern from others.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.
        """
        ...

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """Estimate the temperature rise that the coefficients imply.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            course: (N,) course at each reading.

        Returns:
            ``rise`` in K; empty if the pattern implies none.
        """
        ...


@dataclass(frozen=True)
class CastingExpansion:
    """Thermal expansion of the castings by a strain, common or separate for each casting."""

    per_casting: bool = False
    penalty = 0.0

    @property
    def words(self) -> str:
        return "links grow each by itself" if self.per_casting else "the arm grows"

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        """Return one strain for the arm, or one for each casting.

        Args:
            least: Lower limit of strain coefficients.
        """
        parts = ("carousel", "upper_arm", "forearm") if self.per_casting else ("arm",)
        return tuple(LawParameter(key=f"strain_{p}", unit="1", lower_limit=least) for p in parts)

    def patterns(self, thermal_state: ThermalState) -> Array:
        """Return the TCP motion per unit strain.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N, D, P) m, rad per unit strain.
        """
        return (
            thermal_state.casting_columns
            if self.per_casting
            else thermal_state.casting_columns.sum(axis=2, keepdims=True)
        )

    def is_testable(self, thermal_state: ThermalState) -> bool:
        """Return whether the readings span enough time for the castings to expand.

        A reading relative to a reference state a minute earlier cannot show it.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.
        """
        if (
            not thermal_state.is_relative
            or thermal_state.time_since_start is None
            or thermal_state.unloaded_time_since_start is None
        ):
            return True
        return (
            float((thermal_state.time_since_start - thermal_state.unloaded_time_since_start).max(initial=0.0))
            > LEAST_SPAN
        )

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """Estimate the temperature rise for castings of iron or steel.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            course: (N,) course at each reading.
        """
        return {"rise": Quantity(float(np.abs(course).max() * np.abs(values).max()) / STEEL, "K")}


@dataclass(frozen=True)
class StandDrift:
    """Translation of the stand, optionally with tilt."""

    includes_tilt: bool = True

    @property
    def words(self) -> str:
        return "the stand shifts and tilts" if self.includes_tilt else "the stand shifts"

    @property
    def penalty(self) -> float:
        return 6.0 if self.includes_tilt else 0.0

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        """Return the translation and, with tilt, the rotation of the stand.

        Args:
            least: Lower limit of strain coefficients.
        """
        turns = tuple(LawParameter(key=f"turn_{a}", unit="rad") for a in "xyz") if self.includes_tilt else ()
        return (*(LawParameter(key=f"shift_{a}", unit="m") for a in "xyz"), *turns)

    def patterns(self, thermal_state: ThermalState) -> Array:
        """Return the TCP motion per unit translation and rotation of the stand.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N, D, P) m, rad per m and rad.
        """
        return thermal_state.stand_columns if self.includes_tilt else thermal_state.stand_columns[:, :, :3]

    def is_testable(self, thermal_state: ThermalState) -> bool:
        # measured poses have a fitted frame: a pure translation is hardly distinguishable from one with tilt
        """Return whether the readings can distinguish the pattern from others.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.
        """
        return self.includes_tilt or thermal_state.is_relative

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """Return nothing: a moving stand implies no temperature rise.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            course: (N,) course at each reading.
        """
        return {}


@dataclass(frozen=True)
class ExpansionAndStandDrift:
    """Expansion of the castings together with a drift of the stand: hall and arm warm up together."""

    expansion: CastingExpansion = CastingExpansion()
    stand_drift: StandDrift = StandDrift()

    @property
    def words(self) -> str:
        return f"{self.stand_drift.words}, and {self.expansion.words}"

    @property
    def penalty(self) -> float:
        return self.stand_drift.penalty

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        """Return the coefficients of both patterns.

        Args:
            least: Lower limit of strain coefficients.
        """
        return (*self.expansion.coefficients(least), *self.stand_drift.coefficients(least))

    def patterns(self, thermal_state: ThermalState) -> Array:
        """Return the TCP motion per unit of each coefficient.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N, D, P) m, rad per unit of each coefficient.
        """
        return np.concatenate(
            [self.expansion.patterns(thermal_state), self.stand_drift.patterns(thermal_state)], axis=2
        )

    def is_testable(self, thermal_state: ThermalState) -> bool:
        """Return whether the readings are absolute.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.
        """
        return not thermal_state.is_relative  # a load test has many readings at the same TCP position

    def estimate_temperature_rise(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """Estimate the temperature rise from the strain of the castings.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            course: (N,) course at each reading.
        """
        return self.expansion.estimate_temperature_rise(values[:1], course)


@dataclass(frozen=True)
class ThermalDrift:
    """Thermal drift: one motion pattern with one course."""

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

    def columns(self, shape: Array, thermal_state: ThermalState) -> Array:
        """Return the TCP drift per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N, D, P) m, rad per unit of each coefficient.
        """
        return np.asarray(self.motion.patterns(thermal_state) * self.course.course(shape, thermal_state)[:, None, None])

    def sizes(self, values: Array, shape: Array, thermal_state: ThermalState) -> Mapping[str, Quantity]:
        """Return the largest drift, the implied temperature rise and the time constant.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            ``drift`` in mm first, then the others.
        """
        moved = np.linalg.norm((self.columns(shape, thermal_state) @ values)[:, :3], axis=1)
        size = {"drift": Quantity(1e3 * float(moved.max()), "mm")}
        temperature_rise = self.motion.estimate_temperature_rise(values, self.course.course(shape, thermal_state))
        slow = {"time_constant": Quantity(float(shape[0]), "s")} if len(shape) else {}
        return {**size, **temperature_rise, **slow}

    def grid(self, thermal_state: ThermalState) -> tuple[Shape, ...]:
        """Return the shapes of the course if the motion pattern is testable.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            Shapes in SI.
        """
        return self.course.grid(thermal_state) if self.motion.is_testable(thermal_state) else ()


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
