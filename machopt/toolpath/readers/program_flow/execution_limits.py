"""Errors and limits of the program flow: endless loops, jumps to missing targets."""

from __future__ import annotations

from collections.abc import Hashable

MAX_STEPS = 300_000  # lines carried out in one program, beyond twice the lines it has
MAX_IDLE = 100_000  # of them one after the other that hold nothing for the control


class ProgramFlowError(ValueError):
    """The flow of the program cannot be followed; carries its line number."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


class StepGuard:
    """Ends a program that never would: too many lines, too many without motion, or a jump back into the same state."""

    def __init__(self, lines: int) -> None:
        self.most = MAX_STEPS + 2 * lines
        self.steps = self.idle = 0
        self._seen: set[tuple[int, Hashable]] = set()

    def step(self, line: int) -> None:
        """Count one line that is carried out.

        Args:
            line: Line number in the file (1-based).

        Raises:
            ProgramFlowError: the limit of lines is exceeded.
        """
        self.steps += 1
        if self.steps > self.most:
            raise ProgramFlowError(f"more than {self.most} lines carried out: does a loop never end?", line)

    def count_idle_lines(self, *, anything: bool, line: int) -> None:
        """Count consecutive lines without effect on the control.

        Args:
            anything: Whether the line holds something for the control.
            line: Line number in the file (1-based).

        Raises:
            ProgramFlowError: a loop never moves.
        """
        self.idle = 0 if anything else self.idle + 1
        if self.idle > MAX_IDLE:
            raise ProgramFlowError("a loop goes on without ever moving: does it never end?", line)

    def check_backward_jump(self, place: int, state: Hashable, line: int) -> None:
        """Check a jump to an earlier line for an endless loop.

        Args:
            place: Index of the target line.
            state: Everything that the flow from there depends on.
            line: Line number in the file (1-based).

        Raises:
            ProgramFlowError: the same jump with the same state occurred before.
        """
        if (place, state) in self._seen:
            raise ProgramFlowError("a loop comes back to where it was with nothing changed: it never ends", line)
        self._seen.add((place, state))
