"""From a caller's keywords to the request that a service takes: one table of names and defaults, the request itself."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from machopt.errors import InputError, nearest

R = TypeVar("R")
GIVEN = ("cell", "recordings", "jobs", "robot", "out", "allow_external", "effects")  # what a call gives by other means
NOWHERE = Path()  # ``out`` of a request whose place is named later, by ``save``


def names_of(request: type[Any]) -> list[str]:
    """The options of a command, as its request has them."""
    return [f.name for f in fields(request) if f.name not in GIVEN]


def asked(request: type[R], options: Mapping[str, Any], **given: Any) -> R:
    """A request with these options; what is not given keeps the request's own default.

    Args:
        request: the dataclass of a service.
        options: values by the names of :func:`names_of`; lists and paths may be of any kind.
        given: the fields that are no options.

    Raises:
        InputError: an option that the command does not have; names the nearest.
    """
    known = names_of(request)
    for name in options:
        if name not in known:
            raise InputError(f"there is no such option; {nearest(name, known)}", where=name)
    kinds = {f.name: str(f.type) for f in fields(request)}  # type: ignore[arg-type]
    return request(**{name: _plain(value, kinds[name]) for name, value in options.items()}, **given)


def paths(value: str | os.PathLike[str] | Iterable[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """One path or several."""
    return (Path(value),) if isinstance(value, str | os.PathLike) else tuple(Path(v) for v in value)


def _plain(value: Any, kind: str) -> Any:
    """A value as the field wants it: tuples for lists, paths for names of files."""
    if "Path" in kind and value is not None:
        return paths(value) if kind.startswith("tuple") else Path(value)
    if kind.startswith("tuple") and isinstance(value, str):
        return (value,)
    return _tuple(value)


def _tuple(value: Any) -> Any:
    if isinstance(value, str | bytes | Mapping):
        return value
    return tuple(_tuple(v) for v in value) if isinstance(value, Iterable) else value
