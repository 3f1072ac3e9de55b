"""Functions compiled by numba for the verifier, which may import nothing of the planner's packages."""

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
