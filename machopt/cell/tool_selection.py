"""Selection of cell tools by the tool words of the CAM file, and division of a job at tool changes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell, Tool
from machopt.data_types.tool_segments import ToolSegment, cut_toolpath
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.errors import CellError, suggest_nearest_word

_NUMBER = re.compile(r"T?0*([0-9]+)(?:\.0*)?", re.IGNORECASE)  # T03, 3 and 3.0 are one tool


def match_tool(operation: ToolpathOperation, tools: Mapping[str, Tool]) -> str | None:
    """Find the cell tool that the tool words of an operation mean.

    The same text comes first, then the same number as a name, then the number that one tool has in the controller.

    Args:
        operation: The operation with its tool words.
        tools: Tool name → tool of the cell.

    Returns:
        Name of the tool, None where none matches.
    """
    names = list(tools)
    same = next((word for word in operation.tools if word in names), None)
    if same is not None:
        return same
    known = {_normalise_word(name): name for name in names}
    named = next((known[_normalise_word(word)] for word in operation.tools if _normalise_word(word) in known), None)
    if named is not None:
        return named
    numbers: dict[str, list[str]] = {}
    for name, tool in tools.items():
        if tool.number is not None:
            numbers.setdefault(str(tool.number), []).append(name)
    matches_by_tool = [numbers.get(_normalise_word(word), []) for word in operation.tools]
    return next((found[0] for found in matches_by_tool if len(found) == 1), None)


def match_operation_tools(toolpath: Toolpath, tools: Mapping[str, Tool]) -> tuple[str | None, ...]:
    """Find the tool of each operation; one without a tool word has the tool of the previous operation.

    With one tool in the cell no words are needed.

    Args:
        toolpath: The toolpath, SI units.
        tools: Tool name → tool of the cell.

    Returns:
        Name per operation, None where it has no points and no tool of the cell.

    Raises:
        CellError: a tool is not in the cell, or a word is missing where the cell has several tools.
    """
    names = list(tools)
    used = set(toolpath.operation.tolist())
    out: list[str | None] = []
    last: str | None = names[0] if len(names) == 1 else None
    for k, operation in enumerate(toolpath.operations):
        if operation.tools:
            found = match_tool(operation, tools)
            if found is None and k in used:
                words = " or ".join(repr(w) for w in operation.tools)
                raise CellError(
                    f"operation {operation.label!r} wants the tool {words}, which the cell does not have; "
                    f"{suggest_nearest_word(operation.tools[0], names)}",
                    file=toolpath.source,
                )
            last = found
        elif last is None and k in used:
            raise CellError(
                f"operation {operation.label!r} names no tool, and the cell has {', '.join(names)}; a word for it "
                "(LOADTL, T, TOOL CALL, a column tool) would work",
                file=toolpath.source,
            )
        out.append(last)
    return tuple(out)


def select_job_tools(cell: Cell, toolpath: Toolpath) -> Cell:
    """Select the tools of a toolpath; where it uses several, the cell keeps these and none is mounted.

    Args:
        cell: The cell.
        toolpath: The toolpath, SI units.

    Returns:
        The cell with its tools.

    Raises:
        CellError: see :func:`match_operation_tools`.
    """
    if not cell.tools:
        return cell
    wanted = _find_required_tools(cell, toolpath)
    if len(wanted) == 1:
        return _mount_tool(cell, next(iter(wanted)))
    table = {name: cell.tools[name] for name in wanted}
    return replace(cell, tool=next(iter(table.values())), tools=table, tool_name=None)


def select_single_tool(cell: Cell, *toolpaths: Toolpath) -> Cell:
    """Select the one tool of all toolpaths; a cell without a tool table stays as it is.

    Args:
        cell: The cell.
        *toolpaths: The toolpaths.

    Returns:
        The cell with the tool mounted.

    Raises:
        CellError: see :func:`match_operation_tools`; or the toolpaths use several tools.
    """
    if not cell.tools:
        return cell
    wanted = _find_required_tools(cell, *toolpaths)
    if len(wanted) > 1:
        changes = ", ".join(f"{tool} from operation {label}" for tool, label in wanted.items())
        raise CellError(
            f"wants {len(wanted)} tools of the cell ({changes}); this is done with one tool: a file for each would "
            "work (optimize takes several in one)",
            file=toolpaths[0].source,
        )
    (name,) = wanted
    return _mount_tool(cell, name)


def split_into_tool_segments(cell: Cell, toolpath: Toolpath) -> tuple[ToolSegment, ...]:
    """Split the job at its tool changes.

    Args:
        cell: The cell.
        toolpath: The toolpath, SI units.

    Returns:
        Segments in order; one where the tool does not change.

    Raises:
        CellError: see :func:`match_operation_tools`; or a tool changes during a cut, or tools share a controller
            number.
    """
    home, change = cell.joints_at_home, cell.joints_at_tool_change
    if not cell.tools or len(_find_required_tools(cell, toolpath)) == 1:
        return (
            ToolSegment(
                cell=select_job_tools(cell, toolpath), toolpath=toolpath, whole=toolpath, first=0, begin=home, end=home
            ),
        )
    chosen = match_operation_tools(toolpath, cell.tools)
    name_of = np.array([chosen[k] for k in toolpath.operation.tolist()], dtype=object)
    firsts = [0, *(1 + np.flatnonzero(name_of[1:] != name_of[:-1])).tolist()]
    for first in firsts[1:]:
        onward = MoveKind(int(toolpath.move[first]))  # a retract or a link is still led by the tool that has cut
        if toolpath.move[first - 1] == MoveKind.CUT and onward in (MoveKind.CUT, MoveKind.RETRACT, MoveKind.LINK):
            way = "cuts from" if onward == MoveKind.CUT else f"goes out of a cut (a {onward.word}) from"
            raise CellError(
                f"{way} point {first - 1} to point {first}, and the tool changes from {name_of[first - 1]} to "
                f"{name_of[first]} between them; a rapid move to the first point of a tool would work",
                file=toolpath.source,
            )
    _check_tool_numbers(cell, {str(name) for name in name_of})
    out = []
    for n, (first, stop) in enumerate(zip(firsts, [*firsts[1:], len(toolpath)], strict=True), start=1):
        out.append(
            ToolSegment(
                cell=_mount_tool(cell, str(name_of[first])),
                toolpath=cut_toolpath(toolpath, first, stop),
                whole=toolpath,
                first=first,
                begin=home if n == 1 else change,
                end=home if n == len(firsts) else change,
                number=n,
            )
        )
    return tuple(out)


def list_used_operations(toolpath: Toolpath) -> tuple[str, ...]:
    """List the labels of the operations that have points, in the order of the points.

    Args:
        toolpath: The toolpath, SI units.

    Returns:
        The labels.
    """
    return tuple(toolpath.operations[k].label for k in dict.fromkeys(toolpath.operation.tolist()))


def _find_required_tools(cell: Cell, *toolpaths: Toolpath) -> dict[str, str]:
    """Each tool in use, with its first operation."""
    out: dict[str, str] = {}
    for toolpath in toolpaths:
        chosen = match_operation_tools(toolpath, cell.tools)
        for k in dict.fromkeys(toolpath.operation.tolist()):
            out.setdefault(str(chosen[k]), f"{toolpath.operations[k].label!r} of {toolpath.source}")
    return out


def _mount_tool(cell: Cell, name: str) -> Cell:
    """The cell with a tool of its table on."""
    tool: Tool = cell.tools[name]
    controller = cell.controller
    if tool.number is not None:
        controller = replace(controller, tool_number=tool.number)
    return replace(cell, tool=tool, tool_name=name, controller=controller)


def _check_tool_numbers(cell: Cell, names: Iterable[str]) -> None:
    """In the controller each tool has a number of its own, or none has one."""
    shared: dict[int, str] = {}
    for name in sorted(names):
        number = cell.tools[name].number
        number = cell.controller.tool_number if number is None else number
        if number is not None and number in shared:
            raise CellError(
                f"the tools {shared[number]} and {name} would both be number {number} of the controller; a tool_number "
                "of its own for each would work",
                file=cell.folder / "cell.yaml",
                where=f"tools.{name}",
            )
        if number is not None:
            shared[number] = name


def _normalise_word(word: str) -> str:
    text = " ".join(word.split()).casefold()
    number = _NUMBER.fullmatch(text)
    return text if number is None else number.group(1)
