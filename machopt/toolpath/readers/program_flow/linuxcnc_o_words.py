"""Subroutines of a program and the O-words of LinuxCNC: sub, call, return, if, while, do, repeat, break, continue."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError
from machopt.toolpath.readers.program_flow.macro_expressions import FANUC_LOCAL, LINUXCNC_LOCAL, MacroParameters

FlowItem = tuple[int, str, list[str]]  # line, code in upper case, comments
MAX_CALLS = 50  # nested
O_WORD = re.compile(
    r"(?:N[0-9]+\s*)?O\s*(<[^<>]*>|[0-9]+)\s*(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|DO|WHILE|ENDWHILE|REPEAT|ENDREPEAT"
    r"|BREAK|CONTINUE)\b\s*(.*)"
)
_O_INDIRECT = re.compile(r"(N[0-9]+\s*)?O\s*(?=[\[#](?!<[^<>]*>\s*=))")
O_WITHIN = re.compile(
    r"O\s*(?:<[^<>]*>|[0-9]+)\s*(?:SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|DO|WHILE|ENDWHILE|REPEAT|ENDREPEAT|BREAK|CONTINUE)\b"
)
_ALONE = ("SUB", "ELSE", "ENDIF", "DO", "ENDWHILE", "ENDREPEAT", "BREAK", "CONTINUE")  # nothing behind them


@dataclass
class SubroutineCall:
    back: int  # place to go on at
    start: int
    repeats: int  # still to be done after this one
    own_parameters: bool
    restore: bool = False  # M73: the modes come back when it returns


def normalise_label(text: str) -> str:
    """Return the standard form of a label: ``O001`` and ``O1`` are the same.

    Args:
        text: Text of the label.

    Returns:
        The standard form.
    """
    return str(int(text)) if text.isdigit() else re.sub(r"\s", "", text)


class SubroutineFlow:
    """Calls that are under way, and what O-words do."""

    def __init__(self, items: Sequence[FlowItem]) -> None:
        self.items = items
        self.parameters = MacroParameters()
        self.calls: list[SubroutineCall] = []
        self.loops: dict[tuple[int, str], tuple[int, int]] = {}  # O repeat, by depth of calls: (place, still to do)
        self.o_words: dict[str, list[tuple[int, str]]] = {}
        self.called = False

    def _enter(
        self, back: int, start: int, repeats: int, line: int, own: dict[str, float] | None, highest: int = FANUC_LOCAL
    ) -> None:
        if len(self.calls) >= MAX_CALLS:
            raise ProgramFlowError(f"more than {MAX_CALLS} nested calls: does a subprogram call itself?", line)
        self.called = True
        if own is not None:
            self.parameters.enter(own, highest)
        self.calls.append(SubroutineCall(back, start, repeats, own is not None))

    def _leave(self) -> int:
        call = self.calls.pop()
        if call.own_parameters:
            self.parameters.leave()
        return call.back

    def _resolve_number(self, text: str) -> str:
        """``O[#1+2] CALL`` with the number it means."""
        found = _O_INDIRECT.match(text)
        if not found:
            return text
        value, end = self.parameters.leading_factor(text[found.end() :])
        return f"O{round(value)} {text[found.end() + end :]}"

    def _find(self, label: str, after: int, words: tuple[str, ...]) -> int:
        for k, word in self.o_words[label]:
            if k > after and word in words:
                return k
        raise ProgramFlowError(f"O{label} has no {' or '.join(words)}", self.items[after][0])

    def _return_from_call(self, label: str, before: int, words: tuple[str, ...]) -> int:
        for k, word in reversed(self.o_words[label]):
            if k < before and word in words:
                return k
        raise ProgramFlowError(f"O{label} has no {' or '.join(words)} before it", self.items[before][0])

    def _end_sub(self, at: int, value: str) -> int | tuple[str, int]:
        """ENDSUB and RETURN, with the value they give back."""
        call = self.calls[-1]
        if call.restore:  # first the modes that M73 saved, then this line again
            call.restore = False
            return "M72", at
        found = self.parameters.number(value) if value else 0.0
        back = self._leave()
        self.parameters.values.update({"<_VALUE>": found, "<_VALUE_RETURNED>": float(bool(value))})
        return back

    def _run_o_word(self, at: int, label: str, word: str, rest: str) -> int | tuple[str, int]:
        number = self.parameters.number
        line, loop = self.items[at][0], (len(self.calls), label)
        if word in _ALONE and rest:
            raise ProgramFlowError(
                f"found {rest[:20]!r} behind O{label} {word}; expected it in a block of its own", line
            )
        if word == "SUB":
            return self._find(label, at, ("ENDSUB",)) + 1
        if word == "CALL":
            start = next((k for k, w in self.o_words.get(label, []) if w == "SUB"), None)
            if start is None:
                raise ProgramFlowError(f"O{label} CALL: that subroutine is not in this file", line)
            own = {str(n): v for n, v in enumerate(self.parameters.evaluate_brackets(rest), 1)}
            own |= {str(n): 0.0 for n in range(len(own) + 1, LINUXCNC_LOCAL + 1)}
            self._enter(at + 1, start, 0, line, own, LINUXCNC_LOCAL)
            return start + 1
        if word in ("ENDSUB", "RETURN"):
            if not self.calls:
                raise ProgramFlowError(f"O{label} {word} outside of a call", line)
            return self._end_sub(at, rest)
        if word == "IF":
            return self._find_branch_end(at, label, taken=bool(number(rest)))
        if word in ("ELSEIF", "ELSE"):  # reached from the part before it, which was carried out
            return self._find(label, at, ("ENDIF",)) + 1
        if word == "WHILE":
            here = self.o_words[label]
            loop_of_do = [w for k, w in here if k < at and w in ("DO", "ENDWHILE")][-1:] == ["DO"]
            if loop_of_do:
                return self._return_from_call(label, at, ("DO",)) + 1 if number(rest) else at + 1
            return at + 1 if number(rest) else self._find(label, at, ("ENDWHILE",)) + 1
        if word == "ENDWHILE":
            return self._return_from_call(label, at, ("WHILE",))
        if word == "REPEAT":
            end = self._find(label, at, ("ENDREPEAT",))
            times = round(number(rest))
            if times < 1:
                return end + 1
            self.loops[loop] = (at, times - 1)
        if word == "ENDREPEAT":
            start, times = self.loops.get(loop, (0, 0))
            if times:
                self.loops[loop] = (start, times - 1)
                return start + 1
        if word in ("BREAK", "CONTINUE"):
            end = self._find(label, at, ("ENDWHILE", "ENDREPEAT", "WHILE"))
            return end + 1 if word == "BREAK" else end
        return at + 1

    def _find_branch_end(self, at: int, label: str, *, taken: bool) -> int:
        while not taken:
            at = self._find(label, at, ("ELSEIF", "ELSE", "ENDIF"))
            found = O_WORD.match(self.items[at][1])
            assert found is not None
            taken = found.group(2) != "ELSEIF" or bool(self.parameters.number(found.group(3)))
        return at + 1
