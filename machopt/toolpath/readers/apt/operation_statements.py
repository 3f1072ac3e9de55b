"""CL statements about operations, tools, spindle, coolant and the output of the post-processor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from machopt.file_formats.source_file import normalise_word
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.apt.cam_dialect import CamDialect, parse_unit
from machopt.toolpath.readers.apt.coordinate_statements import CoordinateSystemReader
from machopt.toolpath.readers.apt.inserted_text import AUXILIARY, has_nc_words
from machopt.toolpath.readers.apt.statement_parser import parse_number, split_fields

_MODES = ("MILL", "INCR", "ABSOL")


class OperationStatementReader(CoordinateSystemReader):
    """Keeps them as operations and events; what may move points is counted as not understood."""

    tool_from = 0  # number of points before the tool in use
    registers: Mapping[str, str] = MappingProxyType({})  # word → number of the offset register in use

    def tool_path(self, word: str, rest: str, line: int) -> None:
        """Carry out TOOL PATH: an operation begins (NX).

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        parts = [p.strip() for p in rest.split(",")]
        tool = parts[2] if len(parts) > 2 else ""
        self.take_new_tool()
        self.ended = False
        self.cycle, self.rapid = None, False
        self.out.begin_operation(parts[0] or "TOOL PATH", tool=tool)

    def feature(self, word: str, rest: str, line: int) -> None:
        """Begin an operation with the name of a feature.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        self.out.begin_operation(rest, tool=self.tool)

    def load_tool(self, word: str, rest: str, line: int) -> None:
        """Carry out LOADTL or TOOLNO: a tool change.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        parts = split_fields(rest)
        value = parse_number(parts[0]) if parts else None
        if parts and parts[0] == self.tool:
            return  # named again, not changed
        self.tool = parts[0] if parts else ""
        self.take_new_tool()
        self.out.event("tool", f"{word}/{rest}", math.nan if value is None else value)
        if self.dialect in (CamDialect.GENERIC, CamDialect.CREO):
            self.out.begin_operation(f"tool {self.tool}", tool=self.tool)
        elif self.dialect is CamDialect.HSM:
            self.out.change_tool(self.tool)
        else:
            self.out.also_tool(self.tool)

    def load(self, word: str, rest: str, line: int) -> None:
        """Carry out ``LOAD/TOOL``: a tool change.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        parts = rest.split(",")
        if parts[0].strip().upper() == "TOOL" and len(parts) > 1:
            self.load_tool("LOAD", ",".join(parts[1:]), line)
        else:
            self.out.ignore(f"LOAD/{parts[0].strip()}", line, understood=False)

    def insert(self, word: str, rest: str, line: int) -> None:
        """Carry out INSERT: text for the control program.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        if rest.startswith("["):
            self.tool_text = rest.partition("]")[2].strip() or rest
        if has_nc_words(rest):  # the post copies the text into its program
            self.out.ignore(f"INSERT/{' '.join(rest.split())[:40]}", line, understood=False)
        self.out.event("comment", rest)

    def function_code(self, word: str, rest: str, line: int) -> None:
        """Carry out PREFUN or AUXFUN.

        PREFUN/n writes Gn and AUXFUN/n writes Mn into the program. Codes that move nothing are accepted.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        code = parse_number((split_fields(rest) or [""])[0])
        if code is None:
            known = False
        elif word == "PREFUN":
            known = round(code * 10) in harmless_words.G
        else:
            known = round(code) in harmless_words.M or round(code) in AUXILIARY
        self.out.ignore(word if known else f"{word}/{rest.strip()[:20]}", line, understood=known)

    def tool_number(self, word: str, rest: str, line: int) -> None:
        """Carry out a statement that gives the number of the tool.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        if "TURN" in split_fields(rest):
            self.out.warn_once("a turning tool: the work turns, its points are not those of a milling tool", line)
        self.out.ignore(word, line, understood=True)

    def coolant(self, word: str, rest: str, line: int) -> None:
        """Carry out COOLNT: record a coolant event.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        self.out.event("coolant", f"COOLNT/{rest}")

    def compensation(self, word: str, rest: str, line: int) -> None:
        """Carry out CUTCOM: cutter radius compensation.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        side = split_fields(rest)[:1]
        if side and side[0] in ("LEFT", "RIGHT"):
            self.out.warn_once(
                "CUTCOM is taken as wear compensation of zero: the points are the tool's, not the contour's", line
            )
        self.out.ignore("CUTCOM", line, understood=True)

    def delay(self, word: str, rest: str, line: int) -> None:
        """Carry out DELAY: record a dwell event.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        value = parse_number((split_fields(rest) or [""])[0])
        self.out.event("dwell", f"DELAY/{rest}", math.nan if value is None else value)

    def stop(self, word: str, rest: str, line: int) -> None:
        """Carry out STOP or OPSTOP: record a stop event.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        self.out.event("stop", word)

    def remark(self, word: str, rest: str, line: int) -> None:
        """Carry out a comment statement: record its text.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        text = rest.strip().strip("'")
        self.remarks = text or self.remarks
        self.out.event("comment", text)

    def take_new_tool(self) -> None:
        """Forget the registers of the tool before: the new tool has a length of its own."""
        self.tool_from = len(self.out)
        self.registers = {name: n for name, n in self.registers.items() if name == "OFSTNO"}

    def select_register(self, word: str, number: str, line: int, *, points_before: bool) -> None:
        """Carry out the choice of an offset register, whose value only the control knows.

        The first choice names the register that the points count from. Another one in the middle of the path moves the
        points behind it by the difference of both values (ISO 4343: OFSETL, OFSTNO), so it stops the plan.

        Args:
            word: SET/OFSETL, SET/ADJUST or OFSTNO.
            number: Text of the number.
            line: Line number in the file (1-based).
            points_before: Whether points count from the register that was in use.
        """
        before = self.registers.get(word)
        self.registers = {**self.registers, word: number}
        self.out.ignore(word, line, understood=number == before or not points_before)

    def offset_number(self, word: str, rest: str, line: int) -> None:
        """Carry out OFSTNO: the work offset that the points count from.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        self.select_register(word, rest.strip(), line, points_before=len(self.out) > 0)

    def set_mode(self, word: str, rest: str, line: int) -> None:
        """Carry out ``SET/MODE`` or another mode of the post-processor.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        parts = split_fields(rest)
        if "INCR" in parts:
            self.ask_for_increments("SET/MODE,INCR", line)
        name = parts[0] if parts else ""
        if name in ("OFSETL", "ADJUST"):
            self.select_register(f"SET/{name}", ",".join(parts[1:]), line, points_before=len(self.out) > self.tool_from)
            return
        self.out.ignore(f"SET/{name[:20]}", line, understood=name in harmless_words.APT_SET)

    def ask_for_increments(self, word: str, line: int) -> None:
        """Decide the meaning of INCR by the user's option.

        In NX it orders the post-processor to write increments and GOTO stays absolute; elsewhere GOTO is incremental.

        Args:
            word: Major word of the statement.
            line: Line number in the file (1-based).

        Raises:
            InputError: the user has not given the option.
        """
        if normalise_word(word) not in self.options.accept_unknown:
            raise self.source.build_error(
                f"{word}: it tells the post to write increments while GOTO stays absolute (NX), or it says that GOTO "
                f"itself counts in increments. Give --accept-unknown {word} where GOTO stays absolute; expected "
                "absolute points otherwise",
                line,
            )
        self.out.ignore(word, line, understood=False)

    def units(self, word: str, rest: str, line: int) -> None:
        """Carry out a further UNITS statement (HSM/Fusion writes one per section).

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        scale = parse_unit(rest)
        if scale is not None and scale != self.scale:
            self.out.warn_once("the unit changes within the file", line)
            self.scale = scale
        self.out.ignore(word if scale else f"{word}/{rest.strip()[:20]}", line, understood=scale is not None)

    def mode(self, word: str, rest: str, line: int) -> None:
        """Carry out MODE: absolute or incremental points.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        parts = split_fields(rest)
        if "INCR" in parts:
            self.ask_for_increments("MODE/INCR", line)
        if "TURN" in parts:
            self.tool_number(word, rest, line)
        else:
            strange = [p for p in parts if p and p not in _MODES and parse_number(p) is None]
            self.out.ignore(f"MODE/{strange[0]}" if strange else word, line, understood=not strange)

    def multi_axis(self, word: str, rest: str, line: int) -> None:
        """Carry out MULTAX: whether points carry a tool axis.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        self.multax = "OFF" not in split_fields(rest)
        if not self.multax and self.dialect is CamDialect.HSM:
            self.axis = (0.0, 0.0, 1.0)
        self.out.ignore(word, line, understood=True)

    def cutter(self, word: str, rest: str, line: int) -> None:
        """Carry out CUTTER: in HSM/Fusion the first statement of an operation after its name.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        if self.dialect is CamDialect.HSM and self.remarks:
            self.out.begin_operation(self.remarks, tool=self.tool)
        self.out.ignore(word, line, understood=True)
