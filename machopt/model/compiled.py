"""Functions compiled by numba: stored on disk where there is a place for it, elsewhere compiled in each process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """``numba.njit``, cached where a folder may be written: a read-only installation and home are none."""
    try:
        return numba.njit(cache=True)(function)  # type: ignore[no-any-return]
    except RuntimeError:  # numba finds no folder it may write to
        return numba.njit(function)  # type: ignore[no-any-return]
