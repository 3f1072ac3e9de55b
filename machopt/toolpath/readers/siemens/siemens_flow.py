"""R parameters, variables, jumps and loops of Sinumerik programs, executed as far as the file contains them.

Supported: DEF, assignments, IF … GOTOF/GOTOB label, CASE, IF/ELSE/ENDIF, FOR, WHILE, REPEAT/UNTIL, LOOP, REPEAT and
REPEATB of a part, labels, RET, and subprograms in the same file as ``%_N_NAME_SPF`` or ``PROC NAME``, with parameters,
repeats (``L100 P2``) and modal calls. Labels and block numbers count inside their own program. Lines are returned in
execution order, with every expression replaced by its number.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError, StepGuard
from machopt.toolpath.readers.program_flow.linuxcnc_o_words import MAX_CALLS, FlowItem
from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError
from machopt.toolpath.readers.siemens.line_expressions import LineEvaluator
from machopt.toolpath.readers.siemens.repeated_parts import MAX_REPEATS, REPEAT, RepeatedPart, find_part
from machopt.toolpath.readers.siemens.siemens_expressions import VARIABLE, SiemensVariables
from machopt.toolpath.readers.siemens.subprograms import (
    HEAD,
    CallText,
    Subprogram,
    SubprogramCall,
    bind_call,
    compile_call_pattern,
    enter_call,
    hide_variable,
    index_programs,
    leave_call,
    parse_call,
    split_arguments,
)
from machopt.toolpath.readers.siemens.variable_types import convert_to_type, parse_definitions

NEEDS_FLOW = re.compile(
    r"\bR(?:[0-9]+|\[[^]]*\])\s*=|=\s*[-+]?\s*\(?\s*[A-Z]|\b(?:GOTO[BFCS]?|CASE|WHILE|ENDWHILE|REPEATB?|UNTIL|LOOP|DEF|IF|FOR|CALL|PCALL|EXTERN)\b|\bPROC\s|%_N_\w+_SPF",
    re.IGNORECASE,
)
SAVE_MODES, RESTORE_MODES = "%SAVE", "%RESTORE"  # around a call of PROC … SAVE, for the reader
NEXT_PASS = "%NEXT_PASS"  # of PROC … SAVE: the modes are restored and saved again
_PREFIX = re.compile(r"(?:N[0-9]+\s*)?(?:([A-Z_][A-Z0-9_]+)\s*:(?!=)\s*)?")
_DEF = re.compile(r"DEF\s+(REAL|INT|BOOL|CHAR)\b\s*(.*)")
_IF_GOTO = re.compile(r"IF\s*(.*?)\s*(GOTO[BFC]?)\s+(\w+)\s*")
_GOTO = re.compile(r"(GOTO[BFC]?)\s+(\w+)\s*|(GOTOS)\s*")
_CASE = re.compile(r"CASE\s*(.+?)\s*\bOF\b\s*(.*)")
_CASE_BRANCH = re.compile(r"\s*([-+]?[0-9]+\.?[0-9]*|DEFAULT)\s+(GOTO[BFC]?)\s+(\w+)")
_END = re.compile(r"(?<![\w\"])(?:M0*2|M30)(?![\w\"(=])")  # of a program; in a subprogram a return
_AXIS_WORD = re.compile(r"(?<![A-Z_])[XYZABC]\s*(?:=|[-+.0-9])")
_QUOTED = re.compile(r'"[^"]*"?')  # text, which moves nothing
_FOR = re.compile(rf"FOR\s+({VARIABLE})\s*=\s*(.*)\bTO\b(.*)")
_BLOCKS = {  # word → (closing word, words between)
    "IF": ("ENDIF", ("ELSE",)),
    "FOR": ("ENDFOR", ()),
    "WHILE": ("ENDWHILE", ()),
    "REPEAT": ("UNTIL", ()),
    "LOOP": ("ENDLOOP", ()),
}
_WORD = re.compile(r"(IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|REPEAT|UNTIL|LOOP|ENDLOOP)\b\s*(.*)")
_FLOW_WORD = re.compile(
    r"(?:IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|REPEATB?|UNTIL|LOOP|ENDLOOP|GOTO[BFCS]?|CASE|EXTERN|DEF|RET|M17|M99)\b"
)
_RETURN = re.compile(r"(?<![\w\"])(?:M17|M99|RET)(?![\w\"(=])")  # in a block with other words too


class SiemensFlow:
    """Carries out one program line by line."""

    def __init__(self, items: Sequence[FlowItem]) -> None:
        self.items = [
            (line, *_PREFIX.match(text).groups(), _PREFIX.sub("", text, 1).strip(), comments)  # type: ignore[union-attr]
            for line, text, comments in items
        ]
        self.raw = items
        self.variables = SiemensVariables()
        self.labels: dict[str, list[int]] = {}
        self.programs, self.owners = index_programs(items)
        self.call_pattern = compile_call_pattern(list(self.programs))
        self.partner: dict[int, int] = {}  # block word → the next one of its block
        self.loop_of: dict[int, int] = {}  # closing word → opening word
        self.limits: dict[int, float] = {}  # FOR → its end value
        self.frames: list[SubprogramCall] = []
        self.modal: tuple[CallText, Subprogram] | None = None  # MCALL
        self.notes: list[str] = []  # readings that depend on the control, for the reader
        self.parts: list[RepeatedPart] = []
        self.plain: set[int] = set()  # places of lines that only assign and move
        self.called = False
        self.lines = LineEvaluator(self.variables, [code for _, _, code, _ in self.items])
        self._index()

    @property
    def only_subroutines(self) -> bool:
        return False

    def _index(self) -> None:
        opened: list[tuple[str, int, int]] = []  # closing word, first and latest place
        for k, (line, label, code, _) in enumerate(self.items):
            if label:
                self.labels.setdefault(label, []).append(k)
            word = self._find_block_word(code)
            if word is None:
                continue
            if word in _BLOCKS:
                opened.append((_BLOCKS[word][0], k, k))
                continue
            if word == "ELSE" and opened and opened[-1][0] == "ENDIF":
                closing, start, latest = opened.pop()
                self.partner[latest] = k
                opened.append((closing, start, k))
                continue
            if not opened or opened[-1][0] != word:
                raise ProgramFlowError(f"{word} does not close what was opened before it", line)
            _, start, latest = opened.pop()
            self.partner[latest] = k
            self.loop_of[k] = start
        for k, (_, _, code, _) in enumerate(self.items):
            if code and not (
                _FLOW_WORD.match(code)
                or _RETURN.search(code)
                or HEAD.fullmatch(self.raw[k][1])
                or parse_call(code, self.call_pattern)
                or code.startswith("MCALL")
                or (self.programs and _END.search(code))
            ):
                self.plain.add(k)
        if opened:
            raise ProgramFlowError(f"a block is never closed; expected {opened[-1][0]}", self.items[opened[-1][1]][0])

    def _find_block_word(self, code: str) -> str | None:
        found = _WORD.fullmatch(code)
        if not found or _IF_GOTO.fullmatch(code):
            return None
        if found.group(1) == "REPEAT" and found.group(2):
            return None  # REPEAT label P=n
        return found.group(1)

    def run(self) -> Iterator[FlowItem]:
        """Lines as they are carried out.

        Raises:
            FlowError: a loop without end, a jump or call into what the file does not hold.
        """
        at = 0
        guard = StepGuard(len(self.items))
        if self.owners and self.owners[0].parameters:  # called from outside: with the defaults only
            for p in self.owners[0].parameters:
                self.variables.types[p.name] = p.type
                if p.default:
                    self.variables.assign(p.name, self.variables.value(p.default))
        while at < len(self.items) or self.frames:
            before, frames = at, len(self.frames)
            line, _, code, comments = self.items[at] if at < len(self.items) else (self.items[-1][0], None, "", [])
            guard.step(line)
            try:
                if self.frames and not self.frames[-1].program.first <= at < self.frames[-1].program.last:
                    self.notes.append("a subprogram without M17 or RET returns at its end")
                    text, at = self._run_return()
                else:
                    text, at = self._step(at, code)
                at = self._find_next_after_part(before, at, returned=len(self.frames) < frames)
            except MacroExpressionError as problem:
                raise ProgramFlowError(str(problem), line) from problem
            guard.count_idle_lines(anything=bool(text), line=line)
            if at <= before:
                state = (
                    tuple(self.variables.values.items()),
                    tuple(self.limits.items()),
                    tuple((call.back, call.repeats) for call in self.frames),
                    tuple((part.first, part.left, part.back) for part in self.parts),
                )
                guard.check_backward_jump(at, state, line)
            if text or comments:
                yield line, text, comments

    def _step(self, at: int, code: str) -> tuple[str, int]:
        line = self.items[at][0]
        value = self.variables.value
        if at in self.plain:
            text = self.lines.replace_expressions(code)
            if (
                self.modal is not None
                and _AXIS_WORD.search(_QUOTED.sub("", code))
                and not any(call.modal for call in self.frames)
            ):
                bound = bind_call(*self.modal, at + 1, line, self.variables)
                bound.modal = True
                return text, self._enter(bound)[1]
            return text, at + 1
        if not code:
            return "", at + 1
        if HEAD.fullmatch(self.raw[at][1]):
            if not self.frames and self.owners[at] is not self.owners[0]:
                return "M30", len(self.items)  # the main program ran to its end
            return "", at + 1
        if found := _IF_GOTO.fullmatch(code):
            return "", self._run_jump(found.group(2), found.group(3), at) if value(found.group(1)) else at + 1
        if found := _GOTO.fullmatch(code):
            return "", self.owners[at].first if found.group(3) else self._run_jump(found.group(1), found.group(2), at)
        if found := _CASE.fullmatch(code):
            return "", self._run_case(at, *found.groups())
        if found := _DEF.fullmatch(code):
            self._define(*found.groups())
            return "", at + 1
        word = self._find_block_word(code)
        if word is not None:
            return "", self._run_block(word, at, code)
        if found := REPEAT.fullmatch(code):
            return "", self._repeat(at, found.groups())
        if code.startswith("REPEAT"):
            raise ProgramFlowError(f"{code[:30]!r}: expected REPEAT label [label] P=times", line)
        if code.startswith("EXTERN"):
            return "", at + 1  # declares a subprogram; its call is what counts
        if '"' not in code and (found := _RETURN.search(code)) and (self.frames or found.group() != "M99"):
            text = self.lines.replace_expressions(_RETURN.sub(" ", code))  # other words of the block come first
            if self.frames:
                back, at = self._run_return()
                return f"{text} {back}".strip(), at
            return f"{text} M30", len(self.items)
        if self.frames and '"' not in code and _END.search(code):
            self.notes.append("M2 or M30 in a subprogram is read as its return, like M17")
            text = self.lines.replace_expressions(_END.sub(" ", code))
            back, at = self._run_return()
            return f"{text} {back}".strip(), at
        if call := parse_call(code, self.call_pattern):
            return self._call(at, call)
        if code.startswith("MCALL"):
            self.modal = None
        return self.lines.replace_expressions(code), at + 1

    def _call(self, at: int, call: CallText) -> tuple[str, int]:
        """Call a subprogram of this file, or (MCALL) have it called after each block that moves."""
        line, program = self.items[at][0], self.programs[call.name]
        if not call.alone:
            raise ProgramFlowError(
                f"the call of {call.name} and other words in one block: which comes first is not stated. Expected the "
                "call in a block of its own",
                line,
            )
        bound = bind_call(call, program, at + 1, line, self.variables)
        if call.way == "MCALL":
            values = ",".join(f"{v:.12f}" for v in bound.values.values())
            if bound.returned or len(bound.values) < len(program.parameters):
                raise ProgramFlowError(f"MCALL {call.name}: only parameters that are plain values are followed", line)
            self.modal = CallText("", call.name, values, call.repeats, alone=True), program
            return "MCALL", at + 1  # ends a modal drilling cycle
        return self._enter(bound)

    def _enter(self, call: SubprogramCall) -> tuple[str, int]:
        if len(self.frames) >= MAX_CALLS:
            raise ProgramFlowError(f"more than {MAX_CALLS} nested calls: does a subprogram call itself?", call.line)
        self.called = True
        self.frames.append(call)
        enter_call(call, self.variables)
        return SAVE_MODES if call.program.saves_modes else "", call.program.first

    def _run_return(self) -> tuple[str, int]:
        """Return from a subprogram, or begin its next pass; the text restores the modes where it saved them."""
        call = self.frames.pop()
        leave_call(call, self.variables)
        self.parts = [part for part in self.parts if part.depth <= len(self.frames)]
        text = RESTORE_MODES if call.program.saves_modes else ""
        if call.repeats:
            call.repeats -= 1
            call.values.update({name: self.variables.values[to] for name, to in call.returned.items()})
            self.frames.append(call)
            enter_call(call, self.variables)
            return NEXT_PASS if text else "", call.program.first
        return text, call.back

    def _list_places(self, label: str, at: int) -> list[int]:
        """Places of a label or block number in the program of a line."""
        if label.startswith("N") and label[1:].isdigit():
            number = re.compile(rf"N0*{int(label[1:])}(?![0-9])")
            places = [k for k, (_, text, _) in enumerate(self.raw) if number.match(text)]
        else:
            places = self.labels.get(label, [])
        return [k for k in places if self.owners[k] is self.owners[at]]

    def _repeat(self, at: int, words: tuple[str | None, ...]) -> int:
        """REPEAT label [label] P=n, REPEATB label P=n: the part once more, n times."""
        block, first, second, formula, number = words
        line = self.items[at][0]
        assert first is not None
        ends = self._list_places(second, at) if second else []
        found: tuple[int, int] | str = f"{second} is not in this program"
        if ends or not second:
            found = find_part(bool(block), self._list_places(first, at), ends, self._list_places("ENDLABEL", at), at)
        if isinstance(found, str):
            raise ProgramFlowError(f"REPEAT{block} {first}: {found}", line)
        count = self.variables.value(formula or number or "1")
        if count != round(count) or not 0 <= count <= MAX_REPEATS:
            raise ProgramFlowError(f"REPEAT{block} {first} P={count:g}: expected 0 to {MAX_REPEATS} repeats", line)
        if len(self.parts) >= MAX_CALLS:
            raise ProgramFlowError(f"more than {MAX_CALLS} nested repeats", line)
        if count < 1:
            return at + 1
        self.parts.append(RepeatedPart(*found, round(count) - 1, at + 1, len(self.frames)))
        return found[0]

    def _find_next_after_part(self, before: int, at: int, *, returned: bool) -> int:
        """Where to go on after a line that may be the last one of a repeated part."""
        while self.parts:
            part = self.parts[-1]
            if at != part.last + 1 or len(self.frames) != part.depth or not (before == part.last or returned):
                break
            if part.left > 0:
                part.left -= 1
                return part.first
            self.parts.pop()
            before, at = part.back - 1, part.back
        return at

    def _run_jump(self, word: str, label: str, at: int) -> int:
        places = self._list_places(label, at)
        ahead, behind = [k for k in places if k > at], [k for k in places if k <= at]
        order = {"GOTOF": ahead, "GOTOB": behind[::-1]}.get(word, ahead + behind[::-1])
        if not order:
            if word == "GOTOC":  # without a target it goes on with the next block
                return at + 1
            raise ProgramFlowError(
                f"{word} {label}: no such label {'ahead' if word == 'GOTOF' else 'there'} in this program",
                self.items[at][0],
            )
        self.parts = [p for p in self.parts if p.depth != len(self.frames) or p.first <= order[0] <= p.last]
        return order[0]

    def _run_case(self, at: int, formula: str, branches: str) -> int:
        """CASE value OF number GOTOF label … DEFAULT GOTOF label."""
        found = list(_CASE_BRANCH.finditer(branches))
        if not found or "".join(f.group() for f in found) != branches.rstrip():
            raise ProgramFlowError("expected CASE value OF number GOTOF label … DEFAULT GOTOF label", self.items[at][0])
        value = self.variables.value(formula)
        if value != round(value):
            raise MacroExpressionError(f"CASE {value:g}: expected a whole number to compare with")
        for branch in found:
            if branch.group(1) == "DEFAULT" or float(branch.group(1)) == value:
                return self._run_jump(branch.group(2), branch.group(3), at)
        return at + 1

    def _run_block(self, word: str, at: int, code: str) -> int:
        found = _WORD.fullmatch(code)
        assert found is not None
        rest, value = found.group(2), self.variables.value
        if word == "IF":
            return at + 1 if value(rest) else self.partner[at] + 1
        if word == "WHILE":
            return at + 1 if value(rest) else self.partner[at] + 1
        if word == "FOR":
            return self._run_for(at, code)
        if word == "ENDFOR":
            return self._run_next(at)
        if word == "UNTIL":
            return at + 1 if value(rest) else self.loop_of[at] + 1
        if word in ("ENDWHILE", "ENDLOOP"):
            return self.loop_of[at]
        return self.partner[at] + 1 if word == "ELSE" else at + 1

    def _run_for(self, at: int, code: str) -> int:
        found = _FOR.fullmatch(code)
        if not found:
            raise ProgramFlowError("expected FOR name = value TO value", self.items[at][0])
        name, start, end = self.variables.name_of(found.group(1)), *map(self.variables.value, found.group(2, 3))
        of_real = self.variables.types.get(name.partition("[")[0], "REAL") == "REAL"
        if end != round(end) or (of_real and start != round(start)):
            raise MacroExpressionError(
                f"FOR {name}={start:g} TO {end:g}: a loop counts whole numbers; expected them as its start and end"
            )
        self.variables.assign(name, start)
        self.limits[at] = end
        return at + 1 if self.variables.values[name] <= self.limits[at] else self.partner[at] + 1

    def _run_next(self, at: int) -> int:
        start = self.loop_of[at]
        found = _FOR.fullmatch(self.items[start][2])
        assert found is not None
        name = self.variables.name_of(found.group(1))
        self.variables.assign(name, self.variables.values.get(name, 0.0) + 1.0)
        return start + 1 if self.variables.values[name] <= self.limits.get(start, 0.0) else at + 1

    def _define(self, kind: str, text: str) -> None:
        for found in parse_definitions(split_arguments(text)):
            names = [found.name] if found.size is None else [f"{found.name}[{k}]" for k in range(found.size)]
            given = [self.variables.value(part) for part in split_arguments(found.values)] if found.values else []
            if len(given) > (1 if found.repeats else len(names)):
                raise MacroExpressionError(f"DEF {found.name}: {len(given)} values for {len(names)} elements")
            given = given * len(names) if found.repeats else given
            for k, name in enumerate(names):
                if self.frames:
                    hide_variable(self.frames[-1], name, self.variables)
                value = given[k] if k < len(given) else 0.0
                self.variables.values[name] = convert_to_type(value, kind, name)
            self.variables.types[found.name] = kind
