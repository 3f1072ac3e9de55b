"""JSON files as machopt writes and reads them: strict, in one style, NaN as null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from machopt.data_types.documents.document_base import DocumentModel
from machopt.errors import OutputFolderError

DocumentT = TypeVar("DocumentT", bound=DocumentModel)
MOST_BYTES = 256 << 20  # a result of a million points is below a tenth of it


def write_json(path: Path, value: Mapping[str, object]) -> None:
    """Write JSON with the keys in the given order, one-space indent, NaN and infinities as null.

    NumPy scalars and arrays, tuples and paths are taken as they come; anything else is refused.

    Args:
        path: The file to write.
        value: The object; NumPy scalars and arrays are allowed.
    """
    text = json.dumps(convert_to_json_types(value), indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8", newline="\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Args:
        path: The file to read.

    Raises:
        InputError: the file is missing or too large, is no JSON, holds a key twice, or is no object.
    """
    try:
        if path.is_symlink() or not path.is_file():
            raise OutputFolderError("is missing" if not path.exists() else "is not a plain file", file=path)
        if path.stat().st_size > MOST_BYTES:
            raise OutputFolderError(f"has {path.stat().st_size} bytes; {MOST_BYTES} at most are read", file=path)
        text = path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as problem:
        raise OutputFolderError(f"is not UTF-8 at byte {problem.start}", file=path) from None
    except OSError as problem:
        raise OutputFolderError(f"cannot be read: {problem.strerror}", file=path) from None
    try:
        found = json.loads(text, object_pairs_hook=_refuse_duplicate_keys, parse_constant=_refuse_constant)
    except json.JSONDecodeError as problem:
        place = f"line {problem.lineno}, column {problem.colno}"
        raise OutputFolderError(f"is no JSON: {problem.msg}", file=path, where=place) from None
    except (ValueError, RecursionError) as problem:
        raise OutputFolderError(f"is no JSON of ours: {problem or 'nested too deeply'}", file=path) from None
    if not isinstance(found, dict):
        raise OutputFolderError(f"holds {type(found).__name__}; a JSON object was expected", file=path)
    return found


def write_result(path: Path, result: DocumentModel) -> None:
    """Write a result document.

    Args:
        path: The file to write.
        result: The document.
    """
    write_json(path, result.to_json_types())


def read_result(path: Path, form: type[DocumentT]) -> DocumentT:
    """Read a result document.

    Args:
        path: The file to read.
        form: Model of the document.

    Raises:
        InputError: the file is missing, is no JSON, or does not match the model; the message names key and value.
    """
    value = read_json(path)
    try:
        return form.model_validate(value)
    except ValidationError as problem:
        first, *more = list_unique_errors(problem.errors())
        raise OutputFolderError(first + (f"; and {len(more)} more like it" if more else ""), file=path) from None


def list_unique_errors(errors: Sequence[ErrorDetails]) -> list[str]:
    """Return one message for each wrong key; pydantic reports one error for every type of a union.

    Args:
        errors: Errors of pydantic.
    """
    return list({_format_key(error): describe_wrong_key(error) for error in reversed(errors)}.values())[::-1]


def describe_wrong_key(error: ErrorDetails) -> str:
    """Return what is wrong with one key.

    Args:
        error: Error of pydantic.
    """
    key = _format_key(error)
    if error["type"] == "extra_forbidden":
        return f"{key} is no key of this file"
    if error["type"] == "missing":
        return f"{key} is missing"
    found = repr(error["input"])
    return f"{key} is {found if len(found) <= 60 else found[:57] + '…'}; {_describe_expected(error)}"


def _format_key(error: ErrorDetails) -> str:
    # what pydantic adds to a place, e.g. the kind it tried of several, is no key of the file
    return ".".join(str(part) for part in error["loc"] if not (isinstance(part, str) and part in _KINDS))


_KINDS = frozenset(("int", "float", "constrained-int", "constrained-float"))


def _describe_expected(error: ErrorDetails) -> str:
    text = error["msg"].removeprefix("Input should be ")
    return f"{text} was expected" if text != error["msg"] else text


def convert_to_json_types(value: object) -> Any:
    """Return the value in JSON's own types.

    Args:
        value: The value.

    Raises:
        TypeError: the value has no JSON form.
    """
    if isinstance(value, Mapping):
        return {str(key): convert_to_json_types(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return convert_to_json_types(value.tolist())
    if isinstance(value, list | tuple):
        return [convert_to_json_types(item) for item in value]
    if isinstance(value, np.generic):
        return convert_to_json_types(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return value.as_posix()
    if value is None or isinstance(value, str | bool | int):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: convert_to_json_types(getattr(value, f.name)) for f in fields(value)}
    raise TypeError(f"{type(value).__name__} has no JSON form here: {value!r}")


def _refuse_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in pairs:
        if key in out:
            raise ValueError(f"the key {key!r} is given twice")
        out[key] = value
    return out


def _refuse_constant(word: str) -> Any:
    raise ValueError(f"{word} is not JSON; null is used for values that are not finite")
