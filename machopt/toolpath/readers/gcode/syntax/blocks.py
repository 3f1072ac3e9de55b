"""G-code text split into blocks: comments removed, words with their numbers, calls with their arguments."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError

Word = tuple[str, float]
_WORD = re.compile(r"\s*([A-Z])\s*([+-]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))")
_PLAIN = re.compile(r"(?:\s*[A-Z]\s*[+-]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))+\s*")
# A word may follow the number before it without a blank; E0.5 behind a number is a word E of its own (an extruder's).
_EXPONENT = re.compile(
    r"(?:(?<![A-Z0-9_\"])[A-Z][A-Z]?[0-9]?|(?<=[0-9.])[A-Z])\s*=?\s*[-+]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+)E[-+]?[0-9]+(?![0-9.])"
)
_QUOTED = re.compile(r"\"[^\"]*\"")
_COMMENT = re.compile(r"(?:[^;\"]|\"[^\"]*(?:\"|$))*")  # up to a semicolon that is not quoted
LARGEST = 1e15  # beyond it no length, angle or feed
_SLOW = re.compile(
    r"""\s*(?:
      (?P<switch>[MH][0-9]+)\s*\([^()]*\)
    | (?P<name>[A-Z][A-Z0-9_]*)\s*=\s*(?P<mode>AC|IC|DC|ACP|ACN)\s*\(\s*
      (?P<moded>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:EX[-+]?[0-9]+)?)\s*\)
    | (?P<text>[A-Z][A-Z0-9_]*)\s*=\s*"(?P<string>[^"]*)"
    | (?P<named>[A-Z][A-Z0-9_]*)\s*=\s*(?P<value>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:EX[-+]?[0-9]+)?)(?![\w*/+\-(.])
    | (?P<comma>,\s*[RCA])\s*(?P<size>[+-]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))
    | (?P<letter>[A-Z@^])\s*(?P<number>[+-]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:EX[-+]?[0-9]+)?)(?![0-9.]|[A-Z_]*[=(\[])
    | (?P<call>[A-Z_][A-Z0-9_]{2,}|CT(?=\s|$))\s*(?P<args>\((?:[^()"]|"[^"]*")*\))?
    )""",
    re.VERBOSE,
)


@dataclass(kw_only=True)
class ProgramBlock:
    """One line of a program."""

    line: int
    words: list[Word]
    calls: list[tuple[str, str]] = field(default_factory=list)  # (name, text in parentheses)
    named: dict[str, float] = field(default_factory=dict)  # CR, A3, B3, C3, TURN …
    modes: dict[str, str] = field(default_factory=dict)  # X → AC, IC, DC
    texts: dict[str, str] = field(default_factory=dict)  # T="MILL_10"
    junk: str = ""  # what is left and means nothing
    text: str = ""  # as written

    def words_but_number(self) -> bool:
        """Return whether the block has any word except its number."""
        return any(letter != "N" for letter, _ in self.words)

    def bare(self, letter: str) -> bool:
        """Return whether the number of a letter has no decimal point.

        Args:
            letter: The letter.
        """
        return re.search(rf"{letter}\s*[-+]?\s*[0-9]+(?![0-9.])", self.text) is not None


class BlockReader:
    """Splits lines."""

    def __init__(self, *, parentheses_are_comments: bool) -> None:
        self.parentheses_are_comments = parentheses_are_comments
        self.unclosed = False  # a parenthesis in the line read last

    def comments(self, text: str) -> tuple[str, list[str]]:
        """Separate a line and its comments.

        A semicolon inside parentheses is part of that comment. Parentheses behind a semicolon are part of that comment.
        ``unclosed`` records whether a parenthesis of this line is not closed: the rest of the line is then comment.

        Args:
            text: Text of the line.

        Returns:
            The line without its comments, and the comments.
        """
        self.unclosed = False
        if not self.parentheses_are_comments:
            if ";" not in text:
                return text, []
            at = _COMMENT.match(text).end() if '"' in text else text.index(";")  # type: ignore[union-attr]
            return text[:at], [text[at + 1 :].strip()] if text[at : at + 1] == ";" else []
        found: list[str] = []
        code_parts: list[str] = []
        depth = start = 0
        for k, c in enumerate(text):
            if c == "(":
                if depth == 0:
                    code_parts.append(text[start:k])
                    start = k + 1
                depth += 1
            elif c == ")" and depth:
                depth -= 1
                if depth == 0:
                    found.append(text[start:k].strip())
                    start = k + 1
            elif c == ";" and depth == 0:
                code_parts.append(text[start:k])
                found.append(text[k + 1 :].strip())
                return " ".join(code_parts), found
        self.unclosed = depth > 0
        (found if depth else code_parts).append(text[start:].strip() if depth else text[start:])
        return " ".join(code_parts), found

    def block(self, line: int, text: str) -> ProgramBlock:
        """Parse the words of one line.

        Args:
            line: Line number in the file (1-based).
            text: Line in upper case without comments and expressions.

        Returns:
            The block.

        Raises:
            MacroExpressionError: a number is malformed.
        """
        if _PLAIN.fullmatch(text):
            return ProgramBlock(
                line=line, words=[(a, float("".join(n.split()))) for a, n in _WORD.findall(text)], text=text
            )
        return self._parse_slowly(line, text)

    def _parse_slowly(self, line: int, text: str) -> ProgramBlock:
        block = ProgramBlock(line=line, words=[], text=text)
        at = 0
        text = text.rstrip()
        while at < len(text):
            found = _SLOW.match(text, at)
            if not found:
                block.junk = text[at:].strip()
                break
            at = found.end()
            g = found.groupdict()
            if g["switch"]:
                block.words.append((g["switch"][0], float(g["switch"][1:])))
            elif g["mode"]:
                value = _parse_number(g["moded"])
                block.modes[g["name"]] = g["mode"]
                block.words.append((g["name"], value)) if len(g["name"]) == 1 else block.named.update(
                    {g["name"]: value}
                )
            elif g["text"]:
                block.texts[g["text"]] = g["string"]
            elif g["named"]:
                if len(g["named"]) == 1:
                    block.words.append((g["named"], _parse_number(g["value"])))
                else:
                    block.named[g["named"]] = _parse_number(g["value"])
            elif g["comma"]:
                block.named["," + g["comma"][-1]] = _parse_number(g["size"])
            elif g["letter"]:
                block.words.append((g["letter"], _parse_number(g["number"])))
            else:
                block.calls.append((g["call"], (g["args"] or "").strip("()").strip()))
        return block


def _parse_number(text: str) -> float:
    """A number with blanks in it; ``EX`` is Sinumerik's exponent."""
    value = float("".join(text.split()).replace("EX", "e"))
    if not abs(value) < LARGEST:
        raise MacroExpressionError(f"{text} is not a number of a sane size")
    return value


def refuse_exponent(text: str) -> None:
    """Refuse ``Z-5.0E-1``: a control reads −5 and a word E, or nothing.

    Args:
        text: Code in upper case.

    Raises:
        MacroExpressionError: the code holds such a number.
    """
    found = _EXPONENT.search(_QUOTED.sub("", text))
    if found:
        raise MacroExpressionError(
            f"{found.group()!r}: numbers with an exponent are none on this control (it would read "
            f"{found.group().partition('E')[0]} and a word E); post them as plain decimals"
        )
