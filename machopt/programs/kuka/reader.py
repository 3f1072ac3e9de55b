"""Reader of KUKA KRL: executes a ``.src`` with its ``.dat`` as the controller does, without formulas and branches."""

from __future__ import annotations

import math
import re
from typing import NoReturn

from machopt.file_formats.source_file import SourceFile
from machopt.programs.kuka.expression_values import (
    KrlMemory,
    KrlValueError,
    evaluate_expression,
    evaluate_whole_number,
    split_variable_name,
    try_evaluate,
)
from machopt.programs.kuka.file_routines import OPENS, KrlLine, KrlRoutine, get_first_word, read_krl_module
from machopt.programs.kuka.harmless_words import KRL_CALLS, KRL_STATEMENTS, KRL_VARIABLES, ORIENTATION_IGNORED
from machopt.programs.kuka.move_statements import KrlMoves
from machopt.programs.kuka.move_targets import POSE, build_pose
from machopt.programs.kuka.statement_patterns import MOVE, SWITCHES, TYPES, WITHOUT_EFFECT, is_harmless_statement
from machopt.programs.reading.called_files import find_called_file, find_sibling_files, try_read_source
from machopt.programs.reading.line_by_line_execution import LineFollower
from machopt.programs.reading.parsed_program import ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import MOST_MOVES, STANDING_TOOL, ProgramBuilder

_DECLARE = re.compile(
    r"(?:DECL\s+|GLOBAL\s+|CONST\s+)*(?!PTP\b|LIN\b|RETURN\b|WAIT\b)([A-Za-z_]\w*)\s+(?:GLOBAL\s+)?(\$?[A-Za-z_]\w*)\s*"
    r"(\[[^\]]*\])?\s*((?:,[^=]*)?)(?:=(.*))?",
    re.IGNORECASE,
)
_ASSIGN = re.compile(r"(\$?[A-Za-z_]\w*\s*(?:\[[^\]]*\])?\s*(?:\.\s*\w+\s*)*)=(?!=)(.*)")
_CALL = re.compile(r"([A-Za-z_]\w*)\s*\((.*)\)\s*")
_FOR = re.compile(r"FOR\s+(\w+)\s*=\s*(.+?)\s+TO\s+(.+?)(?:\s+STEP\s+(.+))?", re.IGNORECASE)
_KINEMATIC = re.compile(
    r"EK\s*\(\s*MACHINE_DEF\s*\[([^\]]+)\]\s*\.\s*ROOT\s*,"
    r"\s*MACHINE_DEF\s*\[([^\]]+)\]\s*\.\s*MECH_TYPE\s*,\s*(.+)\)",
    re.IGNORECASE,
)
_TEXT_ARRAY = re.compile(r"\$?\w+\s*\[\s*\]\s*")
EVENTFUL = ("$OUT", "$ANOUT", "$CYCFLAG", "$FLAG")


def read_krl(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a KRL program.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames, events and unknown words of the program.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    return _KrlReader(ProgramBuilder(source=source, dialect="krl", arc_tolerance=arc_tolerance, strict=strict)).run()


class _KrlReader(LineFollower[KrlRoutine]):
    value_error = KrlValueError

    def __init__(self, out: ProgramBuilder) -> None:
        self.out, self.memory, self.routines = out, KrlMemory(), dict[str, KrlRoutine]()
        self.feed_outside = math.nan  # m/s, before a spline block
        self.returned = False  # a RETURN was reached in the routine that is followed
        self.moves = KrlMoves(out, self.memory)
        self.framed: dict[str, str] = {}  # base and tool that an inline form has set
        self.memory.plain["$NULLFRAME"] = dict.fromkeys(POSE, 0.0)

    def run(self) -> ParsedProgram:
        source = self.out.source
        first = self.load(source)
        own = find_called_file(source.path, source.path.stem, (".dat", ".src"))  # the other half of the module
        if own is not None:
            other = self.load(own)
            first = first or other
            self.out.files.append(own.path)
        if first is None:
            raise self.out.error("is a data list without a program; give the .src that moves to its points")
        self.out.name = first.name
        self.globals(source)
        self.follow(first, 0, len(first.lines), 0)
        return self.out.build()

    # ---- reading files

    def load(self, source: SourceFile) -> KrlRoutine | None:
        """Take in the routines and data of a file; its first routine is its program."""
        module = read_krl_module(source)
        for routine in module.routines:
            self.routines.setdefault(routine.name.upper(), routine)
        if module.routines:
            for line in module.unassigned_lines:
                self.out.ignore("text outside of DEF … END", line.number, understood=False, stops=False)
        if module.is_incomplete:
            self.out.warn_once("the program has no END: the file may be cut off", len(source.lines))
        for line in module.data:
            self.declaration(line.code, line.number, source)
        return module.routines[0] if module.routines else None

    def globals(self, source: SourceFile) -> None:
        """GLOBAL data of the other data lists in the folder, for names that are not declared here."""
        mine = {*self.memory.plain, *self.memory.arrays}
        own_stem = source.path.stem.lower()
        needed = {
            m.group(1).upper()
            for r in self.routines.values()
            for line in r.lines
            if (m := re.match(r"(?:S?PTP|S?LIN|SPL|S?CIRC)\s+([A-Za-z_]\w*)", line.code, re.IGNORECASE))
        } - mine
        if not needed:
            return
        for file in find_sibling_files(source.path, (".dat",)):
            if file.stem.lower() == own_stem:
                continue
            other = try_read_source(file)
            if other is None or not any("GLOBAL" in t.upper() for t in other.lines[:200]):
                continue
            head = "\n".join(other.lines).upper()
            if any(re.search(rf"\b{re.escape(name)}\b", head) for name in needed):
                self.load(other)
                self.out.files.append(file)

    def declaration(self, code: str, line: int, source: SourceFile) -> None:
        try:
            assigned = _ASSIGN.fullmatch(code)
            if assigned is not None:
                self.assign(assigned.group(1), assigned.group(2), line)
                return
            found = _DECLARE.fullmatch(code)
            if found is None:
                # a name that it may declare stays unknown, and a move to it is refused
                self.out.ignore(get_first_word(code), line, understood=bool(WITHOUT_EFFECT.match(code)), stops=False)
                return
            name = found.group(2).upper()
            if found.group(5) is not None:
                value = try_evaluate(found.group(5), self.memory)
                if found.group(3) is None:
                    self.memory.put(name, None, [], value)
            elif found.group(3) is not None:
                self.memory.arrays.setdefault(name, {})
            else:
                for other in [name, *(w.strip().upper() for w in (found.group(4) or "").split(",") if w.strip())]:
                    self.memory.plain.setdefault(other, None)
        except KrlValueError as problem:
            raise self.out.error(str(problem), line, source) from None

    # ---- following the program

    def statement(self, routine: KrlRoutine, k: int, depth: int) -> int:
        """Carry out line k; returns the last line that is done with."""
        line = routine.lines[k]
        code = line.code
        word = get_first_word(code)
        if word in OPENS:
            return self.block(routine, k, word, depth)
        if found := MOVE.fullmatch(code):
            self.moves.move(found.group(1).upper(), found.group(2), line.number)
        elif word in ("GOTO", "EXIT", "RETURN", "RESUME") or code.endswith(":"):
            if word == "GOTO":
                raise self.out.error(
                    "GOTO: jumps are not followed; expand the program first", line.number, routine.source
                )
            self.out.ignore(word, line.number, understood=code.endswith(":") or word == "RETURN")
            self.returned = word == "RETURN"
        elif word == "WAIT":
            seconds = (
                try_evaluate(code[4:].strip()[3:], self.memory) if code[4:].strip().upper().startswith("SEC") else None
            )
            dwell = isinstance(seconds, float)
            self.out.event(code, "dwell" if dwell else "comment", seconds if isinstance(seconds, float) else math.nan)
        elif word == "HALT":
            self.out.event(code, "stop")
        elif word in ("SPLINE", "ENDSPLINE"):
            self.spline(word, code, line.number)
        elif found := _ASSIGN.fullmatch(code):
            self.assign(found.group(1), found.group(2), line.number)
        elif found := _CALL.fullmatch(code):
            self.call(found.group(1), found.group(2), line, routine, depth)
        elif WITHOUT_EFFECT.match(code) or word in KRL_STATEMENTS:
            self.out.ignore(word, line.number, understood=True)
        elif word == "TRIGGER" and SWITCHES.search(code):
            self.out.event(code, "comment")
        elif _DECLARE.fullmatch(code) and word in TYPES:
            self.declaration(code, line.number, routine.source)
        else:
            self.out.ignore(word or code, line.number, understood=False)
        return k

    def block(self, routine: KrlRoutine, k: int, word: str, depth: int) -> int:
        line, end = routine.lines[k], routine.ends[k]
        loop = _FOR.fullmatch(line.code) if word == "FOR" else None
        if loop is not None:
            first, last = (
                evaluate_whole_number(loop.group(2), self.memory),
                evaluate_whole_number(loop.group(3), self.memory),
            )
            step = evaluate_whole_number(loop.group(4), self.memory) if loop.group(4) else 1
            if step == 0:
                raise KrlValueError("FOR … STEP 0 never ends")
            if abs(last - first) > MOST_MOVES * abs(step):
                raise KrlValueError(
                    f"FOR runs {abs(last - first) // abs(step) + 1} times; expected {MOST_MOVES} at most"
                )
            for value in range(first, last + (1 if step > 0 else -1), step):
                self.memory.put(loop.group(1).upper(), None, [], float(value))
                self.out.step(line.number)
                self.follow(routine, k + 1, end, depth)
            return end
        for inner in routine.lines[k + 1 : end]:
            if get_first_word(inner.code) == "GOTO":
                self.refuse_runtime_decision(word, line.number, routine.source)
            elif get_first_word(inner.code) == "RETURN":
                self.out.may_end(inner.number)
            calls = _CALL.fullmatch(inner.code)
            if (assigned := _ASSIGN.fullmatch(inner.code)) is not None:
                self.mark_variable_unknown(assigned.group(1), word, line.number, routine.source)
            elif calls and calls.group(1).upper() == "BAS":
                self.refuse_runtime_decision(word, line.number, routine.source)
            elif calls and calls.group(1).upper() not in (*self.routines, *KRL_CALLS):
                self.out.ignore(f"{calls.group(1)}( )", inner.number, understood=False)
            elif not calls and inner.code and not is_harmless_statement(inner.code):
                self.out.ignore(get_first_word(inner.code), inner.number, understood=False)
            if MOVE.fullmatch(inner.code) or (calls and calls.group(1).upper() in self.routines):
                self.refuse_runtime_decision(word, line.number, routine.source)
        self.out.ignore(f"{word} without moves inside", line.number, understood=True)
        return end

    def mark_variable_unknown(self, left: str, word: str, line: int, source: SourceFile) -> None:
        """A variable that a branch assigns while the robot runs: its value is not known from here on.

        Raises:
            InputError: it is a frame, or what frames and feeds are counted in.
        """
        name = left.split("[", maxsplit=1)[0].split(".", maxsplit=1)[0].strip().upper()
        if name in ("$BASE", "$TOOL", "$IPO_MODE", "$OV_PRO"):
            self.refuse_runtime_decision(word, line, source)
        if name == "$VEL":
            self.out.feed = math.nan
        elif not name.startswith("$"):
            self.memory.plain[name] = None
            for index in self.memory.arrays.get(name, {}):
                self.memory.arrays[name][index] = None
        elif name not in (*KRL_VARIABLES, *EVENTFUL):
            self.out.ignore(f"{name}=", line, understood=False)

    def refuse_runtime_decision(self, word: str, line: int, source: SourceFile) -> NoReturn:
        raise self.out.error(
            f"{word} decides about moves while the robot runs: they are not known here; expand the program first",
            line,
            source,
        )

    def call(self, name: str, arguments: str, line: KrlLine, routine: KrlRoutine, depth: int) -> None:
        upper = name.upper()
        if upper == "BAS":
            self.bas(arguments)
            return
        target = self.routines.get(upper)
        if target is None and upper in KRL_CALLS:
            self.out.event(f"{name}({arguments})", "comment")
            return
        if target is None:
            other = find_called_file(routine.source.path, name, (".src",))
            if other is not None:
                self.load(other)
                self.out.files.append(other.path)
                target = self.routines.get(upper)
        if target is None:
            self.out.event(f"{name}( )")
            self.out.ignore(f"{name}( )", line.number, understood=False)
            return
        self.follow(target, 0, len(target.lines), depth + 1)
        self.returned = False

    def bas(self, arguments: str) -> None:
        """KUKA's own set-up routine: speeds and numbered frames."""
        what, _, value = arguments.partition(",")
        what = what.strip().upper()
        if what in ("#CP_PARAMS", "#PTP_PARAMS"):
            self.inline_frames()
        if what in ("#VEL_CP", "#CP_PARAMS"):
            speed = evaluate_expression(value, self.memory)
            self.out.feed = speed if isinstance(speed, float) else math.nan
        elif what == "#BASE":
            self.frame("$BASE", f"BASE_DATA[{value.strip()}]")
        elif what == "#TOOL":
            self.frame("$TOOL", f"TOOL_DATA[{value.strip()}]")

    def spline(self, word: str, code: str, line: int) -> None:
        """A spline block: a speed in its head holds inside of it."""
        if word == "ENDSPLINE":
            self.out.feed = self.feed_outside
        else:
            self.feed_outside = self.out.feed
            if found := re.search(r"\$VEL\.CP\s*=\s*([^,]+)", code, re.IGNORECASE):
                value = try_evaluate(found.group(1), self.memory)
                self.out.feed = value if isinstance(value, float) else math.nan
        self.out.ignore(word, line, understood=True)

    def inline_frames(self) -> None:
        """The numbers of base and tool in the data of an inline form (FDAT_ACT = F…) hold from here on."""
        data = self.memory.plain.get("FDAT_ACT")
        for word, key, table in (("$BASE", "BASE_NO", "BASE_DATA"), ("$TOOL", "TOOL_NO", "TOOL_DATA")):
            number = data.get(key) if isinstance(data, dict) else None
            if isinstance(number, float):
                name = "$NULLFRAME" if number == 0.0 else f"{table}[{number:.0f}]"
                if self.framed.get(word) != name:
                    self.frame(word, name)
                    self.framed[word] = name

    def assign(self, left: str, right: str, line: int) -> None:
        if _TEXT_ARRAY.fullmatch(left):  # NAME[] is a whole array of characters: no target is one
            self.out.ignore("text", line, understood=True)
            return
        name = split_variable_name(left, self.memory)
        if name is None:
            raise KrlValueError(f"{left.strip()[:30]!r} cannot be assigned to")
        word, index, fields = name
        if word in ("$BASE", "$TOOL") and not fields:
            self.frame(word, right.strip())
            return
        if word in ("$BASE", "$TOOL"):
            raise KrlValueError(f"{left.strip()} moves one component of a frame: not followed; assign the whole frame")
        value = try_evaluate(right, self.memory)
        self.memory.put(word, index, fields, value)
        if word == "$OV_PRO":
            self.out.override(value if isinstance(value, float) else None, line)
            return
        if word == "$IPO_MODE":
            if right.strip().upper() != "#BASE":
                raise KrlValueError(f"$IPO_MODE={right.strip()[:20]}: {STANDING_TOOL}")
            self.out.ignore(word + "=", line, understood=True)
            return
        if word == "$VEL" and (fields == ["CP"] or (not fields and isinstance(value, dict) and "CP" in value)):
            speed = value if fields or not isinstance(value, dict) else value["CP"]
            self.out.feed = speed if isinstance(speed, float) else math.nan
        elif word == "$APO" and fields == ["CDIS"]:
            self.moves.corner = value * 1e-3 if isinstance(value, float) else math.nan
        elif word == "$APO" and fields == ["CPTP"]:
            self.moves.joint_corner = value if isinstance(value, float) else math.nan
        elif word in EVENTFUL:
            self.out.event(f"{left.strip()}={right.strip()}", "comment")
        elif word.startswith("$"):
            turns = word == "$ORI_TYPE" and right.strip().upper() in ORIENTATION_IGNORED
            self.out.ignore(f"{word}=", line, understood=word in KRL_VARIABLES and not turns)

    def frame(self, word: str, text: str) -> None:
        rides = ""
        if found := _KINEMATIC.fullmatch(text):
            numbers = {evaluate_whole_number(found.group(k), self.memory) for k in (1, 2)}
            if len(numbers) > 1:
                raise KrlValueError(f"{text[:60]!r} takes root and type of two machines; expected those of one")
            rides, text = f"MACHINE_DEF[{numbers.pop()}]", found.group(3)
        value = try_evaluate(text, self.memory)
        known = isinstance(value, dict) and all(isinstance(value.get(c), float) for c in POSE)
        frame = ProgramFrame(text, build_pose({c: float(value[c]) for c in POSE}) if known else None, rides)  # type: ignore[index]
        if word == "$BASE":
            self.out.set_base(frame)
            self.out.last = None
        else:
            self.out.set_tool(frame)
