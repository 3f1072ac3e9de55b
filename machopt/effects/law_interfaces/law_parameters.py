"""Definitions shared by all laws: a parameter, a reported quantity, and the parameters that a file states for a law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import MOST_JOINTS, format_joint_location

Ints = NDArray[np.int64]
Shape = tuple[float, ...]

ARCMIN = np.pi / 10800.0  # rad
DEGREE = np.pi / 180.0  # rad
COMPLIANCE = "rad/(N·m)"
DEFAULT_FORM_UNCERTAINTY = (
    0.08  # relative 1 sigma of a size caused by the form of its law: real gears deviate from equations
)
EXACT_FORM_UNCERTAINTY = 0.02  # the same for an exact law: limited by the knowledge of the arm that it acts through
JOINTS = tuple(format_joint_location(i) for i in range(1, MOST_JOINTS + 1))
MEMORIES = (
    "cycle",
    "visit",
    "arrival",
    "session",
    "approach",
)  # kinds of load history of a gear, in the order of the search indices

Port = Literal["twist", "torque", "angle", "frame", "body", "record"]
"""Which local thing a law makes: twist of a joint by its torque, torque beside a gear, angle without load, where a
frame is built, twist of a body by its wrench, a change of the recording itself."""


@dataclass(frozen=True, kw_only=True)
class LawParameter:
    """A number of a law, or a row with one for each of its branches; a definition, never a value."""

    key: str  # in files, carries its unit
    unit: str  # SI, of values in the program
    factor: float = 1.0  # SI per unit of the key
    lower_limit: float = -np.inf  # in the unit of the key
    positive: bool = False  # above zero
    inverse: bool = False  # the key holds one over the number, which is left out where the number is zero
    required: bool = False  # not fitted: a file that uses this law must state it
    is_list: bool = False  # a list in files
    is_scalar_for_one_branch: bool = False  # a single branch is written as a number instead of a list
    name: str = ""  # report name of a coefficient if its SI unit differs from the key's unit
    magnitude_limit: float = (
        np.inf
    )  # largest absolute value in the unit of the key; a larger value indicates a wrong unit
    unit_in_words: str = ""  # the unit of the key in words, for error messages

    @property
    def report_key(self) -> str:
        return self.name or self.key


@dataclass(frozen=True)
class Quantity:
    """One number of a finding in the unit used in reports."""

    value: float
    unit: str  # "arcmin", "N·m/arcmin", "%", "ms" …


class LawParameterSet(Protocol):
    """Parameters that a file states for a law: P coefficients (the law is linear in them) and S shape parameters."""

    @property
    def word(self) -> str:
        """Name of the law in files, if the effect has several laws; else empty."""
        ...

    @property
    def coefficients(self) -> tuple[LawParameter, ...]: ...

    @property
    def shape(self) -> tuple[LawParameter, ...]: ...

    @property
    def has_memory(self) -> bool:
        """Whether the effect depends on the load history or on the time under load."""
        ...


class DescribedLaw(LawParameterSet, Protocol):
    """Law with the texts that a report shows."""

    @property
    def name(self) -> str:
        """Short name, for example "play", "bends and twists", "constant angle"."""
        ...

    @property
    def equation(self) -> str:
        """Equation with its source."""
        ...
