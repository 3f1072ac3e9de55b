"""Escaping of user text in CSV cells, so that spreadsheets do not run it as a formula.

Spreadsheets read a cell that begins with ``=``, ``+``, ``-``, ``@``, a tab or a carriage return as a formula, quoted or
not. Such a text gets an apostrophe as prefix, which spreadsheets show as text; reading removes it again. A text that
already looks escaped gets one more apostrophe, so that every text is restored exactly.
"""

from __future__ import annotations

FORMULA = ("=", "+", "-", "@", "\t", "\r", "＝", "＋", "－", "＠")
MARK = "'"


def escape_formula_text(text: str) -> str:
    """Escape a text for a CSV cell, so that a spreadsheet does not read it as a formula.

    Args:
        text: The text.

    Returns:
        Text of the cell.
    """
    return MARK + text if _is_formula_like(text) else text


def unescape_formula_text(cell: str) -> str:
    """Reverse :func:`escape_formula_text`.

    Args:
        cell: Text of the cell.

    Returns:
        The original text.
    """
    return cell[1:] if cell.startswith(MARK) and _is_formula_like(cell) else cell


def _is_formula_like(text: str) -> bool:
    return text.lstrip(MARK).lstrip(" ").startswith(FORMULA)
