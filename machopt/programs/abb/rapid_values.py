"""Values of RAPID: literals, aggregates, names and function calls, and the targets that they state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from machopt.programs.reading.move_attributes import parse_number

MOST_DEPTH = 30
NONE_EXTERNAL = 8.9e9  # 9E9: no such axis


class RapidToken(NamedTuple):
    kind: str  # comment, text, number, name, sign, list
    text: str
    line: int
    value: object = None  # of a list of numbers


class RapidSyntaxError(ValueError):
    """What cannot be read; the reader adds file and line."""


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
