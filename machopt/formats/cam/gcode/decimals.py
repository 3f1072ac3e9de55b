"""Numbers without a decimal point, which one control reads as whole millimetres and another as thousandths of one.

Fanuc, Haas and others decide by a parameter whether ``X1500`` is 1500 mm or 1.5 mm; old programs leave out trailing
or leading zeros (``X0019685``). Where what stands in the file makes the whole-number reading doubtful, it is asked for.
"""

from __future__ import annotations

import dataclasses
import re

from machopt.formats.source import Source

_CODE = r"(?<![A-Z#<_.\d])"
_LEADING = re.compile(_CODE + r"[XYZUVWIJR]\s*[-+]?\s*0(?=\d\d)\d*[1-9]\d*(?![\d.])", re.IGNORECASE)
_BIG = re.compile(_CODE + r"[XYZUVWIJR]\s*[-+]?\s*[1-9]\d{3,}(?![\d.])", re.IGNORECASE)
_POINT = re.compile(_CODE + r"[XYZ]\s*[-+]?\s*\d*\.\d", re.IGNORECASE)
_WHOLE_WITH_POINT = re.compile(_CODE + r"[XYZ]\s*[-+]?\s*\d+\.(?!\d)", re.IGNORECASE)
_EXPRESSIONS = re.compile(r"[#\[]|^\s*O\s*<", re.IGNORECASE | re.MULTILINE)  # LinuxCNC and macros: whole numbers are
_WHOLE = re.compile(_CODE + r"[XYZUVWIJR]\s*[-+]?\s*[1-9]\d*(?![\d.])", re.IGNORECASE)
_DWELL = re.compile(r"G0*4(?![\d.])", re.IGNORECASE)
_LARGE = 10_000  # without a point beside numbers that have one: ten metres, or ten inches in ten-thousandths
_BARE = re.compile(_CODE + r"([XYZUVWIJKRABCQ])(\s*)([-+]?)\s*(\d+)(?![\d.])", re.IGNORECASE)
_CYCLE = re.compile(r"G(?:7[346]|8[1-9])(?!\d)", re.IGNORECASE)


def check_decimals(source: Source) -> None:
    """Ask for the decimals of a G-code file where they are in doubt.

    In doubt are numbers with leading zeros, any whole number in a file that marks most of its whole numbers (``X5.``),
    large ones in a file whose other numbers have points, and 1000 and more in a file without any.

    Raises:
        InputError: they are; names the first such number.
    """
    at, what = _first(source, _LEADING, 1), "a number has leading zeros and no decimal point"
    if at is None:
        at, what = _large(source)
    if at is None:
        at, what = _odd(source)
    if at is None:
        return
    raise source.error(
        f"{what}: by the control's parameters that counts whole units or decimals of one. Give --decimals N (4: the "
        "last digit is a ten-thousandth, usual for inches; 3: a thousandth, usual for mm; 0: as it stands)",
        at,
    )


def _large(source: Source) -> tuple[int | None, str]:
    if source.find(_BIG) is None or source.find(_EXPRESSIONS) is not None:
        return None, ""
    without = source.find(_POINT) is None and source.find(_WHOLE_WITH_POINT) is None
    marked = source.find(_WHOLE_WITH_POINT) is not None
    at = _first(source, _BIG, 1000 if without or marked else _LARGE)
    found = "" if at is None else next(m for m in _BIG.findall(_code(source.lines[at - 1])))
    why = "no number of the file has a decimal point" if without else "other numbers of the file have a decimal point"
    return at, f"{found.strip()} has no decimal point ({why})"


def _odd(source: Source) -> tuple[int | None, str]:
    """The first bare whole number where the file marks most of them: its writer knew what the point is for."""
    if source.find(_WHOLE) is None or source.find(_WHOLE_WITH_POINT) is None or source.find(_EXPRESSIONS) is not None:
        return None, ""
    marked = bare = 0
    at, found = None, ""
    for line, raw in enumerate(source.lines, 1):
        text = _code(raw)
        marked += len(_WHOLE_WITH_POINT.findall(text))
        if _DWELL.search(text) is None and (here := _WHOLE.findall(text)):
            bare += len(here)
            if at is None:
                at, found = line, here[0].strip()
    if marked <= 2 * bare:  # written both ways: the point means nothing to the writer
        return None, ""
    return at, f"{found} has no decimal point ({marked} whole numbers have one, {bare} have none)"


def _first(source: Source, pattern: re.Pattern[str], least: int) -> int | None:
    """The first line whose code holds a number of that kind that is not smaller than ``least``."""
    if source.find(pattern) is None:
        return None
    for line, text in enumerate(source.lines, 1):
        for found in pattern.findall(_code(text)) if pattern.search(text) else ():
            if int(re.sub(r"\D", "", found)) >= least:
                return line
    return None


def _code(text: str) -> str:
    return re.sub(r"\([^()]*\)", " ", text.partition(";")[0])


def with_points(source: Source, decimals: int) -> Source:
    """The file with a decimal point in every length and angle that has none; 0 decimals: as it is.

    F, S, P and what counts something (K and L of cycles) stay.
    """
    if decimals == 0:
        return source
    return dataclasses.replace(source, lines=[_pointed(t, decimals) for t in source.lines])


def _pointed(text: str, decimals: int) -> str:
    cycle = _CYCLE.search(text) is not None

    def point(found: re.Match[str]) -> str:
        letter, blank, sign, digits = found.groups()
        if (letter in "Kk" and cycle) or (letter in "Qq" and not cycle):
            return found.group()
        digits = digits.zfill(decimals + 1)
        return f"{letter}{blank}{sign}{digits[:-decimals]}.{digits[-decimals:]}"

    parts = re.split(r"(\([^()]*\)|;.*)", text)  # comments stay
    return "".join(p if k % 2 else _BARE.sub(point, p) for k, p in enumerate(parts))
