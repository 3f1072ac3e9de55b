"""Tool axis in workpiece coordinates from the rotary angles of a five-axis machine under tool-centre-point control.

With ISO 841 signs a positive rotary word turns the tool, seen from the workpiece, right-handed about X (A), Y (B)
or Z (C), whether head or table moves. The tool axis of a machine whose axis P carries axis Q is then, for a head,
R_P R_Q z and, for a table (Q carries the workpiece), R_Q R_P z. With C on the table or at the foot of the head
both give R_Z(C) R_tilt z: for A and C (i, j, k) = (sin C sin A, −cos C sin A, cos A).

``-reversed``: a positive angle turns the *table* right-handed, as LinuxCNC's xyzac-trt and xyzbc-trt kinematics
do; all signs are opposite to ISO 841.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.domain.toolpath import Array
from machopt.errors import InputError

_ORDERS = {  # name → axes in the order their matrices are multiplied, z last
    "table-ac": "CA", "table-bc": "CB", "head-ac": "CA", "head-bc": "CB", "mixed-ac": "CA", "mixed-bc": "CB",
    "table-ab": "BA", "table-ba": "AB", "head-ab": "AB", "head-ba": "BA",
    "table-a": "A", "table-b": "B", "head-a": "A", "head-b": "B", "three-axis": "",
}  # fmt: skip
MACHINES = tuple(name + end for name in _ORDERS for end in ("", "-reversed") if not (end and "table" not in name))
HELP = (
    "table-ac, table-bc, head-ac, head-bc, mixed-ac, mixed-bc (C turns the table or the head's foot), table-ab "
    "(A carries B), table-ba, head-ab, head-ba, table-a, table-b, head-a, head-b, three-axis; tables also with "
    "-reversed (LinuxCNC signs)"
)


@dataclass(frozen=True)
class Rotary:
    """Which rotary words turn the tool axis, and how."""

    name: str

    def __post_init__(self) -> None:
        if self.name not in MACHINES:
            raise InputError(f"unknown machine {self.name!r}: known are {HELP}", where="machine")

    @property
    def letters(self) -> str:
        return _ORDERS[self.name.removesuffix("-reversed")]

    @property
    def sign(self) -> float:
        return -1.0 if self.name.endswith("-reversed") else 1.0

    def tool_axis(self, angles_deg: dict[str, float]) -> tuple[float, float, float]:
        """Unit vector from tip to shank in workpiece coordinates."""
        axis = np.array([0.0, 0.0, 1.0])
        for letter in reversed(self.letters):
            axis = _turn(letter, self.sign * math.radians(angles_deg.get(letter, 0.0))) @ axis
        x, y, z = axis.tolist()
        return x, y, z


def _turn(letter: str, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    if letter == "A":
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    if letter == "B":
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
