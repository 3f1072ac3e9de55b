"""Conversion from SI to displayed units: mm, deg, mm/min, N/µm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from machopt.report.page_types.optimize_page_data import Quantity


def format_fixed(value: float, decimals: int, *, signed: bool = False) -> str:
    """Return a number with fixed decimals and a true minus sign; a value that rounds to zero has no sign.

    Args:
        value: The value.
        decimals: Number of decimals.
        signed: Write a plus sign for positive values.
    """
    rounded = round(value, decimals) + 0.0
    return f"{rounded:{'+' if signed and rounded else ''}.{decimals}f}".replace("-", "−")


def format_option_value(value: object) -> str:
    """Return an option's value as text: yes, no, none, a list without brackets.

    Args:
        value: Value of the option.
    """
    if value is None or (isinstance(value, list | tuple | dict) and not value):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(format_option_value(v) for v in value)
    return str(value)


@dataclass(frozen=True)
class DisplayUnit:
    """Displayed unit: shown = SI · factor."""

    factor: float
    name: str
    decimals: int

    def format_value(self, value: float, *, unit: bool = False) -> str:
        """Return the value in the displayed unit, "–" where there is none.

        Args:
            value: Value, SI.
            unit: Append the unit's name.
        """
        if not math.isfinite(value):
            return "–"
        number = format_fixed(value * self.factor, self.decimals)
        return f"{number} {self.name}".rstrip() if unit else number


LENGTH = DisplayUnit(1e3, "mm", 1)
FINE_LENGTH = DisplayUnit(1e3, "mm", 3)
ANGLE = DisplayUnit(180 / math.pi, "deg", 1)
FEED = DisplayUnit(6e4, "mm/min", 0)
STIFFNESS = DisplayUnit(1e-6, "N/µm", 3)
FORCE = DisplayUnit(1.0, "N", 0)
TIME = DisplayUnit(1.0, "s", 1)
FINE_TIME = DisplayUnit(1.0, "s", 2)
SHARE = DisplayUnit(100.0, "%", 1)
DIMENSIONLESS = DisplayUnit(1.0, "", 3)

QUANTITY_UNITS: dict[Quantity, DisplayUnit] = {
    "deflection": FINE_LENGTH,
    "stiffness": STIFFNESS,
    "index": DIMENSIONLESS,
}


@dataclass(frozen=True)
class QuantityLabels:
    """Wording of the optimised quantity."""

    worst: str
    axis: str
    better: str  # direction that is good
    large_is_good: bool


QUANTITY_LABELS: dict[Quantity, QuantityLabels] = {
    "deflection": QuantityLabels("Predicted worst deflection", "Deflection", "lower is better", False),
    "stiffness": QuantityLabels("Predicted least stiffness", "Stiffness", "higher is better", True),
    "index": QuantityLabels("Least stiffness index", "Index", "higher is better", True),
}
