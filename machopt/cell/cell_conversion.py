"""Parts of a cell made of what was read: no file is opened here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from machopt.cell.cell_schema import JointMapKeys, ShapeKeys
from machopt.cell.urdf import UrdfModel
from machopt.data_types.cell import CollisionShape, JointLimits, Tool, Workpiece
from machopt.data_types.robot_program import JointMap
from machopt.errors import CellError, InputError
from machopt.file_formats.strict_yaml import YamlDocument
from machopt.numerics.array_types import Array


def describe_tool_choice(tools: Mapping[str, Tool]) -> list[str]:
    """A sentence where there are several tools; none for one."""
    if len(tools) < 2:
        return []
    return [f"of the tools {', '.join(tools)} the first is taken by commands that no toolpath tells which"]


def combine_tools(tools: Mapping[str, Tool]) -> Tool:
    """One tool with the bodies of all, for pairs that may touch by their names."""
    first = next(iter(tools.values()))
    bodies = {shape.name: shape for tool in tools.values() for shape in tool.geometry}
    cutter = next((tool.cutter for tool in tools.values() if tool.cutter is not None), None)
    return replace(first, geometry=tuple(bodies.values()), cutter=cutter)


def build_joint_map(keys: JointMapKeys) -> JointMap:
    """How the controller counts the joints."""
    coupling = np.zeros((6, 6))
    for axis, sources in keys.coupling.items():
        for other, factor in sources.items():
            coupling[int(axis[1]) - 1, int(other[1]) - 1] = factor
    return JointMap(
        copy_read_only(np.array(keys.sign)), copy_read_only(np.array(keys.offset_deg)), copy_read_only(coupling)
    )


def copy_read_only(array: Array) -> Array:
    """A copy that cannot be written to."""
    out = np.array(array, float)
    out.setflags(write=False)
    return out


def copy_limits_read_only(limits: JointLimits) -> JointLimits:
    """A copy that cannot be written to."""
    rows = limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk
    return JointLimits(*map(copy_read_only, rows))


def build_file_error(file: Path, message: str) -> InputError:
    """What is wrong with a file."""
    return CellError(message, file=file)


def format_xacro_argument(value: str | float | bool) -> str:
    """An argument as xacro's own command line would have it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) and value.is_integer() else str(value)


def describe_unused_elements(urdf: UrdfModel) -> tuple[str, ...]:
    """A sentence on elements of the description that are not used; none where there are none."""
    if not urdf.unused_elements:
        return ()
    found = ", ".join(f"{tag} ({n})" for tag, n in urdf.unused_elements.items())
    return (f"{urdf.path.name}: elements that say nothing of bodies, masses and joints, not used: {found}",)


def check_unique_names(document: YamlDocument, *shapes: CollisionShape) -> None:
    """Refuse two bodies of one name.

    Raises:
        InputError: there are two.
    """
    seen: set[str] = set()
    for s in shapes:
        if s.name in seen:
            raise CellError(
                f"two bodies are named {s.name!r}; all names of shapes must differ",
                file=document.file,
                where="obstacles",
            )
        seen.add(s.name)


def find_missing_bodies(tool: Tool, workpiece: Workpiece) -> list[str]:
    """What is not described cannot be checked for collisions; the user should know."""
    return [
        f"the cell has no {key}, so collisions with the {key.split('.')[0]} are not checked"
        for key, there in (("tool.geometry", tool.geometry), ("workpiece.geometry", workpiece.geometry))
        if not there
    ]


def find_links_without_bodies(urdf: UrdfModel) -> list[str]:
    """What of the robot is not checked for collisions."""
    name, drawn = urdf.path.name, [p.name for p in urdf.parts if p.visuals and not p.collisions]
    if not urdf.has_collision:
        return [f"{name} has no collision geometry, so the arm's own body is not checked"]
    if drawn:
        return [f"{name} has no collision geometry for the links {', '.join(drawn)}: what touches them is not seen"]
    return []


def get_solid_shape(keys: ShapeKeys) -> tuple[Literal["box", "cylinder", "sphere"], list[float]]:
    """Kind and sizes in mm of a body that is no mesh; the schema lets exactly one through."""
    if keys.box_mm is not None:
        return "box", keys.box_mm
    if keys.cylinder_mm is not None:
        return "cylinder", keys.cylinder_mm
    return "sphere", [keys.sphere_mm or 0.0]
