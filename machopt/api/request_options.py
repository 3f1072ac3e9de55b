"""Conversion of keyword arguments of the API into the request of a command."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from machopt.errors import InputError, UnknownOptionError

R = TypeVar("R")
NON_OPTION_ARGUMENTS = (
    "cell",
    "recordings",
    "recording",
    "jobs",
    "robot",
    "out",
    "allow_external",
    "effects",
    "process",
)  # what a call gives by other means
NOWHERE = Path()  # ``out`` of a request whose place is named later, by ``save``


def list_option_names(request: type[Any]) -> list[str]:
    """Return the option names of a command, from the fields of its request.

    Args:
        request: Class of the request.
    """
    return [f.name for f in fields(request) if f.name not in NON_OPTION_ARGUMENTS]


def build_request(request: type[R], options: Mapping[str, object], **given: object) -> R:
    """A request with these options; what is not given keeps the request's own default.

    Args:
        request: the dataclass of a service.
        options: values by the names of :func:`list_option_names`; lists and paths may be of any kind.
        given: the fields that are no options.

    Raises:
        InputError: an option that the command does not have, with the nearest; or one of another type.
    """
    known = list_option_names(request)
    for name in options:
        if name not in known:
            raise UnknownOptionError(name, known)
    kinds = {f.name: str(f.type) for f in fields(request)}  # type: ignore[arg-type]
    hints = get_type_hints(request)
    plain = {
        name: check_value_type(_convert_to_field_type(value, kinds[name], name), hints[name], name)
        for name, value in options.items()
    }
    return request(**plain, **given)


def convert_to_path(value: object, where: str) -> Path:
    """Return a path that was given as text or as any kind of path.

    Args:
        value: The given value.
        where: Name of the argument.

    Raises:
        InputError: the value is neither.
    """
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"found {_format_value(value)}; a path would work, as text or pathlib.Path", where=where)
    return Path(os.fspath(value))


def convert_to_paths(value: object, where: str) -> tuple[Path, ...]:
    """Return one path or several as a tuple.

    Args:
        value: The given value.
        where: Name of the argument.

    Raises:
        InputError: a value is no path.
    """
    if isinstance(value, Iterable) and not isinstance(value, str | os.PathLike):
        return tuple(convert_to_path(v, where) for v in value)
    return (convert_to_path(value, where),)


def convert_to_texts(value: object, where: str) -> tuple[str, ...]:
    """Return one name or several as a tuple; names may be paths.

    Args:
        value: The given value.
        where: Name of the argument.

    Raises:
        InputError: a value is neither text nor path.
    """
    several = value if isinstance(value, Iterable) and not isinstance(value, str | os.PathLike) else (value,)
    return tuple(v if isinstance(v, str) else os.fspath(convert_to_path(v, where)) for v in several)


def check_value_type(value: Any, hint: Any, where: str) -> Any:
    """Return the value if it has the annotated type of a request's field or an argument.

    Args:
        value: The given value.
        hint: The annotated type.
        where: Name of the argument.

    Raises:
        InputError: the value has another type; the message says what was found and what is accepted.
    """
    try:
        TypeAdapter(hint).validate_python(value, strict=True)
    except ValidationError:
        kind = hint.__name__ if isinstance(hint, type) and "[" not in str(hint) else str(hint)
        raise InputError(f"found {_format_value(value)}; expected {_describe_annotation(kind)}", where=where) from None
    return value


def _format_value(value: object) -> str:
    text = repr(value)
    return f"{text if len(text) <= 60 else text[:60] + '…'} ({type(value).__name__})"


def _describe_annotation(kind: str) -> str:
    """An annotation in words, e.g. ``float | None``: a number, or None."""
    kind = kind.replace("pathlib.", "").replace("typing.", "")
    known = {"str": "text", "int": "a whole number", "float": "a number", "bool": "True or False", "Path": "a path"}
    words = [known.get(k.strip(), k.strip()) for k in kind.split(" | ")]
    return ", or ".join(words)


def _convert_to_field_type(value: Any, kind: str, where: str) -> Any:
    """Return a value in the type of its field: tuples for lists, paths for names of files."""
    if kind.startswith("Mapping") and kind.endswith("Path]") and isinstance(value, Mapping):
        return {name: convert_to_path(folder, where) for name, folder in value.items()}
    if "Path" in kind and value is not None:
        return convert_to_paths(value, where) if kind.startswith("tuple") else convert_to_path(value, where)
    if kind.startswith("tuple") and isinstance(value, str):
        return (value,)
    return _convert_to_tuple(value)


def _convert_to_tuple(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str | bytes | Mapping):
        return value
    return tuple(_convert_to_tuple(v) for v in value) if isinstance(value, Iterable) else value
