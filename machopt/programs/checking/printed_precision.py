"""Resolution of printed joint targets, from the number of printed decimals."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.programs.reading.parsed_program import ParsedProgram

MIN_DECIMALS, MAX_DECIMALS = 4, 9  # decimals: of a program whose values happen to be round, four are taken
ROUNDING_TOLERANCE = 1e-12  # of a value read and rounded again


def compute_target_step(parsed: ParsedProgram, reach: float) -> float:
    """m, what the last digits of joint targets are worth together where they are worth most.

    Args:
        parsed: a program; values in pulses and in units that no number of decimals explains count nothing.
        reach: m, the lever of a joint that turns.
    """
    turning = compute_last_digit(parsed.axes_deg)
    per_joint = np.radians(turning) if turning else compute_last_digit(np.radians(parsed.axes_deg))
    external = parsed.external.copy()
    for row, words in zip(external, parsed.configuration, strict=True):
        units = words.get("external")
        if isinstance(units, tuple):
            row[[k for k, unit in enumerate(units[: len(row)]) if unit == "pulse"]] = np.nan
    others = compute_last_digit(external) * int(
        np.isfinite(external).any(axis=0).sum()
    )  # mm or deg: a degree moves more
    return 0.5 * reach * (6.0 * float(per_joint) + float(np.radians(others)))


def compute_last_digit(values: Array) -> float:
    """Return the value of one unit of the last printed digit; 0 where there are more than nine decimals.

    Args:
        values: Numbers as they were read; those that are not finite are ignored.
    """
    known = values[np.isfinite(values)]
    for decimals in range(MIN_DECIMALS, MAX_DECIMALS + 1):
        if (np.abs(np.round(known, decimals) - known) <= ROUNDING_TOLERANCE * np.maximum(np.abs(known), 1.0)).all():
            return float(10.0**-decimals) if len(known) else 0.0
    return 0.0
