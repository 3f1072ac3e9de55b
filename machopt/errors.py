"""The whole exception tree of machopt.

::

    MachoptError
    ├── InputError          exit 2   a file or an option is wrong: says what, where and what would have worked
    └── VerificationError   exit 4   the exported trajectory does not hold what the plan promised
"""

from __future__ import annotations

from pathlib import Path

from machopt.spelling_suggestions import suggest_word


class MachoptError(Exception):
    """Base of everything machopt raises on purpose; its text is for the user."""

    exit_code = 1


class InputError(MachoptError):
    """Bad input: names file, place, what was found and what was expected.

    Args:
        message: what was found and what would have worked.
        file: the file it stands in.
        where: key, or line and column, e.g. ``robot.limits.velocity_deg_s`` or ``line 12``.
        key: the key alone, where it is one of a file.
    """

    exit_code = 2

    def __init__(
        self, message: str, *, file: Path | str | None = None, where: str | None = None, key: str = ""
    ) -> None:
        self.file, self.where, self.reason, self.key = file, where, message, key
        place = ": ".join(str(p) for p in (file, where) if p is not None)
        super().__init__(f"{place}: {message}" if place else message)


class VerificationError(MachoptError):
    """The independent check of an exported trajectory failed."""

    exit_code = 4


def suggest_nearest_word(word: str, valid: list[str]) -> str:
    """``did you mean 'x'? valid: a, b, c`` for an unknown name."""
    return f"{suggest_word(word, valid)}valid: {', '.join(valid)}"
