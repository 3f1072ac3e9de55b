"""Error classes of posts, so that callers distinguish them by class instead of message text."""

from __future__ import annotations

from machopt.errors import InputError


class MissingControllerKeyError(InputError):
    """The cell's ``controller`` does not say what a dialect needs; the template is not to blame, and not named."""


class MissingFieldValueError(InputError):
    """A program has nothing for a field of a template."""

    def __init__(self, name: str, where: str | None) -> None:
        super().__init__(f"the program has no value for @{{{name}}}; put it into a section @[{name}|…@]", where=where)
        self.name = name
