"""Error of a mesh, which the caller locates in the cell."""

from __future__ import annotations

from collections.abc import Callable

from machopt.errors import InputError

ErrorFactory = Callable[[str], InputError]
