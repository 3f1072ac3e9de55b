"""Conversion of parsed values to parts of a cell, without file access."""

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
    """Describe which of several tools is the default.

    Args:
        tools: Tool name → tool of the cell.

    Returns:
        One sentence where there are several tools, else none.
    """
    if len(tools) < 2:
        return []
    return [f"of the tools {', '.join(tools)} the first one is used by commands without a toolpath"]


def combine_tools(tools: Mapping[str, Tool]) -> Tool:
    """Combine the bodies of all tools into one tool, to find body pairs that may touch by name.

    Args:
        tools: Tool name → tool of the cell.

    Returns:
        The combined tool.
    """
    first = next(iter(tools.values()))
    bodies = {shape.name: shape for tool in tools.values() for shape in tool.geometry}
    cutter = next((tool.cutter for tool in tools.values() if tool.cutter is not None), None)
    return replace(first, geometry=tuple(bodies.values()), cutter=cutter)


def build_joint_map(keys: JointMapKeys) -> JointMap:
    """Build the mapping of URDF joints to controller axes.

    Args:
        keys: Keys of the joint map.

    Returns:
        The mapping.
    """
    coupling = np.zeros((6, 6))
    for axis, sources in keys.coupling.items():
        for other, factor in sources.items():
            coupling[int(axis[1]) - 1, int(other[1]) - 1] = factor
    return JointMap(
        copy_read_only(np.array(keys.sign)), copy_read_only(np.array(keys.offset_deg)), copy_read_only(coupling)
    )


def copy_read_only(array: Array) -> Array:
    """Return a read-only copy.

    Args:
        array: Array of any shape.
    """
    out = np.array(array, float)
    out.setflags(write=False)
    return out


def copy_limits_read_only(limits: JointLimits) -> JointLimits:
    """Return a read-only copy of joint limits.

    Args:
        limits: Limits of the moving joints, SI units.
    """
    rows = limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk
    return JointLimits(*map(copy_read_only, rows))


def build_file_error(file: Path, message: str) -> InputError:
    """Build an error of a cell file.

    Args:
        file: Path of the file.
        message: Description of the error.

    Returns:
        The error, not raised.
    """
    return CellError(message, file=file)


def format_xacro_argument(value: str | float | bool) -> str:
    """Format an argument as xacro's command line expects it.

    Args:
        value: Value of the argument.

    Returns:
        The text.
    """
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) and value.is_integer() else str(value)


def describe_unused_elements(urdf: UrdfModel) -> tuple[str, ...]:
    """Describe the elements of the robot description that are not used.

    Args:
        urdf: The robot: links, joints, bodies and masses.

    Returns:
        One sentence, or none where all are used.
    """
    if not urdf.unused_elements:
        return ()
    found = ", ".join(f"{tag} ({n})" for tag, n in urdf.unused_elements.items())
    return (f"{urdf.path.name}: elements without information on bodies, masses and joints are not used: {found}",)


def check_unique_names(document: YamlDocument, *shapes: CollisionShape) -> None:
    """Refuse two bodies with the same name.

    Args:
        document: Parsed YAML file, with the line of each key for errors.
        *shapes: Collision bodies of the cell.

    Raises:
        CellError: two bodies have the same name.
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
    """Warn of a tool or workpiece without bodies, which collision checks cannot include.

    Args:
        tool: The tool.
        workpiece: The workpiece.

    Returns:
        One warning each.
    """
    return [
        f"the cell has no {key}, so collisions with the {key.split('.')[0]} are not checked"
        for key, there in (("tool.geometry", tool.geometry), ("workpiece.geometry", workpiece.geometry))
        if not there
    ]


def find_links_without_bodies(urdf: UrdfModel) -> list[str]:
    """Warn of robot links that collision checks cannot include.

    Args:
        urdf: The robot: links, joints, bodies and masses.

    Returns:
        One warning each.
    """
    name, drawn = urdf.path.name, [p.name for p in urdf.parts if p.visuals and not p.collisions]
    if not urdf.has_collision:
        return [f"{name} has no collision geometry, so the arm's own body is not checked"]
    if drawn:
        return [f"{name} has no collision geometry for the links {', '.join(drawn)}: what touches them is not seen"]
    return []


def get_solid_shape(keys: ShapeKeys) -> tuple[Literal["box", "cylinder", "sphere"], list[float]]:
    """Return kind and sizes of a body that is no mesh; the schema permits exactly one.

    Args:
        keys: Keys of the body.

    Returns:
        Kind, and sizes in mm.
    """
    if keys.box_mm is not None:
        return "box", keys.box_mm
    if keys.cylinder_mm is not None:
        return "cylinder", keys.cylinder_mm
    return "sphere", [keys.sphere_mm or 0.0]
