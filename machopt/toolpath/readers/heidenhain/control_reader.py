"""Common part of the Heidenhain readers (conversational, DIN/ISO): pole, polar moves, datum chain, cycles, tools."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.file_formats.source_file import MM_PER_INCH, ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError
from machopt.path_building.drilling_cycles import DrillingCycleError
from machopt.path_building.point_collector import Vector
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.gcode.arc_moves import ProgrammedArc
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourCorner, ContourSegment, CornerKind
from machopt.toolpath.readers.gcode.geometry.hole_patterns import MOST_HOLES, generate_hole_circle, generate_hole_grid
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.word_meanings import PLANES
from machopt.toolpath.readers.heidenhain.contour_approach import (
    ContourApproach,
    LeadIn,
    LeadPath,
    convert_to_plane_point,
)
from machopt.toolpath.readers.heidenhain.datums_and_planes import NUMBER, DatumAndPlaneReader, parse_value
from machopt.toolpath.readers.heidenhain.drilling_cycles import (
    SUPPORTED,
    build_old_cycle,
    build_q_cycle,
)
from machopt.toolpath.readers.heidenhain.label_flow import LabelFlow

_TOOL_AXIS = re.compile(r"TOOL CALL\s*(?:\"\"|\d+)?\s*([XYZUVW])\b")
_QUOTED = re.compile(r"\"[^\"]*\"")


class HeidenhainControlReader(DatumAndPlaneReader):
    """State and moves of the control."""

    format = "heidenhain"
    decimals_count = False
    unit_by_words = False

    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        super().__init__(source, options)
        self.siemens = False
        self.blocks.parentheses_are_comments = False
        self.pole = [math.nan, math.nan, math.nan]  # mm, in the program's coordinates
        self.pole_axes = "XY"
        self.tool_feed = math.nan  # F of the last TOOL CALL
        self.q: dict[int, float] = {}
        self.cycle: int | None = None  # number
        self.cycle_words: dict[str, float] = {}
        self.side = 0.0  # of the tool by radius compensation: +1 left (RL, G41), -1 right
        self.approach: ContourApproach | None = None  # waits for the contour element it leads into
        self.left_out: tuple[str, int] | None = None  # another program that was called
        self.centres.absolute = True

    def needs_flow(self) -> bool:
        return True

    def label_flow(self) -> LabelFlow:
        items = [(n, *found) for n, t in enumerate(self.source.lines, 1) if (found := self.clean(n, t))]
        return LabelFlow(items)

    # ---- moves

    def own_m_words(self, m_words: list[int], line: int) -> list[int]:
        """Carry out the M words that only this control has.

        Args:
            m_words: Numbers of the M words.
            line: Line number in the file (1-based).

        Returns:
            The other M words.

        Raises:
            InputError: an M word is not supported.
        """
        for m in m_words:
            if m in (136, 137):
                self.feed_mode = "revolution" if m == 136 else "minute"
            elif m in (91, 92, 99, 140):
                pass  # the motion words' readers use them
            elif m == 89:
                raise self.source.build_error(
                    "M89 (a cycle at every point that follows) is not supported; use M99", line
                )
            elif m == 130 and "plane" in self.chain:
                raise self.source.build_error(
                    "M130 (points of the untilted system) in a tilted plane is not supported", line
                )
            elif m in harmless_words.HEIDENHAIN_M:
                if m in (126, 127):
                    self.shortest_turns = m == 126
                self.out.ignore(f"M{m}", line, understood=True)
            else:
                continue
        mine = {89, 91, 92, 99, 136, 137, 140, *harmless_words.HEIDENHAIN_M}
        return [m for m in m_words if m not in mine]

    def feed_word(self, f: float, line: int) -> None:
        """Carry out F.

        Args:
            f: Feed, program units per minute.
            line: Line number in the file (1-based).
        """
        if self.scale != 1.0:
            self.out.warn_once("F of an inch program is read in tenths of an inch a minute", line)
        self.feed = f * (MM_PER_INCH * 0.1 if self.scale != 1.0 else 1.0) / self.scale

    def other_program(self, line: int) -> None:
        """Refuse a motion after a call of another program.

        Args:
            line: Line number in the file (1-based).

        Raises:
            InputError: another program was called, whose motion is not in the file.
        """
        if self.left_out is not None:
            name, at = self.left_out
            raise self.source.build_error(
                f"{name} is called in line {at}; that program is not in this file, so where the tool stands after it "
                "is not known: expand it",
                line,
            )

    def absolute(self, words: dict[str, float], line: int) -> None:
        """Convert incremental coordinates IX … in place to absolute ones, program units.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            line: Line number in the file (1-based).

        Raises:
            InputError: an increment starts from an unknown coordinate.
        """
        for k, letter in enumerate("XYZ"):
            if "I" + letter in words:
                if math.isnan(self.p[k]):
                    raise self.source.build_error(f"incremental {letter} from a place that is not known", line)
                words[letter] = self.p[k] / self.scale + words.pop("I" + letter)
        for letter in "ABC":
            if "I" + letter in words:
                words[letter] = self.setup.angles.get(letter, 0.0) + words.pop("I" + letter)

    def set_pole(self, words: dict[str, float]) -> None:
        """Carry out CC: set the pole.

        Args:
            words: Words of the block: letter or name → number.
        """
        given = ""
        for k, letter in enumerate("XYZ"):
            if letter in words:
                self.pole[k] = words[letter] * self.scale
                given += letter
            elif "I" + letter in words:
                self.pole[k] = self.p[k] + words["I" + letter] * self.scale
                given += letter
        self.pole_axes = given or self.pole_axes
        self.plane = np.array({"YZ": PLANES[190], "XZ": PLANES[180]}.get(self.pole_axes, PLANES[170]))

    def circle(
        self, kind: str, words: dict[str, float], left: bool | None, radius: float | None, b: ProgramBlock
    ) -> None:
        """Carry out C about the pole or CR by its radius.

        Args:
            kind: C or CR.
            words: Words of the block: letter or name → number; changed in place.
            left: Direction of rotation: True for DR+, False for DR−, None where not given.
            radius: Radius in program units, None for an arc about the pole.
            b: The block: its words, calls and line number.

        Raises:
            ArcError: the words describe no arc.
        """
        if left is None:
            raise ArcError(f"{kind} without DR+ or DR-")
        self.motion = 3 if left else 2
        if kind == "CR":
            if radius is None:
                raise ArcError("CR without R")
            b.named["CR"] = radius
        else:
            if self.pole_axes == "XYZ":
                raise ArcError("a circle about a pole (CC) of three coordinates: its plane is not stated")
            centre = [p if math.isnan(c) else c for c, p in zip(self.pole, self.p, strict=True)]
            for k, letter in enumerate("IJK"):
                if not math.isnan(centre[k]):
                    words[letter] = centre[k] / self.scale
        if not words.keys() & set("XYZ"):
            for k, letter in enumerate("XYZ"):
                if not math.isnan(self.p[k]):
                    words[letter] = self.p[k] / self.scale
        self.move(words, b)

    def to_cartesian(self, words: dict[str, float], line: int) -> None:
        """Convert PR, PA (IPR, IPA) about the pole in place to X and Y; XY plane only.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            line: Line number in the file (1-based).

        Raises:
            InputError: the pole or one of the polar coordinates is not known.
        """
        if math.isnan(self.pole[0]) or math.isnan(self.pole[1]):
            raise self.source.build_error("polar coordinates before a pole (CC) was set", line)
        dx, dy = self.p[0] - self.pole[0], self.p[1] - self.pole[1]
        radius = (
            words.pop("PR") * self.scale if "PR" in words else math.hypot(dx, dy) + words.pop("IPR", 0.0) * self.scale
        )
        angle = words.pop("PA") if "PA" in words else math.degrees(math.atan2(dy, dx)) + words.pop("IPA", 0.0)
        if not (math.isfinite(radius) and math.isfinite(angle)):
            raise self.source.build_error("polar coordinates from a place that is not known", line)
        words["X"] = (self.pole[0] + radius * math.cos(math.radians(angle))) / self.scale
        words["Y"] = (self.pole[1] + radius * math.sin(math.radians(angle))) / self.scale

    def polar_circle(self, words: dict[str, float], left: bool | None, b: ProgramBlock) -> None:
        """Carry out CP: an arc or helix about the pole by its angle; IPA may exceed one turn.

        Args:
            words: Words of the block: letter or name → number; changed in place.
            left: Direction of rotation: True for DR+, False for DR−, None where not given.
            b: The block: its words, calls and line number.

        Raises:
            ArcError: the words describe no arc.
        """
        if left is None:
            raise ArcError("CP without DR+ or DR-")
        sweep = words.get("IPA")
        if sweep is not None and (sweep > 0.0) != left and sweep:
            self.out.warn_once(
                "IPA and DR of CP have opposite signs: DR holds, the angle is taken that way round", b.line
            )
            words["IPA"] = sweep = -sweep
        self.to_cartesian(words, b.line)
        turns = 1
        if sweep is not None:
            if abs(sweep) > 1e6:
                raise ArcError(f"an arc of {sweep:g}°")
            turns = max(math.ceil(abs(sweep) / 360.0 - 1e-9), 1)
            if abs(abs(sweep) - 360.0 * turns) < 1e-9:  # whole turns end exactly where they start
                words["X"], words["Y"] = self.p[0] / self.scale, self.p[1] / self.scale
        words["P"] = float(turns)
        self.circle("C", words, left, None, b)

    def retract(self, distance: float, line: int) -> None:
        """Carry out M140 MB: retract along the tool axis.

        Args:
            distance: Distance, mm.
            line: Line number in the file (1-based).
        """
        if self.along_z():
            words = {"Z": (self.p[2] + distance) / self.scale}
            if not math.isnan(self.p[2]):
                self.motion = 0
                self.move(words, ProgramBlock(line=line, words=[]))
            return
        self.mark_position_unknown({}, "M140", line)

    # ---- ends of contours and corners

    def wait_for_corner(self, kind: CornerKind, size: float, f: float | None, line: int) -> None:
        """Read RND or CHF (DIN/ISO: G25, G24): a corner with its size and its own feed.

        Args:
            kind: Rounding or chamfer.
            size: Radius or length, program units.
            f: Feed in program units per minute, None where not given.
            line: Line number in the file (1-based).

        Raises:
            InputError: the size is not positive.
        """
        feed, own = self.feed, None
        if f is not None:
            self.feed_word(f, line)
            own = self.feed * self.feed_scale
        self.feed = feed
        if not size > 0.0:
            raise self.source.build_error(
                f"a {'rounding' if kind == 'round' else 'chamfer'} of {size:g}: expected a size above zero", line
            )
        self.corner = ContourCorner(kind, size * self.scale, line, own)

    def lead_in(self, approach: ContourApproach) -> None:
        """Carry out APPR: the path to the first contour point follows once the next element is known.

        Args:
            approach: The pending approach.

        Raises:
            InputError: the position before the approach or its target is not known.
        """
        self.end_contour("an approach (APPR) follows")
        if any(map(math.isnan, (*self.p, *approach.place))):
            raise self.source.build_error("APPR from or to a place that is not known", approach.line)
        self.approach = approach
        self.p = list(approach.place)

    def end_contour(self, why: str) -> None:
        """End the contour.

        Args:
            why: Reason, for the message.

        Raises:
            InputError: an approach, a rounding or a chamfer still waits for the next element.
        """
        if self.approach is not None:
            raise self.source.build_error(f"APPR without a contour element after it: {why}", self.approach.line)
        super().end_contour(why)

    def turn_corner(self, one: ContourSegment, axis: Vector, line: int) -> ContourSegment:
        """Add the pending approach or corner before an element.

        Args:
            one: The element behind it.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).

        Returns:
            The part of the element that is left.
        """
        approach, self.approach = self.approach, None
        if approach is not None:
            tangent = one.element(self.plane).direction(one.element(self.plane).start)
            path = approach.path.compute_approach(
                convert_to_plane_point(one.start), tangent, convert_to_plane_point(np.array(approach.start))
            )
            self.p = list(approach.start)
            self.move_to_contour(path.helper, approach.place[2], approach, axis)
            if path.centre is not None:
                self.lead_arc(path, one.start, axis, approach.feed, approach.line)
            else:
                self.go(one.start.tolist(), axis, MoveKind.CUT, approach.feed, approach.line)
            self.end_contour("")
            one = dataclasses.replace(one, first=len(self.out))
        return super().turn_corner(one, axis, line)

    def move_to_contour(self, helper: complex, height: float, approach: ContourApproach, axis: Vector) -> None:
        """Move to the auxiliary point: first in the plane, then along the tool axis.

        Args:
            helper: Auxiliary point in the working plane, mm.
            height: Height of the contour, mm.
            approach: The pending approach.
            axis: Tool axis in programmed coordinates, unit vector.
        """
        for z in (self.p[2], height):
            to = [helper.real, helper.imag, z]
            if to != self.p:
                move = MoveKind.RAPID if math.isnan(approach.feed_before) else MoveKind.CUT
                self.go(to, axis, move, approach.feed_before, approach.line)

    def lead_arc(self, path: LeadPath, end: Array, axis: Vector, feed: float, line: int) -> None:
        """Add the arc of an approach or departure.

        Args:
            path: Path of the approach or departure in the working plane.
            end: End point (3,) in programmed mm.
            axis: Tool axis in programmed coordinates, unit vector.
            feed: Feed, mm/min.
            line: Line number in the file (1-based).
        """
        assert path.centre is not None
        centre = np.array([path.centre.real, path.centre.imag, self.p[2]])
        normal = self.plane * (1.0 if path.left else -1.0)
        modal, self.feed = self.feed, feed / self.feed_scale
        self.along_arc(ProgrammedArc(np.array(self.p), end, centre, normal), axis, line)
        self.feed = modal

    def lead_out(self, path: LeadIn, outside: complex | None, height: float | None, line: int) -> None:
        """Carry out DEP: leave the last contour element.

        Args:
            path: The departure.
            outside: Position after it in the working plane, mm; None where not given.
            height: Height after it, mm; None where not given.
            line: Line number in the file (1-based).

        Raises:
            InputError: there is no contour element before the departure.
        """
        if self.segment is None or np.isnan(self.segment.end).any():
            raise self.source.build_error("DEP without a contour element before it", line)
        if self.corner is not None:
            raise self.source.build_error(
                "a rounding or chamfer before DEP: no contour element follows it", self.corner.line
            )
        element = self.segment.element(self.plane)
        found = path.compute_departure(element.end, element.direction(element.end), outside)
        feed = self.feed_mm_min(1.0, line)
        axis, z = self.axis, self.p[2]
        end = np.array([found.helper.real, found.helper.imag, z])
        if found.centre is not None:
            self.lead_arc(found, end, axis, feed, line)
        else:
            self.go(end.tolist(), axis, MoveKind.CUT, feed, line)
        if outside is not None:
            self.go([outside.real, outside.imag, z], axis, MoveKind.CUT, feed, line)
        if height is not None and height != z:
            self.go([*self.p[:2], height], axis, MoveKind.CUT, feed, line)
        self.side, self.segment = 0.0, None  # DEP ends the compensation

    # ---- tools and cycles

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

    def call_tool(self, tool: str, rpm: float | None, text: str, line: int) -> None:
        """Carry out a tool call.

        Args:
            tool: Name or number of the tool.
            rpm: Spindle speed in 1/min, None where not given.
            text: Text of the call.
            line: Line number in the file (1-based).

        Raises:
            InputError: the tool axis of the call is not Z.
        """
        if rpm is not None:
            self.rpm = rpm
            self.out.event("spindle", text, self.rpm)
        feed = re.search(r"\bF\s*" + NUMBER, _QUOTED.sub("", text))
        if feed:
            self.feed_word(parse_value(feed.group(1)), line)
            self.tool_feed = self.feed  # F AUTO goes back to it
        for found in re.finditer(r"\b(D[LR]2?)\s*" + NUMBER, _QUOTED.sub("", text)):
            if parse_value(found.group(2)):
                self.out.warn_once(
                    f"{found.group(1)} of TOOL CALL (oversize of the tool) is not carried out: the points are as "
                    "programmed",
                    line,
                )
        axis = _TOOL_AXIS.match(_QUOTED.sub('""', text))
        if axis and axis.group(1) != "Z":
            raise self.source.build_error(
                f"the tool axis is {axis.group(1)} (another working plane than XY): not supported; post it with Z, "
                "and tilt the plane by PLANE",
                line,
            )
        if tool:
            self.out.event("tool", text, float(tool) if tool.isdigit() else math.nan)
            self.out.change_tool(tool)

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
