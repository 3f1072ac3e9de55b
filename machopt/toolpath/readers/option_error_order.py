"""Order of errors: errors that no option can resolve are reported before an option is requested."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from machopt.errors import InputError
from machopt.file_formats.source_file import OptionNeededError, ReadOptions

_ANSWERS: dict[str, tuple[tuple[str, Any], ...]] = {  # option → keyword and values that users give it
    "unit": (("unit", "mm"), ("unit", "inch")),
    "feed": (("default_feed", 1.0),),
    "decimals": (("decimals", 0), ("decimals", 3), ("decimals", 4)),
    "machine": (("machine", "table-ac@0,0,0"), ("machine", "table-bc@0,0,0"), ("machine", "table-ab@0,0,0")),
}
_MOST = 4  # questions one after the other
MAX_LINES = 50_000  # of a file that is read again; longer ones raise at once


def find_fault_behind(
    question: OptionNeededError, options: ReadOptions, read: Callable[[ReadOptions], None], *, depth: int = 0
) -> InputError | None:
    """Read on with each usual answer; the fault that all of them meet, None where one of them meets none.

    Args:
        question: what the file was refused for.
        options: as the user gave them.
        read: carries the program out with other options; what it collects is not used.
        depth: how many questions were answered before.
    """
    faults: list[InputError] = []
    for keyword, value in _ANSWERS.get(question.option, ()) if depth < _MOST else ():
        if getattr(options, keyword) is not None:
            return None
        answered = dataclasses.replace(options, **{keyword: value})
        try:
            read(answered)
        except OptionNeededError as another:
            fault = find_fault_behind(another, answered, read, depth=depth + 1)
            if fault is None:
                return None
            faults.append(fault)
        except InputError as problem:
            if "--" in problem.reason:  # it names an option: another answer may cure it
                return None
            faults.append(problem)
        else:
            return None
    same = bool(faults) and all(f.where == faults[0].where for f in faults)
    return faults[0] if same else None
