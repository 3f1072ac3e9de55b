"""Evaluate the expressions of xacro files without Python's evaluator.

A robot file is untrusted input. An expression of such a file is parsed to a syntax tree; a node is evaluated here only
where its type is listed in this module, and every other node is refused. No Python object with attributes is ever
reachable: values are numbers, text, booleans, None, lists and dictionaries, and functions are instances of
:class:`ExpressionFunction` from a fixed table. Size of the text, depth, numbers, text and containers are bounded, so an
expression needs memory and time in proportion to its file.

``eval`` with reduced names is not enough: ``(lambda: x.__class__)()`` hides names in a nested code object, and
libraries that restrict ``eval`` have been left by the same ways repeatedly.
"""

from __future__ import annotations

import ast
import operator
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

MAX_TEXT = 20_000  # characters of a value
MAX_ITEMS = 20_000  # numbers, texts and containers inside one value; joint limits of a robot have some hundred
MAX_EXPRESSION = 4_000  # characters of an expression; a long one of a public robot has 300
MAX_DEPTH = 60  # nodes in nodes
MAX_BITS = 512  # of an integer: far beyond any length or angle
_FIELD = re.compile(r"%[-+ #0]*[0-9]{0,2}(?:\.[0-9]{0,2})?[diouxXeEfFgGsrc%]")


class XacroExpressionError(ValueError):
    """An expression that is not evaluated: what was found in it."""


class SymbolTable(Protocol):
    """Values by name, as the tables of xacro are."""

    def __getitem__(self, name: str, /) -> object: ...


@dataclass
class EvaluationBudget:
    """Work that may still be done: nodes evaluated and parts of values made. Shared by all expressions of a robot."""

    left: int = 2_000_000  # about a second; a large public robot needs 100,000

    def spend(self, parts: int) -> None:
        """Reduce the remaining evaluation work.

        Args:
            parts: Amount of work.

        Raises:
            XacroExpressionError: the budget is used up.
        """
        self.left -= parts
        if self.left < 0:
            raise XacroExpressionError("takes more work than any robot; its macros or loops grow without bound")


@dataclass(frozen=True)
class ExpressionFunction:
    """A function that expressions may call; its result is checked against the bounds."""

    name: str
    call: Callable[..., object]


class FunctionTable(dict[str, object]):
    """Functions and constants by name: the part before the dot of ``math.sin``."""


@dataclass(frozen=True)
class _ListedMethod:
    """A method of a text, list or dictionary that is listed in :data:`METHODS`."""

    owner: object
    name: str


METHODS: Mapping[type, tuple[str, ...]] = {
    str: (
        *("lower", "upper", "title", "strip", "lstrip", "rstrip", "split", "join", "replace"),
        *("startswith", "endswith", "find", "count", "isdigit"),
    ),
    dict: ("get", "keys", "values", "items"),
    list: ("index", "count"),
}
_BINARY: Mapping[type, Callable[[Any, Any], object]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
_UNARY: Mapping[type, Callable[[Any], object]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
}
_COMPARE: Mapping[type, Callable[[Any, Any], object]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in _check_container(b),
    ast.NotIn: lambda a, b: a not in _check_container(b),
}
_FAILURES = (TypeError, ValueError, ArithmeticError, LookupError, AttributeError, RecursionError, MemoryError)


def evaluate_expression(text: str, symbols: SymbolTable, budget: EvaluationBudget | None = None) -> object:
    """Return the value of an expression.

    Args:
        text: between ``${`` and ``}``.
        symbols: values and functions by name.
        budget: of the whole file; one of its own where none is given.

    Raises:
        XacroExpressionError: no expression, an unsupported construct, a bound exceeded, or a value of a wrong type.
    """
    text = text.strip()
    if len(text) > MAX_EXPRESSION:
        raise XacroExpressionError(f"has {len(text)} characters; at most {MAX_EXPRESSION} are evaluated")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of unknown escapes in texts
            tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError) as problem:
        raise XacroExpressionError(f"is no expression: {getattr(problem, 'msg', None) or problem}") from None
    return _ExpressionEvaluator(symbols, budget or EvaluationBudget()).value(tree.body, 0)


class _ExpressionEvaluator:
    def __init__(self, symbols: SymbolTable, budget: EvaluationBudget) -> None:
        self.symbols, self.budget = symbols, budget
        self.nodes: dict[type, Callable[..., object]] = {
            ast.Constant: self.constant,
            ast.Name: self.name,
            ast.BinOp: self.binary,
            ast.UnaryOp: self.unary,
            ast.BoolOp: self.boolean,
            ast.Compare: self.compare,
            ast.IfExp: self.choice,
            ast.Subscript: self.subscript,
            ast.Attribute: self.attribute,
            ast.Call: self.call,
            ast.List: self.items,
            ast.Tuple: self.items,
            ast.Dict: self.dictionary,
        }

    def value(self, node: ast.AST, depth: int) -> object:
        """Value of a node whose type is listed; any other is refused."""
        if depth > MAX_DEPTH:
            raise XacroExpressionError(f"is nested deeper than {MAX_DEPTH} levels")
        self.budget.spend(1)
        found = self.nodes.get(type(node))
        if found is None:
            raise XacroExpressionError(
                f"contains {type(node).__name__}, which is not evaluated; arithmetic, comparisons, a if b else c, "
                "lists, dictionaries and the functions of xacro are"
            )
        try:
            return found(node, depth + 1)
        except XacroExpressionError:
            raise
        except KeyError as problem:
            raise XacroExpressionError(f"has no key {problem}") from None
        except _FAILURES as problem:
            raise XacroExpressionError(str(problem) or type(problem).__name__) from None

    def checked(self, value: object) -> object:
        """A value that was made, counted and within the bounds."""
        self.budget.spend(count_parts(value))
        return value

    def constant(self, node: ast.Constant, _: int) -> object:
        return self.checked(node.value)

    def name(self, node: ast.Name, _: int) -> object:
        try:
            return _check_known_value(self.symbols[_check_plain_name(node.id)])
        except KeyError:
            raise XacroExpressionError(f"name {node.id!r} is not defined") from None

    def binary(self, node: ast.BinOp, depth: int) -> object:
        left, right = self.value(node.left, depth), self.value(node.right, depth)
        call = _BINARY.get(type(node.op))
        if call is None:
            raise XacroExpressionError(f"contains the operator {type(node.op).__name__}, which is not evaluated")
        _check_growth(node.op, left, right)
        return self.checked(call(left, right))

    def unary(self, node: ast.UnaryOp, depth: int) -> object:
        call = _UNARY.get(type(node.op))
        if call is None:
            raise XacroExpressionError(f"contains the operator {type(node.op).__name__}, which is not evaluated")
        return self.checked(call(self.value(node.operand, depth)))

    def boolean(self, node: ast.BoolOp, depth: int) -> object:
        found: object = None
        for part in node.values:
            found = self.value(part, depth)
            if bool(found) == isinstance(node.op, ast.Or):
                break
        return found

    def compare(self, node: ast.Compare, depth: int) -> object:
        left = self.value(node.left, depth)
        for op, part in zip(node.ops, node.comparators, strict=True):
            right = self.value(part, depth)
            if not _COMPARE[type(op)](left, right):
                return False
            left = right
        return True

    def choice(self, node: ast.IfExp, depth: int) -> object:
        return self.value(node.body if self.value(node.test, depth) else node.orelse, depth)

    def subscript(self, node: ast.Subscript, depth: int) -> object:
        owner = self.value(node.value, depth)
        if not isinstance(owner, (str, list, tuple, dict)):
            raise XacroExpressionError(
                f"takes an element of {_name_type(owner)}; a list, a text or a dictionary has elements"
            )
        if isinstance(node.slice, ast.Slice):
            ends: list[Any] = [
                None if end is None else self.value(end, depth)
                for end in (node.slice.lower, node.slice.upper, node.slice.step)
            ]
            return owner[slice(*ends)]
        return owner[self.value(node.slice, depth)]  # type: ignore[index, call-overload]

    def attribute(self, node: ast.Attribute, depth: int) -> object:
        """A member of a function table, an entry of a dictionary or a name space, or a listed method."""
        owner, name = self.value(node.value, depth), _check_plain_name(node.attr)
        if isinstance(owner, Mapping) and name in owner:  # FunctionTable and name spaces of included files too
            return _check_known_value(owner[name])
        if name in METHODS.get(type(owner), ()):
            return _ListedMethod(owner, name)
        raise XacroExpressionError(f"{_name_type(owner)} has no {name!r} that expressions may use")

    def call(self, node: ast.Call, depth: int) -> object:
        called = self.value(node.func, depth)
        if any(isinstance(a, ast.Starred) for a in node.args) or any(k.arg is None for k in node.keywords):
            raise XacroExpressionError("contains unpacked arguments, which are not evaluated")
        args = [self.value(a, depth) for a in node.args]
        named = {_check_plain_name(str(k.arg)): self.value(k.value, depth) for k in node.keywords}
        if isinstance(called, _ListedMethod):
            return self.checked(_call_method(called, args, named))
        if isinstance(called, ExpressionFunction):
            return self.checked(called.call(*args, **named))
        raise XacroExpressionError(f"calls {_name_type(called)}, which is no function")

    def items(self, node: ast.List | ast.Tuple, depth: int) -> object:
        found = [self.value(e, depth) for e in node.elts]
        return self.checked(found if isinstance(node, ast.List) else tuple(found))

    def dictionary(self, node: ast.Dict, depth: int) -> object:
        if any(k is None for k in node.keys):
            raise XacroExpressionError("contains an unpacked dictionary, which is not evaluated")
        keys = [self.value(k, depth) for k in node.keys if k is not None]
        return self.checked(dict(zip(keys, (self.value(v, depth) for v in node.values), strict=True)))


def check_bounds(value: object) -> object:
    """Return a value unchanged; raises as :func:`count_parts` does.

    Args:
        value: Value of an expression.

    Returns:
        The value.
    """
    count_parts(value)
    return value


def count_parts(value: object) -> int:
    """Count the numbers, texts and containers of a value; shared ones count each time they are reached.

    Args:
        value: Value of an expression.

    Returns:
        The count.

    Raises:
        XacroExpressionError: a type that expressions do not have, or a value beyond the bounds of this module.
    """
    parts, open_values = 0, [value]
    while open_values:
        part = open_values.pop()
        parts += 1
        if isinstance(part, str):
            parts += len(part) * MAX_ITEMS // MAX_TEXT
        elif isinstance(part, int):
            if part.bit_length() > MAX_BITS:
                raise XacroExpressionError(
                    f"makes an integer of {part.bit_length()} bits; at most {MAX_BITS} are evaluated"
                )
        elif isinstance(part, dict):
            open_values += [*part.keys(), *part.values()]
        elif isinstance(part, (list, tuple)):
            open_values += part
        elif not (part is None or isinstance(part, (float, ExpressionFunction, _ListedMethod))):
            raise XacroExpressionError(
                f"makes a value of type {_name_type(part)}; numbers, text, lists and dictionaries are evaluated"
            )
        if parts + len(open_values) > MAX_ITEMS:
            raise XacroExpressionError(f"makes a value of more than {MAX_ITEMS} parts or {MAX_TEXT} characters")
    return parts


def _check_growth(op: ast.operator, left: object, right: object) -> None:
    """Refuse a result beyond the bounds before it is computed."""
    if isinstance(op, ast.Pow) and isinstance(left, int) and isinstance(right, int):
        if right > 0 and abs(left) > 1 and left.bit_length() * right > 2 * MAX_BITS:
            raise XacroExpressionError(f"raises to a power of more than {MAX_BITS} bits")
    elif isinstance(op, ast.Mult):
        for row, times in ((left, right), (right, left)):
            if isinstance(row, (str, list, tuple)) and isinstance(times, int) and len(row) * times > MAX_TEXT:
                raise XacroExpressionError(f"repeats to more than {MAX_TEXT} parts")
    elif isinstance(op, ast.Mod) and isinstance(left, str):
        values = right if isinstance(right, tuple) else (right,)
        if _FIELD.sub("", left).count("%") or not all(isinstance(v, (str, int, float)) for v in values):
            raise XacroExpressionError("formats with %, and not numbers or text by plain fields such as %.3f")


def _call_method(method: _ListedMethod, args: list[object], named: dict[str, object]) -> object:
    owner, name = method.owner, method.name
    if named:
        raise XacroExpressionError(f"calls {name} with named arguments, which are not evaluated")
    if isinstance(owner, str) and name == "replace" and len(args) >= 2:
        old, new = args[:2]
        if isinstance(old, str) and isinstance(new, str) and owner.count(old) * len(new) > MAX_TEXT:
            raise XacroExpressionError(f"replaces to more than {MAX_TEXT} characters")
    if isinstance(owner, str) and name == "join" and len(args) == 1:
        parts = _check_container(args[0])
        if (len(parts) + 1) * len(owner) > MAX_TEXT:
            raise XacroExpressionError(f"joins to more than {MAX_TEXT} characters")
    found: object = getattr(owner, name)(*args)
    if isinstance(owner, dict) and name != "get":
        return [list(f) if isinstance(f, tuple) else f for f in found]  # type: ignore[attr-defined]
    return found


def _check_known_value(value: object) -> object:
    """A value of a symbol table; one of another type than those of expressions is refused."""
    if value is None or isinstance(value, (bool, int, float, str, list, tuple, Mapping, ExpressionFunction)):
        return value
    raise XacroExpressionError(f"uses a value of type {_name_type(value)}, which expressions have not")


def _check_container(value: object) -> str | list[object] | tuple[object, ...] | dict[object, object]:
    if not isinstance(value, (str, list, tuple, dict)):
        raise XacroExpressionError(
            f"looks for an element in {_name_type(value)}; a list, a text or a dictionary has elements"
        )
    return value


def _check_plain_name(name: str) -> str:
    """A name without leading underscores: no name of Python's own machinery is ever looked up."""
    if name.startswith("_"):
        raise XacroExpressionError(f"uses the name {name!r}; names with a leading underscore are not evaluated")
    return name


def _name_type(value: object) -> str:
    return "a dictionary" if isinstance(value, Mapping) else type(value).__name__
