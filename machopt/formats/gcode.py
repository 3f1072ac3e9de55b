"""G-code reader: three axes, and five axes under tool-centre-point control (G43.4, G234, TRAORI, vectors).

Coordinates are those of the active work offset, which is ``workpiece``. Without tool-centre-point control X Y Z
depend on where the machine's rotary axes lie: cuts with a turned axis are refused then.
"""

from __future__ import annotations

import math
import re

import numpy as np

from machopt.domain.toolpath import Array, Move, Toolpath
from machopt.errors import InputError
from machopt.formats import rotary
from machopt.formats.arcs import ArcError, arc, from_radius
from machopt.formats.gcode_blocks import Block, BlockReader
from machopt.formats.gcode_cycles import SIEMENS, Canned, siemens_cycle
from machopt.formats.gcode_expr import ExpressionError
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
from machopt.formats.holecycle import CycleError, HoleCycle, drill
from machopt.formats.pathbuilder import PathBuilder, Vector
from machopt.formats.rotary import Rotary
from machopt.formats.source import UNIT_NAMES, ReadOptions, Source
from machopt.formats.unknowns import fill_unknown

_OPERATION = re.compile(
    r"^\W*(?:OPER(?:ATION)?(?:[ _]*NAME)?|TOOLPATH|PATH)\s*[:=]\s*(.*?)[\s*]*$", re.IGNORECASE
)
_SIEMENS = re.compile(r"\b(?:TRAORI|TRAFOOF|MCALL|CYCLE\d+|MSG|SUPA|DEF\s+REAL|CR\s*=|R\d+\s*=|A3\s*=)")
_O_WORD = re.compile(r"\s*O\s*(?:<|\d+\s*(?:SUB|IF|ELSE|WHILE|DO|REPEAT|CALL|ENDSUB|RETURN)|\[)")
_UNIT_WORD = re.compile(r"G0*(20|21|70|71)(?![\d.])")
_Z = (0.0, 0.0, 1.0)
RADIUS_WARN = 0.05  # mm
RADIUS_FAULT = 0.1  # share of the radius
_AXES = "XYZ"


def read_gcode(source: Source, options: ReadOptions) -> Toolpath:
    """Read a G-code program.

    Raises:
        InputError: see :func:`machopt.formats.toolpath.read_toolpath`.
    """
    return _Reader(source, options).run()


class _Reader:
    def __init__(self, source: Source, options: ReadOptions) -> None:
        self.source, self.options = source, options
        self.siemens = any(_SIEMENS.search(t.upper().partition(";")[0]) for t in source.lines[:2000])
        self.out = PathBuilder(source, options, "gcode")
        self.blocks = BlockReader(parentheses_are_comments=not self.siemens)
        self.machine = Rotary(options.machine) if options.machine else None
        self.tolerance = options.arc_tolerance * 1e3  # mm
        self.scale = UNIT_NAMES[self.first_unit()]
        self.p: list[float] = [math.nan] * 3  # mm; NaN: not known
        self.lost = [False] * 3  # the machine's own frame was used since the coordinate was last known
        self.axis: Vector = _Z
        self.angles: dict[str, float] = {}
        self.tcp: str | None = None  # "angles" | "vector"
        self.motion: int | None = None
        self.plane = np.array(_Z)
        self.incremental, self.absolute_centre = False, False
        self.feed_mode, self.feed, self.rpm = "minute", math.nan, math.nan
        self.canned: Canned | None = None
        self.back_to_initial = True
        self.modal_call: HoleCycle | None = None
        self.offset: int | None = None
        self.last_feed = math.nan
        self.plunges: list[tuple[int, dict[str, float]]] = []
        self.ended = False

    def run(self) -> Toolpath:
        for line, text in self.code_lines():
            try:
                block = self.blocks.block(line, text)
                self.block(block)
            except (ExpressionError, ArcError, CycleError) as problem:
                raise self.source.error(str(problem), line) from problem
        if len(self.out):
            self.out.replace_positions(fill_unknown(self.out.positions(), self.out))
        self.compare_rotary_signs()
        return self.out.build()

    def code_lines(self):  # type: ignore[no-untyped-def]  # generator of (line, upper-case code)
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
                raise self.source.error("LinuxCNC subroutines and loops (O words) are not followed; expand them first", line)
            if not text.isspace() and text:
                yield line, text

    def first_unit(self) -> str:
        """The unit by the file's first unit word, else the option's."""
        found: str | None = None
        line = 0
        for line, raw in enumerate(self.source.lines, 1):
            if "G" in raw or "g" in raw:
                text, _ = self.blocks.comments(raw) if "(" in raw or ";" in raw else (raw, [])
                word = _UNIT_WORD.search(text.upper())
                if word:
                    found = UNITS[int(word.group(1)) * 10]
                    break
        unit = self.options.unit
        if found is None and unit is None:
            raise self.source.error("has no G20 or G21 (G70, G71); give the unit with --unit mm or --unit inch")
        if found is not None and unit is not None and found != unit:
            raise self.source.error(f"the file is in {found} but --unit {unit} was given", line)
        self.out.meta["unit"] = found or unit or ""
        self.out.meta["unit_from"] = "G word" if found else "option"
        return found or unit or ""

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
            self.out.ignore(b.junk[:24], b.line, understood=False)
        words: dict[str, float] = {}
        g_words: list[int] = []
        m_words: list[int] = []
        for letter, value in b.words:
            if letter == "G":
                g_words.append(round(value * 10))
            elif letter == "M":
                m_words.append(round(value))
            elif letter == "N" or letter == "O":
                continue
            else:
                if letter in words:
                    raise self.source.error(f"{letter} stands twice in one block", b.line)
                words[letter] = value
        for name, args in b.calls:
            self.call(name, args, words, b.line)
        for name in b.named:
            if name not in ("CR", "A3", "B3", "C3", "TURN"):
                if re.fullmatch(r"R\d+", name):
                    raise self.source.error(f"{name}=…: R parameters are not evaluated; expand the program first", b.line)
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

    next_tool = math.nan

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
                self.out.begin_operation(f"T{tool}", tool=tool)
            elif m in (97, 98):
                raise self.source.error(f"M{m} calls a subprogram; expand it into one program first", line)
            elif m == 128 or m == 428:
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
        self.out.ignore(name, line, understood=name in IGNORED_CALLS)

    once = 0

    def out_z(self) -> bool:
        return self.axis == _Z

    # ---- motion

    def lose(self, words: dict[str, float], name: str, line: int) -> None:
        """A move in the machine's frame: where the tip is in the workpiece is not known after it."""
        axes = [k for k in range(3) if _AXES[k] in words]
        if not axes and name in ("G53", "G153", "SUPA"):
            return  # suppresses an offset, moves nothing
        for k in axes or (range(3) if not words.keys() & set("ABC") else []):
            self.p[k], self.lost[k] = math.nan, True
        for letter in words.keys() & set("ABC"):
            self.angles[letter] = 0.0 if name in ("G28", "G30") else words[letter]
        self.out.ignore(f"{name} (move in the machine's frame)", line, understood=True)

    def move(self, words: dict[str, float], b: Block) -> None:
        vector = self.vector(words, b)
        turned = vector is None and self.turn(words, b)
        target = self.target(words, b)
        has_point = target is not None
        cycle = self.cycle_of_block(words, b)
        if cycle is not None and (has_point or self.once == b.line):
            self.holes(cycle, words, target, b)
            return
        if self.modal_call is not None and self.once == b.line:
            return
        centre = words.keys() & set("IJKR") or "CR" in b.named
        arc_only = self.motion in (2, 3) and bool(centre)
        axis = self.axis if vector is None else vector
        if not (has_point or arc_only or vector is not None or (turned and self.tcp)):
            self.leftovers(words, b)
            return
        if self.motion is None:
            raise self.source.error("moves before any G0, G1, G2 or G3 was given", b.line)
        to = list(self.p) if target is None else target
        tilted = any(abs(v) > 1e-9 for v in self.angles.values()) and self.tcp is None
        if tilted:
            if self.motion != 0:
                raise self.source.error(self.why_not_turned(), b.line)
            for k in range(3):
                if target is None or not math.isnan(to[k]):
                    self.p[k], self.lost[k] = math.nan, True
            self.out.ignore("rapid with turned rotary axes and no tool-centre-point control", b.line, understood=True)
            return
        if self.motion == 0:
            self.go(to, axis, Move.RAPID, math.nan, b.line)
        elif self.motion == 1:
            self.cut(to, axis, b.line, words)
        else:
            self.arc(to, axis, words, b)
        self.leftovers(words, b)

    def leftovers(self, words: dict[str, float], b: Block) -> None:
        for letter in words:
            if letter not in "XYZABCIJKRPLQ":
                self.out.ignore(letter, b.line, understood=False)
            elif letter in "PLQ":
                self.out.ignore(letter, b.line, understood=False)

    def target(self, words: dict[str, float], b: Block) -> list[float] | None:
        """Where the block goes to (mm), None where it has no X, Y or Z."""
        if not ("X" in words or "Y" in words or "Z" in words):
            return None
        to = list(self.p)
        for k, letter in enumerate(_AXES):
            if letter in words:
                value = words[letter] * self.scale
                if self.incremental if letter not in b.modes else b.modes[letter] == "IC":
                    if math.isnan(to[k]):
                        if self.lost[k]:
                            raise self.source.error(
                                f"incremental {letter} after a move in the machine's frame: its start is not known",
                                b.line,
                            )
                        self.out.warn_once("the first incremental moves start from 0", b.line)
                        to[k] = 0.0
                    value += to[k]
                to[k] = value
        return to

    def go(self, to: list[float], axis: Vector, move: int, feed: float, line: int) -> None:
        for k in range(3):
            if not math.isnan(to[k]):
                self.lost[k] = False
            elif move == Move.CUT and self.lost[k]:
                raise self.source.error(
                    f"cuts while {_AXES[k]} is not known: it was last moved in the machine's frame (G53, G28 …)", line
                )
        self.p, self.axis = to, axis
        self.out.add((to[0], to[1], to[2]), axis, move, feed, line)

    def cut(self, to: list[float], axis: Vector, line: int, words: dict[str, float]) -> None:
        length = math.dist(to, self.p)
        if self.tcp and self.angles and len(self.out):
            self.plunges.append((len(self.out), dict(self.angles)))
        self.go(to, axis, Move.CUT, self.feed_mm_min(length, line), line)

    def feed_mm_min(self, length: float, line: int) -> float:
        if self.feed_mode == "minute":
            return self.feed * self.scale
        if self.feed_mode == "revolution":
            return self.feed * self.rpm * self.scale
        feed = self.feed * length  # G93: F is 1/min for the block
        if not (math.isfinite(feed) and feed > 1e-6):
            if math.isnan(self.feed) or math.isnan(self.last_feed):
                return math.nan
            self.out.warn_once("G93 blocks without travel of the tip keep the feed before them", line)
            return self.last_feed
        self.last_feed = feed
        return feed

    def arc(self, to: list[float], axis: Vector, words: dict[str, float], b: Block) -> None:
        start = np.array(self.p)
        if np.isnan(start).any():
            names = "".join(_AXES[k] for k in range(3) if math.isnan(self.p[k]))
            plane_needs = [k for k in range(3) if self.plane[k] == 0.0 and math.isnan(self.p[k])]
            if plane_needs:
                raise self.source.error(f"an arc starts where {names} is not known", b.line)
            start = np.nan_to_num(start)
        end = np.where(np.isnan(to), start, to)
        normal = self.plane * (1.0 if self.motion == 3 else -1.0)
        radius = b.named.get("CR", words.get("R"))
        turns = max(round(words.get("P", 1.0)), 1) + round(b.named.get("TURN", 0.0))
        words.pop("P", None)
        if radius is not None:
            centre = from_radius(start, end, radius * self.scale, normal)
        else:
            offsets = np.array([words.get(c, math.nan) for c in "IJK"]) * self.scale
            if np.isnan(offsets).all():
                raise ArcError("an arc without I, J, K or R")
            centre = self.centre(start, end, offsets, b)
        found = arc(start, end, centre, normal, self.tolerance, turns=turns)
        if abs(found.mismatch) > max(RADIUS_WARN, RADIUS_FAULT * found.radius):
            raise ArcError(f"start and end of the arc differ by {abs(found.mismatch):.4g} mm in their distance to the centre")
        if abs(found.mismatch) > RADIUS_WARN:
            self.out.warn_once("start and end of an arc differ in their distance to its centre", b.line)
        points = found.points
        unknown = np.isnan(np.array(self.p))
        if unknown.any():
            points = np.where(unknown, np.nan, points)
        length = found.sweep * found.radius
        feed = self.feed_mm_min(math.hypot(length, float((end - start) @ self.plane)), b.line)
        self.out.add_arc(points, axis, Move.CUT, feed, b.line, axis_before=self.axis)
        x, y, z = points[-1].tolist()
        self.p, self.axis = [x, y, z], axis

    def centre(self, start: Array, end: Array, offsets: Array, b: Block) -> Array:
        """Centre from I, J, K; absolute only where they fit that way and not the usual one."""
        relative = start + np.nan_to_num(offsets)
        absolute = np.where(np.isnan(offsets), start, offsets)
        first, second = (absolute, relative) if self.absolute_centre else (relative, absolute)
        flat = 1.0 - np.abs(self.plane)

        def mismatch(c: Array) -> float:
            r0, r1 = np.linalg.norm((start - c) * flat), np.linalg.norm((end - c) * flat)
            return float(abs(r0 - r1) / max(r0, r1, 1e-9))

        if mismatch(first) > RADIUS_FAULT and mismatch(second) < 1e-2:
            self.out.warn_once(
                f"I, J, K fit only as {'offsets' if self.absolute_centre else 'absolute'} centres; read that way", b.line
            )
            return second
        return first

    # ---- tool axis

    def vector(self, words: dict[str, float], b: Block) -> Vector | None:
        named = [b.named.get(n) for n in ("A3", "B3", "C3")]
        if any(v is not None for v in named):
            if self.tcp is None:
                raise self.source.error("a tool vector (A3=, B3=, C3=) outside of TRAORI", b.line)
            i, j, k = (v or 0.0 for v in named)
        elif self.tcp == "vector" and self.motion in (0, 1) and words.keys() & set("IJK"):
            i, j, k = (words.pop(c, 0.0) for c in "IJK")
        else:
            return None
        length = math.sqrt(i * i + j * j + k * k)
        if not length > 1e-6:
            raise self.source.error("the tool vector is zero", b.line)
        return (i / length, j / length, k / length)

    def turn(self, words: dict[str, float], b: Block) -> bool:
        """Take the rotary words; True where the block has any."""
        given = [c for c in "ABC" if c in words]
        for letter in given:
            value = words.pop(letter)
            relative = self.incremental if letter not in b.modes else b.modes[letter] == "IC"
            self.angles[letter] = value + (self.angles.get(letter, 0.0) if relative else 0.0)
        if self.tcp == "angles" and (given or self.angles):
            self.axis = self.axis_of_angles(b.line)
        return bool(given)

    def axis_of_angles(self, line: int) -> Vector:
        turned = {c: v for c, v in self.angles.items() if abs(v) > 1e-9}
        if not turned:
            return _Z
        if self.machine is None:
            raise self.source.error(
                f"rotary words ({', '.join(sorted(turned))}) under tool-centre-point control: the tool axis depends on "
                f"the machine; give the option machine, one of {rotary.HELP}",
                line,
            )
        strange = sorted(turned.keys() - set(self.machine.letters))
        if strange:
            raise self.source.error(f"rotary word {strange[0]} but machine {self.machine.name} has no such axis", line)
        return self.machine.tool_axis(self.angles)

    def why_not_turned(self) -> str:
        angles = " ".join(f"{c}{v:g}" for c, v in sorted(self.angles.items()))
        return (
            f"cuts with turned rotary axes ({angles}) and without tool-centre-point control: X, Y, Z are then the "
            "machine's, and its pivot lengths are not in the file. Post it with G43.4, G234, TRAORI or M128, or export "
            "APT/CL data"
        )

    def compare_rotary_signs(self) -> None:
        """Plunges run along the tool axis: say so where they do only with the other sign of the angles."""
        if self.machine is None or not self.plunges:
            return
        other = Rotary(
            self.machine.name.removesuffix("-reversed")
            if self.machine.sign < 0.0
            else self.machine.name.replace("head", "table").replace("mixed", "table") + "-reversed"
        )
        p, move = self.out.positions(), self.out.moves()
        chosen = opposite = 0
        for k, angles in self.plunges:
            if move[k - 1] != Move.RAPID:
                continue
            step = p[k] - p[k - 1]
            length = float(np.linalg.norm(step))
            a, o = np.array(self.machine.tool_axis(angles)), np.array(other.tool_axis(angles))
            if length < 0.1 or float(a @ o) > math.cos(math.radians(5.0)):
                continue
            chosen += bool(-(step @ a) > 0.999 * length)
            opposite += bool(-(step @ o) > 0.999 * length)
        self.out.meta["plunges_along_axis"] = f"{chosen} with {self.machine.name}, {opposite} with {other.name}"
        if opposite > 2 * chosen:
            self.out.warn(
                f"{opposite} plunges run along the tool axis of machine {other.name}, {chosen} along that of "
                f"{self.machine.name}: the rotary signs may be the other way round"
            )

    # ---- cycles

    def begin_cycle(self, code: int, b: Block) -> None:
        if code in (76, 87, 88):
            self.out.warn_once(f"G{code} is read as a plain boring stroke", b.line)
        if self.canned is None:
            if math.isnan(self.p[2]):
                raise self.source.error(f"G{code} begins where Z is not known", b.line)
            self.canned = Canned(initial=self.p[2])
        self.canned.code = code

    def cycle_of_block(self, words: dict[str, float], b: Block) -> HoleCycle | None:
        if self.canned is None:
            return self.modal_call
        c = self.canned
        if not self.out_z():
            raise self.source.error(f"G{c.code} with a tilted tool axis is not supported", b.line)
        if "R" in words:
            c.r = words.pop("R") * self.scale + (c.initial if self.incremental else 0.0)
        if "Z" in words:
            c.z = words.pop("Z") * self.scale + ((c.r or 0.0) if self.incremental else 0.0)
        if "Q" in words:
            c.q = abs(words.pop("Q")) * self.scale
        if "P" in words:
            p = words.pop("P")
            c.dwell = p / 1e3 if "P" in b.integers and p >= 100.0 else p
        for letter in "IJK":
            if letter in words and letter != "K":
                self.out.ignore(f"{letter} in a cycle", b.line, understood=False)
                words.pop(letter)
        if c.z is None and c.r is None and not words:
            return None
        feed = self.feed * self.scale * (self.rpm if self.feed_mode == "revolution" else 1.0)
        return c.at_hole(back_to_initial=self.back_to_initial, feed=feed)

    def holes(self, cycle: HoleCycle, words: dict[str, float], target: list[float] | None, b: Block) -> None:
        if math.isnan(cycle.feed):
            cycle = HoleCycle(**{**cycle.__dict__, "feed": self.feed * self.scale})
        repeats = 1
        for letter in ("L", "K"):
            if letter in words:
                repeats = round(words.pop(letter))
        if repeats > 10_000:
            raise CycleError(f"{repeats} repeats of one cycle; the limit is 10000")
        x, y = (self.p[0], self.p[1]) if target is None else (target[0], target[1])
        if math.isnan(x) or math.isnan(y):
            raise self.source.error("a drilling cycle where X or Y is not known", b.line)
        dx, dy = (x - self.p[0], y - self.p[1]) if self.incremental else (0.0, 0.0)
        for n in range(repeats):
            hole = (x + n * dx, y + n * dy, 0.0)
            before = None if any(math.isnan(v) for v in self.p) else (self.p[0], self.p[1], self.p[2])
            after = drill(self.out, cycle, hole, _Z, b.line, before)
            self.p, self.lost = list(after), [False] * 3
        if self.once == b.line and not any(name == "MCALL" for name, _ in b.calls):
            self.modal_call = None


def _offset_name(number: int) -> str:
    g, p = divmod(number, 1000)
    return f"G{g / 10:g}" + (f" P{p}" if p else "")


__all__ = ["InputError", "read_gcode"]
