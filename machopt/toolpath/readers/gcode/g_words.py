"""G words of a block: modes, units, planes, coordinate systems, cycles, and words that are refused or ignored."""

from __future__ import annotations

import numpy as np

from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.gcode.auxiliary_words import AuxiliaryWordReader
from machopt.toolpath.readers.gcode.block_motion import TAP
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.word_meanings import (
    CYCLES,
    FEED_MODES,
    HOLE_PATTERNS,
    MACHINE_FRAME,
    MOTION,
    OFFSETS,
    PLANES,
    POLES,
    REFUSED,
    TABLE_OFFSETS,
    UNITS,
)


class GWordReader(AuxiliaryWordReader):
    """G words, one by one."""

    def g_words(self, g_words: list[int], words: dict[str, float], b: ProgramBlock) -> str | None:
        """Carry out the G words of a block.

        Args:
            g_words: G words of the block, times ten.
            words: Words of the block: letter or name → number; may be changed in place.
            b: The block: its words, calls and line number.

        Returns:
            Name of a machine-frame word, None where the block has none.
        """
        machine_frame = None
        for g in g_words:
            if self.state_word(g, words, b) or self.frame_word(g, words, b):
                continue
            if g in MACHINE_FRAME and not (g == 740 and {"R", "Z"} <= words.keys()):
                machine_frame = MACHINE_FRAME[g]
            elif g in CYCLES:
                self.begin_cycle(g // 10, b)
            elif g == 40:
                self.dwell(words, b)
            else:
                self.refuse_misread(g, words, b)
                self.other_word(g, words, b)
        return machine_frame

    def state_word(self, g: int, words: dict[str, float], b: ProgramBlock) -> bool:
        """Carry out a word that sets how coordinates are read: kind of move, unit, plane, distance mode.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number.
            b: The block: its words, calls and line number.

        Returns:
            Whether the word is one of these.

        Raises:
            InputError: the word asks for a hole pattern (Haas), which is not supported.
        """
        if g in MOTION:
            self.motion = MOTION[g]
            self.canned = None
        elif g == 331:
            self.motion, self.canned = TAP, None
        elif g in (900, 910):
            self.incremental = g == 910
        elif g in HOLE_PATTERNS and words.keys() & set("IJKL"):
            given = ", ".join(sorted(words.keys() & set("IJKL")))
            raise self.source.build_error(
                f"G{g // 10} with {given} places holes in a pattern (Haas): not supported; post each by itself",
                b.line,
            )
        elif g in UNITS:
            self.use_unit(g, b.line)
        elif g in FEED_MODES:
            self.use_feed_mode(FEED_MODES[g])
        elif g in PLANES:
            self.plane = np.array(PLANES[g])
        elif g in (901, 911):
            self.centres.absolute = g == 901
        elif g == 800:
            self.canned = None
        elif g in (980, 990):
            self.back_to_initial, self.retract_said = g == 980, True
        elif g in (410, 420):
            self.out.warn_once(
                "cutter compensation (G41, G42) is not carried out: the points are as programmed", b.line
            )
            self.out.ignore(f"G{g // 10}", b.line, understood=True)
        else:
            return False
        return True

    def frame_word(self, g: int, words: dict[str, float], b: ProgramBlock) -> bool:
        """Carry out a word that sets the coordinate system: pole, mirror, scale, offset, plane, TCP control.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; may be changed in place.
            b: The block: its words, calls and line number.

        Returns:
            Whether the word is one of these.
        """
        if g in (150, 160) and not (g == 150 and "H" in words):
            self.polar.switch(on=g == 160)
        elif g in POLES and self.siemens:
            self.polar.set_pole(g, words, b, self.p, self.plane, self.scale)
        elif g in (501, 511):
            self.mirror_word(g, words)
        elif g == 510:
            self.scale_word(words, b)
        elif g == 500 and not words.keys() & set("XYZ"):
            self.use_inner("scale", None)
        elif g in (434, 435, 2340):
            self.use_tcp("vector" if g == 435 else "angles", b.line)
        elif g == 490:
            self.use_tcp(None, b.line)
        elif g in (2540, 2550):
            self.dynamic_offset(on=g == 2540)
        elif g in (100, 520, 920, 921, 922, 923):
            self.shift_origin(g, words, b.line)
        elif g in (680, 682, 690, 691, 531, 536):
            self.plane_word(g, words, b)
        elif (g == 530 and self.g53_is_an_offset) or (
            (g in OFFSETS or g == 150) and not self.shifts_the_zero(g, words)
        ):
            self.use_offset(g, words, b.line)
        else:
            return False
        return True

    def shifts_the_zero(self, g: int, words: dict[str, float]) -> bool:
        """Return whether the word is Sinumerik's G58 or G59 with axis words, which names no work offset.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number.
        """
        return g in (580, 590) and self.siemens and bool(words.keys() & set("XYZ"))

    def refuse_misread(self, g: int, words: dict[str, float], b: ProgramBlock) -> None:
        """Refuse words whose meaning depends on other words, and words that are not supported.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; may be changed in place.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the word is one of these.
        """
        if self.shifts_the_zero(g, words):
            raise self.source.build_error(
                f"G{g // 10} with axis words shifts the zero (Sinumerik) and names no work offset: not supported; "
                "write the shift as TRANS" + (", ATRANS" if g == 590 else ""),
                b.line,
            )
        if g == 600 and not self.siemens and words.keys() & set("XYZABC"):
            raise self.source.build_error(
                "G60 with axis words approaches its place from one side, by an overrun that only the control "
                "knows: not supported; post it as G0",
                b.line,
            )

    def other_word(self, g: int, words: dict[str, float], b: ProgramBlock) -> None:
        """Handle a word that changes no point or is unknown.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the word is unknown and may move points.
        """
        if g == 50 and not words.keys() & set("XYZ"):
            self.out.ignore("G5", b.line, understood=True)  # G5 P10000: high speed mode
            words.pop("P", None)
        elif g in (51, 281, 301) and not words.keys() & set("XYZABCIJ"):
            self.out.ignore(f"G{g / 10:g}", b.line, understood=True)  # fast modes; a place that is stored
            words.pop("P", None), words.pop("Q", None)
        elif g == 431 and "H" not in words:  # LinuxCNC: offsets of the tool's length, no move
            self.out.ignore("G43.1", b.line, understood=True)
            words.clear()
        elif g in TABLE_OFFSETS and words.get("P") == 0.0:
            words.pop("P")  # off
        elif g in REFUSED:
            raise self.source.build_error(f"{REFUSED[g]}: not supported; export without it", b.line)
        elif g in harmless_words.G and not (g == 630 and words.keys() & set("XYZABC")):
            if g in (80, 81, 640, 1870):
                words.pop("P", None), words.pop("Q", None)
        else:
            name = f"G{g / 10:g}"
            if words.keys() & set("XYZABC"):
                raise self.source.build_error(f"{name} is not known, and its block contains axis words", b.line)
            self.out.ignore(name, b.line, understood=False)
