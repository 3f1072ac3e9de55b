"""Data of RAPID modules: declarations and assignments, and their targets, speeds, zones and frames."""

from __future__ import annotations

import math
import re

import numpy as np

from machopt.numerics.array_types import Array
from machopt.programs.abb.rapid_syntax import RapidProcedure, RapidStatement, read_rapid_module
from machopt.programs.abb.rapid_values import (
    RapidFunctionCall,
    RapidName,
    RapidSyntaxError,
    RapidValueReader,
    list_numbers,
    parse_robtarget,
)
from machopt.programs.abb.record_component_assignment import replace_component
from machopt.programs.reading.called_files import find_sibling_files, try_read_source
from machopt.programs.reading.program_builder import STANDING_TOOL, ProgramBuilder
from machopt.programs.reading.rotation_conventions import build_pose_matrix, convert_quaternion

ENDINGS = (".mod", ".prg", ".sys", ".modx", ".sysx")
DEEPEST = 20
_ZONE = re.compile(r"Z([0-9]{1,3})")
Quaternion = tuple[float, float, float, float]  # w first
_SPEED = re.compile(r"V([0-9]{1,5})")


class RapidData:
    """What CONST, PERS, VAR and assignments give names, as far as it is known before the robot runs."""

    def __init__(self, out: ProgramBuilder) -> None:
        self.out = out
        self.values: dict[str, tuple[object, str]] = {}  # value and type
        self.changed: dict[str, int] = {}  # name → line of its last assignment
        self.looked_around = False

    def declare(self, s: RapidStatement) -> None:
        """Store one CONST, PERS or VAR; a value that cannot be evaluated matters only when it is used.

        Args:
            s: The statement.
        """
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
                value = RapidValueReader(words[assign + 1 :]).value()
            except RapidSyntaxError:
                value = None
        indexed = at + 2 < len(words) and words[at + 2].text == "{"
        if indexed and isinstance(value, list):
            for k, item in enumerate(value, 1):
                self.values[f"{name}{{{k}}}"] = (item, kind)
        self.values[name] = (value, kind)

    def assign(self, s: RapidStatement) -> None:
        """Assign a value to a variable, an element or a component, as the controller does.

        A value that cannot be evaluated is unknown from here on: a target or frame that needs it is refused.

        Args:
            s: The statement.

        Raises:
            RapidSyntaxError: the left side is no variable.
        """
        at = next(k for k, t in enumerate(s.tokens) if t.text == ":=")
        target = RapidValueReader(s.tokens[:at]).value()
        if not isinstance(target, RapidName):
            raise RapidSyntaxError("found ':=' after something that is no variable")
        value: object
        try:
            value = RapidValueReader(s.tokens[at + 1 :]).value()
            value = self.resolve_name(value) if isinstance(value, RapidName | RapidFunctionCall) else value
        except RapidSyntaxError:
            value = None
        old, kind = self.values.get(target.text, (None, ""))
        self.mark_value_unknown(target.text, s.line, keep_elements=self.has(target))
        if not target.tail:
            self.values[target.text] = (value, kind)
        elif self.has(target):
            self.values[target.text + target.tail] = (value, kind)
        elif value is not None:
            self.values[target.text] = (replace_component(old, kind, target.tail, value), kind)

    def has(self, name: RapidName) -> bool:
        """Return whether a name is an element of an array whose elements are known one by one.

        Args:
            name: Name with its index or component.
        """
        return name.tail.startswith("{") and name.text + name.tail in self.values

    def mark_value_unknown(self, name: str, line: int, *, keep_elements: bool = False) -> None:
        """Mark the value of a variable as unknown from a line on.

        Args:
            name: Name of the variable.
            line: Line number in the file (1-based).
            keep_elements: Whether known elements of an array stay known.
        """
        _, kind = self.values.get(name, (None, ""))
        self.values[name] = (None, kind)
        self.changed[name] = line
        if not keep_elements:
            for key in [k for k in self.values if k.startswith(name + "{")]:
                self.values[key] = (None, kind)

    def frame_name(self, value: object, default: str) -> str:
        """Return the name of a tool or work object, which is a new name after each assignment to it.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.
            default: Name for a value without a name.

        Returns:
            The name.
        """
        if not isinstance(value, RapidName):
            return default
        line = self.changed.get(value.text)
        return value.text + value.tail + ("" if line is None else f" of line {line}")

    def resolve_name(self, value: object, depth: int = 0) -> object:
        """Resolve a name, or an Offs or RelTool of a name, to its list.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.
            depth: Depth of nested names, to stop circular definitions.

        Returns:
            The value.

        Raises:
            RapidSyntaxError: the name is not declared, or the value is a formula.
        """
        if depth > DEEPEST:
            raise RapidSyntaxError("data that refers to itself")
        if isinstance(value, RapidName):
            key = value.text + value.tail
            if value.tail.startswith(".") or (value.tail and key not in self.values):
                raise RapidSyntaxError(
                    f"{key}: components and computed indices are not evaluated; expand the program first"
                )
            if key not in self.values:
                self.load_sibling_modules(value.text)
            if key not in self.values:
                raise RapidSyntaxError(
                    f"{value.shown} is declared in none of the modules read; put the module that "
                    "declares it beside this one"
                )
            found = self.values[key][0]
            if found is None:
                raise RapidSyntaxError(f"{value.shown} gets its value only while the robot runs")
            return self.resolve_name(found, depth + 1)
        if isinstance(value, RapidFunctionCall):
            return self.shift_target(value, depth)
        return value

    def shift_target(self, value: RapidFunctionCall, depth: int) -> object:
        """Evaluate Offs(point, x, y, z) along the work object axes or RelTool(point, x, y, z) along the tool axes.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.
            depth: Depth of nested names, to stop circular definitions.

        Returns:
            The shifted robtarget.

        Raises:
            RapidSyntaxError: another function, or its arguments are not known.
        """
        numbers = value.arguments[1:]
        if value.name in ("CROBT", "CJOINTT", "CPOS"):
            raise RapidSyntaxError(
                f"{value.name.lower()}() is the current position of the robot: it is known only while the program runs"
            )
        turns = dict(value.options)
        known = all(isinstance(v, float) for v in (*numbers, *turns.values()))
        if (
            value.name not in ("OFFS", "RELTOOL")
            or len(numbers) != 3
            or not known
            or (turns and (value.name == "OFFS" or not set(turns) <= {"RX", "RY", "RZ"}))
        ):
            raise RapidSyntaxError(f"{value.name.lower()}(…) is not evaluated; expand the program first")
        point = self.resolve_name(value.arguments[0], depth + 1)
        x, y, z, q, rest = parse_robtarget(point)
        d = np.array(numbers, float)
        if value.name == "RELTOOL":
            rows = convert_quaternion(*q)
            if rows is None:
                raise RapidSyntaxError("a quaternion is not of unit length")
            d = np.array(rows).reshape(3, 3) @ d
        for axis in ("RX", "RY", "RZ"):  # about the tool's axes as they lie after the turn before
            if axis in turns:
                q = _turn_quaternion(q, axis, float(turns[axis]))  # type: ignore[arg-type]
        return [[x + d[0], y + d[1], z + d[2]], list(q), *rest]

    def load_sibling_modules(self, name: str) -> None:
        """Read the declarations in the other modules of the folder.

        Args:
            name: Name that is looked for.
        """
        if self.looked_around:
            return
        self.looked_around = True
        for file in find_sibling_files(self.out.source.path, ENDINGS):
            other = try_read_source(file)
            if other is None or not re.search(rf"\b{re.escape(name)}\b", "\n".join(other.lines), re.IGNORECASE):
                continue
            before = dict(self.values)
            for s in read_rapid_module(other).data:
                self.declare(s)
            self.values |= before  # this module has priority
            self.out.files.append(file)

    def speed(self, value: object, line: int, proc: RapidProcedure) -> float:
        """Return the speed of a move.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.
            line: Line number in the file (1-based).
            proc: The procedure that holds the move.

        Returns:
            Speed in m/s; NaN where it is set elsewhere.
        """
        if isinstance(value, RapidName) and value.text not in self.values:
            known = _SPEED.fullmatch(value.text)
            if known:
                return float(known.group(1)) * 1e-3
            if value.text != "VMAX":
                where = "an argument of the procedure" if value.text in proc.parameters else "declared elsewhere"
                # its feed is required
                self.out.ignore(f"speed {value.shown} ({where})", line, understood=False, stops=False)
            return math.nan
        found = self.resolve_name(value)
        if isinstance(found, list) and found and isinstance(found[0], float):
            return found[0] * 1e-3
        return math.nan

    def zone(self, value: object) -> float:
        """Return the zone of a move.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.

        Returns:
            Radius in m; 0 for a stop point.
        """
        if isinstance(value, RapidName) and value.text not in self.values:
            known = _ZONE.fullmatch(value.text)
            if known:
                return (float(known.group(1)) or 0.3) * 1e-3
            return 0.0 if value.text == "FINE" else math.nan
        found = self.resolve_name(value)
        if isinstance(found, list) and len(found) > 1 and isinstance(found[1], float):
            stops = isinstance(found[0], RapidName) and found[0].text == "TRUE"
            return 0.0 if stops else found[1] * 1e-3
        return math.nan

    def find_carrying_unit(self, value: object) -> str:
        """Find the mechanical unit that carries a work object.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.

        Returns:
            Name of the unit; empty for a fixed work object or an unknown one.
        """
        if not isinstance(value, RapidName) or value.text not in self.values:
            return ""
        try:
            found = self.resolve_name(value)
        except RapidSyntaxError:
            return ""
        return _find_moving_unit(found) if isinstance(found, list) else ""

    def frame(self, value: object, zero: str, work_object: bool) -> Array | None:
        """Return the frame of tooldata or wobjdata.

        Args:
            value: Parsed RAPID value: number, text, list, name or function call.
            zero: Name of the frame that is the identity (tool0, wobj0).
            work_object: Whether the value is wobjdata instead of tooldata.

        Returns:
            Transform (4, 4) in m, None where only the controller holds it.

        Raises:
            RapidSyntaxError: the value is no such data, or the tool is stationary (robhold).
        """
        if value is None or (isinstance(value, RapidName) and value.text == zero):
            return np.eye(4)
        if isinstance(value, RapidName) and value.text not in self.values:
            return None
        try:
            found = self.resolve_name(value)
        except RapidSyntaxError:
            return None
        if not isinstance(found, list):
            return None
        holds = isinstance(found[0], RapidName) and found[0].text == "TRUE" if found else False
        if found and isinstance(found[0], RapidName) and holds == work_object:
            name = (
                f"{'wobjdata' if work_object else 'tooldata'} "
                f"{value.shown if isinstance(value, RapidName) else ''}".strip()
            )
            raise RapidSyntaxError(f"{name} (robhold): {STANDING_TOOL}")
        places = found[3:5] if work_object else found[1:2]
        if work_object and _find_moving_unit(found):  # the unit's pose counts instead of the user frame
            places = found[4:5]
        out = np.eye(4)
        for place in places:
            if not (isinstance(place, list) and len(place) == 2):
                return None
            p, q = (list_numbers(v, n) for v, n in zip(place, (3, 4), strict=True))
            rows = None if q is None else convert_quaternion(*q)
            if p is None or rows is None:
                return None
            out = out @ build_pose_matrix(rows, p[0] * 1e-3, p[1] * 1e-3, p[2] * 1e-3)
        return out


def _find_moving_unit(found: list[object]) -> str:
    """The mechanical unit that moves wobjdata (ufprog FALSE), empty for a fixed one."""
    if len(found) < 3 or not (isinstance(found[1], RapidName) and found[1].text == "FALSE"):
        return ""
    return found[2] if isinstance(found[2], str) else "?"


def _turn_quaternion(q: Quaternion, axis: str, degrees: float) -> Quaternion:
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
