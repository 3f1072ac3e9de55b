"""Approach to and departure from a contour (APPR, DEP): moves before its first and behind its last element."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.path_building.point_collector import Vector
from machopt.toolpath.readers.gcode.arc_moves import ProgrammedArc
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourSegment
from machopt.toolpath.readers.heidenhain.approach_departure_geometry import (
    ContourApproach,
    LeadIn,
    LeadPath,
    convert_to_plane_point,
)
from machopt.toolpath.readers.heidenhain.datums_and_planes import DatumAndPlaneReader


class ContourEndReader(DatumAndPlaneReader):
    """Approaches that wait for the contour element they lead into, and departures."""

    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        super().__init__(source, options)
        self.side = 0.0  # of the tool by radius compensation: +1 left (RL, G41), -1 right
        self.approach: ContourApproach | None = None  # waits for the contour element it leads into

    def lead_in(self, approach: ContourApproach) -> None:
        """Carry out APPR: the path to the first contour point follows once the next element is known.

        Args:
            approach: The pending approach.

        Raises:
            InputError: the position before the approach or its target is not known.
        """
        self.end_contour("an approach (APPR) follows")
        if any(map(math.isnan, (*self.p, *approach.place))):
            raise self.source.build_error("APPR from or to a place that is not known", approach.line)
        self.approach = approach
        self.p = list(approach.place)

    def end_contour(self, why: str) -> None:
        """End the contour.

        Args:
            why: Reason, for the message.

        Raises:
            InputError: an approach, a rounding or a chamfer still waits for the next element.
        """
        if self.approach is not None:
            raise self.source.build_error(f"APPR without a contour element after it: {why}", self.approach.line)
        super().end_contour(why)

    def turn_corner(self, one: ContourSegment, axis: Vector, line: int) -> ContourSegment:
        """Add the pending approach or corner before an element.

        Args:
            one: The element behind it.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).

        Returns:
            The part of the element that is left.
        """
        approach, self.approach = self.approach, None
        if approach is not None:
            tangent = one.element(self.plane).direction(one.element(self.plane).start)
            path = approach.path.compute_approach(
                convert_to_plane_point(one.start), tangent, convert_to_plane_point(np.array(approach.start))
            )
            self.p = list(approach.start)
            self.move_to_contour(path.helper, approach.place[2], approach, axis)
            if path.centre is not None:
                self.lead_arc(path, one.start, axis, approach.feed, approach.line)
            else:
                self.go(one.start.tolist(), axis, MoveKind.CUT, approach.feed, approach.line)
            self.end_contour("")
            one = dataclasses.replace(one, first=len(self.out))
        return super().turn_corner(one, axis, line)

    def move_to_contour(self, helper: complex, height: float, approach: ContourApproach, axis: Vector) -> None:
        """Move to the auxiliary point: first in the plane, then along the tool axis.

        Args:
            helper: Auxiliary point in the working plane, mm.
            height: Height of the contour, mm.
            approach: The pending approach.
            axis: Tool axis in programmed coordinates, unit vector.
        """
        for z in (self.p[2], height):
            to = [helper.real, helper.imag, z]
            if to != self.p:
                move = MoveKind.RAPID if math.isnan(approach.feed_before) else MoveKind.CUT
                self.go(to, axis, move, approach.feed_before, approach.line)

    def lead_arc(self, path: LeadPath, end: Array, axis: Vector, feed: float, line: int) -> None:
        """Add the arc of an approach or departure.

        Args:
            path: Path of the approach or departure in the working plane.
            end: End point (3,) in programmed mm.
            axis: Tool axis in programmed coordinates, unit vector.
            feed: Feed, mm/min.
            line: Line number in the file (1-based).
        """
        assert path.centre is not None
        centre = np.array([path.centre.real, path.centre.imag, self.p[2]])
        normal = self.plane * (1.0 if path.left else -1.0)
        modal, self.feed = self.feed, feed / self.feed_scale
        self.along_arc(ProgrammedArc(np.array(self.p), end, centre, normal), axis, line)
        self.feed = modal

    def lead_out(self, path: LeadIn, outside: complex | None, height: float | None, line: int) -> None:
        """Carry out DEP: leave the last contour element.

        Args:
            path: The departure.
            outside: Position after it in the working plane, mm; None where not given.
            height: Height after it, mm; None where not given.
            line: Line number in the file (1-based).

        Raises:
            InputError: there is no contour element before the departure.
        """
        if self.segment is None or np.isnan(self.segment.end).any():
            raise self.source.build_error("DEP without a contour element before it", line)
        if self.corner is not None:
            raise self.source.build_error(
                "a rounding or chamfer before DEP: no contour element follows it", self.corner.line
            )
        element = self.segment.element(self.plane)
        found = path.compute_departure(element.end, element.direction(element.end), outside)
        feed = self.feed_mm_min(1.0, line)
        axis, z = self.axis, self.p[2]
        end = np.array([found.helper.real, found.helper.imag, z])
        if found.centre is not None:
            self.lead_arc(found, end, axis, feed, line)
        else:
            self.go(end.tolist(), axis, MoveKind.CUT, feed, line)
        if outside is not None:
            self.go([outside.real, outside.imag, z], axis, MoveKind.CUT, feed, line)
        if height is not None and height != z:
            self.go([*self.p[:2], height], axis, MoveKind.CUT, feed, line)
        self.side, self.segment = 0.0, None  # DEP ends the compensation
