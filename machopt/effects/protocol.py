"""The nouns of every effect: a parameter's definition, what drives a law, the law, the effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.effects.given import Parameters

Ints = NDArray[np.int64]
Shape = tuple[float, ...]

ARCMIN = np.pi / 10800.0  # rad
DEGREE = np.pi / 180.0  # rad
COMPLIANCE = "rad/(N·m)"
FORM = 0.08  # relative 1 sigma of a size for a law's own form: no gear, beam or loop is quite like its equation
JOINTS = tuple(f"joint:{i}" for i in range(1, 7))
MEMORIES = ("cycle", "visit", "arrival", "session")  # what a gear remembers, in the order that searches number them

Port = Literal["twist", "torque", "angle", "frame", "body", "record"]
"""Which local thing a law makes: twist of a joint by its torque, torque beside a gear, angle without load, where a
frame is built, twist of a body by its wrench, a change of the recording itself."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number of a law, or a row with one for each of its branches; a definition, never a value."""

    key: str  # in files, carries its unit
    unit: str  # SI, of values in the program
    factor: float = 1.0  # SI per unit of the key
    least: float = -np.inf  # in the unit of the key
    positive: bool = False  # above zero
    inverse: bool = False  # the key holds one over the number, which is left out where the number is zero
    required: bool = False  # no fit searches for it: a file that means this law states it
    many: bool = False  # a list in files
    bare: bool = False  # of one branch alone, the number without a list
    name: str = ""  # of a coefficient where it is reported in SI and the key's unit is another
    most: float = np.inf  # to either side, in the unit of the key: beyond it the number is in another unit
    said: str = ""  # the unit of the key in words, where refusals say it

    @property
    def called(self) -> str:
        return self.name or self.key


@dataclass(frozen=True)
class Quantity:
    """One number of a finding in the unit of the trade."""

    value: float
    unit: str  # "arcmin", "N·m/arcmin", "%", "ms" …


@dataclass(frozen=True)
class Drive:
    """What acts at one joint in K states, in the order they happened.

    Different memories of a gear are different drives over the same law.
    """

    torque: Array  # (..., ) N·m that the law follows
    angle: Array | None = None  # (...,) rad of the joint
    gap: Array | None = None  # (K,) s since the state before; of a first one since the gear rested; see creep.lag
    first: Ints | None = None  # (K,) 1: nothing before this state counts. None: each state stands by itself, for long


@dataclass(frozen=True)
class Scale:
    """How much a recording or a plan asks of one joint: what shares and sizes are of."""

    reach: float  # N·m, about the largest torque
    compliance: float | None = None  # rad/(N·m) of the joint's own spring; None: not known yet
    low: float = 0.0  # rad, range of its angle
    high: float = 0.0
    lasting: float = np.inf  # s, the longest history without a break
    sampled: bool = False  # a motion in many samples; else settled readings, some a cycle


@dataclass(frozen=True, kw_only=True)
class Body:
    """A body where it gives way, all joints at zero: between its root and the frame S at its loaded end."""

    axes: Array  # (3, 3) axes of S in base_link: x along the body, or out of the tool
    length: float = 0.0  # m; 0: the joints leave none
    root: Array | None = None  # (4, 4) the flange as seen from S; None: a body that begins anywhere
    normal: Array | None = None  # (3,) base_link axes: across the body, what the arm moves about in its plane
    turned: bool = False  # what is no beam is stated in axes of S; else in base_link's


class Stated(Protocol):
    """What a file states of a law: P coefficients in which it is linear, S numbers that give its shape."""

    @property
    def word(self) -> str:
        """In files, where the effect has several laws; empty: a file states none."""
        ...

    @property
    def coefficients(self) -> tuple[Parameter, ...]: ...

    @property
    def shape(self) -> tuple[Parameter, ...]: ...

    @property
    def remembers(self) -> bool:
        """How a torque came there, or since when it has been there, makes a difference."""
        ...


class Law(Stated, Protocol):
    """One law of an effect. Stateless; SI."""

    @property
    def name(self) -> str:
        """In reports: "play"."""
        ...

    @property
    def equation(self) -> str:
        """With its source."""
        ...

    @property
    def weighs(self) -> bool:
        """It follows the whole torque of a joint, weight included, along a curve."""
        ...

    def columns(self, shape: Array, drive: Drive) -> Array:
        """(..., P) what it makes per unit of each coefficient, at each state of the drive."""
        ...

    def tangent(self, shape: Array, drive: Drive) -> Array:
        """(..., P) its slope by the torque; of what remembers, the most that a lasting load can meet."""
        ...

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """How much compliance it may take from its joint at most, ≤ 0 rad/(N·m), and at which angle in rad (or NaN)."""
        ...

    def within(self, values: Array, room: float) -> Law:
        """The law as it holds where the joint has ``room`` rad/(N·m) left for it to take."""
        ...

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the law is not offered."""
        ...

    def silent(self, loaded: Array, unloaded: Array, scale: Scale) -> str:
        """Why torques (N,) against those without load (N,) cannot show it; empty where they can."""
        ...


class Unloaded(Stated, Protocol):
    """An angle Δ(q) that a joint is off by without any load, by its own angle or another joint's. Stateless; SI."""

    @property
    def equation(self) -> str:
        """With its source."""
        ...

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        """(..., P) rad per unit of each coefficient at angles (...,) rad, or a derivative by the angle."""
        ...

    def steepest(self, values: Array, shape: Array) -> float:
        """The most that Δ changes, rad per rad of the angle."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...


class Beside(Stated, Protocol):
    """A torque that a spring puts on a joint beside its gear, by the joint's own angle. Stateless; SI."""

    @property
    def name(self) -> str: ...

    def torque(self, shape: Array, angle: Array) -> Array:
        """(..., P) N·m per unit of each coefficient at angles (...,) rad."""
        ...

    def slope(self, shape: Array, angle: Array) -> Array:
        """(..., P) its derivative by the angle; what it takes from the stiffness of the gear."""
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...


@dataclass(frozen=True)
class Recorded:
    """What a load test records in K readings, as far as sensors may have it wrong. base_link axes."""

    wrench: Array  # (K, 6) N, N·m at the TCP
    displacement: Array  # (K, D) m, rad of the TCP, as predicted so far
    axes: Array  # (K, 3, 3) of the sensor, its axes in columns
    tool: Array  # (K, 3, 3) of the tool


class RecordLaw(Stated, Protocol):
    """What acts beyond what is recorded, linear in its coefficients. Stateless; SI."""

    @property
    def name(self) -> str: ...

    @property
    def equation(self) -> str:
        """With its source."""
        ...

    @property
    def moves(self) -> str:
        """What it changes: "wrench", which acts through the arm, or "displacement"."""
        ...

    def columns(self, shape: Array, seen: Recorded) -> Array:
        """(K, 6, P) N, N·m or (K, D, P) m, rad per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to small coefficients."""
        ...

    def grid(self) -> tuple[Shape, ...]:
        """Shapes that a search tries."""
        ...


@dataclass(frozen=True)
class Rubbing:
    """How a joint moves in K samples, as its friction feels it; of a slide m for rad and N for N·m."""

    speed: Array  # (K,) rad/s
    way: Array  # (K,) −1 … 1, which way friction points
    load: Array  # (K,) N·m, size of the torque that it carries
    first: Ints  # (K,) 1 where a segment begins
    step: float  # s between samples
    warmth: Callable[[float], Array]  # (K,) 0 … 1 for a time constant in s; of zero by the recorded temperature
    slides: bool = False


@dataclass(frozen=True)
class Pace:
    """How a joint moves in a recording: what shapes of friction are of."""

    fast: float  # rad/s, about its largest speed
    loaded: bool  # what it carries changes
    warming: tuple[float, ...] = ()  # s, time constants that the recording can show


class FrictionLaw(Stated, Protocol):
    """A torque of the motor beyond Coulomb and viscous friction, linear in its coefficients. Stateless; SI."""

    @property
    def name(self) -> str: ...

    @property
    def equation(self) -> str:
        """With its source."""
        ...

    @property
    def note(self) -> str:
        """Where it shows."""
        ...

    @property
    def by_angle(self) -> bool:
        """Its picture is over the joint's angle; else over its speed."""
        ...

    def columns(self, shape: Array, seen: Rubbing) -> Array:
        """(K, P) N·m per unit of each coefficient."""
        ...

    def sizes(self, values: Array, shape: Array, seen: Rubbing) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, pace: Pace) -> tuple[Shape, ...]:
        """Shapes that a search tries; none where the recording cannot show it."""
        ...


class BodyLaw(Stated, Protocol):
    """How a body gives way under what it bears, linear in that: a twist of S by the wrench there. Stateless; SI."""

    @property
    def name(self) -> str:
        """In reports: "bends and twists"."""
        ...

    @property
    def equation(self) -> str:
        """With its source."""
        ...

    @property
    def note(self) -> str:
        """Where it shows; empty: where joints' torques explain nothing."""
        ...

    @property
    def weighs(self) -> bool:
        """Tried where weight bends too, which shows little of a body."""
        ...

    @property
    def bounded(self) -> bool:
        """A search keeps the coefficients above their least; else noise may leave a direction that pushes back."""
        ...

    def axes(self, body: Body) -> Array:
        """(3, 3) in base_link, the law's own axes at S with all joints at zero."""
        ...

    def matrices(self, shape: Array, body: Body) -> Array:
        """(P, 6, 6) compliance at S per unit of each coefficient, in the law's axes."""
        ...

    def sags(self, shape: Array, body: Body, own: Sequence[tuple[Array, float]]) -> Array | None:
        """(K, 6, P) twist of S under weights that are spread evenly along the body; None: they count at S.

        Args:
            own: of each weight the whole of it (K, 3) N in the law's axes, and how far from the root it reaches, m.
        """
        ...

    def nearest(self, values: Array, metric: Array) -> Array:
        """Coefficients of a body that pushes back nowhere.

        Args:
            values: (p,) where noise has its way.
            metric: (p, p) how the sum of squares that readings leave grows with a change of them.
        """
        ...

    def stated(self, values: Array, shape: Array, body: Body) -> dict[str, Any]:
        """The parameters of a file."""
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Numbers of the trade; the first is the effect's size and grows in proportion to the coefficients."""
        ...

    def grid(self, body: Body) -> tuple[Shape, ...]:
        """Shapes that a search tries; none of a body that makes no such thing."""
        ...

    def seen(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """As readings of 3 or 6 coordinates show it, whose loads turn the tool by moments or only pull."""
        ...


Reader = Callable[[Parameters, Body], tuple[BodyLaw, Array, Array, Body]]
"""Law, coefficients and shape that a file means, and the body as the file has it."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A word of the vocabulary and what stands behind it."""

    name: str  # "joint_hysteresis"; one thing in the program
    word: str = ""  # what files and findings call it, where two effects share a word; empty: the name
    noun: str  # "hysteresis"; its place follows
    sentence: str  # for the reader of a report
    port: Port
    places: tuple[str, ...]  # of an arm; empty: not listed, e.g. columns of a recording
    laws: tuple[Law, ...] = ()  # in the order in which they are tried
    unloaded: Unloaded | None = None  # the law of port angle
    beside: tuple[Beside, ...] = ()  # those of port torque; the first is the one that files state
    gives: tuple[BodyLaw, ...] = ()  # those of port body
    recorded: tuple[RecordLaw, ...] = ()  # those of port record, on forces and displacements
    rubs: tuple[FrictionLaw, ...] = ()  # those of a motor's torque in motion
    reads: Reader | None = None  # of bodies whose files have forms of their own; None: by what the laws declare
    default: str = ""  # law of a file that states none; empty: it must, where there are several
    elastic: bool = False  # stands in stiffness.yaml
    spoken: str = ""  # the noun where a sentence runs on; empty: the noun
    of: str = "of"  # between noun and place; empty: the noun says where it is
    at: Mapping[str, str] = field(default_factory=dict)  # places that are said in another way here
    form: float = FORM  # relative 1 sigma of its sizes for its own form
    plausible: Mapping[str, float] = field(
        default_factory=dict
    )  # most of its size, by unit: beyond it fits other things
    note: str = ""  # where it shows, e.g. "on load reversal"

    @property
    def paired(self) -> bool:
        """Between two joints: its law, which is linear, turns each by the torque of the other."""
        return bool(self.places) and "-" in self.places[0]

    @property
    def called(self) -> str:
        """In files and findings."""
        return self.word or self.name

    def law(self, word: str, stated: frozenset[str] = frozenset()) -> Law:
        """The law of a word, of several the first that has every key a file states."""
        known = [law for law in self.laws if law.word == word]
        keys = [{p.key for p in (*law.coefficients, *law.shape)} for law in known]
        return next((law for law, own in zip(known, keys, strict=True) if stated <= own), known[-1])

    @property
    def remembers(self) -> bool:
        """All its laws ask for a history."""
        return bool(self.laws) and all(law.remembers for law in self.laws)

    @property
    def words(self) -> tuple[str, ...]:
        """Of its laws, as files state them."""
        return tuple(dict.fromkeys(law.word for law in self.laws if law.word))


def joints_of(location: str) -> tuple[int, int]:
    """0-based, of ``joint:4-5``: the joint that drives and the one that is moved; of ``joint:3`` itself twice."""
    numbers = [int(n) - 1 for n in location.removeprefix("joint:").split("-")]
    return numbers[0], numbers[-1]


def timed(law: Law) -> bool:
    """It goes by time: one of its numbers is a time constant."""
    return any(p.unit == "s" for p in law.shape)


class Settled:
    """What most laws answer: nothing is taken, nothing bounds them, every torque shows them."""

    word = ""
    weighs = False
    remembers = False

    def steepest(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        return 0.0, np.nan

    def silent(self, loaded: Array, unloaded: Array, scale: Scale) -> str:
        return ""


def percent(value: float, compliance: float) -> Quantity:
    """A compliance as a share of the joint's own."""
    return Quantity(100.0 * value / compliance, "%")
