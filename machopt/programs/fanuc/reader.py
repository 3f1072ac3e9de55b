"""Reader of FANUC TP programs as text (.ls): motion lines of /MN with the positions of /POS."""

from __future__ import annotations

import math
import re
from contextlib import suppress

import numpy as np

from machopt.file_formats.source_file import SourceFile
from machopt.numerics.array_types import Array
from machopt.programs.fanuc.file_sections import FanucFile, FanucPosition, split_sections
from machopt.programs.fanuc.harmless_words import FANUC
from machopt.programs.fanuc.move_speed import (
    SWITCHES,
    MoveSpeedError,
    compute_feed_of_duration,
    parse_feed,
    refuse_duration,
)
from machopt.programs.reading.called_files import find_called_file
from machopt.programs.reading.harmless_word_reasons import compile_beginning_pattern
from machopt.programs.reading.move_attributes import MoveAttributes, ProgramEnd, parse_number
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import STANDING_TOOL, ProgramBuilder
from machopt.programs.reading.rotation_conventions import (
    build_pose_matrix,
    compute_fixed_xyz_rotation,
    compute_halfway_pose,
)

_MOTION = re.compile(r"([JLCA])\s+(PR?)\s*\[\s*([0-9]+)\s*(?::[^\]]*)?\]\s*(.*)")
_POSITION = re.compile(r"(PR?)\s*\[\s*([0-9]+)\s*(?::[^\]]*)?\]\s*(.*)")
_END = re.compile(r"\b(FINE|CNT\s*[0-9]+|CD\s*[0-9]+|CR\s*[0-9]+|CNT\s*R\[[0-9]+\])", re.IGNORECASE)
_FRAME_NUMBER = re.compile(r"(UFRAME|UTOOL)_NUM\s*=\s*([0-9]+)")
_MODIFIER = re.compile(
    r"(?:ACC\s*[0-9]+|COORD|PTH|BREAK|MROT|EV\s*[0-9]+%?|IND|AP_LD[0-9.]*|RT_LD[0-9.]*|PSPD\s*[0-9]+|CR\s*[0-9]+)$"
)
_QUIET = compile_beginning_pattern(FANUC)
_EVENT = re.compile(r"(?:DO|RO|SO|M)\[|ARC |Arc |SPOT|Spot|WAIT|PULSE")
_STRANGE_MOTION = re.compile(r"[A-Z]\s+(?:P|PR|PAL_[0-9]+)\s*\[")
_BRANCH = re.compile(r"LBL\s*\[|(?:IF|ENDIF|ELSE|END)\b")
_JUMP = re.compile(r"(?:JMP\b|FOR\b|ENDFOR\b|SELECT\b|SKIP\b|.*\bJMP\s+LBL)")
_FRAME_SET = re.compile(r"(?:UFRAME|UTOOL)(?:_NUM\b|\s*\[)")
_POSITION_SET = re.compile(r"P\s*\[[^\]]*\]\s*=")
_DECIDES = re.compile(r"\bCALL\b|\bOVERRIDE\b|,\s*(?:UFRAME|UTOOL|P\s*\[)")
_DEEPEST = 20


def read_fanuc(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a FANUC program.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames, events and unknown words of the program.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    out = ProgramBuilder(source=source, dialect="fanuc", arc_tolerance=arc_tolerance, strict=strict)
    return _FanucReader(out).run()


class _FanucReader:
    def __init__(self, out: ProgramBuilder) -> None:
        self.out = out
        self.user_frame: int | None = None
        self.tool: int | None = None
        self.moves = 0
        self.feed = math.nan  # of the straight move before, m/s
        self.row: list[tuple[Array, re.Match[str], int]] = []  # A moves so far: pose, words, line
        self.jump: tuple[int, str, SourceFile] | None = None
        self.branches: list[tuple[int, str]] = []  # IF … THEN that are open: line and text

    def run(self) -> ParsedProgram:
        part = split_sections(self.out.source)
        self.out.name = part.name or self.out.source.path.stem
        if not part.has_end:
            self.out.warn_once("no /END: the file may be cut off", len(self.out.source.lines))
        with suppress(ProgramEnd):
            self.follow(part, 0)
        if self.jump is not None and self.moves:
            line, text, source = self.jump
            raise self.out.error(
                f"{text[:30]!r} decides while the robot runs: the order of moves is not known here; "
                "expand the program first",
                line,
                source,
            )
        return self.out.build()

    def follow(self, part: FanucFile, depth: int) -> None:
        if depth > _DEEPEST:
            raise self.out.error(f"calls are nested more than {_DEEPEST} deep, or {part.name} calls itself")
        pending: tuple[int, str, str, str, int] | None = None  # C with its first point
        for line, text in part.lines:
            self.out.step(line)
            if pending is not None:
                second = _POSITION.match(text)
                if second is None:
                    raise self.out.error("a circular move C has no second position", line, part.source)
                self.circle(part, pending, second, line)
                pending = None
                continue
            motion = _MOTION.fullmatch(text)
            if self.branches and (motion is not None or text.startswith(("CALL", "UFRAME", "UTOOL", "OVERRIDE"))):
                self.jump = self.jump or (*self.branches[0], part.source)
            if text == "END" and not self.branches:
                break  # back to the program that called this one
            if motion is None:
                self.other(text, line, part, depth)
                continue
            if motion.group(1) == "A":
                self.arc_point(part, motion, line)
                continue
            self.end_of_arcs(part)
            if motion.group(1) == "C":
                second = re.search(r"(PR?)\s*\[\s*([0-9]+)\s*(?::[^\]]*)?\]\s*(.*)", motion.group(4))
                first = (line, motion.group(1), motion.group(2), motion.group(3), line)
                if second is not None:
                    self.circle(part, first, second, line)
                else:
                    pending = first
                continue
            self.motion(part, motion, line)
        if pending is not None:
            raise self.out.error("a circular move C has no second position", pending[0], part.source)
        self.end_of_arcs(part)

    # ---- motion

    def position(self, part: FanucFile, kind: str, index: str, line: int) -> FanucPosition:
        if kind == "PR":
            raise self.out.error(
                f"PR[{index}] is a position register: the controller holds it, the program does not", line, part.source
            )
        found = part.positions.get(int(index))
        if found is None:
            raise self.out.error(f"P[{index}] is not in /POS", line, part.source)
        if found.fault:
            raise self.out.error(f"P[{index}]: {found.fault}", found.line, part.source)
        if found.user_frame is not None and self.user_frame is not None and found.user_frame != self.user_frame:
            self.out.warn_once(
                f"P[{index}] is taught in user frame {found.user_frame}, but {self.user_frame} is active", line
            )
        frame = found.user_frame if found.user_frame is not None else self.user_frame
        tool = found.tool if found.tool is not None else self.tool
        self.out.set_base(ProgramFrame(f"UFRAME {frame}" if frame is not None else "UFRAME", None))
        self.out.set_tool(ProgramFrame(f"UTOOL {tool}" if tool is not None else "UTOOL", None))
        return found

    def motion(self, part: FanucFile, motion: re.Match[str], line: int) -> None:
        self.moves += 1
        found = self.position(part, motion.group(2), motion.group(3), line)
        kind = JOINT if motion.group(1) == "J" else LINEAR
        tail, incremental = re.subn(r"\bINC\b,?", " ", motion.group(4), flags=re.IGNORECASE)
        feed, blend = self.read_motion_options(tail, line, part)
        if kind == LINEAR:
            feed = self.read_duration(tail, found, incremental > 0, feed, line, part)
        if incremental:
            self.step(found, kind, feed, blend, line, part)
            return
        percent = re.search(r"\bCNT\s*([0-9]+)", motion.group(4), re.IGNORECASE)
        words = {**found.configuration, "cnt": int(percent.group(1)) if percent is not None else 0}
        given = MoveAttributes(
            feed=feed if kind == LINEAR else math.nan,
            blend=blend,
            external=found.other_groups,
            configuration=words,
        )
        if "J1" in found.values:
            axes = [found.values.get(f"J{k}", math.nan) for k in range(1, 7)]
            if any(math.isnan(v) for v in axes):
                raise self.out.error(f"P[{motion.group(3)}] has no six axes", found.line, part.source)
            self.out.joint(axes, line, given, kind=kind)
            return
        v = found.values
        rows = compute_fixed_xyz_rotation(v["W"], v["P"], v["R"])
        self.out.pose(kind, rows, (v["X"] * 1e-3, v["Y"] * 1e-3, v["Z"] * 1e-3), line, given)

    def read_duration(
        self, tail: str, to: FanucPosition, incremental: bool, feed: float, line: int, part: FanucFile
    ) -> float:
        """Feed in m/s of a straight move, which may be stated as a duration."""
        way = None
        if "X" in to.values and (incremental or self.out.last is not None):
            place = np.array([to.values[c] for c in "XYZ"]) * 1e-3
            start = np.zeros(3) if incremental or self.out.last is None else self.out.last[:3, 3]
            way = float(np.linalg.norm(place - start))
        try:
            found = compute_feed_of_duration(tail, way, self.feed)
        except MoveSpeedError as problem:
            raise self.out.error(str(problem), line, part.source) from problem
        self.feed = feed if found is None else found
        return self.feed

    def step(self, by: FanucPosition, kind: int, feed: float, blend: float, line: int, part: FanucFile) -> None:
        """INC: add the numbers of the position to the present one, along the user frame."""
        if "X" not in by.values or self.out.last is None:
            raise self.out.error(
                "INC starts at the current position of the robot, which the program does not state (or gives axes); "
                "absolute positions would work",
                line,
                part.source,
            )
        if any(by.values[c] for c in "WPR"):
            raise self.out.error(
                "INC that turns the tool is not read; absolute positions would work", line, part.source
            )
        T = self.out.last.copy()
        T[:3, 3] += [by.values[c] * 1e-3 for c in "XYZ"]
        given = MoveAttributes(feed=feed if kind == LINEAR else math.nan, blend=blend, external=by.other_groups)
        self.out.add_pose_move(kind, T, line, given)

    def arc_point(self, part: FanucFile, motion: re.Match[str], line: int) -> None:
        """A: straight to the first of a row; from the third on, the arc through it and the two before."""
        if not self.row:
            self.motion(part, motion, line)
            self.row = [(self.out.last, motion, line)] if self.out.last is not None else []
            return
        found = self.position(part, motion.group(2), motion.group(3), line)
        if "X" not in found.values:
            raise self.out.error("a circular move needs Cartesian positions", line, part.source)
        self.moves += 1
        self.row.append((_build_pose(found.values), motion, line))
        if len(self.row) < 3:
            return
        feed, blend = self.read_arc_options(motion.group(4), line, part)
        a, b, c = (row[0] for row in self.row[-3:])
        via = b if len(self.row) == 3 else compute_halfway_pose(a, b, c)
        given = MoveAttributes(feed=feed, blend=blend, external=found.other_groups, configuration=found.configuration)
        self.out.circle(via, c, line, given)

    def end_of_arcs(self, part: FanucFile) -> None:
        if len(self.row) == 2:
            raise self.out.error(
                "two moves A in a row: an arc needs three points; L would work", self.row[1][2], part.source
            )
        self.row = []

    def circle(self, part: FanucFile, first: tuple[int, str, str, str, int], second: re.Match[str], line: int) -> None:
        self.moves += 1
        via = self.position(part, first[2], first[3], first[0])
        end = self.position(part, second.group(1), second.group(2), line)
        feed, blend = self.read_arc_options(second.group(3), line, part)
        poses = []
        for p in (via, end):
            if "X" not in p.values:
                raise self.out.error("a circular move needs Cartesian positions", line, part.source)
            poses.append(_build_pose(p.values))
        given = MoveAttributes(feed=feed, blend=blend, external=end.other_groups, configuration=end.configuration)
        self.out.circle(poses[0], poses[1], line, given)

    def read_arc_options(self, text: str, line: int, part: FanucFile) -> tuple[float, float]:
        """Read feed in m/s and blend in m of an arc."""
        try:
            refuse_duration(text)
        except MoveSpeedError as problem:
            raise self.out.error(str(problem), line, part.source) from problem
        return self.read_motion_options(text, line, part)

    def read_motion_options(self, text: str, line: int, part: FanucFile) -> tuple[float, float]:
        """Read feed in m/s and blend in m from the text behind a position."""
        blend = math.nan
        for switched in SWITCHES.findall(text):
            self.out.event(switched, "comment")
        feed, text = parse_feed(SWITCHES.sub(" ", text))
        end = _END.search(text)
        if end is not None:
            word = end.group(1).upper()
            blend = 0.0 if word == "FINE" else float(word[2:]) * 1e-3 if word.startswith(("CR", "CD")) else math.nan
            text = text[: end.start()] + text[end.end() :]
        for word in re.split(r"[\s]+", text.strip()):
            if word.upper().rstrip(",") == "RTCP":
                raise self.out.error(f"RTCP: {STANDING_TOOL}", line, part.source)
            if not word or _MODIFIER.match(word.upper()):
                continue
            if word.upper().rstrip(",") == "INC":
                raise self.out.error("INC in a circular move is not read; absolute ones would work", line, part.source)
            if re.match(r"(?:TOOL_)?OFFSET|VOFFSET", word.upper()):
                raise self.out.error(
                    f"{word.rstrip(',')} shifts the point by a register that the controller holds and the program does "
                    "not: post the points where they lie",
                    line,
                    part.source,
                )
            self.out.ignore(word, line, understood=False)
        return feed, blend

    # ---- what is no motion

    def other(self, text: str, line: int, part: FanucFile, depth: int) -> None:
        if not text:
            return
        if text.startswith("!"):
            self.out.comment(text[1:].strip())
        elif found := _FRAME_NUMBER.match(text):
            n = int(found.group(2))
            if found.group(1) == "UFRAME":
                self.user_frame = n
                self.out.last = None
            else:
                self.tool = n
        elif _FRAME_SET.match(text):
            raise self.out.error(
                f"{text[:30]!r} sets a frame to what only the controller knows: not followed; post UFRAME_NUM and "
                "UTOOL_NUM with numbers, and the points where they lie",
                line,
                part.source,
            )
        elif _POSITION_SET.match(text):
            raise self.out.error(
                f"{text[:30]!r} changes a position while the robot runs: not followed; post the points where they lie",
                line,
                part.source,
            )
        elif _STRANGE_MOTION.match(text):
            raise self.out.error(
                f"{text[:30]!r}: a move to a position that the program does not hold (register, pallet, indirect "
                "number), or of a kind that is not read; J, L, C and A to P[n] would work",
                line,
                part.source,
            )
        elif text.startswith("OVERRIDE"):
            percent = re.search(r"=\s*([0-9]+)\s*%?\s*$", text)
            self.out.override(float(percent.group(1)) if percent else None, line)
        elif text.startswith("CALL"):
            self.call(text[4:].strip(), line, part, depth)
        elif _JUMP.match(text):
            self.jump = self.jump or (line, text, part.source)
            self.out.ignore(re.split(r"[\s\[]", text)[0], line, understood=True)
        elif text.startswith(("PAUSE", "ABORT")):
            if text.startswith("ABORT") and not self.branches:
                self.out.end_program(text)
            self.out.event(text, "stop")
        elif text == "END":
            self.out.may_end(line)
        elif found := re.match(r"WAIT\s+([0-9.]+)\s*\(?sec\)?", text):
            seconds = parse_number(found.group(1))
            self.out.event(text, "dwell", math.nan if seconds is None else seconds)
        elif _EVENT.match(text):
            self.out.event(text, "comment")
        elif _BRANCH.match(text) or _QUIET.match(text):
            self.branch(text, line, part)
            self.out.ignore(re.split(r"[\s\[(]", text)[0], line, understood=True)
        else:
            self.out.ignore(re.split(r"[\s\[(]", text)[0], line, understood=False)

    def branch(self, text: str, line: int, part: FanucFile) -> None:
        if text.startswith("IF") and _DECIDES.search(text):
            self.jump = self.jump or (line, text, part.source)
        if text.startswith("IF") and text.endswith("THEN"):
            self.branches.append((line, text))
        elif text.startswith("ENDIF") and self.branches:
            self.branches.pop()

    def call(self, name: str, line: int, part: FanucFile, depth: int) -> None:
        plain = re.split(r"[\s(;]", name)[0]
        other = find_called_file(part.source.path, plain, (".ls",)) if re.fullmatch(r"\w+", plain) else None
        if other is None:
            self.out.event(f"CALL {name}")
            self.out.ignore(f"CALL {plain}", line, understood=False)
            return
        self.out.files.append(other.path)
        self.follow(split_sections(other), depth + 1)


def _build_pose(v: dict[str, float]) -> Array:
    return build_pose_matrix(
        compute_fixed_xyz_rotation(v["W"], v["P"], v["R"]), v["X"] * 1e-3, v["Y"] * 1e-3, v["Z"] * 1e-3
    )
