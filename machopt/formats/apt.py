"""APT / cutter location readers: NX CLSF, CATIA aptsource, CAMWorks APT and CLT, HSM/Fusion and plain APT.

One statement reader serves them all; what differs is kept in :class:`Dialect`. Coordinates stay in the system
they are printed in, which is ``workpiece``; where a file changes it, later points are brought into the first one.
"""

from __future__ import annotations

import enum
import math
import re

import numpy as np

from machopt.domain.toolpath import Array, Move, Toolpath
from machopt.formats.apt_curves import Curves
from machopt.formats.apt_cycles import FEED_UNITS, hole_cycle, parse_cycle
from machopt.formats.apt_tokens import COMMENT, fields, leading_numbers, number, statements
from machopt.formats.apt_words import NO_EFFECT, REFUSED
from machopt.formats.frames import Frame, FrameError, Transfer
from machopt.formats.holecycle import CycleError, HoleCycle, drill
from machopt.formats.pathbuilder import PathBuilder, Vector
from machopt.formats.source import MM_PER_INCH, ReadOptions, Source

_OPERATION_COMMENT = re.compile(r"\s*(?:OPERATION(?: NAME)?|OPNAME)\s*[:=]\s*(.+)", re.IGNORECASE)
_ROW = 4  # numbers in one line of a CATIA matrix


class Dialect(enum.Enum):
    """CAM system that wrote the file; the value is the format's name."""

    NX = "apt/nx"
    CATIA = "apt/catia"
    CAMWORKS = "apt/camworks"
    CLT = "apt/camworks-clt"
    GENERIC = "apt"


def sniff_dialect(source: Source) -> Dialect:
    """Which CAM system's words the first lines hold."""
    head = "\n".join(source.lines[:400]).upper()
    if "TOOL PATH/" in head or "TLDATA/" in head or "MSYS/" in head:
        return Dialect.NX
    if "*CATIA" in head or "CATIA APT" in head or "TLON,GOFWD" in head:
        return Dialect.CATIA
    if "OPFEATSTART/" in head or "ROTABL/" in head:
        return Dialect.CLT
    if "CSI_SET_" in head or ("CSYS/" in head and "TRNTYP/" in head):
        return Dialect.CAMWORKS
    return Dialect.GENERIC


def read_apt(source: Source, options: ReadOptions) -> Toolpath:
    """Read a cutter location file.

    Raises:
        InputError: see :func:`machopt.formats.toolpath.read_toolpath`.
    """
    return _Reader(source, options).run()


class _Reader:
    def __init__(self, source: Source, options: ReadOptions) -> None:
        self.source = source
        self.dialect = sniff_dialect(source)
        self.out = PathBuilder(source, options, self.dialect.value)
        self.scale = _unit_scale(source, options, self.out)
        self.curves = Curves(self.dialect is Dialect.NX, options.arc_tolerance * 1e3)
        self.position: Vector | None = None  # mm, in the present system
        self.axis: Vector = (0.0, 0.0, 1.0)
        self.rapid = False  # holds for the next motion only
        self.feed, self.per_revolution = math.nan, False
        self.rpm = math.nan
        self.cycle: HoleCycle | None = None
        self.last_cycle: HoleCycle | None = None
        self.first_frame: Frame | None = None
        self.transfer: Transfer | None = None
        self.catia_rows: list[list[float]] | None = None
        self.tool, self.tool_text, self.count = "", "", 0
        self.rotations: dict[str, float] = {}
        self.cut_rotation: dict[str, float] | None = None
        self.ended = False

    def run(self) -> Toolpath:
        handlers = {
            "FROM": self.go_from, "GOHOME": self.go_home, "GODLTA": self.go_delta, "RAPID": self.rapid_next,
            "FEDRAT": self.feed_rate, "SPINDL": self.spindle, "COOLNT": self.coolant, "CUTCOM": self.compensation,
            "CYCLE": self.cycle_word, "MSYS": self.msys, "CSYS": self.csys, "TOOL PATH": self.tool_path,
            "OPFEATSTART": self.feature, "LOADTL": self.load_tool, "LOAD": self.load, "INSERT": self.insert,
            "TLAXIS": self.tool_axis, "DELAY": self.delay, "STOP": self.stop, "OPSTOP": self.stop,
            "SET": self.set_mode, "PPRINT": self.remark, "MSG": self.remark, "ROTABL": self.rotate_table,
            "CIRCLE": self.circle, "MOVARC": self.circle, "INDIRV": self.circle, "TLON": self.drive,
            "NURBS": self.spline, "KNOT": self.spline, "CNTRL": self.spline,
        }  # fmt: skip
        last_line = len(self.source.lines)
        for line, word, rest in statements(self.source):
            if self.ended and word not in (COMMENT, "TOOL PATH", "FINI"):
                self.out.ignore("text after the end", line, understood=False)
                continue
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
            except (CycleError, FrameError, ValueError) as problem:
                if line == last_line and not self.source.complete and not self.ended:
                    self.out.warn(f"the last line is cut off and was left out ({problem})", line)
                    self.out.ignore("cut-off last line", line, understood=False)
                    continue
                raise self.source.error(f"{word[:20]}: {problem}", line) from problem
        return self.finish(last_line)

    def finish(self, last_line: int) -> Toolpath:
        if self.curves.spline_open:
            self.end_spline(last_line)
        if self.curves.pending is not None:
            self.out.warn("an arc is not followed by its end point (GOTO) and was left out", self.curves.pending.line)
            self.out.ignore("CIRCLE without GOTO", self.curves.pending.line, understood=False)
        if not self.ended:
            self.out.warn("no FINI, END or END-OF-PATH at the end: the file may be cut off", last_line)
        if self.first_frame is not None:
            self.out.meta["frame"] = str(self.first_frame)
        self.out.meta["dialect"] = self.dialect.value
        return self.out.build()

    # ---- motion

    def goto(self, rest: str, line: int) -> None:
        try:
            values = [float(v) for v in rest.split(",")]
        except ValueError:
            values = _numbers(rest)
        count = len(values)
        if count not in (3, 6):
            raise ValueError(f"{count} numbers; expected x, y, z or x, y, z, i, j, k")
        if not math.isfinite(sum(values)):
            raise ValueError("a number is not finite")
        s = self.scale
        to: Vector = (values[0] * s, values[1] * s, values[2] * s)
        axis = self.axis if count == 3 else (values[3], values[4], values[5])
        if self.curves.spline_open:
            self.end_spline(line)
        if self.cycle is not None:
            if axis != self.axis:
                self.position = None  # sideways at one height has no meaning when the axis turns
            self.axis = axis
            self.drill(to, line)
            return
        if self.curves.pending is not None:
            if self.position is None:
                raise ValueError("an arc ends here but its start is not known; expected a GOTO before CIRCLE")
            curve = self.curves.arc_to(np.array(self.position), np.array(to), self.out)
            self.add_curve(curve, axis, line)
            self.position = to
            return
        self.move_to(to, axis, line)

    def move_to(self, to: Vector, axis: Vector, line: int, *, rapid: bool = False) -> None:
        self.position, self.axis = to, axis
        if self.transfer is not None:
            to, axis = self.transfer.point(to), self.transfer.direction(axis)
        if self.rapid or rapid:
            self.rapid = False
            self.out.add(to, axis, Move.RAPID, math.nan, line)
        else:
            self.out.add(to, axis, Move.CUT, self.feed_mm_min(), line)
            self.check_rotation(line)

    def add_curve(self, points: Array, axis: Vector, line: int) -> None:
        before = self.axis
        self.axis = axis
        if self.transfer is not None:
            points = self.transfer.points(points)
            before, axis = self.transfer.direction(before), self.transfer.direction(axis)
        if self.rapid:
            self.rapid = False
            self.out.add_arc(points, axis, Move.RAPID, math.nan, line, axis_before=before)
        else:
            self.out.add_arc(points, axis, Move.CUT, self.feed_mm_min(), line, axis_before=before)
            self.check_rotation(line)

    def drill(self, hole: Vector, line: int) -> None:
        assert self.cycle is not None
        self.rapid = False
        axis, before = self.axis, self.position
        if self.transfer is not None:
            turned = self.transfer.direction(axis)
            start = None if before is None else self.transfer.point(before)
            drill(self.out, self.cycle, self.transfer.point(hole), turned, line, start)
        else:
            drill(self.out, self.cycle, hole, axis, line, before)
        top = self.cycle.retract if not self.cycle.feed_out else max(self.cycle.retract, self.cycle.clear)
        n = np.array(axis) / max(float(np.linalg.norm(axis)), 1e-12)
        x, y, z = (np.array(hole) + top * n).tolist()
        self.position = (x, y, z)
        self.check_rotation(line)

    def feed_mm_min(self) -> float:
        return self.feed * self.rpm if self.per_revolution else self.feed

    def go_from(self, word: str, rest: str, line: int) -> None:
        values, after = leading_numbers(fields(rest))
        if len(values) not in (3, 6) or after:
            raise ValueError("expected x, y, z or x, y, z, i, j, k")
        axis = self.axis if len(values) == 3 else (values[3], values[4], values[5])
        s = self.scale
        self.move_to((values[0] * s, values[1] * s, values[2] * s), axis, line, rapid=True)

    def go_home(self, word: str, rest: str, line: int) -> None:
        if len(leading_numbers(fields(rest))[0]) >= 3:
            self.go_from(word, rest, line)
        else:
            self.out.ignore("GOHOME without coordinates", line, understood=True)

    def go_delta(self, word: str, rest: str, line: int) -> None:
        values = [v * self.scale for v in _numbers(rest)]
        if self.position is None or len(values) not in (1, 3):
            raise ValueError("expected dx, dy, dz or a distance along the tool axis, after a first GOTO")
        step = np.array(values) if len(values) == 3 else values[0] * np.array(self.axis)
        x, y, z = (np.array(self.position) + step).tolist()
        self.move_to((x, y, z), self.axis, line)

    def rapid_next(self, word: str, rest: str, line: int) -> None:
        self.rapid = True

    # ---- curves

    def circle(self, word: str, rest: str, line: int) -> None:
        if self.cycle is not None and word != "INDIRV":
            raise ValueError("stands inside a drilling cycle; expected CYCLE/OFF before it")
        if word == "INDIRV":
            self.curves.tangent = _numbers(rest)
        else:
            self.curves.begin(word, fields(rest), line, self.scale)

    def drive(self, word: str, rest: str, line: int) -> None:
        if self.position is None:
            raise ValueError("an arc starts here but no point is known; expected a GOTO before it")
        points = self.curves.drive(rest, np.array(self.position), self.scale, line, self.out)
        self.add_curve(points, self.axis, line)
        self.position = tuple(points[-1].tolist())

    def spline(self, word: str, rest: str, line: int) -> None:
        if word == "NURBS":
            if self.curves.spline_open:
                self.end_spline(line)
            self.curves.spline_open = True
        elif not self.curves.spline_open:
            raise ValueError("stands outside of a NURBS")
        elif word == "KNOT":
            self.curves.knots.extend(_numbers(rest))
        else:
            values = _numbers(rest)
            if len(values) != 3:
                raise ValueError(f"{len(values)} numbers; expected x, y, z")
            self.curves.control.append([v * self.scale for v in values])

    def end_spline(self, line: int) -> None:
        if self.position is None:
            raise self.source.error("a NURBS without a point before it; expected a GOTO first", line)
        try:
            points = self.curves.spline(np.array(self.position))
        except ValueError as problem:
            raise self.source.error(f"NURBS that ends before this line: {problem}", line) from problem
        self.add_curve(points, self.axis, line - 1)
        self.position = tuple(points[-1].tolist())

    # ---- feeds and cycles

    def feed_rate(self, word: str, rest: str, line: int) -> None:
        parts = fields(rest)
        unit = next((p for p in parts if p in FEED_UNITS), None)
        value = next((v for p in parts if (v := number(p)) is not None), None)
        strange = [p for p in parts if p and p not in FEED_UNITS and number(p) is None]
        for p in strange:
            self.out.ignore(f"FEDRAT/{p}", line, understood=p in ("LOCK", "ON", "OFF"))
        if value is None:
            if strange:
                return
            raise ValueError("no number; expected e.g. FEDRAT/600,MMPM")
        self.feed, self.per_revolution = self.feed_in_mm(value, unit)

    def feed_in_mm(self, value: float, unit: str | None) -> tuple[float, bool]:
        scale, per_revolution = FEED_UNITS[unit] if unit else (None, False)
        return value * (self.scale if scale is None else scale), per_revolution

    def spindle(self, word: str, rest: str, line: int) -> None:
        parts = fields(rest)
        value = next((v for p in parts if (v := number(p)) is not None), None)
        surface = any(p in ("SFM", "SMM", "SFPM", "SMPM") for p in parts)
        if value is not None:
            self.rpm = math.nan if surface else value
        self.out.event("spindle", f"SPINDL/{rest}", math.nan if value is None or surface else value)

    def cycle_word(self, word: str, rest: str, line: int) -> None:
        parts = fields(rest)
        if not parts or parts[0] in ("OFF", "NOMORE"):
            self.cycle = None
            return
        if parts[0] in ("INIT",):
            return
        if parts[0] == "ON":
            self.cycle = self.last_cycle
            return
        words = parse_cycle(parts)
        for strange in words.unknown:
            self.out.ignore(f"CYCLE/{words.name},{strange}", line, understood=False)
        if words.feed is not None:
            feed, per_revolution = self.feed_in_mm(words.feed, words.feed_word)
        else:
            feed, per_revolution = self.feed, self.per_revolution
        if per_revolution:
            feed *= self.rpm
        if words.deep and not (words.first_peck or words.next_peck):
            self.out.warn(f"CYCLE/{words.name} gives no peck depth: one stroke", line)
        self.cycle = self.last_cycle = hole_cycle(
            words, signed_depth=self.dialect is Dialect.NX, scale=self.scale, feed=feed
        )

    # ---- coordinate systems

    def msys(self, word: str, rest: str, line: int) -> None:
        v = _numbers(rest)
        if len(v) != 9:
            raise ValueError(f"{len(v)} numbers; expected origin, x axis and y axis (9)")
        x, y = np.array(v[3:6]), np.array(v[6:9])
        self.use_frame(Frame(np.column_stack([x, y, np.cross(x, y)]), np.array(v[:3]) * self.scale), line)

    def csys(self, word: str, rest: str, line: int) -> None:
        v = _numbers(rest)
        if len(v) != 12:
            raise ValueError(f"{len(v)} numbers; expected three rows of four (12)")
        m = np.array(v).reshape(3, 4)
        self.count += 1
        if self.dialect is Dialect.CAMWORKS:
            if self.cycle is not None:
                self.out.warn("the cycle before has no CYCLE/OFF; the new operation ends it", line)
                self.cycle = None
            self.out.begin_operation(f"{self.count} {self.tool_text}".strip(), tool=self.tool)
        self.use_frame(Frame(m[:, :3], m[:, 3] * self.scale), line)

    def use_frame(self, frame: Frame, line: int) -> None:
        if self.first_frame is None or (not len(self.out) and self.transfer is None):
            self.first_frame = frame
            return
        before = self.transfer
        self.transfer = None if frame.same_as(self.first_frame) else Transfer.between(self.first_frame, frame)
        if self.transfer is not None:
            self.out.warn_once(
                "the coordinate system changes: points from here on are brought into the first one", line
            )
        if self.transfer is not before:
            self.position = None

    def comment(self, rest: str, line: int) -> None:
        if self.catia_rows is not None:
            values = _numbers_or_none(rest)
            if values is not None and len(values) == _ROW:
                self.catia_rows.append(values)
                if len(self.catia_rows) == 3:
                    m = np.array(self.catia_rows)
                    self.catia_rows = None
                    self.use_frame(Frame(m[:, :3], m[:, 3] * self.scale), line)
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

    def rotate_table(self, word: str, rest: str, line: int) -> None:
        parts = fields(rest)
        angle = number(parts[0]) if parts else None
        name = next((p for p in parts if p.endswith("AXIS")), None)
        if angle is None or name is None:
            raise ValueError("expected angle, axis")
        self.rotations[name] = round(self.rotations.get(name, 0.0) + angle, 6)
        self.out.ignore("ROTABL", line, understood=True)

    def check_rotation(self, line: int) -> None:
        """CLT: coordinates are those of the turned table; one position only can be ``workpiece``."""
        if not self.rotations and self.cut_rotation is None:
            return
        now = {k: v for k, v in self.rotations.items() if v != 0.0}
        if self.cut_rotation is None:
            self.cut_rotation = now
            if now:
                angles = ", ".join(f"{k} {math.degrees(v):g}°" for k, v in sorted(now.items()))
                self.out.warn(f"coordinates are taken as those of the part with the table at {angles}", line)
                self.out.meta["table"] = angles
        elif now != self.cut_rotation:
            raise self.source.error(
                "the table stands differently than for the cuts before; expected one table position in a file: "
                "export one file for each",
                line,
            )

    def tool_axis(self, word: str, rest: str, line: int) -> None:
        values = _numbers(rest)
        if len(values) != 3:
            raise ValueError(f"{len(values)} numbers; expected i, j, k")
        if self.dialect is Dialect.CLT:
            self.out.ignore("TLAXIS", line, understood=True)  # of the part; the points are in the tool's system
        else:
            self.axis = (values[0], values[1], values[2])

    # ---- operations, tools, events

    def tool_path(self, word: str, rest: str, line: int) -> None:
        parts = [p.strip() for p in rest.split(",")]
        tool = parts[2] if len(parts) > 2 else ""
        self.ended = False
        self.cycle, self.rapid = None, False
        self.out.begin_operation(parts[0] or "TOOL PATH", tool=tool)

    def feature(self, word: str, rest: str, line: int) -> None:
        self.out.begin_operation(rest, tool=self.tool)

    def load_tool(self, word: str, rest: str, line: int) -> None:
        parts = fields(rest)
        value = number(parts[0]) if parts else None
        if parts and parts[0] == self.tool:
            return  # named again, not changed
        self.tool = parts[0] if parts else ""
        self.out.event("tool", f"{word}/{rest}", math.nan if value is None else value)
        if self.dialect is Dialect.GENERIC:
            self.out.begin_operation(f"tool {self.tool}", tool=self.tool)

    def load(self, word: str, rest: str, line: int) -> None:
        parts = rest.split(",")
        if parts[0].strip().upper() == "TOOL" and len(parts) > 1:
            self.load_tool("LOAD", ",".join(parts[1:]), line)
        else:
            self.out.ignore(f"LOAD/{parts[0].strip()}", line, understood=False)

    def insert(self, word: str, rest: str, line: int) -> None:
        if rest.startswith("["):
            self.tool_text = rest.partition("]")[2].strip() or rest
        self.out.event("comment", rest)

    def coolant(self, word: str, rest: str, line: int) -> None:
        self.out.event("coolant", f"COOLNT/{rest}")

    def compensation(self, word: str, rest: str, line: int) -> None:
        side = fields(rest)[:1]
        if side and side[0] in ("LEFT", "RIGHT"):
            self.out.warn_once(
                "CUTCOM is taken as wear compensation of zero: the points are the tool's, not the contour's", line
            )
        self.out.ignore("CUTCOM", line, understood=True)

    def delay(self, word: str, rest: str, line: int) -> None:
        value = number((fields(rest) or [""])[0])
        self.out.event("dwell", f"DELAY/{rest}", math.nan if value is None else value)

    def stop(self, word: str, rest: str, line: int) -> None:
        self.out.event("stop", word)

    def remark(self, word: str, rest: str, line: int) -> None:
        self.out.event("comment", rest)

    def set_mode(self, word: str, rest: str, line: int) -> None:
        if "INCR" in fields(rest):
            raise ValueError("incremental coordinates are not supported; export absolute ones")
        self.out.ignore(f"SET/{rest[:20]}", line, understood=True)

    def other(self, word: str, rest: str, line: int) -> None:
        if word in REFUSED:
            if word in ("TRANS", "ORIGIN") and not any(_numbers_or_none(rest) or [1.0]):
                self.out.ignore(word, line, understood=True)
                return
            raise self.source.error(f"{word}/ is not supported: {REFUSED[word]}", line)
        if re.fullmatch(r"CYCLE\d+", word):
            raise self.source.error(
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
        self.out.ignore(word, line, understood=word in NO_EFFECT)


def _numbers(rest: str) -> list[float]:
    values, after = leading_numbers(fields(rest))
    if after:
        raise ValueError(f"found {after[0] or 'an empty place'!r}; expected a number")
    return values


def _numbers_or_none(rest: str) -> list[float] | None:
    try:
        return _numbers(rest)
    except ValueError:
        return None


def _unit_scale(source: Source, options: ReadOptions, out: PathBuilder) -> float:
    """mm per unit of the file, from its UNITS word or its feed words, else from the option."""
    named: dict[str, int] = {}
    feeds: dict[str, int] = {}
    for line, raw in enumerate(source.lines, 1):
        text = raw.upper()
        if "UNIT" in text and (found := re.match(r"\s*(?:\$\$\s*)?UNITS?\s*[/:]\s*([A-Z]+)", text)):
            word = found.group(1)
            if word in ("MM", "CM", "M", "INCH", "INCHES", "IN", "FT", "FEET", "METRIC", "ENGLISH"):
                if word in ("CM", "M", "FT", "FEET"):
                    raise source.error(f"unit {word} is not supported; expected MM or INCHES", line)
                named.setdefault("mm" if word in ("MM", "METRIC") else "inch", line)
        if "MMP" in text and ("MMPM" in text or "MMPR" in text):
            feeds.setdefault("mm", line)
        if "IPM" in text or "IPR" in text:
            words = fields(text.partition("/")[2])
            if "IPM" in words or "IPR" in words:
                feeds.setdefault("inch", line)
    for where in (named, feeds):
        if len(where) == 2:
            raise source.error(
                f"units mm (line {where['mm']}) and inch (line {where['inch']}) are mixed; expected one of them"
            )
    unit = next(iter(named), None) or next(iter(feeds), None)
    if unit is None and "*CATIA" in "\n".join(source.lines[:200]):
        unit = "mm"  # CATIA writes aptsource in mm whatever the session shows
    out.meta["unit_from"] = "UNITS" if named else "feed words" if feeds else "option"
    if unit is None:
        if options.unit is None:
            raise source.error("says nowhere whether it is in mm or inch; give it with --unit mm or --unit inch")
        unit = options.unit
    elif options.unit is not None and options.unit != unit:
        line = (named or feeds).get(unit)
        raise source.error(f"the file is in {unit} but --unit {options.unit} was given", line)
    out.meta["unit"] = unit
    return 1.0 if unit == "mm" else MM_PER_INCH
