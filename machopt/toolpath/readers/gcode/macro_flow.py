"""Subprograms and loops of Fanuc, Haas and LinuxCNC programs, executed as far as the file contains them.

Supported: M98 P and M97 P with L repeats, M99, G65 with arguments; IF […] GOTO, IF […] THEN, WHILE … DO n … END n,
GOTO; LinuxCNC O-words (sub, call, return, if, while, do, repeat, break, continue). Lines are returned in execution
order, with every expression replaced by its number. Other words of a block with M98, M99 or THEN are executed before
the jump. A block whose other words cannot be executed is refused. Nothing behind M2 or M30 is evaluated.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Sequence

from machopt.toolpath.readers.gcode.syntax.blocks import refuse_exponent
from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError, StepGuard
from machopt.toolpath.readers.program_flow.linuxcnc_o_words import (
    O_WITHIN,
    O_WORD,
    FlowItem,
    SubroutineFlow,
    normalise_label,
)
from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError

NEEDS_FLOW = re.compile(
    r"[#\[]|M\s*9[78](?![0-9])|G\s*6[56](?![0-9.])|M\s*73(?![0-9])|M\s*99\s*P|P\s*[0-9]+\s*M\s*99(?![0-9])|\bGOTO\b|\bWHILE\b|\bDO\s*[0-9]|[XYZABCFIJKPQR]\s*[-+]*\s*[A-Z]{2,5}\s*\["
    r"|^[ \t]*(?:N[0-9]+[ \t]*)?O[ \t]*(?:[<\[#]|[0-9]+[ \t]*[A-Z])",
    re.IGNORECASE | re.MULTILINE,
)
_HEAD = re.compile(r"(?:N[0-9]+\s*)?[O:]\s*([0-9]+)\s*")
_CALL = re.compile(r"M\s*9([78])(?![0-9])")
_MACRO = re.compile(r"G\s*65(?![0-9.])")
_RETURN = re.compile(r"M\s*99(?![0-9])")
_PROGRAM_END = re.compile(r"(?<![A-Z])M\s*0*(?:2|30)(?![0-9.])")
_ANY_WORD = re.compile(r"[A-MO-Z]\s*[-+.0-9]")  # in addition to the block number
_SAVE = re.compile(r"(?<![A-Z])M\s*73(?![0-9.])")
_IF = re.compile(r"(?:N[0-9]+\s*)?IF\s*(\[.*\])\s*(GOTO|THEN)\s*(.*)")
_WHILE = re.compile(r"(?:N[0-9]+\s*)?(?:WHILE\s*(\[.*\])\s*)?DO\s*([0-9])\s*")
_END = re.compile(r"(?:N[0-9]+\s*)?END\s*([0-9])\s*")
_GOTO = re.compile(r"(?:N[0-9]+\s*)?GOTO\s*(.+)")
_NUMBER = re.compile(r"N\s*([0-9]+)")
_P_L = re.compile(r"([PLQHD])\s*([0-9]+)(?:\.0*(?![0-9]))?")
_ARGUMENT = dict(zip("ABCDEFHIJKMQRSTUVWXYZ", (1, 2, 3, 7, 8, 9, 11, 4, 5, 6, 13, *range(17, 27)), strict=True))
_WORD = re.compile(r"([A-Z])\s*([-+]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))")


class MacroFlow(SubroutineFlow):
    """Carries out one program line by line."""

    def __init__(self, items: Sequence[FlowItem]) -> None:
        super().__init__(items)
        self.programs: dict[int, int] = {}
        self.numbers: dict[int, list[int]] = {}
        self.ends: dict[int, int] = {}  # DO place → END place and back
        self.heads: list[int] = []  # where programs begin
        self.main: int | None = None  # where the first program begins, unless another one ended before it
        self._index()

    @property
    def only_subroutines(self) -> bool:
        """The file defines subroutines and never calls one."""
        return bool(self.programs or any(w == "SUB" for o in self.o_words.values() for _, w in o)) and not self.called

    def _index(self) -> None:
        opened: dict[str, list[int]] = {}
        ended_before = False
        for k, (line, text, _) in enumerate(self.items):
            if found := O_WORD.match(text):
                self.o_words.setdefault(normalise_label(found.group(1)), []).append((k, found.group(2)))
            elif found := _HEAD.fullmatch(text):
                self.programs.setdefault(int(found.group(1)), k)
                self.heads.append(k)
                self.main = k if self.main is None and not ended_before else self.main
            elif found := _WHILE.fullmatch(text):
                opened.setdefault(found.group(2), []).append(k)
            elif found := _END.fullmatch(text):
                if not opened.get(found.group(1)):
                    raise ProgramFlowError(f"END{found.group(1)} without WHILE … DO{found.group(1)}", line)
                start = opened[found.group(1)].pop()
                self.ends[start], self.ends[k] = k, start
            ended_before = ended_before or _PROGRAM_END.search(text) is not None or _RETURN.search(text) is not None
            if found := _NUMBER.match(text):
                self.numbers.setdefault(int(found.group(1)), []).append(k)

    def run(self) -> Iterator[FlowItem]:
        """Lines as they are carried out.

        Raises:
            FlowError: a loop without end, a call of what the file does not hold, an expression without a value.
        """
        at = 0
        guard = StepGuard(len(self.items))
        while at < len(self.items):
            line, text, comments = self.items[at]
            guard.step(line)
            try:
                step = self._step(at, text)
            except MacroExpressionError as problem:
                raise ProgramFlowError(str(problem), line) from problem
            except ValueError as problem:
                raise (
                    problem if isinstance(problem, ProgramFlowError) else ProgramFlowError(str(problem), line)
                ) from problem
            guard.count_idle_lines(
                anything=not isinstance(step, int) and not step[0].isspace() and step[0] != "", line=line
            )
            to = step if isinstance(step, int) else step[1]
            if to < at or (to == at and isinstance(step, int)):
                guard.check_backward_jump(to, self._state(), line)
            if isinstance(step, int):
                if comments:
                    yield line, "", comments
                at = step
                continue
            text, at = step
            yield line, text, comments
            if _PROGRAM_END.search(text):
                return

    def _state(self) -> Hashable:
        calls = tuple((c.back, c.repeats) for c in self.calls)
        return self.parameters.state(), calls, tuple(self.loops.items())

    def _step(self, at: int, text: str) -> int | tuple[str, int]:
        """The next place, or the code to carry out and the next place."""
        line = self.items[at][0]
        if "O" in text:
            if found := O_WORD.match(self._resolve_number(text)):
                return self._run_o_word(at, normalise_label(found.group(1)), found.group(2), found.group(3))
            if found := _HEAD.fullmatch(text):
                if self.calls and at != self.calls[-1].start:
                    raise ProgramFlowError("a subprogram runs into the next one; expected M99 before it", line)
                return at + 1 if self.calls or at == self.main else len(self.items)
            if O_WITHIN.search(text):
                raise ProgramFlowError(
                    "an O-word behind other words of its block; expected it in a block of its own", line
                )
        elif text.startswith(":") and _HEAD.fullmatch(text):
            return at + 1 if self.calls or at == self.main else len(self.items)
        if text.startswith(("IF", "WHILE", "DO", "END", "GOTO", "N")):
            if found := _IF.fullmatch(text):
                if not self.parameters.number(found.group(1)):
                    return at + 1
                if found.group(2) == "GOTO":
                    return self._label(found.group(3), at)
                if not found.group(3):
                    raise ProgramFlowError(
                        "IF … THEN over several blocks is not followed; expected THEN and a statement", line
                    )
                return self._step(at, found.group(3))
            if found := _WHILE.fullmatch(text):
                if at not in self.ends:
                    raise ProgramFlowError("WHILE without its END", line)
                again = found.group(1) is None or self.parameters.number(found.group(1))
                return at + 1 if again else self.ends[at] + 1
            if _END.fullmatch(text):
                return self.ends[at]
            if found := _GOTO.fullmatch(text):
                return self._label(found.group(1), at)
        if "#" in text or "[" in text:
            text = self.parameters.evaluate(text)
        if _SAVE.search(text) and self.calls:
            self.calls[-1].restore = True
        if found := _CALL.search(text):
            return self._call(at, text, local=found.group(1) == "7")
        if _MACRO.search(text):
            return self._call_macro(at, text)
        if _RETURN.search(text):
            return self._run_return(at, text)
        return text, at + 1

    # ---- Fanuc

    def _label(self, text: str, at: int) -> int:
        """The block N of the program that contains ``at``, forwards first."""
        number = round(self.parameters.number(text))
        first = max((k for k in self.heads if k <= at), default=0)
        last = min((k for k in self.heads if k > at), default=len(self.items))
        places = [k for k in self.numbers.get(number, []) if first <= k < last]
        if not places:
            raise ProgramFlowError(f"GOTO {number}: no block N{number} in this program", self.items[at][0])
        return next((k for k in places if k > at), places[0])

    def _run_return(self, at: int, text: str) -> tuple[str, int]:
        """M99: the other words of its block are carried out, then the program goes back, or to the block P names."""
        line = self.items[at][0]
        to = re.search(r"P\s*([0-9]+)(?:\.0*(?![0-9]))?", text)
        rest = _RETURN.sub(" ", text if to is None else text.replace(to.group(), " "))
        if not self.calls:
            goal = len(self.items) if to is None else self._label(to.group(1), at)
            if goal > at:
                return (text, goal) if to is None else (rest, goal)
            return f"{rest} M30", len(self.items)  # the program begins again: once is its path
        call = self.calls[-1]
        if call.repeats and to is None:
            call.repeats -= 1
            return rest, call.start + 1
        if call.restore:  # first the modes that M73 saved, then this block again
            call.restore = False
            if _ANY_WORD.search(rest):
                raise ProgramFlowError(
                    "M99 with other words in a subprogram with M73: write them in a block before it", line
                )
            return "M72", at
        back = self._leave()
        return rest, back if to is None else self._label(to.group(1), back - 1)

    def _call(self, at: int, text: str, *, local: bool) -> tuple[str, int]:
        line = self.items[at][0]
        found = _P_L.findall(text)
        words = dict(found)
        if "P" not in words:
            raise ProgramFlowError(
                "M98 without P: the subprogram is not stated (calls by file name are not followed)", line
            )
        if len(words) < len(found) or words.keys() & {"Q", "H"}:
            raise ProgramFlowError("M98 with Q, H or a word twice: not followed; expected P and L alone", line)
        number, repeats = int(words["P"]), int(words.get("L", "1"))
        places = self.numbers.get(number, []) if local else []
        start = (places[0] - 1 if places else None) if local else self.programs.get(number)
        if start is None and not local and number > 9999 and "L" not in words:
            repeats, number = divmod(number, 10_000)
            start = self.programs.get(number)
        if start is None:
            raise ProgramFlowError(
                f"M{97 if local else 98} P{words['P']} calls a subprogram that is not in this file; expand it into one "
                "program, or append it",
                line,
            )
        rest = _CALL.sub(" ", _P_L.sub(lambda m: " " if m.group(1) in "PL" else m.group(), text))
        if repeats < 1:
            return rest, at + 1
        self._enter(at + 1, start, repeats - 1, line, None)
        return rest, start + 1

    def _call_macro(self, at: int, text: str) -> tuple[str, int]:
        """G65: words before it are carried out first, those behind it are the macro's arguments."""
        line = self.items[at][0]
        macro = _MACRO.search(text)
        assert macro is not None
        before = text[: macro.start()]
        behind = text[macro.end() :]
        refuse_exponent(behind)
        if rest := _WORD.sub(" ", behind).strip():
            raise ProgramFlowError(f"found {rest[:20]!r} behind G65; expected P, L and arguments such as A10.5", line)
        found = [(c, float(re.sub(r"\s", "", n))) for c, n in _WORD.findall(behind)]
        arguments = dict(found)
        if len(arguments) < len(found) or arguments.keys() & {"G", "O", "N"}:
            raise ProgramFlowError(
                "G65 with G, N or a letter twice behind it: not followed; expected P, L and arguments", line
            )
        number, repeats = round(arguments.pop("P", -1.0)), round(arguments.pop("L", 1.0))
        start = self.programs.get(number)
        if start is None and str(number) in self.o_words:
            raise ProgramFlowError(
                f"G65 P{number} calls an O-word subroutine: not followed; write O{number} CALL", line
            )
        if start is None:
            raise ProgramFlowError(
                f"G65 P{number} calls a macro that is not in this file: its motion is not known", line
            )
        own = {str(_ARGUMENT[c]): v for c, v in arguments.items() if c in _ARGUMENT}
        self._enter(at + 1, start, max(repeats, 1) - 1, line, own)
        return before, start + 1
