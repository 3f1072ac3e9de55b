"""A parsed robot program as a toolpath to be planned anew: tip, tool axis, feed, operations and events."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from machopt.domain.toolpath import Move, Toolpath
from machopt.errors import InputError
from machopt.formats.pathbuilder import PathBuilder
from machopt.formats.programs.parsed import Array, ParsedProgram
from machopt.formats.programs.rotations import inverted
from machopt.formats.source import ReadOptions, Source

AXES = {"-z": (2, -1.0), "+z": (2, 1.0), "-x": (0, -1.0), "+x": (0, 1.0), "-y": (1, -1.0), "+y": (1, 1.0)}
Forward = Callable[[Array], Array]


def to_toolpath(
    program: ParsedProgram, source: Source, options: ReadOptions, tool_axis: str = "-z", forward: Forward | None = None
) -> Toolpath:
    """Points of the tool tip in the program's first base frame.

    Joint targets have no place without the robot: with ``forward`` they get one, without they are left out and
    counted.

    Args:
        program: as read.
        source: the file, for messages and its hash.
        options: default feed, strictness.
        tool_axis: the direction of the tool frame that points from the tip to the shank.
        forward: poses (M, 4, 4) of the tool in the workpiece from axes (M, 6) in the program's degrees.

    Raises:
        InputError: no linear move, frames that only the controller knows change, a cut without a feed.
    """
    if tool_axis not in AXES:
        raise InputError(f"unknown tool axis {tool_axis!r}: known are {', '.join(AXES)}", where="tool_axis")
    if options.unit not in (None, "mm"):
        raise source.error(f"robot programs are in mm (URScript in m), but --unit {options.unit} was given")
    column, sign = AXES[tool_axis]
    out = PathBuilder(source, options, f"robot/{program.dialect}")
    T, known = _in_first_base(program, source, out)
    if forward is not None and (~known).any():
        rows = np.flatnonzero(~known & np.isfinite(program.axes_deg).all(axis=1))
        T[rows] = forward(program.axes_deg[rows])
        known[rows] = True
    if not (known & (program.move == Move.CUT)).any():
        raise source.error(_nothing_to_cut(program, known))
    events = sorted(program.events, key=lambda e: e.index)  # stable: in order at one move
    operation, told = -2, 0
    for k in range(len(program)):
        while told < len(events) and events[told].index <= k:
            out.event(events[told].kind, events[told].text, events[told].value)
            told += 1
        line = int(program.line[k])
        if not known[k]:
            out.ignore("joint move (no place without the robot)", line, understood=True)
            continue
        if program.operation[k] != operation:
            operation = int(program.operation[k])
            if operation >= 0:
                out.begin_operation(program.operations[operation])
        x, y, z = (T[k, :3, 3] * 1e3).tolist()
        i, j, c = (sign * T[k, :3, column]).tolist()
        out.add((x, y, z), (i, j, c), int(program.move[k]), float(program.feed[k]) * 6e4, line)
    for event in events[told:]:
        out.event(event.kind, event.text, event.value)
    for word in program.ignored:
        for _ in range(word.count):
            out.ignore(word.word, word.first_line, understood=word.understood)
    out.warnings.extend(w for w in program.warnings if not w.startswith("not understood"))
    out.meta |= {"unit": "mm", "program": program.name, "tool_axis": f"{tool_axis} of the tool frame",
                 "base": program.bases[int(program.base[known][0])].name}  # fmt: skip
    return out.build(reference=T[known][:, :3, 0 if column != 0 else 1])


def _in_first_base(program: ParsedProgram, source: Source, out: PathBuilder) -> tuple[Array, NDArray[np.bool_]]:
    """Poses in the base of the first one, and which moves have one."""
    T = program.T_base_tcp.copy()
    known = program.has_pose.copy()
    used = list(dict.fromkeys(program.base[known].tolist()))
    if len(used) > 1:
        first = program.bases[used[0]]
        for k in used[1:]:
            other = program.bases[k]
            rows = known & (program.base == k)
            if first.T is None or other.T is None:
                unknown = first.name if first.T is None else other.name
                names = ", ".join(program.bases[b].name for b in used[:4])
                raise source.error(
                    f"moves in {len(used)} base frames ({names}), but only the controller knows where {unknown} is; "
                    "post it in one frame",
                    int(program.line[rows][0]),
                )
            T[rows] = inverted(first.T) @ other.T @ T[rows]
        out.warn(f"points of {len(used)} base frames were brought into {first.name}")
    tools = set(program.tool[known].tolist())
    if len(tools) > 1:
        names = ", ".join(program.tools[t].name for t in sorted(tools)[:4])
        out.warn(f"the program uses {len(tools)} tools ({names}); their tips make one toolpath")
    for column in program.external[known].T:
        moving = column[np.isfinite(column)]
        if len(moving) and float(np.ptp(moving)) > 1e-6:
            out.warn_once("external axes move: the points are taken in the frame the program gives them in")
    return T, known


def _nothing_to_cut(program: ParsedProgram, known: NDArray[np.bool_]) -> str:
    linear = int((program.move == Move.CUT).sum())
    if linear:
        return (
            f"holds {linear} linear moves, but all of them to joint positions, whose places are not known without the "
            "robot; a program with Cartesian targets would work"
        )
    return f"holds {len(program)} joint moves and no linear one: there is no path to plan anew"
