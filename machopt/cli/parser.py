"""The parser of every command: what is wrong in one line, with the word that was probably meant."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Sequence
from typing import Any, NoReturn, TypeVar

from machopt.errors import nearest

N = TypeVar("N")


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without two screens of usage above it.

    Options are never abbreviated: the beginning of one word may mean another command's option, or tomorrow's.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **{**settings, "allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"machopt: {message} ({self.prog} --help lists the options)\n")

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """As argparse, but an option that no command knows is answered with the nearest one of that command."""
        found, left = self.parse_known_args(args, namespace)
        if left:
            command = commands_of(self).get(found.command, self)
            options = options_of(command)
            told = []
            for word in left:
                name = word.partition("=")[0].lstrip("-")  # without dashes, in which all are alike
                close = difflib.get_close_matches(name, [o.lstrip("-") for o in options], n=1, cutoff=0.55)
                told.append(f"{word}; did you mean --{close[0]}?" if close and word.startswith("-") else word)
            command.error(f"not understood: {', '.join(told)}")
        return found

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            name = action.option_strings[-1] if action.option_strings else action.metavar or action.dest
            self.error(f"{name}: found {value!r}; {nearest(str(value), [str(c) for c in action.choices])}")


def options_of(parser: argparse.ArgumentParser) -> list[str]:
    """Every option of a command, the long names where there are any."""
    return [word for a in parser._actions for word in a.option_strings if word.startswith("--")]


def commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands of the whole parser by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}
