"""The class :class:`Effect`, together with the names that the author of a law imports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from machopt.effects.law_interfaces.joint_laws import (
    JointAngleLaw,
    JointAngleLawDefaults,
    JointAngleRange,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    ParallelTorqueLaw,
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
from machopt.effects.law_interfaces.motion_laws import (
    FrictionLaw,
    FrictionState,
    JointSpeedRange,
    MotorLaw,
    MotorLoading,
    VibrationLaw,
    VibrationLoading,
)
from machopt.effects.law_interfaces.recording_and_payload_laws import (
    DelayedChannel,
    DelayLaw,
    PayloadLaw,
    RecordedLoad,
    RecordLaw,
    ToolSideLoad,
)
from machopt.effects.law_interfaces.structure_laws import BodyLaw, CompliantBody, DriftLaw, Reader, ThermalState

__all__ = [
    "ARCMIN",
    "COMPLIANCE",
    "DEFAULT_FORM_UNCERTAINTY",
    "DEGREE",
    "EXACT_FORM_UNCERTAINTY",
    "JOINTS",
    "MEMORIES",
    "UNCATALOGUED",
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

UNCATALOGUED = "unnamed"  # effect of an explanation that is none of the catalogue


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One effect of the vocabulary: its name, texts, places and laws."""

    name: str  # unique in the program, e.g. "joint_hysteresis"
    word: str = ""  # name in files and findings if two effects share one; empty: the name
    noun: str  # e.g. "hysteresis"; the place follows in texts
    sentence: str  # one-sentence explanation for reports
    port: Port
    places: tuple[str, ...]  # of an arm; empty: not listed, e.g. columns of a recording
    preferred_places: tuple[str, ...] = ()  # places that a search tries; empty: all
    joint_laws: tuple[JointLaw, ...] = ()  # in the order in which they are tried
    angle_laws: tuple[JointAngleLaw, ...] = ()  # port angle; files state the first one
    parallel_torque_laws: tuple[ParallelTorqueLaw, ...] = ()  # port torque; files state the first one
    body_laws: tuple[BodyLaw, ...] = ()  # port body
    record_laws: tuple[RecordLaw, ...] = ()  # port record, of forces and displacements
    friction_laws: tuple[FrictionLaw, ...] = ()  # of the motor torque in motion
    motor_laws: tuple[MotorLaw, ...] = ()  # of the recorded drive torques
    drift_laws: tuple[DriftLaw, ...] = ()  # of time and temperature
    payload_laws: tuple[PayloadLaw, ...] = ()  # of the load at the flange
    vibration_laws: tuple[VibrationLaw, ...] = ()  # of a joint's spring in motion
    delay_laws: tuple[DelayLaw, ...] = ()  # of time delays
    file_reader: Reader | None = None  # reader for bodies with special file forms; None: by the declared parameters
    default_law: str = ""  # law of a file that states none; empty: a file must state one of several
    is_elastic: bool = False  # is stated in stiffness.yaml
    short_noun: str = ""  # noun inside a sentence; empty: the noun
    preposition: str = "of"  # between noun and place; empty: the noun contains the place
    place_wording: Mapping[str, str] = field(default_factory=dict)  # special wording of places
    form_uncertainty: float = DEFAULT_FORM_UNCERTAINTY  # relative 1 sigma of its sizes caused by the form of its law
    plausible_sizes: Mapping[str, float] = field(
        default_factory=dict
    )  # largest plausible size by unit; a larger fit describes something else
    note: str = ""  # where it is visible, e.g. "on load reversal"

    @property
    def is_joint_pair(self) -> bool:
        """Whether it couples two joints: its linear law twists each joint by the torque of the other."""
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
        """Return the joint law of a word.

        Args:
            word: Name of the law in files; empty for the only one.
            stated: Keys that the file states; of several laws the first one that has all of them is returned.

        Returns:
            The law.
        """
        known = [law for law in self.joint_laws if law.word == word]
        keys = [{p.key for p in (*law.coefficients, *law.shape)} for law in known]
        return next((law for law, own in zip(known, keys, strict=True) if stated <= own), known[-1])

    @property
    def has_memory(self) -> bool:
        """Whether all its joint laws depend on the load history."""
        return bool(self.joint_laws) and all(law.has_memory for law in self.joint_laws)

    @property
    def law_words(self) -> tuple[str, ...]:
        """Of its laws, as files state them."""
        return tuple(dict.fromkeys(law.word for law in self.joint_laws if law.word))
