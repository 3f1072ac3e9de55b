"""Link pairs that an SRDF disables: ``disable_collisions``, and the defaults of its newer form.

``<disable_default_collisions link="a"/>`` disables a link against all others; ``<enable_collisions>`` enables one of
these pairs again.

Source: MoveIt's srdfdom, urdf of the planning scene's allowed collision matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from machopt.cell.urdf.xml_tree import XmlElement, read_markup
from machopt.errors import RobotModelError

_PAIR = ("disable_collisions", "enable_collisions")


@dataclass(frozen=True)
class DisabledLinkPair:
    """Two links that may touch."""

    link1: str
    link2: str
    reason: str  # as the file gives it: Adjacent, Never, Default, User; empty where it gives none
    line: int


def read_srdf(path: Path, links: tuple[str, ...]) -> tuple[DisabledLinkPair, ...]:
    """Pairs of an SRDF, each once.

    Args:
        path: the file.
        links: of the URDF it belongs to; a default counts against all of them.

    Raises:
        InputError: no SRDF, or an element without its links; names file and line.
    """
    root = read_markup(path, "an SRDF")
    if root.tag != "robot":
        raise RobotModelError(
            f"found the root element <{root.tag}>; an SRDF starts with <robot>", file=path, where=f"line {root.line}"
        )
    found: dict[frozenset[str], DisabledLinkPair] = {}
    for e in root.find_children("disable_default_collisions"):
        link = _read_attribute(path, e, "link")
        for other in links:
            if other != link:
                found.setdefault(frozenset((link, other)), DisabledLinkPair(link, other, "Default", e.line))
    for e in root.children:
        if e.tag in _PAIR:
            a, b = _read_attribute(path, e, "link1"), _read_attribute(path, e, "link2")
            if e.tag == "enable_collisions":
                found.pop(frozenset((a, b)), None)
            elif a != b:
                found[frozenset((a, b))] = DisabledLinkPair(a, b, e.attributes.get("reason", ""), e.line)
    return tuple(found.values())


def _read_attribute(path: Path, e: XmlElement, key: str) -> str:
    if not e.attributes.get(key):
        raise RobotModelError(f"<{e.tag}> has no {key!r}; a link's name would work", file=path, where=f"line {e.line}")
    return e.attributes[key]
