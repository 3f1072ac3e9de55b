"""Unknown words of a toolpath file, which stop a plan because they may move points or frames.

Each dialect has one reviewed list of words that cannot move anything (:mod:`machopt.toolpath.readers.harmless_words`,
:mod:`machopt.programs.reading.harmless_word_reasons`). Every other word stops the plan, unless the user accepts it
by name.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from machopt.data_types.toolpath import Toolpath
from machopt.errors import FileFormatError
from machopt.toolpath.toolpath_reader import read_toolpath

MOST_NAMED = 8  # words in one message


def read_for_plan(path: Path, reading: Mapping[str, Any]) -> Toolpath:
    """Read a toolpath that a plan may be made from.

    Args:
        path: the file.
        reading: keywords of :func:`machopt.toolpath.toolpath_reader.read_toolpath`.

    Raises:
        InputError: as :func:`machopt.toolpath.toolpath_reader.read_toolpath`, and see :func:`refuse_unknown_words`.
    """
    return refuse_unknown_words(read_toolpath(path, **reading), path)


def refuse_unknown_words(toolpath: Toolpath, path: Path) -> Toolpath:
    """Return the toolpath, unless its file holds unknown words that may move points or frames.

    Args:
        toolpath: The toolpath with its unknown words.
        path: Path of the file.

    Returns:
        The toolpath, unchanged.

    Raises:
        FileFormatError: names file, line, word and the option that accepts it.
    """
    found = sorted((w for w in toolpath.ignored if w.stops), key=lambda w: w.first_line)
    if not found:
        return toolpath
    first = found[0]
    further = ", ".join(f"{w.word!r} (line {w.first_line})" for w in found[1:MOST_NAMED])
    if len(found) > MOST_NAMED:
        further += f" and {len(found) - MOST_NAMED} more"
    options = " ".join(format_accept_option(w.word) for w in found[:MOST_NAMED])
    raise FileFormatError(
        f"the word {first.word!r} is not understood and may move points or frames, so no plan is made"
        + (f"; the same holds for {further}" if further else "")
        + f". Expected a file without it, or, where it moves nothing: {options}",
        file=path,
        where=f"line {first.first_line}",
    )


def format_accept_option(word: str) -> str:
    """Format the option that accepts a word, quoted for a shell.

    Args:
        word: The unknown word.

    Returns:
        The option.
    """
    quoted = shlex.quote(word)
    return f"--accept-unknown={quoted}" if word.startswith("-") else f"--accept-unknown {quoted}"
