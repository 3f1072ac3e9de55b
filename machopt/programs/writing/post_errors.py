"""Error classes of posts, so that callers distinguish them by class instead of message text."""

from __future__ import annotations

from machopt.errors import InputError


class MissingControllerKeyError(InputError):
    """Error of a ``controller`` key that a dialect needs and the cell lacks; it does not name the template."""


class MissingFieldValueError(InputError):
    """A program has nothing for a field of a template."""

    def __init__(self, name: str, where: str | None) -> None:
        super().__init__(f"the program has no value for @{{{name}}}; put it into a section @[{name}|…@]", where=where)
        self.name = name
