"""Parts of a cell made of what was read: no file is opened here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import JointLimits, Shape, Tool, Workpiece
from machopt.domain.program import JointMap
from machopt.errors import InputError
from machopt.formats.cell_schema import JointMapKeys, ShapeKeys
from machopt.formats.urdf import Urdf
from machopt.formats.yamlstrict import Document


def first_taken(tools: Mapping[str, Tool]) -> list[str]:
    """A sentence where there are several tools; none for one."""
    if len(tools) < 2:
        return []
    return [f"of the tools {', '.join(tools)} the first is taken by commands that no toolpath tells which"]


def any_of(tools: Mapping[str, Tool]) -> Tool:
    """One tool with the bodies of all, for pairs that may touch by their names."""
    first = next(iter(tools.values()))
    bodies = {shape.name: shape for tool in tools.values() for shape in tool.geometry}
    cutter = next((tool.cutter for tool in tools.values() if tool.cutter is not None), None)
    return replace(first, geometry=tuple(bodies.values()), cutter=cutter)


def joint_map_of(keys: JointMapKeys) -> JointMap:
    """How the controller counts the joints."""
    coupling = np.zeros((6, 6))
    for axis, sources in keys.coupling.items():
        for other, factor in sources.items():
            coupling[int(axis[1]) - 1, int(other[1]) - 1] = factor
    return JointMap(frozen(np.array(keys.sign)), frozen(np.array(keys.offset_deg)), frozen(coupling))


def frozen(array: Array) -> Array:
    """A copy that cannot be written to."""
    out = np.array(array, float)
    out.setflags(write=False)
    return out


def frozen_limits(limits: JointLimits) -> JointLimits:
    """A copy that cannot be written to."""
    rows = limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk
    return JointLimits(*map(frozen, rows))


def of_file(file: Path, message: str) -> InputError:
    """What is wrong with a file."""
    return InputError(message, file=file)


def xacro_word(value: str | float | bool) -> str:
    """An argument as xacro's own command line would have it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) and value.is_integer() else str(value)


def unused_words(urdf: Urdf) -> tuple[str, ...]:
    """A sentence on elements of the description that are not used; none where there are none."""
    if not urdf.unused:
        return ()
    found = ", ".join(f"{tag} ({n})" for tag, n in urdf.unused.items())
    return (f"{urdf.path.name}: elements that say nothing of bodies, masses and joints, not used: {found}",)


def different_names(document: Document, *shapes: Shape) -> None:
    """Refuse two bodies of one name.

    Raises:
        InputError: there are two.
    """
    seen: set[str] = set()
    for s in shapes:
        if s.name in seen:
            raise InputError(
                f"two bodies are named {s.name!r}; all names of shapes must differ",
                file=document.file,
                where="obstacles",
            )
        seen.add(s.name)


def missing_bodies(tool: Tool, workpiece: Workpiece) -> list[str]:
    """What is not described cannot be checked for collisions; the user should know."""
    return [
        f"the cell has no {key}, so collisions with the {key.split('.')[0]} are not checked"
        for key, there in (("tool.geometry", tool.geometry), ("workpiece.geometry", workpiece.geometry))
        if not there
    ]


def unseen_links(urdf: Urdf) -> list[str]:
    """What of the robot is not checked for collisions."""
    name, drawn = urdf.path.name, [p.name for p in urdf.parts if p.visuals and not p.collisions]
    if not urdf.has_collision:
        return [f"{name} has no collision geometry, so the arm's own body is not checked"]
    if drawn:
        return [f"{name} has no collision geometry for the links {', '.join(drawn)}: what touches them is not seen"]
    return []


def given_solid(keys: ShapeKeys) -> tuple[Literal["box", "cylinder", "sphere"], list[float]]:
    """Kind and sizes in mm of a body that is no mesh; the schema lets exactly one through."""
    if keys.box_mm is not None:
        return "box", keys.box_mm
    if keys.cylinder_mm is not None:
        return "cylinder", keys.cylinder_mm
    return "sphere", [keys.sphere_mm or 0.0]
