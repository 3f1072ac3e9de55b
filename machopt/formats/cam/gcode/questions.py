"""Questions come last: what no option can cure is reported before an option is asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from machopt.errors import InputError
from machopt.formats.source import OptionNeededError, ReadOptions

_MACHINES = ("table-ac@0,0,0", "table-bc@0,0,0", "table-ab@0,0,0", "head-ac@0", "head-bc@0")
_MOST = 20  # questions of one file


def find_fault_behind(
    question: OptionNeededError, options: ReadOptions, read: Callable[[ReadOptions], None]
) -> InputError | None:
    """Read on with assumed answers; the first fault that no option cures, None where there is none.

    Args:
        question: what the file was refused for.
        options: as the user gave them.
        read: carries the program out with other options; what it collects is not used.
    """
    asked: OptionNeededError = question
    machines = iter(_MACHINES)
    for _ in range(_MOST):
        answered = _answer(asked, options, machines)
        if answered is None:
            return None
        options = answered
        try:
            read(options)
        except OptionNeededError as another:
            asked = another
        except InputError as fault:
            return None if "--" in fault.reason else fault  # it names an option: another answer may cure it
        else:
            return None
    return None


def _answer(asked: OptionNeededError, options: ReadOptions, machines: object) -> ReadOptions | None:
    if asked.option == "unit" and options.unit is None:
        return dataclasses.replace(options, unit="mm")
    if asked.option == "feed" and options.default_feed is None:
        return dataclasses.replace(options, default_feed=1.0)
    if asked.option == "decimals" and options.decimals is None:
        return dataclasses.replace(options, decimals=4)
    if asked.option == "machine":
        name = next(machines, None)  # type: ignore[call-overload]
        return None if name is None else dataclasses.replace(options, machine=name)
    return None
