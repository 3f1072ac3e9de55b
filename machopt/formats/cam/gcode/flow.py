"""Subprograms and loops of Fanuc, Haas and LinuxCNC programs, as far as the file holds them.

M98 P and M97 P with L repeats, M99, G65 with arguments; IF […] GOTO, IF […] THEN, WHILE … DO n … END n, GOTO;
LinuxCNC O-words (sub, call, return, if, while, do, repeat, break, continue). Lines come out in the order they are
carried out, with every expression replaced by its number.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

from machopt.formats.cam.gcode.expr import ExpressionError, Parameters

Item = tuple[int, str, list[str]]  # line, code in upper case, comments
MAX_STEPS = 300_000  # lines carried out in one program, beyond twice the lines it has
MAX_IDLE = 100_000  # of them one after the other that hold nothing for the control
MAX_CALLS = 50  # nested

NEEDS_FLOW = re.compile(
    r"[#\[]|M9[78](?!\d)|G6[56](?![\d.])|\bGOTO\b|\bWHILE\b|^[ \t]*(?:N\d+[ \t]*)?O[ \t]*(?:<|\d+[ \t]*[A-Z])",
    re.IGNORECASE | re.MULTILINE,
)
_O_WORD = re.compile(
    r"(?:N\d+\s*)?O\s*(<[^<>]*>|\d+)\s*(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|DO|WHILE|ENDWHILE|REPEAT|ENDREPEAT"
    r"|BREAK|CONTINUE)\b\s*(.*)"
)
_HEAD = re.compile(r"(?:N\d+\s*)?[O:]\s*(\d+)\s*")
_CALL = re.compile(r"M9([78])(?!\d)")
_MACRO = re.compile(r"G65(?![\d.])")
_RETURN = re.compile(r"M99(?!\d)")
_IF = re.compile(r"(?:N\d+\s*)?IF\s*(\[.*\])\s*(GOTO|THEN)\s*(.*)")
_WHILE = re.compile(r"(?:N\d+\s*)?WHILE\s*(\[.*\])\s*DO\s*(\d)\s*")
_END = re.compile(r"(?:N\d+\s*)?END\s*(\d)\s*")
_GOTO = re.compile(r"(?:N\d+\s*)?GOTO\s*(.+)")
_NUMBER = re.compile(r"N\s*(\d+)")
_P_L = re.compile(r"([PL])\s*(\d+)")
_ARGUMENT = dict(zip("ABCDEFHIJKMQRSTUVWXYZ", (1, 2, 3, 7, 8, 9, 11, 4, 5, 6, 13, *range(17, 27)), strict=True))
_WORD = re.compile(r"([A-Z])\s*([-+]?\s*(?:\d+\.?\d*|\.\d+))")


class FlowError(ValueError):
    """The flow of the program cannot be followed; carries the line it stands in."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


class StepGuard:
    """Ends a program that never would: too many lines, too many without motion, or a jump back into the same state."""

    def __init__(self, lines: int) -> None:
        self.most = MAX_STEPS + 2 * lines
        self.steps = self.idle = 0
        self._seen: set[tuple[int, Hashable]] = set()

    def step(self, line: int) -> None:
        self.steps += 1
        if self.steps > self.most:
            raise FlowError(f"more than {self.most} lines carried out: does a loop never end?", line)

    def moved(self, *, anything: bool, line: int) -> None:
        """Tell whether the line held something for the control."""
        self.idle = 0 if anything else self.idle + 1
        if self.idle > MAX_IDLE:
            raise FlowError("a loop goes on without ever moving: does it never end?", line)

    def jumped_back(self, place: int, state: Hashable, line: int) -> None:
        """Tell a jump to an earlier place, and everything the way from there depends on."""
        if (place, state) in self._seen:
            raise FlowError("a loop comes back to where it was with nothing changed: it never ends", line)
        self._seen.add((place, state))


@dataclass
class _Call:
    back: int  # place to go on at
    start: int
    repeats: int  # still to be done after this one
    own_parameters: bool


class MacroFlow:
    """Carries out one program line by line."""

    def __init__(self, items: Sequence[Item]) -> None:
        self.items = items
        self.parameters = Parameters()
        self.calls: list[_Call] = []
        self.loops: dict[str, tuple[int, int]] = {}  # O repeat: (place, still to do)
        self.programs: dict[int, int] = {}
        self.o_words: dict[str, list[tuple[int, str]]] = {}
        self.numbers: dict[int, list[int]] = {}
        self.ends: dict[int, int] = {}  # DO place → END place and back
        self.called = False
        self.main: int | None = None  # where the first program begins
        self._index()

    @property
    def only_subroutines(self) -> bool:
        """The file defines subroutines and never calls one."""
        return bool(self.programs or any(w == "SUB" for o in self.o_words.values() for _, w in o)) and not self.called

    def _index(self) -> None:
        opened: dict[str, list[int]] = {}
        for k, (line, text, _) in enumerate(self.items):
            if found := _O_WORD.match(text):
                self.o_words.setdefault(found.group(1), []).append((k, found.group(2)))
            elif found := _HEAD.fullmatch(text):
                self.programs.setdefault(int(found.group(1)), k)
                self.main = k if self.main is None else self.main
            elif found := _WHILE.fullmatch(text):
                opened.setdefault(found.group(2), []).append(k)
            elif found := _END.fullmatch(text):
                if not opened.get(found.group(1)):
                    raise FlowError(f"END{found.group(1)} without WHILE … DO{found.group(1)}", line)
                start = opened[found.group(1)].pop()
                self.ends[start], self.ends[k] = k, start
            if found := _NUMBER.match(text):
                self.numbers.setdefault(int(found.group(1)), []).append(k)

    def run(self) -> Iterator[Item]:
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
            except ExpressionError as problem:
                raise FlowError(str(problem), line) from problem
            except ValueError as problem:
                raise problem if isinstance(problem, FlowError) else FlowError(str(problem), line) from problem
            guard.moved(anything=not isinstance(step, int) and not step[0].isspace() and step[0] != "", line=line)
            to = step if isinstance(step, int) else step[1]
            if to <= at:
                guard.jumped_back(to, self._state(), line)
            if isinstance(step, int):
                if comments:
                    yield line, "", comments
                at = step
                continue
            text, at = step
            yield line, text, comments

    def _state(self) -> Hashable:
        calls = tuple((c.back, c.repeats) for c in self.calls)
        return self.parameters.state(), calls, tuple(self.loops.items())

    def _step(self, at: int, text: str) -> int | tuple[str, int]:
        """The next place, or the code to carry out and the next place."""
        line = self.items[at][0]
        if found := _O_WORD.match(text):
            return self._o_word(at, found.group(1), found.group(2), found.group(3))
        if found := _HEAD.fullmatch(text):
            if self.calls and at != self.calls[-1].start:
                raise FlowError("a subprogram runs into the next one; expected M99 before it", line)
            return at + 1 if self.calls or at == self.main else len(self.items)
        if text.startswith(("IF", "WHILE", "END", "GOTO", "N")):
            if found := _IF.fullmatch(text):
                if not self.parameters.number(found.group(1)):
                    return at + 1
                if found.group(2) == "GOTO":
                    return self._label(found.group(3), at)
                self.parameters.evaluate(found.group(3))
                return at + 1
            if found := _WHILE.fullmatch(text):
                if at not in self.ends:
                    raise FlowError("WHILE without its END", line)
                return at + 1 if self.parameters.number(found.group(1)) else self.ends[at] + 1
            if _END.fullmatch(text):
                return self.ends[at]
            if found := _GOTO.fullmatch(text):
                return self._label(found.group(1), at)
        if "#" in text or "[" in text:
            text = self.parameters.evaluate(text)
        if found := _CALL.search(text):
            return self._call(at, text, local=found.group(1) == "7")
        if _MACRO.search(text):
            return self._macro(at, text)
        if _RETURN.search(text) and self.calls:
            call = self.calls[-1]
            if call.repeats:
                call.repeats -= 1
                return call.start + 1
            return self._leave()
        return text, at + 1

    # ---- Fanuc

    def _label(self, text: str, at: int) -> int:
        number = round(self.parameters.number(text))
        places = self.numbers.get(number, [])
        if not places:
            raise FlowError(f"GOTO {number}: no block N{number} in this file", self.items[at][0])
        return next((k for k in places if k > at), places[0])

    def _call(self, at: int, text: str, *, local: bool) -> tuple[str, int]:
        line = self.items[at][0]
        words = dict(_P_L.findall(text))
        if "P" not in words:
            raise FlowError("M98 without P: which subprogram is not said (calls by file name are not followed)", line)
        number, repeats = int(words["P"]), int(words.get("L", "1"))
        places = self.numbers.get(number, []) if local else []
        start = (places[0] - 1 if places else None) if local else self.programs.get(number)
        if start is None and not local and number > 9999 and "L" not in words:
            repeats, number = divmod(number, 10_000)
            start = self.programs.get(number)
        if start is None:
            raise FlowError(
                f"M{97 if local else 98} P{words['P']} calls a subprogram that is not in this file; expand it into one "
                "program, or append it",
                line,
            )
        rest = _CALL.sub(" ", _P_L.sub(" ", text))
        if repeats < 1:
            return rest, at + 1
        self._enter(at + 1, start, repeats - 1, line, None)
        return rest, start + 1

    def _macro(self, at: int, text: str) -> tuple[str, int]:
        line = self.items[at][0]
        arguments = {letter: float(re.sub(r"\s", "", n)) for letter, n in _WORD.findall(_MACRO.sub(" ", text))}
        number, repeats = round(arguments.pop("P", -1.0)), round(arguments.pop("L", 1.0))
        start = self.programs.get(number)
        if start is None:
            raise FlowError(f"G65 P{number} calls a macro that is not in this file: its motion is not known", line)
        own = {str(_ARGUMENT[c]): v for c, v in arguments.items() if c in _ARGUMENT}
        self._enter(at + 1, start, max(repeats, 1) - 1, line, own)
        return "", start + 1

    def _enter(self, back: int, start: int, repeats: int, line: int, own: dict[str, float] | None) -> None:
        if len(self.calls) >= MAX_CALLS:
            raise FlowError(f"more than {MAX_CALLS} nested calls: does a subprogram call itself?", line)
        self.called = True
        if own is not None:
            self.parameters.enter(own)
        self.calls.append(_Call(back, start, repeats, own is not None))

    def _leave(self) -> int:
        call = self.calls.pop()
        if call.own_parameters:
            self.parameters.leave()
        return call.back

    # ---- LinuxCNC

    def _find(self, label: str, after: int, words: tuple[str, ...]) -> int:
        for k, word in self.o_words[label]:
            if k > after and word in words:
                return k
        raise FlowError(f"O{label} has no {' or '.join(words)}", self.items[after][0])

    def _back(self, label: str, before: int, words: tuple[str, ...]) -> int:
        for k, word in reversed(self.o_words[label]):
            if k < before and word in words:
                return k
        raise FlowError(f"O{label} has no {' or '.join(words)} before it", self.items[before][0])

    def _o_word(self, at: int, label: str, word: str, rest: str) -> int:
        number = self.parameters.number
        if word == "SUB":
            return self._find(label, at, ("ENDSUB",)) + 1
        if word == "CALL":
            start = next((k for k, w in self.o_words[label] if w == "SUB"), None)
            if start is None:
                raise FlowError(f"O{label} CALL: that subroutine is not in this file", self.items[at][0])
            own = {str(n): v for n, v in enumerate(self.parameters.bracketed(rest), 1)}
            own |= {str(n): 0.0 for n in range(len(own) + 1, 31)}
            self._enter(at + 1, start, 0, self.items[at][0], own)
            return start + 1
        if word in ("ENDSUB", "RETURN"):
            if not self.calls:
                raise FlowError(f"O{label} {word} outside of a call", self.items[at][0])
            return self._leave()
        if word == "IF":
            return self._branch(at, label, taken=bool(number(rest)))
        if word in ("ELSEIF", "ELSE"):  # reached from the part before it, which was carried out
            return self._find(label, at, ("ENDIF",)) + 1
        if word == "WHILE":
            here = self.o_words[label]
            loop_of_do = [w for k, w in here if k < at and w in ("DO", "ENDWHILE")][-1:] == ["DO"]
            if loop_of_do:
                return self._back(label, at, ("DO",)) + 1 if number(rest) else at + 1
            return at + 1 if number(rest) else self._find(label, at, ("ENDWHILE",)) + 1
        if word == "ENDWHILE":
            return self._back(label, at, ("WHILE",))
        if word == "REPEAT":
            end = self._find(label, at, ("ENDREPEAT",))
            times = round(number(rest))
            if times < 1:
                return end + 1
            self.loops[label] = (at, times - 1)
        if word == "ENDREPEAT":
            start, times = self.loops.get(label, (0, 0))
            if times:
                self.loops[label] = (start, times - 1)
                return start + 1
        if word in ("BREAK", "CONTINUE"):
            end = self._find(label, at, ("ENDWHILE", "ENDREPEAT", "WHILE"))
            return end + 1 if word == "BREAK" else end
        return at + 1

    def _branch(self, at: int, label: str, *, taken: bool) -> int:
        while not taken:
            at = self._find(label, at, ("ELSEIF", "ELSE", "ENDIF"))
            found = _O_WORD.match(self.items[at][1])
            assert found is not None
            taken = found.group(2) != "ELSEIF" or bool(self.parameters.number(found.group(3)))
        return at + 1
