"""Numbers in the text of CAM files: plain decimals, without what Python reads in addition."""

from __future__ import annotations

LARGEST = 1e15  # beyond it no length, angle or feed: squares of it would overflow


def is_plain(text: str) -> bool:
    """Return whether a text has only characters of a plain decimal: no digits of other scripts, no ``1_000``.

    Args:
        text: The text.
    """
    return "_" not in text and text.isascii()


def parse_plain_decimal(text: str) -> float:
    """Parse a plain decimal such as ``-1.5`` or ``2e-3``.

    Args:
        text: Text of the number; blanks around it are passed over.

    Returns:
        The number.

    Raises:
        ValueError: the text is no number, not finite, too large, or has underscores or digits of other scripts.
    """
    word = text.strip()
    value = float(word)
    if not abs(value) < LARGEST or not is_plain(word):
        raise ValueError(f"found {word!r}; expected a finite decimal number")
    return value
