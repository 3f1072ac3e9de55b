"""G-code reader: three axes, and five axes under tool-centre-point control (G43.4, G234, TRAORI, vectors).

Coordinates are those of the active work offset, which is ``workpiece``. Without tool-centre-point control X Y Z
depend on where the machine's rotary axes lie: cuts with a turned axis are refused then.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np

from machopt.domain.toolpath import Toolpath
from machopt.formats.arcs import ArcError
from machopt.formats.gcode_blocks import Block, BlockReader
from machopt.formats.gcode_cycles import SIEMENS, siemens_cycle
from machopt.formats.gcode_expr import ExpressionError
from machopt.formats.gcode_motion import MotionReader
from machopt.formats.gcode_words import (
    CYCLES,
    FEED_MODES,
    IGNORED_CALLS,
    MACHINE_FRAME,
    MOTION,
    NO_EFFECT,
    NO_EFFECT_M,
    OFFSETS,
    PLANES,
    PROGRAM_END,
    REFUSED,
    REFUSED_CALLS,
    UNITS,
)
from machopt.formats.holecycle import CycleError
from machopt.formats.source import UNIT_NAMES, ReadOptions, Source
from machopt.formats.unknowns import fill_unknown

_OPERATION = re.compile(r"^\W*(?:OPER(?:ATION)?(?:[ _]*NAME)?|TOOLPATH|PATH)\s*[:=]\s*(.*?)[\s*]*$", re.IGNORECASE)
_SIEMENS = re.compile(r"\b(?:TRAORI|TRAFOOF|MCALL|CYCLE\d+|MSG|SUPA|DEF\s+REAL|CR\s*=|R\d+\s*=|A3\s*=)")
_O_WORD = re.compile(r"\s*O\s*(?:<|\d+\s*(?:SUB|IF|ELSE|WHILE|DO|REPEAT|CALL|ENDSUB|RETURN)|\[)")
_HALF_WORD = re.compile(r"(?:^|\s)[XYZABCGIJKRFUVW]\s*[-+.\d]|^[-+.\d]")
_RUN_TOGETHER = re.compile(r"[XYZABCGIJKRFM]+\d\w*")
_UNIT_WORD = re.compile(r"G0*(20|21|70|71)(?![\d.])")
_Z = (0.0, 0.0, 1.0)
_AXES = "XYZ"


def read_gcode(source: Source, options: ReadOptions) -> Toolpath:
    """Read a G-code program.

    Raises:
        InputError: see :func:`machopt.formats.toolpath.read_toolpath`.
    """
    return ProgramReader(source, options).run()


class ProgramReader(MotionReader):
    """Carries out G, M and other words of G-code; Heidenhain's conversational reader builds on it."""

    def __init__(self, source: Source, options: ReadOptions) -> None:
        self.siemens = any(_SIEMENS.search(t.upper().partition(";")[0]) for t in source.lines[:2000])
        self.blocks = BlockReader(parentheses_are_comments=not self.siemens)
        unit, self.unit_from = self.first_unit(source, options)
        super().__init__(source, options, unit)
        self.out.meta.update(unit=unit, unit_from=self.unit_from)
        self.offset: int | None = None
        self.next_tool = math.nan
        self.ended = False

    def run(self) -> Toolpath:
        for line, text in self.code_lines():
            try:
                self.code(line, text)
            except (ExpressionError, ArcError, CycleError) as problem:
                raise self.source.error(str(problem), line) from problem
        if not self.ended and not self.source.complete:
            self.out.warn("no program end (M30, M2) and no line end: the file may be cut off", len(self.source.lines))
        if len(self.out):
            self.out.replace_positions(fill_unknown(self.out.positions(), self.out))
        self.compare_rotary_signs()
        return self.out.build()

    def code(self, line: int, text: str) -> None:
        self.block(self.blocks.block(line, text))

    def code_lines(self) -> Iterator[tuple[int, str]]:
        """Line number and code in upper case, comments told and taken out."""
        listing = 0  # "====" lines of an information listing; the program starts after the second
        for line, raw in enumerate(self.source.lines, 1):
            if raw.startswith("====="):
                listing += 1
            if listing and (listing < 2 or raw.startswith("=====")):
                self.out.ignore("information listing header", line, understood=True)
                continue
            text = raw.strip(" \t\x1a\f")
            if not text or text.startswith("%"):
                continue
            if self.ended:
                self.out.ignore("text after the program end", line, understood=True)
                continue
            if text.startswith("/"):
                self.out.ignore("/ (block delete; the block is read)", line, understood=True)
                text = text.lstrip("/0123456789")
            if "(" in text or ";" in text:
                text, comments = self.blocks.comments(text)
                for comment in comments:
                    self.comment(comment)
            text = text.upper()
            if _O_WORD.match(text):
                raise self.source.error(
                    "LinuxCNC subroutines and loops (O words) are not followed; expand them first", line
                )
            if not text.isspace() and text:
                yield line, text

    def first_unit(self, source: Source, options: ReadOptions) -> tuple[str, str]:
        """The unit by the file's first unit word, else the option's; and where it is from."""
        found: str | None = None
        where: int | None = None
        for line, raw in enumerate(source.lines, 1):
            if "G" in raw or "g" in raw:
                text, _ = self.blocks.comments(raw) if "(" in raw or ";" in raw else (raw, [])
                word = _UNIT_WORD.search(text.upper())
                if word:
                    found, where = UNITS[int(word.group(1)) * 10], line
                    break
        unit = options.unit
        if found is None and unit is None:
            raise source.error("has no G20 or G21 (G70, G71); give the unit with --unit mm or --unit inch")
        if found is not None and unit is not None and found != unit:
            raise source.error(f"the file is in {found} but --unit {unit} was given", where)
        return found or unit or "", "G word" if found else "option"

    def comment(self, text: str) -> None:
        found = _OPERATION.match(text)
        if found and found.group(1):
            self.out.begin_operation(found.group(1))
        elif text:
            self.out.event("comment", text)

    # ---- one block

    def block(self, b: Block) -> None:
        if b.junk:
            if re.match(r"[A-Z]\s*=|[A-Z]\d*\s*=|.*[=(*]", b.junk):
                raise self.source.error(
                    f"{b.junk[:30]!r}: variables and formulas are not evaluated; expand the program first", b.line
                )
            if b.words or _HALF_WORD.search(b.junk):
                raise self.source.error(f"found {b.junk[:30]!r}; expected words such as X10.5 or G1", b.line)
            self.out.ignore(b.junk[:24], b.line, understood=False)
        words: dict[str, float] = {}
        g_words: list[int] = []
        m_words: list[int] = []
        for letter, value in b.words:
            if letter == "G":
                g_words.append(round(value * 10))
            elif letter == "M":
                m_words.append(round(value))
            elif letter in ("N", "O"):
                continue
            else:
                if letter in words:
                    raise self.source.error(f"{letter} stands twice in one block", b.line)
                words[letter] = value
        for name, args in b.calls:
            self.call(name, args, words, b.line)
        if any(name == "MCALL" for name, _ in b.calls):
            self.once = 0  # the cycle is carried out at the points that follow
        for name in b.named:
            if name not in ("CR", "A3", "B3", "C3", "TURN"):
                if re.fullmatch(r"R\d+", name):
                    raise self.source.error(
                        f"{name}=…: R parameters are not evaluated; expand the program first", b.line
                    )
                self.out.ignore(f"{name}=", b.line, understood=False)
        machine_frame = self.g_words(g_words, words, b)
        if any(name == "SUPA" for name, _ in b.calls) or 91 in m_words:
            machine_frame = "SUPA" if 91 not in m_words else "M91"
        self.numbers(words, b)
        self.m_words(m_words, words, b.line)
        if machine_frame:
            self.lose(words, machine_frame, b.line)
        else:
            self.move(words, b)
        if any(m in PROGRAM_END for m in m_words):
            self.ended = True

    def g_words(self, g_words: list[int], words: dict[str, float], b: Block) -> str | None:
        """Carry out the G words; the name of a machine-frame word where the block has one."""
        machine_frame = None
        for g in g_words:
            if g in MOTION:
                self.motion = MOTION[g]
                self.canned = None
            elif g in (900, 910):
                self.incremental = g == 910
            elif g in UNITS:
                self.scale = UNIT_NAMES[UNITS[g]]
            elif g in FEED_MODES:
                self.feed_mode = FEED_MODES[g]
            elif g in PLANES:
                self.plane = np.array(PLANES[g])
            elif g in (901, 911):
                self.absolute_centre = g == 901
            elif g == 800:
                self.canned = None
            elif g in (980, 990):
                self.back_to_initial = g == 980
            elif g == 40:
                self.dwell(words, b)
            elif g in (434, 435, 2340):
                self.tcp = "vector" if g == 435 else "angles"
            elif g == 490:
                self.tcp = None
            elif g in (410, 420):
                self.out.warn_once(
                    "cutter compensation (G41, G42) is not carried out: the points are as programmed", b.line
                )
                self.out.ignore(f"G{g // 10}", b.line, understood=True)
            elif g in MACHINE_FRAME and not (g == 740 and {"R", "Z"} <= words.keys()):
                machine_frame = MACHINE_FRAME[g]
            elif g in CYCLES:
                self.begin_cycle(g // 10, b)
            elif g in (100, 920, 921, 520):
                self.shift(g, words, b.line)
            elif g in OFFSETS:
                self.use_offset(g, words, b.line)
            elif g == 50 and (not words.keys() & set(_AXES)):
                self.out.ignore("G5", b.line, understood=True)  # G5 P10000: high speed mode
                words.pop("P", None)
            elif g == 70 and not (words.keys() | b.named.keys()) - {"F", "S"}:
                self.out.ignore("G7", b.line, understood=False)
            elif g in REFUSED:
                raise self.source.error(f"{REFUSED[g]}: not supported; export without it", b.line)
            elif g in NO_EFFECT:
                if g in (51, 81, 640, 1870):
                    words.pop("P", None), words.pop("Q", None)
            else:
                name = f"G{g / 10:g}"
                if words.keys() & set("XYZABC"):
                    raise self.source.error(f"{name} is not known, and it stands with axis words", b.line)
                self.out.ignore(name, b.line, understood=False)
        return machine_frame

    def use_offset(self, g: int, words: dict[str, float], line: int) -> None:
        number = g * 1000 + (round(words.pop("P", 0.0)) if g == 541 else 0)
        if self.offset is not None and number != self.offset and len(self.out):
            raise self.source.error(
                f"the work offset changes from {_offset_name(self.offset)} to {_offset_name(number)}: how they lie "
                "to each other is not in the file; split it, one offset in each",
                line,
            )
        self.offset = number
        self.out.meta["work_offset"] = _offset_name(number)

    def shift(self, g: int, words: dict[str, float], line: int) -> None:
        axes = words.keys() & set("XYZABC")
        if g == 520 and not any(words[a] for a in axes):
            self.out.ignore("G52", line, understood=True)
        elif len(self.out) and axes:
            raise self.source.error(f"G{g / 10:g} moves the origin in the middle of the path: not supported", line)
        else:
            self.out.ignore(f"G{g / 10:g}", line, understood=True)
        words.clear()

    def numbers(self, words: dict[str, float], b: Block) -> None:
        if "F" in words:
            self.feed = words.pop("F")
        if "S" in words:
            self.rpm = words.pop("S")
            self.out.event("spindle", f"S{self.rpm:g}", self.rpm)
        if "T" in words:
            number = words.pop("T")
            self.next_tool = number
            self.out.ignore("T", b.line, understood=True)
        for letter in ("H", "D", "E"):
            if letter in words:
                words.pop(letter)
                self.out.ignore(letter, b.line, understood=True)
        for letter in ("U", "V", "W"):
            value = words.pop(letter, 0.0)
            if value and not self.siemens:
                self.out.ignore(letter, b.line, understood=False)

    def m_words(self, m_words: list[int], words: dict[str, float], line: int) -> None:
        for m in m_words:
            if m in (3, 4, 5):
                self.out.event("spindle", f"M{m}", 0.0 if m == 5 else self.rpm)
            elif m in (7, 8, 9):
                self.out.event("coolant", f"M{m}")
            elif m in (0, 1):
                self.out.event("stop", f"M{m}")
            elif m == 6:
                self.out.event("tool", f"T{self.next_tool:g} M6", self.next_tool)
                tool = "" if math.isnan(self.next_tool) else f"{self.next_tool:g}"
                self.out.change_tool(tool)
            elif m in (97, 98):
                raise self.source.error(f"M{m} calls a subprogram; expand it into one program first", line)
            elif m in (128, 428):
                self.tcp = "angles"
                if m == 428 and self.machine and not self.machine.name.endswith("-reversed"):
                    self.out.warn_once(
                        "M428 is LinuxCNC's switch; its table kinematics turn the other way: machine …-reversed?", line
                    )
            elif m in (129, 429, 430):
                self.tcp = None
            elif m not in PROGRAM_END and m != 91:
                self.out.ignore(f"M{m}", line, understood=m in NO_EFFECT_M)
                words.pop("P", None)
                words.pop("Q", None)

    def dwell(self, words: dict[str, float], b: Block) -> None:
        value = math.nan
        for letter in ("X", "U", "P", "F"):
            if letter in words:
                value = words.pop(letter)
                if letter == "P" and "P" in b.integers:
                    value = value / 1e3 if value >= 100.0 else math.nan  # ms on Fanuc, s on LinuxCNC
                    if math.isnan(value):
                        self.out.warn_once("G4 P without a decimal point: seconds or milliseconds is not known", b.line)
                break
        self.out.event("dwell", "G4", value)

    def call(self, name: str, args: str, words: dict[str, float], line: int) -> None:
        if name in REFUSED_CALLS:
            raise self.source.error(f"{name}: {REFUSED_CALLS[name]}", line)
        if name == "TRAORI":
            self.tcp = "angles"
        elif name in ("TRAFOOF", "TRAOOF"):
            self.tcp = None
        elif name == "MCALL":
            self.modal_call = None
        elif name == "MSG" and (found := _OPERATION.match(args.strip('"'))):
            self.out.begin_operation(found.group(1))
            return
        elif SIEMENS.fullmatch(name):
            if not self.out_z():
                raise self.source.error(f"{name} with a tilted tool axis is not supported", line)
            feed = words.get("F", self.feed) * self.scale
            self.modal_call = siemens_cycle(name, args, self.scale, feed)
            self.once = line
            return
        if re.fullmatch(r"L\d+", name):
            raise self.source.error(f"{name} calls a subprogram; expand it into one program first", line)
        if _RUN_TOGETHER.fullmatch(name):
            raise self.source.error(f"found {name!r}; expected words such as X10.5 or G1", line)
        self.out.ignore(name, line, understood=name in IGNORED_CALLS)


def _offset_name(number: int) -> str:
    g, p = divmod(number, 1000)
    return f"G{g / 10:g}" + (f" P{p}" if p else "")
