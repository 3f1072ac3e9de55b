"""Subprograms that a Sinumerik file contains: their parts of the file, parameters, calls and variables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from machopt.toolpath.readers.program_flow.execution_limits import ProgramFlowError
from machopt.toolpath.readers.program_flow.linuxcnc_o_words import FlowItem
from machopt.toolpath.readers.siemens.siemens_expressions import VARIABLE, SiemensVariables
from machopt.toolpath.readers.siemens.variable_types import NUMBER_TYPES, convert_to_type

HEAD = re.compile(r"%_N_(\w+?)_(?:SPF|MPF)\b.*|(?:N[0-9]+\s*)?PROC\s+(\w+)\b\s*(.*)")
_SIGNATURE = re.compile(r"\(([^()]*)\)")
_PARAMETER = re.compile(
    r"(VAR\s+)?(REAL|INT|BOOL|CHAR|STRING|AXIS|FRAME)\b(?:\s*\[[^\]]*\])?\s*([A-Z_]\w*)?\s*(?:=(.*))?"
)
_REPEATS = re.compile(r"P\s*(?:=\s*(.+)|([0-9]+))")
_NAME = re.compile(VARIABLE)
MAX_REPEATS = 9999  # of the address P of a call


@dataclass(frozen=True)
class SubprogramParameter:
    """One parameter of ``PROC NAME(…)``."""

    name: str
    type: str
    default: str  # expression; empty: zero
    by_reference: bool  # VAR


@dataclass
class Subprogram:
    """One program of the file: the places from its head to the next one."""

    first: int  # place of the first line behind the name
    last: int = -1  # place behind the last line
    parameters: tuple[SubprogramParameter, ...] = ()
    saves_modes: bool = False  # PROC … SAVE


@dataclass(kw_only=True)
class SubprogramCall:
    """A call that is under way."""

    back: int  # place to go on at
    program: Subprogram
    line: int
    repeats: int = 0  # still to be done after this one
    values: dict[str, float] = field(default_factory=dict)  # of the parameters
    hidden: dict[str, float | None] = field(default_factory=dict)  # the caller's values; None: it had none
    hidden_types: dict[str, str | None] = field(default_factory=dict)  # the caller's types of these names
    returned: dict[str, str] = field(default_factory=dict)  # VAR parameter → the caller's variable
    modal: bool = False  # by MCALL


@dataclass(frozen=True)
class CallText:
    """A call as it is written: ``NAME(arguments) P…``, behind MCALL, CALL or PCALL or alone."""

    way: str  # MCALL, CALL, PCALL or empty
    name: str
    arguments: str  # text in the brackets
    repeats: str  # expression behind P, empty where there is none
    alone: bool  # nothing else is in the block


def index_programs(items: Sequence[FlowItem]) -> tuple[dict[str, Subprogram], list[Subprogram]]:
    """Find the programs of a file.

    Args:
        items: Lines of the file.

    Returns:
        The programs by name, and the program of each line.

    Raises:
        ProgramFlowError: a list of parameters is malformed.
    """
    present = Subprogram(0)
    named: dict[str, Subprogram] = {}
    owners: list[Subprogram] = []
    begun = False  # a line behind the head
    for k, (line, text, _) in enumerate(items):
        found = HEAD.fullmatch(text)
        if found:
            if begun or (found.group(2) and present.parameters):
                present.last = k
                present = Subprogram(k + 1)
                begun = False
            present.first = k + 1
            if found.group(2):
                present.parameters, present.saves_modes = _parse_signature(found.group(3), line)
            named.setdefault((found.group(1) or found.group(2)).upper(), present)
        elif text:
            begun = True
        owners.append(present)
    present.last = len(items)
    return named, owners


def _parse_signature(text: str, line: int) -> tuple[tuple[SubprogramParameter, ...], bool]:
    listed = _SIGNATURE.match(text)
    rest = text[listed.end() :] if listed else text
    parameters = []
    for part in split_arguments(listed.group(1)) if listed and listed.group(1).strip() else []:
        found = _PARAMETER.fullmatch(part.strip())
        if found is None or not found.group(3):
            raise ProgramFlowError(f"PROC: parameter {part.strip()!r}; expected a type and a name such as REAL A", line)
        parameters.append(
            SubprogramParameter(found.group(3), found.group(2), (found.group(4) or "").strip(), bool(found.group(1)))
        )
    return tuple(parameters), re.search(r"\bSAVE\b", rest) is not None


def compile_call_pattern(names: Sequence[str]) -> re.Pattern[str] | None:
    """Return the pattern of a call of one of the programs of a file; None where it has none.

    Args:
        names: Names of the programs.
    """
    callable_names = [name for name in names if not name.isdigit()]  # 10 in X-10 is no call of %_N_10_MPF
    if not callable_names:
        return None
    listed = "|".join(map(re.escape, sorted(callable_names, key=len, reverse=True)))
    return re.compile(
        rf"(?<![\w=])(?:(MCALL|CALL|PCALL)\b\s*)?[\"/\w]*?(?<![A-Z0-9])(?:_N_)?({listed})(?:_SPF|_MPF)?\"?(?!\w|\s*[=:\[])"
    )


def parse_call(code: str, pattern: re.Pattern[str] | None) -> CallText | None:
    """Parse the call of a program of the file in one line.

    Args:
        code: The line without its number and label.
        pattern: See :func:`compile_call_pattern`.

    Returns:
        The call; None where the line has none.
    """
    found = pattern.search(code) if pattern is not None else None
    if found is None or found.start() > code.find('"') >= 0:
        return None
    rest, arguments = code[found.end() :].strip(), ""
    if rest.startswith("("):
        end = find_closing_bracket(rest, 1)
        arguments, rest = rest[1:end].strip(), rest[end + 1 :].strip()
    before = code[: found.start()].strip()
    repeats = _REPEATS.fullmatch(rest or before)
    alone = not (rest and before) and (repeats is not None or not (rest or before))
    text = (repeats.group(1) or repeats.group(2)) if repeats else ""
    return CallText(found.group(1) or "", found.group(2), arguments, text, alone)


def bind_call(call: CallText, program: Subprogram, back: int, line: int, variables: SiemensVariables) -> SubprogramCall:
    """Evaluate the arguments of a call.

    A parameter without argument has its default, else zero. INT and CHAR round, BOOL is zero or one.

    Args:
        call: The call as written.
        program: The program called.
        back: Place to go on at.
        line: Line number in the file (1-based).
        variables: Variables of the caller.

    Returns:
        The call with the values of its parameters.

    Raises:
        ProgramFlowError: arguments do not match the parameters, or the number of repeats is none.
        MacroExpressionError: an argument has no value.
    """
    texts = split_arguments(call.arguments) if call.arguments else []
    if len(texts) > len(program.parameters):
        raise ProgramFlowError(
            f"{call.name} is called with {len(texts)} values; its PROC has {len(program.parameters)} parameters", line
        )
    times = variables.value(call.repeats) if call.repeats else 1.0
    if times != round(times) or not 1 <= times <= MAX_REPEATS:
        raise ProgramFlowError(f"{call.name} P{times:g}: expected 1 to {MAX_REPEATS} passes", line)
    bound = SubprogramCall(back=back, program=program, line=line, repeats=round(times) - 1)
    for k, parameter in enumerate(program.parameters):
        text = texts[k].strip() if k < len(texts) else ""
        if parameter.type not in NUMBER_TYPES:
            if text:
                raise ProgramFlowError(
                    f"{call.name}: parameter {parameter.name} is of type {parameter.type}; followed are "
                    f"{', '.join(NUMBER_TYPES)}. Expand the call",
                    line,
                )
            continue
        if parameter.by_reference and text:
            if not _NAME.fullmatch(text):
                raise ProgramFlowError(f"{call.name}: VAR {parameter.name} needs a variable; found {text!r}", line)
            bound.returned[parameter.name] = variables.name_of(text)
        value = variables.value(text or parameter.default or "0")
        bound.values[parameter.name] = convert_to_type(value, parameter.type, parameter.name)
    return bound


def enter_call(call: SubprogramCall, variables: SiemensVariables) -> None:
    """Set the parameters; the caller's variables of the same names are hidden until the program returns.

    Args:
        call: The call.
        variables: Variables of the program flow; changed in place.
    """
    types = {parameter.name: parameter.type for parameter in call.program.parameters}
    for name, value in call.values.items():
        hide_variable(call, name, variables)
        variables.types[name] = types[name]
        variables.values[name] = value


def hide_variable(call: SubprogramCall, name: str, variables: SiemensVariables) -> None:
    """Keep the caller's value of a variable that the called program defines anew.

    Args:
        call: The call under way.
        name: Name of the variable.
        variables: Variables of the program flow.
    """
    base = name.partition("[")[0]
    call.hidden.setdefault(name, variables.values.get(name))
    call.hidden_types.setdefault(base, variables.types.get(base))


def leave_call(call: SubprogramCall, variables: SiemensVariables) -> None:
    """Return the VAR parameters and restore the caller's variables.

    Args:
        call: The call that ends.
        variables: Variables of the program flow; changed in place.
    """
    returned = {to: variables.values[name] for name, to in call.returned.items()}
    for name, value in call.hidden.items():
        if value is None:
            variables.values.pop(name, None)
        else:
            variables.values[name] = value
    for name, kind in call.hidden_types.items():
        if kind is None:
            variables.types.pop(name, None)
        else:
            variables.types[name] = kind
    call.hidden.clear()
    call.hidden_types.clear()
    for name, value in returned.items():
        variables.assign(name, value)


def find_closing_bracket(text: str, at: int) -> int:
    """Return the index of the bracket that closes the one before ``at``; the end of the line where none does.

    Args:
        text: Text of the line.
        at: Index behind the opening bracket.
    """
    depth = 1
    for k in range(at, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if depth == 0:
            return k
    return len(text)


def split_arguments(text: str) -> list[str]:
    """Split arguments at the commas outside of round and square brackets and quotes.

    Args:
        text: Text between the brackets of a call.

    Returns:
        The arguments.
    """
    parts, depth, quoted = [""], 0, False
    for c in text:
        quoted ^= c == '"'
        depth += (c in "([") - (c in ")]")
        if c == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += c
    return parts
