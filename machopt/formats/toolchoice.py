"""Which tool of a cell's table a toolpath wants, by the words of the CAM file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from machopt.domain.cell import Cell
from machopt.domain.toolpath import Operation, Toolpath
from machopt.errors import InputError, nearest

_NUMBER = re.compile(r"T?0*(\d+)(?:\.0*)?", re.IGNORECASE)  # T03, 3 and 3.0 are one tool


def tool_of(operation: Operation, names: Iterable[str]) -> str | None:
    """The name in the table that an operation's tool words mean: the same text, or the same number; else None."""
    known = {_plain(name): name for name in names}
    return next((known[_plain(word)] for word in operation.tools if _plain(word) in known), None)


def tools_of(toolpath: Toolpath, names: Iterable[str]) -> tuple[str | None, ...]:
    """The tool of each operation (None where it has no points and no tool of the table).

    An operation without a word has the tool of the one before; a table of one tool needs no words.

    Raises:
        InputError: a tool that is not in the table, or no word where the table has several.
    """
    names = list(names)
    used = set(toolpath.operation.tolist())
    out: list[str | None] = []
    last: str | None = names[0] if len(names) == 1 else None
    for k, operation in enumerate(toolpath.operations):
        if operation.tools:
            found = tool_of(operation, names)
            if found is None and k in used:
                words = " or ".join(repr(w) for w in operation.tools)
                raise InputError(
                    f"operation {operation.label!r} wants the tool {words}, which the cell does not have; "
                    f"{nearest(operation.tools[0], names)}",
                    file=toolpath.source,
                )
            last = found
        elif last is None and k in used:
            raise InputError(
                f"operation {operation.label!r} names no tool, and the cell has {', '.join(names)}; a word for it "
                "(LOADTL, T, TOOL CALL, a column tool) would work",
                file=toolpath.source,
            )
        out.append(last)
    return tuple(out)


def with_tool(cell: Cell, *toolpaths: Toolpath) -> Cell:
    """The cell with the tool that the toolpaths want; as it is where it has no table.

    Raises:
        InputError: see :func:`tools_of`; or they want several tools.
    """
    if not cell.tools:
        return cell
    wanted: dict[str, str] = {}  # tool → operation that wants it first
    for toolpath in toolpaths:
        chosen = tools_of(toolpath, cell.tools)
        for k in sorted(set(toolpath.operation.tolist())):
            wanted.setdefault(str(chosen[k]), f"{toolpath.operations[k].label!r} of {toolpath.source}")
    if len(wanted) > 1:
        changes = ", ".join(f"{tool} from operation {label}" for tool, label in wanted.items())
        raise InputError(
            f"wants {len(wanted)} tools of the cell ({changes}); one plan has one tool: a file for each would work",
            file=toolpaths[0].source,
        )
    (name,) = wanted
    return replace(cell, tool=cell.tools[name], tool_name=name)


def _plain(word: str) -> str:
    text = " ".join(word.split()).casefold()
    number = _NUMBER.fullmatch(text)
    return text if number is None else number.group(1)
