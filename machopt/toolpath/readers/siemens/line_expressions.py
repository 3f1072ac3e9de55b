"""Expressions in a line of a Sinumerik program, replaced by their numbers; assignments carried out."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError
from machopt.toolpath.readers.siemens.siemens_expressions import VARIABLE, SiemensVariables
from machopt.toolpath.readers.siemens.subprograms import find_closing_bracket, split_arguments

_ASSIGN = re.compile(rf"\s*({VARIABLE})\s*=(?!=)\s*")
_MODE = re.compile(r"(AC|IC|DC|ACP|ACN)\s*\(")
_ADDRESS = re.compile(
    r"[A-Z]|CR|AR|RP|AP|TURN|[ABC][2-5]|[IJK]1|FA|SPOS|[XYZABC][0-9]|FR\w*|OMA[0-9]|D[LT]?|RPL|RNDM?|CHF|CHR|ANG|FB|OVR|[MSHGT][0-9]?"
)
_MOVES_TOO = re.compile(r"\bG[0-9]|\b[XYZ]\s*(?:=|[-+.0-9])")
_NOT_EVALUATED = re.compile(r"(?:MSG|SPOS|DISABLE|WRITE|EXTERN)\b")
_ONLY_PARAMETERS = re.compile(r"(?:R[0-9]+=[-0-9.]+\s*|N[0-9]+\s*)*")
_PARAMETER = re.compile(r"R[0-9]+")
_PLAIN_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_CALL = re.compile(r"[A-Z_]\w*\s*\(")
_STEP = re.compile(r"\"[^\"]*\"?|[A-Z_]\w*|.", re.DOTALL)


def _keep_index(found: re.Match[str]) -> str:
    """What an assignment reads on its left side: the names in an index."""
    return f" {found.group(1).partition('[')[2]} "


class LineEvaluator:
    """Evaluates the lines of one program."""

    def __init__(self, variables: SiemensVariables, codes: Iterable[str]) -> None:
        self.variables = variables
        self._parts: dict[str, list[str | Callable[[], str]]] = {}  # lines split once
        self.read = {  # names that some line reads: variables, not words of the control
            name for code in codes for name in re.findall(r"[A-Z_]\w*", _ASSIGN.sub(_keep_index, code))
        }

    def replace_expressions(self, code: str) -> str:
        """Return the line with assignments carried out and every address' expression as a number.

        Args:
            code: The line without its number and label.

        Raises:
            MacroExpressionError: an expression has no value.
        """
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
                one, at = self._parse_assignment(code, found)
                parts.append(one)
                continue
            call = _CALL.match(code, at)
            if call and not _NOT_EVALUATED.match(code, at):
                end = find_closing_bracket(code, call.end())
                parts.append(self._build_call(code[at : call.end()], split_arguments(code[call.end() : end])))
                at = end + 1
                continue
            step = _STEP.match(code, at)
            assert step is not None
            parts.append(step.group())
            at = step.end()
        return parts

    def _build_call(self, head: str, arguments: list[str]) -> Callable[[], str]:
        return lambda: head + ",".join(map(self._evaluate_argument, arguments)) + ")"

    def _parse_assignment(self, code: str, found: re.Match[str]) -> tuple[Callable[[], str], int]:
        """One ``name = expression`` and the place after it; what stays a word of the block comes back as text."""
        written = found.group(1)
        fixed = None if "[" in written else written  # the name of an element follows from its index
        base = written.partition("[")[0].strip()
        address = fixed is not None and _ADDRESS.fullmatch(fixed) is not None
        mode = _MODE.match(code, found.end())
        begin = found.end() if mode is None else mode.end()
        end = self.variables.end_of(code, begin)
        if mode is not None and code[end : end + 1] != ")":
            raise MacroExpressionError(f"{mode.group(1)}( is not closed")

        def carry_out() -> str:
            value = self.variables.part(code, begin)[0]
            name = self.variables.name_of(written) if fixed is None else fixed
            parameter = _PARAMETER.fullmatch(name) is not None
            if mode is not None:
                return f" {name}={mode.group(1)}({value:.9f}) "
            is_variable = parameter or address or name in self.variables.values or base in self.variables.types
            if not is_variable and (_MOVES_TOO.search(code) or base not in self.read):
                return f" {name}={value:.9f} "  # no variable: those are assigned in blocks of their own
            if parameter or not address or name in self.variables.values or base in self.variables.types:
                self.variables.assign(name, value)
                return f" {name}={value:.9f} " if parameter else ""  # older drilling cycles take R2, R3, R10 as words
            return f" {name}{value:.9f} " if len(name) == 1 else f" {name}={value:.9f} "

        return carry_out, end if mode is None else end + 1

    def _evaluate_argument(self, text: str) -> str:
        part = text.strip()
        if not part or part.startswith('"') or _PLAIN_NUMBER.fullmatch(part):
            return text
        return f"{self.variables.value(part):.9f}"
