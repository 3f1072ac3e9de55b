"""Words of a block without motion: feed and its unit, spindle, tool, coolant, stop, dwell."""

from __future__ import annotations

import math

from machopt.file_formats.source_file import UNIT_NAMES, ReadOptions, SourceFile
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.gcode.saved_modes import ModeReader
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.dwell_units import MAX_DWELL_S, convert_dwell
from machopt.toolpath.readers.gcode.syntax.word_meanings import MACHINE_FRAME, PROGRAM_END, UNITS


class AuxiliaryWordReader(ModeReader):
    """F, S, T, M and G4."""

    def __init__(self, source: SourceFile, options: ReadOptions, unit: str) -> None:
        super().__init__(source, options, unit)
        self.next_tool, self.next_name = float("nan"), ""

    def unit_of_feeds(self, g: int) -> float:
        """Return the unit of the feeds behind a unit word.

        Sinumerik's G70 and G71 change lengths only: feeds stay in the unit of the control. G700 and G710 change both.

        Args:
            g: Ten times the number of the G word.

        Returns:
            mm per unit; NaN where the file does not give it.
        """
        if not self.siemens or g not in (700, 710):
            return self.scale
        if self.options.unit is not None:
            return UNIT_NAMES[self.options.unit]
        return 1.0 if g == 710 else math.nan

    def use_unit(self, g: int, line: int) -> None:
        """Carry out G20, G21, G70, G71, G700 or G710.

        Args:
            g: Ten times the number of the G word.
            line: Line number in the file (1-based).

        Raises:
            InputError: the unit contradicts the option ``--unit``.
        """
        unit = UNITS[g]
        option_unit, lengths_only = self.options.unit, self.siemens and g in (700, 710)
        if option_unit not in (None, unit) and not self.unit_used_at and self.unit_by_words and not lengths_only:
            raise self.source.build_error(f"the file is in {unit} but --unit {option_unit} was given", line)
        self.unit_used_at = self.unit_used_at or line
        self.scale = UNIT_NAMES[unit]
        self.feed_unit = self.unit_of_feeds(g)
        self.unit_said = True

    def check_unit(self, g_words: list[int], words: dict[str, float], b: ProgramBlock) -> None:
        """Check that the unit is known before the first length or feed.

        Before the first unit word the unit is that of the control, which is not in the file.

        Args:
            g_words: G words of the block, times ten.
            words: Words of the block: letter or name → number.
            b: The block: its words, calls and line number.

        Raises:
            InputError: lengths or feeds occur before a unit word, and no option gives the unit.
        """
        if any(g in MACHINE_FRAME or g == 40 for g in g_words):
            return
        if any(words.get(c) for c in "XYZIJKRF") or any(b.named.get(c) for c in ("CR", "RP", "RND", "CHF", "CHR")):
            if not self.unit_said:
                raise self.source.build_option_question(
                    "unit",
                    "a length or feed before the first G20 or G21 (G70, G71) that is carried out: what unit the "
                    "control starts with is not in the file; give it with --unit mm or --unit inch",
                    b.line,
                )
            self.unit_used_at = self.unit_used_at or b.line

    def take_feed(self, feed: float, line: int) -> None:
        """Carry out F.

        Args:
            feed: Number behind F, program units.
            line: Line number in the file (1-based).

        Raises:
            InputError: the unit of the feed is not known.
        """
        if math.isnan(self.feed_unit) and self.feed_mode != "inverse":
            raise self.source.build_error(
                "F under G70: it makes lengths inches, feeds stay in the control's own unit. Give that with "
                "--unit inch (F in inch/min) or --unit mm (F in mm/min), or post the program with G700",
                line,
            )
        self.feed, self.feed_scale, self.fed_at = feed, self.feed_unit, line

    def use_feed_mode(self, mode: str) -> None:
        """Carry out G93, G94 or G95.

        An earlier F is no feed under G93, and an F under G93 is no feed later.

        Args:
            mode: Feed mode.
        """
        if mode != self.feed_mode and "inverse" in (mode, self.feed_mode):
            self.feed = math.nan
        self.feed_mode = mode

    def numbers(self, words: dict[str, float], b: ProgramBlock, *, started: bool) -> None:
        """F, S, T and the words that only lines of a machine's own need.

        Args:
            started: the block starts the spindle too, which says the speed.
        """
        if "F" in words:
            self.take_feed(words.pop("F"), b.line)
        if "S" in words:
            self.rpm = words.pop("S")
            if not started:
                self.out.event("spindle", f"S{self.rpm:g}", self.rpm)
        if "T" in words:
            self.next_tool, self.next_name = words.pop("T"), ""
            self.out.ignore("T", b.line, understood=True)
        if "T" in b.texts:
            self.next_tool, self.next_name = float("nan"), b.texts["T"]
            self.out.ignore("T", b.line, understood=True)
        for letter in ("H", "D", "E"):
            if letter in words:
                words.pop(letter)
                self.out.ignore(letter, b.line, understood=True)
        for letter in ("U", "V", "W"):
            value = words.pop(letter, 0.0)
            if value and not self.siemens:
                raise self.source.build_error(
                    f"{letter}{value:g} moves a further axis of the machine (or counts from where the tool is): not "
                    "supported; post the path in X, Y, Z",
                    b.line,
                )

    def m_words(self, m_words: list[int], words: dict[str, float], line: int) -> None:
        """Carry out the M words of a block.

        Args:
            m_words: Numbers of the M words.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            line: Line number in the file (1-based).

        Raises:
            InputError: an M word calls a subprogram that is not in the file.
        """
        for m in m_words:
            if m in (3, 4, 5):
                if m != 5:
                    self.out.undo_event("spindle", f"S{self.rpm:g}")
                self.out.event("spindle", f"M{m}", 0.0 if m == 5 else self.rpm)
            elif m in (7, 8, 9):
                self.out.event("coolant", f"M{m}")
            elif m in (0, 1):
                self.out.event("stop", f"M{m}")
            elif m == 6:
                number = "" if self.next_tool != self.next_tool else f"{self.next_tool:g}"
                self.out.event("tool", f"T{self.next_name or number} M6", self.next_tool)
                self.out.change_tool(self.next_name or number)
            elif m in (97, 98):
                raise self.source.build_error(
                    f"M{m} calls a subprogram that is not in this file; expand it into one program, or append it", line
                )
            elif m in (128, 428):
                self.use_tcp("angles", line)
                machine = self.setup.machine
                if m == 428 and machine and not machine.name.endswith("-reversed"):
                    self.out.warn_once(
                        "M428 is LinuxCNC's switch; its table kinematics turn the other way: machine …-reversed?", line
                    )
            elif m in (129, 429, 430):
                self.use_tcp(None, line)
            elif m in (13, 14):  # spindle and coolant in one word
                self.out.undo_event("spindle", f"S{self.rpm:g}")
                self.out.event("spindle", f"M{m}", self.rpm)
                self.out.event("coolant", f"M{m}")
            elif 70 <= m <= 73 and not self.siemens and self.decimals_count:
                self.saved_modes(m, line)
            elif m not in PROGRAM_END and m != 91 and not (m == 17 and self.siemens):
                self.out.ignore(f"M{m}", line, understood=m in harmless_words.M)
                for letter in "RPQ" if m == 19 else "PQ":  # of M words: no words of a cycle that holds
                    words.pop(letter, None)

    def dwell(self, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out G4.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the dwell is longer than in any program, so its unit is another one.
        """
        value = float("nan")
        for letter in ("X", "U", "P", "F"):
            if letter in words:
                value = words.pop(letter)
                if not self.siemens:
                    value = convert_dwell(value, letter=letter, bare=b.bare(letter), control=self.control)
                if math.isnan(value):
                    self.out.warn_once(
                        f"G4 {letter} without a decimal point: seconds or milliseconds is not known", b.line
                    )
                break
        if value > MAX_DWELL_S:
            raise self.source.build_error(
                f"a dwell of {value:g} s; expected at most {MAX_DWELL_S:g} s. Is it meant in milliseconds? Write it in "
                "seconds, with a decimal point",
                b.line,
            )
        if self.siemens:
            words.pop("S", None)  # turns of the spindle to wait
        self.out.event("dwell", "G4", value)
