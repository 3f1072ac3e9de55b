"""Reader for the parameters of one entry of a file, key by key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from machopt.errors import ConfigurationKeyError, suggest_nearest_word
from machopt.numerics.array_types import Array


class ParameterReader:
    """Parameters of one entry, read key by key. Keys that were never read are reported as errors."""

    def __init__(self, data: Mapping[str, Any], where: str, file: Any = None) -> None:
        self._data, self._where, self._file = dict(data), where, file
        self._read_keys: list[str] = []

    def build_error(self, key: str, message: str) -> ConfigurationKeyError:
        """Build an error that names the file and the key.

        Args:
            key: Key inside this entry.
            message: What is wrong and what would be accepted.

        Returns:
            The error; the caller raises it.
        """
        return ConfigurationKeyError(message, file=self._file, where=f"{self._where}{f'.{key}' if key else ''}")

    def read_nested(self, key: str, data: Mapping[str, Any]) -> ParameterReader:
        """Return a reader for a mapping inside this entry.

        Args:
            key: Key inside this entry.
            data: The nested mapping.

        Returns:
            The reader; errors name the full path of a key.
        """
        return ParameterReader(data, f"{self._where}.{key}", self._file)

    def read_word(self, key: str) -> str:
        """Return a value as text.

        Args:
            key: Key inside this entry.

        Returns:
            The text; empty if the key is missing.
        """
        return str(self._data[key]) if self.has_key(key) else ""

    def has_key(self, key: str) -> bool:
        """Return whether the entry has a key, and mark the key as read.

        Args:
            key: Key inside this entry.

        Returns:
            True if the key is present.
        """
        self._read_keys.append(key)
        return key in self._data

    def read_number(self, key: str, default: float | None = None, *, positive: bool = True) -> float:
        """Read a finite number.

        Args:
            key: Key inside this entry.
            default: Value if the key is missing; None makes the key mandatory.
            positive: Whether only numbers above zero are accepted.

        Returns:
            The number in the unit of the key.

        Raises:
            InputError: The key is missing, or the value is not an accepted number.
        """
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
        """Whether the entry states nothing, so that its parameters are to be fitted."""
        return not self._data

    @property
    def keys(self) -> frozenset[str]:
        """Stated keys without those that every law may have."""
        return frozenset(self._data) - {"law", "memory"}

    def read_choice(self, key: str, valid: Sequence[str], default: str) -> str:
        """Read one of several words.

        Args:
            key: Key inside this entry.
            valid: Accepted words.
            default: Value if the key is missing.

        Returns:
            The word.

        Raises:
            InputError: The value is not one of the accepted words.
        """
        if not self.has_key(key):
            return default
        value = self._data[key]
        if value not in valid:
            raise self.build_error(key, f"found {value!r}; valid: {', '.join(valid)}")
        return str(value)

    def read_single_key(self, key: str) -> bool:
        """Return whether a key is stated with a single value instead of a list.

        Args:
            key: Key inside this entry.

        Returns:
            True for a single value.
        """
        return self.has_key(key) and not isinstance(self._data[key], list)

    def read_row(self, key: str, *, least: float = -np.inf) -> Array:
        """Read a list of one or more finite numbers.

        Args:
            key: Key inside this entry.
            least: Smallest accepted number.

        Returns:
            (n,) numbers in the unit of the key; empty if the key is missing.

        Raises:
            InputError: The value is not a list of accepted numbers.
        """
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
        """Read finite numbers of a given shape.

        Args:
            key: Key inside this entry.
            shape: Expected shape.
            default: Value if the key is missing; None makes the key mandatory.

        Returns:
            Array of the given shape.

        Raises:
            InputError: The key is missing, or the value has another shape.
        """
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
        """Read a list of mappings.

        Args:
            key: Key inside this entry.

        Returns:
            The mappings.

        Raises:
            InputError: The value is not a list of mappings.
        """
        value = self._data.get(key)
        self._read_keys.append(key)
        if not isinstance(value, list) or not value or not all(isinstance(v, dict) for v in value):
            raise self.build_error(key, f"found {value!r}; expected a list of mappings")
        return value

    def refuse_unread_keys(self) -> None:
        """Raise an error if the entry has keys that were never read."""
        for key in self._data:
            if key not in self._read_keys:
                valid = sorted(set(self._read_keys))
                raise self.build_error(key, f"unknown key; {suggest_nearest_word(key, valid)}")


def _format_shape(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape))
