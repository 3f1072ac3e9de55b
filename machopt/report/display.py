"""The one place where SI becomes what a process engineer reads: mm, deg, mm/min, N/µm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from machopt.report.data import Quantity


def fixed(value: float, decimals: int, *, signed: bool = False) -> str:
    """So many decimals with a true minus sign; what rounds to zero has none."""
    rounded = round(value, decimals) + 0.0
    return f"{rounded:{'+' if signed and rounded else ''}.{decimals}f}".replace("-", "−")


def in_words(value: object) -> str:
    """An option's value as a reader takes it: yes, no, none, a list without brackets."""
    if value is None or (isinstance(value, list | tuple | dict) and not value):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(in_words(v) for v in value)
    return str(value)


@dataclass(frozen=True)
class Unit:
    """A displayed unit: shown = SI · factor."""

    factor: float
    name: str
    decimals: int

    def text(self, value: float, *, unit: bool = False) -> str:
        """The value as shown, "–" where there is none."""
        if not math.isfinite(value):
            return "–"
        number = fixed(value * self.factor, self.decimals)
        return f"{number} {self.name}".rstrip() if unit else number


LENGTH = Unit(1e3, "mm", 1)
FINE_LENGTH = Unit(1e3, "mm", 3)
ANGLE = Unit(180 / math.pi, "deg", 1)
FEED = Unit(6e4, "mm/min", 0)
STIFFNESS = Unit(1e-6, "N/µm", 3)
TIME = Unit(1.0, "s", 1)
MOMENT = Unit(1.0, "s", 2)
SHARE = Unit(100.0, "%", 1)
BARE = Unit(1.0, "", 3)

QUANTITY: dict[Quantity, Unit] = {"deflection": FINE_LENGTH, "stiffness": STIFFNESS, "index": BARE}


@dataclass(frozen=True)
class QuantityWords:
    """How the optimised quantity is spoken of."""

    worst: str
    axis: str
    better: str  # direction that is good
    large_is_good: bool


WORDS: dict[Quantity, QuantityWords] = {
    "deflection": QuantityWords("Predicted worst deflection", "Deflection", "lower is better", False),
    "stiffness": QuantityWords("Predicted least stiffness", "Stiffness", "higher is better", True),
    "index": QuantityWords("Least stiffness index", "Index", "higher is better", True),
}
