"""What the verification asks of a maker's ``checks.py``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from machopt.data_types.robot_program import RobotController, RobotProgram
from machopt.programs.reading.parsed_program import ParsedProgram
from machopt.programs.writing.blend_zones import BlendZones

SLACK = 2e-4  # deg: axes are printed to 1e-4 at least
ZONE_STEP_RATIO = 1.7  # between two preferred numbers: coordinates are printed, so a zone may fall to its neighbour

Words = Mapping[str, object]


@dataclass(frozen=True, kw_only=True)
class ArmPosture:
    """One target of a program, from the joints of the planned motion.

    An axis that lies on a boundary as printed may count to either side.
    """

    axes_deg: list[float]  # 6, as the controller counts them
    wrist_behind: bool | None  # wrist root behind axis 1; None where the arm has no such
    elbow_up: bool | None
    nonflip_j5: Literal["negative", "positive"] | None = None  # FANUC's N
    low: list[float] = field(init=False)
    high: list[float] = field(init=False)
    is_negative: list[set[bool]] = field(init=False)  # accepted values of each axis

    def __post_init__(self) -> None:
        object.__setattr__(self, "low", [v - SLACK for v in self.axes_deg])
        object.__setattr__(self, "high", [v + SLACK for v in self.axes_deg])
        object.__setattr__(self, "is_negative", [{a < 0.0, b < 0.0} for a, b in zip(self.low, self.high, strict=True)])


@dataclass(frozen=True)
class ZoneCase:
    """A program whose zones are checked."""

    parsed: ParsedProgram  # as it was read
    program: RobotProgram  # as the post takes it
    law: BlendZones  # of the moves' ends
    controller: RobotController
    printed: float  # m, rounding error of two targets that mean one place


def _compare_nothing(program_words: Words, posture: ArmPosture) -> list[bool]:
    return []


def _copy_nothing(words: Sequence[Words]) -> dict[str, Sequence[object]]:
    return {}


@dataclass(frozen=True)
class ProgramChecks:
    """Checks of one maker; a maker without any has these defaults."""

    compare_words: Callable[[Words, ArmPosture], list[bool]] = _compare_nothing
    """Whether the words of a move that name its configuration are those of its joints, one for each known word."""
    find_wrong_zones: Callable[[ZoneCase], list[tuple[int, str]]] | None = None
    """(move, what is wrong) where zones are words; None: they are distances, which all makers share."""
    list_rounded_shares: Callable[[Sequence[Words]], Sequence[float]] | None = None
    """Shares of the joint moves to and from each target over which it is rounded, where the program gives shares and no
    distances; NaN where it does not."""
    copy_printed_columns: Callable[[Sequence[Words]], dict[str, Sequence[object]]] = _copy_nothing
    """Columns as the program has them whose last digit depends on rounding; their rule is checked separately."""


def read_whole_number(words: Words, name: str) -> int:
    """Return a whole number of a move's words; 0 where it has none.

    Args:
        words: ``ParsedProgram.configuration`` of the move.
        name: Key of the number.
    """
    value = words.get(name, 0)
    return value if isinstance(value, int) else 0
