"""An effect: a word of the vocabulary and what stands behind it; here too is all that the author of a law imports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from machopt.effects.law_interfaces.joint_laws import (
    FrictionLaw,
    FrictionState,
    JointAngleLaw,
    JointAngleLawDefaults,
    JointAngleRange,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    JointSpeedRange,
    MotorLaw,
    MotorLoading,
    ParallelTorqueLaw,
    VibrationLaw,
    VibrationLoading,
    compute_compliance_percent,
    is_time_dependent,
)
from machopt.effects.law_interfaces.law_parameters import (
    ARCMIN,
    COMPLIANCE,
    DEFAULT_FORM_UNCERTAINTY,
    DEGREE,
    EXACT_FORM_UNCERTAINTY,
    JOINTS,
    MEMORIES,
    Ints,
    LawParameter,
    LawParameterSet,
    Port,
    Quantity,
    Shape,
)
from machopt.effects.law_interfaces.structure_and_record_laws import (
    BodyLaw,
    CompliantBody,
    DelayedChannel,
    DelayLaw,
    DriftLaw,
    PayloadLaw,
    Reader,
    RecordedLoad,
    RecordLaw,
    ThermalState,
    ToolSideLoad,
)

__all__ = [
    "ARCMIN",
    "COMPLIANCE",
    "DEFAULT_FORM_UNCERTAINTY",
    "DEGREE",
    "EXACT_FORM_UNCERTAINTY",
    "JOINTS",
    "MEMORIES",
    "BodyLaw",
    "CompliantBody",
    "DelayLaw",
    "DelayedChannel",
    "DriftLaw",
    "Effect",
    "FrictionLaw",
    "FrictionState",
    "Ints",
    "JointAngleLaw",
    "JointAngleLawDefaults",
    "JointAngleRange",
    "JointLaw",
    "JointLawDefaults",
    "JointLoadRange",
    "JointLoading",
    "JointSpeedRange",
    "LawParameter",
    "LawParameterSet",
    "MotorLaw",
    "MotorLoading",
    "ParallelTorqueLaw",
    "PayloadLaw",
    "Port",
    "Quantity",
    "Reader",
    "RecordLaw",
    "RecordedLoad",
    "Shape",
    "ThermalState",
    "ToolSideLoad",
    "VibrationLaw",
    "VibrationLoading",
    "compute_compliance_percent",
    "is_time_dependent",
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
    preferred_places: tuple[str, ...] = ()  # those of its places that a search tries; empty: all
    joint_laws: tuple[JointLaw, ...] = ()  # in the order in which they are tried
    angle_laws: tuple[JointAngleLaw, ...] = ()  # those of port angle; the first is the one that files state
    parallel_torque_laws: tuple[
        ParallelTorqueLaw, ...
    ] = ()  # those of port torque; the first is the one that files state
    body_laws: tuple[BodyLaw, ...] = ()  # those of port body
    record_laws: tuple[RecordLaw, ...] = ()  # those of port record, on forces and displacements
    friction_laws: tuple[FrictionLaw, ...] = ()  # those of a motor's torque in motion
    motor_laws: tuple[MotorLaw, ...] = ()  # those of what drives tell of their motors
    drift_laws: tuple[DriftLaw, ...] = ()  # those of time and temperature
    payload_laws: tuple[PayloadLaw, ...] = ()  # those of the load at the flange
    vibration_laws: tuple[VibrationLaw, ...] = ()  # those of a joint's spring in motion
    delay_laws: tuple[DelayLaw, ...] = ()  # those of what comes late
    file_reader: Reader | None = None  # of bodies whose files have forms of their own; None: by what the laws declare
    default_law: str = ""  # law of a file that states none; empty: it must, where there are several
    is_elastic: bool = False  # stands in stiffness.yaml
    short_noun: str = ""  # the noun where a sentence runs on; empty: the noun
    preposition: str = "of"  # between noun and place; empty: the noun says where it is
    place_wording: Mapping[str, str] = field(default_factory=dict)  # places that are said in another way here
    form_uncertainty: float = DEFAULT_FORM_UNCERTAINTY  # relative 1 sigma of its sizes for its own form
    plausible_sizes: Mapping[str, float] = field(
        default_factory=dict
    )  # most of its size, by unit: beyond it fits other things
    note: str = ""  # where it shows, e.g. "on load reversal"

    @property
    def is_joint_pair(self) -> bool:
        """Between two joints: its law, which is linear, turns each by the torque of the other."""
        return bool(self.places) and "-" in self.places[0]

    @property
    def search_places(self) -> tuple[str, ...]:
        """Places that a search tries."""
        return self.preferred_places or self.places

    @property
    def file_word(self) -> str:
        """In files and findings."""
        return self.word or self.name

    def find_law(self, word: str, stated: frozenset[str] = frozenset()) -> JointLaw:
        """The law of a word, of several the first that has every key a file states."""
        known = [law for law in self.joint_laws if law.word == word]
        keys = [{p.key for p in (*law.coefficients, *law.shape)} for law in known]
        return next((law for law, own in zip(known, keys, strict=True) if stated <= own), known[-1])

    @property
    def has_memory(self) -> bool:
        """All its laws ask for a history."""
        return bool(self.joint_laws) and all(law.has_memory for law in self.joint_laws)

    @property
    def law_words(self) -> tuple[str, ...]:
        """Of its laws, as files state them."""
        return tuple(dict.fromkeys(law.word for law in self.joint_laws if law.word))
