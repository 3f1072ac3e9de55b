"""Heidenhain DIN/ISO programs (``%NAME G71 *``): modal pole I, J; cycles G200 …; labels G98 L.

The words differ from G-code: G54 shifts the datum, G73 rotates, G80 tilts the plane, G79 calls a cycle, G10 to G13 are
polar moves.
"""

from __future__ import annotations

import math
import re

from machopt.data_types.toolpath import Toolpath
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.dialect_detection import HEIDENHAIN_ISO
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.heidenhain.control_reader import HeidenhainControlReader
from machopt.toolpath.readers.heidenhain.datums_and_planes import NUMBER, parse_value
from machopt.toolpath.readers.heidenhain.number_notation import refuse_strange_numbers
from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError

_WORD = re.compile(r"\s*([A-Z])\s*" + NUMBER)
_Q = re.compile(r"\s*Q([0-9]+)\s*=\s*" + NUMBER)
_MIRROR = re.compile(r"(?:G9[01]\s*)?G28(?:\s*[XYZABC])*")
_REFUSED = {
    6: "G6 (tangential arc)",
    16: "G16 (polar tangential arc)",
    26: "G26 (tangential approach)",
    27: "G27 (tangential departure)",
    28: "G28 (mirroring)",
    72: "G72 (scaling)",
    18: "G18 (another tool axis)",
    19: "G19 (another tool axis)",
    20: "G20 (another tool axis)",
    53: "G53 (datum table)",
    5: "G5 (arc without a direction)",
    15: "G15 (polar arc without a direction)",
}


def read_heidenhain_iso(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read a DIN/ISO program.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    return _DinIsoReader(source, options).run()


class _DinIsoReader(HeidenhainControlReader):
    format = "heidenhain-iso"
    mode = 0  # 0 … 3 or 10 … 13: the motion that holds

    def run(self) -> Toolpath:
        try:
            self.carry_out(self.label_flow().run())
        except ProgramFlowError as problem:
            raise self.source.build_error(str(problem), problem.line) from problem
        whole, self.ended = self.ended, True
        if not whole:
            self.out.incomplete_reason = "the program's last block (N99999999 %…) is missing"
        return self.finish()

    def first_unit(self, source: SourceFile, options: ReadOptions) -> tuple[str, str]:
        found = HEIDENHAIN_ISO.search("\n".join(source.lines))
        named = None if not found else "inch" if found.group(1) == "0" else "mm"
        if named is None and options.unit is None:
            raise source.build_option_question(
                "unit", "has no G70 or G71 in its first block; give the unit with --unit mm or --unit inch"
            )
        if named and options.unit and named != options.unit:
            raise source.build_error(f"the program is in {named} but --unit {options.unit} was given")
        return named or options.unit or "", "first block" if named else "option"

    def clean(self, line: int, raw: str) -> tuple[str, list[str]] | None:
        if raw.lstrip().startswith("%"):
            if HEIDENHAIN_ISO.match(raw) or not raw.strip("% \t*"):
                return None
            raw = "N0 " + raw.lstrip()
        found = super().clean(line, raw)
        if found is None:
            return None
        refuse_strange_numbers(self.source, found[0], line)
        text = re.sub(r"^\s*N\s*[0-9]+\s*", "", found[0])
        if re.match(r"%.*G7[01]", text):
            return "END", found[1]
        if text.startswith("%"):
            raise self.source.build_error(
                f"{text.rstrip('* ')} calls a program that is not in this file; expand it into one program", line
            )
        return text.rstrip("* ").strip(), found[1]

    def code(self, line: int, text: str) -> None:
        if text == "END":
            self.ended = True
            return
        cycle = re.match(r"G(2[0-9][0-9])(?![0-9.])", text)
        if cycle or _Q.match(text):
            if cycle:
                self.begin_q_cycle(int(cycle.group(1)), line)
            for number, v in _Q.findall(text):
                self.q[int(number)] = parse_value(v)
            return
        if " COMPUTED" in text:
            text = self.insert_computed_angles(text, line)
        if _MIRROR.fullmatch(text):  # its axes have no numbers; none: off
            self.mirror_axes(text[text.index("G28") + 3 :], "G28", line)
            return
        self.iso_block(*self.split(text, line), ProgramBlock(line=line, words=[]))

    def split(self, text: str, line: int) -> tuple[dict[str, float], list[int], list[int]]:
        words: dict[str, float] = {}
        g: list[int] = []
        m: list[int] = []
        at = 0
        while at < len(text.rstrip()):
            found = _WORD.match(text, at)
            if not found:
                raise self.source.build_error(
                    f"found {text[at:].strip()[:20]!r}; expected words such as X10.5 or G1", line
                )
            letter, number = found.group(1), parse_value(found.group(2))
            at = found.end()
            if letter in "GM":
                if not 0.0 <= number < 1000.0 or number != round(number):
                    raise self.source.build_error(f"{letter}{number:g} is not a word of this control", line)
                (g if letter == "G" else m).append(round(number))
            elif letter in words:
                raise self.source.build_error(f"{letter} is given twice in one block", line)
            else:
                words[letter] = number
        return words, g, m

    def iso_block(self, words: dict[str, float], g_words: list[int], m_words: list[int], b: ProgramBlock) -> None:
        special = 0
        for g in g_words:
            if g in (0, 1, 2, 3, 10, 11, 12, 13):
                self.mode = g
            elif g in (90, 91):
                self.incremental = g == 91
            elif g in (41, 42):
                self.out.warn_once("radius compensation (G41, G42) is not carried out: points as programmed", b.line)
            elif g in (4, 24, 25, 54, 73, 79, 80, 98):
                special = g
            elif g in _REFUSED:
                raise self.source.build_error(f"{_REFUSED[g]} is not supported; export it as G0 to G3", b.line)
            elif g not in harmless_words.DIN_ISO:
                raise self.source.build_error(f"G{g} is not known in DIN/ISO programs here", b.line)
        if 30 in g_words or 31 in g_words or 99 in g_words:
            return
        if special in (24, 25):
            if words.keys() - {"R", "F"} or "R" not in words:
                raise self.source.build_error(f"G{special}: expected R and perhaps F, nothing else", b.line)
            self.wait_for_corner("round" if special == 25 else "setback", words["R"], words.get("F"), b.line)
            return
        if "F" in words and special != 4:
            self.feed_word(words.pop("F"), b.line)
        if "T" in words:
            self.call_tool(f"{words.pop('T'):g}", words.get("S"), f"T S{words.get('S', 0.0):g}", b.line)
            words.pop("S", None)
        if "S" in words:
            self.rpm = words.pop("S")
            self.out.event("spindle", f"S{self.rpm:g}", self.rpm)
        for letter in "DE":
            if letter in words:
                words.pop(letter)
                self.out.ignore(letter, b.line, understood=True)
        self.m_words(self.own_m_words(m_words, b.line), {}, b.line)
        if 91 in m_words or 92 in m_words:
            self.mark_position_unknown(words, "M91", b.line)
        elif special == 4:
            self.out.event("dwell", "G4", words.get("F", math.nan))
        elif special == 54:
            self.shift_datum({("I" if self.incremental else "") + k: v for k, v in words.items() if k in "XYZ"}, b.line)
        elif special == 73:
            more = self.turned_by if self.incremental else 0.0  # G73 G91 H: on top of the rotation in force
            self.turn_plane(words.get("H", 0.0) + more, b.line)
        elif special == 80:
            self.tilt_angles({k: v for k, v in words.items() if k in "ABC"}, b.line)
        elif special != 98:
            self.iso_move(words, b)
        if 99 in m_words or special == 79:
            self.drill_here(b)
        if any(m in (0, 2, 30) for m in m_words) and not set(m_words) - {0, 2, 30} and m_words[-1] != 0:
            self.ended = True

    def iso_move(self, words: dict[str, float], b: ProgramBlock) -> None:
        poles = {"IJK"[k]: words.pop("IJK"[k]) for k in range(3) if "IJK"[k] in words}
        named = {("I" if self.incremental else "") + "XYZ"["IJK".index(c)]: v for c, v in poles.items()}
        self.set_pole(named)
        if not words.keys() & set("XYZABCRH") and not (poles and self.mode in (2, 3)) and self.mode not in (2, 3):
            return
        if self.mode in (2, 3) and not words.keys() & set("XYZR") and not poles:
            return
        radius = words.pop("R", None)
        if self.mode >= 10:
            prefix = "I" if self.incremental else ""
            if radius is not None:
                words[prefix + "PR"] = radius
            if "H" in words:
                words[prefix + "PA"] = words.pop("H")
            if self.incremental:
                words = {("I" + k if k in "XYZ" else k): v for k, v in words.items()}
                self.absolute(words, b.line)
            self._remove_increments(words, b)
            return
        if self.incremental:
            words = {("I" + k if k in "XYZABC" else k): v for k, v in words.items()}
            self.absolute(words, b.line)
        self.incremental, before = False, self.incremental
        self.motion = self.mode
        if self.mode in (2, 3):
            self.circle("CR" if radius is not None else "C", words, self.mode == 3, radius, b)
        elif words:
            self.move(words, b)
        self.incremental = before

    def _remove_increments(self, words: dict[str, float], b: ProgramBlock) -> None:
        """G10 to G13: the words are absolute by now."""
        self.incremental, before = False, self.incremental
        self.motion = {10: 0, 11: 1}.get(self.mode, 1)
        if self.mode in (12, 13):
            self.polar_circle(words, self.mode == 13, b)
        else:
            self.to_cartesian(words, b.line)
            self.move(words, b)
        self.incremental = before
