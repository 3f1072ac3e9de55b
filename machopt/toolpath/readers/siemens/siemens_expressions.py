"""Expressions of Sinumerik programs (``R1+R2*SIN(R3)``, comparisons, variables), evaluated completely or refused."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from machopt.file_formats.expression_parser import RecursiveDescentParser
from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError
from machopt.toolpath.readers.siemens.variable_types import (
    compute_remainder,
    convert_to_type,
    round_away,
    round_half_up,
)

_RADIANS = math.radians
_FUNCTIONS: dict[str, tuple[int, Callable[..., float]]] = {  # name → (arguments, function); angles in degrees
    "SIN": (1, lambda v: math.sin(_RADIANS(v))),
    "COS": (1, lambda v: math.cos(_RADIANS(v))),
    "TAN": (1, lambda v: math.tan(_RADIANS(v))),
    "ASIN": (1, lambda v: math.degrees(math.asin(v))),
    "ACOS": (1, lambda v: math.degrees(math.acos(v))),
    "ATAN2": (2, lambda y, x: math.degrees(math.atan2(y, x))),
    "SQRT": (1, math.sqrt),
    "ABS": (1, abs),
    "POT": (1, lambda v: v * v),
    "TRUNC": (1, math.trunc),
    "ROUND": (1, round_half_up),
    "ROUNDUP": (1, round_away),
    "LN": (1, math.log),
    "EXP": (1, math.exp),
    "MINVAL": (2, min),
    "MAXVAL": (2, max),
    "BOUND": (3, lambda low, high, v: min(max(v, low), high)),
}
_LEVELS: tuple[dict[str, Callable[[float, float], float]], ...] = (  # weakest first
    {"OR": lambda a, b: float(bool(a) or bool(b)), "XOR": lambda a, b: float(bool(a) != bool(b))},
    {"AND": lambda a, b: float(bool(a) and bool(b))},
    {
        "==": lambda a, b: float(abs(a - b) <= 1e-12 * max(abs(a), abs(b), 1.0)),
        "<>": lambda a, b: float(abs(a - b) > 1e-12 * max(abs(a), abs(b), 1.0)),
        "<": lambda a, b: float(a < b),
        ">": lambda a, b: float(a > b),
        "<=": lambda a, b: float(a <= b),
        ">=": lambda a, b: float(a >= b),
    },
    {"+": lambda a, b: a + b, "-": lambda a, b: a - b},
    {
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "DIV": lambda a, b: float(math.trunc(a / b)),
        "MOD": compute_remainder,
    },
    {"^": lambda a, b: a**b},  # Heidenhain
)
VARIABLE = r"[A-Z_]\w*(?:\s*\[(?:[^][\"=]|\[[^][\"=]*\])*\])?"  # that is assigned; an index may hold another one
Values = dict[str, float]
Expression = Callable[[Values], float]


class SiemensVariables:
    """R parameters and variables of a program; one that is read before it is set is an error."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {"TRUE": 1.0, "FALSE": 0.0, "$PI": math.pi}
        self.types: dict[str, str] = {}  # name without index → type; R parameters and undefined names are REAL
        self._read: dict[tuple[str, int], tuple[Expression, int]] = {}  # parsed once, evaluated often

    def assign(self, name: str, value: float) -> None:
        """Assign a value, converted to the type of the variable.

        Args:
            name: Name of the variable, with its index where it is an element of an array.
            value: The value.

        Raises:
            MacroExpressionError: the type does not hold the value, or the array has no such element.
        """
        base, index, _ = name.partition("[")
        kind = self.types.get(base)
        if kind is not None and index and name not in self.values:
            raise MacroExpressionError(f"{name} is no element of the array {base}")
        self.values[name] = value if kind is None else convert_to_type(value, kind, name)

    def name_of(self, text: str) -> str:
        """Return the name of a variable that is assigned; an index is evaluated, and ``R[5]`` is R5.

        Args:
            text: Name, with the expression of its index in brackets where it has one.

        Raises:
            MacroExpressionError: the index has no value, or is no whole number.
        """
        base, bracket, index = text.partition("[")
        return name_element(base.strip(), self.value(index.rstrip()[:-1])) if bracket else base.strip()

    def value(self, text: str) -> float:
        """Evaluate one expression.

        Args:
            text: Text of the expression.

        Returns:
            The value.

        Raises:
            MacroExpressionError: it has no value, or text follows the expression.
        """
        value, at = self.part(text, 0)
        if text[at:].strip():
            raise MacroExpressionError(f"found {text[at:].strip()[:20]!r} after an expression")
        return value

    def part(self, text: str, at: int) -> tuple[float, int]:
        """Evaluate the expression that begins at an index.

        Args:
            text: Text of the expression.
            at: Index at which the expression begins.

        Returns:
            The value, and the index behind the expression.

        Raises:
            MacroExpressionError: it has no value.
        """
        expression, end = self._parse_cached(text, at)
        try:
            value = expression(self.values)
        except (ZeroDivisionError, ValueError, OverflowError) as problem:
            if isinstance(problem, MacroExpressionError):
                raise
            raise MacroExpressionError(f"an expression has no value there: {problem}") from problem
        if not math.isfinite(value) or abs(value) > 1e12:
            raise MacroExpressionError(f"an expression gives {value}")
        return value, end

    def end_of(self, text: str, at: int) -> int:
        """Find the end of the expression that begins at an index.

        Args:
            text: Text of the expression.
            at: Index at which the expression begins.

        Returns:
            Index behind the expression.
        """
        return self._parse_cached(text, at)[1]

    def _parse_cached(self, text: str, at: int) -> tuple[Expression, int]:
        found = self._read.get((text, at))
        if found is None:
            parser = _SiemensParser(text, at)
            found = self._read[text, at] = (parser.parse_expression(), parser.at)
        return found


class _SiemensParser(RecursiveDescentParser[Expression]):
    """Into functions of the variables."""

    token = re.compile(
        r"\s*([0-9]+\.?[0-9]*(?:EX[-+]?[0-9]+)?|\.[0-9]+|==|<>|>=|<=|<<|[-+*/^()\[\],<>=]|\$?[A-Z_][A-Z0-9_]*)"
    )
    levels = _LEVELS
    problem = MacroExpressionError

    def combine_operands(
        self, operator: Callable[[float, float], float], expression: Expression, right: Expression
    ) -> Expression:
        return lambda values: float(operator(expression(values), right(values)))

    def parse_atom(self) -> Expression:
        token = self.take_token()
        if token in ("+", "-", "NOT"):
            inner = self.parse_factor()
            if token == "+":
                return inner
            return (lambda v: -inner(v)) if token == "-" else (lambda v: float(not inner(v)))
        if token == "(":
            inner = self.parse_expression()
            if self.take_token() != ")":
                raise MacroExpressionError("a bracket is not closed")
            return inner
        if token[0].isdigit() or token[0] == ".":
            self.refuse_notation(token)
            number = float(token.replace("EX", "E"))
            return lambda _: number
        if token in _FUNCTIONS and self.peek_token() == "(":
            return self.call(token)
        if self.peek_token() == "[":
            return self._parse_element(token)
        return lambda values: _get_value(values, token)

    def _parse_element(self, base: str) -> Expression:
        """Parse ``[index]`` behind a name; an index of a variable of the control is passed over."""
        self.take_token()
        if base.startswith("$"):
            self.at = _find_index_end(self.text, self.at)
            return lambda values: _get_value(values, base)
        index = self.parse_expression()
        if (token := self.peek_token()) != "]":
            raise MacroExpressionError(
                f"{base}[…]: arrays of two and more dimensions are not followed"
                if token == ","
                else f"the bracket behind {base} is not closed"
            )
        self.take_token()
        return lambda values: _get_value(values, name_element(base, index(values)))

    def call(self, name: str) -> Expression:
        count, function = _FUNCTIONS[name]
        self.take_token()
        inner = [self.parse_expression()]
        while self.peek_token() == ",":
            self.take_token()
            inner.append(self.parse_expression())
        if self.take_token() != ")" or len(inner) != count:
            raise MacroExpressionError(f"{name} takes {count} values in brackets")
        return lambda values: float(function(*[f(values) for f in inner]))


def name_element(base: str, index: float) -> str:
    """Return the name of an element of an array; ``R[5]`` is R5.

    Args:
        base: Name of the array.
        index: Value of its index.

    Raises:
        MacroExpressionError: the index is negative or no whole number.
    """
    if not (index >= 0.0 and index == round(index)):
        raise MacroExpressionError(f"{base}[{index:g}]: expected a whole number from zero as index")
    return f"R{index:.0f}" if base == "R" else f"{base}[{index:.0f}]"


def _find_index_end(text: str, at: int) -> int:
    """Index behind the bracket that closes the one before ``at``; the end of the text where none does."""
    depth = 1
    while at < len(text) and depth:
        depth += (text[at] == "[") - (text[at] == "]")
        at += 1
    return at


def _get_value(values: Values, name: str) -> float:
    try:
        return values[name]
    except KeyError:
        if name in ("SET", "REP"):
            raise MacroExpressionError(f"{name}(…) is followed in DEF only; assign each element") from None
        base, bracket, _ = name.partition("[")
        if bracket and f"{base}[0]" in values:
            raise MacroExpressionError(f"{name} is no element of the array {base}") from None
        if name.startswith("$"):
            raise MacroExpressionError(f"{name} is a variable of the control; its value is not in the file") from None
        raise MacroExpressionError(f"{name} is read before it is set") from None
