"""Staubli VAL3 applications: the programs (.pgx) and data (.dtx) of a project (.pjx), without formulas and branches."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from machopt.errors import FileFormatError
from machopt.file_formats.source_file import SourceFile
from machopt.numerics.array_types import Array
from machopt.programs.reading.called_files import find_sibling_files, try_read_source
from machopt.programs.reading.move_attributes import MoveAttributes, parse_number
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import build_pose_matrix, compute_moving_xyz_rotation
from machopt.programs.staubli.harmless_words import VAL3, VAL3_TYPES

_ITEM = re.compile(r"\s*([A-Za-z_]\w*)\s*(?:\[\s*([0-9]+)\s*\])?\s*")
_CALL = re.compile(r"(?:\w+\s*=\s*)?(?:call\s+)?([A-Za-z_]\w*)\s*\((.*)\)")
_ASSIGNED = re.compile(
    r"(?:\s*(?:num|bool|string)\s+)?([A-Za-z_]\w*)\s*(?:\[[^\]]*\])?((?:\.\w+)*)\s*[-+*/&|]?=(?!=).*"
)
_BLOCK = re.compile(r"(if|for|while|do|switch)\b")
_DEEPEST = 20
_EVENTS = frozenset(("open", "close", "watch", "wait", "setDio", "aioSet", "dioSet"))
MOST_FRAMES = 20


@dataclass
class Val3Application:
    """Everything a project's files hold."""

    data: dict[str, tuple[str, dict[int, dict[str, str]]]] = field(default_factory=dict)  # name: type, values by key
    programs: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    locals: dict[str, str] = field(default_factory=dict)  # type of each local variable
    files: list[Path] = field(default_factory=list)


def read_val3(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read an application from its .pjx, or from one .pgx with the data file of the same folder.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames, events and unknown words of the program.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    return _Val3Reader(
        ProgramBuilder(
            source=source,
            dialect="val3",
            arc_tolerance=arc_tolerance,
            strict=strict,
            has_external_values_in_comments=True,
        )
    ).run()


class _Val3Reader:
    def __init__(self, out: ProgramBuilder) -> None:
        self.out, self.app = out, Val3Application()

    def run(self) -> ParsedProgram:
        source = self.out.source
        root = _parse_xml(source)
        start = "start"
        if root.tag == "Project":
            for item in root.iter():
                if item.tag in ("Program", "Data"):
                    self.add(item.get("file", ""), source)
            self.out.name = source.path.stem
        elif root.tag == "Programs":
            names = self.take(root, source)
            start = "start" if "start" in names or not names else names[0]
            for file in find_sibling_files(source.path, (".dtx", ".pgx")):
                other = try_read_source(file)
                if other is not None:
                    self.take(_parse_xml(other), other)
                    self.out.files.append(file)
            self.out.name = source.path.parent.name or source.path.stem
        else:
            raise self.out.error("is data without a program; give the .pjx or the .pgx that moves to its points")
        if start not in self.app.programs:
            raise self.out.error(f"has no program {start!r}; found {', '.join(sorted(self.app.programs)) or 'none'}")
        self.follow(start, 0)
        return self.out.build()

    def add(self, name: str, source: SourceFile) -> None:
        """Add a file of the project, from the same folder."""
        path = source.path.parent / name
        if not name or Path(name).name != name:
            raise self.out.error(f"names the file {name!r}; expected a file in the folder of the project")
        other = try_read_source(path) if path.is_file() else None
        if other is None:
            raise self.out.error(f"names {name}, which is not in its folder")
        self.take(_parse_xml(other), other)
        self.out.files.append(path)

    def take(self, root: ET.Element, source: SourceFile) -> list[str]:
        """Take in programs and data of one file; returns the programs' names."""
        names = []
        for item in root.iter():
            if item.tag == "Program" and item.get("name"):
                code = "".join(c.text or "" for c in item.iter() if c.tag == "Code")
                first = _find_line(source, code)
                self.app.programs[str(item.get("name"))] = list(enumerate(code.split("\n"), first))
                names.append(str(item.get("name")))
            elif item.tag in ("Local", "Parameter") and item.get("name"):
                self.app.locals[str(item.get("name"))] = str(item.get("type"))
            elif item.tag == "Data" and item.get("name"):
                values = {}
                for value in item.iter():
                    if value.tag == "Value":
                        key = parse_number(value.get("key", ""))
                        if key is None or key != int(key):
                            raise self.out.error(f"Value of {item.get('name')} has no key", None, source)
                        values[int(key)] = dict(value.attrib)
                self.app.data[str(item.get("name"))] = (str(item.get("type")), values)
        return names

    # ---- following

    def follow(self, name: str, depth: int) -> None:
        if depth > _DEEPEST:
            raise self.out.error(f"{name} calls itself, or calls are nested more than {_DEEPEST} deep")
        inside = 0
        for line, raw in self.app.programs[name]:
            code, slashes, comment = raw.partition("//")
            code = code.strip()
            if slashes:
                self.out.comment(comment.strip())
            if not code:
                continue
            self.out.step(line)
            if _BLOCK.match(code):
                inside += 1
                self.out.ignore(f"{code.split(' ')[0]} …", line, understood=True)
            elif re.match(r"end(?:If|For|While|Switch)\b|until\b", code):
                inside = max(inside - 1, 0)
            else:
                self.statement(code, line, depth, inside > 0)

    def statement(self, code: str, line: int, depth: int, inside: bool) -> None:
        found = _CALL.fullmatch(code)
        assigned = _ASSIGNED.fullmatch(code)
        if assigned and not (found and found.group(1) in ("movej", "movel", "movec", *self.app.programs)):
            self.assign(assigned.group(1), line)
            return
        word = found.group(1) if found else code.split(" ", maxsplit=1)[0]
        if found is None:
            known = word in ("begin", "end", "else", "return", "local", "num", "string", "bool")
            self.out.ignore(word, line, understood=known)
            return
        if word in ("movej", "movel", "movec"):
            if inside:
                raise self.out.error(
                    f"{word} inside a branch or loop: which moves are made cannot be known here; "
                    "expand the program first",
                    line,
                )
            self.motion(word, [a.strip() for a in found.group(2).split(",")], line)
        elif word in self.app.programs:
            if inside:
                raise self.out.error(f"{word} is called inside a branch or loop; expand the program first", line)
            self.follow(word, depth + 1)
        elif word == "delay":
            seconds = parse_number(found.group(2).strip())
            self.out.event(code, "dwell", math.nan if seconds is None else seconds)
        elif word in _EVENTS:
            self.out.event(code, "comment")
        else:
            self.out.ignore(word, line, understood=word in VAL3)

    def assign(self, name: str, line: int) -> None:
        """A variable gets a value while the robot runs: points, frames, tools and speeds may not.

        Raises:
            InputError: it is one of those.
        """
        kind = self.app.data[name][0] if name in self.app.data else self.app.locals.get(name, "")
        if kind and kind not in VAL3_TYPES:
            raise self.out.error(
                f"{name} ({kind}) is changed while the robot runs: not followed; post the points where they lie", line
            )
        self.out.ignore(f"{name} =", line, understood=kind in VAL3_TYPES)

    # ---- data

    def item(self, text: str, line: int) -> tuple[str, str, dict[str, str]]:
        """Name, type and value of ``name[index]``."""
        found = _ITEM.fullmatch(text)
        if found is None:
            raise self.out.error(f"{text[:30]!r}: formulas are not evaluated; expand the program first", line)
        name, index = found.group(1), int(found.group(2) or 0)
        if name not in self.app.data:
            raise self.out.error(f"{name} is in none of the data files read", line)
        kind, values = self.app.data[name]
        return f"{name}[{index}]", kind, values.get(index, {})

    def numbers(self, values: dict[str, str], names: str, line: int, what: str) -> list[float]:
        """Attributes as numbers; VAL3 leaves out those that are zero."""
        out = []
        for name in names.split():
            value = parse_number(values.get(name, "0"))
            if value is None:
                raise self.out.error(f"{name} of {what} is {values[name][:20]!r}; expected a number", line)
            out.append(value)
        return out

    def build_pose(self, values: dict[str, str], line: int, what: str) -> Array:
        x, y, z, rx, ry, rz = self.numbers(values, "x y z rx ry rz", line, what)
        return build_pose_matrix(compute_moving_xyz_rotation(rx, ry, rz), x * 1e-3, y * 1e-3, z * 1e-3)

    def parent(self, name: str, line: int) -> tuple[str, Array]:
        """A frame or tool by its name, in the world or the flange."""
        out, base = np.eye(4), name
        for _ in range(MOST_FRAMES):
            if name in ("", "world[0]", "flange[0]"):
                return base or "world[0]", out
            label, _, values = self.item(name, line)
            out = self.build_pose(values, line, label) @ out
            name = values.get("fatherId", "")
        raise self.out.error(f"{base} refers to itself through other frames", line)

    def motion(self, word: str, texts: list[str], line: int) -> None:
        count = 2 if word == "movec" else 1
        if len(texts) != count + 2:
            raise self.out.error(f"{word} with {len(texts)} arguments; expected {count + 2}", line)
        targets = [self.item(t, line) for t in texts[:count]]
        tool, _, tool_values = self.item(texts[count], line)
        T_tool = self.build_pose(tool_values, line, tool)
        father = tool_values.get("fatherId", "flange[0]")
        self.out.set_tool(
            ProgramFrame(tool, self.parent(father, line)[1] @ T_tool if father != "flange[0]" else T_tool)
        )
        speed, _, motion = self.item(texts[-1], line)
        most, leave = self.numbers(motion, "tmax leave", line, speed)
        blend = leave * 1e-3 if motion.get("blend", "off").lower() not in ("off", "") else 0.0
        kind = JOINT if word == "movej" else LINEAR
        feed = most * 1e-3 if kind == LINEAR and "tmax" in motion and most < 99998.0 else math.nan
        name, what, values = targets[-1]
        if what == "jointRx":
            if kind == LINEAR:
                raise self.out.error(f"{word} goes to {name}, a joint position", line)
            self.out.joint(self.numbers(values, "j1 j2 j3 j4 j5 j6", line, name), line, MoveAttributes(blend=blend))
            return
        poses = []
        for label, kind_of, attributes in targets:
            if kind_of != "pointRx":
                raise self.out.error(f"{label} is a {kind_of}; expected a pointRx", line)
            poses.append(self.build_pose(attributes, line, label))
        base, T_base = self.parent(values.get("fatherId", "world[0]"), line)
        self.out.set_base(ProgramFrame(base, T_base))
        bits: dict[str, object] = {k: values[k] for k in ("shoulder", "elbow", "wrist") if k in values}
        given = MoveAttributes(feed=feed, blend=blend, configuration=bits)
        if word == "movec":
            self.out.circle(poses[0], poses[1], line, given)
            return
        self.out.add_pose_move(kind, poses[0], line, given)


def _parse_xml(source: SourceFile) -> ET.Element:
    """The file's root, namespaces taken off.

    Raises:
        InputError: it is no XML, or declares entities.
    """
    text = "\n".join(source.lines)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise source.build_error("declares a document type; VAL3 files have none")
    try:
        root = ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except ET.ParseError as problem:
        line, column = problem.position
        raise FileFormatError(
            f"is not XML: {problem.msg}", file=source.path, where=f"line {line}, column {column}"
        ) from None
    for item in root.iter():
        item.tag = item.tag.rsplit("}", 1)[-1] if isinstance(item.tag, str) else ""
    return root


def _find_line(source: SourceFile, code: str) -> int:
    """The line a program's code begins on."""
    first = next((t for t in code.split("\n") if t.strip()), "")
    before = len(code) - len(code.lstrip("\n"))
    for n, line in enumerate(source.lines, 1):
        if first and line == first:
            return n - before
    return 1
