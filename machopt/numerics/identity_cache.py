"""Values that follow from one immutable object, kept as long as the object lives."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

Owner = TypeVar("Owner")
Value = TypeVar("Value")


class IdentityCache(Generic[Owner, Value]):
    """One value per object. Objects are compared by identity, so that they need no hash; they must not change."""

    def __init__(self) -> None:
        self._values: dict[int, tuple[weakref.ref[Owner], Value]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def get(self, owner: Owner, compute: Callable[[Owner], Value]) -> Value:
        """Return the value of an object.

        Args:
            owner: The object.
            compute: Computes the value, at the first call with this object.
        """
        key = id(owner)
        found = self._values.get(key)
        if found is not None and found[0]() is owner:
            return found[1]
        value = compute(owner)
        values = self._values
        values[key] = weakref.ref(owner, lambda gone: _remove(values, key, gone)), value
        return value


def _remove(values: dict[int, tuple[weakref.ref[Owner], Value]], key: int, gone: weakref.ref[Owner]) -> None:
    """Remove the value of an object that no longer exists, unless its place has another object already."""
    found = values.get(key)
    if found is not None and found[0] is gone:
        del values[key]
