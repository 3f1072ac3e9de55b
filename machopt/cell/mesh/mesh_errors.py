"""How a mesh is refused: the caller knows where it is used."""

from __future__ import annotations

from collections.abc import Callable

from machopt.errors import InputError

ErrorFactory = Callable[[str], InputError]
