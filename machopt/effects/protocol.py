"""An effect: a word of the vocabulary and what stands behind it; here too is all that the author of a law imports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from machopt.effects.joint_ports import (
    Beside,
    Drive,
    Free,
    FrictionLaw,
    Geared,
    Law,
    MotorLaw,
    Pace,
    Rubbing,
    Scale,
    Settled,
    Swept,
    Swinging,
    SwingLaw,
    Unloaded,
    percent,
    timed,
)
from machopt.effects.nouns import (
    ARCMIN,
    COMPLIANCE,
    DEGREE,
    EXACT,
    FORM,
    JOINTS,
    MEMORIES,
    Ints,
    Parameter,
    Port,
    Quantity,
    Shape,
    Stated,
)
from machopt.effects.other_ports import (
    Body,
    BodyLaw,
    Carried,
    CarriedLaw,
    Delayed,
    DelayLaw,
    DriftLaw,
    Reader,
    Recorded,
    RecordLaw,
    Warming,
)

__all__ = [
    "ARCMIN",
    "COMPLIANCE",
    "DEGREE",
    "EXACT",
    "FORM",
    "JOINTS",
    "MEMORIES",
    "Beside",
    "Body",
    "BodyLaw",
    "Carried",
    "CarriedLaw",
    "DelayLaw",
    "Delayed",
    "DriftLaw",
    "Drive",
    "Effect",
    "Free",
    "FrictionLaw",
    "Geared",
    "Ints",
    "Law",
    "MotorLaw",
    "Pace",
    "Parameter",
    "Port",
    "Quantity",
    "Reader",
    "RecordLaw",
    "Recorded",
    "Rubbing",
    "Scale",
    "Settled",
    "Shape",
    "Stated",
    "Swept",
    "SwingLaw",
    "Swinging",
    "Unloaded",
    "Warming",
    "percent",
    "timed",
]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A word of the vocabulary and what stands behind it."""

    name: str  # "joint_hysteresis"; one thing in the program
    word: str = ""  # what files and findings call it, where two effects share a word; empty: the name
    noun: str  # "hysteresis"; its place follows
    sentence: str  # for the reader of a report
    port: Port
    places: tuple[str, ...]  # of an arm; empty: not listed, e.g. columns of a recording
    likely: tuple[str, ...] = ()  # those of its places that a search tries; empty: all
    laws: tuple[Law, ...] = ()  # in the order in which they are tried
    unloaded: tuple[Unloaded, ...] = ()  # those of port angle; the first is the one that files state
    beside: tuple[Beside, ...] = ()  # those of port torque; the first is the one that files state
    gives: tuple[BodyLaw, ...] = ()  # those of port body
    recorded: tuple[RecordLaw, ...] = ()  # those of port record, on forces and displacements
    rubs: tuple[FrictionLaw, ...] = ()  # those of a motor's torque in motion
    motors: tuple[MotorLaw, ...] = ()  # those of what drives tell of their motors
    drifts: tuple[DriftLaw, ...] = ()  # those of time and temperature
    carries: tuple[CarriedLaw, ...] = ()  # those of the load at the flange
    swings: tuple[SwingLaw, ...] = ()  # those of a joint's spring in motion
    delays: tuple[DelayLaw, ...] = ()  # those of what comes late
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
    def tried(self) -> tuple[str, ...]:
        """Places that a search tries."""
        return self.likely or self.places

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
