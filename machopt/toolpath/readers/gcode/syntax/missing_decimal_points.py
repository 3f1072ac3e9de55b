"""Numbers without a decimal point, which controls read as whole millimetres or as thousandths.

On Fanuc, Haas and others a parameter decides whether ``X1500`` is 1500 mm or 1.5 mm. Old programs omit trailing or
leading zeros (``X0019685``). Where the file makes the whole-number reading doubtful, the user must give an option.
The check and ``--decimals`` examine the words of each block, with or without blanks between them, and never comments.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.toolpath.readers.gcode.syntax.blocks import BlockReader
from machopt.toolpath.readers.gcode.syntax.dwell_units import find_control

_TOKEN = re.compile(r"([A-Z])(\s*)([-+]?)\s*([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)", re.ASCII)
_DOUBTED = frozenset("XYZUVWIJR")  # lengths, whose numbers without a point are checked
_POINTED = frozenset("XYZUVWIJKRABCQ")  # words that --decimals gives a point
_EXPRESSIONS = re.compile(r"[#\[]|^\s*O\s*<", re.IGNORECASE | re.MULTILINE)
_BARE = re.compile(r"[XYZUVWIJR]\s*[-+]?\s*0*[1-9][0-9]*(?![0-9.])", re.IGNORECASE | re.ASCII)
_CYCLE = re.compile(r"G(?:7[346]|8[1-9])(?![0-9])")
_CYCLE_END = re.compile(r"G0*(?:80|[0123])(?![0-9.])")
_OTHER_MEANING = re.compile(r"G0*4(?![0-9.])|M19(?![0-9])")  # X, U and P of a dwell, R of a spindle position
_VECTORS = re.compile(r"G43\.5(?![0-9])")  # I, J, K are the tool's direction
_VECTORS_END = re.compile(r"G49(?![0-9.])|G(?:43\.4|234)(?![0-9])|M(?:[14]2[89]|430)(?![0-9])")
_FACTORS = re.compile(r"G51(?![0-9.])")  # I, J, K of the block are factors
_LARGE = 10_000  # without a point beside numbers that have one: ten metres, or ten inches in ten-thousandths
_LARGE_WITHOUT = 1_000  # the same in a file without any point, or one that marks its whole numbers (X5.)
_EXAMPLES = 2
_PECK = re.compile(r"G(?:73|83)(?![0-9]).*?(Q\s*0*([0-9]+))(?![0-9.])", re.ASCII)
_LARGE_PECK = 100  # mm or inches: no peck is as deep, and controls count Q in thousandths


def apply_decimals_option(
    source: SourceFile, options: ReadOptions, blocks: BlockReader, *, siemens: bool
) -> tuple[SourceFile, str]:
    """Apply the option ``--decimals`` to the numbers of a file.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).
        blocks: Parser of the lines.
        siemens: Whether the program is for Sinumerik.

    Returns:
        The file with decimal points, and a description of the change.

    Raises:
        InputError: the option is needed, or it is given and cannot apply.
    """
    decimals = options.decimals
    if decimals is None:
        return source, "" if siemens else check_decimals(source, blocks)
    if siemens:
        raise source.build_error(
            "--decimals is for G-code of the Fanuc kind; numbers of Sinumerik are read as they are"
        )
    if decimals == 0:
        if not any(word.bare for word in _iterate_length_words(source, blocks)):
            raise _build_idle_option_error(source)
        return source, ""
    return insert_decimal_points(source, decimals, blocks)


@dataclass(frozen=True)
class _LengthWord:
    """A length without expression, as written in a block."""

    letter: str
    number: str
    line: int
    text: str

    @property
    def bare(self) -> bool:
        return "." not in self.number

    @property
    def leading_zeros(self) -> bool:
        return self.bare and len(self.number) > 2 and self.number[0] == "0" and int(self.number) > 0


def _clean_code(raw: str, blocks: BlockReader) -> str:
    return (blocks.comments(raw)[0] if "(" in raw or ";" in raw else raw).upper()


def _has_vectors(text: str, before: bool) -> bool:
    """Whether I, J and K of a block are the tool's direction."""
    return (before and _VECTORS_END.search(text) is None) or _VECTORS.search(text) is not None


def _iterate_length_words(source: SourceFile, blocks: BlockReader) -> Iterator[_LengthWord]:
    vectors = False
    for line, raw in enumerate(source.lines, 1):
        text = _clean_code(raw, blocks)
        vectors = _has_vectors(text, vectors)
        if _OTHER_MEANING.search(text):
            continue
        no_lengths = vectors or _FACTORS.search(text) is not None
        for found in _TOKEN.finditer(text):
            if found.group(1) in _DOUBTED and not (no_lengths and found.group(1) in "IJK"):
                yield _LengthWord(found.group(1), found.group(4), line, found.group().strip())


@dataclass(kw_only=True)
class _LengthWordSurvey:
    """How the lengths of a file are written."""

    marked: int = 0  # coordinates with a point at their end
    pointed: int = 0  # coordinates with decimals
    bare: int = 0  # lengths without a point and without leading zeros
    marks_whole: bool = False  # a whole number other than zero is written with a point at its end
    zeros: _LengthWord | None = None  # the first one with leading zeros
    first: _LengthWord | None = None  # the first one without a point
    large: list[_LengthWord] = field(default_factory=list)  # examples without a point, large for either limit

    @property
    def has_points(self) -> bool:
        return bool(self.marked or self.pointed)

    def find_too_large(self) -> _LengthWord | None:
        """Return the first number without a point that is too large for whole units."""
        least = _LARGE if self.pointed and not self.marked else _LARGE_WITHOUT
        return next((w for w in self.large if int(w.number) >= least), None)


def _survey_length_words(source: SourceFile, blocks: BlockReader) -> _LengthWordSurvey:
    """Return how the lengths of a file are written."""
    survey = _LengthWordSurvey()
    for word in _iterate_length_words(source, blocks):
        if not word.bare:
            if word.letter in "XYZ":
                whole = word.number.endswith(".")
                survey.marked += whole
                survey.marks_whole = survey.marks_whole or (whole and float(word.number) > 0.0)
                survey.pointed += not whole
        elif (size := int(word.number)) > 0:
            survey.zeros = survey.zeros or (word if word.leading_zeros else None)
            survey.bare += not word.leading_zeros
            survey.first = survey.first or word
            if size >= _LARGE_WITHOUT and (not survey.large or (size >= _LARGE and len(survey.large) < _EXAMPLES)):
                survey.large.append(word)
    return survey


def check_decimals(source: SourceFile, blocks: BlockReader) -> str:
    """Require the option for the decimals of a G-code file whose numbers are ambiguous.

    Ambiguous: numbers with leading zeros; any whole number in a file that marks whole numbers by a point (``X5.``), but
    for LinuxCNC; large ones in a file whose other numbers have points; 1000 and more in a file without any points. All
    others count whole units, as on LinuxCNC and on controls whose parameter says so; beside words with a point that is
    stated. Source: Mitsubishi M700V, Programming Manual,
    "Decimal Point Input": X1 is 0.001 mm with input I and 1 mm with input II, X1. is 1 mm with both; Fanuc's parameter
    3401 decides the same.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        blocks: Parser of the lines.

    Returns:
        Description of the reading; empty where all lengths are written in one way.

    Raises:
        InputError: such a number occurs; the message names the first one.
    """
    _check_pecks(source, blocks)
    if source.find_line(_BARE) is None:
        return ""
    words = _survey_length_words(source, blocks)
    if words.zeros is not None:
        raise _build_decimals_question(
            source, f"{words.zeros.text} has leading zeros and no decimal point", words.zeros.line
        )
    control = find_control(source)
    first = words.first
    is_ambiguous = first is not None and words.marks_whole and control != "linuxcnc"
    if source.find_line(_EXPRESSIONS) is not None and not is_ambiguous:  # in expressions whole numbers are usual
        return ""
    large = words.find_too_large()
    if large is not None:
        others = "other numbers of the file have" if words.has_points else "no number of the file has"
        raise _build_decimals_question(
            source, f"{large.text} has no decimal point ({others} a decimal point)", large.line
        )
    if is_ambiguous and first is not None:
        raise _build_decimals_question(
            source,
            f"{first.text} has no decimal point ({words.pointed + words.marked} coordinates have one, "
            f"{words.bare} have none)",
            first.line,
        )
    if first is None or not words.has_points or control == "linuxcnc":
        return ""
    return (
        f"lengths without a decimal point count whole units (first {first.text}, line {first.line}); where a parameter "
        "of the control counts thousandths, give --decimals"
    )


def _check_pecks(source: SourceFile, blocks: BlockReader) -> None:
    """Require the option where a peck without a point is deeper than any, in a file whose lengths have points."""
    if source.find_line(re.compile(r"Q\s*[0-9]{3}", re.IGNORECASE | re.ASCII)) is None:
        return
    pointed = any(not word.bare for word in _iterate_length_words(source, blocks))
    if not pointed or source.find_line(_EXPRESSIONS) is not None:
        return
    for line, raw in enumerate(source.lines, 1):
        found = _PECK.search(_clean_code(raw, blocks))
        if found is not None and int(found[2]) >= _LARGE_PECK:
            raise _build_decimals_question(
                source, f"{found[1]} has no decimal point (other numbers of the file have a decimal point)", line
            )


def _build_decimals_question(source: SourceFile, what: str, line: int) -> Exception:
    return source.build_option_question(
        "decimals",
        f"{what}: a parameter of the control decides whether it counts whole units or decimals of one. Give "
        "--decimals N (4: the "
        "last digit is a ten-thousandth, usual for inches; 3: a thousandth, usual for mm; 0: no implied decimals)",
        line,
    )


def insert_decimal_points(source: SourceFile, decimals: int, blocks: BlockReader) -> tuple[SourceFile, str]:
    """Insert a decimal point in every length and angle that has none.

    F, S, P, counters (K and L of cycles), directions (I, J, K under G43.5) and factors (those of G51) stay.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        decimals: Number of decimals.
        blocks: Parser of the lines.

    Returns:
        The file with decimal points, and a description of the change.

    Raises:
        InputError: no such number is in the file, or lengths are expressions, whose decimals are not in the file.
    """
    at = source.find_line(_EXPRESSIONS)
    if at is not None:
        raise source.build_error(
            "--decimals cannot apply to expressions: it is not known which of their numbers have implied decimals", at
        )
    lines: list[str] = []
    changed, cycle, vectors = 0, False, False
    examples: list[str] = []
    for raw in source.lines:
        text = _clean_code(raw, blocks)
        cycle = (cycle and _CYCLE_END.search(text) is None) or _CYCLE.search(text) is not None
        vectors = _has_vectors(text, vectors)
        if _OTHER_MEANING.search(text) or not _TOKEN.search(text):
            lines.append(raw)
            continue
        no_lengths = vectors or _FACTORS.search(text) is not None
        pieces, last = [], 0
        for found in _TOKEN.finditer(text):
            letter, blank, sign, digits = found.groups()
            counts = (letter == "K" and cycle) or (letter == "Q" and not cycle)
            if letter not in _POINTED or "." in digits or counts or (no_lengths and letter in "IJK"):
                continue
            filled = digits.zfill(decimals + 1)
            new = f"{letter}{blank}{sign}{filled[:-decimals]}.{filled[-decimals:]}"
            pieces += [text[last : found.start()], new]
            last, changed = found.end(), changed + (int(digits) > 0)
            if int(digits) > 0 and len(examples) < _EXAMPLES:
                examples.append(f"{found.group().strip()} as {new.strip()}")
        if not pieces:
            lines.append(raw)
            continue
        comments = "".join(f"({c})" for c in blocks.comments(raw)[1])
        lines.append("".join([*pieces, text[last:], comments]))
    if not changed:
        raise _build_idle_option_error(source)
    note = f"--decimals {decimals}: {changed} coordinate words without a decimal point got one ({', '.join(examples)})"
    return dataclasses.replace(source, lines=lines), note


def _build_idle_option_error(source: SourceFile) -> Exception:
    return source.build_error("--decimals: no coordinate of the file is without a decimal point; leave the option out")
