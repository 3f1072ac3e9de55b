"""Spelling suggestions for mistyped words, as in "did you mean …?".

A suggestion corrects a typing error; it never offers a word of another meaning. Words are split at hyphens,
underscores and dots and compared part by part. Digits, units and parts of one or two letters must be equal. A longer
part may differ by one error, from seven letters on by two. An error is a letter more, less or different, or two
letters exchanged; in parts of up to four letters a different letter is not accepted. A missing unit is accepted.
Another unit or another number of parts is not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

UNITS = frozenset(
    ("mm", "m", "um", "deg", "rad", "s", "ms", "min", "n", "nm", "nm2", "kn", "kg", "hz", "rpm", "percent")
)
OPPOSITE = (frozenset({"least", "most"}), frozenset({"first", "last"}), frozenset({"lower", "upper"}))
SHORT = 4  # letters up to which another letter makes another word: post and port, tcp and tip
LONG = 7  # letters from which on two slips are believed


def find_typo(word: str, valid: Sequence[str]) -> str | None:
    """Return the valid word that is nearest to a mistyped one; None where there is none.

    Args:
        word: The mistyped word.
        valid: The valid words.
    """
    found = [(slips, n) for n, known in enumerate(valid) if (slips := _compare_words(word, known)) is not None]
    return valid[min(found)[1]] if found else None


def _compare_words(word: str, known: str) -> float | None:
    """How many slips lie between two words; None where they differ by more than slips."""
    if word == known:
        return 0.0
    a, b = _split(word), _split(known)
    if a and "".join(a) == "".join(b):
        return 0.1  # case and separators only
    left_out = 0.0
    if not _find_unit(a) and _find_unit(b):
        b, left_out = b[: len(b) - len(_find_unit(b))], 0.5
    if not a or len(a) != len(b):
        return None
    total = left_out
    for one, other in zip(a, b, strict=True):
        slips = _compare_pieces(one, other)
        if slips is None:
            return None
        total += slips
    return total if total <= 2.5 else None


def _compare_pieces(a: str, b: str) -> int | None:
    if a == b:
        return 0
    if min(len(a), len(b)) <= 2 or a in UNITS or b in UNITS or re.sub(r"\D", "", a) != re.sub(r"\D", "", b):
        return None
    if frozenset({a, b}) in OPPOSITE or (len(a) == len(b) <= SHORT and sorted(a) != sorted(b)):
        return None
    slips = count_slips(a, b)
    return slips if slips <= (2 if len(b) >= LONG else 1) else None


def _split(word: str) -> list[str]:
    return [piece for piece in re.split(r"[-_.\s]+", word.lower()) if piece]


def _find_unit(pieces: Sequence[str]) -> Sequence[str]:
    """The units at the end, "rad_s" of "velocity_rad_s"; never the whole word."""
    n = len(pieces)
    while n > 1 and (pieces[n - 1] in UNITS or pieces[n - 1] == "per"):
        n -= 1
    return pieces[n:]


def count_slips(a: str, b: str) -> int:
    """Return the Damerau-Levenshtein distance (optimal string alignment).

    Args:
        a: The first word.
        b: The second word.
    """
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        last, row = row, [i]
        for j, y in enumerate(b, 1):
            best = min(last[j] + 1, row[j - 1] + 1, last[j - 1] + (x != y))
            if i > 1 and j > 1 and x == b[j - 2] and a[i - 2] == y:
                best = min(best, before[j - 2] + 1)
            row.append(best)
        before = last
    return row[-1]


def suggest_word(word: str, valid: Iterable[str]) -> str:
    """Return ``did you mean 'x'? `` or an empty text.

    Args:
        word: The mistyped word.
        valid: The valid words.
    """
    close = find_typo(word, list(valid))
    return f"did you mean {close!r}? " if close else ""
