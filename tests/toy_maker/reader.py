"""Reader of toy programs: one statement per line."""

from __future__ import annotations

import numpy as np

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.move_attributes import MoveAttributes
from machopt.programs.reading.parsed_program import LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import Rows, build_pose_matrix, convert_quaternion

from .harmless_words import TOY


def read_toy(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a toy program."""
    out = ProgramBuilder(source=source, dialect="toy", arc_tolerance=arc_tolerance, strict=strict)
    for line, text in enumerate(source.lines[1:], 2):
        word, _, rest = text.partition(" ")
        if word in ("TOOL", "BASE"):
            rows, place = _read_pose(rest.split())
            frame = ProgramFrame(word.lower(), build_pose_matrix(rows, *(v * 1e-3 for v in place)))
            (out.set_tool if word == "TOOL" else out.set_base)(frame)
        elif word == "JUMP":
            *axes, wrist = rest.split()
            out.joint(
                [float(a) for a in axes], line, MoveAttributes(configuration={"wrist": wrist.removeprefix("WRIST=")})
            )
        elif word == "LINE":
            values, _, output = rest.partition(" FEED=")
            feed, blend, move, operation = output.split(" ", 3)
            out.begin_or_none(operation.strip('"'))
            out.word(move)
            rows, place = _read_pose(values.split())
            size = float(blend.removeprefix("ROUND=")) * 1e-3
            x, y, z = (v * 1e-3 for v in place)
            out.pose(LINEAR, rows, (x, y, z), line, MoveAttributes(feed=float(feed) / 6e4, blend=size))
        elif word == ";":
            out.event(rest)
        elif text and word not in TOY:
            out.ignore(word, line, understood=False)
    return out.build()


def _read_pose(words: list[str]) -> tuple[Rows, list[float]]:
    x, y, z, *q = (float(w) for w in words)
    rows = convert_quaternion(*np.asarray(q).tolist())
    assert rows is not None
    return rows, [x, y, z]
