"""Unit of the meshes of a new cell: as given, else metres unless a body would be too large for the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from machopt.cell.mesh import read_collada_surface, read_surface
from machopt.cell_setup.template.init_request import UNITS
from machopt.errors import InputError, MeshError, OptionError

LARGEST = {"link": 2.0, "tool": 1.5, "workpiece": 3.0}
"""Spans of the arm, end to end, that a body is long at most. In mm every body is a thousand times longer."""


@dataclass(frozen=True)
class MeshUnit:
    """Metres per unit of a mesh file, and a note where that is not a metre by the file's own word."""

    scale: float
    note: str | None


def detect_unit(
    file: Path, role: Literal["link", "tool", "workpiece"], span: float, unit: str | None = None, scale: float = 1.0
) -> MeshUnit:
    """Return the unit of a mesh.

    Args:
        file: the mesh.
        role: what it is.
        span: m, of the arm's links end to end.
        unit: as the user states it; None: by the size.
        scale: m per unit of the file as far as it is known.

    Raises:
        InputError: the mesh cannot be read.
    """

    def fail(message: str) -> InputError:
        return MeshError(message, file=file)

    if file.suffix.lower() == ".dae" and role != "link":
        read_collada_surface(file, fail)
        if unit is not None:
            raise OptionError(f"has no effect on {file.name}, which states its unit", where="--mesh-unit")
        return MeshUnit(1.0, None)
    if unit is not None and role != "link":
        return MeshUnit(UNITS[unit], None)
    extent = read_surface(file, fail).extent * scale
    if not span > 0.0 or extent <= LARGEST[role] * span:
        return MeshUnit(scale, None)
    other = scale * UNITS[unit or "mm"]
    return MeshUnit(
        other,
        f"{file.name} would be {extent:.4g} m long, so it is taken in {unit or 'mm'}: {extent * other / scale:.4g} m "
        "(--mesh-unit)",
    )
