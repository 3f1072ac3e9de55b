"""Parameters and expressions of Fanuc macros and LinuxCNC: ``#1=5``, ``X[#<a>*10.]``; evaluated fully or refused."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from operator import add, mod, mul, sub, truediv

from machopt.formats.expression import Descent


class ExpressionError(ValueError):
    """The expression cannot be evaluated here; the reader adds file and line."""


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


def _logic(what: Callable[[bool, bool], bool]) -> Callable[[float, float], float]:
    return lambda left, right: float(what(left != 0.0, right != 0.0))


def _compared(what: Callable[[float, float], bool]) -> Callable[[float, float], float]:
    return lambda left, right: float(what(left, right))


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
        value, at = parser.expression(), parser.at
        if text[at:].strip():
            raise ExpressionError(f"found {text[at:].strip()[:20]!r} after an expression")
        return value

    def bracketed(self, text: str) -> list[float]:
        """The values of ``[…] […] …``."""
        found: list[float] = []
        at = 0
        while text[at:].strip():
            parser = _Parser(text, at, self._values)
            found.append(parser.factor())
            at = parser.at
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
            if c not in "[#":
                out.append(c)
                at += 1
                continue
            parser = _Parser(text, at, self._values)
            if c == "#":
                name = parser.name()
                rest = text[parser.at :].lstrip()
                if rest.startswith("="):
                    parser.at = len(text) - len(rest) + 1
                    later[name], at = parser.expression(), parser.at
                    continue
                parser.at = at
            out.append(_plain(parser.factor()))
            at = parser.at
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


def _power(base: float, exponent: float) -> float:
    try:
        return float(base**exponent)
    except (OverflowError, ZeroDivisionError, TypeError) as problem:
        raise ExpressionError("a power has no real value") from problem


def _by(operator: Callable[[float, float], float]) -> Callable[[float, float], float]:
    def divided(left: float, right: float) -> float:
        if right == 0.0:
            raise ExpressionError("division by zero")
        return operator(left, right)

    return divided


class _Parser(Descent[float]):
    """Evaluates while it reads."""

    token = re.compile(r"\s*(\d+\.?\d*|\.\d+|\*\*|[-+*/\[\]#=]|<[^<>]*>|[A-Z]+)")
    levels = (
        {name: _logic(what) for name, what in _LOGIC.items()},
        {name: _compared(what) for name, what in _COMPARE.items()},
        {"+": add, "-": sub},
        {"*": mul, "/": _by(truediv), "MOD": _by(mod)},
        {"**": _power},
    )
    problem = ExpressionError

    def __init__(self, text: str, at: int, values: dict[str, float]) -> None:
        super().__init__(text, at)
        self.values = values

    def both(self, operator: Callable[[float, float], float], left: float, right: float) -> float:
        return float(operator(left, right))

    def name(self) -> str:
        self.take()  # '#'
        token = self.take()
        if token.startswith("<"):
            return re.sub(r"\s", "", token)
        if token in "[#":
            raise ExpressionError("indirect parameters (##, #[…]) are not supported")
        return token

    def atom(self) -> float:
        token = self.peek()
        if token in ("+", "-"):
            self.take()
            value = self.factor()
            return -value if token == "-" else value
        if token == "[":
            self.take()
            value = self.expression()
            if self.take() != "]":
                raise ExpressionError("a bracket is not closed")
            return value
        if token == "#":
            name = self.name()
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
            name = self.name()
            if self.take() != "]":
                raise ExpressionError("a bracket is not closed")
            return float(name in self.values)
        if token == "ATAN":
            y = self.factor()
            if self.take() != "/":
                raise ExpressionError("ATAN is written ATAN[y]/[x]")
            return math.degrees(math.atan2(y, self.factor()))
        if token in _DEGREES:
            try:
                return float(_DEGREES[token](self.factor()))
            except (ValueError, OverflowError) as problem:
                raise ExpressionError(f"{token} has no value there") from problem
        raise ExpressionError(f"{token!r} is not supported in an expression")
