"""YAML text as nodes, with rows of plain numbers left as text: a matrix of a stiffness file is most of its tokens.

Each row of numbers on one line is replaced by a mark before ruamel.yaml reads the text. Where a mark is anything but
a whole value afterwards, as inside a text or a key, the text is read without marks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

MAX_DEPTH = 100  # levels of lists and mappings; a cell has six
_NUMBER = r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
_ROW = re.compile(rf"(?<![^\s\[,])\[ *{_NUMBER}(?: *, *(?:\n +)?{_NUMBER})* *\](?![^\s,\]}}])")  # not $OUT[5]
_MARK = "\ue000"  # private use: YAML allows it, and hardly any file holds it
_WHOLE = re.compile(f"{_MARK}[0-9]+{_MARK}")


@dataclass(frozen=True)
class ComposedText:
    """Nodes of a YAML text."""

    node: Any  # of ruamel.yaml, None where the text holds nothing
    rows: tuple[str, ...] = ()  # rows of numbers as written, in the order of their marks

    def find_row(self, node: Any) -> tuple[tuple[str, int], ...] | None:
        """Return the numbers as written of a scalar node that represents a row, each with its line behind the first.

        None for another node.

        Args:
            node: The scalar node.
        """
        if not self.rows or node.style is not None or not node.value.startswith(_MARK):
            return None
        words, line = [], 0
        for word in self.rows[int(node.value[1:-1])][1:-1].split(","):
            line += word.count("\n")
            words.append((word.strip(" \n"), line))
        return tuple(words)


def compose_text(text: str) -> ComposedText:
    """Return the nodes of a text.

    Args:
        text: YAML 1.2.

    Raises:
        YAMLError: of ruamel.yaml; it is no YAML.
        RecursionError: it is nested too deeply.
    """
    marked = None if _MARK in text else _compose_with_marks(text)
    return ComposedText(_compose_nodes(text, MAX_DEPTH)) if marked is None else marked


def _compose_with_marks(text: str) -> ComposedText | None:
    """Nodes with a mark for each row; None where there is no row, and where the text must be read as it is."""
    from ruamel.yaml.error import YAMLError

    rows: list[str] = []

    def mark(found: re.Match[str]) -> str:
        if "\n" in found[0] and "#" in text[text.rfind("\n", 0, found.start()) + 1 : found.start()]:
            return found[0]  # a comment ends with its line
        rows.append(found[0])
        return f"{_MARK}{len(rows) - 1}{_MARK}" + "\n" * found[0].count("\n")  # what follows keeps its line

    short = _ROW.sub(mark, text)
    if not rows:
        return None
    try:
        node = _compose_nodes(short, MAX_DEPTH - 1)  # a row is a level
    except (YAMLError, RecursionError):
        return None  # reading the text itself states the error
    return ComposedText(node, tuple(rows)) if all(map(_is_mark_whole, _list_nodes(node))) else None


def _list_nodes(node: Any) -> Iterator[tuple[Any, bool]]:
    """Every node once, and whether it is a key."""
    seen, waiting = set[tuple[int, bool]](), [(node, False)]
    while waiting:
        one, is_key = waiting.pop()
        if one is None or (id(one), is_key) in seen:
            continue
        seen.add((id(one), is_key))
        yield one, is_key
        if not isinstance(one.value, str):
            for child in one.value:
                waiting += [(child[0], True), (child[1], False)] if isinstance(child, tuple) else [(child, False)]


def _is_mark_whole(listed: tuple[Any, bool]) -> bool:
    node, is_key = listed
    if _MARK in f"{node.anchor}{node.tag}":
        return False
    if not isinstance(node.value, str) or _MARK not in node.value:
        return True
    return not is_key and node.style is None and _WHOLE.fullmatch(node.value) is not None


def _compose_nodes(text: str, depth: int) -> Any:
    from ruamel import yaml as ruamel

    yaml = ruamel.YAML(typ="safe", pure=True)
    yaml.version = (1, 2)
    yaml.max_depth = depth  # from ruamel.yaml 0.18.7 on; before, Python's own limit ends the parser
    return yaml.compose(text)
