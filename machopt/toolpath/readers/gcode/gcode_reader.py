"""G-code reader for Fanuc, Haas, LinuxCNC and Sinumerik; three axes, 3+2 and five axes.

Coordinates are those of the first work offset, which is ``workpiece``. Subprograms, loops and expressions are
evaluated as far as the file contains them. Tilted planes and tool-centre-point control are supported. Without either,
X, Y, Z with rotary axes need the kinematics of the machine (``--machine``).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

from machopt.data_types.toolpath import Toolpath
from machopt.file_formats.source_file import OptionNeededError, ReadOptions, SourceFile
from machopt.path_building.arc_chords import ArcError
from machopt.path_building.coordinate_systems import FrameError
from machopt.path_building.drilling_cycles import DrillingCycleError
from machopt.path_building.unknown_coordinates import fill_unknown
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.gcode import macro_flow as gcode_flow
from machopt.toolpath.readers.gcode.fast_linear_move_reader import PLAIN, SIEMENS, is_plain_line_mode, read_plain_lines
from machopt.toolpath.readers.gcode.g_words import GWordReader
from machopt.toolpath.readers.gcode.macro_flow import MacroFlow
from machopt.toolpath.readers.gcode.siemens_calls import OPERATION
from machopt.toolpath.readers.gcode.syntax.blocks import BlockReader, ProgramBlock, refuse_exponent
from machopt.toolpath.readers.gcode.syntax.missing_decimal_points import apply_decimals_option
from machopt.toolpath.readers.gcode.syntax.program_prescan import (
    ARCHIVE_HEAD,
    PROGRAM_NUMBER,
    check_ascii,
    check_gcode_options,
    find_first_unit,
    find_tape_end,
    is_siemens_program,
)
from machopt.toolpath.readers.gcode.syntax.word_meanings import ADDRESSES, PROGRAM_END, REFUSED_CALLS
from machopt.toolpath.readers.option_error_order import MAX_LINES, find_fault_behind
from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError
from machopt.toolpath.readers.program_flow.linuxcnc_o_words import FlowItem
from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError
from machopt.toolpath.readers.siemens import siemens_flow
from machopt.toolpath.readers.siemens.siemens_flow import SiemensFlow

_HALF_WORD = re.compile(r"(?:^|\s)[XYZABCGIJKRFUVW]\s*[-+.0-9]|^[-+.0-9]")


def read_gcode(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read a G-code program.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    check_gcode_options(source, options)
    try:
        return GcodeReader(source, options).run()
    except OptionNeededError as question:
        if len(source.lines) > MAX_LINES:
            raise
        fault = find_fault_behind(question, options, lambda o: GcodeReader(source, o).carry_out_program())
        raise (fault or question) from None


class GcodeReader(GWordReader):
    """Carries out G, M and other words of G-code; the readers of Heidenhain's programs build on it."""

    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        self.siemens = is_siemens_program(source)
        self.tape_end = find_tape_end(source) if self.decimals_count and not self.siemens else None
        if self.tape_end is not None:
            source = dataclasses.replace(source, lines=source.lines[: self.tape_end])
        self.blocks = BlockReader(parentheses_are_comments=not self.siemens)
        note = ""
        if self.decimals_count:
            source, note = apply_decimals_option(source, options, self.blocks, siemens=self.siemens)
        unit, self.unit_from = self.first_unit(source, options)
        super().__init__(source, options, unit)
        self.unit_said = self.unit_said or not self.unit_by_words
        self.out.meta.update(unit=unit, unit_from=self.unit_from)
        if note:
            self.out.warn(note)
        if self.siemens:
            self.out.meta["control"] = "sinumerik"
        self.ended = False
        self.listing = 0  # "====" lines of an information listing; the program starts after the second
        self.closed = self.tape_end is not None
        self.flow: MacroFlow | SiemensFlow | None = None

    def run(self) -> Toolpath:
        self.carry_out_program()
        if isinstance(self.flow, MacroFlow) and self.flow.only_subroutines and not len(self.out):
            raise self.source.build_error("defines subroutines and calls none; give the program that calls them")
        return self.finish()

    def carry_out_program(self) -> None:
        """Carry out every block of the program, in the order of its flow."""
        try:
            if self.needs_flow():
                items = [(n, *found) for n, t in enumerate(self.source.lines, 1) if (found := self.clean(n, t))]
                self.flow = SiemensFlow(items) if self.siemens else MacroFlow(items)
                self.carry_out(self.flow.run())
            else:
                self.carry_out_lines()
        except ProgramFlowError as problem:
            raise self.source.build_error(str(problem), problem.line) from problem

    def finish(self) -> Toolpath:
        self.end_contour("the program ends")
        self.report_other_programs()
        self.check_offsets_given()
        if self.options.machine and not self.rotary_words:
            self.out.warn("--machine has no effect: the program has no rotary words (A, B, C) and no tool vectors")
        if not self.ended and not self.closed:
            whole = self.source.complete
            self.out.incomplete_reason = "no program end (M30, M2, M99 or %)" + (
                "" if whole else " and the last line does not end: its last number may be cut off"
            )
        if len(self.out):
            self.out.replace_positions(fill_unknown(self.out.positions(), self.out))
        self.compare_rotary_signs()
        return self.out.build()

    def report_other_programs(self) -> None:
        """Name the main programs of the file behind the first one: other channels or jobs, which are not read."""
        pattern = ARCHIVE_HEAD if self.siemens else PROGRAM_NUMBER
        if not self.decimals_count or (self.flow is not None and not self.siemens):
            return
        named = [(n, found.group(1)) for n, t in enumerate(self.source.lines, 1) if (found := pattern.match(t))]
        if len(named) > 1:
            others = ", ".join(name for _, name in named[1:5])
            self.out.warn(f"only the first program of the file is read; {others} would be read by itself", named[1][0])

    def present_call(self) -> object:
        return self.flow.calls[-1] if isinstance(self.flow, MacroFlow) and self.flow.calls else None

    def needs_flow(self) -> bool:
        module = siemens_flow if self.siemens else gcode_flow
        return self.source.find_line(module.NEEDS_FLOW) is not None

    def plain_from(self, at: int) -> int:
        """Carry out plain lines.

        Args:
            at: Index of the first line.

        Returns:
            Index of the first line that is not plain.
        """
        return read_plain_lines(self, at, SIEMENS if self.siemens else PLAIN)

    def carry_out_lines(self) -> None:
        """A program without jumps, line by line, runs of plain moves at once."""
        lines, at = self.source.lines, 0
        while at < len(lines):
            if not self.ended and is_plain_line_mode(self):
                at = self.plain_from(at)
                if at >= len(lines):
                    break
            found = self.clean(at + 1, lines[at])
            at += 1
            if found:
                self.carry_out(iter([(at, *found)]))

    def carry_out(self, items: Iterator[FlowItem]) -> None:
        """Carry out the lines in the order of the program flow.

        Args:
            items: Lines and comments in the order in which the control runs them.

        Raises:
            InputError: a line cannot be carried out.
        """
        for line, text, comments in items:
            if self.ended:
                self.out.ignore("text after the program end", line, understood=True)
                continue
            for comment in comments:
                self.comment(comment)
            if not text:
                continue
            try:
                if "E" in text:
                    refuse_exponent(text)
                self.code(line, text)
            except (MacroExpressionError, ArcError, DrillingCycleError, FrameError) as problem:
                raise self.source.build_error(str(problem), line) from problem
            if isinstance(self.flow, MacroFlow):
                self.report_place(self.flow, line)
            while isinstance(self.flow, SiemensFlow) and self.flow.notes:
                self.out.warn_once(self.flow.notes.pop(), line)

    def report_place(self, flow: MacroFlow, line: int) -> None:
        """Give the present position to the expressions, and report the conventions that an expression depended on.

        Args:
            flow: Program flow with its parameters.
            line: Line number in the file (1-based).
        """
        x, y, z = (v / self.scale for v in self.p)
        flow.parameters.present = (x, y, z)
        while flow.parameters.notes:
            self.out.warn_once(flow.parameters.notes.pop(), line)

    def code(self, line: int, text: str) -> None:
        """Carry out one line of code.

        Args:
            line: Line number in the file (1-based).
            text: Text in upper case without comments.
        """
        if text.endswith(siemens_flow.NEXT_PASS):
            self.code(line, text.removesuffix(siemens_flow.NEXT_PASS) + siemens_flow.RESTORE_MODES)
            self.save_for_call()
            return
        if text.startswith("%"):
            if text == siemens_flow.SAVE_MODES:
                self.save_for_call()
            elif text.endswith(siemens_flow.RESTORE_MODES):
                self.restore_after_call(line)
            elif len(self.out) and self.flow is None:  # the head of the next program in an archive
                self.ended = True
            return
        if text.endswith(siemens_flow.RESTORE_MODES):  # behind words in the block of the return
            self.block(self.blocks.block(line, text.removesuffix(siemens_flow.RESTORE_MODES)))
            self.restore_after_call(line)
            return
        self.block(self.blocks.block(line, text))

    def clean(self, line: int, raw: str) -> tuple[str, list[str]] | None:
        """Split one line into code and comments.

        Args:
            line: Line number in the file (1-based).
            raw: Text of the line.

        Returns:
            Code in upper case and the comments; None where the line holds neither.
        """
        if raw.startswith("====="):
            self.listing += 1
        if self.listing and (self.listing < 2 or raw.startswith("=====")):
            self.out.ignore("information listing header", line, understood=True)
            return None
        text = raw.strip(" \t\x1a\f")
        if not text:
            return None
        if text.startswith("%"):
            return (text.upper(), []) if text.upper().startswith("%_N_") else None
        if text.startswith("/"):
            self.out.ignore("/ (block delete; the block is read)", line, understood=True)
            self.out.warn_once("blocks with / are read, as a control does with its block-delete switch off", line)
            text = text.lstrip("/0123456789")
        comments: list[str] = []
        if "(" in text or ";" in text:
            text, comments = self.blocks.comments(text)
            if self.blocks.unclosed:
                self.out.warn_once(
                    "a parenthesis is not closed: the rest of the line is read as a comment; some controls alarm", line
                )
        text = text.strip().upper()
        if not text.isascii():
            check_ascii(self.source, text, line)
        return (text, comments) if text or comments else None

    def first_unit(self, source: SourceFile, options: ReadOptions) -> tuple[str, str]:
        """Find the unit of lengths before the first unit word.

        Args:
            source: Lines of the file, with its path and the builders of its errors.
            options: Reading options of the user (unit, feed, tolerances, accepted words).

        Returns:
            Name of the unit, and its origin.
        """
        return find_first_unit(source, options, self.blocks, siemens=self.siemens)

    def comment(self, text: str) -> None:
        """Record a comment, or begin the operation that it names.

        Args:
            text: Text of the comment.
        """
        found = OPERATION.match(text)
        if found and found.group(1):
            self.out.begin_operation(found.group(1))
        elif text:
            self.out.event("comment", text)

    # ---- one block

    def block(self, b: ProgramBlock) -> None:
        """Carry out one block.

        Args:
            b: The block: its words, calls and line number.

        Raises:
            InputError: the block cannot be carried out.
        """
        if b.junk:
            self.refuse_junk(b)
        words, twice, g_words, m_words = self.sort_words(b)
        if self.siemens and "L" in words:
            b.calls.append((f"L{words.pop('L'):g}", ""))
        self.calls(b, words)
        for name in b.named:
            if name in REFUSED_CALLS:
                raise self.source.build_error(f"{name}=: {REFUSED_CALLS[name]}", b.line)
            if name not in ADDRESSES and not re.fullmatch(r"R[0-9]+", name):
                self.out.ignore(f"{name}=", b.line, understood=name in harmless_words.SINUMERIK_NAMES)
        machine_frame = self.g_words(g_words, words, b)
        if not self.unit_used_at:
            self.check_unit(g_words, words, b)
        if any(name == "SUPA" for name, _ in b.calls) or 91 in m_words:
            machine_frame = "SUPA" if 91 not in m_words else "M91"
        self.numbers(words, b, started=bool({3, 4, 13, 14} & set(m_words)))
        self.m_words(m_words, words, b.line)
        if "T" in twice:
            self.next_tool, self.next_name = twice["T"], ""
        modal_feed = self.feed, self.feed_scale
        if "FB" in b.named:
            self.take_feed(b.named["FB"], b.line)  # for this block only
        if machine_frame:
            self.mark_position_unknown(words, machine_frame, b.line)
        else:
            self.move(words, b)
        if "FB" in b.named:
            self.feed, self.feed_scale = modal_feed
        if any(m in PROGRAM_END or (m == 17 and self.siemens) for m in m_words):
            self.ended = True

    def refuse_junk(self, b: ProgramBlock) -> None:
        """Refuse text of a block that is no word, or ignore it where it moves nothing.

        Args:
            b: The block: its words, calls and line number.

        Raises:
            InputError: the text is a formula or a call, or may belong to a word.
        """
        if re.match(r"[A-Z]\s*=|[A-Z][0-9]*\s*=|.*[=(*]", b.junk):
            raise self.source.build_error(f"{b.junk[:30]!r}: this formula or call is not understood", b.line)
        if b.words or _HALF_WORD.search(b.junk):
            raise self.source.build_error(f"found {b.junk[:30]!r}; expected words such as X10.5 or G1", b.line)
        self.out.ignore(b.junk[:24], b.line, understood=False)

    def sort_words(self, b: ProgramBlock) -> tuple[dict[str, float], dict[str, float], list[int], list[int]]:
        """Sort the words of a block.

        Args:
            b: The block: its words, calls and line number.

        Returns:
            Words by letter, a second T word, numbers of the G words times ten, numbers of the M words.

        Raises:
            InputError: a word is given twice or belongs to no control, or another program begins.
        """
        words: dict[str, float] = {}
        twice: dict[str, float] = {}
        g_words: list[int] = []
        m_words: list[int] = []
        for letter, value in b.words:
            if letter in "GM":
                if value > 1e5:
                    raise self.source.build_error(f"{letter}{value:g} is not a word of any control", b.line)
                (g_words if letter == "G" else m_words).append(round(value * 10) if letter == "G" else round(value))
            elif letter == "O" and len(self.out) and self.flow is None and not self.siemens and self.decimals_count:
                raise self.source.build_error(
                    f"O{value:g} begins another program, and the one before has no end (M30, M2 or M99): expected one "
                    "program in the file, or an end before the next one",
                    b.line,
                )
            elif letter == "O" and any(other not in "NO" for other, _ in b.words[: b.words.index((letter, value))]):
                raise self.source.build_error(
                    f"O{value:g} follows other words; expected a program number alone, or a zero instead of O",
                    b.line,
                )
            elif letter not in "NO":
                if letter == "T" and "T" in words and "T" not in twice:
                    twice["T"] = value  # T01 T02 M06: the second one is for later
                    continue
                if letter in words:
                    raise self.source.build_error(f"{letter} is given twice in one block", b.line)
                words[letter] = value
        return words, twice, g_words, m_words
