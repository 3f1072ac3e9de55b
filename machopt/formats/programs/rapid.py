"""ABB RAPID: a module followed from its main procedure, without formulas and branches."""

from __future__ import annotations

import math
import re

import numpy as np

from machopt.arrays import Array
from machopt.formats.programs.builder import STANDING_TOOL, Builder
from machopt.formats.programs.nearby import called, opened, siblings
from machopt.formats.programs.parsed import JOINT, LINEAR, Frame, ParsedProgram
from machopt.formats.programs.rapid_syntax import (
    BLOCKS,
    Call,
    Name,
    Proc,
    RapidError,
    Reader,
    Statement,
    confdata,
    jointtarget,
    numbers,
    read_module,
    robtarget,
)
from machopt.formats.programs.rapid_syntax import external as externals
from machopt.formats.programs.rotations import from_quaternion, matrix
from machopt.formats.source import Source

_ENDINGS = (".mod", ".prg", ".sys", ".modx", ".sysx")
_DEEPEST = 20
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
_QUIET = frozenset(
    (
        "CONFL",
        "CONFJ",
        "SINGAREA",
        "ACCSET",
        "VELSET",
        "ACTUNIT",
        "DEACTUNIT",
        "SYNCMOVEON",
        "SYNCMOVEOFF",
        "WAITSYNCTASK",
        "SOFTACT",
        "SOFTDEACT",
        "GRIPLOAD",
        "PATHACCLIM",
        "WORLDACCLIM",
        "TPERASE",
        "TPWRITE",
        "TPREADFK",
        "CIRPATHMODE",
        "EOFFSOFF",
        "PDISPOFF",
        "WAITROB",
        "CLKRESET",
        "CLKSTART",
        "CLKSTOP",
        "MOTIONSUP",
        "ERRWRITE",
        "STARTMOVE",
        "STOPMOVE",
    )
)
_EVENTS = frozenset(("SETDO", "SETGO", "SETAO", "SET", "RESET", "PULSEDO", "WAITDI", "WAITDO", "WAITUNTIL", "INVERTDO"))
_STOPS = frozenset(("STOP", "EXIT", "BREAK"))
_ZONE = re.compile(r"Z(\d{1,3})")
Quaternion = tuple[float, float, float, float]  # w first
NORMALISED = 1e-3  # of the sum of squares: three printed decimals are within; a control stops at worse
_SPEED = re.compile(r"V(\d{1,5})")


def read_rapid(source: Source, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a RAPID module.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    return _Reader(Builder(source, "rapid", arc_tolerance, strict)).run()


class _Reader:
    def __init__(self, out: Builder) -> None:
        self.out = out
        self.data: dict[str, tuple[object, str]] = {}  # value and type of declared data
        self.procs: dict[str, Proc] = {}
        self.looked_around = self.returned = False
        self.fastest = math.inf  # m/s, of VelSet
        self.base_name = self.tool_name = ""

    def run(self) -> ParsedProgram:
        procs = self.load(self.out.source)
        if not procs:
            raise self.out.error("holds no PROC: give the module whose procedure moves the robot")
        main = self.entry(procs)
        self.out.name = main.name
        self.follow(main, 0, len(main.statements), 0)
        return self.out.build()

    def load(self, source: Source) -> list[Proc]:
        try:
            module = read_module(source)
            for s in module.data:
                self.declare(s)
        except RapidError as problem:
            raise self.out.error(str(problem), None, source) from None
        for proc in module.procs:
            self.procs.setdefault(proc.name.upper(), proc)
        if module.cut_off:
            self.out.warn_once("the last PROC has no ENDPROC: the file may be cut off", len(source.lines))
        return module.procs

    def entry(self, procs: list[Proc]) -> Proc:
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

    def declare(self, s: Statement) -> None:
        """One CONST, PERS or VAR; values that cannot be had are not needed until they are used."""
        words = list(s.tokens)
        at = 0
        while at < len(words) and words[at].text.upper() in ("LOCAL", "TASK", "CONST", "PERS", "VAR"):
            at += 1
        if at + 1 >= len(words) or words[at].kind != "name" or words[at + 1].kind != "name":
            self.out.ignore(s.word, s.line, understood=False)
            return
        kind, name = words[at].text.lower(), words[at + 1].text.upper()
        assign = next((k for k in range(at + 2, len(words)) if words[k].text == ":="), None)
        value: object = None
        if assign is not None:
            try:
                value = Reader(words[assign + 1 :]).value()
            except RapidError:
                value = None
        indexed = at + 2 < len(words) and words[at + 2].text == "{"
        if indexed and isinstance(value, list):
            for k, item in enumerate(value, 1):
                self.data[f"{name}{{{k}}}"] = (item, kind)
        self.data[name] = (value, kind)

    # ---- following the program

    def follow(self, proc: Proc, start: int, stop: int, depth: int) -> None:
        if depth > _DEEPEST:
            raise self.out.error(f"{proc.name} calls itself, or calls are nested more than {_DEEPEST} deep")
        k = start
        while k < stop and not self.returned:
            s = proc.statements[k]
            if s.tokens[0].kind == "comment":
                self.out.comment(s.tokens[0].text)
            else:
                self.out.step(s.line)
                try:
                    k = self.statement(proc, k, depth)
                except RapidError as problem:
                    raise self.out.error(str(problem), s.line, proc.source) from None
            k += 1

    def statement(self, proc: Proc, k: int, depth: int) -> int:
        s = proc.statements[k]
        word = s.word
        if k in proc.ends:
            self.block(proc, k)
            return proc.ends[k]
        if word in _MOVES:
            values, options = s.plain or Reader(s.tokens[1:]).arguments()
            self.motion(word, values, options, s.line, proc)
        elif word in ("CONST", "PERS", "VAR"):
            self.declare(s)
        elif word == "WAITTIME":
            values, _ = Reader(s.tokens[1:]).arguments()
            seconds = values[0] if values and isinstance(values[0], float) else math.nan
            self.out.event(_plain(s), "dwell", seconds)
        elif word in _EVENTS:
            self.out.event(_plain(s), "comment")
        elif word in _STOPS:
            self.out.event(_plain(s), "stop")
        elif word in ("PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET"):
            raise RapidError(f"{word}: displacements set while the robot runs are not followed")
        elif word == "VELSET":
            self.velocity(Reader(s.tokens[1:]).arguments()[0])
        elif word == "SPEEDREFRESH" and Reader(s.tokens[1:]).arguments()[0][:1] != [100.0]:
            raise RapidError("SpeedRefresh other than 100 % scales every feed behind it; post the feeds themselves")
        elif word == "IF":
            self.decision(s, s)
        elif word == "RETURN":
            self.returned = True
        elif word in _QUIET:
            self.out.ignore(word, s.line, understood=True)
        elif word == "GOTO":
            raise RapidError("GOTO: jumps are not followed; expand the program first")
        elif len(s.tokens) > 1 and any(t.text == ":=" for t in s.tokens):
            self.assign(s)
        elif word:
            self.call(word, s, proc, depth)
        else:
            self.out.ignore(_plain(s)[:24], s.line, understood=False)
        return k

    def assign(self, s: Statement) -> None:
        at = next(k for k, t in enumerate(s.tokens) if t.text == ":=")
        target = Reader(s.tokens[:at]).value()
        if not isinstance(target, Name):
            raise RapidError("found ':=' after something that is no variable")
        value: object
        try:
            value = Reader(s.tokens[at + 1 :]).value()
            value = self.resolved(value) if isinstance(value, Name) else value
        except RapidError:
            value = None
        _, kind = self.data.get(target.text, (None, ""))
        self.data[target.text] = (None if target.tail else value, kind)

    def block(self, proc: Proc, k: int) -> None:
        s = proc.statements[k]
        for inner in proc.statements[k + 1 : proc.ends[k]]:
            self.decision(s, inner)
        self.out.ignore(f"{s.word} without moves inside", s.line, understood=True)

    def decision(self, s: Statement, inner: Statement) -> None:
        """What stands in a branch or loop, or behind a compact IF: nothing that moves or jumps.

        Raises:
            RapidError: it does.
        """
        names = {t.text.upper() for t in (inner.tokens if inner.word == "IF" else inner.tokens[:1])}
        if names & {*_MOVES, *self.procs, "GOTO"}:
            until = f" … {BLOCKS[s.word]}" if inner is not s else ""
            raise RapidError(
                f"{s.word}{until} decides about moves while the robot runs: they are not known here; "
                "expand the program first"
            )
        if "RETURN" in names:
            self.out.may_end(inner.line)
        if inner is s:
            self.out.ignore("IF without a move behind it", s.line, understood=True)

    def call(self, word: str, s: Statement, proc: Proc, depth: int) -> None:
        target = self.procs.get(word)
        if target is None:
            other = called(proc.source.path, word, _ENDINGS)
            if other is not None:
                self.load(other)
                self.out.files.append(other.path)
                target = self.procs.get(word)
        if target is None:
            self.out.event(_plain(s))
            self.out.ignore(f"call of {s.tokens[0].text}, which is not in this folder", s.line, understood=False)
            return
        self.follow(target, 0, len(target.statements), depth + 1)
        self.returned = False

    def velocity(self, values: list[object]) -> None:
        """VelSet: an override, and the largest speed of what follows (mm/s)."""
        if values[:1] != [100.0]:
            raise RapidError("VelSet other than 100 % scales every feed behind it; post the feeds themselves")
        most = values[1] if len(values) > 1 else None
        self.fastest = most * 1e-3 if isinstance(most, float) else math.inf

    # ---- data

    def resolved(self, value: object, depth: int = 0) -> object:
        """A list from a name or an Offs, RelTool of one.

        Raises:
            RapidError: not declared, or a formula.
        """
        if depth > _DEEPEST:
            raise RapidError("data that refers to itself")
        if isinstance(value, Name):
            key = value.text + value.tail
            if value.tail.startswith(".") or (value.tail and key not in self.data):
                raise RapidError(f"{key}: components and computed indices are not evaluated; expand the program first")
            if key not in self.data:
                self.look_around(value.text)
            if key not in self.data:
                raise RapidError(
                    f"{value.shown} is declared in none of the modules read; put the module that "
                    "declares it beside this one"
                )
            found = self.data[key][0]
            if found is None:
                raise RapidError(f"{value.shown} gets its value only while the robot runs")
            return self.resolved(found, depth + 1)
        if isinstance(value, Call):
            return self.shifted(value, depth)
        return value

    def shifted(self, value: Call, depth: int) -> object:
        """Offs(point, x, y, z) along the work object's axes, RelTool(point, x, y, z) along the tool's."""
        numbers = value.arguments[1:]
        if value.name in ("CROBT", "CJOINTT", "CPOS"):
            raise RapidError(f"{value.name.lower()}() is where the robot stands: known only while it runs")
        turns = dict(value.options)
        known = all(isinstance(v, float) for v in (*numbers, *turns.values()))
        if (
            value.name not in ("OFFS", "RELTOOL")
            or len(numbers) != 3
            or not known
            or (turns and (value.name == "OFFS" or not set(turns) <= {"RX", "RY", "RZ"}))
        ):
            raise RapidError(f"{value.name.lower()}(…) is not evaluated; expand the program first")
        point = self.resolved(value.arguments[0], depth + 1)
        x, y, z, q, rest = robtarget(point)
        d = np.array(numbers, float)
        if value.name == "RELTOOL":
            rows = from_quaternion(*q)
            if rows is None:
                raise RapidError("a quaternion is not of unit length")
            d = np.array(rows).reshape(3, 3) @ d
        for axis in ("RX", "RY", "RZ"):  # about the tool's axes as they lie after the turn before
            if axis in turns:
                q = _turned(q, axis, float(turns[axis]))  # type: ignore[arg-type]
        return [[x + d[0], y + d[1], z + d[2]], list(q), *rest]

    def look_around(self, name: str) -> None:
        """Declarations in the other modules of the folder."""
        if self.looked_around:
            return
        self.looked_around = True
        for file in siblings(self.out.source.path, _ENDINGS):
            other = opened(file)
            if other is None or not re.search(rf"\b{re.escape(name)}\b", "\n".join(other.lines), re.IGNORECASE):
                continue
            before = dict(self.data)
            for s in read_module(other).data:
                self.declare(s)
            self.data |= before  # what this module says holds
            self.out.files.append(file)

    # ---- motion

    def motion(self, word: str, values: list[object], options: dict[str, object], line: int, proc: Proc) -> None:
        if word.startswith(("TRIGG", "SEARCH", "MOVEEXT")):
            raise RapidError(f"{word} is not read; MoveJ, MoveL, MoveC or MoveAbsJ would work")
        count = 2 if word.startswith("MOVEC") else 1
        if len(values) < count + 3:
            raise RapidError(f"found {len(values)} arguments; expected a target, speed, zone and tool")
        for option in options:
            if option not in ("WOBJ", "ID", "CONC", "V", "T", "Z", "INPOS", "NOEOFFS", "TLOAD", "DO", "AO", "GO"):
                self.out.ignore(f"\\{option}", line, understood=False)
        if isinstance(values[0], Call) and values[0].name in ("CROBT", "CJOINTT"):
            self.out.ignore(f"{word} {values[0].name} (to where the robot stands)", line, understood=True)
            self.out.warn_once("a move to where the robot stands is no part of the path: left out", line)
            return
        targets = [self.resolved(v) for v in values[:count]]
        feed = min(self.speed(values[count], line, proc), self.fastest)
        if isinstance(options.get("V"), float):
            feed = float(options["V"]) * 1e-3  # type: ignore[arg-type]
        if "T" in options:
            feed = math.nan
        blend = self.zone(values[count + 1])
        self.frames(values[count + 2], options.get("WOBJ"))
        if word == "MOVEABSJ":
            axes, external = jointtarget(targets[0])
            self.out.joint(axes, line, blend=blend, external=external)
            return
        x, y, z, q, rest = robtarget(targets[-1])
        rows = from_quaternion(*q)
        if rows is None:
            raise RapidError(f"quaternion {list(q)} is not of unit length")
        if abs(sum(c * c for c in q) - 1.0) > NORMALISED:
            self.out.ignore("length of a quaternion", line, understood=False)
        external = externals(rest[1]) if len(rest) > 1 else []
        bits = confdata(rest[0]) if rest else {}
        if word.startswith("MOVEC"):
            vx, vy, vz, vq, _ = robtarget(targets[0])
            via_rows = from_quaternion(*vq)
            if via_rows is None:
                raise RapidError(f"quaternion {list(vq)} is not of unit length")
            via = matrix(via_rows, vx * 1e-3, vy * 1e-3, vz * 1e-3)
            end = matrix(rows, x * 1e-3, y * 1e-3, z * 1e-3)
            self.out.circle(via, end, line, feed=feed, blend=blend, external=external, configuration=bits)
            return
        seconds = options.get("T")
        if isinstance(seconds, float) and seconds > 0.0 and self.out.last is not None:
            feed = math.dist(self.out.last[:3, 3] * 1e3, (x, y, z)) * 1e-3 / seconds
        kind = JOINT if word.startswith("MOVEJ") else LINEAR
        self.out.pose(
            kind,
            rows,
            x * 1e-3,
            y * 1e-3,
            z * 1e-3,
            line,
            feed=feed if kind == LINEAR else math.nan,
            blend=blend,
            external=external,
            configuration=bits,
        )

    def speed(self, value: object, line: int, proc: Proc) -> float:
        """m/s; NaN where it is set elsewhere."""
        if isinstance(value, Name) and value.text not in self.data:
            known = _SPEED.fullmatch(value.text)
            if known:
                return float(known.group(1)) * 1e-3
            if value.text != "VMAX":
                where = "an argument of the procedure" if value.text in proc.parameters else "declared elsewhere"
                self.out.ignore(f"speed {value.shown} ({where})", line, understood=False)
            return math.nan
        found = self.resolved(value)
        if isinstance(found, list) and found and isinstance(found[0], float):
            return found[0] * 1e-3
        return math.nan

    def zone(self, value: object) -> float:
        """m; 0 for a stop point."""
        if isinstance(value, Name) and value.text not in self.data:
            known = _ZONE.fullmatch(value.text)
            if known:
                return (float(known.group(1)) or 0.3) * 1e-3
            return 0.0 if value.text == "FINE" else math.nan
        found = self.resolved(value)
        if isinstance(found, list) and len(found) > 1 and isinstance(found[1], float):
            stops = isinstance(found[0], Name) and found[0].text == "TRUE"
            return 0.0 if stops else found[1] * 1e-3
        return math.nan

    def frames(self, tool: object, base: object) -> None:
        tool_name = tool.text if isinstance(tool, Name) else "TOOL"
        base_name = base.text if isinstance(base, Name) else "WOBJ0"
        if tool_name != self.tool_name:
            self.tool_name = tool_name
            self.out.set_tool(Frame(tool_name.lower(), self.frame(tool, "TOOL0", False)))
        if base_name != self.base_name:
            self.base_name = base_name
            self.out.set_base(Frame(base_name.lower(), self.frame(base, "WOBJ0", True), self.moved_by(base)))
            self.out.last = None

    def moved_by(self, value: object) -> str:
        """The mechanical unit that carries a work object, empty for one that stands still or is not known."""
        if not isinstance(value, Name) or value.text not in self.data:
            return ""
        try:
            found = self.resolved(value)
        except RapidError:
            return ""
        return _moved(found) if isinstance(found, list) else ""

    def frame(self, value: object, zero: str, work_object: bool) -> Array | None:
        """(4, 4) of tooldata or wobjdata, None where the controller holds it."""
        if value is None or (isinstance(value, Name) and value.text == zero):
            return np.eye(4)
        if isinstance(value, Name) and value.text not in self.data:
            return None
        try:
            found = self.resolved(value)
        except RapidError:
            return None
        if not isinstance(found, list):
            return None
        holds = isinstance(found[0], Name) and found[0].text == "TRUE" if found else False
        if found and isinstance(found[0], Name) and holds == work_object:
            name = (
                f"{'wobjdata' if work_object else 'tooldata'} {value.shown if isinstance(value, Name) else ''}".strip()
            )
            raise RapidError(f"{name} (robhold): {STANDING_TOOL}")
        places = found[3:5] if work_object else found[1:2]
        if work_object and _moved(found):  # what the user frame says does not count, the unit's place does
            places = found[4:5]
        out = np.eye(4)
        for place in places:
            if not (isinstance(place, list) and len(place) == 2):
                return None
            p, q = (numbers(v, n) for v, n in zip(place, (3, 4), strict=True))
            rows = None if q is None else from_quaternion(*q)
            if p is None or rows is None:
                return None
            out = out @ matrix(rows, p[0] * 1e-3, p[1] * 1e-3, p[2] * 1e-3)
        return out


def _moved(found: list[object]) -> str:
    """The mechanical unit that moves wobjdata (ufprog FALSE), empty for one that stands still."""
    if len(found) < 3 or not (isinstance(found[1], Name) and found[1].text == "FALSE"):
        return ""
    return found[2] if isinstance(found[2], str) else "?"


def _plain(s: Statement) -> str:
    return " ".join(t.text for t in s.tokens)[:120]


def _turned(q: Quaternion, axis: str, degrees: float) -> Quaternion:
    """``q`` turned about one of its own axes."""
    half = math.radians(degrees) / 2.0
    b = [math.cos(half), 0.0, 0.0, 0.0]
    b[("RX", "RY", "RZ").index(axis) + 1] = math.sin(half)
    w, x, y, z = q
    return (
        w * b[0] - x * b[1] - y * b[2] - z * b[3],
        w * b[1] + x * b[0] + y * b[3] - z * b[2],
        w * b[2] - x * b[3] + y * b[0] + z * b[1],
        w * b[3] + x * b[2] - y * b[1] + z * b[0],
    )
