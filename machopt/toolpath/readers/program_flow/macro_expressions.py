"""Parameters and expressions of Fanuc macros and LinuxCNC: ``#1=5``, ``X[#<a>*10.]``, ``X-#1``, ``YSIN[30]``.

Expressions are evaluated completely or refused. Where controls differ in a value (halves, remainders and integer parts
of negative numbers, comparisons of nearly equal numbers) the rule of LinuxCNC applies and a note reports it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable
from operator import add, mul, sub, truediv

from machopt.file_formats.expression_parser import RecursiveDescentParser

FANUC_LOCAL, LINUXCNC_LOCAL = 33, 30  # the highest parameter that a called macro or subroutine has for itself
_EQUAL = 1e-4  # numbers that differ by less are equal on LinuxCNC
_EXACT = 1e-9  # numbers that differ by less are equal on every control
_WAY = {"FIX": "lower one", "FUP": "higher one"}
_PRESENT = {name: k for k, names in enumerate((("5420", "<_X>"), ("5421", "<_Y>"), ("5422", "<_Z>"))) for name in names}
_OFFSETS = ((5161, 5400), (7001, 7960))  # parameters that hold reference points and work offsets of the control


class MacroExpressionError(ValueError):
    """The expression cannot be evaluated here; the reader adds file and line."""


_COMPARE: dict[str, Callable[[float, float], bool]] = {
    "EQ": lambda a, b: abs(a - b) < _EQUAL,
    "NE": lambda a, b: abs(a - b) >= _EQUAL,
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


def _build_logic_operator(what: Callable[[bool, bool], bool]) -> Callable[[float, float], float]:
    return lambda left, right: float(what(left != 0.0, right != 0.0))


def _build_comparison_operator(what: Callable[[float, float], bool]) -> Callable[[float, float], float]:
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
    "ROUND": lambda v: math.copysign(math.floor(abs(v) + 0.5), v),  # halves away from zero
    "EXP": math.exp,
    "LN": math.log,
}


class MacroParameters:
    """Values of ``#1`` and ``#<name>``; a parameter read before it is set is an error."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._outside: list[tuple[dict[str, float], int]] = []
        self.present = (math.nan, math.nan, math.nan)  # coordinates of the tool, program units
        self.present_was_read = False
        self.notes: list[str] = []  # conventions that a value depended on, for the reader to report

    def state(self) -> Hashable:
        """Everything that a later line may depend on."""
        frames = tuple(tuple(values.items()) for values, _ in self._outside)
        return tuple(self.values.items()), frames, self.present if self.present_was_read else ()

    def enter(self, arguments: dict[str, float], highest: int = FANUC_LOCAL) -> None:
        """Begin a subroutine: #1 to #``highest`` and names without an underscore become local.

        Args:
            arguments: Name of the parameter → value.
            highest: Highest number of a local parameter.
        """
        self._outside.append((self.values, highest))
        shared = {k: v for k, v in self.values.items() if not _is_local(k, highest)}
        self.values = {**shared, **arguments}

    def leave(self) -> None:
        """It ends: its own parameters are forgotten, what it set outside stays."""
        outside, highest = self._outside.pop()
        shared = {k: v for k, v in self.values.items() if not _is_local(k, highest)}
        self.values = {k: v for k, v in outside.items() if _is_local(k, highest)} | shared

    def read(self, name: str) -> float:
        """Return the value of one parameter.

        Args:
            name: Name or number of the parameter.

        Returns:
            The value.

        Raises:
            MacroExpressionError: it has no value yet, or only the running control knows it.
        """
        if name in self.values:
            return self.values[name]
        if name in _PRESENT:
            self.present_was_read = True
            value = self.present[_PRESENT[name]]
            if math.isnan(value):
                raise MacroExpressionError(f"#{name} is the tool's present place, which is not known there")
            return value
        if name in ("<_VALUE>", "<_VALUE_RETURNED>"):
            return 0.0
        if name.startswith(("<_HAL[", "<_INI[")):
            raise MacroExpressionError(
                f"#{name} is a value of the running control, not of the program: write the number instead"
            )
        raise MacroExpressionError(f"parameter #{name} is read before it is set")

    def number(self, text: str) -> float:
        """Evaluate one expression.

        Args:
            text: Text of the expression.

        Returns:
            The value.

        Raises:
            MacroExpressionError: as for :meth:`evaluate`, or text follows the expression.
        """
        value, at = self.leading(text)
        if text[at:].strip():
            raise MacroExpressionError(f"found {text[at:].strip()[:20]!r} after an expression")
        return value

    def leading(self, text: str) -> tuple[float, int]:
        """Evaluate the expression that a text begins with.

        Args:
            text: Text of the expression.

        Returns:
            The value, and the index behind the expression.
        """
        parser = _MacroParser(text, 0, self)
        return parser.parse_expression(), parser.at

    def leading_factor(self, text: str) -> tuple[float, int]:
        """Evaluate the number, parameter or bracket that a text begins with.

        Args:
            text: Text of the expression.

        Returns:
            The value, and the index behind it.
        """
        parser = _MacroParser(text, 0, self)
        return parser.parse_factor(), parser.at

    def evaluate_brackets(self, text: str) -> list[float]:
        """Evaluate ``[…] […] …``.

        Args:
            text: Text of the expression.

        Returns:
            The value of each bracket.
        """
        found: list[float] = []
        at = 0
        while text[at:].strip():
            parser = _MacroParser(text, at, self)
            found.append(parser.parse_factor())
            at = parser.at
        return found

    def evaluate(self, text: str) -> str:
        """Replace every expression of a line by its number and carry out assignments.

        Args:
            text: Text of the line.

        Returns:
            The line with numbers.

        Raises:
            MacroExpressionError: an unset parameter, an unknown function, a division by zero.
        """
        out: list[str] = []
        later: dict[str, float] = {}  # assignments hold from the next line on
        at = 0
        while at < len(text):
            if word := _WORD_VALUE.match(text, at):
                parser = _MacroParser(text, word.end(1), self)
                out.append(word.group(1) + _format_plain_number(parser.parse_factor()))
                at = parser.at
                continue
            if text[at] not in "[#":
                out.append(text[at])
                at += 1
                continue
            parser = _MacroParser(text, at, self)
            if text[at] == "#":
                name = parser.name()
                rest = text[parser.at :].lstrip()
                if rest.startswith("="):
                    parser.at = len(text) - len(rest) + 1
                    _check_assigned(name)
                    later[name], at = parser.parse_expression(), parser.at
                    continue
                parser.at = at
            out.append(_format_plain_number(parser.parse_factor()))
            at = parser.at
        self.values.update(later)
        return "".join(out)


_FUNCTION = "|".join((*_DEGREES, "ATAN", "EXISTS"))
_WORD_VALUE = re.compile(rf"([A-Z@^])(?<![A-Z]{{2}})\s*(?=[-+\s]*(?:[\[#]|(?:{_FUNCTION})\s*\[))")


def _check_assigned(name: str) -> None:
    """Refuse an assignment that changes where the program's zero lies."""
    if name.isdigit() and any(low <= int(name) < high for low, high in _OFFSETS):
        raise MacroExpressionError(
            f"#{name}= sets a reference point or work offset of the control: not followed; use G10, or G52"
        )


def _is_local(name: str, highest: int) -> bool:
    if name.startswith("<"):
        return not name.startswith("<_")
    return name.isdigit() and int(name) <= highest


def _format_plain_number(value: float) -> str:
    if not math.isfinite(value) or abs(value) > 1e12:
        raise MacroExpressionError(f"an expression gives {value}")
    return f"{value:.9f}"


def _compute_power(base: float, exponent: float) -> float:
    try:
        return float(base**exponent)
    except (OverflowError, ZeroDivisionError, TypeError) as problem:
        raise MacroExpressionError("a power has no real value") from problem


def _compute_with_operator(operator: Callable[[float, float], float]) -> Callable[[float, float], float]:
    def divided(left: float, right: float) -> float:
        if right == 0.0:
            raise MacroExpressionError("division by zero")
        return operator(left, right)

    return divided


def _compute_remainder(left: float, right: float) -> float:
    """LinuxCNC's MOD: never negative."""
    found = math.fmod(left, right)
    return found + abs(right) if found < 0.0 else found


class _MacroParser(RecursiveDescentParser[float]):
    """Evaluates while it reads."""

    token = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+|\*\*|[-+*/\[\]#=]|<[^<>]*>|[A-Z]+)")
    levels = (
        {name: _build_logic_operator(what) for name, what in _LOGIC.items()},
        {name: _build_comparison_operator(what) for name, what in _COMPARE.items()},
        {"+": add, "-": sub},
        {"*": mul, "/": _compute_with_operator(truediv), "MOD": _compute_with_operator(_compute_remainder)},
        {"**": _compute_power},
    )
    problem = MacroExpressionError

    def __init__(self, text: str, at: int, parameters: MacroParameters) -> None:
        super().__init__(text, at)
        self.parameters = parameters

    def combine_operands(self, operator: Callable[[float, float], float], left: float, right: float) -> float:
        found = float(operator(left, right))
        if operator is self.levels[3]["MOD"] and left < 0.0 and found != 0.0:
            self.note("MOD of a negative number is never negative here (LinuxCNC); other controls keep its sign")
        if operator in (self.levels[1]["EQ"], self.levels[1]["NE"]) and _EXACT < abs(left - right) < _EQUAL:
            self.note("EQ and NE take numbers that differ by less than 0.0001 for equal (LinuxCNC)")
        return found

    def note(self, text: str) -> None:
        if text not in self.parameters.notes:
            self.parameters.notes.append(text)

    def name(self) -> str:
        """The parameter's name; ``##3`` and ``#[1+2]`` name it by a value."""
        self.take_token()  # '#'
        token = self.peek_token()
        if token.startswith("<"):
            return re.sub(r"\s", "", self.take_token())
        if token in ("[", "#"):
            number = self.parse_factor()
            if not (math.isfinite(number) and abs(number - round(number)) < _EQUAL and number > 0.5):
                raise MacroExpressionError(f"#[{number:g}]: expected the number of a parameter")
            return str(round(number))
        self.take_token()
        return str(int(token)) if token.isdigit() else token

    def parse_atom(self) -> float:
        token = self.peek_token()
        if token in ("+", "-"):
            self.take_token()
            value = self.parse_factor()
            return -value if token == "-" else value
        if token == "[":
            self.take_token()
            value = self.parse_expression()
            if self.take_token() != "]":
                raise MacroExpressionError("a bracket is not closed")
            return value
        if token == "#":
            return self.parameters.read(self.name())
        self.take_token()
        if token and (token[0].isdigit() or token[0] == "."):
            self.refuse_notation(token)
            return float(token)
        if token == "EXISTS":
            if self.take_token() != "[" or self.peek_token() != "#":
                raise MacroExpressionError("EXISTS is written EXISTS[#<name>]")
            name = self.name()
            if self.take_token() != "]":
                raise MacroExpressionError("a bracket is not closed")
            return float(name in self.parameters.values)
        if token == "ATAN":
            y = self.parse_factor()
            if self.take_token() != "/":
                raise MacroExpressionError("ATAN is written ATAN[y]/[x]")
            return math.degrees(math.atan2(y, self.parse_factor()))
        if token in _DEGREES:
            value = self.parse_factor()
            if token in ("FIX", "FUP") and value < 0.0 and value != round(value):
                self.note(f"{token} of a negative number is the next {_WAY[token]} (LinuxCNC); Fanuc counts from zero")
            try:
                return float(_DEGREES[token](value))
            except (ValueError, OverflowError) as problem:
                raise MacroExpressionError(f"{token} has no value there") from problem
        raise MacroExpressionError(f"{token!r} is not supported in an expression")
