"""Parser of APT and cutter location statements: continuation lines, comments, major word and arguments."""

from __future__ import annotations

import re

from machopt.file_formats.plain_decimals import LARGEST, is_plain

COMMENT = "$$"
TEXT_WORDS = ("PARTNO", "PPRINT", "INSERT", "TPRINT", "REMARK", "LETTER", "MSG")
_HEAD = re.compile(r"[A-Z][A-Z0-9_\-]*(?: [A-Z]+|,[A-Z]+)?")
_SEPARATOR = re.compile(r"[,\s]+")


AptStatement = tuple[int, str, str]  # line, major word in upper case, text after the slash


def parse_statement_at(lines: list[str], at: int) -> tuple[int, list[AptStatement]]:
    """Parse the statement that begins at a line, and the comments in it.

    Comments have the word ``$$``; Creo's ``$$-> WORD / …`` are statements. A statement continued with ``$`` has the
    number of its first line. A line that does not begin with a word has its text as word: the reader counts it as
    not understood.

    Args:
        lines: Lines of the file.
        at: Index of the first line of the statement.

    Returns:
        Index of the line after the statement, and the statements.
    """
    found: list[AptStatement] = []
    joined, start = "", at + 1
    while at < len(lines):
        text = lines[at].strip()
        at += 1
        comment = text.find("$$")
        if comment == 0 and not joined:
            if not text.startswith("$$->"):
                found.append((at, COMMENT, text[2:]))
                return at, found
            text, comment = text[4:].strip(), -1
        if comment >= 0:
            found.append((at, COMMENT, text[comment + 2 :]))
            text = text[:comment].rstrip()
        if text.endswith("$"):
            joined += text[:-1]
            continue
        if text or joined:
            found.append((start, *split_statement(joined + text)))
        return at, found
    if joined:
        found.append((start, *split_statement(joined)))
    return at, found


def split_statement(text: str) -> tuple[str, str]:
    """Split one statement at its slash.

    Args:
        text: Text of the statement.

    Returns:
        Major word, and the text behind the slash.
    """
    head, slash, rest = text.partition("/")
    head = head.strip().upper()
    if slash and _HEAD.fullmatch(head):
        return head.partition(",")[0], rest  # TLON,GOFWD/ is a TLON
    upper = text.upper()
    for word in TEXT_WORDS:
        if upper.startswith(word):
            return word, text[len(word) :].lstrip(" /")
    if not slash and _HEAD.fullmatch(head):
        return head, ""
    return text.strip()[:32], ""


def split_fields(rest: str) -> list[str]:
    """Split the arguments of a statement.

    Blanks separate as commas do.

    Args:
        rest: Text behind the slash of the statement.

    Returns:
        Arguments in upper case; an empty text per missing argument.
    """
    found: list[str] = []
    for part in rest.split(","):
        words = part.split()
        found.extend(w.upper() for w in words) if words else found.append("")
    while found and not found[-1]:
        found.pop()
    return found


def parse_number(text: str) -> float | None:
    """Parse one field as a number.

    Args:
        text: Text of the field.

    Returns:
        The number; None where the field is a word or not finite.
    """
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < LARGEST and is_plain(text) else None


def parse_leading_numbers(parts: list[str]) -> tuple[list[float], list[str]]:
    """Parse the numbers that a statement begins with.

    Args:
        parts: Arguments of the statement.

    Returns:
        The numbers, and the arguments behind them.
    """
    values: list[float] = []
    for k, part in enumerate(parts):
        value = parse_number(part)
        if value is None:
            return values, parts[k:]
        values.append(value)
    return values, []


def parse_groups(rest: str) -> list[tuple[str, list[float]]]:
    """Parse the ``(WORD/numbers)`` groups of a drive statement such as ``(CIRCLE/x,y,z,r),ON,(LINE/…)``.

    Args:
        rest: Text behind the slash of the statement.

    Returns:
        Word and numbers of each group.
    """
    found: list[tuple[str, list[float]]] = []
    for word, inside in re.findall(r"\(\s*([A-Z]+)\s*/([^()]*)\)", rest.upper()):
        found.append((word, parse_leading_numbers([p for p in _SEPARATOR.split(inside.strip()) if p])[0]))
    return found


def parse_numbers(rest: str) -> list[float]:
    """Parse all arguments as numbers.

    Args:
        rest: Text behind the slash of the statement.

    Returns:
        The numbers.

    Raises:
        ValueError: one argument is not a number.
    """
    values, after = parse_leading_numbers(split_fields(rest))
    if after:
        raise ValueError(f"found {after[0] or 'an empty place'!r}; expected a number")
    return values


def try_parse_numbers(rest: str) -> list[float] | None:
    """Parse all arguments as numbers, if they are numbers.

    Args:
        rest: Text behind the slash of the statement.

    Returns:
        The numbers, None where one argument is not a number.
    """
    try:
        return parse_numbers(rest)
    except ValueError:
        return None
