"""Numbers that a Heidenhain control does not know: ``1_0``, ``1E5``, ``nan``, ``inf``."""

from __future__ import annotations

import re

from machopt.file_formats.source_file import SourceFile

_QUOTED = re.compile(r"\"[^\"]*\"?")
_NAMED = re.compile(r"PGM\b|%|TOOL\b|LBL\b|FN\s*(?:15|16|38)\b")  # a sentence with a name or a text
_NO_DECIMAL = re.compile(
    r"(?<![A-Z0-9_.])(?:I?[A-Z]{1,3}\s*[-+]?\s*|[-+=]\s*)[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:_|E[-+]?[0-9])\w*"
    r"|(?<![A-Z0-9_])[A-Z]{0,4}\s*=?\s*[-+]?\s*(?:NAN|INF|INFINITY)\b"
)


def refuse_strange_numbers(source: SourceFile, text: str, line: int) -> None:
    """Refuse a sentence with a number that is no plain decimal.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        text: Code in upper case without comments.
        line: Line number in the file (1-based).

    Raises:
        InputError: the sentence holds such a number.
    """
    if "_" not in text and "E" not in text and "N" not in text:
        return
    found = None if _NAMED.search(text) else _NO_DECIMAL.search(_QUOTED.sub("", text))
    if found:
        raise source.build_error(f"found {found.group().strip()!r}; expected plain decimals such as X+10.5", line)
