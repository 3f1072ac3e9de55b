"""Parser of RAPID text: tokens, routines and values."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field

from machopt.file_formats.source_file import SourceFile
from machopt.programs.abb.rapid_values import MOST_DEPTH, RapidName, RapidToken
from machopt.programs.reading.move_attributes import parse_number

_TOKEN = re.compile(
    r'[ \t\f]+|(!.*)|("(?:[^"]|"")*"?)|((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)'
    r"|([A-Za-z_]\w*)|(:=|<>|<=|>=|.)"
)
_DECLARE = ("CONST", "PERS", "VAR", "TASK", "LOCAL")
BLOCKS = {"IF": "ENDIF", "FOR": "ENDFOR", "WHILE": "ENDWHILE", "TEST": "ENDTEST"}
_LINE_WORDS = frozenset(
    (
        "ELSE",
        "ENDIF",
        "ENDFOR",
        "ENDWHILE",
        "ENDTEST",
        "ERROR",
        "UNDO",
        "BACKWARD",
        "ENDPROC",
        "ENDFUNC",
        "ENDTRAP",
        "ENDMODULE",
        "ENDRECORD",
        "DEFAULT",
    )
)
_NUMBERS = re.compile(r"\[[-+.,0-9\seE\[\]]{0,2000}\](?=\s*[,;\\])")
_PLAIN_MOVE = re.compile(
    r"\s*(Move(?:L|J|AbsJ))\s+(\[[-+.,0-9\seE\[\]]{0,2000}\])\s*,\s*([A-Za-z_]\w*)\s*,\s*([A-Za-z_]\w*)\s*,"
    r"\s*([A-Za-z_]\w*)\s*(?:\\(WObj)\s*:=\s*([A-Za-z_]\w*)\s*)?;\s*",
    re.IGNORECASE,
)


@dataclass
class RapidStatement:
    """The tokens up to a semicolon, or a block word; a comment is a statement of its own."""

    line: int
    tokens: list[RapidToken]
    plain: tuple[list[object], dict[str, object]] | None = None  # arguments, where the whole was read at once

    @property
    def word(self) -> str:
        return self.tokens[0].text.upper() if self.tokens and self.tokens[0].kind == "name" else ""


@dataclass
class RapidProcedure:
    name: str
    source: SourceFile
    parameters: frozenset[str] = frozenset()
    statements: list[RapidStatement] = field(default_factory=list)
    ends: dict[int, int] = field(default_factory=dict)  # of block statements


@dataclass
class RapidModule:
    procs: list[RapidProcedure] = field(default_factory=list)
    data: list[RapidStatement] = field(default_factory=list)
    is_incomplete: bool = False


def read_rapid_module(source: SourceFile) -> RapidModule:
    """Split a file into declarations and procedures.

    Args:
        source: Lines of the file, with its path and the builder of its errors.

    Returns:
        The module.

    Raises:
        InputError: blocks do not match.
    """
    out = RapidModule()
    current: RapidProcedure | None = None
    skipping = ""
    for s in _parse_statements(source):
        word = s.word
        if current is None and not skipping:
            kind = _find_routine_word(s)
            if kind == "PROC":
                current = _parse_procedure(s, source)
                out.procs.append(current)
            elif kind:
                skipping = {"FUNC": "ENDFUNC", "TRAP": "ENDTRAP", "RECORD": "ENDRECORD"}[kind]
            elif word in _DECLARE:
                out.data.append(s)
        elif skipping:
            skipping = "" if word == skipping else skipping
        elif word == "ENDPROC":
            current = None
        elif current is not None:
            if word in ("ERROR", "UNDO", "BACKWARD") and len(s.tokens) == 1:
                current, skipping = None, "ENDPROC"  # handlers run only when something goes wrong
            else:
                current.statements.append(s)
    out.is_incomplete = current is not None
    for proc in out.procs:
        _match_blocks(proc)
    return out


def _parse_statements(source: SourceFile) -> list[RapidStatement]:
    out: list[RapidStatement] = []
    open_tokens: list[RapidToken] = []

    def close() -> None:
        if open_tokens:
            out.append(RapidStatement(open_tokens[0].line, list(open_tokens)))
            open_tokens.clear()

    names: dict[str, RapidName] = {}
    for n, raw in enumerate(source.lines, 1):
        move = None if open_tokens else _PLAIN_MOVE.fullmatch(raw)
        if move is not None and (target := _parse_plain_list(move.group(2))) is not None:
            used = [names.setdefault(w, RapidName(w.upper(), "", w)) for w in move.group(3, 4, 5, 7) if w]
            option: dict[str, object] = {"WOBJ": used[3]} if move.group(6) else {}
            out.append(RapidStatement(n, [RapidToken("name", move.group(1), n)], ([target, *used[:3]], option)))
            continue
        at, end = 0, len(raw)
        while at < end:
            found = _TOKEN.match(raw, at)
            assert found is not None  # its last branch takes any character
            at, group = found.end(), found.lastindex
            if group is None:
                continue
            if group == 5 and found.group(5) == "[" and (whole := _NUMBERS.match(raw, found.start())):
                value = _parse_plain_list(whole.group(0))
                if value is not None:
                    at = whole.end()
                    open_tokens.append(RapidToken("list", whole.group(0), n, value))
                    continue
            text = found.group(group)
            if group == 1:
                comment = RapidStatement(n, [RapidToken("comment", text[1:].strip(), n)])
                behind = bool(out) and out[-1].tokens[-1].line == n and out[-1].tokens[0].kind != "comment"
                out.insert(len(out) - behind, comment)  # a comment behind a statement explains it
                continue
            if group == 5 and text == ";":
                close()
                continue
            open_tokens.append(RapidToken(("", "comment", "text", "number", "name", "sign")[group], text, n))
            word = text.upper() if group == 4 else ""
            if word in ("THEN", "DO") or (word in _LINE_WORDS and len(open_tokens) == 1):
                close()
        if (
            open_tokens
            and open_tokens[0].kind == "name"
            and (
                open_tokens[0].text.upper() in ("MODULE", "TEST", "CASE", "TRAP", "RECORD")
                or (_find_routine_word(RapidStatement(n, open_tokens)) and open_tokens[-1].text == ")")
            )
        ):
            close()
    close()
    return out


def _parse_plain_list(text: str) -> object:
    """A list of numbers at once: JSON reads most of them; None where it does not and tokens are needed."""
    if text.count("[") > MOST_DEPTH:
        return None
    try:
        return json.loads(text, parse_int=float, parse_float=_parse_finite)
    except ValueError:
        return None


def _parse_finite(text: str) -> float:
    value = parse_number(text)
    if value is None:
        raise ValueError(text)
    return value


def _find_routine_word(s: RapidStatement) -> str:
    """PROC, FUNC, TRAP or RECORD where the statement is the head of one."""
    words = [t.text.upper() for t in s.tokens[:2] if t.kind == "name"]
    if words and words[0] in ("LOCAL", "TASK") and len(words) > 1:
        words = words[1:]
    return words[0] if words and words[0] in ("PROC", "FUNC", "TRAP", "RECORD") else ""


def _parse_procedure(s: RapidStatement, source: SourceFile) -> RapidProcedure:
    names = [t.text for t in s.tokens if t.kind == "name"]
    at = next(k for k, name in enumerate(names) if name.upper() == "PROC")
    inside = [
        t.text.upper()
        for k, t in enumerate(s.tokens[1:], 1)
        if t.kind == "name" and k + 1 < len(s.tokens) and s.tokens[k + 1].text in (",", ")", "{")
    ]
    return RapidProcedure(names[at + 1] if at + 1 < len(names) else "", source, frozenset(inside))


def _match_blocks(proc: RapidProcedure) -> None:
    opened: list[tuple[int, str]] = []
    for k, s in enumerate(proc.statements):
        word = s.word
        if word in BLOCKS and (word == "TEST" or s.tokens[-1].text.upper() in ("THEN", "DO")):
            opened.append((k, BLOCKS[word]))
        elif word in BLOCKS.values():
            if not opened or opened[-1][1] != word:
                raise proc.source.build_error(f"{word} without its beginning", s.line)
            proc.ends[opened.pop()[0]] = k
    if opened:
        at, word = opened[-1]
        raise proc.source.build_error(f"{proc.statements[at].word} without {word}", proc.statements[at].line)
