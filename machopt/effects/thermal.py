"""What heat does to arm and set-up: castings grow, the stand creeps, with the temperature or with the time.

A law is what heat follows times which way it moves the TCP. A reading that counts from a state without load shows
what has moved since.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import DriftLaw, Effect, Parameter, Quantity, Shape, Warming

WARM = (600.0, 1800.0, 3600.0, 7200.0, 14400.0)  # s, time constants of arms: gear boxes in minutes, castings in hours
LEAST_WARM, MOST_WARM = 0.05, 3.0  # of the longest session: faster looks like a jump, slower like a straight line
LEAST_SPAN = 300.0  # s, of a session in which heat shows
STEEL = 11.5e-6  # 1/K, thermal expansion of steel and cast iron


@dataclass(frozen=True)
class Temperature:
    """s = T − T₀ of the temperature that was recorded."""

    words = "with the temperature"
    equation = "s = T − T at the start"
    shape: tuple[Parameter, ...] = ()
    warms = True  # castings grow

    def course(self, shape: Array, seen: Warming) -> Array:
        assert seen.rise is not None  # grid looks
        return seen.rise

    def grid(self, seen: Warming) -> tuple[Shape, ...]:
        return ((),) if seen.rise is not None else ()


@dataclass(frozen=True)
class AfterStart:
    """s = 1 − exp(−t/T): motors have begun to warm gear boxes and castings."""

    words = "after the start of a session"
    equation = "s = 1 − exp(−t/T), t since the session began"
    shape = (Parameter(key="time_constant_s", unit="s", positive=True),)
    warms = True

    def course(self, shape: Array, seen: Warming) -> Array:
        return _counted(seen, lambda t: -np.expm1(-t / shape[0]))

    def grid(self, seen: Warming) -> tuple[Shape, ...]:
        longest = seen.longest
        if longest <= LEAST_SPAN:
            return ()
        return tuple((t,) for t in WARM if LEAST_WARM * longest <= t <= MOST_WARM * longest)


@dataclass(frozen=True)
class Evenly:
    """s = t: the hall's day, or what cools."""

    words = "evenly over a session"
    equation = "s = t since the session began"
    shape: tuple[Parameter, ...] = ()
    warms = False  # it may as well shrink

    def course(self, shape: Array, seen: Warming) -> Array:
        return _counted(seen, lambda t: t / seen.longest)

    def grid(self, seen: Warming) -> tuple[Shape, ...]:
        return ((),) if seen.longest > LEAST_SPAN else ()


class Course(Protocol):
    """What heat follows."""

    @property
    def words(self) -> str:
        """After which way it moves: "with the temperature"."""
        ...

    @property
    def equation(self) -> str: ...

    @property
    def shape(self) -> tuple[Parameter, ...]: ...

    @property
    def warms(self) -> bool:
        """Castings only grow; else they may as well shrink."""
        ...

    def course(self, shape: Array, seen: Warming) -> Array:
        """(N,) since the state that a reading counts from."""
        ...

    def grid(self, seen: Warming) -> tuple[Shape, ...]: ...


class Way(Protocol):
    """Which way heat moves the TCP."""

    @property
    def words(self) -> str:
        """ "the stand shifts"."""
        ...

    @property
    def penalty(self) -> float: ...

    def coefficients(self, least: float) -> tuple[Parameter, ...]:
        """Of strains none below ``least``."""
        ...

    def patterns(self, seen: Warming) -> Array:
        """(N, D, P) m, rad of the TCP per unit of each coefficient, where the course is 1."""
        ...

    def shown(self, seen: Warming) -> bool:
        """Whether such readings can tell it from others."""
        ...

    def warmed(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """How much warmer castings would be, of what tells that."""
        ...


@dataclass(frozen=True)
class Grows:
    """Castings are longer by a strain, alike or each by itself."""

    each: bool = False
    penalty = 0.0

    @property
    def words(self) -> str:
        return "links grow each by itself" if self.each else "the arm grows"

    def coefficients(self, least: float) -> tuple[Parameter, ...]:
        parts = ("carousel", "upper_arm", "forearm") if self.each else ("arm",)
        return tuple(Parameter(key=f"strain_{p}", unit="1", least=least) for p in parts)

    def patterns(self, seen: Warming) -> Array:
        return seen.castings if self.each else seen.castings.sum(axis=2, keepdims=True)

    def shown(self, seen: Warming) -> bool:
        """Castings take their time: between a load and the state without it, a minute before, none grows."""
        if not seen.counted or seen.since is None or seen.before is None:
            return True
        return float((seen.since - seen.before).max(initial=0.0)) > LEAST_SPAN

    def warmed(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        """If they are of iron or steel."""
        return {"rise": Quantity(float(np.abs(course).max() * np.abs(values).max()) / STEEL, "K")}


@dataclass(frozen=True)
class Shifts:
    """The stand moves, and tilts."""

    tilts: bool = True

    @property
    def words(self) -> str:
        return "the stand shifts and tilts" if self.tilts else "the stand shifts"

    @property
    def penalty(self) -> float:
        return 6.0 if self.tilts else 0.0

    def coefficients(self, least: float) -> tuple[Parameter, ...]:
        turns = tuple(Parameter(key=f"turn_{a}", unit="rad") for a in "xyz") if self.tilts else ()
        return (*(Parameter(key=f"shift_{a}", unit="m") for a in "xyz"), *turns)

    def patterns(self, seen: Warming) -> Array:
        return seen.stand if self.tilts else seen.stand[:, :, :3]

    def shown(self, seen: Warming) -> bool:
        # measured poses have a frame that is fitted: what shifts alone is hardly told from a stand that also tilts
        return self.tilts or seen.counted

    def warmed(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        return {}


@dataclass(frozen=True)
class Both:
    """Hall and arm warm together: the stand moves while the castings grow."""

    grows: Grows = Grows()
    stands: Shifts = Shifts()

    @property
    def words(self) -> str:
        return f"{self.stands.words}, and {self.grows.words}"

    @property
    def penalty(self) -> float:
        return self.stands.penalty

    def coefficients(self, least: float) -> tuple[Parameter, ...]:
        return (*self.grows.coefficients(least), *self.stands.coefficients(least))

    def patterns(self, seen: Warming) -> Array:
        return np.concatenate([self.grows.patterns(seen), self.stands.patterns(seen)], axis=2)

    def shown(self, seen: Warming) -> bool:
        return not seen.counted  # a load test has one place of the TCP for many readings

    def warmed(self, values: Array, course: Array) -> Mapping[str, Quantity]:
        return self.grows.warmed(values[:1], course)


@dataclass(frozen=True)
class Drift:
    """One way of moving by one course of heat."""

    way: Way
    course: Course
    word = ""
    remembers = False

    @property
    def penalty(self) -> float:
        return self.way.penalty

    @property
    def name(self) -> str:
        return f"{self.way.words} {self.course.words}"

    @property
    def equation(self) -> str:
        return f"α L ΔT: {self.course.equation}"

    @property
    def shape(self) -> tuple[Parameter, ...]:
        return self.course.shape

    @property
    def coefficients(self) -> tuple[Parameter, ...]:
        return self.way.coefficients(0.0 if self.course.warms else -np.inf)

    def columns(self, shape: Array, seen: Warming) -> Array:
        return np.asarray(self.way.patterns(seen) * self.course.course(shape, seen)[:, None, None])

    def sizes(self, values: Array, shape: Array, seen: Warming) -> Mapping[str, Quantity]:
        moved = np.linalg.norm((self.columns(shape, seen) @ values)[:, :3], axis=1)
        size = {"drift": Quantity(1e3 * float(moved.max()), "mm")}
        warmed = self.way.warmed(values, self.course.course(shape, seen))
        slow = {"time_constant": Quantity(float(shape[0]), "s")} if len(shape) else {}
        return {**size, **warmed, **slow}

    def grid(self, seen: Warming) -> tuple[Shape, ...]:
        return self.course.grid(seen) if self.way.shown(seen) else ()


def _counted(seen: Warming, law: Callable[[Array], Array]) -> Array:
    """(N,) since the state that a reading counts from."""
    assert seen.since is not None  # grids look
    return np.asarray(law(seen.since) - (0.0 if seen.before is None else law(seen.before)))


def _laws(course: Course) -> tuple[DriftLaw, ...]:
    return tuple(Drift(way, course) for way in (Grows(), Grows(each=True), Shifts(), Shifts(tilts=False), Both()))


THERMAL = Effect(
    name="thermal_drift",
    noun="thermal drift",
    sentence="The arm or the set-up grows with temperature or time, load or not.",
    port="body",
    places=("environment",),
    drifts=(*_laws(Temperature()), *_laws(AfterStart()), *_laws(Evenly())),
    form=0.2,
    plausible={"mm": 5.0},
    of="",
    note="with time and temperature, whatever the pose and load",
)
