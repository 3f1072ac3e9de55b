"""Names of model discrepancies in a stiffness file's ``discrepancy``: ``joint 3``, ``coupling 4-5``, ``base rx`` ….

Files and models hold the text; this module parses and formats it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

AXES = ("x", "y", "z", "rx", "ry", "rz")  # of a body's compliance
JOINT, COUPLING, COS, SIN, TERM, LOADED = "joint", "coupling", "cos", "sin", "term", "loaded"


@dataclass(frozen=True)
class DiscrepancyName:
    """A name's parts."""

    kind: str  # one of this module's words, of what bends with a joint's torque its own; of a body its location
    numbers: tuple[int, ...] = ()  # 0-based joint or joints; of a term its place in the file and its coefficient
    axis: int = -1  # of a body, into AXES


@lru_cache(maxsize=1024)
def parse_discrepancy_name(text: str) -> DiscrepancyName:
    """Return the parts of a name.

    Args:
        text: The name.

    Raises:
        ValueError: it is no such name.
    """
    kind, _, rest = text.partition(" ")
    if rest in AXES:
        return DiscrepancyName(kind, axis=AXES.index(rest))
    if kind == TERM:
        place, coefficient = rest.split()
        return DiscrepancyName(kind, (int(place), int(coefficient)))
    return DiscrepancyName(kind, tuple(int(n) - 1 for n in rest.split("-")) if rest else ())


def format_joint_name(kind: str, joint: int) -> str:
    """Return the name of a joint discrepancy: ``joint 3``, ``play 3`` ….

    Args:
        kind: Kind of the discrepancy.
        joint: The joint, counted from 1.
    """
    return f"{kind} {joint}"


def format_joint_pair_name(i: int, j: int) -> str:
    """Return the name of a coupling: ``coupling 4-5``.

    Args:
        i: First joint, counted from 1.
        j: Second joint, counted from 1.
    """
    return f"{COUPLING} {i}-{j}"


def format_term_name(place: int, coefficient: int) -> str:
    """Return the name of a term's coefficient: ``term 0 1``.

    Args:
        place: Number of the term in the file, from 0.
        coefficient: Number of the coefficient, from 0.
    """
    return f"{TERM} {place} {coefficient}"


def format_body_name(location: str, axis: str) -> str:
    """Return the name of a body compliance: ``link:2 rx``.

    Args:
        location: Location of the body.
        axis: Axis of the compliance.
    """
    return f"{location} {axis}"
