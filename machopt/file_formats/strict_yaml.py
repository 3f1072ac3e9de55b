"""Strict YAML 1.2 reader: core-schema scalars, no duplicate keys, no NaN, every error with line and key.

ruamel.yaml parses the text into nodes; the scalars are resolved here by the YAML 1.2 core schema (section
10.3.2 of the specification): ``1e-3`` is a number, ``no`` a word, ``010`` ten, whatever the file's header says.
"""

from __future__ import annotations

import math
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from machopt.errors import ConfigurationKeyError, FileFormatError, InputError, suggest_nearest_word
from machopt.file_formats.file_reading import YAML, read_text
from machopt.file_formats.yaml_composition import ComposedText, compose_text

KeyPath = tuple[str | int, ...]
M = TypeVar("M", bound=BaseModel)

_INT = re.compile(r"[-+]?[0-9]+")
_OCT_HEX = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
_CONSTANTS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_MAX_NODES = 500_000  # an alias bomb expands beyond any real cell or stiffness grid
_SHORT_TEXT = 20_000  # characters of a text whose nodes are kept, some MB
_MAX_INT = 2**63
_TOO_DEEP = "MaxDepthExceededError"  # error of ruamel.yaml that older versions lack
_SHOWN_PROBLEMS = 4
_DEEPEST = 2  # levels of keys that are searched for a misplaced one


class StrictSchema(BaseModel):
    """Base of every file schema: unknown keys, coerced types and non-finite numbers are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)
    HINTS: typing.ClassVar[dict[str, str]] = {}  # keys that others would write here, and what to do instead


@dataclass(frozen=True)
class YamlDocument:
    """A parsed YAML file: plain dicts, lists and scalars, and the line of each of them."""

    value: object
    lines: dict[KeyPath, int]
    file: Path | str

    def locate_key(self, loc: KeyPath) -> str:
        """Format the location of a key: ``line 12: robot.limits.velocity_deg_s[2]``.

        Args:
            loc: Key path of the value in the document.

        Returns:
            The location; the line is that of the nearest enclosing key that exists.
        """
        line = next((f"line {self.lines[loc[:n]]}" for n in range(len(loc), 0, -1) if loc[:n] in self.lines), None)
        return ": ".join(p for p in (line, format_key_path(loc)) if p)

    def build_error(self, loc: KeyPath, message: str) -> ConfigurationKeyError:
        """Build a :class:`ConfigurationKeyError` located at a key.

        Args:
            loc: Key path of the value in the document.
            message: Description of the error.

        Returns:
            The error, not raised.
        """
        return ConfigurationKeyError(
            message, file=self.file, where=self.locate_key(loc) or None, key=format_key_path(loc)
        )


def read_yaml(path: Path) -> YamlDocument:
    """Parse one YAML 1.2 file.

    Args:
        path: Path of the file.

    Returns:
        The document.

    Raises:
        InputError: missing or unreadable file, not UTF-8, not YAML, a duplicate key, a non-finite number.
    """
    return parse_yaml(read_text(path, expected="a YAML file", most=YAML), path)


def parse_yaml(text: str, file: Path | str) -> YamlDocument:
    """Parse YAML 1.2 text.

    Args:
        text: Text of the file.
        file: Name of the file, for messages.

    Returns:
        The document.

    Raises:
        FileFormatError: not YAML, a duplicate key, a non-finite number.
    """
    from ruamel.yaml.error import YAMLError

    try:
        composed = (_compose_short_text if len(text) <= _SHORT_TEXT else compose_text)(text)
    except RecursionError:
        raise FileFormatError("is nested too deeply", file=file) from None
    except YAMLError as err:
        if type(err).__name__ == _TOO_DEEP:
            raise FileFormatError("is nested too deeply", file=file) from None
        mark = getattr(err, "problem_mark", None)
        where = f"line {mark.line + 1}, column {mark.column + 1}" if mark else None
        words = [w for w in (getattr(err, "context", None), getattr(err, "problem", None)) if w]
        raise FileFormatError(f"is not YAML: {', '.join(words) or err}", file=file, where=where) from None
    builder = _YamlValueBuilder(composed, file)
    value = None if composed.node is None else builder.build(composed.node, (), ())
    return YamlDocument(value, builder.lines, file)


# A run reads many files twice: as it writes them and as it checks them. The nodes are only read, values are built anew.
_compose_short_text = lru_cache(maxsize=64)(compose_text)


def validate_document(model: type[M], document: YamlDocument, prefix: KeyPath = ()) -> M:
    """Check a document against a schema.

    Args:
        model: the schema.
        document: what was read.
        prefix: key path put before the schema's own in messages.

    Raises:
        InputError: names file, line, key, what was found and what was expected; the first few problems.
    """
    if document.value is None:
        raise document.build_error(prefix, f"is empty; expected a mapping with {_list_schema_keys(model)}")
    try:
        return model.model_validate(document.value)
    except ValidationError as err:
        problems = _list_error_messages(model, err)
    (loc, text), rest = problems[0], problems[1:]
    for other, message in rest[: _SHOWN_PROBLEMS - 1]:
        text += f"\n  {document.locate_key(prefix + other)}: {message}"
    if len(rest) >= _SHOWN_PROBLEMS:
        text += f"\n  and {len(rest) - _SHOWN_PROBLEMS + 1} more"
    raise document.build_error(prefix + loc, text)


def list_schema_errors(model: type[BaseModel], document: YamlDocument) -> list[tuple[KeyPath, str]]:
    """List everything in a document that its schema refuses.

    Args:
        model: Schema as a pydantic model.
        document: Parsed YAML file, with the line of each key for errors.

    Returns:
        Key path and message of each error; empty where the document is accepted.
    """
    try:
        model.model_validate(document.value)
    except ValidationError as err:
        return _list_error_messages(model, err)
    return []


def _list_error_messages(model: type[BaseModel], err: ValidationError) -> list[tuple[KeyPath, str]]:
    # an unknown key first: the missing key is often the same one, misspelt
    found = sorted(err.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    return [_describe_error(model, e) for e in found]


def format_key_path(loc: KeyPath) -> str:
    """Format a key path: ``robot.limits.velocity_deg_s[2]``.

    Args:
        loc: Key path of the value in the document.

    Returns:
        The text.
    """
    out = ""
    for part in loc:
        out += f"[{part}]" if isinstance(part, int) else f".{part}" if out else part
    return out


def format_found_value(value: object) -> str:
    """Format a found value as the user wrote it, shortened.

    Args:
        value: The value.

    Returns:
        The text.
    """
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"the text {value[:60]!r}"
    if isinstance(value, dict):
        return f"a mapping with {', '.join(map(str, value)) or 'no keys'}"
    if isinstance(value, list):
        inner = ", ".join(format_found_value(v) for v in value) if len(value) <= 8 and not _is_nested(value) else "…"
        return f"a list of {len(value)} ([{inner}])"
    return str(value)


class _YamlValueBuilder:
    """Plain Python values from ruamel's nodes."""

    def __init__(self, composed: ComposedText, file: Path | str) -> None:
        self.composed, self.file, self.lines, self.count = composed, file, dict[KeyPath, int](), 0

    def build(self, node: typing.Any, loc: KeyPath, parents: tuple[int, ...]) -> object:
        from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

        line = node.start_mark.line + 1
        self.lines.setdefault(loc, line)
        self.count += 1
        if id(node) in parents or self.count > _MAX_NODES:
            raise self.error(line, loc, "an alias that contains itself, or too many values")
        if not str(node.tag).startswith("tag:yaml.org,2002:"):
            raise self.error(line, loc, f"tag {node.tag} is not accepted; plain values would work")
        inside = (*parents, id(node))
        if isinstance(node, ScalarNode):
            row = self.composed.find_row(node)
            return (
                self.scalar(node.value, node.style, line, loc)
                if row is None
                else self.row(row, node.end_mark.line + 1, loc)
            )
        if isinstance(node, SequenceNode):
            return [self.build(child, (*loc, n), inside) for n, child in enumerate(node.value)]
        assert isinstance(node, MappingNode)  # ruamel knows three kinds of node
        out: dict[str, object] = {}
        for key_node, child in node.value:
            key_line = key_node.start_mark.line + 1
            key = key_node.value
            if not isinstance(key_node, ScalarNode):
                raise self.error(key_line, loc, "a key must be a word")
            if key in out:
                first = self.lines[(*loc, key)]
                raise self.error(key_line, (*loc, key), f"key is given twice, first in line {first}; keep one")
            self.lines[(*loc, key)] = key_line
            out[key] = self.build(child, (*loc, key), inside)
        return out

    def row(self, words: tuple[tuple[str, int], ...], line: int, loc: KeyPath) -> list[object]:
        self.count += len(words)
        if self.count > _MAX_NODES:
            raise self.error(line, loc, "too many values")
        for n, (_, later) in enumerate(words):
            self.lines.setdefault((*loc, n), line + later)
        return [self.scalar(word, None, line + later, (*loc, n)) for n, (word, later) in enumerate(words)]

    def scalar(self, text: str, style: str | None, line: int, loc: KeyPath) -> object:
        if style is not None:  # quoted or block text
            return text
        if text in _CONSTANTS:
            return _CONSTANTS[text]
        if _NOT_FINITE.fullmatch(text):
            raise self.error(line, loc, f"found {text}; expected a finite number")
        if _INT.fullmatch(text) or _OCT_HEX.fullmatch(text):
            number = int(text, 0 if text[:2] in ("0o", "0x") else 10) if len(text) < 30 else _MAX_INT
            if abs(number) >= _MAX_INT:
                raise self.error(line, loc, f"found {text[:30]}; expected a number below 2^63")
            return number
        if _FLOAT.fullmatch(text):
            if not math.isfinite(float(text)):
                raise self.error(line, loc, f"found {text}; expected a finite number")
            return float(text)
        return text

    def error(self, line: int, loc: KeyPath, message: str) -> InputError:
        return FileFormatError(
            message, file=self.file, where=": ".join(p for p in (f"line {line}", format_key_path(loc)) if p)
        )


def _describe_error(model: type[BaseModel], e: ErrorDetails) -> tuple[KeyPath, str]:
    """Key path and message of one pydantic error, in the house's words."""
    loc, kind, found = tuple(e["loc"]), e["type"], e.get("input")
    owner, info = _find_field(model, loc)
    expected = info.description if info is not None and info.description else None
    if kind == "extra_forbidden":
        key = str(loc[-1])
        hint = owner.HINTS.get(key) if issubclass(owner, StrictSchema) else None
        elsewhere = _find_key_elsewhere(model, key, format_key_path(loc[:-1]))
        return loc, f"unknown key {key!r}; {hint or elsewhere + suggest_nearest_word(key, list(owner.model_fields))}"
    if kind == "missing":
        return loc, "required key is missing" + (f"; expected {expected}" if expected else "")
    if kind in ("value_error", "assertion_error"):
        return loc, str(e["msg"]).removeprefix("Value error, ")
    plain = {
        "float_type": "a number",
        "int_type": "a whole number",
        "string_type": "text",
        "list_type": "a list",
        "bool_type": "true or false",
        "dict_type": "a mapping",
        "int_from_float": "a whole number",
    }
    if kind == "model_type":
        wanted = f"a mapping with {_list_schema_keys(_find_inner_model(info) or owner)}"
    elif kind in ("too_short", "too_long"):
        ctx = e["ctx"]
        n = ctx.get("min_length", ctx.get("max_length"))
        wanted = f"{n} values" + (f": {expected}" if expected else "")
    elif kind == "literal_error" and isinstance(found, str):
        valid = [str(v) for v in typing.get_args(_unwrap_literal(info.annotation))] if info is not None else []
        return loc, f"found {format_found_value(found)}; " + suggest_nearest_word(found, valid)
    elif kind in plain:
        wanted = plain[kind] + (f" ({expected})" if expected else "")
    else:
        wanted = str(e["msg"]).removeprefix("Input should be ") + (f" ({expected})" if expected else "")
    return loc, f"found {format_found_value(found)}; expected {wanted}"


def _list_schema_keys(model: type[BaseModel]) -> str:
    return ", ".join(model.model_fields)


def _find_field(model: type[BaseModel], loc: KeyPath) -> tuple[type[BaseModel], FieldInfo | None]:
    """The schema that owns the last word of a key path, and that word's field where it is known."""
    owner, info = model, None
    for part in (p for p in loc if isinstance(p, str)):
        owner = (_find_inner_model(info) or owner) if info is not None else owner
        info = owner.model_fields.get(part)
    return owner, info


def _find_inner_model(info: FieldInfo | None) -> type[BaseModel] | None:
    return next(_list_nested_models(info.annotation), None) if info is not None else None


def _list_nested_models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for arg in typing.get_args(annotation):
        yield from _list_nested_models(arg)


def _find_key_elsewhere(model: type[BaseModel], key: str, here: str) -> str:
    """Where a key that is unknown here is known, in words; empty where nowhere."""
    todo, places = [("", model)], list[str]()
    while todo and len(places) < _SHOWN_PROBLEMS:
        at, one = todo.pop(0)
        for name, info in one.model_fields.items():
            path = f"{at}.{name}" if at else name
            if name == key and at and at != here:
                places.append(at)
            todo += [(path, inner) for inner in _list_nested_models(info.annotation) if path.count(".") < _DEEPEST]
    return f"it belongs under {' or '.join(dict.fromkeys(places))}; " if places else ""


def _unwrap_literal(annotation: object) -> object:
    """The Literal inside ``Literal[...] | None``."""
    return next((a for a in typing.get_args(annotation) if typing.get_origin(a) is typing.Literal), annotation)


def _is_nested(value: list[object]) -> bool:
    return any(isinstance(v, list | dict) for v in value)
