"""Robot programs that are one JSON object."""

from __future__ import annotations

import json
from collections.abc import Mapping

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.program_builder import ProgramBuilder


def parse_json_object(out: ProgramBuilder, source: SourceFile) -> Mapping[str, object]:
    """Parse the file as one JSON object.

    Args:
        out: Program builder, for errors.
        source: Lines of the file, with its path and the builder of its errors.

    Returns:
        The object.

    Raises:
        InputError: the file is no JSON object.
    """
    try:
        value = json.loads("\n".join(source.lines), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as problem:
        raise out.error(f"is not JSON: {str(problem)[:120]}") from None
    if not isinstance(value, dict):
        raise out.error("is JSON, but no object")
    return value


def _refuse_constant(word: str) -> float:
    raise ValueError(f"{word} is no JSON number")
