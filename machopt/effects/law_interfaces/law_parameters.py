"""What all laws share: a parameter's definition, a number of a finding, what a file states of a law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.locations import format_joint_location

Ints = NDArray[np.int64]
Shape = tuple[float, ...]

ARCMIN = np.pi / 10800.0  # rad
DEGREE = np.pi / 180.0  # rad
COMPLIANCE = "rad/(N·m)"
DEFAULT_FORM_UNCERTAINTY = (
    0.08  # relative 1 sigma of a size for a law's own form: no gear, beam or loop is quite like its equation
)
EXACT_FORM_UNCERTAINTY = 0.02  # the same where a law is exact: what it acts through is known to about that
JOINTS = tuple(format_joint_location(i) for i in range(1, 7))
MEMORIES = ("cycle", "visit", "arrival", "session", "approach")  # of a gear, in the order that searches number them

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
    required: bool = False  # no fit searches for it: a file that means this law states it
    is_list: bool = False  # a list in files
    is_scalar_for_one_branch: bool = False  # of one branch alone, the number without a list
    name: str = ""  # of a coefficient where it is reported in SI and the key's unit is another
    magnitude_limit: float = np.inf  # to either side, in the unit of the key: beyond it the number is in another unit
    unit_in_words: str = ""  # the unit of the key in words, where refusals say it

    @property
    def report_key(self) -> str:
        return self.name or self.key


@dataclass(frozen=True)
class Quantity:
    """One number of a finding in the unit of the trade."""

    value: float
    unit: str  # "arcmin", "N·m/arcmin", "%", "ms" …


class LawParameterSet(Protocol):
    """What a file states of a law: P coefficients in which it is linear, S numbers that give its shape."""

    @property
    def word(self) -> str:
        """In files, where the effect has several laws; empty: a file states none."""
        ...

    @property
    def coefficients(self) -> tuple[LawParameter, ...]: ...

    @property
    def shape(self) -> tuple[LawParameter, ...]: ...

    @property
    def has_memory(self) -> bool:
        """How a torque came there, or since when it has been there, makes a difference."""
        ...


class DescribedLaw(LawParameterSet, Protocol):
    """What a report says of a law beside that."""

    @property
    def name(self) -> str:
        """ "play", "bends and twists", "constant angle"."""
        ...

    @property
    def equation(self) -> str:
        """With its source."""
        ...
