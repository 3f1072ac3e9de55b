"""Functions compiled by numba for the verifier, which may import nothing of the planner's packages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """``numba.njit`` without the interpreter lock, cached where a folder may be written: not everywhere is one."""
    try:
        return numba.njit(cache=True, nogil=True)(function)  # type: ignore[no-any-return]
    except RuntimeError:  # numba finds no folder it may write to
        return numba.njit(nogil=True)(function)  # type: ignore[no-any-return]
