"""Parts of a cell made of what was read: no file is opened here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Tool
from machopt.domain.program import JointMap
from machopt.errors import InputError
from machopt.formats.cell_schema import JointMapKeys
from machopt.formats.urdf import Urdf


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
