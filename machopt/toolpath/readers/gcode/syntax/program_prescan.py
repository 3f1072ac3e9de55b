"""Properties of a G-code file that are found before it is executed: control, unit, end of program."""

from __future__ import annotations

import re
import unicodedata

from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.toolpath.readers.gcode.syntax.blocks import BlockReader
from machopt.toolpath.readers.gcode.syntax.word_meanings import UNITS

_SIEMENS = re.compile(
    r"\b(?:TRAORI|TRAFOOF|MCALL|CYCLE[0-9]+|MSG|SUPA|DEF\s+(?:REAL|INT)|(?:CR|AR|TURN|RND|RNDM|CHF|CHR|AP|RP|RPL|ANG)\s*="
    r"|R[0-9]+\s*=|A3\s*=|[XYZABCIJK]1?\s*=\s*-?[A-Z0-9.]|GOTO[BF]|(?<![-.<])A?(?:TRANS|ROT|SCALE|MIRROR)\b(?![-.>])|CIP\b|HOLES[12]\b"
    r"|REPEATB?\s+[A-Z]|PROC\s+[A-Z_]\w*|CASE\b.*\bGOTO[BF])"
    r"|=\s*(?:AC|IC|DC|ACP|ACN)\b"
    r"|^\s*%_N_\w+_[MS]PF",
    re.IGNORECASE | re.MULTILINE,
)
_NAMED_PARAMETER = re.compile(r"#<")  # LinuxCNC
_UNIT_WORD = re.compile(r"G0*(20|21|70|71|700|710)(?![0-9.])")
_BRACKETS = re.compile(  # at the beginning of a block
    r"^[ \t]*(?:N[0-9]+[ \t]*)?\((?:(?:RPT|UAO|UTO|UIO|SCF|MIR|ROT|GTO|CLS|EPP),|ERP\)|RPT N[0-9]"
    r"|PCALL [0-9]|CALL [0-9]+\))",
    re.MULTILINE,
)
_MILLPLUS = re.compile(r"^\s*(?:N[0-9]+\s*)?(?:G7\s+A5=|G141\b)", re.MULTILINE)


ARCHIVE_HEAD = re.compile(r"\s*%_N_(\w+?)_MPF\b", re.IGNORECASE)  # of a main program
PROGRAM_NUMBER = re.compile(r"\s*([O:][0-9]+)(?!\s*(?:SUB|ENDSUB|CALL|IF|DO|WHILE|REPEAT)\b|[0-9])", re.IGNORECASE)
_PERCENT = re.compile(r"^[ \t\x1a\f]*%", re.MULTILINE)
_CODE = re.compile(r"(?:N[0-9]+\s*)?[GMTSXYZ#]\s*[-+<.0-9]", re.IGNORECASE)


def find_tape_end(source: SourceFile) -> int | None:
    """Find the % that ends the program.

    A % in front of another program (a further % or a program number) only separates two programs of one file.
    Text before the first % is no program unless it is code.

    Args:
        source: Lines of the file, with its path and the builders of its errors.

    Returns:
        Line number (1-based), None where no % follows code.
    """
    if source.find_line(_PERCENT) is None:
        return None
    begun = False
    for line, raw in enumerate(source.lines, 1):
        text = raw.strip(" \t\x1a\f")
        if not text.startswith("%"):
            begun = begun or _CODE.match(text) is not None
        elif text.upper().startswith("%_N_"):
            return None
        elif begun and not _has_second_program(source.lines[line:]):
            return line
    return None


def _has_second_program(lines: list[str]) -> bool:
    first = next((t.strip() for t in lines if t.strip() and t.strip()[0] not in "(;"), "")
    return first.startswith("%") or re.match(r"[O:]\s*[0-9]", first, re.IGNORECASE) is not None


def is_siemens_program(source: SourceFile) -> bool:
    """Return whether a Sinumerik word occurs outside of comments; in such programs brackets are no comments.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
    """
    if source.find_line(_SIEMENS) is None or source.find_line(_NAMED_PARAMETER) is not None:
        return False
    return any(_SIEMENS.search(t.partition(";")[0].partition("(")[0]) for t in source.lines)


def find_first_unit(source: SourceFile, options: ReadOptions, blocks: BlockReader, *, siemens: bool) -> tuple[str, str]:
    """Find the unit of lengths before the first unit word is carried out, and its origin.

    Without an option the first unit word of the file counts. The reader requires the option where a length precedes
    every unit word. Where Sinumerik's G70 or G71 leaves feeds in the unit of the control, the option gives that unit.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).
        blocks: Parser of the lines.
        siemens: Whether the program is for Sinumerik.

    Returns:
        Name of the unit, and its origin.

    Raises:
        InputError: the program is for an unsupported control, or the unit is ambiguous.
    """
    at = source.find_line(_MILLPLUS)
    if at is not None:
        raise source.build_error(
            "is a program for the MillPlus control (G7 A5=, G141), whose G93, G7 and G141 mean other things than "
            "in G-code: not supported; post it for Heidenhain, Siemens or Fanuc, or export APT/CL data",
            at,
        )
    at = source.find_line(_BRACKETS)
    if at is not None:
        raise source.build_error(
            "a statement in brackets, as OSAI and Fagor controls have them (RPT, UAO, ROT …) and others take for a "
            "comment: not supported; expand it, or post the program for Fanuc, Siemens or Heidenhain",
            at,
        )
    found: str | None = None
    lengths_only = False
    for raw in source.lines:
        if "G" in raw or "g" in raw:
            text, _ = blocks.comments(raw) if "(" in raw or ";" in raw else (raw, [])
            word = _UNIT_WORD.search(text.upper())
            if word:
                found = UNITS[int(word.group(1)) * 10]
                lengths_only = siemens and word.group(1) in ("70", "71")
                break
    if found is None and options.unit is None:
        raise source.build_option_question(
            "unit", "has no G20 or G21 (G70, G71); give the unit with --unit mm or --unit inch"
        )
    if found is None or (options.unit is not None and not lengths_only):
        return options.unit or "", "option"
    return found, "G word"


def check_ascii(source: SourceFile, text: str, line: int) -> None:
    """Refuse digits, letters and signs of another script in code (full-width X１０, a typographic minus).

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        text: Code in upper case without comments.
        line: Line number in the file (1-based).

    Raises:
        InputError: the text holds such a character.
    """
    for c in text:
        plain = unicodedata.normalize("NFKC", c)
        if not c.isascii() and ((plain.isascii() and plain.strip()) or unicodedata.category(c) in ("Nd", "Pd", "Sm")):
            raise source.build_error(
                f"{c!r} ({unicodedata.name(c, 'unnamed')}) in a block: no control reads it; expected ASCII", line
            )


def check_gcode_options(source: SourceFile, options: ReadOptions) -> None:
    """Refuse options that have no effect on G-code.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Raises:
        InputError: one of them is given.
    """
    usual = ReadOptions()
    for name in ("cycle_order", "tool_axis"):
        if getattr(options, name) != getattr(usual, name):
            raise source.build_error(f"--{name.replace('_', '-')} has no effect on G-code; leave it out for this file")
