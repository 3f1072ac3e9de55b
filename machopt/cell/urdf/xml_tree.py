"""XML tree with line numbers, read as URDF parsers do: raw names, no entities, no external files."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from machopt.errors import RobotModelError
from machopt.file_formats.file_reading import MARKUP, read_text

_DEEPEST = 100  # levels; a URDF has six, what its simulators add a dozen
_MOST = 500_000  # elements; the largest robots have some thousand


@dataclass
class XmlElement:
    """One element; ``text`` is the stripped text between its children."""

    tag: str  # as written, a prefix included
    attributes: dict[str, str]
    line: int  # of its first character, 1-based
    children: list[XmlElement] = field(default_factory=list)
    text: str = ""

    def find_children(self, tag: str) -> list[XmlElement]:
        """Return the child elements with a name.

        Args:
            tag: Name of the element.
        """
        return [c for c in self.children if c.tag == tag]

    def find_first_child(self, tag: str) -> XmlElement | None:
        """Return the first child element with a name, None where there is none.

        Args:
            tag: Name of the element.
        """
        return next((c for c in self.children if c.tag == tag), None)

    def descendants(self) -> list[XmlElement]:
        out = list(self.children)
        for c in out:  # grows while it is walked
            out.extend(c.children)
        return out


def read_markup(path: Path, expected: str) -> XmlElement:
    """Read the root element of an XML file.

    Args:
        path: Path of the file.
        expected: Description of the expected file, for messages.

    Returns:
        The root element.

    Raises:
        InputError: unreadable, not UTF-8, not well-formed, too deep, too large, or with entities or an external
            document type.
    """
    return parse_markup(read_text(path, expected=expected, most=MARKUP), path, expected)


def parse_markup(text: str, path: Path, expected: str) -> XmlElement:
    """Parse the root element of an XML text.

    Args:
        text: Text of the file.
        path: Path of the file.
        expected: Description of the expected file, for messages.

    Returns:
        The root element.

    Raises:
        RobotModelError: as for :func:`read_markup`.
    """
    if not text.strip():
        raise RobotModelError(f"is empty; expected {expected}", file=path)
    builder = _XmlTreeBuilder(path)
    try:
        builder.parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as problem:
        where = f"line {problem.lineno}, column {problem.offset + 1}"
        message = f"is not XML: {expat.ErrorString(problem.code)}{builder.expected()}"
        if not text.lstrip().startswith("<"):
            message += f"; expected {expected}"  # another file altogether
        raise RobotModelError(message, file=path, where=where) from None
    assert builder.root is not None  # a document without a root is an ExpatError
    return builder.root


def add_missing_prefixes(text: str) -> str | None:
    """Declare every namespace prefix that a URDF uses.

    Simulators add elements such as ``drake:acceleration``. URDF parsers read names literally; a parser with namespaces
    refuses an undeclared prefix.

    Args:
        text: Text of the file.

    Returns:
        The new text, None where all prefixes are declared.
    """
    used, declared, root = set[str](), {"xml", "xmlns"}, list[int]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        root.append(parser.CurrentByteIndex)
        for word in (tag, *attributes):
            prefix, mark, name = word.partition(":")
            if mark:
                (declared if prefix == "xmlns" else used).add(name if prefix == "xmlns" else prefix)

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = start
    raw = text.encode("utf-8")
    parser.Parse(raw, True)
    lacking = sorted(used - declared)
    if not lacking:
        return None
    tag = re.compile(rb"<[^\s/>]+").match(raw, root[0])
    assert tag is not None  # expat has read it
    added = "".join(f' xmlns:{p}="urn:{p}"' for p in lacking).encode()
    return (raw[: tag.end()] + added + raw[tag.end() :]).decode("utf-8")


class _XmlTreeBuilder:
    def __init__(self, path: Path) -> None:
        self.path, self._count = path, 0
        self.root: XmlElement | None = None
        self._open: list[XmlElement] = []
        self._texts: list[list[str]] = []  # pieces of text of each open element
        self.parser = expat.ParserCreate("utf-8")
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._add_text
        self.parser.StartDoctypeDeclHandler = self._check_doctype
        self.parser.EntityDeclHandler = self._refuse_entity

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        line = self.parser.CurrentLineNumber
        if len(self._open) >= _DEEPEST or self._count > _MOST:
            raise RobotModelError(
                f"is nested deeper than {_DEEPEST} levels or holds more than {_MOST} elements",
                file=self.path,
                where=f"line {line}",
            )
        element = XmlElement(tag, dict(attributes), line)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)
        self._texts.append([])

    def expected(self) -> str:
        """Closing tag of the open element, for messages; empty where none is open."""
        if not self._open:
            return ""
        last = self._open[-1]
        return f"; expected </{last.tag}>, which line {last.line} opens"

    def _end(self, _: str) -> None:
        self._open.pop().text = "".join(self._texts.pop()).strip()

    def _add_text(self, text: str) -> None:
        self._texts[-1].append(text)  # all of it: meshes have their numbers here

    def _check_doctype(self, name: str, system: str | None, public: str | None, internal: bool) -> None:
        if system or public or internal:
            self._refuse("declares a document type of its own")

    def _refuse_entity(self, *_: object) -> None:
        self._refuse("declares XML entities")

    def _refuse(self, what: str) -> None:
        raise RobotModelError(
            f"{what}; a plain URDF without <!DOCTYPE> and entities would work",
            file=self.path,
            where=f"line {self.parser.CurrentLineNumber}",
        )
