"""Heidenhain conversational programs (``BEGIN PGM``): L, LN, CC, C, CR, LP, CP, PLANE, CYCL DEF, LBL, Q parameters.

The circle centre CC is modal. Under M128 or FUNCTION TCPM the points are tool tip positions. LN gives the tool axis as
TX, TY, TZ.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from machopt.data_types.toolpath import Toolpath
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.toolpath.readers.gcode.block_motion import TANGENTIAL
from machopt.toolpath.readers.gcode.fast_linear_move_reader import HEIDENHAIN, read_plain_lines
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.heidenhain.datums_and_planes import NUMBER, parse_value
from machopt.toolpath.readers.heidenhain.definition_sentences import DefinitionReader
from machopt.toolpath.readers.heidenhain.number_notation import refuse_strange_numbers
from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError

_M_WITH_WORDS = re.compile(r"\s*M(103|118|120)(?![0-9])(?:\s*(?:F|LA|[XYZABC])\s*[+-]?[0-9.]+)+")
_NEEDS_FLOW = re.compile(r"\b(?:LBL|FN)\b|\bQ[0-9]+(?![0-9]*\s*=\s*[-+]?[0-9.])", re.IGNORECASE)
_IGNORED = (
    "BLK FORM",
    "TOOL DEF",
    "LBL",
    "STOP",
    "FUNCTION MODE MILL",
    "FUNCTION FEED DWELL",
    "FUNCTION RESET FEED DWELL",
    "FUNCTION S-PULSE",
    "FUNCTION RESET S-PULSE",
    "FUNCTION DWELL",
    "FUNCTION COUNT",
)
_OUTPUT = re.compile(r"FN (15|16|38)\b")  # texts for the screen, files or the network
_NAME = re.compile(r"[A-Z][A-Z-]+(?: [A-Z][A-Z-]+)*")  # words that a sentence begins with
_CORNER = re.compile(r"(RND|CHF)\s+(?:R\s*)?" + NUMBER + r"(?:\s+F\s*" + NUMBER + ")?$")
_MOVE = re.compile(
    r"(?:LN?|CC|CR|CT|C|LP|CP|M\s*[0-9]+)(?=\s|$|[0-9])|I?[XYZABC]\s*[+-]?\.?[0-9]|R0\b|F ?MAX\b|S ?[0-9]"
)
_REFUSED = {
    "CTP": "polar tangential arcs",
    "FN": "formulas",
    "FPOL": "free contours",
    "FLT": "free contours",
    "FL": "free contours",
    "FCT": "free contours",
    "FC": "free contours",
    "SEL": "other programs and tables",
    "CYCL CALL PAT": "point patterns",
}


def read_heidenhain(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read a conversational program.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    return _ConversationalReader(source, options).run()


class _ConversationalReader(DefinitionReader):
    def run(self) -> Toolpath:
        try:
            if self.source.find_line(_NEEDS_FLOW) is None and self.scale == 1.0:
                self.carry_out_lines()
            else:
                self.carry_out(self.label_flow().run())
        except ProgramFlowError as problem:
            raise self.source.build_error(str(problem), problem.line) from problem
        toolpath_ends = self.ended
        self.ended = True
        if not toolpath_ends:
            self.out.incomplete_reason = "no END PGM" + (
                "" if self.source.complete else " and the last line does not end: its last number may be cut off"
            )
        return self.finish()

    def plain_from(self, at: int) -> int:
        return at if self.left_out or self.approach else read_plain_lines(self, at, HEIDENHAIN, linear=True)

    def first_unit(self, source: SourceFile, options: ReadOptions) -> tuple[str, str]:
        named = None
        for line in source.lines:
            found = re.search(r"BEGIN\s+PGM\s+\S.*?\b(MM|INCH|IN)\s*$", line, re.IGNORECASE)
            if found:
                named = "mm" if found.group(1).upper() == "MM" else "inch"
                break
        option_unit = options.unit
        if named is None and option_unit is None:
            raise source.build_option_question(
                "unit", "BEGIN PGM names neither MM nor INCH; give --unit mm or --unit inch"
            )
        if named and option_unit and named != option_unit:
            raise source.build_error(f"the program is in {named} but --unit {option_unit} was given")
        return named or option_unit or "", "BEGIN PGM" if named else "option"

    def clean(self, line: int, raw: str) -> tuple[str, list[str]] | None:
        found = super().clean(line, raw)
        if found is None:
            return None
        refuse_strange_numbers(self.source, found[0], line)
        text = re.sub(r"^\s*[0-9]+(?:\s+|$)", "", found[0]).rstrip("~ ").strip()
        return re.sub(r"\s+", " ", text), found[1]

    def code(self, line: int, text: str) -> None:
        self.close_pattern(text)
        if text.startswith("CYCLE DEF"):
            text = "CYCL DEF" + text[9:]
        if text.startswith("BEGIN PGM"):
            return
        if text.startswith("*"):  # a heading of the program's structure
            self.out.event("comment", text.lstrip("* -"))
            return
        if text.startswith("END PGM"):
            self.ended = True
            return
        parameters = self.parameters(text)
        if parameters and (text.startswith("Q") or not text.startswith("CYCL DEF")):
            self.take_parameters(parameters)
            if text.startswith("Q"):
                return
        if " COMPUTED" in text:
            text = self.insert_computed_angles(text, line)
        carry_out = next((done for begins, done in _SENTENCES if text.startswith(begins)), _ConversationalReader.other)
        carry_out(self, text, line)

    def call_cycle_at(self, text: str, line: int) -> None:
        words = text[13:]
        height = re.search(r"(?<![A-Z])I?Z[+-]?[0-9.]+", words)
        plane = re.search(r"(?<![A-Z])I?[XY][+-]?[0-9.]", words)
        if height is None or plane is None:
            self.statement(f"L {words} M99", line)
            return
        over = words.replace(height[0], "", 1)  # never a diagonal: over the place first, and up before that
        feed = re.search(r"F(?:MAX|[0-9.]+)", words)
        along = f"{height[0]} {feed[0] if feed else ''}"
        value = parse_value(height[0].lstrip("IZ"))
        goes_up = value > 0.0 if height[0].startswith("I") else value * self.scale > self.p[2]
        first, last = (along, over) if goes_up else (over, along)
        self.statement(f"L {first}", line)
        self.statement(f"L {last} M99", line)

    def other(self, text: str, line: int) -> None:
        """What is known by more than its first words: calls of a cycle, corners, moves; and what is left out."""
        if text == "CYCL CALL" or re.match(r"CYCL CALL (?:M|F)", text):
            self.drill_here(ProgramBlock(line=line, words=[]))
        elif found := _CORNER.match(text):
            feed = parse_value(found.group(3)) if found.group(3) else None
            self.wait_for_corner(
                "round" if found.group(1) == "RND" else "setback", parse_value(found.group(2)), feed, line
            )
        elif text.startswith(_IGNORED):
            word = next(w for w in _IGNORED if text.startswith(w))
            self.out.ignore(word, line, understood=True)
            if text.startswith("STOP"):
                self.out.event("stop", text)
                if re.search(r"\bM(?:2|30)\b", text):
                    self.ended = True
        elif _MOVE.match(text):
            self.statement(text, line)
        elif found := _OUTPUT.match(text):
            self.out.ignore(f"FN {found.group(1)}", line, understood=True)
        else:
            for word, reason in _REFUSED.items():
                if re.match(re.escape(word) + r"\b", text):
                    raise self.source.build_error(
                        f"{text[:24]!r}: {reason} are not supported; export APT/CL data", line
                    )
            name = _NAME.match(text)
            self.out.ignore(name.group(0)[:40] if name else text[:14], line, understood=False)

    def statement(self, text: str, line: int) -> None:
        kind, rest = "L", text
        found = re.match(r"(LN|LP|L|CC|CR|CT|CP|C)(?![A-Z])", text)
        if found:
            kind, rest = found.group(1), text[found.end() :]
        if found := _M_WITH_WORDS.search(rest):  # their words are no coordinates
            rest = rest[: found.start()] + (" M118" if found.group(1) == "118" else "") + rest[found.end() :]
            if found.group(1) == "103":
                self.out.warn_once("M103 (slower plunges) is not carried out: feeds are as programmed", line)
        words, flags = self.split(rest, line)
        self.speeds(kind, words, flags, line)
        if kind == "CC":
            self.set_pole(words)
            return
        m_words = [int(f[1:]) for f in flags if re.fullmatch(r"M[0-9]+", f)]
        vector = [words.pop("T" + c, math.nan) for c in "XYZ"]
        for c in "XYZ":
            words.pop("N" + c, None)
        radius = words.pop("R", None)
        self.m_words(self.own_m_words(m_words, line), {}, line)
        if self.move_in_machine_frame(m_words, words, flags, line):
            return
        b = ProgramBlock(line=line, words=[])
        if words or not all(map(math.isnan, vector)):
            self.other_program(line)
        self.absolute(words, line)
        if not all(map(math.isnan, vector)):
            if self.setup.tcp is None:
                raise self.source.build_error("a tool vector (TX, TY, TZ) outside of M128", line)
            b.named.update({n: (0.0 if math.isnan(v) else v) for n, v in zip(("A3", "B3", "C3"), vector, strict=True)})
        left = next((f == "DR+" for f in flags if f.startswith("DR")), None)
        self.along(kind, words, left, radius, b)
        if 99 in m_words:
            self.drill_here(b)
        if any(m in (2, 30) for m in m_words):
            self.ended = True

    def speeds(self, kind: str, words: dict[str, float], flags: list[str], line: int) -> None:
        """How fast it goes from here on: rapid, feed, spindle; takes their words out."""
        if "FMAX" in flags:
            self.motion = 0
        elif kind in ("L", "LN", "LP"):
            self.motion = 1
        if "FAUTO" in flags:
            self.feed = self.tool_feed
        if "F" in words:
            self.feed_word(words.pop("F"), line)
        if "S" in words:
            self.rpm = words.pop("S")
            self.out.event("spindle", f"S{self.rpm:g}", self.rpm)

    def move_in_machine_frame(self, m_words: list[int], words: dict[str, float], flags: list[str], line: int) -> bool:
        """Carry out a move in the machine's own frame, or away along the tool; False where it is none."""
        if any(m in (91, 92) for m in m_words):
            self.mark_position_unknown(words, "M91", line)
            return True
        if 140 not in m_words:
            return False
        back = next((f[2:] for f in flags if f.startswith("MB")), "MAX")
        if back == "MAX":
            self.mark_position_unknown({"Z": 0.0} if self.along_z() else {}, "M140", line)
        else:
            self.retract(parse_value(back) * self.scale, line)
        return True

    def along(
        self, kind: str, words: dict[str, float], left: bool | None, radius: float | None, b: ProgramBlock
    ) -> None:
        """The move that the words say; ``left`` is the sense of an arc."""
        if kind in ("C", "CR"):
            self.circle(kind, words, left, radius, b)
        elif kind == "CP":
            self.polar_circle(words, left, b)
        elif kind == "CT":
            self.motion = TANGENTIAL
            self.move(words, b)
        elif words or b.named:
            if kind == "LP":
                self.to_cartesian(words, b.line)
            self.move(words, b)


_SENTENCES: tuple[
    tuple[str, Callable[[_ConversationalReader, str, int], None]], ...
] = (  # a sentence by its first words
    ("TOOL CALL", _ConversationalReader.tool_call),
    ("CYCL DEF", _ConversationalReader.define),
    ("CYCL CALL POS", _ConversationalReader.call_cycle_at),
    ("APPR ", _ConversationalReader.contour_end),
    ("DEP ", _ConversationalReader.contour_end),
    ("TRANS ", _ConversationalReader.trans),
    ("PLANE", _ConversationalReader.plane_statement),
    ("FUNCTION TCPM", _ConversationalReader.tcpm),
    ("FUNCTION RESET TCPM", _ConversationalReader.end_tcpm),
    ("PRESET", _ConversationalReader.select_preset),
    ("CALL PGM", _ConversationalReader.call_program),
)
