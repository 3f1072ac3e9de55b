"""What heat does to arm and set-up: castings grow, the stand creeps, with the temperature or with the time.

A law is what heat follows times which way it moves the TCP. A reading that counts from a state without load shows
what has moved since.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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


Course = Temperature | AfterStart | Evenly


@dataclass(frozen=True)
class _Drift:
    """What both ways of moving share."""

    course: Course
    word = ""
    remembers = False

    @property
    def ways(self) -> str:
        """Which way it moves, in words."""
        raise NotImplementedError

    @property
    def penalty(self) -> float:
        return 0.0

    @property
    def name(self) -> str:
        return f"{self.ways} {self.course.words}"

    @property
    def equation(self) -> str:
        return f"α L ΔT: {self.course.equation}"

    @property
    def shape(self) -> tuple[Parameter, ...]:
        return self.course.shape

    def patterns(self, seen: Warming) -> Array:
        """(N, D, P) m, rad of the TCP per unit of each coefficient, where the course is 1."""
        raise NotImplementedError

    def columns(self, shape: Array, seen: Warming) -> Array:
        return np.asarray(self.patterns(seen) * self.course.course(shape, seen)[:, None, None])

    def sizes(self, values: Array, shape: Array, seen: Warming) -> Mapping[str, Quantity]:
        moved = np.linalg.norm((self.columns(shape, seen) @ values)[:, :3], axis=1)
        size = {"drift": Quantity(1e3 * float(moved.max()), "mm")} | self.more(values, shape, seen)
        return size | ({"time_constant": Quantity(float(shape[0]), "s")} if len(shape) else {})

    def more(self, values: Array, shape: Array, seen: Warming) -> dict[str, Quantity]:
        return {}

    def grid(self, seen: Warming) -> tuple[Shape, ...]:
        return self.course.grid(seen)


@dataclass(frozen=True)
class Grows(_Drift):
    """Castings are longer by a strain, alike or each by itself."""

    each: bool = False

    @property
    def ways(self) -> str:
        return "links grow each by itself" if self.each else "the arm grows"

    @property
    def coefficients(self) -> tuple[Parameter, ...]:
        least = 0.0 if self.course.warms else -np.inf
        parts = ("carousel", "upper_arm", "forearm") if self.each else ("arm",)
        return tuple(Parameter(key=f"strain_{p}", unit="1", least=least) for p in parts)

    def patterns(self, seen: Warming) -> Array:
        return seen.castings if self.each else seen.castings.sum(axis=2, keepdims=True)

    def more(self, values: Array, shape: Array, seen: Warming) -> dict[str, Quantity]:
        """How much warmer castings are, if they are of iron or steel."""
        warmed = float(np.abs(self.course.course(shape, seen)).max() * np.abs(values).max()) / STEEL
        return {"rise": Quantity(warmed, "K")}


@dataclass(frozen=True)
class Shifts(_Drift):
    """The stand moves, and tilts."""

    tilts: bool = True

    @property
    def ways(self) -> str:
        return "the stand shifts and tilts" if self.tilts else "the stand shifts"

    @property
    def penalty(self) -> float:
        return 6.0 if self.tilts else 0.0

    @property
    def coefficients(self) -> tuple[Parameter, ...]:
        turns = tuple(Parameter(key=f"turn_{a}", unit="rad") for a in "xyz") if self.tilts else ()
        return (*(Parameter(key=f"shift_{a}", unit="m") for a in "xyz"), *turns)

    def patterns(self, seen: Warming) -> Array:
        return seen.stand if self.tilts else seen.stand[:, :, :3]

    def grid(self, seen: Warming) -> tuple[Shape, ...]:
        # measured poses have a frame that is fitted: what shifts alone is hardly told from a stand that also tilts
        return self.course.grid(seen) if self.tilts or seen.counted else ()


def _counted(seen: Warming, law: Callable[[Array], Array]) -> Array:
    """(N,) since the state that a reading counts from."""
    assert seen.since is not None  # grids look
    return np.asarray(law(seen.since) - (0.0 if seen.before is None else law(seen.before)))


def _laws(course: Course) -> tuple[DriftLaw, ...]:
    return Grows(course), Grows(course, each=True), Shifts(course), Shifts(course, tilts=False)


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
