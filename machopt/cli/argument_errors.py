"""Argument parser of every command: errors in one line, with suggestions for mistyped words."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn, TypeVar

from machopt.errors import suggest_nearest_word
from machopt.spelling_suggestions import find_typo

N = TypeVar("N")
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", re.ASCII)
_SEPARATOR = re.compile(r"\s*([][,:{}]|\s)\s*")


class SingleValueAction(argparse._StoreAction):
    """Value of an option that is given once; a repetition with another value contradicts the first one."""

    _seen: tuple[argparse.Namespace, Any] | None = None

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option_string: Any = None
    ) -> None:
        """Store the value.

        Args:
            parser: The argument parser.
            namespace: Object that receives the value.
            values: The converted value.
            option_string: The option as typed.

        Raises:
            argparse.ArgumentError: the option was given before with another value.
        """
        before = self._seen
        if self.option_strings and before is not None and before[0] is namespace and before[1] != values:
            raise argparse.ArgumentError(self, f"given twice, {before[1]} and {values}; expected one value")
        self._seen = namespace, values
        super().__call__(parser, namespace, values, option_string)


class NamedValuesAction(argparse._AppendAction):
    """Values of an option that may be repeated; one in the form NAME=VALUE states each name once."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option_string: Any = None
    ) -> None:
        """Append the value.

        Args:
            parser: The argument parser.
            namespace: Object that receives the value.
            values: The converted value.
            option_string: The option as typed.

        Raises:
            argparse.ArgumentError: the name was given before with another value.
        """
        metavar = str(self.metavar or "")
        name, value = _split_named_value(values)
        if "=" in metavar and (name or metavar.startswith("[")):  # [NAME=]VALUE: the name may be left out
            for other in getattr(namespace, self.dest, None) or []:
                other_name, other_value = _split_named_value(other)
                if other_name == name and not _is_same_value(other_value, value):
                    raise argparse.ArgumentError(
                        self, f"{name or 'it'} is given twice, {other_value} and {value}; expected one value"
                    )
        super().__call__(parser, namespace, values, option_string)


def _split_named_value(value: Any) -> tuple[str, str]:
    if isinstance(value, tuple):
        return str(value[0]), str(value[1])
    name, equals, text = str(value).partition("=")
    return (name.strip(), text.strip()) if equals else ("", name.strip())


def _is_same_value(one: str, other: str) -> bool:
    """Whether two texts are alike, or differ in the notation of their numbers only (5 and 5.0, 0:10 and 0:1e1)."""
    return one == other or _split_numbers(one) == _split_numbers(other)


def _split_numbers(text: str) -> list[str | float]:
    """Parts of a list or range; a plain decimal as number."""
    return [float(part) if _NUMBER.fullmatch(part) else part for part in _SEPARATOR.split(text)]


class OptionParser(argparse.ArgumentParser):
    """Parser whose options refuse contradicting repetitions; also the parent of commands with common options."""

    def register(self, registry_name: str, value: object, object: object) -> None:
        """Register a class by name; the actions of argparse that take values are replaced by those of this module.

        Args:
            registry_name: ``action`` or ``type``.
            value: Name of the class; None: the default.
            object: The class of argparse.
        """
        own = {None: SingleValueAction, "store": SingleValueAction, "append": NamedValuesAction}
        found = own.get(value, object) if registry_name == "action" and isinstance(value, str | None) else object
        super().register(registry_name, value, found)


class CommandParser(OptionParser):
    """Argument parser that reports errors in one line, without the usage text.

    Options are never abbreviated: an abbreviation may match another command's option, or a future one.
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does, without abbreviations; subcommands are parsed through this method too.

        Args:
            args: The arguments; None takes those of the process.
            namespace: Object that receives the values.
        """
        self.allow_abbrev = False
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print an error in one line and exit with code 2.

        Args:
            message: What is wrong.
        """
        self.exit(2, f"machopt: {message} ({self.prog} --help lists the options)\n")

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse as argparse does; an unknown option gets a spelling suggestion.

        Args:
            args: The arguments; None takes those of the process.
            namespace: Object that receives the values.
        """
        found, left = self.parse_known_args(args, namespace)
        if left:
            command = list_commands(self).get(found.command, self)
            options = list_options(command)
            messages = []
            for word in left:
                messages.append(f"{word}{self._find_hint(word, options)}" if word.startswith("-") else word)
            command.error(f"not understood: {', '.join(messages)}")
        return found

    def _find_hint(self, word: str, options: list[str]) -> str:
        """What an unknown option may stand for: a slip of one of its command, or an option of other commands."""
        name = word.partition("=")[0].lstrip("-")  # without dashes, in which all are alike
        owners: dict[str, list[str]] = {option.lstrip("-"): [] for option in options}
        for command, parser in list_commands(self).items():
            for option in list_options(parser):
                if option not in options:
                    owners.setdefault(option.lstrip("-"), []).append(command)
        close = find_typo(name, list(owners))
        if close is None:
            return ""
        if owners[close]:
            return f" (an option of {' and '.join(owners[close])})" if close == name else ""
        return f"; did you mean --{close}?"

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            name = action.option_strings[-1] if action.option_strings else action.metavar or action.dest
            self.error(f"{name}: found {value!r}; {suggest_nearest_word(str(value), [str(c) for c in action.choices])}")


def list_options(parser: argparse.ArgumentParser) -> list[str]:
    """Return every long option of a command.

    Args:
        parser: The argument parser.
    """
    return [word for a in parser._actions for word in a.option_strings if word.startswith("--")]


def list_commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the sub-parsers of all commands by name.

    Args:
        parser: The argument parser.
    """
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}
