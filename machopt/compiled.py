"""Functions compiled by numba: stored on disk where there is a place for it, elsewhere compiled in each process.

They hold no interpreter lock, so that threads can run them side by side."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])
Told = Callable[[bool], None]  # called once, when something is compiled that was not stored; True: it will be stored


class _Listener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Hears of every function that numba really compiles; what it loads from disk makes no event."""

    def __init__(self) -> None:
        self.told: Told | None = None
        self.stored = True

    def on_start(self, event: Any) -> None:
        if self.told is not None:
            told, self.told = self.told, None
            told(self.stored)

    def on_end(self, event: Any) -> None:
        """Nothing: only the beginning is told."""


_LISTENER = _Listener()
event.register("numba:compile", _LISTENER)


@contextlib.contextmanager
def when_compiling(told: Told) -> Iterator[None]:
    """Have ``told`` called when the next function is compiled in this block, and not after it."""
    _LISTENER.told = told
    try:
        yield
    finally:
        _LISTENER.told = None


def compiled(function: F) -> F:
    """``numba.njit``, cached where a folder may be written: a read-only installation and home are none."""
    try:
        return numba.njit(cache=True, nogil=True)(function)  # type: ignore[no-any-return]
    except RuntimeError:  # numba finds no folder it may write to
        _LISTENER.stored = False
        return numba.njit(nogil=True)(function)  # type: ignore[no-any-return]
