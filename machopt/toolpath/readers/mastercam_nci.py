"""Reader of Mastercam NCI files: two lines per record, a record code and its numbers.

Supported codes: 0 and 1 (rapid, feed), 2 and 3 (arcs), 11 (five axes), 1000 … 1003 (tools, end), 1014 (tool plane) and
comments. The order of the numbers of arcs and five-axis records differs between versions. The order that fits every
record of the file is used: equal radii, unit tool vectors. Drilling records (81 and above) are refused.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.file_formats.plain_decimals import parse_plain_decimal
from machopt.file_formats.source_file import UNIT_NAMES, ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError, compute_arc_chords
from machopt.path_building.arc_radius_check import check_radius
from machopt.path_building.coordinate_systems import CoordinateSystem, FrameError, SystemTransform
from machopt.path_building.point_collector import PathBuilder, Vector
from machopt.toolpath.readers import harmless_words

_COMMENTS = {1005, 1006, 1007, 1008, 1025, 1026}
_DRILLING = range(81, 201)
_MOTION = (0, 1, 2, 3, 11)  # records that consist of numbers only
_ARC_LAYOUTS = {  # places of (plane, end, centre, feed)
    "cc plane end centre": (1, 2, 5, 8),
    "cc end centre plane": (7, 1, 4, 8),
    "plane end centre": (0, 1, 4, 7),
}
_AXIS_LAYOUTS = {  # places of (tip, vector, feed), and whether the vector is a second point
    "cc tip vector": (1, 4, 7, False),
    "tip vector": (0, 3, 6, False),
    "cc tip point": (1, 4, 7, True),
    "tip point": (0, 3, 6, True),
}
_COMPENSATION = (0.0, 40.0, 41.0, 42.0, 140.0)
_UNIT_VECTOR = 2e-3
_SAME_RADIUS = 2e-3  # of the radius, and of a unit


@dataclass(frozen=True)
class _NciRecord:
    code: int
    line: int
    text: str
    values: list[float]


def read_nci(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read an NCI file, which does not give its unit.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    return _NciReader(source, options).run()


class _NciReader:
    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        self.source = source
        self.out = PathBuilder(source=source, options=options, format="nci")
        if options.unit is None:
            raise source.build_option_question(
                "unit", "is Mastercam NCI, which does not state its unit; give --unit mm or --unit inch"
            )
        self.scale = UNIT_NAMES[options.unit]
        self.out.meta.update(unit=options.unit, unit_from="option")
        self.tolerance = options.arc_tolerance * 1e3
        self.position: Vector | None = None  # mm, tool plane
        self.axis: Vector = (0.0, 0.0, 1.0)  # tool plane
        self.feed = math.nan
        self.plane: SystemTransform | None = None
        self.first_plane: CoordinateSystem | None = None
        self.ended = False

    def run(self) -> Toolpath:
        records = self.records()
        self.arc_layout = self.layout_of_arcs(records)
        self.axis_layout = self.layout_of_axes(records)
        for record in records:
            if self.ended:
                self.out.ignore("records after the end", record.line, understood=False, stops=False)
                continue
            try:
                self.record(record)
            except (ArcError, FrameError) as problem:
                raise self.source.build_error(str(problem), record.line) from problem
        if not self.ended:
            self.out.incomplete_reason = "no record 1003 (end of the program)"
        return self.out.build()

    def records(self) -> list[_NciRecord]:
        found: list[_NciRecord] = []
        lines = self.source.lines
        at = 0
        while at < len(lines):
            head = lines[at].strip()
            if not head:
                at += 1
                continue
            if not re.fullmatch(r"[0-9]{1,5}", head):
                raise self.source.build_error(f"found {head[:30]!r}; expected the number of an NCI record", at + 1)
            if at + 1 >= len(lines):
                self.out.incomplete_reason = f"record {head} in the last line has no numbers"
                break
            text = lines[at + 1].strip()
            values = _parse_numbers(text) if int(head) < 1000 else []
            if int(head) in _MOTION and len(values) < len(text.split()):
                raise self.source.build_error(
                    f"found {text.split()[len(values)][:30]!r} in record {head}; expected finite decimal numbers",
                    at + 2,
                )
            found.append(_NciRecord(int(head), at + 1, text, values))
            at += 2
        return found

    def record(self, r: _NciRecord) -> None:
        if r.code in (0, 1):
            self.straight(r)
        elif r.code in (2, 3):
            self.arc(r)
        elif r.code == 11:
            self.five_axes(r)
        elif r.code == 4:
            self.out.event("dwell", f"NCI 4: {r.text}")
        elif r.code in (1000, 1001, 1002):
            self.tool(r)
        elif r.code == 1003:
            self.ended = True
        elif r.code == 1014:
            self.tool_plane(r)
        elif r.code in _COMMENTS:
            if r.code == 1008:
                self.out.begin_operation(r.text)
            else:
                self.out.event("comment", r.text)
        elif r.code in _DRILLING:
            raise self.source.build_error(
                f"record {r.code} is a drilling cycle, whose heights are not documented well enough to be read; let "
                "Mastercam write drilling as single moves, or post G-code or APT",
                r.line,
            )
        else:
            known = r.code in harmless_words.NCI or r.code >= 10_000
            self.out.ignore("parameters (10000 …)" if r.code >= 10_000 else str(r.code), r.line, understood=known)

    # ---- motion

    def take_feed(self, values: list[float], place: int) -> bool:
        """Use the record's feed: −1 unchanged, −2 rapid. True for rapid."""
        feed = values[place] if place < len(values) else -1.0
        if feed == -2.0:
            return True
        if feed > 0.0:
            self.feed = feed * self.scale
        return False

    def straight(self, r: _NciRecord) -> None:
        if len(r.values) < 5:
            raise self.source.build_error(f"{len(r.values)} numbers; expected compensation, x, y, z, feed", r.line)
        if r.values[0] in (41.0, 42.0):
            self.out.warn_once("cutter compensation is not carried out: the points are as written", r.line)
        rapid = self.take_feed(r.values, 4) or r.code == 0
        self.go(self.point(r.values, 1), (0.0, 0.0, 1.0), rapid, r.line)

    def point(self, values: list[float], at: int) -> Vector:
        return values[at] * self.scale, values[at + 1] * self.scale, values[at + 2] * self.scale

    def go(self, to: Vector, axis: Vector, rapid: bool, line: int) -> None:
        self.position, self.axis = to, axis
        if self.plane is not None:
            to, axis = self.plane.point(to), self.plane.direction(axis)
        self.out.add(to, axis, MoveKind.RAPID if rapid else MoveKind.CUT, math.nan if rapid else self.feed, line)

    def arc(self, r: _NciRecord) -> None:
        plane, end, centre, feed = _ARC_LAYOUTS[self.arc_layout]
        if self.position is None:
            raise ArcError("an arc before any point")
        needed = max(plane + 1, end + 3, centre + 3)
        if len(r.values) < needed:
            raise ArcError(f"an arc of {len(r.values)} numbers; expected {needed} as in the other arcs")
        if r.values[plane] != 0.0:
            raise ArcError(f"an arc in plane {r.values[plane]:g}; only those in XY (0) are read")
        self.take_feed(r.values, feed)
        to = self.point(r.values, end)
        normal = np.array([0.0, 0.0, 1.0 if r.code == 3 else -1.0])
        found = compute_arc_chords(
            np.array(self.position), np.array(to), np.array(self.point(r.values, centre)), normal, self.tolerance
        )
        check_radius(found, r.line, self.out)
        points, axis = found.points, (0.0, 0.0, 1.0)
        self.position = to
        if self.plane is not None:
            points, axis = self.plane.points(points), self.plane.direction(axis)
        self.out.add_arc(points, axis, MoveKind.CUT, self.feed, r.line)

    def five_axes(self, r: _NciRecord) -> None:
        tip, vector, feed, is_point = _AXIS_LAYOUTS[self.axis_layout]
        rapid = self.take_feed(r.values, feed)
        at = np.array(r.values[tip : tip + 3])
        axis = np.array(r.values[vector : vector + 3]) - (at if is_point else 0.0)
        i, j, k = (axis / np.linalg.norm(axis)).tolist()
        self.go(self.point(r.values, tip), (i, j, k), rapid, r.line)

    # ---- layouts

    def layout_of_arcs(self, records: list[_NciRecord]) -> str:
        """The order of an arc's numbers for which every arc has one radius."""
        arcs: list[tuple[list[float], list[float], int]] = []
        before: list[float] | None = None
        for r in records:
            if r.code in (2, 3) and before is not None:
                arcs.append((before, r.values, r.line))
                before = None  # the end is not known yet
            elif r.code in (0, 1) and len(r.values) >= 4:
                before = r.values[1:4]
        if not any(r.code in (2, 3) for r in records):
            return next(iter(_ARC_LAYOUTS))
        fitting = [name for name in _ARC_LAYOUTS if arcs and all(_has_equal_radii(name, a, v) for a, v, _ in arcs)]
        if len(fitting) != 1:
            line = next(r.line for r in records if r.code in (2, 3))
            raise self.source.build_error(
                "the numbers of the arcs (records 2 and 3) are in an order that is not known; let Mastercam break arcs "
                "into lines, or post G-code or APT",
                line,
            )
        return fitting[0]

    def layout_of_axes(self, records: list[_NciRecord]) -> str:
        """The order of a five-axis record's numbers for which every tool vector is of one length."""
        rows = [r for r in records if r.code == 11]
        if not rows:
            return next(iter(_AXIS_LAYOUTS))
        values = [r.values for r in rows]
        fitting = [name for name in _AXIS_LAYOUTS if not _AXIS_LAYOUTS[name][3] and _has_unit_length(name, values)]
        if not fitting and len(rows) > 1:  # one record alone always has one length
            fitting = [name for name in _AXIS_LAYOUTS if _AXIS_LAYOUTS[name][3] and _has_unit_length(name, values)]
        if len(fitting) != 1:
            raise self.source.build_error(
                "the numbers of the five-axis records (11) are in an order that is not known: none has tool vectors of "
                "one length; post G-code with tool vectors or APT",
                rows[0].line,
            )
        return fitting[0]

    # ---- tools and planes

    def tool(self, r: _NciRecord) -> None:
        values = _parse_numbers(r.text)
        if r.code != 1000 and len(values) > 3:
            self.out.event("tool", f"NCI {r.code}: tool {values[3]:g}", values[3])
            self.out.change_tool(f"{values[3]:g}")
        self.out.ignore(str(r.code), r.line, understood=True)

    def tool_plane(self, r: _NciRecord) -> None:
        """Rows are the tool plane's axes in the part; points are in it."""
        values = _parse_numbers(r.text)
        if len(values) < 9:
            raise FrameError(f"record 1014 with {len(values)} numbers; expected a matrix of 9")
        R = np.array(values[:9]).reshape(3, 3).T
        origin = np.array(values[9:12]) * self.scale if len(values) >= 12 else np.zeros(3)
        frame = CoordinateSystem(R, origin)
        if self.first_plane is None or not len(self.out):
            self.first_plane = frame
            return
        self.plane = None if frame.same_as(self.first_plane) else SystemTransform.between(self.first_plane, frame)
        if self.plane is not None:
            self.out.warn_once("the tool plane changes: points from here on are brought into the first one", r.line)


def _parse_numbers(text: str) -> list[float]:
    found: list[float] = []
    for part in text.split():
        try:
            found.append(parse_plain_decimal(part))
        except ValueError:
            break
    return found


def _has_equal_radii(layout: str, before: list[float], values: list[float]) -> bool:
    plane, end, centre, _ = _ARC_LAYOUTS[layout]
    if len(values) < max(plane, end + 2, centre + 2) + 1 or values[plane] not in (0.0, 1.0, 2.0):
        return False
    if layout.startswith("cc") and values[0] not in _COMPENSATION:
        return False
    flat = {0: [0, 1], 1: [1, 2], 2: [0, 2]}[round(values[plane])]
    c = np.array(values[centre : centre + 3])[flat]
    r0 = float(np.linalg.norm(np.array(before)[flat] - c))
    r1 = float(np.linalg.norm(np.array(values[end : end + 3])[flat] - c))
    return r0 > 1e-6 and abs(r0 - r1) <= _SAME_RADIUS * max(r0, 1.0)


def _has_unit_length(layout: str, rows: list[list[float]]) -> bool:
    tip, vector, _, is_point = _AXIS_LAYOUTS[layout]
    if any(len(v) < vector + 3 or (tip == 1 and v[0] not in _COMPENSATION) for v in rows):
        return False
    table = np.array([v[: vector + 3] for v in rows])
    axes: Array = table[:, vector:] - (table[:, tip : tip + 3] if is_point else 0.0)
    length = np.linalg.norm(axes, axis=1)
    wanted = float(np.median(length)) if is_point else 1.0
    return wanted > 1e-6 and bool((np.abs(length - wanted) <= _UNIT_VECTOR * wanted).all())
