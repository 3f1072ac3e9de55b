"""Reader of ABB RAPID: executes a module from its main procedure, without formulas and branches.

:mod:`machopt.programs.abb.program_data` resolves names.
"""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from dataclasses import replace

from machopt.file_formats.source_file import SourceFile
from machopt.numerics.array_types import Array
from machopt.programs.abb.harmless_words import RAPID
from machopt.programs.abb.program_data import DEEPEST, ENDINGS, RapidData
from machopt.programs.abb.rapid_syntax import BLOCKS, RapidProcedure, RapidStatement, read_rapid_module
from machopt.programs.abb.rapid_values import (
    RapidFunctionCall,
    RapidSyntaxError,
    RapidValueReader,
    parse_confdata,
    parse_jointtarget,
    parse_robtarget,
)
from machopt.programs.abb.rapid_values import list_external_axes as externals
from machopt.programs.reading.called_files import find_called_file
from machopt.programs.reading.move_attributes import MoveAttributes, ProgramEnd
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import build_pose_matrix, convert_quaternion

_MOVES = frozenset(
    (
        "MOVEJ",
        "MOVEL",
        "MOVEC",
        "MOVEABSJ",
        "MOVEJDO",
        "MOVELDO",
        "MOVECDO",
        "MOVEJAO",
        "MOVELAO",
        "MOVEJGO",
        "MOVELGO",
        "MOVEJSYNC",
        "MOVELSYNC",
        "MOVECSYNC",
        "TRIGGL",
        "TRIGGJ",
        "TRIGGC",
        "SEARCHL",
        "SEARCHC",
        "MOVEEXTJ",
    )
)
_EVENTS = frozenset(("SETDO", "SETGO", "SETAO", "SET", "RESET", "PULSEDO", "WAITDI", "WAITDO", "WAITUNTIL", "INVERTDO"))
_DISPLACES = frozenset(("PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET"))
_STOPS = frozenset(("STOP", "BREAK"))
_BRANCHES = frozenset(
    ("ELSE", "ELSEIF", "CASE", "DEFAULT", "RETURN", "EXIT", "WAITTIME", "CONST", "VAR", "PERS")
)  # words within a branch that move nothing
NORMALISED = 1e-3  # of the sum of squares: three printed decimals are within; a control stops at worse


def read_rapid(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a RAPID module.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames, events and unknown words of the program.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    return _RapidReader(
        ProgramBuilder(source=source, dialect="rapid", arc_tolerance=arc_tolerance, strict=strict)
    ).run()


class _RapidReader:
    def __init__(self, out: ProgramBuilder) -> None:
        self.out = out
        self.data = RapidData(out)
        self.procs: dict[str, RapidProcedure] = {}
        self.returned = False
        self.fastest = math.inf  # m/s, of VelSet
        self.base_name = self.tool_name = ""

    def run(self) -> ParsedProgram:
        procs = self.load(self.out.source)
        if not procs:
            raise self.out.error("holds no PROC: give the module whose procedure moves the robot")
        main = self.entry(procs)
        self.out.name = main.name
        with suppress(ProgramEnd):
            self.follow(main, 0, len(main.statements), 0)
        return self.out.build()

    def load(self, source: SourceFile) -> list[RapidProcedure]:
        try:
            module = read_rapid_module(source)
            for s in module.data:
                self.data.declare(s)
        except RapidSyntaxError as problem:
            raise self.out.error(str(problem), None, source) from None
        for proc in module.procs:
            self.procs.setdefault(proc.name.upper(), proc)
        if module.is_incomplete:
            self.out.warn_once("the last PROC has no ENDPROC: the file may be cut off", len(source.lines))
        return module.procs

    def entry(self, procs: list[RapidProcedure]) -> RapidProcedure:
        """Where the program begins: ``main``, else the one procedure that moves and is called by no other."""
        for proc in procs:
            if proc.name.upper() == "MAIN":
                return proc
        called_names = {s.word for p in procs for s in p.statements}
        first = [p for p in procs if p.name.upper() not in called_names]
        moving = [p for p in first if any(s.word in _MOVES or s.word in self.procs for s in p.statements)] or first
        if len(moving) > 1:
            names = ", ".join(p.name for p in moving[:5])
            raise self.out.error(
                f"holds {len(moving)} procedures that nothing calls ({names}); keep the one to be "
                "read, or call them in their order from a PROC main"
            )
        return moving[0] if moving else procs[0]

    # ---- following the program

    def follow(self, proc: RapidProcedure, start: int, stop: int, depth: int) -> None:
        if depth > DEEPEST:
            raise self.out.error(f"{proc.name} calls itself, or calls are nested more than {DEEPEST} deep")
        k = start
        while k < stop and not self.returned:
            s = proc.statements[k]
            if s.tokens[0].kind == "comment":
                self.out.comment(s.tokens[0].text)
            else:
                self.out.step(s.line)
                try:
                    k = self.statement(proc, k, depth)
                except RapidSyntaxError as problem:
                    raise self.out.error(str(problem), s.line, proc.source) from None
            k += 1

    def statement(self, proc: RapidProcedure, k: int, depth: int) -> int:
        s = proc.statements[k]
        word = s.word
        if k in proc.ends:
            self.block(proc, k)
            return proc.ends[k]
        if word in _MOVES:
            values, options = s.plain or RapidValueReader(s.tokens[1:]).arguments()
            self.motion(word, values, options, s.line, proc)
        elif word in ("CONST", "PERS", "VAR"):
            self.data.declare(s)
        elif word == "WAITTIME":
            values, _ = RapidValueReader(s.tokens[1:]).arguments()
            seconds = values[0] if values and isinstance(values[0], float) else math.nan
            self.out.event(_normalise_statement(s), "dwell", seconds)
        elif word in _EVENTS:
            self.out.event(_normalise_statement(s), "comment")
        elif word in _STOPS:
            self.out.event(_normalise_statement(s), "stop")
        elif word in _DISPLACES:
            raise RapidSyntaxError(f"{word}: displacements set while the robot runs are not followed")
        elif word == "VELSET":
            self.velocity(RapidValueReader(s.tokens[1:]).arguments()[0])
        elif word == "SPEEDREFRESH" and RapidValueReader(s.tokens[1:]).arguments()[0][:1] != [100.0]:
            raise RapidSyntaxError(
                "SpeedRefresh other than 100 % scales every feed behind it; post the feeds themselves"
            )
        elif word == "IF":
            self.decision(s, s)
        elif word == "RETURN":
            self.returned = True
        elif word == "EXIT":
            self.out.end_program("EXIT")
        elif word in RAPID and word not in self.procs:
            self.out.ignore(word, s.line, understood=True)
        elif word == "GOTO":
            raise RapidSyntaxError("GOTO: jumps are not followed; expand the program first")
        elif len(s.tokens) > 1 and s.tokens[1].text in (":=", "{", ".") and any(t.text == ":=" for t in s.tokens):
            self.data.assign(s)
        elif word:
            self.call(word, s, proc, depth)
        else:
            self.out.ignore(_normalise_statement(s)[:24], s.line, understood=False)
        return k

    def block(self, proc: RapidProcedure, k: int) -> None:
        s = proc.statements[k]
        for inner in proc.statements[k + 1 : proc.ends[k]]:
            self.decision(s, inner)
        self.out.ignore(f"{s.word} without moves inside", s.line, understood=True)

    def decision(self, s: RapidStatement, inner: RapidStatement) -> None:
        """Check that a branch, loop or compact IF holds no motion or jump.

        Raises:
            RapidSyntaxError: it does.
        """
        names = {t.text.upper() for t in (inner.tokens if inner.word == "IF" else inner.tokens[:1])}
        if names & {*_MOVES, *self.procs, *_DISPLACES, "GOTO", "VELSET", "SPEEDREFRESH"}:
            until = f" … {BLOCKS[s.word]}" if inner is not s else ""
            raise RapidSyntaxError(
                f"{s.word}{until} decides about moves while the robot runs: they are not known here; "
                "expand the program first"
            )
        if names & {"RETURN", "EXIT"}:
            self.out.may_end(inner.line)
        at = next((k for k, t in enumerate(inner.tokens) if t.text == ":="), None)
        if at is not None:
            start = max(
                (k for k, t in enumerate(inner.tokens[:at]) if t.text.upper() in ("THEN", "DO", "IF")), default=-1
            )
            for t in inner.tokens[start + 1 : at]:
                if t.kind == "name":
                    self.data.mark_value_unknown(t.text.upper(), inner.line)
        elif (word := _get_conditional_instruction(inner)) not in (
            *RAPID,
            *_EVENTS,
            *_STOPS,
            *_BRANCHES,
            *BLOCKS,
            *BLOCKS.values(),
            "",
        ):
            self.out.ignore(word, inner.line, understood=False)
        if inner is s:
            self.out.ignore("IF without a move behind it", s.line, understood=True)

    def call(self, word: str, s: RapidStatement, proc: RapidProcedure, depth: int) -> None:
        target = self.procs.get(word)
        if target is None:
            other = find_called_file(proc.source.path, word, ENDINGS)
            if other is not None:
                self.load(other)
                self.out.files.append(other.path)
                target = self.procs.get(word)
        if target is None:
            self.out.event(_normalise_statement(s))
            self.out.ignore(s.tokens[0].text, s.line, understood=False)
            return
        self.follow(target, 0, len(target.statements), depth + 1)
        self.returned = False

    def velocity(self, values: list[object]) -> None:
        """VelSet: an override, and the largest speed of what follows (mm/s)."""
        if values[:1] != [100.0]:
            raise RapidSyntaxError("VelSet other than 100 % scales every feed behind it; post the feeds themselves")
        most = values[1] if len(values) > 1 else None
        self.fastest = most * 1e-3 if isinstance(most, float) else math.inf

    # ---- motion

    def motion(
        self, word: str, values: list[object], options: dict[str, object], line: int, proc: RapidProcedure
    ) -> None:
        if word.startswith(("TRIGG", "SEARCH", "MOVEEXT")):
            raise RapidSyntaxError(f"{word} is not read; MoveJ, MoveL, MoveC or MoveAbsJ would work")
        count = 2 if word.startswith("MOVEC") else 1
        if len(values) < count + 3:
            raise RapidSyntaxError(f"found {len(values)} arguments; expected a target, speed, zone and tool")
        for option in options:
            if option not in ("WOBJ", "ID", "CONC", "V", "T", "Z", "INPOS", "NOEOFFS", "TLOAD", "DO", "AO", "GO"):
                self.out.ignore(f"\\{option}", line, understood=False)
        if isinstance(values[0], RapidFunctionCall) and values[0].name in ("CROBT", "CJOINTT"):
            self.out.ignore(f"{word} {values[0].name} (to the current position of the robot)", line, understood=True)
            self.out.warn_once(
                "a move to the current position of the robot is not part of the path; it is left out", line
            )
            return
        targets = [self.data.resolve_name(v) for v in values[:count]]
        feed = min(self.data.speed(values[count], line, proc), self.fastest)
        if isinstance(options.get("V"), float):
            feed = float(options["V"]) * 1e-3  # type: ignore[arg-type]
        if "T" in options:
            feed = math.nan
        blend = self.data.zone(values[count + 1])
        self.frames(values[count + 2], options.get("WOBJ"))
        if word == "MOVEABSJ":
            axes, external = parse_jointtarget(targets[0])
            self.out.joint(axes, line, MoveAttributes(blend=blend, external=external))
            return
        x, y, z, q, rest = parse_robtarget(targets[-1])
        rows = convert_quaternion(*q)
        if rows is None:
            raise RapidSyntaxError(f"quaternion {list(q)} is not of unit length")
        if abs(sum(c * c for c in q) - 1.0) > NORMALISED:
            self.out.ignore("length of a quaternion", line, understood=False, stops=False)
        external = externals(rest[1]) if len(rest) > 1 else []
        bits = parse_confdata(rest[0]) if rest else {}
        given = MoveAttributes(feed=feed, blend=blend, external=external, configuration=bits)
        if word.startswith("MOVEC"):
            via = _parse_via_pose(targets[0])
            end = build_pose_matrix(rows, x * 1e-3, y * 1e-3, z * 1e-3)
            self.out.circle(via, end, line, given)
            return
        seconds = options.get("T")
        if isinstance(seconds, float) and seconds > 0.0 and self.out.last is not None:
            feed = math.dist(self.out.last[:3, 3] * 1e3, (x, y, z)) * 1e-3 / seconds
        kind = JOINT if word.startswith("MOVEJ") else LINEAR
        given = replace(given, feed=feed if kind == LINEAR else math.nan)
        self.out.pose(kind, rows, (x * 1e-3, y * 1e-3, z * 1e-3), line, given)

    def frames(self, tool: object, base: object) -> None:
        tool_name = self.data.frame_name(tool, "TOOL")
        base_name = self.data.frame_name(base, "WOBJ0")
        if tool_name != self.tool_name:
            self.tool_name = tool_name
            self.out.set_tool(ProgramFrame(tool_name.lower(), self.data.frame(tool, "TOOL0", False)))
        if base_name != self.base_name:
            self.base_name = base_name
            self.out.set_base(
                ProgramFrame(
                    base_name.lower(), self.data.frame(base, "WOBJ0", True), self.data.find_carrying_unit(base)
                )
            )
            self.out.last = None


def _get_conditional_instruction(s: RapidStatement) -> str:
    """The instruction of a statement; of a compact ``IF condition instruction …`` the one behind its condition."""
    if s.word != "IF":
        return s.word
    for before, token in itertools.pairwise(s.tokens[1:]):
        ends = before.kind in ("number", "text", "name") or before.text in (")", "}", "]")
        joins = {before.text.upper(), token.text.upper()} & {"AND", "OR", "XOR", "NOT", "DIV", "MOD", "THEN"}
        if ends and not joins and token.kind == "name":
            return token.text.upper()
    return s.word


def _normalise_statement(s: RapidStatement) -> str:
    return " ".join(t.text for t in s.tokens)[:120]


def _parse_via_pose(target: object) -> Array:
    """(4, 4) m, the point through which an arc leads."""
    x, y, z, q, _ = parse_robtarget(target)
    rows = convert_quaternion(*q)
    if rows is None:
        raise RapidSyntaxError(f"quaternion {list(q)} is not of unit length")
    return build_pose_matrix(rows, x * 1e-3, y * 1e-3, z * 1e-3)
