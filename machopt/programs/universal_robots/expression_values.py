"""URScript values: numbers, lists, poses, ``pose_trans`` and arithmetic of numbers; nothing is executed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import add, mul, sub

import numpy as np

from machopt.file_formats.expression_parser import RecursiveDescentParser
from machopt.numerics.array_types import Array
from machopt.programs.reading.move_attributes import parse_number
from machopt.programs.reading.rotation_conventions import Rows, build_pose_matrix, convert_rotation_vector

MOST_DEPTH = 30  # brackets inside each other
_SIGNED = re.compile(r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\s*")
FARTHEST_TURN = 1e4  # rad of a rotation vector


class ScriptValueError(ValueError):
    """What cannot be read; the reader adds file and line."""


@dataclass(frozen=True)
class UnknownValue:
    """A value that only the running robot knows."""

    text: str


@dataclass(frozen=True)
class ScriptPose:
    """p[…], or pose_trans of a named frame and p[…]: then in that frame."""

    position: tuple[float, float, float]  # m
    rows: Rows
    base: str = "base"
    base_matrix: Array | None = None


def evaluate_expression(text: str, memory: Mapping[str, object], quietly: bool = False) -> object:
    """Evaluate an expression.

    Args:
        text: Text of the expression or of the arguments.
        memory: Variable → value.
        quietly: Whether a value that cannot be evaluated becomes :class:`UnknownValue` instead of an error.

    Returns:
        The value.

    Raises:
        ScriptValueError: it cannot be evaluated, and not ``quietly``.
    """
    try:
        plain = _parse_plain_value(text)
        if plain is not None:
            return plain
        parser = _ScriptParser(text, memory)
        value = parser.parse_expression()
        if parser.peek_token():
            raise ScriptValueError(f"found {parser.peek_token()[:20]!r} behind a value")
        return value
    except ScriptValueError:
        if quietly:
            return UnknownValue(text[:40])
        raise


def _parse_plain_value(text: str) -> float | list[object] | ScriptPose | None:
    """A number, or a list or a pose of numbers, at once: nearly all there is in a program of thousands of moves.

    Raises:
        ScriptValueError: a pose that is none.
    """
    text = text.strip()
    if not text.endswith("]"):
        return parse_number(text) if _SIGNED.fullmatch(text) else None
    pose = text.startswith("p[")
    if not pose and not text.startswith("["):
        return None
    values: list[object] = []
    for item in text[1 + pose : -1].split(","):
        value = parse_number(item) if _SIGNED.fullmatch(item) else None
        if value is None:
            return None
        values.append(value)
    return _build_pose(values) if pose else values


def parse_arguments(
    text: str, memory: Mapping[str, object], quietly: bool = False
) -> tuple[list[object], dict[str, object]]:
    """Evaluate the arguments of a call.

    Args:
        text: Text of the expression or of the arguments.
        memory: Variable → value.
        quietly: Whether a value that cannot be evaluated becomes :class:`UnknownValue` instead of an error.

    Returns:
        Positional arguments, and named arguments.

    Raises:
        ScriptValueError: one cannot be evaluated, and not ``quietly``.
    """
    values: list[object] = []
    named: dict[str, object] = {}
    for part in _split_at_commas(text):
        found = re.match(r"\s*([A-Za-z_]\w*)\s*=(?!=)(.*)", part, re.DOTALL)
        if found:
            named[found.group(1)] = evaluate_expression(found.group(2), memory, quietly)
        else:
            values.append(evaluate_expression(part, memory, quietly))
    return values, named


def _compute_quotient(left: float, right: float) -> float:
    if right == 0.0:
        raise ScriptValueError("division by zero")
    return left / right


class _ScriptParser(RecursiveDescentParser[object]):
    """Evaluates while it reads; operators join numbers only."""

    token = re.compile(
        r'\s*([0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?|\.[0-9]+(?:[eE][-+]?[0-9]+)?|[A-Za-z_]\w*|"[^"]*"?|\S)'
    )
    levels = ({"+": add, "-": sub}, {"*": mul, "/": _compute_quotient})
    problem = ScriptValueError
    most_depth = MOST_DEPTH + 1

    def __init__(self, text: str, memory: Mapping[str, object]) -> None:
        super().__init__(text)
        self.memory = memory

    def combine_operands(self, operator: Callable[[float, float], float], left: object, right: object) -> object:
        return float(operator(_check_number(left), _check_number(right)))

    def expect(self, text: str) -> None:
        if self.peek_token() != text:
            raise ScriptValueError(f"found {self.peek_token()[:20] or 'the end'!r}; expected {text!r}")
        self.take_token()

    def parse_atom(self) -> object:
        text = self.peek_token()
        if not text:
            raise ScriptValueError("found 'the end'; expected 'a value'")
        self.take_token()
        if text in ("-", "+"):
            value = _check_number(self.parse_factor())
            return -value if text == "-" else value
        if text[0].isdecimal() or (text[0] == "." and len(text) > 1):
            known = parse_number(text)
            if known is None:
                raise ScriptValueError(f"{text[:20]!r} is no number")
            return known
        if text[0] == '"':
            return text
        if text == "(":
            inner = self.parse_expression()
            self.expect(")")
            return inner
        if text == "[":
            return self.list("]")
        if text[0] == "_" or (text[0].isascii() and text[0].isalpha()):
            return self.name(text)
        raise ScriptValueError(f"found {text[:20]!r}; expected a value")

    def list(self, end: str) -> list[object]:
        out: list[object] = []
        while self.peek_token() != end:
            out.append(self.parse_expression())
            if self.peek_token() == ",":
                self.take_token()
            elif self.peek_token() != end:
                raise ScriptValueError(
                    f"found {self.peek_token()[:20] or 'the end'!r} in a list; expected a comma or {end}"
                )
        self.expect(end)
        return out

    def name(self, name: str) -> object:
        if name == "p" and self.peek_token() == "[":
            self.take_token()
            return _build_pose(self.list("]"))
        if self.peek_token() == "(":
            self.take_token()
            first = self.peek_token()
            return _call_function(name, self.list(")"), first)
        if name not in self.memory:
            raise ScriptValueError(f"{name} is not set before it is used")
        value = self.memory[name]
        if isinstance(value, UnknownValue):
            raise ScriptValueError(f"{name} = {value.text}: known only while the robot runs")
        if self.peek_token() == "[":
            self.take_token()
            index = self.list("]")
            if not (
                isinstance(value, list)
                and len(index) == 1
                and isinstance(index[0], float)
                and 0 <= index[0] < len(value)
            ):
                raise ScriptValueError(f"{name} has no such element")
            return value[int(index[0])]
        return value


def _call_function(name: str, values: list[object], first: str) -> object:
    if name == "d2r" and len(values) == 1:
        return math.radians(_check_number(values[0]))
    if name == "pose_trans" and len(values) == 2:
        frame, pose = values
        if isinstance(frame, ScriptPose) and isinstance(pose, ScriptPose):
            outer = build_pose_matrix(frame.rows, *frame.position)
            outer = outer if frame.base_matrix is None else frame.base_matrix @ outer
            if pose.base_matrix is not None:
                raise ScriptValueError("pose_trans inside pose_trans is not read; one named frame would work")
            named = re.fullmatch(r"[A-Za-z_]\w*", first) and first != "p"
            return ScriptPose(pose.position, pose.rows, first if named else "frame", np.asarray(outer))
    raise ScriptValueError(f"{name}(…) is known only while the robot runs")


def _build_pose(values: list[object]) -> ScriptPose:
    if len(values) != 6:
        raise ScriptValueError(f"a pose of {len(values)} numbers; expected p[x,y,z,rx,ry,rz]")
    x, y, z, rx, ry, rz = (_check_number(v) for v in values)
    if max(abs(rx), abs(ry), abs(rz)) > FARTHEST_TURN:
        raise ScriptValueError("a rotation vector longer than any turn")
    return ScriptPose((x, y, z), convert_rotation_vector(rx, ry, rz))


def _check_number(value: object) -> float:
    if not isinstance(value, float) or not math.isfinite(value):
        raise ScriptValueError("found something else where a number is expected")
    return value


def _split_at_commas(text: str) -> list[str]:
    """At commas outside of brackets and quotes."""
    out, depth, start, quoted = [], 0, 0, False
    for k, c in enumerate(text):
        quoted ^= c == '"'
        if quoted:
            continue
        depth += (c in "([") - (c in ")]")
        if c == "," and depth == 0:
            out.append(text[start:k])
            start = k + 1
    return [*out, text[start:]] if text.strip() else []
