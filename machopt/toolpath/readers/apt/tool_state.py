"""State of the tool while CL data are read: position, coordinate systems, feed, and the moves that change it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.path_building.coordinate_systems import CoordinateSystem, SystemTransform
from machopt.path_building.drilling_cycles import DrillingCycle, append_hole_moves
from machopt.path_building.point_collector import PathBuilder, Vector
from machopt.toolpath.readers.apt.cam_dialect import CamDialect, detect_dialect, find_unit_scale
from machopt.toolpath.readers.apt.curve_statements import CurveState
from machopt.toolpath.readers.apt.cycle_statements import HsmDrillingCycle


@dataclass(frozen=True)
class WorkingPlane:
    """A plane across the tool axis, in the present coordinate system."""

    point: Array  # (3,) mm
    normal: Array  # (3,) unit


class AptToolState:
    """State of the tool, in the first coordinate system of the file."""

    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        self.source, self.options = source, options
        self.dialect = detect_dialect(source)
        self.out = PathBuilder(source=source, options=options, format=self.dialect.value)
        self.scale = find_unit_scale(source, options, self.out)
        self.curves = CurveState(
            left_handed=self.dialect is CamDialect.NX,
            tolerance=options.arc_tolerance * 1e3,
            states_sweep=self.dialect is CamDialect.GENERIC,
        )
        self.position: Vector | None = None  # mm, in the present system
        self.axis: Vector = (0.0, 0.0, 1.0)
        self.rapid = False  # holds for the next motion only
        self.feed, self.per_revolution = math.nan, False
        self.rpm = math.nan
        self.cycle: DrillingCycle | HsmDrillingCycle | None = None
        self.last_cycle: DrillingCycle | HsmDrillingCycle | None = None
        self.multax = False
        self.remarks = ""  # the last PPRINT
        self.shifts: dict[str, list[float]] = {}  # TRANS, ORIGIN
        self.first_frame: CoordinateSystem | None = None
        self.transfer: SystemTransform | None = None  # printed points in the first system
        self.of_frame: SystemTransform | None = None  # its part by MSYS, CSYS or a CATIA matrix
        self.placement: dict[str, SystemTransform] = {}  # its parts by SCALE and TRANS
        self.world = False  # points are in one system, independent of CSYS
        self.catia_rows: list[list[float]] | None = None
        self.tool, self.tool_text, self.count = "", "", 0
        self.rotations: dict[str, float] = {}
        self.cut_rotation: dict[str, float] | None = None
        self.ended = False
        self.away = 0  # line of a move to a place that the file does not state, 0 where the place is known
        self.back_to: WorkingPlane | None = None  # of RTRCTO,AUTO

    def move_to(self, to: Vector, axis: Vector, line: int, *, rapid: bool = False) -> None:
        """Add a move to a point, or the arc that this point ends.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).
            rapid: Whether the move is a rapid traverse.

        Raises:
            ValueError: a cut begins at an unknown position.
        """
        if self.away and not (self.rapid or rapid):
            raise ValueError(
                f"a cut from an unknown position: the move of line {self.away} ends where the file does not state it; "
                "expected "
                "RAPID before this GOTO"
            )
        self.away = 0
        self.position, self.axis = to, axis
        if self.transfer is not None:
            to, axis = self.transfer.point(to), self.transfer.direction(axis)
        if self.rapid or rapid:
            self.rapid = False
            self.out.add(to, axis, MoveKind.RAPID, math.nan, line)
        else:
            self.out.add(to, axis, MoveKind.CUT, self.feed_mm_min(), line)
            self.check_rotation(line)

    def add_curve(self, points: Array, axis: Vector, line: int) -> None:
        """Add the points of a curve as cuts.

        Args:
            points: Points (N, 3), mm.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).
        """
        before = self.axis
        self.axis = axis
        if self.transfer is not None:
            points = self.transfer.points(points)
            before, axis = self.transfer.direction(before), self.transfer.direction(axis)
        if self.rapid:
            self.rapid = False
            self.out.add_arc(points, axis, MoveKind.RAPID, math.nan, line, axis_before=before)
        else:
            self.out.add_arc(points, axis, MoveKind.CUT, self.feed_mm_min(), line, axis_before=before)
            self.check_rotation(line)

    def drill(self, hole: Vector, line: int) -> None:
        """Add the strokes of the active drilling cycle at one hole.

        Args:
            hole: Programmed point of the hole, mm.
            line: Line number in the file (1-based).
        """
        assert self.cycle is not None
        self.rapid = False
        axis, before = self.axis, self.position
        cycle = self.cycle.build_cycle_at(hole, axis) if isinstance(self.cycle, HsmDrillingCycle) else self.cycle
        if cycle.retract is None:
            cycle = replace(cycle, retract=self.height_before(hole, axis, cycle.clear))
        self.away = 0
        if self.transfer is not None:
            turned = self.transfer.direction(axis)
            start = None if before is None else self.transfer.point(before)
            height = append_hole_moves(self.out, cycle, self.transfer.point(hole), turned, line, start)
        else:
            height = append_hole_moves(self.out, cycle, hole, axis, line, before)
        n = np.array(axis) / max(float(np.linalg.norm(axis)), 1e-12)
        x, y, z = (np.array(hole) + height * n).tolist()
        self.position = (x, y, z)
        self.check_rotation(line)

    def height_before(self, hole: Vector, axis: Vector, clear: float) -> float:
        """Return the height over a hole of the plane that the tool was in before the cycle (RTRCTO,AUTO).

        Args:
            hole: Programmed point of the hole, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            clear: Clearance over the hole, mm.

        Returns:
            Height, mm.

        Raises:
            ValueError: that plane is not known, or the tool axis has turned since.
        """
        n = np.array(axis) / max(float(np.linalg.norm(axis)), 1e-12)
        if self.back_to is None and self.position is not None:
            self.back_to = WorkingPlane(np.array(self.position), n)
        if self.back_to is None or not np.allclose(self.back_to.normal, n, atol=1e-6):
            raise ValueError(
                "RTRCTO,AUTO retracts to where the tool was before the cycle, and that height is not known for this "
                "tool axis; expected RTRCTO with a distance, or a GOTO along the same axis before the cycle"
            )
        return max(float((self.back_to.point - np.array(hole)) @ n), clear)

    def feed_mm_min(self) -> float:
        return self.feed * self.rpm if self.per_revolution else self.feed

    def use_frame(self, frame: CoordinateSystem, line: int) -> None:
        """Change the coordinate system of the points that follow.

        Args:
            frame: The coordinate system in the first one of the file.
            line: Line number in the file (1-based).
        """
        if self.first_frame is None or (not len(self.out) and self.transfer is None):
            self.first_frame = frame
            return
        self.of_frame = None if frame.same_as(self.first_frame) else SystemTransform.between(self.first_frame, frame)
        if self.of_frame is not None:
            self.out.warn_once(
                "the coordinate system changes: points from here on are brought into the first one", line
            )
        self.place()

    def change_placement(self, one: SystemTransform, name: str) -> None:
        """Replace one of the transforms TRANS and SCALE.

        Points are scaled, then shifted, in the present coordinate system.

        Args:
            one: The transform; the identity ends it.
            name: Word of the transform.
        """
        self.placement.pop(name, None)
        if not one.nothing:
            self.placement[name] = one
        self.place()

    def place(self) -> None:
        """What brings printed points into the first system; the tool's place in the new one is not known."""
        before, found = self.transfer, None
        for one in (self.placement.get("SCALE"), self.placement.get("TRANS"), self.of_frame):
            if one is not None:
                found = one if found is None else found.then(one)
        self.transfer = None if found is None or found.nothing else found
        if self.transfer is not None or before is not None:
            here = self.position
            self.position = None
            if here is not None and self.of_frame is None:
                back = before.point(here) if before is not None else here
                self.position = back if self.transfer is None else self.transfer.inverse().point(back)

    def check_rotation(self, line: int) -> None:
        """Check that all points belong to one position of the table (CLT).

        Coordinates are those of the turned table, and one position only can be ``workpiece``.

        Args:
            line: Line number in the file (1-based).

        Raises:
            InputError: points follow at another position of the table.
        """
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
            raise self.source.build_error(
                "the table has another position than for the cuts before; expected one table position in a file: "
                "export one file for each",
                line,
            )
