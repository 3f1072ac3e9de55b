"""Drilling cycles of Heidenhain controls: definition, call at a position, call at a pattern of positions."""

from __future__ import annotations

import numpy as np

from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.path_building.drilling_cycles import DrillingCycleError
from machopt.toolpath.readers.gcode.geometry.hole_patterns import MOST_HOLES, generate_hole_circle, generate_hole_grid
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.heidenhain.approach_departure_reader import ContourEndReader
from machopt.toolpath.readers.heidenhain.drilling_cycles import SUPPORTED, build_old_cycle, build_q_cycle


class CycleCallReader(ContourEndReader):
    """The drilling cycle in force, with its parameters."""

    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        super().__init__(source, options)
        self.q: dict[int, float] = {}
        self.cycle: int | None = None  # number
        self.cycle_words: dict[str, float] = {}

    def drill_pattern(self, number: int, line: int) -> None:
        """Carry out cycles 220 (circle) and 221 (rows): the last drilling cycle at every position.

        Args:
            number: Number of the cycle.
            line: Line number in the file (1-based).

        Raises:
            DrillingCycleError: no drilling cycle precedes it, or a parameter is missing.
        """
        if self.cycle is None or self.cycle < 200:
            raise DrillingCycleError(f"cycle {number} before any drilling cycle was defined")
        needed = (216, 217, 244, 245, 241) if number == 220 else (225, 226, 237, 238, 242, 243)
        missing = [f"Q{n}" for n in needed if n not in self.q]
        if missing:
            raise DrillingCycleError(f"cycle {number} without {', '.join(missing)}")
        q, s = self.q, self.scale
        count = q[241] if number == 220 else max(q[242], q[243]) ** 2
        if not 1.0 <= count <= MOST_HOLES:
            raise DrillingCycleError(f"cycle {number} with {count:g} holes; expected 1 to {MOST_HOLES}")
        if number == 220:
            n, step = round(q[241]), q.get(247, 0.0)
            if step == 0.0:
                whole = q.get(246, 360.0) - q[245]
                step = whole / n if abs(abs(whole) - 360.0) < 1e-9 else whole / max(n - 1, 1)
            places = list(generate_hole_circle((q[216], q[217], q[244] / 2.0, q[245], step), n))
        else:
            columns, rows = round(q[242]), round(q[243])
            places = list(generate_hole_grid((q[225], q[226]), (q[237], q[238]), columns, rows, q.get(224, 0.0)))
        if q.get(201) == 0.0:
            self.out.warn_once(f"cycle {self.cycle} with Q201=0 (no depth) is not carried out, as on the control", line)
            return
        plan = build_q_cycle(self.cycle, self.q, self.scale, self.rpm)
        for x, y in places:
            self.holes(plan, {}, [x * s, y * s, self.p[2]], ProgramBlock(line=line, words=[]))

    def begin_q_cycle(self, number: int, line: int) -> None:
        """Begin a cycle whose parameters are Q numbers.

        Args:
            number: Number of the cycle.
            line: Line number in the file (1-based).

        Raises:
            InputError: the cycle is not supported.
        """
        if number not in SUPPORTED:
            raise self.source.build_error(
                f"cycle {number}: only the drilling cycles {', '.join(map(str, SUPPORTED))} are supported; export its "
                "motion as blocks, or APT/CL data",
                line,
            )
        if number == 241:
            self.out.warn_once(
                "cycle 241 is read as one stroke at Q206 from the pre-drilled depth Q379: speeds and the dwell on the "
                "way are not carried out",
                line,
            )
        if number == 204:
            self.out.warn_once(
                "cycle 204 (back boring): the spindle must stop at the angle Q336 while the tool is beside the axis; "
                "that is no part of a path",
                line,
            )
        self.cycle, self.cycle_words = number, {}
        for name in [k for k in self.q if k >= 200]:
            del self.q[name]  # each cycle names its own

    def drill_here(self, b: ProgramBlock) -> None:
        """Carry out M99, CYCL CALL or G79: one hole at the present position.

        Args:
            b: The block: its words, calls and line number.

        Raises:
            DrillingCycleError: no cycle is defined, or the tool position is not known.
        """
        if self.cycle is None:
            raise DrillingCycleError("a cycle call (M99, CYCL CALL, G79) before any drilling cycle was defined")
        if np.isnan(self.p).any():
            raise DrillingCycleError("a drilling cycle where the tool's place is not known")
        depth = 249 if self.cycle == 204 else 201
        if self.cycle >= 200 and self.q.get(depth) == 0.0:
            self.out.warn_once(
                f"cycle {self.cycle} with Q{depth}=0 (no depth) is not carried out, as on the control", b.line
            )
            return
        if self.cycle >= 200:
            plan = build_q_cycle(self.cycle, self.q, self.scale, self.rpm)
        else:
            plan = build_old_cycle(self.cycle, self.cycle_words, self.p[2], self.scale, self.rpm)
        self.holes(plan, {}, None, b)
