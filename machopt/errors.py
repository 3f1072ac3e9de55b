"""The exceptions of machopt.

::

    MachoptError
    ├── InputError                 exit 2   input is wrong: says what, where and what would be accepted
    │   ├── OptionError                     value of an option or argument
    │   ├── UnknownOptionError              name of an option
    │   ├── FileAccessError                 a file is absent, unreadable, special or too large
    │   ├── FileFormatError                 content of a file: line and column
    │   ├── ConfigurationKeyError           key of a YAML file
    │   ├── RobotModelError                 URDF, xacro or SRDF
    │   ├── MeshError                       mesh of a body
    │   ├── CellError                       a cell that is read, and cannot do what is requested
    │   ├── RecordingError                  recording of measurements
    │   ├── PostError                       post or template of a robot program
    │   ├── CuttingInputError               cutting coefficients, cutter or cut outside of what a force model accepts
    │   ├── EffectDefinitionError           file with effects of the user's own
    │   └── OutputFolderError               output folder or file
    └── VerificationError          exit 4   the exported trajectory does not hold what the plan promised
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from machopt.spelling_suggestions import find_typo, suggest_word


class MachoptError(Exception):
    """Base class of all errors that machopt raises on purpose; the text is for the user."""

    exit_code = 1


class InputError(MachoptError):
    """Wrong input.

    Args:
        message: what was found and what would be accepted.
        file: the file that contains it.
        where: key, option, or line and column, e.g. ``robot.limits.velocity_deg_s`` or ``line 12``.
        key: the key alone, where it is one of a file.

    Attributes:
        reason: the message without file and place.
    """

    exit_code = 2

    def __init__(
        self, message: str, *, file: Path | str | None = None, where: str | None = None, key: str = ""
    ) -> None:
        self.file, self.where, self.reason, self.key = file, where, message, key
        super().__init__(self._format())

    def rename_options(self, rename: Callable[[str], str]) -> None:
        """Change the names of options in the message, where the caller knows them by others.

        Args:
            rename: returns a text with the other names.
        """
        self.where, self.reason = None if self.where is None else rename(self.where), rename(self.reason)
        self.args = (self._format(),)

    def _format(self) -> str:
        place = ": ".join(str(p) for p in (self.file, self.where) if p is not None)
        return f"{place}: {self.reason}" if place else self.reason


class OptionError(InputError):
    """An option or argument has a value that is not accepted.

    Attributes:
        option: its name as typed on the command line, e.g. ``--max-load-N``.
        argument: its name in Python, e.g. ``max_load_N``; errors of API functions name it in their text too.
    """

    def __init__(
        self, message: str, *, file: Path | str | None = None, where: str | None = None, key: str = ""
    ) -> None:
        super().__init__(message, file=file, where=where, key=key)
        self.option = where or ""

    @property
    def argument(self) -> str:
        return (self.where or "").removeprefix("--").replace("-", "_")


class UnknownOptionError(InputError):
    """There is no option of this name.

    Args:
        option: the name that was given.
        valid: the names that exist.
        where: the function, command or file.
        file: the file that contains it.

    Attributes:
        suggestions: names that may be meant.
    """

    def __init__(
        self, option: str, valid: Sequence[str], *, where: str | None = None, file: Path | str | None = None
    ) -> None:
        self.option, self.valid = option, tuple(valid)
        close = find_typo(option, list(valid))
        self.suggestions = (close,) if close else ()
        message = f"unknown option {option!r}; {suggest_nearest_word(option, list(valid))}"
        super().__init__(message, where=where, file=file)


class FileAccessError(InputError):
    """A file is absent, unreadable, no regular file, or too large."""


class FileFormatError(InputError):
    """The content of a file is wrong.

    Attributes:
        line: 1-based line, where known.
        column: 1-based column, where known.
    """

    @property
    def line(self) -> int | None:
        return self._read_number("line")

    @property
    def column(self) -> int | None:
        return self._read_number("column")

    def _read_number(self, word: str) -> int | None:
        found = re.search(rf"\b{word} ([0-9]+)", self.where or "")
        return int(found[1]) if found else None


class ConfigurationKeyError(FileFormatError):
    """A key of a YAML file is unknown, missing, or has a value that is not accepted; ``key`` names it."""


class RobotModelError(FileFormatError):
    """A robot description (URDF, xacro, SRDF) is wrong or not supported."""


class MeshError(FileFormatError):
    """A mesh is damaged, empty, or has an impossible size."""


class CellError(FileFormatError):
    """Valid cell that cannot do what is requested; ``file`` and ``where`` name the key."""


class TooManyArmJointsError(CellError):
    """The arm has more than six joints: its readings can be diagnosed, but no motion planned."""


class RecordingError(FileFormatError):
    """A recording of measurements is wrong or too small."""


class PostError(FileFormatError):
    """A post or its template is wrong, or cannot write this motion."""


class CuttingInputError(InputError):
    """A cutting coefficient, a dimension of the cutter or of the cut is outside of what the force model accepts.

    Attributes:
        key: the quantity, as in process.yaml or the cell: ``ae_mm``, ``Krc``, ``helix_deg`` …
    """


class EffectDefinitionError(InputError):
    """File with user-defined effects is wrong."""


class OutputFolderError(InputError):
    """An output folder or file cannot be written or read."""


class VerificationError(MachoptError):
    """The independent check of an exported trajectory failed."""

    exit_code = 4


def suggest_nearest_word(word: str, valid: list[str]) -> str:
    """Return ``did you mean 'x'? valid: a, b, c`` for an unknown name.

    Args:
        word: the unknown name.
        valid: the names that exist.
    """
    return f"{suggest_word(word, valid)}valid: {', '.join(valid)}"
