"""Rotary axes of a five-axis machine: tool axis, and tip without tool-centre-point control.

With ISO 841 signs a positive rotary word turns the tool, seen from the workpiece, right-handed about X (A), Y (B)
or Z (C), whether head or table moves. The tool axis of a machine whose axis P carries axis Q is then, for a head,
R_P R_Q z and, for a table (Q carries the workpiece), R_Q R_P z. With C on the table or at the foot of the head
both give R_Z(C) R_tilt z: for A and C (i, j, k) = (sin C sin A, −cos C sin A, cos A).

``-reversed``: a positive angle turns the *table* right-handed, as LinuxCNC's xyzac-trt and xyzbc-trt kinematics
do; all signs are opposite to ISO 841.

Machines that name or turn their axes otherwise are spelled out: ``table:B+Z,A-X`` is a table whose word B turns the
tool, seen from the workpiece, right-handed about Z and A left-handed about X, the axis that carries the workpiece
first (for a head: the foot first). A Haas trunnion with A and B is that one.

Without tool-centre-point control X, Y, Z are the machine's. Where the rotary axes lie is then part of the name:

* table: ``table-ab@x,y,z``, a point on the rotary axes (mm, in the program's zero with all angles 0), or two points
  ``@x,y,z/x,y,z`` where the axes do not meet, that of the axis which carries the workpiece first:
  p = c₁ + R_Q(c₂ + R_P(p_prog − c₂) − c₁);
* head: ``head-bc@250``, the distance L from the pivot to the tip (mm), X Y Z being those of the tip with the head
  upright: p = p_prog + L(z − n), n the tool axis;
* mixed: ``mixed-bc@250/x,y,z``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machopt.errors import OptionError
from machopt.numerics.array_types import Array
from machopt.path_building.coordinate_systems import SystemTransform, compute_axis_turn
from machopt.path_building.point_collector import Vector

_ORDERS = {  # name → axes in the order their matrices are multiplied, z last
    "table-ac": "CA",
    "table-bc": "CB",
    "head-ac": "CA",
    "head-bc": "CB",
    "mixed-ac": "CA",
    "mixed-bc": "CB",
    "table-ab": "BA",
    "table-ba": "AB",
    "head-ab": "AB",
    "head-ba": "BA",
    "table-a": "A",
    "table-b": "B",
    "table-c": "C",
    "head-a": "A",
    "head-b": "B",
    "three-axis": "",
}
MACHINES = tuple(name + end for name in _ORDERS for end in ("", "-reversed") if not (end and "table" not in name))
HELP = (
    "table-ac, table-bc, head-ac, head-bc, mixed-ac, mixed-bc (C turns the table or the head's foot), table-ab "
    "(A carries B), table-ba, head-ab, head-ba, table-a, table-b, table-c, head-a, head-b, three-axis; tables also "
    "with -reversed (LinuxCNC signs); or spelled out, e.g. table:B+Z,A-X"
)
PLACED_HELP = (
    "give --machine with the place of its axes, e.g. table-ac@0,0,-50 (a point on the rotary axes in the program's "
    "zero, mm) or head-bc@250 (pivot to tip, mm)"
)
_LETTER = {"A": "X", "B": "Y", "C": "Z"}
_SPELLED = re.compile(r"(table|head|mixed):([abc][+-][xyz](?:,[abc][+-][xyz])*)")
_FAR = 1e5  # mm: no pivot lies a hundred metres off


@dataclass(frozen=True)
class RotaryMachine:
    """Which rotary words turn the tool axis, and how."""

    name: str  # of MACHINES, or spelled out
    centres: tuple[Vector, ...] = ()  # of the table axes in the order of ``letters``, mm
    pivot: float | None = None  # mm from a head's pivot to the tip

    def __post_init__(self) -> None:
        if self.name not in MACHINES and not self.is_valid_spelling:
            raise OptionError(f"unknown machine {self.name!r}: known are {HELP}", where="--machine")

    @property
    def is_valid_spelling(self) -> bool:
        found = _SPELLED.fullmatch(self.name)
        letters = [part[0] for part in found.group(2).split(",")] if found else []
        return bool(letters) and len(set(letters)) == len(letters) and (len(letters) == 2 or "mixed" not in self.name)

    @property
    def kind(self) -> str:
        return self.name.replace(":", "-").partition("-")[0]

    @cached_property
    def axes(self) -> tuple[tuple[str, str, float], ...]:
        """(word, axis it turns about, sign) in the order the matrices are multiplied."""
        if ":" in self.name:
            parts = self.name.upper().partition(":")[2].split(",")
            return tuple((p[0], p[2], -1.0 if p[1] == "-" else 1.0) for p in parts)
        sign = -1.0 if self.name.endswith("-reversed") else 1.0
        return tuple((c, _LETTER[c], sign) for c in _ORDERS[self.name.removesuffix("-reversed")])

    @property
    def letters(self) -> str:
        return "".join(letter for letter, _, _ in self.axes)

    def turning_the_other_way(self) -> RotaryMachine:
        """The machine whose rotary signs are all opposite."""
        if ":" in self.name:
            return RotaryMachine(self.name.translate(str.maketrans("+-", "-+")))
        if self.name.endswith("-reversed"):
            return RotaryMachine(self.name.removesuffix("-reversed"))
        return RotaryMachine(self.name.replace("head", "table").replace("mixed", "table") + "-reversed")

    @property
    def has_known_tip(self) -> bool:
        """True where the tip is known without tool-centre-point control."""
        return {"table": bool(self.centres), "head": self.pivot is not None, "three": True}.get(
            self.kind, bool(self.centres) and self.pivot is not None
        )

    def tool_axis(self, angles_deg: dict[str, float]) -> Vector:
        """Compute the unit vector from tip to shank in workpiece coordinates.

        Args:
            angles_deg: Axis letter → angle, degrees.

        Returns:
            Unit vector.
        """
        x, y, z = 0.0, 0.0, 1.0
        for letter, about, sign in reversed(self.axes):
            angle = sign * math.radians(angles_deg.get(letter, 0.0))
            c, s = math.cos(angle), math.sin(angle)
            if about == "X":
                y, z = c * y - s * z, s * y + c * z
            elif about == "Y":
                x, z = c * x + s * z, c * z - s * x
            else:
                x, y = c * x - s * y, s * x + c * y
        return x, y, z

    def tip(self, angles_deg: dict[str, float]) -> SystemTransform:
        """Compute the transform from X, Y, Z without tool-centre-point control to the tip in the workpiece (mm).

        Args:
            angles_deg: Axis letter → angle, degrees.

        Returns:
            The transform.

        Raises:
            OptionError: the position of the axes was not given.
        """
        if not self.has_known_tip:
            raise OptionError(
                f"machine {self.name!r} does not state where its axes lie; {PLACED_HELP}", where="--machine"
            )
        rotations = [compute_axis_turn(about, sign * angles_deg.get(letter, 0.0)) for letter, about, sign in self.axes]
        if self.kind == "head":
            return SystemTransform(np.eye(3), self._compute_lean(rotations))
        if self.kind == "mixed":
            centre = np.array(self.centres[0])
            lean = SystemTransform(np.eye(3), self._compute_lean(rotations[1:]))
            return lean.then(SystemTransform(rotations[0], centre - rotations[0] @ centre))
        found = SystemTransform(np.eye(3), np.zeros(3))
        for k in reversed(range(len(rotations))):
            centre = np.array(self.centres[min(k, len(self.centres) - 1)])
            found = found.then(SystemTransform(rotations[k], centre - rotations[k] @ centre))
        return found

    def _compute_lean(self, rotations: list[Array]) -> Array:
        """L(z − n) of a head."""
        n = np.array([0.0, 0.0, 1.0])
        for rotation in reversed(rotations):
            n = rotation @ n
        return np.asarray((self.pivot or 0.0) * (np.array([0.0, 0.0, 1.0]) - n))


def parse_machine(text: str) -> RotaryMachine:
    """Parse a machine option, e.g. ``table-ac``, ``table-ab@0,0,-50`` or ``mixed-bc@250/0,0,0``.

    Args:
        text: Text of the option.

    Returns:
        The machine.

    Raises:
        OptionError: the name is unknown, or the text behind ``@`` does not fit it.
    """
    name, at, rest = text.strip().lower().partition("@")
    if not at:
        return RotaryMachine(name)
    kind = RotaryMachine(name).kind
    try:
        groups = [tuple(float(v) for v in part.split(",")) for part in rest.split("/")]
    except ValueError:
        groups = []
    pivot: float | None = None
    if kind in ("head", "mixed") and groups and len(groups[0]) == 1:
        pivot = groups.pop(0)[0]
    rotary = len(RotaryMachine(name).axes)
    wanted = {"table": range(1, rotary + 1), "mixed": range(1, 2), "head": range(1)}.get(kind, range(1))
    numbers = [v for g in groups for v in g] + ([] if pivot is None else [pivot])
    if (
        any(len(g) != 3 for g in groups)
        or len(groups) not in wanted
        or (kind in ("head", "mixed")) != (pivot is not None)
        or not all(abs(v) < _FAR for v in numbers)
    ):
        raise OptionError(
            f"machine {text!r}: expected e.g. table-ac@0,0,-50 or table-ac@0,0,0/0,0,-50 (points on the axes, mm), "
            "head-bc@250 (pivot to tip, mm), mixed-bc@250/0,0,0",
            where="--machine",
        )
    return RotaryMachine(name, tuple((g[0], g[1], g[2]) for g in groups), pivot)
