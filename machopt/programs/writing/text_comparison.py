"""Comparison of everything in a program except its coordinates: every line of every file, word by word.

The post writes the parsed program a second time, with a mark for each number of a target. All other text (head,
declarations, frames, loads, speeds, zones, events, order of lines, line counts, END) must be identical. The targets are
compared by :mod:`machopt.verification.programs.motion_comparison`, which shares nothing with the posts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.programs.writing.template_fields import LazyColumns
from machopt.programs.writing.template_language import TemplateColumn

MARK = 98765.4321  # placeholder of a coordinate until it is compared
WORD = "machoptword"  # the same for configuration words
_POSES = "x y z x_m y_m z_m a b c r p w qw qx qy qz rvx rvy rvz ex ey ez i j k".split()  # noqa: SIM905 shorter
_AXES = [
    f"{name}{k}{unit}"
    for k in range(1, 7)
    for name, unit in (("a", ""), ("a", "_rad"), ("q", ""), ("q", "_deg"), ("pulse", ""))
]
_WORDS = "status turn cf1 cf4 cf6 cfx t1 t4 t6 time step sec nanosec".split()  # noqa: SIM905 shorter
_EXTERNAL = [
    f"{axis}{unit}"
    for axis in (*(f"e{k}" for k in range(1, 7)), *(f"{g}{k}" for g in ("rail", "table") for k in range(1, 4)))
    for unit in ("", "_si", "_pulse", "_plain")
]
COORDINATES = frozenset((*_POSES, *_AXES, *_EXTERNAL, *_WORDS))
CONFIGURATION = frozenset(("flip", "elbow", "front", "shoulder", "wrist"))
_HOLE = re.compile(rf"98765(?:\.4321[0-9]*|\.432|\.43|\.4)?|{WORD}")
_FILL = re.compile(r"[-+]?[0-9]+(?:\.[0-9]+)?|[A-Za-z]+")  # \d takes digits of other scripts, a control does not
_BLANK = " \t"  # at the end of a line; str.strip() takes a no-break space as well
_LABEL = re.compile(r"\W*(?:[0-9]+:)?\W*(?:operation|move): ")


def mark_coordinates(
    columns: Mapping[str, Callable[[], TemplateColumn]], numbers_by_axis: Mapping[str, Sequence[object]]
) -> LazyColumns:
    """Replace every coordinate in the columns by a mark.

    Args:
        columns: Field → function that computes its column.
        numbers_by_axis: Field → values that the program file holds, which replace the column.

    Returns:
        Columns, computed on demand.
    """

    def hole(name: str) -> Callable[[], TemplateColumn]:
        def column() -> TemplateColumn:
            values = columns[name]()
            if name in CONFIGURATION:
                return [WORD] * len(values)
            number = np.array([np.nan if v is None or v == "" else float(v) for v in values])  # type: ignore[arg-type]
            return np.where(np.isnan(number), np.nan, MARK)

        return column

    out = {n: hole(n) if n in COORDINATES | CONFIGURATION else make for n, make in columns.items()}
    return LazyColumns({**out, **{n: (lambda v=v: v) for n, v in numbers_by_axis.items()}})  # type: ignore[misc]


@dataclass(frozen=True)
class TextDifference:
    """The first line that is not as the post writes it."""

    line: int  # in the file, from 1
    found: str
    expected: str


def find_text_difference(found: str, expected: Sequence[str]) -> TextDifference | None:
    """Compare a file with texts of :func:`mark_coordinates` columns, any of which it may be line by line.

    Lines that only name an operation or a kind of move are left to the comparison with the motion.

    Args:
        found: the file's text.
        expected: the text as the post writes it, and with zones on either side where one hangs on the last digit.
    """
    lines = [(n, t) for n, t in enumerate(found.splitlines(), 1) if not _LABEL.match(t)]
    wanted = [[t for t in text.splitlines() if not _LABEL.match(t)] for text in expected]
    for k, (n, text) in enumerate(lines):
        choices = [w[k] for w in wanted if k < len(w)]
        if not choices:
            return TextDifference(n, text.strip(), "the end of the file")
        if not any(_is_match(text, c) for c in choices):
            return TextDifference(n, text.strip(), _format_text(choices[0]))
    if len(lines) < len(wanted[0]):
        return TextDifference(
            lines[-1][0] + 1 if lines else 1, "the end of the file", _format_text(wanted[0][len(lines)])
        )
    return None


def find_undecodable_bytes(data: bytes, encoding: str) -> tuple[int, str] | None:
    """Find the first character that an encoding does not have.

    Args:
        data: Content of the file.
        encoding: Text encoding.

    Returns:
        Line number (1-based) and bytes, None where all are valid.
    """
    try:
        data.decode(encoding)
    except UnicodeDecodeError as problem:
        return data.count(b"\n", 0, problem.start) + 1, f"the bytes {data[problem.start : problem.start + 4].hex(' ')}"
    return None


def find_wrong_line_end(found: str, line_end: str) -> int | None:
    """The first line (from 1) that does not end as the post ends its lines; a lone CR hides what follows in an editor.

    Args:
        found: the file's text, with its line ends as they are.
        line_end: of the post: ``lf`` or ``crlf``.
    """
    wrong = re.search(r"\r(?!\n)|(?<!\r)\n" if line_end == "crlf" else r"\r", found)
    return None if wrong is None else found.count("\n", 0, wrong.start()) + 1


def _format_text(text: str) -> str:
    return _HOLE.sub("…", text).strip()


def _is_match(text: str, pattern: str) -> bool:
    """Same text, a number or word where the pattern has a mark."""
    if "98765" not in pattern and WORD not in pattern:
        return text.rstrip(_BLANK) == pattern.rstrip(_BLANK)
    at = 0
    for piece, last in _split_pattern(pattern.rstrip(_BLANK)):
        if not text.startswith(piece, at):
            return False
        at += len(piece)
        if last:
            return text[at:].strip(_BLANK) == ""
        fill = _FILL.match(text, at)
        if fill is None:
            return False
        at = fill.end()
    return False


def _split_pattern(pattern: str) -> Iterator[tuple[str, bool]]:
    parts = _HOLE.split(pattern)
    for k, part in enumerate(parts):
        yield part, k + 1 == len(parts)
