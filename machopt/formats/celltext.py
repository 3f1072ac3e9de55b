"""The user's words in a CSV cell: a spreadsheet must show them, never run them.

Spreadsheets take a cell that begins with ``=``, ``+``, ``-``, ``@``, a tab or a carriage return for a formula, quoted
or not. Such a text gets an apostrophe in front, which they show as text; reading takes it away again. A text that
would be mistaken for one so marked gets one more, so that every text comes back as it was.
"""

from __future__ import annotations

FORMULA = ("=", "+", "-", "@", "\t", "\r", "＝", "＋", "－", "＠")
MARK = "'"


def as_cell(text: str) -> str:
    """The text as it may stand in a cell."""
    return MARK + text if _begins_a_formula(text) else text


def from_cell(cell: str) -> str:
    """The text that :func:`as_cell` was given."""
    return cell[1:] if cell.startswith(MARK) and _begins_a_formula(cell) else cell


def _begins_a_formula(text: str) -> bool:
    return text.lstrip(MARK).lstrip(" ").startswith(FORMULA)
