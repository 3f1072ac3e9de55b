"""KRL values: numbers, enumerations, aggregates ``{X 1,Y 2}``, variables and arrays of them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from machopt.programs.reading.move_attributes import parse_number

Aggregate = dict[str, object]
Value = object  # float, str (enumeration, text), Aggregate, or None: declared, value not known
MOST_DEPTH = 8

_PAIR = re.compile(r"\s*([A-Za-z_]\w*)(?:\[[0-9]*\])?\s+(.+?)\s*$")
_NAME = re.compile(r"\s*(\$?[A-Za-z_][\w$]*)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*((?:\.\s*[A-Za-z_]\w*)*)\s*$")


class KrlValueError(ValueError):
    """A value that cannot be had; the reader adds file and line."""


@dataclass
class KrlMemory:
    """Variables by upper-case name; arrays as values by index."""

    plain: dict[str, Value] = field(default_factory=dict)
    arrays: dict[str, dict[int, Value]] = field(default_factory=dict)

    def get(self, name: str, index: int | None, fields: list[str]) -> Value:
        """Return the value of ``name[index].field…``.

        Args:
            name: Name of the variable.
            index: Index of an array element, None where there is none.
            fields: Names of nested components.

        Returns:
            The value.

        Raises:
            KrlValueError: it is not declared, or has no value.
        """
        value: Value
        if index is not None:
            if name not in self.arrays:
                raise KrlValueError(
                    f"{name}[] is declared in none of the files read; its .dat must be in the folder of the program"
                )
            if index not in self.arrays[name]:
                raise KrlValueError(f"{name}[{index}] has no value")
            value = self.arrays[name][index]
        else:
            if name not in self.plain:
                raise KrlValueError(
                    f"{name} is declared in none of the files read; its .dat must be in the folder of the program"
                )
            value = self.plain[name]
        for word in fields:
            if not isinstance(value, dict) or word not in value:
                raise KrlValueError(f"{name} has no component {word}")
            value = value[word]
        if value is None:
            raise KrlValueError(f"{name} gets its value only while the robot runs: its points cannot be known here")
        return value

    def put(self, name: str, index: int | None, fields: list[str], value: Value) -> None:
        """Assign a value; components of an aggregate change in a copy, as in KRL.

        Args:
            name: Name of the variable.
            index: Index of an array element, None where there is none.
            fields: Names of nested components.
            value: The new value.

        Raises:
            KrlValueError: the variable is not declared.
        """
        store: dict[str, Value] | dict[int, Value]
        key: str | int
        if index is None:
            store, key = self.plain, name
        else:
            store, key = self.arrays.setdefault(name, {}), index
        if not fields:
            store[key] = value  # type: ignore[index]
            return
        if key not in store and not name.startswith("$"):
            raise KrlValueError(
                f"{name} is declared in none of the files read; its .dat must be in the folder of the program"
            )
        old = store.get(key)  # type: ignore[arg-type]
        changed: Aggregate = dict(old) if isinstance(old, dict) else {}
        inner = changed
        for word in fields[:-1]:
            deeper = inner.get(word)
            inner[word] = dict(deeper) if isinstance(deeper, dict) else {}
            inner = inner[word]  # type: ignore[assignment]
        inner[fields[-1]] = value
        store[key] = changed  # type: ignore[index]


def split_variable_name(text: str, memory: KrlMemory) -> tuple[str, int | None, list[str]] | None:
    """Split ``NAME[i].X`` into name, index and components.

    Args:
        text: Text of the expression.
        memory: Values of the declared variables.

    Returns:
        The parts, None where the text is no variable.
    """
    found = _NAME.match(text)
    if found is None:
        return None
    index = None
    if found.group(2) is not None:
        if not found.group(2):
            return None
        index = evaluate_whole_number(found.group(2), memory)
    fields = [w.strip().upper() for w in found.group(3).split(".") if w.strip()]
    return found.group(1).upper(), index, fields


def evaluate_whole_number(text: str, memory: KrlMemory) -> int:
    """Evaluate an integer from a constant or a variable.

    Args:
        text: Text of the expression.
        memory: Values of the declared variables.

    Returns:
        The integer.

    Raises:
        KrlValueError: the value is no integer.
    """
    value = evaluate_expression(text, memory)
    if not isinstance(value, float) or value != int(value) or abs(value) > 1e9:
        raise KrlValueError(f"{text.strip()[:30]!r} is no whole number")
    return int(value)


def evaluate_expression(text: str, memory: KrlMemory, depth: int = 0) -> Value:
    """Evaluate a constant, an aggregate or a variable; formulas are not evaluated.

    Args:
        text: Text of the expression.
        memory: Values of the declared variables.
        depth: Depth of nested aggregates.

    Returns:
        The value.

    Raises:
        KrlValueError: another expression, or a variable without a value.
    """
    text = text.strip()
    plain = parse_number(text)
    if plain is not None:
        return plain
    if not text or depth > MOST_DEPTH:
        raise KrlValueError("a value is missing")
    if text[0] == "{" and text[-1] == "}":
        return _parse_aggregate(text[1:-1], memory, depth)
    if text[0] == "#" or text[0] == '"' or text.upper() in ("TRUE", "FALSE"):
        return text.upper() if text[0] != '"' else text
    name = split_variable_name(text, memory)
    if name is None:
        raise KrlValueError(f"{text[:40]!r}: formulas are not evaluated; expand the program first")
    return memory.get(*name)


def parse_plain_aggregate(text: str) -> Aggregate | None:
    """Parse ``{X 1.5,Y -2}`` in one step.

    Args:
        text: Text of the expression.

    Returns:
        Component → number; None where the text holds anything but different components with numbers.
    """
    out: Aggregate = {}
    items = text[1:-1].split(",")
    for item in items:
        pair = item.split()
        if len(pair) != 2 or not (pair[0].isascii() and pair[0].isalnum() and pair[0][0].isalpha()):
            return None
        value = parse_number(pair[1])
        if value is None:
            return None
        out[pair[0].upper()] = value
    return out if len(out) == len(items) else None


def _parse_aggregate(inner: str, memory: KrlMemory, depth: int) -> Aggregate:
    head, colon, rest = inner.partition(":")
    if colon and re.fullmatch(r"\s*[A-Za-z_]\w*\s*", head):
        inner = rest
    out: Aggregate = {}
    for item in _split_at_commas(inner):
        pair = _PAIR.match(item)
        if pair is None:
            raise KrlValueError(
                f"{item.strip()[:30]!r} in an aggregate; expected a component and its value, such as X 10.5"
            )
        word = pair.group(1).upper()
        if word in out:
            raise KrlValueError(f"component {word} is given twice")
        out[word] = evaluate_expression(pair.group(2), memory, depth + 1)
    return out


def _split_at_commas(text: str) -> list[str]:
    """At commas outside of inner braces."""
    if "{" not in text:
        return text.split(",") if text.strip() else []
    out, depth, start = [], 0, 0
    for k, c in enumerate(text):
        depth += (c == "{") - (c == "}")
        if c == "," and depth == 0:
            out.append(text[start:k])
            start = k + 1
    return [*out, text[start:]]


def try_evaluate(text: str, memory: KrlMemory) -> Value:
    """Evaluate an expression if possible; its value may never be needed.

    Args:
        text: Text of the expression.
        memory: Values of the declared variables.

    Returns:
        The value, None where it cannot be evaluated.
    """
    try:
        return evaluate_expression(text, memory)
    except KrlValueError:
        return None
