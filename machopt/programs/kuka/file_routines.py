"""KRL files split into routines and blocks, before execution."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.line_comments import split_comment

_HEAD = re.compile(r"(?:GLOBAL\s+)?(DEF|DEFFCT|DEFDAT)\s+(?:\w+\s+)?(\w+)\s*(?:\(([^)]*)\)?)?.*", re.IGNORECASE)
_WORD = re.compile(r"[^\s({]*")
OPENS = {
    "FOR": "ENDFOR",
    "IF": "ENDIF",
    "WHILE": "ENDWHILE",
    "LOOP": "ENDLOOP",
    "REPEAT": "UNTIL",
    "SWITCH": "ENDSWITCH",
}
_CLOSES = frozenset(OPENS.values())


@dataclass(frozen=True)
class KrlLine:
    number: int
    code: str
    comment: str


@dataclass
class KrlRoutine:
    """One DEF: its lines and, for each line that opens a block, the line that closes it."""

    name: str
    source: SourceFile
    lines: list[KrlLine] = field(default_factory=list)
    ends: dict[int, int] = field(default_factory=dict)


@dataclass
class KrlModule:
    """What one file holds."""

    routines: list[KrlRoutine] = field(default_factory=list)
    data: list[KrlLine] = field(default_factory=list)  # statements between DEFDAT and ENDDAT
    unassigned_lines: list[KrlLine] = field(default_factory=list)  # code outside of everything
    is_incomplete: bool = False


def read_krl_module(source: SourceFile) -> KrlModule:
    """Split a file into its routines and data.

    Args:
        source: Lines of the file, with its path and the builder of its errors.

    Returns:
        Routines and data of the file.

    Raises:
        InputError: a block is closed that was not opened, or the other way round.
    """
    out = KrlModule()
    current: KrlRoutine | None = None
    inside = ""
    for n, raw in enumerate(source.lines, 1):
        code, comment = split_comment(raw, ";")
        word = get_first_word(code)
        head = _HEAD.fullmatch(code) if word in ("DEF", "DEFFCT", "DEFDAT", "GLOBAL") else None
        if head is not None:
            inside = head.group(1).upper()
            current = KrlRoutine(head.group(2), source) if inside == "DEF" else None
            if current is not None:
                out.routines.append(current)
        elif word in ("END", "ENDFCT", "ENDDAT"):
            current, inside = None, ""
        elif current is not None:
            if code or comment:
                current.lines.append(KrlLine(n, code, comment))
        elif inside == "DEFDAT":
            if code:
                out.data.append(KrlLine(n, code, comment))
        elif code and not inside and not code.startswith("&"):
            out.unassigned_lines.append(KrlLine(n, code, comment))
    out.is_incomplete = inside == "DEF"
    for routine in out.routines:
        _match_blocks(routine)
    return out


def _match_blocks(routine: KrlRoutine) -> None:
    """Note where each block of a routine ends."""
    opened: list[tuple[int, str]] = []
    for k, line in enumerate(routine.lines):
        word = get_first_word(line.code)
        if word in OPENS:
            opened.append((k, OPENS[word]))
        elif word in _CLOSES:
            if not opened or opened[-1][1] != word:
                raise routine.source.build_error(f"{word} without its beginning", line.number)
            routine.ends[opened.pop()[0]] = k
    if opened:
        at, word = opened[-1]
        line = routine.lines[at]
        raise routine.source.build_error(f"{get_first_word(line.code)} without {word}", line.number)


def get_first_word(code: str) -> str:
    """Return the first word of a statement in upper case.

    Args:
        code: The statement.

    Returns:
        The word; empty where there is none.
    """
    found = _WORD.match(code)
    return found.group(0).upper() if found else ""
