"""R parameters, variables, jumps and loops of Sinumerik programs, executed as far as the file contains them.

Supported: DEF, assignments, IF … GOTOF/GOTOB label, IF/ELSE/ENDIF, FOR, WHILE, REPEAT/UNTIL, LOOP, labels, RET, and
subprograms in the same file as ``%_N_NAME_SPF`` or ``PROC NAME``. Lines are returned in execution order, with every
expression replaced by its number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError
from machopt.toolpath.readers.program_flow.step_guard import ProgramFlowError, StepGuard
from machopt.toolpath.readers.program_flow.subroutines import MAX_CALLS, FlowItem
from machopt.toolpath.readers.siemens.siemens_expressions import SiemensVariables

NEEDS_FLOW = re.compile(
    r"\bR\[?\d+\]?\s*=|=\s*[-+]?\s*\(?\s*[A-Z]|\b(?:GOTO[BF]?|WHILE|ENDWHILE|REPEATB?|UNTIL|LOOP|DEF|IF|FOR)\b|\bPROC\s|%_N_\w+_SPF",
    re.IGNORECASE,
)
_HEAD = re.compile(r"%_N_(\w+?)_(?:SPF|MPF)\b.*|PROC\s+(\w+)\b.*")
_PREFIX = re.compile(r"(?:N\d+\s*)?(?:([A-Z_][A-Z0-9_]+)\s*:(?!=)\s*)?")
_DEF = re.compile(r"DEF\s+(REAL|INT|BOOL)\b\s*(.*)")
_IF_GOTO = re.compile(r"IF\s*(.*?)\s*(GOTO[BF]?)\s+(\w+)\s*")
_GOTO = re.compile(r"(GOTO[BF]?)\s+(\w+)\s*")
_REPEAT = re.compile(r"REPEAT(B?)\s+([A-Z_]\w*)(?:\s+([A-Z_]\w*))?(?:\s+P\s*=?\s*(\d+))?\s*")
_FOR = re.compile(r"FOR\s+(\w+)\s*=\s*(.*)\bTO\b(.*)")
_BLOCKS = {  # word → (closing word, words between)
    "IF": ("ENDIF", ("ELSE",)),
    "FOR": ("ENDFOR", ()),
    "WHILE": ("ENDWHILE", ()),
    "REPEAT": ("UNTIL", ()),
    "LOOP": ("ENDLOOP", ()),
}
_WORD = re.compile(r"(IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|REPEAT|UNTIL|LOOP|ENDLOOP)\b\s*(.*)")
_FLOW_WORD = re.compile(
    r"(?:IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|REPEATB?|UNTIL|LOOP|ENDLOOP|GOTO[BF]?|DEF|RET|M17|M99)\b"
)
_RETURN = re.compile(r"(?<![\w\"])(?:M17|M99|RET)(?![\w\"(=])")  # in a block with other words too
_ASSIGN = re.compile(r"\s*([A-Z_]\w*(?:\[\s*\d+\s*\])?)\s*=(?!=)\s*")
_MODE = re.compile(r"(AC|IC|DC|ACP|ACN)\s*\(")
_ADDRESS = re.compile(
    r"[A-Z]|CR|AR|RP|AP|TURN|[ABC][2-5]|[IJK]1|FA|SPOS|[XYZABC]\d|FR\w*|OMA\d|D[LT]?|RPL|RNDM?|CHF|CHR|ANG|FB|OVR|[MSHGT]\d?"
)
_MOVES_TOO = re.compile(r"\bG\d|\b[XYZ]\s*(?:=|[-+.\d])")
_NOT_EVALUATED = re.compile(r"(?:MSG|SPOS|DISABLE|WRITE|EXTERN)\b")
_ARRAY_R = re.compile(r"^R\[(\d+)\]$")
_ONLY_PARAMETERS = re.compile(r"(?:R\d+=[-\d.]+\s*|N\d+\s*)*")
_PARAMETER = re.compile(r"R\d+")
_PLAIN_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
_CALL = re.compile(r"[A-Z_]\w*\s*\(")
_STEP = re.compile(r"\"[^\"]*\"?|[A-Z_]\w*|.", re.DOTALL)


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
        self.programs: dict[str, int] = {}
        self.partner: dict[int, int] = {}  # block word → the next one of its block
        self.loop_of: dict[int, int] = {}  # closing word → opening word
        self.limits: dict[int, float] = {}  # FOR → its end value
        self.frames: list[int] = []  # where calls go back to
        self.parts: list[list[int]] = []  # parts being repeated: first and last place, times left, where to go on
        self._parts: dict[str, list[str | Callable[[], str]]] = {}  # lines split once
        self.plain: set[int] = set()  # places of lines that only assign and move
        self.called = False
        self.read = {  # names that some line reads: variables, not words of the control
            name for _, _, code, _ in self.items for name in re.findall(r"[A-Z_]\w*", _ASSIGN.sub(" ", code))
        }
        self._index()

    @property
    def only_subroutines(self) -> bool:
        return False

    def _index(self) -> None:
        opened: list[tuple[str, int, int]] = []  # closing word, first and latest place
        for k, (line, label, code, _) in enumerate(self.items):
            if label:
                self.labels.setdefault(label, []).append(k)
            if found := _HEAD.match(self.raw[k][1]):
                self.programs.setdefault((found.group(1) or found.group(2)).upper(), k)
            word = self._block_word(code)
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
            name = code.partition("(")[0].strip()
            if code and not (
                _FLOW_WORD.match(code) or _RETURN.search(code) or _HEAD.match(self.raw[k][1]) or name in self.programs
            ):
                self.plain.add(k)
        if opened:
            raise ProgramFlowError(f"a block is never closed; expected {opened[-1][0]}", self.items[opened[-1][1]][0])

    def _block_word(self, code: str) -> str | None:
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
        while at < len(self.items):
            line, _, code, comments = self.items[at]
            guard.step(line)
            before = at
            try:
                text, at = self._step(at, code)
                at = self._part_end(before, at)
            except MacroExpressionError as problem:
                raise ProgramFlowError(str(problem), line) from problem
            guard.count_idle_lines(anything=bool(text), line=line)
            if at <= before:
                state = (
                    tuple(self.variables.values.items()),
                    tuple(self.limits.items()),
                    tuple(self.frames),
                    tuple(map(tuple, self.parts)),
                )
                guard.check_backward_jump(at, state, line)
            if text or comments:
                yield line, text, comments

    def _step(self, at: int, code: str) -> tuple[str, int]:
        line = self.items[at][0]
        value = self.variables.value
        if at in self.plain:
            return self._replace_expressions(code), at + 1
        if not code:
            return "", at + 1
        if _HEAD.match(self.raw[at][1]):
            if at in self.programs.values() and not self.frames and any(k < at for k in self.programs.values()):
                return "M30", len(self.items)  # the main program ran to its end
            return "", at + 1
        if found := _IF_GOTO.fullmatch(code):
            return "", self._jump(found.group(2), found.group(3), at) if value(found.group(1)) else at + 1
        if found := _GOTO.fullmatch(code):
            return "", self._jump(found.group(1), found.group(2), at)
        if found := _DEF.fullmatch(code):
            self._define(found.group(2))
            return "", at + 1
        word = self._block_word(code)
        if word is not None:
            return "", self._block(word, at, code)
        if found := _REPEAT.fullmatch(code):
            return "", self._repeat(at, *found.groups())
        if code.startswith("REPEAT"):
            raise ProgramFlowError(f"{code[:30]!r}: expected REPEAT label [label] P=times", line)
        if '"' not in code and (found := _RETURN.search(code)) and (self.frames or found.group() != "M99"):
            text = self._replace_expressions(_RETURN.sub(" ", code))  # other words of the block come first
            if self.frames:
                return text, self.frames.pop()
            return f"{text} M30", len(self.items)
        name = code.partition("(")[0].strip()
        if name in self.programs:
            if "(" in code and code.partition("(")[2].strip(" )"):
                raise ProgramFlowError(f"{name} is called with values: not followed; expand the program first", line)
            if len(self.frames) >= MAX_CALLS:
                raise ProgramFlowError(f"more than {MAX_CALLS} nested calls: does a subprogram call itself?", line)
            self.called = True
            self.frames.append(at + 1)
            return "", self.programs[name] + 1
        return self._replace_expressions(code), at + 1

    def _repeat(self, at: int, block: str, first: str, last: str | None, times: str | None) -> int:
        """REPEAT label [label] P=n, REPEATB label P=n: the part once more, n times."""
        line, count = self.items[at][0], int(times or 1)
        places = [self.labels.get(label, []) for label in (first, last) if label]
        if any(len(found) != 1 for found in places):
            raise ProgramFlowError(f"REPEAT {first}: each of its labels must occur once in this file", line)
        start = places[0][0]
        end = start if block else places[1][0] if last else at - 1
        if end < start or start <= at <= end:
            raise ProgramFlowError(
                f"REPEAT {first}: a part that does not end before it is not followed; expand it", line
            )
        if len(self.parts) >= MAX_CALLS:
            raise ProgramFlowError(f"more than {MAX_CALLS} nested repeats", line)
        if count < 1:
            return at + 1
        self.parts.append([start, end, count - 1, at + 1])
        return start

    def _part_end(self, before: int, at: int) -> int:
        """Where to go on after a line that may be the last one of a repeated part."""
        while self.parts and before == self.parts[-1][1] and at == before + 1:
            part = self.parts[-1]
            if part[2] > 0:
                part[2] -= 1
                return part[0]
            self.parts.pop()
            before, at = part[3] - 1, part[3]
        return at

    def _jump(self, word: str, label: str, at: int) -> int:
        places = self.labels.get(label, [])
        if label.startswith("N") and label[1:].isdigit():
            number = re.compile(rf"{label}(?!\d)")
            places = [k for k, (_, text, _) in enumerate(self.raw) if number.match(text)]
        ahead, behind = [k for k in places if k > at], [k for k in places if k <= at]
        order = {"GOTOF": ahead, "GOTOB": behind[::-1]}.get(word, ahead + behind[::-1])
        if not order:
            raise ProgramFlowError(
                f"{word} {label}: no such label {'ahead' if word == 'GOTOF' else 'there'}", self.items[at][0]
            )
        return order[0]

    def _block(self, word: str, at: int, code: str) -> int:
        found = _WORD.fullmatch(code)
        assert found is not None
        rest, value = found.group(2), self.variables.value
        if word == "IF":
            return at + 1 if value(rest) else self.partner[at] + 1
        if word == "WHILE":
            return at + 1 if value(rest) else self.partner[at] + 1
        if word == "FOR":
            return self._for(at, code)
        if word == "ENDFOR":
            return self._next(at)
        if word == "UNTIL":
            return at + 1 if value(rest) else self.loop_of[at] + 1
        if word in ("ENDWHILE", "ENDLOOP"):
            return self.loop_of[at]
        return self.partner[at] + 1 if word == "ELSE" else at + 1

    def _for(self, at: int, code: str) -> int:
        found = _FOR.fullmatch(code)
        if not found:
            raise ProgramFlowError("expected FOR name = value TO value", self.items[at][0])
        name = found.group(1)
        self.variables.values[name] = self.variables.value(found.group(2))
        self.limits[at] = self.variables.value(found.group(3))
        return at + 1 if self.variables.values[name] <= self.limits[at] else self.partner[at] + 1

    def _next(self, at: int) -> int:
        start = self.loop_of[at]
        found = _FOR.fullmatch(self.items[start][2])
        assert found is not None
        name = found.group(1)
        self.variables.values[name] = self.variables.values.get(name, 0.0) + 1.0
        return start + 1 if self.variables.values[name] <= self.limits.get(start, 0.0) else at + 1

    def _define(self, text: str) -> None:
        for part in text.split(","):
            name, equals, value = part.partition("=")
            self.variables.values[name.strip()] = self.variables.value(value) if equals else 0.0

    def _replace_expressions(self, code: str) -> str:
        """The line with assignments carried out and every address' expression as a number."""
        parts = self._parts.get(code)
        if parts is None:
            parts = self._parts[code] = self._split_line(code)
        out: list[str] = []
        for part in parts:
            out.append(part if isinstance(part, str) else part())
        text = "".join(out).strip()
        return "" if _ONLY_PARAMETERS.fullmatch(text) else text

    def _split_line(self, code: str) -> list[str | Callable[[], str]]:
        """Literal text, and the parts to be evaluated each time."""
        parts: list[str | Callable[[], str]] = []
        at = 0
        while at < len(code):
            found = _ASSIGN.match(code, at)
            if found and code[found.end() : found.end() + 1] != '"':
                one, at = self._assignment(code, found)
                parts.append(one)
                continue
            call = _CALL.match(code, at)
            if call and not _NOT_EVALUATED.match(code, at):
                end = _find_closing_bracket(code, call.end())
                parts.append(self._build_call(code[at : call.end()], _split_arguments(code[call.end() : end])))
                at = end + 1
                continue
            step = _STEP.match(code, at)
            assert step is not None
            parts.append(step.group())
            at = step.end()
        return parts

    def _build_call(self, head: str, arguments: list[str]) -> Callable[[], str]:
        return lambda: head + ",".join(map(self._argument, arguments)) + ")"

    def _assignment(self, code: str, found: re.Match[str]) -> tuple[Callable[[], str], int]:
        """One ``name = expression`` and the place after it; what stays a word of the block comes back as text."""
        name = _ARRAY_R.sub(r"R\1", found.group(1).replace(" ", ""))
        parameter = _PARAMETER.fullmatch(name) is not None
        address = _ADDRESS.fullmatch(name) is not None
        mode = _MODE.match(code, found.end())
        begin = found.end() if mode is None else mode.end()
        end = self.variables.end_of(code, begin)
        if mode is not None and code[end : end + 1] != ")":
            raise MacroExpressionError(f"{mode.group(1)}( is not closed")

        def carry_out() -> str:
            value = self.variables.part(code, begin)[0]
            if mode is not None:
                return f" {name}={mode.group(1)}({value:.9f}) "
            is_variable = parameter or address or name in self.variables.values
            if not is_variable and (_MOVES_TOO.search(code) or name.partition("[")[0] not in self.read):
                return f" {name}={value:.9f} "  # no variable: those are assigned in blocks of their own
            if parameter or not address or name in self.variables.values:
                self.variables.values[name] = value
                return f" {name}={value:.9f} " if parameter else ""  # older drilling cycles take R2, R3, R10 as words
            return f" {name}{value:.9f} " if len(name) == 1 else f" {name}={value:.9f} "

        return carry_out, end if mode is None else end + 1

    def _argument(self, text: str) -> str:
        part = text.strip()
        if not part or part.startswith('"') or _PLAIN_NUMBER.fullmatch(part):
            return text
        return f"{self.variables.value(part):.9f}"


def _find_closing_bracket(text: str, at: int) -> int:
    """The bracket that closes the one before ``at``; the end of the line where none does."""
    depth = 1
    for k in range(at, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if depth == 0:
            return k
    return len(text)


def _split_arguments(text: str) -> list[str]:
    """Arguments at commas outside of brackets and quotes."""
    parts, depth, quoted = [""], 0, False
    for c in text:
        quoted ^= c == '"'
        depth += (c == "(") - (c == ")")
        if c == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += c
    return parts
