"""Text that CL data passes to the control program (INSERT), and the codes of PREFUN and AUXFUN."""

from __future__ import annotations

import re

from machopt.toolpath.readers import harmless_words

AUXILIARY = frozenset((0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 14, 30))  # M words that every control knows: stops, spindle …
_COMMENT = re.compile(r"\([^)]*\)?|;.*")
_WORD = re.compile(r"(?:[A-Z]\s?[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))")
_FRAME = re.compile(
    r"\bG\s?[0-9]|\b(?:A?TRANS|A?ROTS?|A?SCALE|A?MIRROR|SUPA|PLANE|TRAORI|TRAFOOF|TOROT|TOFRAME)\b|\bCYCL(?:E[0-9]|\sDEF)|"
    r"\b(?:M128|FUNCTION\s+TCPM|CALL\s+(?:LBL|PGM))\b"
)
_HARMLESS = "NMSTFHDEP"


def has_nc_words(text: str) -> bool:
    """Return whether a text reads as words of a control program that may move axes or frames.

    A block is a text that consists of words such as ``X10.`` only. A sentence that mentions ``X40.`` is no block.

    Args:
        text: The inserted text.

    Returns:
        True where the text may move axes or frames.
    """
    code = _COMMENT.sub(" ", text.upper()).strip().strip("'\"")
    if _FRAME.search(code):
        return True
    words = [w.replace(" ", "") for w in _WORD.findall(code)]
    if not words or _WORD.sub("", code).strip(" %/"):
        return False
    return not all(_is_harmless(w) for w in words)


def _is_harmless(word: str) -> bool:
    if word[0] == "M":
        code = round(float(word[1:]))
        return code in AUXILIARY or code in harmless_words.M
    return word[0] in _HARMLESS
