"""Motion statements of CL data: GOTO, arcs, splines and holes, in the first coordinate system of the file."""

from __future__ import annotations

import numpy as np

from machopt.file_formats.plain_decimals import LARGEST, is_plain
from machopt.path_building.point_collector import Vector
from machopt.toolpath.readers.apt.cam_dialect import CamDialect
from machopt.toolpath.readers.apt.statement_parser import parse_leading_numbers, parse_numbers, split_fields
from machopt.toolpath.readers.apt.tool_state import AptToolState


class AptMotionReader(AptToolState):
    """State of the tool while statements are read, and the statements that move it."""

    # ---- motion

    def goto(self, rest: str, line: int) -> None:
        """Carry out GOTO: a straight move to one point.

        Args:
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the arguments are not three or six finite numbers, or the start of an arc is not
                known.
        """
        try:
            values = [float(v) for v in rest.split(",")] if is_plain(rest) else parse_numbers(rest)
        except ValueError:
            values = parse_numbers(rest)
        count = len(values)
        if not sum(map(abs, values)) < LARGEST:
            raise ValueError("a number is not finite or absurdly large")
        width = 6 if self.multax else 3
        if self.dialect is CamDialect.CREO and count > width and count % width == 0:
            self.several(values, width, line)  # points of an arc, the last one is its end
            return
        if count not in (3, 6):
            raise ValueError(f"{count} numbers; expected x, y, z or x, y, z, i, j, k")
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

    def several(self, values: list[float], width: int, line: int) -> None:
        """Carry out a GOTO with more than one point (Creo).

        After CIRCLE only the last point is the target; the others lie on the arc.

        Args:
            values: Coordinates of all points, program units.
            width: Numbers per point.
            line: Line number in the file (1-based).
        """
        rows = [values[k : k + width] for k in range(0, len(values), width)]
        if self.curves.pending is not None:
            on_the_way = np.array(rows[:-1])[:, :3] * self.scale
            self.curves.expect(on_the_way)
            rows = rows[-1:]
        for row in rows:
            self.goto(",".join(map(repr, row)), line)

    def go_from(self, word: str, rest: str, line: int) -> None:
        """Carry out FROM: the position before the first move.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the arguments are no position.
        """
        values, after = parse_leading_numbers(split_fields(rest))
        if len(values) not in (3, 6) or after:
            raise ValueError("expected x, y, z or x, y, z, i, j, k")
        axis = self.axis if len(values) == 3 else (values[3], values[4], values[5])
        s = self.scale
        self.move_to((values[0] * s, values[1] * s, values[2] * s), axis, line, rapid=True)

    def go_home(self, word: str, rest: str, line: int) -> None:
        """Carry out GOHOME: a move to the position given, or to one that the file does not give.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the arguments are neither a position nor words.
        """
        if any(not field.isalpha() for field in split_fields(rest) if field):
            self.go_from(word, rest, line)
        else:
            self.out.ignore("GOHOME without coordinates", line, understood=True)
            self.position, self.away = None, line

    def go_delta(self, word: str, rest: str, line: int) -> None:
        """Carry out GODLTA: a move by increments.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the arguments are no increments, or the present position is not known.
        """
        values = [v * self.scale for v in parse_numbers(rest)]
        if self.position is None or len(values) not in (1, 3):
            raise ValueError("expected dx, dy, dz or a distance along the tool axis, after a first GOTO")
        step = np.array(values) if len(values) == 3 else values[0] * np.array(self.axis)
        x, y, z = (np.array(self.position) + step).tolist()
        self.move_to((x, y, z), self.axis, line)

    def rapid_next(self, word: str, rest: str, line: int) -> None:
        """Carry out RAPID: the next move is a rapid traverse.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        self.rapid = True

    # ---- curves

    def circle(self, word: str, rest: str, line: int) -> None:
        """Carry out an arc statement; the next GOTO ends the arc.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: a drilling cycle is active.
        """
        if self.cycle is not None and word != "INDIRV":
            raise ValueError("is inside a drilling cycle; expected CYCLE/OFF before it")
        if word == "INDIRV":
            self.curves.tangent = parse_numbers(rest)
        else:
            self.curves.begin(word, split_fields(rest), line, self.scale)

    def drive(self, word: str, rest: str, line: int) -> None:
        """Carry out ``TLON,GOFWD``: an arc along a drive curve (CATIA).

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the present position is not known.
        """
        if self.position is None:
            raise ValueError("an arc starts here but no point is known; expected a GOTO before it")
        points = self.curves.drive(rest, np.array(self.position), self.scale, line, self.out)
        self.add_curve(points, self.axis, line)
        self.position = tuple(points[-1].tolist())

    def spline(self, word: str, rest: str, line: int) -> None:
        """Collect one statement of a NURBS curve (NX).

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the statement is outside of a NURBS, or has not three coordinates.
        """
        if word == "NURBS":
            if self.curves.spline_open:
                self.end_spline(line)
            self.curves.spline_open = True
        elif not self.curves.spline_open:
            raise ValueError("is outside a NURBS")
        elif word == "KNOT":
            self.curves.knots.extend(parse_numbers(rest))
        else:
            values = parse_numbers(rest)
            if len(values) != 3:
                raise ValueError(f"{len(values)} numbers; expected x, y, z")
            self.curves.control.append([v * self.scale for v in values])

    def end_spline(self, line: int) -> None:
        """Add the points of the collected NURBS curve.

        Args:
            line: Line number in the file (1-based).

        Raises:
            InputError: no point precedes the curve, or its numbers describe none.
        """
        if self.position is None:
            raise self.source.build_error("a NURBS without a point before it; expected a GOTO first", line)
        try:
            points = self.curves.spline(np.array(self.position))
        except ValueError as problem:
            raise self.source.build_error(f"NURBS that ends before this line: {problem}", line) from problem
        self.add_curve(points, self.axis, line - 1)
        self.position = tuple(points[-1].tolist())
