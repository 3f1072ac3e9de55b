"""Execution of G-code and Sinumerik drilling cycles at their holes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.path_building.back_boring import BackBoringCycle, append_back_boring_moves
from machopt.path_building.drilling_cycles import DrillingCycle, DrillingCycleError, append_hole_moves
from machopt.toolpath.readers.gcode.arc_moves import ArcMoveReader
from machopt.toolpath.readers.gcode.canned_cycles import CannedCycle
from machopt.toolpath.readers.gcode.control_state import AXES
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock

_Z = (0.0, 0.0, 1.0)
_PRESENT = 1e-9  # mm
_PARALLEL = 1.0 - 1e-6  # cosine: the tool is parallel to the program's z


class DrillingMoveReader(ArcMoveReader):
    """Canned cycles, modal cycle calls and their holes."""

    def along_z(self) -> bool:
        """Return whether the tool is parallel to the program's z axis."""
        z = self.setup.direction(_Z)
        return sum(a * b for a, b in zip(self.axis, z, strict=True)) > _PARALLEL

    def begin_cycle(self, code: int, b: ProgramBlock) -> None:
        """Begin a canned cycle.

        Args:
            code: Number of the G word.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the position along the drilling axis is not known.
        """
        if code in (76, 77, 87, 88):
            self.out.warn_once(f"G{code} is read as a plain boring stroke", b.line)
        along = self.depth_axis()
        if along != 2:
            self.out.warn_once(
                f"G{code} in G{17 if along == 2 else 18 if along == 1 else 19} drills along {AXES[along]}: the tool is "
                "taken to point along it",
                b.line,
            )
        if self.canned is None:
            if math.isnan(self.p[along]):
                raise self.source.build_error(
                    self.setup.missing_place_reason or f"G{code} begins where {AXES[along]} is not known", b.line
                )
            self.canned = CannedCycle(initial=self.p[along])
        self.canned.code = code

    def depth_axis(self) -> int:
        """Index of the axis that cycles drill along: the normal of the working plane."""
        return int(np.argmax(np.abs(self.plane)))

    def report_conventions(self, c: CannedCycle, given: set[str], b: ProgramBlock) -> None:
        """Report the conventions of a canned cycle that depend on the control and affect this block.

        Args:
            c: The canned cycle.
            given: Letters that the block gives.
            b: The block: its words, calls and line number.
        """
        above = c.r is not None and c.initial > c.r + _PRESENT
        if not self.retract_said and above:
            self.out.warn_once("no G98 or G99 before a cycle: read as G98 (Fanuc); LinuxCNC begins with G99", b.line)
        if c.code in (84, 89) and self.back_to_initial and above:
            self.out.warn_once(
                f"G{c.code} feeds out to R and goes on in rapid (Fanuc); LinuxCNC feeds up to the initial height",
                b.line,
            )
        has_modal_height = not {"R", AXES[self.depth_axis()]} <= given
        if self.incremental and has_modal_height and not (c.counted and self.back_to_initial):
            self.out.warn_once(
                "heights of a cycle stay what they are under G91 (Fanuc); LinuxCNC counts them anew at each hole",
                b.line,
            )
        if math.isnan(c.dwell):
            self.out.warn_once("P of a cycle without a decimal point: seconds or milliseconds is not known", b.line)

    def cycle_of_block(self, words: dict[str, float], b: ProgramBlock) -> DrillingCycle | None:
        """Build the drilling cycle of a block.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Returns:
            The cycle, None where none is active.

        Raises:
            InputError: the words do not describe the cycle, or the tool is not parallel to Z.
        """
        if self.canned is None:
            return self.modal_call
        c = self.canned
        if not self.along_z():
            raise self.source.build_error(f"G{c.code} with a tool that is not parallel to Z is not supported", b.line)
        given = set(words)
        if not given & set("XYZ") and any(letter == "G" and value == c.code for letter, value in b.words):
            self.out.warn_once(f"G{c.code} without a position (X, Y or Z): no hole is drilled in that block", b.line)
        depth = AXES[self.depth_axis()]
        c.take_words(words, b, self.scale, depth=depth, incremental=self.incremental, control=self.control)
        for letter in "IJK":
            if letter in words and letter != "K":
                self.out.ignore(f"{letter} in a cycle", b.line, understood=False)
                words.pop(letter)
        if c.z is None and c.r is None and not words:
            return None
        if c.code in (73, 83) and not c.q > 0.0:
            self.out.warn_once(f"G{c.code} without a peck depth Q above zero: one stroke", b.line)
        self.report_conventions(c, given, b)
        return c.build_cycle_at_hole(back_to_initial=self.back_to_initial)

    def _check_cycle(self, cycle: DrillingCycle, line: int) -> DrillingCycle:
        """Return the cycle with the feed in force; raise InputError where axis, scale or feed do not allow it."""
        why = self.setup.describe_unknown_place()
        if why:
            raise self.source.build_error(why, line)
        if not self.along_z():
            raise self.source.build_error(f"{cycle.name} with a tool that is not parallel to Z is not supported", line)
        if math.isnan(cycle.feed):
            if self.feed_mode == "inverse":
                raise self.source.build_error(
                    f"{cycle.name} under G93: a cycle's feed is no time for a block; G94 before it", line
                )
            cycle = replace(cycle, feed=self.feed_mm_min(0.0, line))
        if abs(self.setup.height_factor - 1.0) > 1e-9:
            raise self.source.build_error(
                f"{cycle.name} under a scaling or mirroring of Z: which of its heights it changes depends on the "
                "control; post the hole as G0 and G1",
                line,
            )
        return cycle

    def holes(self, cycle: DrillingCycle, words: dict[str, float], target: list[float] | None, b: ProgramBlock) -> None:
        """Drill the hole of this block and its repeats.

        Args:
            cycle: Drilling cycle, heights over z = 0.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            target: Position of the hole in programmed mm, None where the block has no X, Y or Z.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the position of the hole is not known, or the tool axis or a scale does not allow the
                cycle.
        """
        cycle = self._check_cycle(cycle, b.line)
        self.end_contour("a drilling cycle follows")
        repeats = 1
        if words.get("K", 1.0) > 1.0 and cycle.first_peck > 0.0 and not self.incremental and not self.siemens:
            raise self.source.build_error(
                f"K{words['K']:g} of {cycle.name}: Fanuc repeats the hole at its place, on Haas it is a depth. "
                "Leave it out, or write L for repeats",
                b.line,
            )
        for letter in ("L", "K"):
            if letter in words:
                repeats = round(words.pop(letter))
        if repeats > 10_000:
            raise DrillingCycleError(f"{repeats} repeats of one cycle; the limit is 10000")
        along = self.depth_axis()
        place = self.p if target is None else target
        across = [k for k in range(3) if k != along]
        if any(math.isnan(place[k]) for k in across):
            raise self.source.build_error(
                f"a drilling cycle where {' or '.join(AXES[k] for k in across)} is not known", b.line
            )
        step = [place[k] - self.p[k] if self.incremental and k != along else 0.0 for k in range(3)]
        normal = self.setup.direction((float(along == 0), float(along == 1), float(along == 2)))
        for n in range(repeats):
            hole = [0.0 if k == along else place[k] + n * step[k] for k in range(3)]
            if self.incremental and self.polar_step is not None:
                hole[0], hole[1] = self.polar_step.place(n)
            before = None
            if not any(math.isnan(v) for v in self.p):
                before = self.setup.point((self.p[0], self.p[1], self.p[2]))
            where = self.setup.point((hole[0], hole[1], hole[2]))
            if isinstance(cycle, BackBoringCycle):
                x, y, z = (v + shift for v, shift in zip(hole, cycle.sideways, strict=True))
                places = where, self.setup.point((x, y, z))
                height = append_back_boring_moves(self.out, cycle, places, normal, b.line, before)
            else:
                height = append_hole_moves(self.out, cycle, where, normal, b.line, before)
            hole[along] = height
            self.p, self.lost = hole, [""] * 3
        if self.once == b.line:
            self.modal_call = None

    def straight(self, points: Array, feed: float, line: int) -> None:
        """Add cuts through points in sequence.

        Args:
            points: Points (N, 3) in programmed mm.
            feed: Feed, mm/min.
            line: Line number in the file (1-based).
        """
        for x, y, z in points.tolist():
            self.go([x, y, z], self.setup.tool_axis(), MoveKind.CUT, feed, line)
