"""Labels, jumps and Q parameters of Heidenhain programs, executed as far as the file contains them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError, StepGuard
from machopt.toolpath.readers.program_flow.linuxcnc_o_words import MAX_CALLS, FlowItem
from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError
from machopt.toolpath.readers.siemens.siemens_expressions import SiemensVariables

_LABEL = re.compile(r"(?:LBL\s*|G98\s*L\s*)([0-9]+|\"[^\"]*\")\s*\*?")
_CALL = re.compile(
    r"(?:CALL\s+LBL\s*([0-9]+|\"[^\"]*\")(?:\s*REP\s*([0-9]+))?(?:/[0-9]+)?|L\s*([0-9]+)\s*,\s*([0-9]+))\s*\*?"
)
_FN = re.compile(r"(?:FN\s*|D0?)([0-9]+)\s*:?\s*Q\s*([0-9]+)\s*=\s*(.+?)\s*\*?")
_IF = re.compile(r"FN\s*(9|10|11|12)\s*:\s*IF\s*(\S+)\s*(?:EQU|NE|GT|LT)\s*(\S+)\s*GOTO\s*LBL\s*([0-9]+|\"[^\"]*\")")
_ASSIGN = re.compile(r"Q\s*([0-9]+)\s*=\s*(.*?)\s*\*?")  # DIN/ISO blocks end with *
_USE = re.compile(r"([-+]?)\s*\bQ([0-9]+)\b(?!\s*=)|(?<=[XYZABCFRS])([-+]?)Q([0-9]+)\b(?!\s*=)")
_COMPUTED = re.compile(r"\b(?:A\s*\+?\s*Q120|B\s*\+?\s*Q121|C\s*\+?\s*Q122)\b")
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_OPERATORS = {1: "+", 2: "-", 3: "*", 4: "DIV"}
_COMPARE = {"9": "==", "10": "<>", "11": ">", "12": "<"}
_CYCLE_Q = range(200, 2000)  # parameters of cycles; formulas use the ones below


class LabelFlow:
    """Carries out one program line by line."""

    only_subroutines = False

    def __init__(self, items: Sequence[FlowItem]) -> None:
        self.items = items
        self.q = SiemensVariables()
        self.labels: dict[str, int] = {}
        self.calls: list[tuple[int, str]] = []  # place to go on at, label called
        self.repeats: dict[int, int] = {}
        self.twice: set[str] = set()  # labels that are set more than once
        for k, (_, text, _) in enumerate(items):
            if (found := _LABEL.fullmatch(text)) and found.group(1) != "0":
                label = _normalise_label(found.group(1))
                self.twice.update({label} & self.labels.keys())
                self.labels.setdefault(label, k)

    def run(self) -> Iterator[FlowItem]:
        """Lines as they are carried out.

        Raises:
            FlowError: a loop without end, a label the file does not hold, a formula that is not read.
        """
        at = 0
        guard = StepGuard(len(self.items))
        while at < len(self.items):
            line, text, comments = self.items[at]
            guard.step(line)
            before = at
            try:
                text, at = self._step(at, text)
            except MacroExpressionError as problem:
                raise ProgramFlowError(f"formulas: {problem}", line) from problem
            guard.count_idle_lines(anything=bool(text), line=line)
            if at <= before:
                state = (tuple(self.q.values.items()), tuple(self.repeats.items()), tuple(self.calls))
                guard.check_backward_jump(at, state, line)
            if text or comments:
                yield line, text, comments

    def _step(self, at: int, text: str) -> tuple[str, int]:
        if found := _LABEL.fullmatch(text):
            if found.group(1).strip("0") == "" and self.calls:
                return "", self.calls.pop()[0]
            return "", at + 1
        if self.calls and text.startswith(("END PGM", "END")):
            label = self.calls[-1][1]
            raise ProgramFlowError(
                f"the program ends inside of the subprogram LBL {label}, which has no LBL 0; add it", self.items[at][0]
            )
        if text.startswith("CALL") and not _CALL.fullmatch(text) and not text.startswith("CALL PGM"):
            raise ProgramFlowError(
                f"{text[:30]!r}: expected CALL LBL and a number or a name, and perhaps REP and a number; calls of "
                "other programs and of labels in variables are not followed. Expand it",
                self.items[at][0],
            )
        if found := _CALL.fullmatch(text):
            again = found.group(2) or (found.group(4) if found.group(4) not in (None, "0") else None)
            return "", self._call(at, found.group(1) or found.group(3), again)
        if re.match(r"D[0-9]+\s+P[0-9]", text):  # DIN/ISO
            raise MacroExpressionError(f"{text.split(maxsplit=1)[0]} is not read; expand the program first")
        if "Q" not in text:
            return text, at + 1
        if found := _IF.fullmatch(text):
            operator = _COMPARE[found.group(1)]
            if self.q.value(f"{found.group(2)} {operator} {found.group(3)}"):
                return "", self._place(found.group(4), at)
            return "", at + 1
        if found := _FN.fullmatch(text):
            self._evaluate_formula(int(found.group(1)), f"Q{found.group(2)}", found.group(3))
            return "", at + 1
        found = _ASSIGN.fullmatch(text.rstrip("~ "))
        if found:
            number = int(found.group(1))
            self.q.values[f"Q{number}"] = value = self.q.value(found.group(2) or "0")
            return (f"Q{number}={value:.9f}" if number in _CYCLE_Q else ""), at + 1
        if text.startswith(("L", "G0", "G1")) and not {"Q120", "Q121", "Q122"} & self.q.values.keys():
            text = _COMPUTED.sub(" COMPUTED ", text, count=1)  # places the control worked out for PLANE … STAY
            text = _COMPUTED.sub(" ", text)
        return _USE.sub(self._format_value, text), at + 1

    def _format_value(self, found: re.Match[str]) -> str:
        sign, number = found.group(1) or found.group(3) or "", found.group(2) or found.group(4)
        name = f"Q{number}"
        if name not in self.q.values:
            raise MacroExpressionError(f"{name} is read before it is set")
        return f"{-self.q.values[name] if '-' in sign else self.q.values[name]:+.9f}"

    def _evaluate_formula(self, number: int, name: str, text: str) -> None:
        if number == 0:
            self.q.values[name] = self.q.value(text)
        elif number in _OPERATORS and _OPERATORS[number] in text:
            left, _, right = (
                text.lstrip().partition(_OPERATORS[number]) if number == 4 else _split_operands(text, number)
            )
            operator = "/" if number == 4 else _OPERATORS[number]
            self.q.values[name] = self.q.value(f"({left}) {operator} ({right})")
        else:
            raise MacroExpressionError(f"FN {number} is not read; expand the program first")

    def _place(self, label: str, at: int) -> int:
        name = _normalise_label(label)
        if name not in self.labels:
            raise ProgramFlowError(f"label {label} is not in this file", self.items[at][0])
        if name in self.twice:
            raise ProgramFlowError(f"label {label} is set more than once in this file", self.items[at][0])
        return self.labels[name] + 1

    def _call(self, at: int, label: str, repeat: str | None) -> int:
        start = self._place(label, at)
        if repeat is not None:  # repeats a part of the program without a return address
            if start > at:
                raise ProgramFlowError(
                    f"CALL LBL {label} REP repeats the part between the label and the call, and the label is behind "
                    f"the call. A subprogram is called without REP",
                    self.items[at][0],
                )
            left = self.repeats.get(at, int(repeat))
            if left <= 0:
                self.repeats.pop(at, None)
                return at + 1
            self.repeats[at] = left - 1
            return start
        if len(self.calls) >= MAX_CALLS:
            raise ProgramFlowError(
                f"more than {MAX_CALLS} nested calls: does a subprogram call itself?", self.items[at][0]
            )
        self.calls.append((at + 1, label))
        return start


def _normalise_label(text: str) -> str:
    return text if text.startswith('"') else str(int(text))


def _split_operands(text: str, number: int) -> tuple[str, str, str]:
    """The two sides of FN 1 … 3, whose numbers carry signs of their own."""
    found = re.match(r"\s*([-+]?\s*(?:Q\s*[0-9]+|[0-9]+\.?[0-9]*|\.[0-9]+))\s*([-+*])\s*(.+)", text)
    if not found or found.group(2) != _OPERATORS[number]:
        raise MacroExpressionError(f"found {text.strip()!r}; expected two values and {_OPERATORS[number]!r}")
    return found.group(1), found.group(2), found.group(3)
