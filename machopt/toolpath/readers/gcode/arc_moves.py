"""G-code arcs given by centre, radius, intermediate point or tangent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcChords, ArcError, compute_arc_chords
from machopt.path_building.arc_radius_check import check_radius
from machopt.path_building.point_collector import Vector
from machopt.path_building.rotary_moves import RotaryTurn
from machopt.toolpath.readers.gcode.control_state import AXES, ControlState
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourSegment
from machopt.toolpath.readers.gcode.geometry.polar_coordinates import find_plane_axes
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock

_TOUCHING = 1e-6  # mm: start and end are one place
_INCREMENT = 2.6e-3  # mm: one ten-thousandth of an inch, more than a thousandth of a millimetre
_INTERMEDIATE = ("I1", "J1", "K1")  # CIP


@dataclass(frozen=True)
class ProgrammedArc:
    """An arc whose centre is known, in programmed coordinates."""

    start: Array  # (3,) mm
    end: Array  # (3,) mm
    centre: Array  # (3,) mm
    normal: Array  # (3,) unit vector, axis of right-handed travel
    unknown: Sequence[bool] = (False, False, False)  # whether each start coordinate is unknown


class ArcMoveReader(ControlState):
    """Circular motion."""

    def arc(self, to: list[float], axis: Vector, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out G2 or G3 from the present position.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Raises:
            ArcError: the words describe no arc, or a spiral or cone.
        """
        if words.keys() & {"Q", "L"}:
            raise ArcError(
                f"an arc with {' and '.join(sorted(words.keys() & {'Q', 'L'}))} (a spiral or cone): not read"
            )
        start, end, unknown = self.arc_ends(to, b.line)
        normal = self.plane * (1.0 if self.motion == 3 else -1.0)
        radius = b.named.get("CR", words.get("R"))
        turns = self.whole_turns(words.pop("P", 1.0)) + self.full_circles(b)
        opening = self.opening_angle(words, b) if "AR" in b.named else None
        if opening is not None and not words.keys() & set("IJK"):
            centre = self.centres.by_opening(start, end, opening, normal)
        elif radius is not None:
            centre = self.centres.by_radius(start, end, radius * self.scale, normal)
        else:
            offsets = np.array([words.get(c, math.nan) for c in "IJK"]) * self.scale
            modes = [b.modes.get(c, "") for c in "IJK"]
            if np.isnan(offsets).all():
                centre = self.centres.find_default_centre(start, end, normal, b.line)
            elif any(modes):
                centre = self.centres.find_stated_centre(start, offsets, modes)
            else:
                centre = self.centres.by_offsets(start, start if opening else end, offsets, normal, b.line)
            if opening is not None:
                end = compute_arc_end(start, end, centre, opening, normal)
        arc = ProgrammedArc(start, end, centre, normal, unknown)
        self.along_arc(arc, axis, b.line, turns=turns)

    def opening_angle(self, words: dict[str, float], b: ProgramBlock) -> float:
        """Return the opening angle AR= of an arc; the block gives its end or its centre too.

        Args:
            words: Words of the block: letter or name → number.
            b: The block: its words, calls and line number.

        Returns:
            Angle, rad.

        Raises:
            ArcError: both, a radius too, or no angle between 0° and 360°.
        """
        degrees = b.named["AR"]
        if not 0.0 < degrees < 360.0:
            raise ArcError(f"AR={degrees:g}; expected an opening angle between 0 and 360 (a full circle: I, J, K)")
        in_plane = {"XYZ"[k] for k in find_plane_axes(self.plane)}
        by_end, by_centre = bool(words.keys() & in_plane), bool(words.keys() & set("IJK"))
        if by_end == by_centre or "CR" in b.named or "R" in words:
            raise ArcError("an arc by its opening angle (AR=) needs its end or its centre (I, J, K), one of the two")
        return math.radians(degrees)

    def arc_ends(self, to: list[float], line: int) -> tuple[Array, Array, list[bool]]:
        """Return the ends of an arc and the coordinates that are unknown at its start.

        A height that only the end gives is used for the whole arc.

        Args:
            to: Target position in programmed coordinates, mm.
            line: Line number in the file (1-based).

        Returns:
            Start (3,) and end (3,) in programmed mm, and whether each start coordinate is unknown.

        Raises:
            InputError: a coordinate of the plane is not known, or the height was lost and is not given.
        """
        unknown = [math.isnan(v) for v in self.p]
        if any(unknown):
            tilted = self.setup.mixes(unknown)
            needed = [AXES[k] for k in range(3) if unknown[k] and (self.plane[k] == 0.0 or tilted)]
            if needed:
                hint = "; a turning program (X and Z only) holds no milling path" if needed == ["Y"] else ""
                lost = next(
                    (
                        self.describe_unknown_position(k)
                        for k in range(3)
                        if unknown[k] and self.describe_unknown_position(k)
                    ),
                    "",
                )
                raise self.source.build_error(f"an arc starts where {''.join(needed)} is not known{hint or lost}", line)
            for k in range(3):
                if unknown[k] and math.isnan(to[k]) and self.lost[k]:
                    raise self.source.build_error(
                        f"cuts while {AXES[k]} is not known{self.describe_unknown_position(k)}", line
                    )
        known = zip(self.p, to, strict=True)
        start = np.array([(0.0 if math.isnan(b) else b) if math.isnan(a) else a for a, b in known])
        end = np.array([a if math.isnan(b) else b for a, b in zip(start.tolist(), to, strict=True)])
        return start, end, [u and math.isnan(v) for u, v in zip(unknown, to, strict=True)]

    def whole_turns(self, value: float) -> int:
        """Check the number of turns P of an arc, its last part included.

        Args:
            value: Number behind P.

        Returns:
            Number of turns.

        Raises:
            ArcError: the number is no integer from 1 to 999.
        """
        if value != round(value) or not 1.0 <= value <= 999.0:
            raise ArcError(f"an arc with P{value:g}; expected a number of turns from 1 to 999")
        return round(value)

    def full_circles(self, b: ProgramBlock) -> int:
        """Return the number of full circles before the arc (TURN=).

        Args:
            b: The block: its words, calls and line number.

        Returns:
            Number of circles.

        Raises:
            ArcError: the number is no natural number.
        """
        turns = b.named.get("TURN", 0.0)
        if turns != round(turns) or not 0.0 <= turns <= 999.0:
            raise ArcError(f"TURN={turns:g}; expected a number of full circles from 0 to 999")
        return round(turns)

    def along_arc(self, arc: ProgrammedArc, axis: Vector, line: int, *, turns: int = 1, in_plane: bool = True) -> None:
        """Add an arc whose centre is known.

        Args:
            arc: Ends, centre and direction in programmed mm.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).
            turns: Number of turns, the last part included.
            in_plane: Whether the arc lies in the working plane.

        Raises:
            ArcError: the numbers describe no arc, or it lies under different scales.
        """
        if not self.setup.even:
            raise ArcError("an arc under different scales along its axes is no arc any more: not supported")
        self.begin_path(line)
        turn = self.rotary_turn()
        least = 1 if turn is None else turn.steps()
        found = compute_arc_chords(
            arc.start, arc.end, arc.centre, arc.normal, self.chord_tolerance(), turns=turns, least=least
        )
        check_radius(found, line, self.out)
        self._warn_of_tiny_arc(arc, found, line)
        height = float((arc.end - arc.start) @ self.plane)
        feed = self.feed_mm_min(math.hypot(found.sweep * found.radius, height), line)
        gap = np.where(arc.unknown, math.nan, 0.0)
        one = ContourSegment(
            start=arc.start + gap,
            end=arc.end + gap,
            first=len(self.out),
            feed=feed,
            centre=arc.centre,
            left=bool(arc.normal @ self.plane > 0.0),
        )
        if axis != self.axis or turn is not None or not in_plane or turns > 1:
            self.end_contour("what follows is no arc in the working plane")
        one = self.turn_corner(one, axis, line)
        if one.start is not None and not np.array_equal(one.start, arc.start + gap, equal_nan=True):
            start = np.where(arc.unknown, arc.start, one.start)
            found = compute_arc_chords(start, arc.end, arc.centre, arc.normal, self.chord_tolerance())
        self._add_chords(found.points + gap if any(arc.unknown) else found.points, turn, axis, feed, line)
        self.segment = one if in_plane else None

    def _warn_of_tiny_arc(self, arc: ProgrammedArc, arc_chords: ArcChords, line: int) -> None:
        """Warn where the ends of an arc lie so close that it may be meant as a full circle, or as none."""
        apart = float(np.linalg.norm((arc.end - arc.start) * (1.0 - np.abs(self.plane))))
        if _TOUCHING < apart <= _INCREMENT:
            shape = "a tiny arc" if arc_chords.sweep < math.pi else "all but a full circle"
            self.out.warn_once(
                f"an arc ends {apart:.2g} mm from its start, less than a control resolves: read as {shape} "
                f"({arc_chords.sweep * arc_chords.radius:.4g} mm long); was a full circle meant, or none?",
                line,
            )

    def _add_chords(self, points: Array, turn: RotaryTurn | None, axis: Vector, feed: float, line: int) -> None:
        """Add the points (n, 3) of an arc in programmed mm and move to the last one."""
        if turn is not None:
            axes = turn.axes(np.arange(1, len(points) + 1) / len(points))
            self.out.add_arc(self.setup.points(points), axes, MoveKind.CUT, feed, line)
        else:
            before = self.axis_before_turn or self.axis
            self.out.add_arc(self.setup.points(points), axis, MoveKind.CUT, feed, line, axis_before=before)
        x, y, z = points[-1].tolist()
        self.p, self.axis = [x, y, z], axis
        for k in range(3):
            self.lost[k] = self.lost[k] if math.isnan(self.p[k]) else ""

    # ---- further arcs

    def through(self, to: list[float], axis: Vector, b: ProgramBlock) -> None:
        """Carry out CIP: the circle through the start, an intermediate point I1=, J1=, K1= and the end.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            b: The block: its words, calls and line number.

        Raises:
            ArcError: a point is not known, or the three lie on a line.
        """
        start = np.array(self.p)
        middle = start.copy()
        for k, name in enumerate(_INTERMEDIATE):
            if name in b.named:
                value = b.named.pop(name) * self.scale
                relative = b.modes.get(name, "IC" if self.incremental else "AC") == "IC"
                middle[k] = value + (start[k] if relative else 0.0)
        end = np.array(to)
        if np.isnan([start, middle, end]).any():
            raise ArcError("CIP from or through a place that is not known")
        centre, normal = compute_circumcircle(start, middle, end)
        flat = abs(abs(float(normal @ self.plane)) - 1.0) < 1e-9
        self.along_arc(ProgrammedArc(start, end, centre, normal), axis, b.line, in_plane=flat)

    def tangential(self, to: list[float], axis: Vector, line: int) -> None:
        """Carry out CT: an arc in the working plane that continues the previous element tangentially.

        Its centre lies on the normal n of the tangent at the start, at r = |d|² / (2 d·n), d from start to end.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).

        Raises:
            ArcError: there is no element before it, or no tangent arc reaches the end.
        """
        if self.segment is None:
            raise ArcError("a tangential arc (CT) without a contour element before it")
        if self.corner is not None:
            raise ArcError("a rounding or chamfer before a tangential arc (CT) is not supported")
        start, end, unknown = self.arc_ends(to, line)
        tangent = self.segment.tangent(self.plane)
        n = np.cross(self.plane, tangent)
        d = (end - start) * (1.0 - np.abs(self.plane))
        aside = float(d @ n)
        if not float(d @ d) > 1e-12:
            raise ArcError("a tangential arc (CT) that ends where it starts")
        if abs(aside) < 1e-9 * math.sqrt(float(d @ d)):
            if float(d @ tangent) < 0.0:
                raise ArcError("a tangential arc (CT) to a place straight behind its start")
            self.motion = 1
            self.cut(to, axis, line)
            return
        centre = start + n * float(d @ d) / (2.0 * aside)
        normal = self.plane * math.copysign(1.0, aside)
        self.along_arc(ProgrammedArc(start, end, centre, normal, unknown), axis, line)

    def about_the_pole(self, to: list[float], axis: Vector, b: ProgramBlock) -> None:
        """Carry out G2 or G3 with AP=: an arc about the pole.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            b: The block: its words, calls and line number.
        """
        first, second = find_plane_axes(self.plane)
        start, end, unknown = self.arc_ends(to, b.line)
        centre = start.copy()
        centre[first], centre[second] = self.polar.pole[first], self.polar.pole[second]
        normal = self.plane * (1.0 if self.motion == 3 else -1.0)
        arc = ProgrammedArc(start, end, centre, normal, unknown)
        self.along_arc(arc, axis, b.line, turns=1 + self.full_circles(b))


def compute_arc_end(start: Array, end: Array, centre: Array, opening: float, normal: Array) -> Array:
    """Compute the end of an arc from its opening angle.

    Args:
        start: Start point (3,), mm.
        end: Point (3,) whose height along the normal is that of the result, mm.
        centre: Centre (3,), mm.
        opening: Opening angle, rad.
        normal: Axis of right-handed travel (3,), unit vector.

    Returns:
        End point (3,), mm.
    """
    n = normal / np.linalg.norm(normal)
    out = start - centre
    out = out - (out @ n) * n
    turned: Array = math.cos(opening) * out + math.sin(opening) * np.cross(n, out)
    return start - out + turned + ((end - start) @ n) * n


def compute_circumcircle(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Compute the circle through three points.

    centre = a + ((|u|² v − |v|² u) × (u × v)) / (2 |u × v|²), with u = b − a and v = c − a.

    Args:
        a: First point (3,), mm.
        b: Second point (3,), mm.
        c: Third point (3,), mm.

    Returns:
        Centre (3,) in mm, and the unit axis (3,) about which a → b → c is right-handed.

    Raises:
        ArcError: the points lie on a line or coincide.
    """
    u, v = b - a, c - a
    n = np.cross(u, v)
    square = float(n @ n)
    if not square > 1e-12 * float(u @ u) * float(v @ v) or not square > 0.0:
        raise ArcError("the three points of an arc (CIP) lie on a line")
    centre = a + np.cross(float(u @ u) * v - float(v @ v) * u, n) / (2.0 * square)
    return centre, n / math.sqrt(square)
