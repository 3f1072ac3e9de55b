"""Last results of what depends on the content of its inputs alone, for processes that compute it again and again."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from threading import Lock
from typing import Generic, TypeVar

import numpy as np

Value = TypeVar("Value")


class NoContentKeyError(TypeError):
    """A value has no content that can be compared, for example a function of a user's effect."""


class ContentCache(Generic[Value]):
    """The results of the last few inputs; equal numbers, words and file contents give the same object.

    Args:
        size: Number of results that are kept.
    """

    def __init__(self, size: int = 2) -> None:
        self.size = size
        self._values: OrderedDict[Hashable, Value] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._values)

    def get(self, inputs: object, compute: Callable[[], Value]) -> Value:
        """Return the result of some inputs; callers must not change it.

        Args:
            inputs: All that the result depends on; see :func:`build_content_key`. Where a file of it cannot be read,
                or a part of it has no key, the result is computed and not kept.
            compute: Computes the result where it is not known.
        """
        try:
            key = build_content_key(inputs)
        except (OSError, NoContentKeyError):
            return compute()
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        value = compute()
        with self._lock:
            self._values[key] = value
            while len(self._values) > self.size:
                self._values.popitem(last=False)
        return value


def build_content_key(value: object) -> Hashable:
    """Return a key that is equal for equal content, in whatever objects and folders it is.

    Args:
        value: A number, word, bytes, array, path, or tuples, lists, sets, mappings and dataclasses of these. A file
            counts by its bytes, a folder not at all: name its files, too.

    Raises:
        OSError: A file cannot be read.
        NoContentKeyError: A value of another kind.
    """
    if value is None or isinstance(value, bool | int | float | str | np.generic):
        return type(value).__name__, value
    if isinstance(value, bytes):
        return hashlib.sha256(value).digest()
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).digest()
    if isinstance(value, Path):
        return "folder" if value.is_dir() else hashlib.sha256(value.read_bytes()).digest()
    if isinstance(value, tuple | list):
        return tuple(build_content_key(v) for v in value)
    if isinstance(value, frozenset):
        return frozenset(build_content_key(v) for v in value)
    if isinstance(value, Mapping):
        return "mapping", tuple((build_content_key(k), build_content_key(v)) for k, v in value.items())
    if is_dataclass(value):
        return type(value), tuple(build_content_key(getattr(value, f.name)) for f in fields(value))
    raise NoContentKeyError(f"{type(value).__name__} has no content key")
