"""Curves of the CL dialects (CIRCLE, MOVARC, TLON,GOFWD, NURBS), converted to chord end points in mm."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import (
    RADIUS_FAULT,
    RADIUS_WARN,
    ArcError,
    compute_arc_chords,
    compute_spline_chords,
)
from machopt.path_building.arc_radius_check import check_radius
from machopt.path_building.point_collector import PathBuilder
from machopt.toolpath.readers.apt.statement_parser import parse_groups, parse_leading_numbers, parse_number

_ARC_WORDS = ("TIMES", "ANGLE", "CLOCKWISE", "COUNTERCLOCKWISE", "CLW", "CCLW")  # the axis gives the direction
ANGLE_WARN = 0.02  # rad
_PLACE_WORDS = ("CENTER", "AXIS", "RADIUS")  # of MOVARC, before the numbers they name
_SWEEP_AT, _WITH_SWEEP = 7, 11  # place of the sweep, and how many numbers such a record has
_CIRCLE_COUNTS = (6, 7, _WITH_SWEEP)  # centre and axis; the radius; tolerances and cutter of NX, or a sweep
_MOVARC_COUNTS = (6, 7)


@dataclass(frozen=True, kw_only=True)
class PendingArc:
    """An arc that waits for its end point."""

    centre: Array
    normal: Array  # right-handed travel
    turns: int
    line: int
    angle: float | None = None  # rad, MOVARC
    sweep: float | None = None  # rad, what the record states: it decides about the direction
    radius: float | None = None  # mm, what the record states


@dataclass(kw_only=True)
class CurveState:
    """State between the statements of one curve."""

    left_handed: bool  # NX: CIRCLE's axis is that of clockwise travel
    tolerance: float  # mm
    states_sweep: bool = False  # CIRCLE with eleven numbers states its sweep
    pending: PendingArc | None = None
    on_the_way: Array | None = None  # (N, 3) mm, points the pending arc should run through
    tangent: list[float] | None = None
    spline_open: bool = False
    knots: list[float] = field(default_factory=list)
    control: list[list[float]] = field(default_factory=list)

    def begin(self, word: str, parts: list[str], line: int, scale: float) -> None:
        """Begin an arc that the next GOTO ends.

        Read are ``CIRCLE/x,y,z,i,j,k[,r,…][,TIMES,n]``, ``MOVARC/x,y,z,i,j,k,r,ANGLE,deg`` and
        ``MOVARC/CENTER,x,y,z,AXIS,i,j,k,RADIUS,r``. With ``states_sweep``, the number behind the radius of a CIRCLE of
        eleven numbers is the sweep in degrees (CAMplete).

        Args:
            word: Major word of the statement.
            parts: Arguments of the statement.
            line: Line number of the statement (1-based).
            scale: mm per unit of the program.

        Raises:
            ArcError: the numbers describe no arc.
        """
        if self.pending is not None:
            raise ArcError(f"the arc of line {self.pending.line} has no end point (GOTO) yet")
        if word == "MOVARC":
            parts = [p for p in parts if p not in _PLACE_WORDS]
        values, after = parse_leading_numbers(parts)
        if len(values) < 6:
            raise ArcError(f"{len(values)} numbers; expected centre and axis (6) at least")
        if len(values) >= 7 and not values[6] > 0.0:
            raise ArcError(f"the radius is {values[6]:g}")
        if len(values) not in (_MOVARC_COUNTS if word == "MOVARC" else _CIRCLE_COUNTS):
            raise ArcError(f"{len(values)} numbers; expected centre and axis (6), the radius (7) or all of NX (11)")
        strange = [p for p in after if p and p not in _ARC_WORDS and parse_number(p) is None]
        if strange:
            raise ArcError(f"found {strange[0]!r}; expected TIMES or ANGLE and a number behind the numbers")
        turns, angle = 1, None
        for word_at, text in enumerate(after):
            value = parse_number(after[word_at + 1]) if word_at + 1 < len(after) else None
            if text == "TIMES" and value is not None:
                turns = max(round(value), 1)
            if text == "ANGLE" and value is not None:
                angle = math.radians(value)
        normal = np.array(values[3:6]) * (-1.0 if self.left_handed and word == "CIRCLE" else 1.0)
        if angle is not None and angle < 0.0:
            normal, angle = -normal, -angle
        if turns > 1000:
            raise ArcError(f"TIMES,{turns}: expected at most 1000 turns")
        sweep = None
        if self.states_sweep and word == "CIRCLE" and len(values) == _WITH_SWEEP:
            sweep = math.radians(values[_SWEEP_AT])
            if not 0.0 < sweep <= 1000.0 * math.tau:
                raise ArcError(f"the sweep is {values[_SWEEP_AT]:g}°; expected more than 0")
            normal = -normal  # axis of clockwise travel; the sweep has priority
        centre = np.array(values[:3]) * scale
        self.pending = PendingArc(
            centre=centre,
            normal=normal,
            turns=turns,
            line=line,
            angle=angle,
            sweep=sweep,
            radius=values[6] * scale if len(values) > 6 else None,
        )

    def arc_to(self, start: Array, end: Array, out: PathBuilder) -> Array:
        """Compute the chord end points of the pending arc.

        Args:
            start: Start point (3,), mm.
            end: End point (3,), mm.
            out: Path builder that takes the points and warnings.

        Returns:
            Chord end points (N, 3), mm.
        """
        wait, on_the_way = self.pending, self.on_the_way
        assert wait is not None
        self.pending = self.on_the_way = None
        if wait.sweep is not None:
            return self.arc_of_sweep(wait, wait.sweep, start, end, out)
        turns = wait.turns
        if wait.angle is not None:
            turns = int(wait.angle // math.tau) + 1
        found = compute_arc_chords(start, end, wait.centre, wait.normal, self.tolerance, turns=1)
        if turns > 1:
            if wait.angle is not None:
                turns = max(round((wait.angle - found.sweep) / math.tau) + 1, 1)
            found = compute_arc_chords(start, end, wait.centre, wait.normal, self.tolerance, turns=turns)
        check_radius(found, wait.line, out, wait.radius)
        if on_the_way is not None:
            nearest = np.linalg.norm(found.points[:, None, :] - on_the_way[None], axis=2).min(axis=0)
            chord = found.radius * found.sweep / max(len(found.points), 1)
            if float(nearest.max()) > chord + RADIUS_WARN:
                out.warn(
                    f"a point given on the arc lies {float(nearest.max()):.3g} mm off it: check its direction",
                    wait.line,
                )
        if wait.angle is not None and abs(found.sweep - wait.angle) > ANGLE_WARN:
            out.warn(
                f"the arc's angle is {math.degrees(wait.angle):.2f}° but its end point gives "
                f"{math.degrees(found.sweep):.2f}°; the end point holds",
                wait.line,
            )
        return found.points

    def arc_of_sweep(self, wait: PendingArc, sweep: float, start: Array, end: Array, out: PathBuilder) -> Array:
        """Compute the chord end points of an arc whose record states its sweep.

        Of the two directions of travel, the one with that sweep is taken.

        Args:
            wait: The pending arc.
            sweep: Sweep of the arc, degrees.
            start: Start point (3,), mm.
            end: End point (3,), mm.
            out: Path builder that takes the points and warnings.

        Returns:
            Chord end points (N, 3), mm.

        Raises:
            ArcError: neither direction has that sweep.
        """
        whole = max(math.ceil(sweep / math.tau - ANGLE_WARN) - 1, 0)
        for normal in (wait.normal, -wait.normal):
            found = compute_arc_chords(start, end, wait.centre, normal, self.tolerance, turns=whole + 1)
            if abs(found.sweep - sweep) <= ANGLE_WARN:
                check_radius(found, wait.line, out, wait.radius)
                return found.points
        other = math.degrees(compute_arc_chords(start, end, wait.centre, wait.normal, self.tolerance).sweep)
        raise ArcError(
            f"the arc of line {wait.line} states a sweep of {math.degrees(sweep):g}°, but its points give {other:.4g}° "
            f"or {360.0 - other:.4g}°: expected one of these"
        )

    def expect(self, points: Array) -> None:
        """Record points that lie on the pending arc.

        Args:
            points: Points (N, 3), mm.
        """
        self.on_the_way = points[:: max(len(points) // 50, 1)]

    def drive(self, rest: str, start: Array, scale: float, line: int, out: PathBuilder) -> Array:
        """CATIA's ``TLON,GOFWD/(CIRCLE/c,R),ON,(LINE/c,end)`` after ``INDIRV/tangent``.

        The sense axis is (start − centre) × tangent; the end is only in LINE, as its second point.

        Args:
            rest: Text behind the slash, with the groups CIRCLE and LINE.
            start: Start point (3,), mm.
            scale: mm per unit of the program.
            line: Line number of the statement (1-based).
            out: Path builder that takes the points and warnings.

        Returns:
            Chord end points (N, 3), mm.

        Raises:
            ArcError: the statement describes no arc.
        """
        shapes = parse_groups(rest)
        if self.tangent is None or len(self.tangent) != 3:
            raise ArcError("TLON without INDIRV before it: the start tangent is not known")
        if len(shapes) != 2 or shapes[0][0] not in ("CIRCLE", "CYLNDR") or shapes[1][0] != "LINE":
            raise ArcError("expected TLON,GOFWD/(CIRCLE/centre,radius),ON,(LINE/centre,end)")
        (_, circle), (_, to) = shapes
        if len(circle) < 4 or len(to) != 6:
            raise ArcError(f"{len(circle)} numbers in the circle and {len(to)} in LINE; expected 4 (7) and 6")
        centre = np.array(circle[:3]) * scale
        radius = circle[-1] * scale
        end = np.array(to[3:6]) * scale
        tangent = np.array(self.tangent)
        self.tangent = None
        normal = np.cross(start - centre, tangent)
        if float(np.linalg.norm(normal)) < 1e-9:
            raise ArcError("INDIRV points at the arc's centre")
        if abs(float(np.linalg.norm(start - centre)) - radius) > max(RADIUS_WARN, RADIUS_FAULT * radius):
            raise ArcError(f"the arc starts {np.linalg.norm(start - centre):g} mm from its centre; radius {radius:g}")
        second = ",2,INTOF" in rest.upper().replace(" ", "")
        found = compute_arc_chords(start, end, centre, normal, self.tolerance, closed_within=1e-4)
        check_radius(found, line, out)
        if not second and found.sweep > math.pi + ANGLE_WARN:
            out.warn(
                f"the arc sweeps {math.degrees(found.sweep):.1f}° although it ends at the first crossing of its "
                "LINE: check INDIRV",
                line,
            )
        return found.points

    def spline(self, start: Array) -> Array:
        """Compute the points of an NX NURBS curve.

        The curve is cubic. The present point is the first control point; the statements give the inner knots and 1.

        Args:
            start: Start point (3,), mm.

        Returns:
            Points (N, 3), mm.

        Raises:
            ArcError: the numbers describe no curve.
        """
        knots, control = self.knots, self.control
        self.spline_open, self.knots, self.control = False, [], []
        if not knots or not control:
            raise ArcError("expected KNOT and CNTRL lines")
        full = np.array([0.0] * 4 + knots[:-1] + [knots[-1]] * 4)
        return compute_spline_chords(np.vstack([start, np.array(control)]), full, self.tolerance)
