"""The parameters of one term as a file states them, read key by key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from machopt.errors import InputError, suggest_nearest_word
from machopt.numerics.array_types import Array


class ParameterReader:
    """The parameters of one term, read key by key; what is not asked for is an error."""

    def __init__(self, data: Mapping[str, Any], where: str, file: Any = None) -> None:
        self._data, self._where, self._file = dict(data), where, file
        self._read_keys: list[str] = []

    def build_error(self, key: str, message: str) -> InputError:
        return InputError(message, file=self._file, where=f"{self._where}{f'.{key}' if key else ''}")

    def read_nested(self, key: str, data: Mapping[str, Any]) -> ParameterReader:
        """The reader of a mapping inside this one."""
        return ParameterReader(data, f"{self._where}.{key}", self._file)

    def read_word(self, key: str) -> str:
        """A word, empty where the key is missing."""
        return str(self._data[key]) if self.has_key(key) else ""

    def has_key(self, key: str) -> bool:
        self._read_keys.append(key)
        return key in self._data

    def read_number(self, key: str, default: float | None = None, *, positive: bool = True) -> float:
        """A finite number, above zero unless ``positive`` is off."""
        if not self.has_key(key):
            if default is None:
                raise self.build_error(key, f"is missing; {key} is needed here")
            return default
        value = self._data[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.build_error(key, f"found {value!r}; expected a number")
        if positive and not value > 0:
            raise self.build_error(key, f"found {value:g}; expected more than zero")
        return float(value)

    @property
    def is_empty(self) -> bool:
        """Nothing is stated: a term to be found."""
        return not self._data

    @property
    def keys(self) -> frozenset[str]:
        """What is stated, but for the words that every law may have."""
        return frozenset(self._data) - {"law", "memory"}

    def read_choice(self, key: str, valid: Sequence[str], default: str) -> str:
        """One of a few words."""
        if not self.has_key(key):
            return default
        value = self._data[key]
        if value not in valid:
            raise self.build_error(key, f"found {value!r}; valid: {', '.join(valid)}")
        return str(value)

    def read_single_key(self, key: str) -> bool:
        """Stated, and no list."""
        return self.has_key(key) and not isinstance(self._data[key], list)

    def read_row(self, key: str, *, least: float = -np.inf) -> Array:
        """One or more finite numbers in a list, none below ``least``; empty where the key is missing."""
        if not self.has_key(key):
            return np.empty(0)
        value = self._data[key]
        if not isinstance(value, list) or not value:
            raise self.build_error(key, f"found {value!r}; expected a list of numbers")
        for n, entry in enumerate(value):
            if isinstance(entry, bool) or not isinstance(entry, int | float) or not np.isfinite(entry):
                raise self.build_error(f"{key}[{n}]", f"found {entry!r}; expected a number")
            if entry < least:
                raise self.build_error(f"{key}[{n}]", f"found {entry:g}; expected at least {least:g}")
        return np.array(value, dtype=float)

    def read_array(self, key: str, shape: tuple[int, ...], default: Array | None = None) -> Array:
        """Finite numbers of a given shape."""
        if not self.has_key(key):
            if default is None:
                raise self.build_error(key, f"is missing; expected {_format_shape(shape)} numbers")
            return default
        try:
            value = np.array(self._data[key], dtype=float)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.shape != shape or not np.isfinite(value).all():
            raise self.build_error(key, f"found {self._data[key]!r}; expected {_format_shape(shape)} finite numbers")
        return value

    def read_mappings(self, key: str) -> list[dict[str, Any]]:
        """A list of mappings."""
        value = self._data.get(key)
        self._read_keys.append(key)
        if not isinstance(value, list) or not value or not all(isinstance(v, dict) for v in value):
            raise self.build_error(key, f"found {value!r}; expected a list of mappings")
        return value

    def refuse_unread_keys(self) -> None:
        """Refuse keys that nothing asked for."""
        for key in self._data:
            if key not in self._read_keys:
                valid = sorted(set(self._read_keys))
                raise self.build_error(key, f"unknown key; {suggest_nearest_word(key, valid)}")


def _format_shape(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape))
