"""Types of Sinumerik variables: definitions by DEF, and the value that a variable takes when it is assigned.

Source: Siemens, Programming Manual Job Planning (6FC5398-2BP40-0BA0), "Implicit data type conversions": from REAL to
INT a fraction of 0.5 and more is rounded up, a smaller one down; to BOOL a value other than zero is TRUE. "Data types":
INT -2147483646 … 2147483647, CHAR 0 … 255; a value outside is an alarm.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError

NUMBER_TYPES = ("REAL", "INT", "BOOL", "CHAR")
MAX_ELEMENTS = 10_000
_RANGES = {"INT": (-2147483646.0, 2147483647.0), "CHAR": (0.0, 255.0)}
_NAME = re.compile(r"\s*([A-Z_]\w*)\s*(?:\[\s*([0-9]+)\s*\])?\s*")
_SET = re.compile(r"\s*(SET|REP)\s*\((.*)\)\s*")


def round_half_up(value: float) -> float:
    """Return the whole number that the control rounds to: a fraction of 0.5 is rounded up."""
    return float(math.floor(value + 0.5))


def round_away(value: float) -> float:
    """Carry out ROUNDUP.

    Raises:
        MacroExpressionError: the value is negative and no whole number; editions of the manual give -3 and -4 for -3.1.
    """
    if value < 0.0 and value != round(value):
        raise MacroExpressionError(
            f"ROUNDUP({value:g}): the direction of negative values differs between controls; write the number itself"
        )
    return float(math.ceil(value))


def compute_remainder(a: float, b: float) -> float:
    """Carry out MOD, which is for whole numbers.

    Raises:
        MacroExpressionError: a number is not whole.
    """
    if a != round(a) or b != round(b):
        raise MacroExpressionError(f"{a:g} MOD {b:g}: expected whole numbers")
    return math.fmod(a, b)


def convert_to_type(value: float, kind: str, name: str) -> float:
    """Convert a value as an assignment to a variable does.

    Args:
        value: The value assigned.
        kind: Type of the variable, one of ``NUMBER_TYPES``.
        name: Name of the variable, for the error.

    Returns:
        The value that the variable takes.

    Raises:
        MacroExpressionError: the type does not hold the value.
    """
    if kind == "BOOL":
        return float(value != 0.0)
    if kind not in _RANGES:
        return value
    whole = round_half_up(value)
    low, high = _RANGES[kind]
    if not low <= whole <= high:
        raise MacroExpressionError(f"{name} is of type {kind}: {value:g} is outside {low:.0f} to {high:.0f}")
    return whole


@dataclass(frozen=True)
class VariableDefinition:
    """One variable of a DEF."""

    name: str
    size: int | None  # of an array; None: no array
    values: str  # text of the value, or of the list of values; empty: zero
    repeats: bool  # REP: one value in every element


def parse_definitions(parts: list[str]) -> list[VariableDefinition]:
    """Parse the variables behind the type of a DEF.

    Args:
        parts: Text of each variable, split at the commas outside of brackets.

    Raises:
        MacroExpressionError: a variable is malformed or has two dimensions.
    """
    found = []
    for part in parts:
        head, equals, value = part.partition("=")
        name = _NAME.fullmatch(head)
        if name is None or (equals and not value.strip()):
            raise MacroExpressionError(
                f"DEF {part.strip()[:30]!r}: expected a name (A) or a name with one size (A[10]), and a value behind ="
            )
        size = None if name.group(2) is None else int(name.group(2))
        listed = _SET.fullmatch(value)
        if size is not None and not 1 <= size <= MAX_ELEMENTS:
            raise MacroExpressionError(f"DEF {name.group(1)}[{size}]: expected 1 to {MAX_ELEMENTS} elements")
        if (listed is not None) != (size is not None and bool(equals)):
            raise MacroExpressionError(
                f"DEF {part.strip()[:30]!r}: expected SET(…) or REP(…) for an array and one value for a variable"
            )
        values, repeats = (listed.group(2), listed.group(1) == "REP") if listed else (value.strip(), False)
        found.append(VariableDefinition(name.group(1), size, values, repeats))
    return found
