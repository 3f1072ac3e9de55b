"""Common part of the Heidenhain readers (conversational, DIN/ISO): pole, polar moves, datum chain, cycles, tools."""

from __future__ import annotations

import math
import re

import numpy as np

from machopt.file_formats.source_file import MM_PER_INCH, ReadOptions, SourceFile
from machopt.path_building.arc_chords import ArcError
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourCorner, CornerKind
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.word_meanings import PLANES
from machopt.toolpath.readers.heidenhain.cycle_calls import CycleCallReader
from machopt.toolpath.readers.heidenhain.datums_and_planes import NUMBER, parse_value
from machopt.toolpath.readers.heidenhain.label_flow import LabelFlow

_TOOL_AXIS = re.compile(r"TOOL CALL\s*(?:\"\"|[0-9]+)?\s*([XYZUVW])\b")
_QUOTED = re.compile(r"\"[^\"]*\"")


class HeidenhainControlReader(CycleCallReader):
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
                f"{name} is called in line {at}; that program is not in this file, so where the tool is after it "
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

    # ---- tools

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
