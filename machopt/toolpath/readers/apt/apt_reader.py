"""APT / cutter location readers: NX CLSF, CATIA aptsource, Creo ncl, CAMWorks APT and CLT, HSM/Fusion, plain APT.

One statement reader handles all dialects; :class:`CamDialect` holds the differences. Coordinates stay in the system
of the file, which is ``workpiece``. Where a file changes the system, later points are transformed into the first one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np

from machopt.data_types.toolpath import Toolpath
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.path_building.coordinate_systems import CoordinateSystem, FrameError
from machopt.path_building.drilling_cycles import DrillingCycleError
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.apt.cam_dialect import CamDialect
from machopt.toolpath.readers.apt.cycle_statements import (
    NO_SPEED,
    HsmDrillingCycle,
    build_drilling_cycle,
    parse_cycle,
)
from machopt.toolpath.readers.apt.fast_goto_reader import is_plain_goto_mode, read_plain_gotos
from machopt.toolpath.readers.apt.feed_units import FEED_UNITS
from machopt.toolpath.readers.apt.operation_statements import OperationStatementReader
from machopt.toolpath.readers.apt.refused_words import REFUSED
from machopt.toolpath.readers.apt.statement_parser import (
    COMMENT,
    parse_number,
    parse_numbers,
    parse_statement_at,
    split_fields,
    try_parse_numbers,
)

_OPERATION_COMMENT = re.compile(r"\s*(?:OPERATION(?: NAME)?|OPNAME)\s*[:=]\s*(.+)", re.IGNORECASE)
SLOWEST_PER_MINUTE = 5.0  # mm/min; twice the largest feed per revolution of drills, below that of any milling cut
_ROW = 4  # numbers in one line of a CATIA matrix
Handler = Callable[[str, str, int], None]


def read_apt(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read a cutter location file.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    return _AptReader(source, options).run()


class _AptReader(OperationStatementReader):
    """Carries out the statements one by one."""

    def run(self) -> Toolpath:
        handlers = self.list_handlers()
        lines, at = self.source.lines, 0
        while at < len(lines):
            if is_plain_goto_mode(self):
                at = read_plain_gotos(self, at)
                if at == len(lines):
                    break
            at, found = parse_statement_at(lines, at)
            for line, word, rest in found:
                self.carry_out(line, word, rest, handlers)
        return self.finish(len(lines))

    def list_handlers(self) -> dict[str, Handler]:
        """Return the method that carries out each word."""
        return {
            "FROM": self.go_from,
            "GOHOME": self.go_home,
            "GODLTA": self.go_delta,
            "RAPID": self.rapid_next,
            "FEDRAT": self.feed_rate,
            "SPINDL": self.spindle,
            "COOLNT": self.coolant,
            "CUTCOM": self.compensation,
            "CYCLE": self.cycle_word,
            "TRNTYP": self.transfer_type,
            "MSYS": self.msys,
            "CSYS": self.csys,
            "TOOL PATH": self.tool_path,
            "OPFEATSTART": self.feature,
            "LOADTL": self.load_tool,
            "LOAD": self.load,
            "INSERT": self.insert,
            "TLAXIS": self.tool_axis,
            "DELAY": self.delay,
            "STOP": self.stop,
            "OPSTOP": self.stop,
            "SET": self.set_mode,
            "OFSTNO": self.offset_number,
            "TOOLNO": self.tool_number,
            "PPRINT": self.remark,
            "MSG": self.remark,
            "ROTABL": self.rotate_table,
            "UNITS": self.units,
            "MODE": self.mode,
            "MULTAX": self.multi_axis,
            "CUTTER": self.cutter,
            "TRANS": self.shift,
            "SCALE": self.enlarge,
            "ORIGIN": self.origin,
            "TRACUT": self.coordinate_word,
            "COPY": self.coordinate_word,
            "MIRROR": self.coordinate_word,
            "ROTATE": self.coordinate_word,
            "ROTHED": self.coordinate_word,
            "PREFUN": self.function_code,
            "AUXFUN": self.function_code,
            "CIRCLE": self.circle,
            "MOVARC": self.circle,
            "INDIRV": self.circle,
            "TLON": self.drive,
            "NURBS": self.spline,
            "KNOT": self.spline,
            "CNTRL": self.spline,
        }

    def carry_out(self, line: int, word: str, rest: str, handlers: dict[str, Handler]) -> None:
        if self.ended and word not in (COMMENT, "TOOL PATH", "FINI"):
            self.out.ignore("text after the end", line, understood=False, stops=False)
            return
        try:
            if word == "GOTO":
                self.goto(rest, line)
            elif word == COMMENT:
                self.comment(rest, line)
            elif word in handlers:
                if self.curves.spline_open and word not in ("NURBS", "KNOT", "CNTRL"):
                    self.end_spline(line)
                handlers[word](word, rest, line)
            else:
                self.other(word, rest, line)
        except (DrillingCycleError, FrameError, ValueError) as problem:
            if line != len(self.source.lines) or self.source.complete or self.ended:
                raise self.source.build_error(f"{word[:20]}: {problem}", line) from problem
            self.out.incomplete_reason = f"line {line}: the last line is cut off and was left out ({problem})"
            self.out.ignore("cut-off last line", line, understood=False, stops=False)

    def finish(self, last_line: int) -> Toolpath:
        if self.curves.spline_open:
            self.end_spline(last_line)
        if self.curves.pending is not None:
            self.out.warn("an arc is not followed by its end point (GOTO) and was left out", self.curves.pending.line)
            self.out.ignore("CIRCLE without GOTO", self.curves.pending.line, understood=False)
        if not self.ended and self.out.incomplete_reason is None:
            self.out.incomplete_reason = "no FINI, END or END-OF-PATH at the end" + (
                "" if self.source.complete else " and the last line does not end: its last number may be cut off"
            )
        if self.first_frame is not None:
            self.out.meta["frame"] = str(self.first_frame)
        self.out.meta["dialect"] = self.dialect.value
        return self.out.build()

    # ---- feeds and cycles

    def feed_rate(self, word: str, rest: str, line: int) -> None:
        parts = split_fields(rest)
        timed = next((p for p in parts if p in NO_SPEED), None)
        if timed:
            raise ValueError(f"{timed} is no speed of the tool tip; expected one per minute or revolution, e.g. MMPM")
        unit = next((p for p in parts if p in FEED_UNITS), None)
        values = [v for p in parts if (v := parse_number(p)) is not None]
        if len(values) > 1:
            raise ValueError(f"{len(values)} numbers; expected one, e.g. FEDRAT/600,MMPM")
        value = values[0] if values else None
        strange = [p for p in parts if p and p not in FEED_UNITS and parse_number(p) is None]
        for p in strange:
            self.out.ignore(f"FEDRAT/{p}", line, understood=p in harmless_words.APT_FEDRAT)
        if value is None:
            if strange:
                return
            raise ValueError("no number; expected e.g. FEDRAT/600,MMPM")
        self.feed, self.per_revolution = self.feed_in_mm(value, unit, line)

    def feed_in_mm(self, value: float, unit: str | None, line: int) -> tuple[float, bool]:
        """A feed in mm/min or mm per revolution, and which of both it is; NaN where ``--feed`` replaces it.

        Raises:
            InputError: it names no unit and is as small as feeds per revolution are.
        """
        scale, per_revolution = FEED_UNITS[unit] if unit else (None, False)
        feed = value * (self.scale if scale is None else scale)
        if unit is None and 0.0 < feed < SLOWEST_PER_MINUTE:
            if self.options.default_feed is None:
                raise self.source.build_option_question(
                    "feed",
                    f"the feed {value:g} names no unit: per minute it is slower than any cut, per revolution the file "
                    "does not state it. Expected MMPM or MMPR (IPM or IPR) behind it, or the feed of these cuts with "
                    "--feed MM_MIN",
                    line,
                )
            self.out.used_options.add("--feed")
            self.out.warn_once("feeds without a unit that look like feeds per revolution take the given feed", line)
            feed = math.nan
        return feed, per_revolution

    def spindle(self, word: str, rest: str, line: int) -> None:
        parts = split_fields(rest)
        value = next((v for p in parts if (v := parse_number(p)) is not None), None)
        surface = any(p in ("SFM", "SMM", "SFPM", "SMPM") for p in parts)
        if value is not None:
            self.rpm = math.nan if surface else value
        elif parts and parts[0] in ("ON", "CLW", "CCLW"):
            value = self.rpm  # starts again at the speed before
        text = f"SPINDL/{rest}"
        if self.dialect is CamDialect.HSM and parts[:1] in (
            ["ON"],
            ["OFF"],
        ):  # its post writes them the wrong way round
            value = 0.0 if parts[0] == "ON" else self.rpm
            text = f"spindle {'off' if parts[0] == 'ON' else 'on'} ({text} of HSM/Fusion)"
        self.out.event("spindle", text, math.nan if value is None or surface else value)

    def cycle_word(self, word: str, rest: str, line: int) -> None:
        parts = split_fields(rest)
        if not parts or parts[0] in ("OFF", "NOMORE"):
            self.cycle = None
            return
        if parts[0] == "CLEAR":
            self.cycle = self.last_cycle = None
            self.out.ignore("CYCLE/CLEAR", line, understood=True)
            return
        if parts[0] == "INIT":
            self.out.ignore("CYCLE/INIT", line, understood=True)
            return
        if parts[0] == "ON":
            self.cycle = self.last_cycle
            return
        words = parse_cycle(parts, self.options.cycle_order)
        self.back_to = None
        if words.loose:
            self.out.used_options.add("--cycle-order")
        for strange in words.unknown:
            self.out.ignore(f"CYCLE/{words.name},{strange}", line, understood=False)
        if words.feed is not None:
            feed, per_revolution = self.feed_in_mm(words.feed, words.feed_word, line)
        else:
            feed, per_revolution = self.feed, self.per_revolution
        if per_revolution:
            feed *= self.rpm
        if words.deep and not (words.first_peck or words.next_peck):
            self.out.warn(f"CYCLE/{words.name} gives no peck depth: one stroke", line)
        if self.dialect is CamDialect.HSM:
            self.out.warn_once(
                "CYCLE of HSM/Fusion: GOTO is read as the bottom of the hole, the clearance as a height of the section"
            )
            self.cycle = self.last_cycle = HsmDrillingCycle(words, self.scale, feed)
        else:
            self.cycle = self.last_cycle = build_drilling_cycle(
                words, signed_depth=self.dialect is CamDialect.NX, scale=self.scale, feed=feed
            )

    # ---- coordinate systems

    def comment(self, rest: str, line: int) -> None:
        if self.catia_rows is not None:
            values = try_parse_numbers(rest)
            if values is not None and len(values) == _ROW:
                self.catia_rows.append(values)
                if len(self.catia_rows) == 3:
                    m = np.array(self.catia_rows)
                    self.catia_rows = None
                    self.use_frame(CoordinateSystem(m[:, :3], m[:, 3] * self.scale), line)
                return
            if self.catia_rows:
                self.out.warn("the CATIA axis system has fewer than three rows", line)
                self.catia_rows = None
        if rest.upper().startswith("*CATIA"):
            self.catia_rows = []
            return
        found = _OPERATION_COMMENT.match(rest)
        if found:
            self.out.begin_operation(found.group(1), tool=self.tool)
        self.out.ignore("$$ comment", line, understood=True)

    def tool_axis(self, word: str, rest: str, line: int) -> None:
        values = parse_numbers(rest)
        if len(values) != 3:
            raise ValueError(f"{len(values)} numbers; expected i, j, k")
        if self.dialect is CamDialect.CLT:
            self.out.ignore("TLAXIS", line, understood=True)  # of the part; the points are in the tool's system
        else:
            self.axis = (values[0], values[1], values[2])

    def other(self, word: str, rest: str, line: int) -> None:
        if word in REFUSED:
            raise self.source.build_error(f"{word}/ is not supported: {REFUSED[word]}", line)
        if re.fullmatch(r"CYCLE[0-9]+", word):
            raise self.source.build_error(
                f"{word} is a control's drilling cycle without a meaning in CL data; expected CYCLE/DRILL,…", line
            )
        if word in ("FINI", "END", "END-OF-PATH"):
            if self.curves.spline_open:
                self.end_spline(line)
            self.ended = True
            if word == "END-OF-PATH":
                self.cycle = None
        if self.curves.spline_open and word != "PAINT":
            self.end_spline(line)
        self.out.ignore(word, line, understood=word in harmless_words.APT)
