"""Calls by name in Sinumerik programs: TRAORI, CYCLE81 … 89, CYCLE800, MCALL, MSG, frames."""

from __future__ import annotations

import math
import re

from machopt.file_formats.plain_decimals import parse_plain_decimal
from machopt.file_formats.source_file import normalise_word
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.gcode.block_motion import TANGENTIAL, THROUGH
from machopt.toolpath.readers.gcode.canned_cycles import SIEMENS, check_plane_mode, parse_siemens_cycle
from machopt.toolpath.readers.gcode.frame_words import FrameWordReader
from machopt.toolpath.readers.gcode.geometry.hole_patterns import (
    MOST_HOLES,
    generate_hole_circle,
    generate_hole_grid,
    generate_hole_row,
)
from machopt.toolpath.readers.gcode.geometry.polar_coordinates import find_plane_axes
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.word_meanings import ADDRESSES, REFUSED_CALLS

# not Sinumerik's ;$PATH=/_N_WKS_DIR, a folder of the control
OPERATION = re.compile(r"^[^\w$]*(?:OPER(?:ATION)?(?:[ _]*NAME)?|TOOLPATH|PATH)\s*[:=]\s*(.*?)[\s*]*$", re.IGNORECASE)
_RUN_TOGETHER = re.compile(r"[XYZABCGIJKRFM]+[0-9]\w*")
_FRAMES = ("TRANS", "ATRANS", "ROT", "AROT", "SCALE", "ASCALE", "MIRROR", "AMIRROR")
_KNOWN = ("SUPA", "TRAORI", "TRAFOOF", "TRAOOF", "MCALL", "CYCLE80", "TOROT", "TOFRAME")  # carried out
_AXIS_WAYS = {"ORIVECT": True, "ORIPLANE": True, "ORIAXES": False, "ORIMACHAX": False}  # in one plane or by axes
_DEFAULT_FGROUP = {"X", "Y", "Z"}
_PATTERNS = {  # arguments that are read; those behind them must be left out or zero
    "HOLES1": ("reference point", "reference point", "angle", "first distance", "distance", "number"),
    "HOLES2": ("centre", "centre", "radius", "first angle", "angle between", "number"),
    "CYCLE801": ("reference point", "reference point", "angle", "column distance", "row distance", "columns", "rows"),
}
_PLANE_MODES = {"HOLES1": 10, "HOLES2": 10, "CYCLE801": 13}  # place of _DMODE
_ALONE = re.compile(rf"{SIEMENS.pattern}|{'|'.join(_PATTERNS)}|CYCLE80[02]|MCALL")  # in a block without motion
_MOTION_LETTERS = frozenset("XYZABCUVWIJK")
_NO_MOTION = frozenset(("FRC", "FRCM", "FB"))  # feeds, of the named addresses


class SiemensCallReader(FrameWordReader):
    """Carries out what is called by name."""

    _plane_in_block: int | None = None  # 17, 18 or 19 where the block of the call has it

    def calls(self, b: ProgramBlock, words: dict[str, float]) -> None:
        """Carry out the calls of a block.

        Args:
            b: The block: its words, calls and line number.
            words: Words of the block: letter or name → number; may be changed in place.
        """
        self._plane_in_block = next((round(v) for c, v in b.words if c == "G" and v in (17.0, 18.0, 19.0)), None)
        for name, args in b.calls:
            if _ALONE.fullmatch(name):
                self._refuse_motion_beside(name, words, b)
            self.call(name, args, words, b)
        if any(name == "MCALL" for name, _ in b.calls):
            self.once = 0  # the cycle is carried out at the points that follow

    def _refuse_motion_beside(self, name: str, words: dict[str, float], b: ProgramBlock) -> None:
        """Raise InputError for words of a motion in the block of a cycle: its call is a block of its own."""
        found = [letter for letter in words if letter in _MOTION_LETTERS]
        found += [f"{word}=" for word in b.named if word in ADDRESSES - _NO_MOTION]
        if found:
            raise self.source.build_error(
                f"{found[0]} in the block of {name}: a cycle is called in a block of its own. Write the motion in the "
                "block before it",
                b.line,
            )

    def call(self, name: str, args: str, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out one call.

        Args:
            name: Name of the call.
            args: Text of the arguments.
            words: Words of the block: letter or name → number; may be changed in place.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the call is not supported.
        """
        if self._move_frame(name, args, words, b):
            return
        if name in REFUSED_CALLS:
            raise self.source.build_error(f"{name}: {REFUSED_CALLS[name]}", b.line)
        if name == "MSG" and (found := OPERATION.match(args.strip('"'))):
            self.out.begin_operation(found.group(1))
            return
        if self._change_modes(name, args, b.line):
            return
        self._refuse_unsupported(name, b.line)
        known = name in harmless_words.SINUMERIK_CALLS or name in _KNOWN
        if name in _AXIS_WAYS:
            self.turns_in_plane = _AXIS_WAYS[name]
        if name == "FGROUP":
            known = {a.strip() for a in args.split(",") if a.strip()} in (set(), _DEFAULT_FGROUP)
        accepted = normalise_word(name) in self.options.accept_unknown
        if not known and not accepted and name != "FGROUP" and self.siemens and not b.words_but_number():
            raise self.source.build_error(
                f"{name} is no word that is known here: a subprogram of that name moves the axes, and it is not in "
                f"this file. Append it or expand it; where it moves nothing: --accept-unknown {name}",
                b.line,
            )
        self.out.ignore(name, b.line, understood=known)

    def _move_frame(self, name: str, args: str, words: dict[str, float], b: ProgramBlock) -> bool:
        """Carry out a call that sets a frame, an arc or holes; return whether it was one."""
        if name in _FRAMES:
            self.siemens_frame(name, words, b)
        elif name == "CYCLE800":
            self.swivel(args, b.line)
        elif name in ("CIP", "CT"):
            self.motion, self.canned = (THROUGH if name == "CIP" else TANGENTIAL), None
        elif name in _PATTERNS:
            self.pattern(name, args, b.line)
        else:
            return False
        return True

    def _change_modes(self, name: str, args: str, line: int) -> bool:
        """Carry out a call that changes the transformation or the modal call; return whether it is a cycle."""
        if name == "TRAORI":
            self.use_tcp("angles", line)
        elif name in ("TRAFOOF", "TRAOOF"):
            self.use_tcp(None, line)
        elif name in ("MCALL", "CYCLE80"):  # the second one is of older controls
            self.modal_call = None
        elif name in ("TOROT", "TOFRAME"):
            self.torot(name, line)
        elif SIEMENS.fullmatch(name):
            self.modal_call = parse_siemens_cycle(name, args, self.scale, self.rpm, self._find_plane_word())
            self.once = line
            if find_plane_axes(self.plane) != (0, 1):
                self.out.warn_once(
                    "a drilling cycle in G18 or G19 drills along the normal of that plane: the tool is taken to point "
                    "along it",
                    line,
                )
            return True
        return False

    def _refuse_unsupported(self, name: str, line: int) -> None:
        """Raise InputError for a subprogram, an unsupported cycle, or words without a space between them."""
        if re.fullmatch(r"L[0-9]+", name):
            raise self.source.build_error(
                f"{name} calls a subprogram that is not in this file; expand it into one program, or append it", line
            )
        if re.fullmatch(r"(?:CYCLE[0-9]+|POCKET[0-9]|SLOT[0-9]|HOLES[0-9])", name) and name not in (
            *harmless_words.SINUMERIK_CALLS,
            *_KNOWN,
        ):
            what = (
                "write each place in a block behind MCALL" if name == "CYCLE802" else "export its motion as G0 and G1"
            )
            raise self.source.build_error(f"{name} is not supported: {what}", line)
        if _RUN_TOGETHER.fullmatch(name):
            raise self.source.build_error(f"found {name!r}; expected words such as X10.5 or G1", line)

    def torot(self, name: str, line: int) -> None:
        """Carry out TOROT; it is read only where the plane is already aligned with the tool.

        Args:
            name: Name of the call.
            line: Line number in the file (1-based).

        Raises:
            InputError: the plane is not aligned with the tool.
        """
        if self.setup.tilted != "aligned":
            raise self.source.build_error(
                f"{name} makes a coordinate system of the tool's direction: not supported", line
            )

    def use_tcp(self, mode: str | None, line: int) -> None:
        """Switch tool-centre-point control on or off.

        Args:
            mode: ``angles``, ``vector`` or ``spatial``; None for off.
            line: Line number in the file (1-based).
        """
        self.change_setup(tcp=mode)
        self.setup.check_letters(line)
        self.check_mirror()

    def pattern(self, name: str, text: str, line: int) -> None:
        """Drill a row (HOLES1), a circle (HOLES2) or a grid (CYCLE801) of holes.

        HOLES1(SPCA, SPCO, STA1, FDIS, DBH, NUM); HOLES2(CPA, CPO, RAD, STA1, INDA, NUM); CYCLE801(SPCA, SPCO, STA,
        DIS1, DIS2, NUM1, NUM2). Places are in the axes of the working plane: X, Y in G17; Z, X in G18; Y, Z in G19. The
        modal cycle (MCALL) is carried out at every hole.

        Args:
            name: Name of the call.
            text: Text of the arguments.
            line: Line number in the file (1-based).

        Raises:
            InputError: the arguments describe no pattern, or no modal cycle precedes it.
        """
        if self.modal_call is None:
            raise self.source.build_error(f"{name} without a modal cycle (MCALL CYCLE81 …) before it", line)
        v = self._parse_pattern(name, text, line)
        first, second = find_plane_axes(self.plane)
        if name == "CYCLE801":
            columns, rows = round(v[5]), round(v[6])
            places = generate_hole_grid((v[0], v[1]), (v[3], v[4]), columns, rows, v[2])
            self.out.warn_once("the order of the holes of CYCLE801 is that of its rows, every second one back", line)
        else:
            generate = generate_hole_row if name == "HOLES1" else generate_hole_circle
            places = generate(v, round(v[5]))
        for place in places:
            hole = list(self.p)
            hole[first], hole[second] = place[0] * self.scale, place[1] * self.scale
            self.holes(self.modal_call, {}, hole, ProgramBlock(line=line, words=[]))

    def _find_plane_word(self) -> int:
        """The G word of the working plane: 17, 18 or 19."""
        return self._plane_in_block or {(0, 1): 17, (2, 0): 18, (1, 2): 19}[find_plane_axes(self.plane)]

    def _parse_pattern(self, name: str, text: str, line: int) -> list[float]:
        """Arguments of a pattern; further ones (frame instead of grid, shear, hidden holes …) must be left out or 0."""
        named = _PATTERNS[name]
        given = [part.strip().strip('"') for part in text.split(",")]
        try:
            v = [parse_plain_decimal(part) if part else 0.0 for part in given]
        except ValueError:
            raise self.source.build_error(f"{name}({text}): expected finite decimal numbers", line) from None
        at = _PLANE_MODES[name]
        if len(v) > at and v[at] in (1.0, 2.0, 3.0):
            check_plane_mode(name, v[at], self._find_plane_word())
            v[at] = 0.0
        counts = v[5 : len(named)]
        if len(v) < len(named) or not all(n == round(n) and n >= 1 for n in counts) or math.prod(counts) > MOST_HOLES:
            raise self.source.build_error(f"{name}({text}): expected {', '.join(named)}; 1 to {MOST_HOLES} holes", line)
        if any(v[len(named) :]):
            further = next(n for n, value in enumerate(v) if n >= len(named) and value)
            raise self.source.build_error(
                f"{name}: argument {further + 1} ({given[further]}) is not read. Write the {len(named)} arguments "
                "before, or each place in a block behind MCALL",
                line,
            )
        return v
