"""Reader that carries out the lines of a routine in their order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, Protocol, TypeVar

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.program_builder import ProgramBuilder

DEEPEST = 20  # calls inside of calls


class ProgramLine(Protocol):
    """A line of a routine."""

    @property
    def number(self) -> int:
        """Line number in the file (1-based)."""

    @property
    def code(self) -> str:
        """Text without the comment."""

    @property
    def comment(self) -> str:
        """Text of the comment."""


class ProgramRoutine(Protocol):
    """A routine or function of a program."""

    @property
    def name(self) -> str:
        """Name that calls use."""

    @property
    def lines(self) -> Sequence[ProgramLine]:
        """Its lines."""

    @property
    def source(self) -> SourceFile | None:
        """File of the lines; None for the main file."""


R = TypeVar("R", bound=ProgramRoutine)


class LineFollower(ABC, Generic[R]):
    """Carries out routines line by line; :meth:`statement` carries out one line, or a block from its first line."""

    value_error: ClassVar[type[ValueError]]  # raised by a statement that cannot be carried out
    out: ProgramBuilder
    returned: bool  # a return was reached in the routine that is followed

    def follow(self, routine: R, start: int, stop: int, depth: int) -> None:
        """Carry out lines until the last one or a return.

        Args:
            routine: The routine.
            start: Index of the first line.
            stop: Index behind the last line.
            depth: Number of calls that lead here.

        Raises:
            InputError: a statement cannot be carried out, or calls are nested too deep.
        """
        if depth > DEEPEST:
            raise self.out.error(f"{routine.name} calls itself, or calls are nested more than {DEEPEST} deep")
        k = start
        while k < stop and not self.returned:
            line = routine.lines[k]
            if line.comment:
                self.out.comment(line.comment)
            if line.code:
                self.out.step(line.number)
                try:
                    k = self.statement(routine, k, depth)
                except self.value_error as problem:
                    raise self.out.error(str(problem), line.number, routine.source) from None
            k += 1

    @abstractmethod
    def statement(self, routine: R, k: int, depth: int) -> int:
        """Carry out a line.

        Args:
            routine: The routine.
            k: Index of the line.
            depth: Number of calls that lead here.

        Returns:
            Index of the last line that is done with.
        """
