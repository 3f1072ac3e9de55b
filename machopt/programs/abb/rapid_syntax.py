"""Parser of RAPID text: tokens, routines and values."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field
from typing import NamedTuple

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.program_builder import parse_number

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
MOST_DEPTH = 30
NONE_EXTERNAL = 8.9e9  # 9E9: no such axis


class RapidToken(NamedTuple):
    kind: str  # comment, text, number, name, sign, list
    text: str
    line: int
    value: object = None  # of a list of numbers


class RapidSyntaxError(ValueError):
    """What cannot be read; the reader adds file and line."""


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


@dataclass(frozen=True)
class RapidName:
    """A variable, in upper case, with its index and component where there are any."""

    text: str
    tail: str = ""
    shown: str = ""  # as it is written


@dataclass(frozen=True)
class RapidFunctionCall:
    """A function and its arguments."""

    name: str
    arguments: tuple[object, ...]
    options: tuple[tuple[str, object], ...] = ()  # \Name:=value


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


class RapidValueReader:
    """Values from a statement's tokens; a cursor that only goes forward."""

    def __init__(self, tokens: list[RapidToken]) -> None:
        self.tokens, self.at = tokens, 0

    @property
    def more(self) -> bool:
        return self.at < len(self.tokens)

    def peek(self) -> str:
        return self.tokens[self.at].text if self.more else ""

    def take(self, text: str | None = None) -> RapidToken:
        """Take the next token.

        Args:
            text: Text that the token must have; None for any.

        Returns:
            The token.

        Raises:
            RapidSyntaxError: the token is another one, or the text ends.
        """
        if not self.more or (text is not None and self.tokens[self.at].text != text):
            raise RapidSyntaxError(f"found {self.peek()[:20] or 'the end'!r}; expected {text or 'a value'!r}")
        self.at += 1
        return self.tokens[self.at - 1]

    def value(self, depth: int = 0) -> object:
        """Read a value.

        Args:
            depth: Depth of nested lists and calls, to stop malformed text.

        Returns:
            A number, text, list, :class:`RapidName` or :class:`RapidFunctionCall`.

        Raises:
            RapidSyntaxError: something else, such as a formula.
        """
        if depth > MOST_DEPTH:
            raise RapidSyntaxError("brackets are nested too deeply")
        token = self.take()
        out: object
        if token.text in ("-", "+"):
            inner = self.value(depth + 1)
            if not isinstance(inner, float):
                raise RapidSyntaxError("formulas are not evaluated; expand the program first")
            return -inner if token.text == "-" else inner
        if token.kind == "list":
            return token.value
        if token.kind == "number":
            known = parse_number(token.text)
            if known is None:
                raise RapidSyntaxError(f"{token.text[:20]!r} is no number")
            out = known
        elif token.kind == "text":
            out = token.text
        elif token.text == "[":
            out = self.items(depth)
        elif token.kind == "name":
            out = self.name(token, depth)
        else:
            raise RapidSyntaxError(f"found {token.text[:20]!r}; expected a value")
        if self.peek() in ("+", "-", "*", "/", "DIV", "MOD"):
            raise RapidSyntaxError("formulas are not evaluated; expand the program first")
        return out

    def items(self, depth: int) -> list[object]:
        """Read the values up to the closing bracket.

        Args:
            depth: Depth of nested lists and calls, to stop malformed text.

        Returns:
            The values.

        Raises:
            RapidSyntaxError: the list is malformed.
        """
        out: list[object] = []
        if self.peek() == "]":
            self.take()
            return out
        while True:
            out.append(self.value(depth + 1))
            if self.take().text == "]":
                return out
            if self.tokens[self.at - 1].text != ",":
                raise RapidSyntaxError(f"found {self.tokens[self.at - 1].text[:20]!r} in a list; expected a comma or ]")

    def name(self, token: RapidToken, depth: int) -> object:
        """Read a name, with its index and components, or a function call.

        Args:
            token: The first token.
            depth: Depth of nested lists and calls, to stop malformed text.

        Returns:
            A :class:`RapidName`, a :class:`RapidFunctionCall` or a constant.
        """
        if self.peek() == "(":
            self.take()
            arguments: list[object] = []
            options: list[tuple[str, object]] = []
            while self.peek() != ")":
                if self.peek() == "\\":
                    self.take()
                    word = self.take().text.upper()
                    self.take(":=")
                    options.append((word, self.value(depth + 1)))
                else:
                    arguments.append(self.value(depth + 1))
                if self.peek() == ",":
                    self.take()
            self.take(")")
            return RapidFunctionCall(token.text.upper(), tuple(arguments), tuple(options))
        tail = ""
        while self.peek() in ("{", "."):
            if self.take().text == ".":
                tail += "." + self.take().text.lower()
                continue
            tail += "{"
            while self.peek() != "}":
                tail += self.take().text
            tail += self.take("}").text
        return RapidName(token.text.upper(), tail, token.text)

    def arguments(self) -> tuple[list[object], dict[str, object]]:
        """Positional and optional (``\\Name:=value``) arguments of an instruction."""
        values: list[object] = []
        options: dict[str, object] = {}
        while self.more:
            if self.peek() == ",":
                self.take()
            elif self.peek() == "\\":
                self.take()
                name = self.take().text.upper()
                options[name] = True
                if self.peek() == ":=":
                    self.take()
                    options[name] = self.value()
            else:
                values.append(self.value())
        return values, options


def list_numbers(value: object, count: int) -> list[float] | None:
    """Return a value as a list of numbers.

    Args:
        value: Parsed RAPID value.
        count: Required length.

    Returns:
        The numbers, None where the value is no such list.
    """
    if not isinstance(value, list) or len(value) != count:
        return None
    found = [v for v in value if isinstance(v, float)]
    return found if len(found) == count else None


def parse_robtarget(value: object) -> tuple[float, float, float, tuple[float, float, float, float], list[object]]:
    """Split a robtarget into its parts.

    Args:
        value: Parsed RAPID value.

    Returns:
        x, y, z in mm, quaternion, and the rest (confdata, external axes).

    Raises:
        RapidSyntaxError: the value is no robtarget.
    """
    if isinstance(value, list) and len(value) >= 2:
        p, q = list_numbers(value[0], 3), list_numbers(value[1], 4)
        if p is not None and q is not None:
            return p[0], p[1], p[2], (q[0], q[1], q[2], q[3]), value[2:]
    raise RapidSyntaxError("found no robtarget; expected [[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[external axes]]")


def parse_jointtarget(value: object) -> tuple[list[float], list[float]]:
    """Split a jointtarget into its parts.

    Args:
        value: Parsed RAPID value.

    Returns:
        Robot axes and external axes, degrees or mm.

    Raises:
        RapidSyntaxError: the value is no jointtarget.
    """
    if isinstance(value, list) and value:
        axes = list_numbers(value[0], 6)
        if axes is not None:
            return axes, list_external_axes(value[1]) if len(value) > 1 else []
    raise RapidSyntaxError("found no jointtarget; expected [[six axes],[external axes]]")


def list_external_axes(value: object) -> list[float]:
    """Return the external axes up to the last one in use.

    Args:
        value: Parsed RAPID value.

    Returns:
        Values in degrees or mm; NaN for an unused axis.
    """
    axes = list_numbers(value, 6) or []
    used = [math.nan if v >= NONE_EXTERNAL else v for v in axes]
    while used and math.isnan(used[-1]):
        used.pop()
    return used


def parse_confdata(value: object) -> dict[str, object]:
    """Return the quarter turns and cfx of confdata.

    Args:
        value: Parsed RAPID value.

    Returns:
        Name → value; empty where the value is no confdata.
    """
    found = list_numbers(value, 4)
    return dict(zip(("cf1", "cf4", "cf6", "cfx"), map(int, found), strict=True)) if found is not None else {}
