"""Reader of Universal Robots scripts: executes the functions from their call, without branches on inputs."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.line_by_line_execution import DEEPEST, LineFollower
from machopt.programs.reading.line_comments import split_comment
from machopt.programs.reading.move_attributes import MoveAttributes, ProgramEnd
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import build_pose_matrix
from machopt.programs.universal_robots.expression_values import (
    ScriptPose,
    ScriptValueError,
    UnknownValue,
    evaluate_expression,
    parse_arguments,
)
from machopt.programs.universal_robots.harmless_words import URSCRIPT

_DEF = re.compile(r"(def|thread)\s+(\w+)\s*\((.*)\)\s*:")
_ASSIGN = re.compile(r"(?:global\s+|local\s+)?([A-Za-z_]\w*)\s*=(?!=)\s*(.+)")
_CALL = re.compile(r"([A-Za-z_]\w*)\s*\((.*)\)")
_OPENS = ("if", "while", "for", "sec", "switch")
_MOVES = ("movej", "movel", "movep", "movec", "servoj", "servoc", "speedj", "speedl", "optimovej", "optimovel")
_QUIET = re.compile("(?:" + "|".join(map(re.escape, URSCRIPT)) + r")\w*")
_VALUES = re.compile(r"(?:get_|is_|read_|to_|str_|norm|size|random|sqrt|floor|ceil|sin|cos|tan|atan|acos|asin)\w*")
_EVENT = re.compile(r"set_\w*(?:digital_out|analog_out|flag)\w*|write_output\w*")
_RUN = re.compile(r"\brun\s+([A-Za-z_]\w*)\s*\(")
_ELEMENT = re.compile(r"([A-Za-z_]\w*)\s*\[([^\[\]]+)\]\s*=(?!=)\s*(.+)")
_OFF_TARGET = (
    "force_mode",
    "path_offset_enable",
    "conveyor_pulse_decode",
    "track_conveyor_linear",
    "track_conveyor_circular",
    "freedrive_mode",
    "teach_mode",
)
_FRAMES = ("set_tcp", "set_reference", *_OFF_TARGET)


@dataclass(frozen=True)
class ScriptLine:
    number: int
    code: str
    comment: str


@dataclass
class ScriptFunction:
    """A function: its own lines, without those of functions defined inside it."""

    name: str
    parameters: tuple[str, ...] = ()
    lines: list[ScriptLine] = field(default_factory=list)
    ends: dict[int, int] = field(default_factory=dict)
    thread: bool = False

    @property
    def source(self) -> None:
        """The main file: a script is one file."""


def read_urscript(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a script.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames, events and unknown words of the program.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    return _ScriptReader(
        ProgramBuilder(source=source, dialect="urscript", arc_tolerance=arc_tolerance, strict=strict)
    ).run()


class _ScriptReader(LineFollower[ScriptFunction]):
    value_error = ScriptValueError

    def __init__(self, out: ProgramBuilder) -> None:
        self.out = out
        self.bodies: dict[str, ScriptFunction] = {}
        self.top = ScriptFunction("")
        self.returned = False  # a return was reached in the function that is followed
        self.memory: dict[str, object] = {"True": 1.0, "False": 0.0, "pi": math.pi}

    def run(self) -> ParsedProgram:
        self.load()
        self.out.set_base(ProgramFrame("base", np.eye(4)))
        with suppress(ProgramEnd):
            self.follow(self.top, 0, len(self.top.lines), 0)
        if not len(self.out):  # defined and not called: a controller runs the one that was sent
            called = {c.group(1) for b in self.bodies.values() for line in b.lines if (c := _CALL.fullmatch(line.code))}
            free = [b for b in self.bodies.values() if b.name not in called and not b.thread]
            moving = [b for b in free if self.moves(b)]
            if len(moving) > 1:
                raise self.out.error(
                    f"defines {len(moving)} programs that nothing calls "
                    f"({', '.join(b.name for b in moving[:5])}); "
                    "keep the one to be read, or call them in their order"
                )
            for body in moving:
                self.out.name = body.name
                with suppress(ProgramEnd):
                    self.follow(body, 0, len(body.lines), 0)
        return self.out.build()

    def load(self) -> None:
        stack: list[tuple[ScriptFunction, str, int]] = [(self.top, "", 0)]
        for n, raw in enumerate(self.out.source.lines, 1):
            code, comment = split_comment(raw, "#")
            body = stack[-1][0]
            word = re.match(r"\w*", code).group(0)  # type: ignore[union-attr]
            if found := _DEF.fullmatch(code):
                names = tuple(p.split("=")[0].strip() for p in found.group(3).split(",") if p.strip())
                inner = ScriptFunction(found.group(2), names, thread=found.group(1) == "thread")
                self.bodies.setdefault(inner.name, inner)
                stack.append((inner, "def", 0))
                continue
            if word in _OPENS and code.endswith(":"):
                body.lines.append(ScriptLine(n, code, comment))
                stack.append((body, word, len(body.lines) - 1))
                continue
            if code == "end":
                if len(stack) == 1:
                    raise self.out.error("end without its beginning", n)
                owner, what, at = stack.pop()
                if what != "def":
                    owner.lines.append(ScriptLine(n, code, comment))
                    owner.ends[at] = len(owner.lines) - 1
                continue
            if code or comment:
                body.lines.append(ScriptLine(n, code, comment))
        if len(stack) > 1:
            raise self.out.error(
                f"{len(stack) - 1} blocks have no end: the file may be cut off", len(self.out.source.lines)
            )

    def moves(self, body: ScriptFunction, depth: int = 0) -> bool:
        for line in body.lines:
            found = _CALL.search(line.code)
            if found is None or depth > DEEPEST:
                continue
            if found.group(1) in _MOVES:
                return True
            inner = self.bodies.get(found.group(1))
            if inner is not None and inner is not body and self.moves(inner, depth + 1):
                return True
        return False

    def statement(self, body: ScriptFunction, k: int, depth: int) -> int:
        line = body.lines[k]
        code = line.code
        if k in body.ends:
            inside = ScriptFunction("", lines=body.lines[k + 1 : body.ends[k]])
            for i in inside.lines:
                if i.code.split(" ")[0] in ("return", "halt"):
                    self.out.may_end(i.number)
            if self.moves(inside):
                raise ScriptValueError(
                    f"{code[:30]!r} decides about moves while the robot runs: they are not "
                    "known here; expand the program first"
                )
            self.not_followed(inside, code)
            self.out.ignore(f"{code.split()[0]} without moves inside", line.number, understood=True)
            return body.ends[k]
        if (started := _RUN.search(code)) and started.group(1) in self.bodies:
            if self.moves(self.bodies[started.group(1)]):
                raise ScriptValueError(f"run {started.group(1)}: a thread that moves the robot is not followed")
            self.not_followed(self.bodies[started.group(1)], code)
        if found := _ELEMENT.fullmatch(code):
            self.memory[found.group(1)] = self.with_element(*found.groups())
        elif found := _ASSIGN.fullmatch(code):
            self.memory[found.group(1)] = evaluate_expression(found.group(2), self.memory, quietly=True)
        elif found := _CALL.fullmatch(code):
            self.call(found.group(1), found.group(2), line, depth)
        elif code == "halt":
            self.out.end_program(code)
        elif code.split(" ")[0] == "return":
            self.returned = True
        else:
            quiet = code.split(" ")[0] in ("return", "global", "local", "run", "kill", "join", "pass", "elif", "else:")
            self.out.ignore(code.split(" ")[0], line.number, understood=quiet)
        return k

    def with_element(self, name: str, index: str, text: str) -> object:
        """The list or pose ``name`` after ``name[index] = text``; unknown where one of the three is."""
        old, at = self.memory.get(name), evaluate_expression(index, self.memory, quietly=True)
        value = evaluate_expression(text, self.memory, quietly=True)
        if not (isinstance(old, list) and isinstance(at, float) and at == int(at) and 0 <= at < len(old)):
            return UnknownValue(f"{name}[{index}] = {text}"[:40])
        return [*old[: int(at)], value, *old[int(at) + 1 :]]

    def not_followed(self, body: ScriptFunction, why: str) -> None:
        """What a branch or function that is not followed assigns is unknown from here on.

        Raises:
            ScriptValueError: it changes frames, or moves the tool off its targets.
        """
        for line in body.lines:
            called = _CALL.search(line.code)
            if found := _ELEMENT.fullmatch(line.code) or _ASSIGN.fullmatch(line.code):
                self.memory[found.group(1)] = UnknownValue(line.code[:40])
            elif called and called.group(1) in _FRAMES:
                raise ScriptValueError(
                    f"{why[:30]!r} decides about {called.group(1)} while the robot runs: frames are not known here; "
                    "expand the program first"
                )
            elif called and called.group(1) in self.bodies and self.bodies[called.group(1)] is not body:
                self.not_followed(self.bodies[called.group(1)], why)
            elif called and not (_QUIET.fullmatch(called.group(1)) or _EVENT.fullmatch(called.group(1))):
                self.unknown_call(called.group(1), line.number)

    def unknown_call(self, name: str, line: int) -> None:
        if name not in ("sleep", "if", "while", "elif", "for", "not", "and", "or", "switch", "case"):
            self.out.ignore(name, line, understood=bool(_VALUES.fullmatch(name)))

    def call(self, name: str, text: str, line: ScriptLine, depth: int) -> None:
        if name in _MOVES:
            self.motion(name, text, line)
        elif name in self.bodies:
            body = self.bodies[name]
            if not self.moves(body):
                self.out.event(f"{name}({text})")
                if any(c.group(1) in _FRAMES for i in body.lines if (c := _CALL.search(i.code))):
                    self.follow(body, 0, len(body.lines), depth + 1)
                    self.returned = False
                else:
                    self.not_followed(body, name)
                return
            given, _ = parse_arguments(text, self.memory, quietly=True)
            self.memory |= dict(zip(body.parameters, given, strict=False))
            self.follow(body, 0, len(body.lines), depth + 1)
            self.returned = False
        elif name == "set_tcp":
            given, _ = parse_arguments(text, self.memory, quietly=True)
            pose = given[0] if given else None
            self.out.set_tool(ProgramFrame("tcp", _build_matrix(pose) if isinstance(pose, ScriptPose) else None))
        elif name == "sleep":
            given, _ = parse_arguments(text, self.memory, quietly=True)
            self.out.event(f"sleep({text})", "dwell", given[0] if given and isinstance(given[0], float) else math.nan)
        elif _EVENT.fullmatch(name):
            self.out.event(f"{name}({text})", "comment")
        elif name == "set_reference":
            raise ScriptValueError("set_reference is not followed; poses in the base would work")
        elif name in _OFF_TARGET:
            raise ScriptValueError(f"{name} moves the tool off its targets while the robot runs: not followed")
        else:
            self.out.ignore(name, line.number, understood=bool(_QUIET.fullmatch(name)))

    def motion(self, name: str, text: str, line: ScriptLine) -> None:
        if name not in ("movej", "movel", "movep", "movec", "servoj"):
            raise ScriptValueError(f"{name} is not read; movej, movel, movep, movec or servoj would work")
        if re.match(r"\s*get_(?:actual|target)_(?:tcp_pose|joint_positions)\s*\(\s*\)\s*(?:,|$)", text):
            self.out.ignore(f"{name} to the current position of the robot", line.number, understood=True)
            self.out.warn_once(
                "a move to the current position of the robot is not part of the path; it is left out", line.number
            )
            return
        values, options = parse_arguments(text, self.memory)
        order = {
            "movej": ("pose", "a", "v", "t", "r"),
            "movel": ("pose", "a", "v", "t", "r"),
            "movep": ("pose", "a", "v", "r"),
            "movec": ("via", "pose", "a", "v", "r", "mode"),
            "servoj": ("pose", "a", "v", "t", "lookahead_time", "gain"),
        }[name]
        options = dict(zip(order, values, strict=False)) | options
        if "q" in options:
            options["pose"] = options["q"]
        target = options.get("pose")
        kind = JOINT if name in ("movej", "servoj") else LINEAR

        def length(key: str) -> float:
            value = options.get(key, 0.0)
            return value if isinstance(value, float) else math.nan

        feed = length("v") if kind == LINEAR and not length("t") > 0.0 else math.nan
        if isinstance(target, list) and len(target) == 6 and all(isinstance(v, float) for v in target):
            axes = [math.degrees(v) for v in target]
            step = {"step_s": length("t")} if name == "servoj" else {}
            if name == "servoj":
                kind = self.out.find_streamed_kind
            given = MoveAttributes(feed=feed, blend=length("r"), configuration=step)
            self.out.joint(axes, line.number, given, kind=kind)
            return
        if not isinstance(target, ScriptPose):
            shown = "a value known only while the robot runs" if isinstance(target, UnknownValue) else "no target"
            raise ScriptValueError(f"{name} goes to {shown}; expected p[x,y,z,rx,ry,rz] or six joints")
        if name == "movec":
            via = options.get("via")
            if not isinstance(via, ScriptPose):
                raise ScriptValueError("movec without a pose on its way")
            given = MoveAttributes(feed=feed, blend=length("r"))
            self.out.circle(_build_matrix(via), _build_matrix(target), line.number, given)
            return
        self.out.set_base(ProgramFrame(target.base, np.eye(4) if target.base_matrix is None else target.base_matrix))
        if kind == LINEAR and length("t") > 0.0 and self.out.last is not None:
            feed = math.dist(self.out.last[:3, 3], target.position) / length("t")
        self.out.pose(kind, target.rows, target.position, line.number, MoveAttributes(feed=feed, blend=length("r")))


def _build_matrix(pose: ScriptPose) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    out = build_pose_matrix(pose.rows, *pose.position)
    return out if pose.base_matrix is None else np.asarray(pose.base_matrix @ out)
