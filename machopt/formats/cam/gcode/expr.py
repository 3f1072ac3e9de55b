"""Parameters and expressions of Fanuc macros and LinuxCNC: ``#1=5``, ``X[#<a>*10.]``; evaluated fully or refused."""

from __future__ import annotations

import math
import re
from collections.abc import Callable


class ExpressionError(ValueError):
    """The expression cannot be evaluated here; the reader adds file and line."""


_TOKEN = re.compile(r"\s*(\d+\.?\d*|\.\d+|\*\*|[-+*/\[\]#=]|<[^<>]*>|[A-Z]+)")
_COMPARE: dict[str, Callable[[float, float], bool]] = {
    "EQ": lambda a, b: abs(a - b) < 1e-6,  # LinuxCNC's own tolerance
    "NE": lambda a, b: abs(a - b) >= 1e-6,
    "GT": lambda a, b: a > b,
    "GE": lambda a, b: a >= b,
    "LT": lambda a, b: a < b,
    "LE": lambda a, b: a <= b,
}
_LOGIC: dict[str, Callable[[bool, bool], bool]] = {
    "AND": lambda a, b: a and b,
    "OR": lambda a, b: a or b,
    "XOR": lambda a, b: a != b,
}
_DEGREES: dict[str, Callable[[float], float]] = {
    "SIN": lambda v: math.sin(math.radians(v)),
    "COS": lambda v: math.cos(math.radians(v)),
    "TAN": lambda v: math.tan(math.radians(v)),
    "ASIN": lambda v: math.degrees(math.asin(v)),
    "ACOS": lambda v: math.degrees(math.acos(v)),
    "SQRT": math.sqrt,
    "ABS": abs,
    "FIX": math.floor,
    "FUP": math.ceil,
    "ROUND": round,
    "EXP": math.exp,
    "LN": math.log,
}
MAX_DEPTH = 50


class Parameters:
    """Values of ``#1`` and ``#<name>``; a parameter read before it is set is an error."""

    def __init__(self) -> None:
        self._values: dict[str, float] = {}
        self._outside: list[dict[str, float]] = []

    def state(self) -> tuple[tuple[str, float], ...]:
        return tuple(self._values.items())

    def enter(self, arguments: dict[str, float]) -> None:
        """A subroutine begins: #1 to #33 and names without an underscore are its own."""
        self._outside.append(self._values)
        shared = {k: v for k, v in self._values.items() if not _is_local(k)}
        self._values = {**shared, **arguments}

    def leave(self) -> None:
        """It ends: its own parameters are forgotten, what it set outside stays."""
        shared = {k: v for k, v in self._values.items() if not _is_local(k)}
        self._values = {k: v for k, v in self._outside.pop().items() if _is_local(k)} | shared

    def number(self, text: str) -> float:
        """The value of one expression.

        Raises:
            ExpressionError: as for :meth:`evaluate`, or something stands after it.
        """
        parser = _Parser(text, 0, self._values)
        value, at = parser.expression()
        if text[at:].strip():
            raise ExpressionError(f"found {text[at:].strip()[:20]!r} after an expression")
        return value

    def bracketed(self, text: str) -> list[float]:
        """The values of ``[…] […] …``."""
        found: list[float] = []
        at = 0
        while text[at:].strip():
            value, at = _Parser(text, at, self._values).factor()
            found.append(value)
        return found

    def evaluate(self, text: str) -> str:
        """The line with every expression replaced by its number and assignments carried out.

        Raises:
            ExpressionError: an unset parameter, an unknown function, a division by zero.
        """
        out: list[str] = []
        later: dict[str, float] = {}  # assignments hold from the next line on
        at = 0
        while at < len(text):
            c = text[at]
            if c == "[":
                value, at = _Parser(text, at, self._values).factor()
                out.append(_plain(value))
            elif c == "#":
                parser = _Parser(text, at, self._values)
                name, end = parser.name()
                rest = text[end:].lstrip()
                if rest.startswith("="):
                    start = len(text) - len(rest) + 1
                    later[name], at = _Parser(text, start, self._values).expression()
                else:
                    value, at = _Parser(text, at, self._values).factor()
                    out.append(_plain(value))
            else:
                out.append(c)
                at += 1
        self._values.update(later)
        return "".join(out)


def _is_local(name: str) -> bool:
    if name.startswith("<"):
        return not name.startswith("<_")
    return name.isdigit() and int(name) <= 33


def _plain(value: float) -> str:
    if not math.isfinite(value) or abs(value) > 1e12:
        raise ExpressionError(f"an expression gives {value}")
    return f"{value:.9f}"


class _Parser:
    """Recursive descent; every method returns (value, place after it)."""

    def __init__(self, text: str, at: int, values: dict[str, float], depth: int = 0) -> None:
        self.text, self.at, self.values, self.depth = text, at, values, depth

    def peek(self) -> str:
        found = _TOKEN.match(self.text, self.at)
        return found.group(1) if found else ""

    def take(self) -> str:
        found = _TOKEN.match(self.text, self.at)
        if not found:
            raise ExpressionError(f"an expression breaks off at {self.text[self.at : self.at + 10]!r}")
        self.at = found.end()
        return found.group(1)

    def name(self) -> tuple[str, int]:
        self.take()  # '#'
        token = self.take()
        if token.startswith("<"):
            return re.sub(r"\s", "", token), self.at
        if token in "[#":
            raise ExpressionError("indirect parameters (##, #[…]) are not supported")
        return token, self.at

    def expression(self) -> tuple[float, int]:
        """Logic over comparisons over sums; both bind from the left."""
        value, _ = self.comparison()
        while self.peek() in _LOGIC:
            operator = self.take()
            right, _ = self.comparison()
            value = float(_LOGIC[operator](value != 0.0, right != 0.0))
        return value, self.at

    def comparison(self) -> tuple[float, int]:
        value, _ = self.sum()
        while self.peek() in _COMPARE:
            operator = self.take()
            value = float(_COMPARE[operator](value, self.sum()[0]))
        return value, self.at

    def sum(self) -> tuple[float, int]:
        value, _ = self.term()
        while self.peek() in ("+", "-"):
            value = value + self.term()[0] if self.take() == "+" else value - self.term()[0]
        return value, self.at

    def term(self) -> tuple[float, int]:
        value, _ = self.power()
        while self.peek() in ("*", "/", "MOD"):
            operator = self.take()
            right, _ = self.power()
            if operator == "*":
                value *= right
            elif right == 0.0:
                raise ExpressionError("division by zero")
            else:
                value = value / right if operator == "/" else value % right
        return value, self.at

    def power(self) -> tuple[float, int]:
        value, _ = self.factor()
        while self.peek() == "**":
            self.take()
            try:
                value = float(value ** self.factor()[0])
            except (OverflowError, ZeroDivisionError, TypeError) as problem:
                raise ExpressionError("a power has no real value") from problem
        return value, self.at

    def factor(self) -> tuple[float, int]:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise ExpressionError("an expression is nested too deeply")
        value = self._factor()
        self.depth -= 1
        return value, self.at

    def _factor(self) -> float:
        token = self.peek()
        if token in ("+", "-"):
            self.take()
            value, _ = self.factor()
            return -value if token == "-" else value
        if token == "[":
            self.take()
            value, _ = self.expression()
            if self.take() != "]":
                raise ExpressionError("a bracket is not closed")
            return value
        if token == "#":
            name, _ = self.name()
            if name not in self.values:
                if name.startswith(("<_HAL[", "<_INI[")):
                    raise ExpressionError(
                        f"#{name} is a value of the running control, not of the program: write the number instead"
                    )
                raise ExpressionError(f"parameter #{name} is read before it is set")
            return self.values[name]
        self.take()
        if token and (token[0].isdigit() or token[0] == "."):
            return float(token)
        if token == "EXISTS":
            if self.take() != "[" or self.peek() != "#":
                raise ExpressionError("EXISTS is written EXISTS[#<name>]")
            name, _ = self.name()
            if self.take() != "]":
                raise ExpressionError("a bracket is not closed")
            return float(name in self.values)
        if token == "ATAN":
            y, _ = self.factor()
            if self.take() != "/":
                raise ExpressionError("ATAN is written ATAN[y]/[x]")
            return math.degrees(math.atan2(y, self.factor()[0]))
        if token in _DEGREES:
            try:
                return float(_DEGREES[token](self.factor()[0]))
            except (ValueError, OverflowError) as problem:
                raise ExpressionError(f"{token} has no value there") from problem
        raise ExpressionError(f"{token!r} is not supported in an expression")
