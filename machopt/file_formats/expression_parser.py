"""Recursive descent parser for expressions of any language: operator levels, brackets, limited depth.

A language defines its tokens, its binary operators from the weakest level to the strongest, and its atoms (number,
name, call, sign, bracket). The type of a value is open: a float, a function of the variables, a pose.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, TypeVar

V = TypeVar("V")
_NOTATION = re.compile(r"_\w*|[Ee][-+]?[0-9]+(?![0-9.])")  # E0.5 is a word of its own
Operator = Callable[[Any, Any], Any]


class RecursiveDescentParser(ABC, Generic[V]):
    """Recursive descent over a text from ``at`` on; ``at`` is then the place after what was read."""

    token: ClassVar[re.Pattern[str]]  # group 1 is the token, blanks before it are passed over
    levels: ClassVar[tuple[Mapping[str, Operator], ...]]  # binary operators, weakest first; all bind from the left
    problem: ClassVar[type[ValueError]]  # what is raised; the reader adds file and line
    most_depth: ClassVar[int] = 50

    def __init__(self, text: str, at: int = 0) -> None:
        self.text, self.at, self.depth = text, at, 0

    def peek_token(self) -> str:
        """The next token, empty where there is none."""
        found = self.token.match(self.text, self.at)
        return found.group(1) if found else ""

    def take_token(self) -> str:
        """The next token, passed over."""
        found = self.token.match(self.text, self.at)
        if not found:
            raise self.problem(f"an expression breaks off at {self.text[self.at : self.at + 10]!r}")
        self.at = found.end()
        return found.group(1)

    def refuse_notation(self, number: str) -> None:
        """Refuse what follows a number where both together read as another notation: ``1_0``, ``1E5``.

        Args:
            number: Text of the number, which ends at ``at``.
        """
        if found := _NOTATION.match(self.text, self.at):
            raise self.problem(f"found {number + found.group()!r}; expected a plain decimal")

    def parse_expression(self, level: int = 0) -> V:
        """Parse operators of one level and the stronger ones.

        Args:
            level: Index of the level, 0 for the weakest operators.

        Returns:
            Value of the expression.
        """
        if level == len(self.levels):
            return self.parse_factor()
        left = self.parse_expression(level + 1)
        while (word := self.peek_token()) in self.levels[level]:
            self.take_token()
            left = self.combine_operands(self.levels[level][word], left, self.parse_expression(level + 1))
        return left

    def parse_factor(self) -> V:
        """An atom, unless it lies in too many others."""
        self.depth += 1
        if self.depth > self.most_depth:
            raise self.problem("an expression is nested too deeply")
        found = self.parse_atom()
        self.depth -= 1
        return found

    @abstractmethod
    def combine_operands(self, operator: Operator, left: V, right: V) -> V:
        """Combine two values by an operator.

        Args:
            operator: The binary operator.
            left: Left value.
            right: Right value.

        Returns:
            The combined value.
        """

    @abstractmethod
    def parse_atom(self) -> V:
        """A number, a name, a call, a sign before a factor, a bracket."""
