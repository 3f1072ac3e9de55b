"""State of a control while it runs a program: modes, coordinate systems, tool position.

G-code and Heidenhain readers share this state and update it word by word. ``p`` is the programmed position; ``setup``
transforms it into the workpiece.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.file_formats.source_file import UNIT_NAMES, ReadOptions, SourceFile
from machopt.path_building import rotary_axes
from machopt.path_building.arc_chords import ArcError
from machopt.path_building.coordinate_systems import SystemTransform
from machopt.path_building.drilling_cycles import DrillingCycle
from machopt.path_building.point_collector import PathBuilder, Vector
from machopt.path_building.rotary_moves import RotaryTurn
from machopt.toolpath.readers.gcode.canned_cycles import CannedCycle
from machopt.toolpath.readers.gcode.feed_state import FeedState
from machopt.toolpath.readers.gcode.geometry.arc_centres import ArcCentres
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourCorner, ContourSegment, fit_corner
from machopt.toolpath.readers.gcode.geometry.coordinate_setup import CoordinateSetup
from machopt.toolpath.readers.gcode.geometry.polar_coordinates import (
    PolarCoordinates,
    PolarStep,
    convert_line_angle,
    convert_polar_words,
    find_plane_axes,
)
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.dwell_units import find_control

_Z = (0.0, 0.0, 1.0)
AXES = "XYZ"


class ControlState(FeedState):
    """State of the control while a program is read, and what a block's coordinates do with it."""

    format = "gcode"
    siemens: bool  # whose control the program is for
    decimals_count = True  # numbers without a point may mean something else, by the control's parameters
    unit_by_words = True  # units are words of blocks, and hold from there on
    once = 0  # line of a drilling cycle that is carried out in its own block

    def __init__(self, source: SourceFile, options: ReadOptions, unit: str) -> None:
        self.source, self.options = source, options
        self.out = PathBuilder(source=source, options=options, format=self.format)
        self.setup = CoordinateSetup(
            machine=rotary_axes.parse_machine(options.machine) if options.machine else None, out=self.out
        )
        self.tolerance = options.arc_tolerance * 1e3  # mm
        self.scale = UNIT_NAMES[unit]
        self.unit_said = options.unit is not None  # by the option or a unit word that was carried out
        self.unit_used_at = 0  # line of the first length or feed
        self.p: list[float] = [math.nan] * 3  # mm, as programmed; NaN: not known
        self.lost = [""] * 3  # what made a coordinate unknown since it was last programmed (G53, G28 …)
        self.axis: Vector = _Z  # in the workpiece
        self.rotary_words = False  # a rotary word or tool vector was carried out
        self.turned_from: dict[str, float] | None = None  # rotary angles before a block that turns them (deg)
        self.axis_before_turn: Vector | None = None  # the tool axis before such a block
        self.turns_in_plane = False  # the tool axis turns in one plane, not on the path of the rotary axes
        self.shortest_turns = False  # rotary axes take the shortest way (Heidenhain's M126)
        self.motion: int | None = None
        self.plane = np.array(_Z)
        self.incremental = False
        self.centres = ArcCentres(self.out)
        self.reset_feed(self.scale)
        self.canned: CannedCycle | None = None
        self.back_to_initial = True
        self.retract_said = False  # G98 or G99 was carried out
        self.control = find_control(source)
        self.modal_call: DrillingCycle | None = None
        self.plunges: list[tuple[int, dict[str, float]]] = []
        self.polar = PolarCoordinates()
        self.polar_step: PolarStep | None = None  # of this block, by @ and ^
        self.segment: ContourSegment | None = None  # the contour element before, while the tool is still at its end
        self.corner: ContourCorner | None = None  # what goes between it and the next one
        self.modal_corner: ContourCorner | None = None  # RNDM
        self.corner_feed: float | None = None  # FRCM, mm/min

    # ---- coordinate systems

    def change_setup(self, **changes: object) -> None:
        """Change the coordinate system, tilted plane or mode: the tool does not move, its coordinates change.

        Args:
            **changes: Fields of :class:`CoordinateSetup` and their new values.
        """
        before = self.setup.transfer
        self.setup = self.setup.with_changes(**changes)
        self.follow(before)
        if self.setup.transfer is not before:
            self.end_contour("the coordinate system changes")

    def follow(self, before: SystemTransform | None) -> None:
        """Recompute the programmed coordinates of the present position after ``setup`` changed.

        Args:
            before: Transform into the workpiece before the change; None where it was not known.
        """
        self.axis = self.setup.tool_axis()
        if before is None and self.setup.transfer is None:
            return
        p, each_by_itself = self.setup.convert_from_system(before, self.p)
        for k in range(3):
            if math.isnan(p[k]) and not each_by_itself:
                self.lost[k] = self.lost[k] or "before the coordinate system turned"
        self.p = p

    def mark_position_unknown(self, words: dict[str, float], name: str, line: int) -> None:
        """Mark the position as unknown after a move in the machine frame.

        Args:
            words: Words of the block: letter or name → number.
            name: Word that moved the machine, for messages.
            line: Line number in the file (1-based).
        """
        axes = [k for k in range(3) if AXES[k] in words]
        if not axes and name in ("G53", "G153", "SUPA"):
            return  # suppresses an offset, moves nothing
        if axes and self.setup.is_rotated and not self.setup.by_machine:
            axes = self.setup.list_axes_moved_by_machine_z() if axes == [2] else [0, 1, 2]
        for k in axes or (range(3) if not words.keys() & set("ABC") else []):
            self.p[k], self.lost[k] = math.nan, name
        angles = {c: 0.0 if name in ("G28", "G30") else words[c] for c in words.keys() & set("ABC")}
        if angles:
            before = self.setup.transfer
            self.setup = self.setup.turn_rotary_axes(angles)
            self.follow_turn(before)
        self.out.ignore(f"{name} (move in the machine's frame)", line, understood=True)

    def follow_turn(self, before: SystemTransform | None) -> None:
        """Update the tool axis and the coordinates after rotary axes moved.

        Without tool-centre-point control the programmed coordinates stay the same.

        Args:
            before: Transform into the workpiece before the change; None where it was not known.
        """
        self.axis = self.setup.tool_axis()
        if self.setup.tcp or self.setup.tilted:
            self.follow(before)

    # ---- straight moves

    def target(self, words: dict[str, float], b: ProgramBlock) -> list[float] | None:
        """Return the target of a block; an incremental zero leaves an unknown coordinate unknown.

        Args:
            words: Words of the block: letter or name → number; may be changed in place.
            b: The block: its words, calls and line number.

        Returns:
            Position in programmed mm, None where the block has no X, Y or Z.

        Raises:
            InputError: an increment starts from an unknown coordinate.
        """
        relative = self.incremental
        self.polar_step = None
        if "@" in words or "^" in words:
            self.polar_step = convert_polar_words(words, b, self.p, self.plane, self.scale, incremental=relative)
        if self.polar.on:
            self.polar.words(words, self.plane, self.scale, incremental=relative)
            b.modes.update({"XYZ"[k]: "AC" for k in find_plane_axes(self.plane)})
        elif not self.polar.about_pole(words, b, self.p, self.plane, self.scale, incremental=relative):
            self.polar.switch(on=False)
        for name in (",A", "ANG"):
            if name in b.named:
                convert_line_angle(b.named.pop(name), words, b, self.p, self.plane, self.scale, incremental=relative)
        if not ("X" in words or "Y" in words or "Z" in words):
            return None
        to = list(self.p)
        for k, letter in enumerate(AXES):
            if letter in words:
                value = words[letter] * self.scale
                if relative if letter not in b.modes else b.modes[letter] == "IC":
                    if math.isnan(to[k]):
                        if value == 0.0:
                            continue
                        if self.lost[k]:
                            raise self.source.build_error(
                                f"incremental {letter} from a place that is not "
                                f"known{self.describe_unknown_position(k)}; post it with "
                                "absolute coordinates (G90) there",
                                b.line,
                            )
                        self.out.warn_once("the first incremental moves start from 0", b.line)
                        to[k] = self.p[k] = 0.0
                        if len(self.out) and not self.setup.is_rotated:  # unchanged since the program began
                            self.out.fill_coordinate(k, float(self.setup.points(np.zeros((1, 3)))[0, k]))
                    value += to[k]
                to[k] = value
        return to

    def go(self, to: list[float], axis: Vector, move: int, feed: float, line: int) -> None:
        """Add one point.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            move: Kind of the move.
            feed: Feed, mm/min.
            line: Line number in the file (1-based).

        Raises:
            InputError: the position in the workpiece is not known.
        """
        if move != MoveKind.CUT:
            self.end_contour("a rapid move follows")
        mixed = self.setup.mixes([math.isnan(v) for v in to])
        for k in range(3):
            if not math.isnan(to[k]):
                self.lost[k] = ""
            elif move == MoveKind.CUT and (self.lost[k] or mixed):
                raise self.source.build_error(
                    f"cuts while {AXES[k]} is not known{self.describe_unknown_position(k)}", line
                )
        self.p, self.axis = to, axis
        if mixed:
            self.out.ignore("rapid in a tilted plane while a coordinate is not known", line, understood=True)
            return
        self.out.add(self.setup.point((to[0], to[1], to[2])), axis, move, feed, line)

    def describe_unknown_position(self, k: int) -> str:
        """Describe why a coordinate is not known.

        Args:
            k: Index of the coordinate: 0, 1, 2 for X, Y, Z.

        Returns:
            Text for a message.
        """
        name = self.lost[k]
        if name in ("G53", "G153", "SUPA"):
            return (
                f": {name} moves in the machine's frame. Where the post writes G53 for its fixture offset 0, set the "
                "operation's fixture offset to 1 (G54) and post again, or give --offset G53=0,0,0"
            )
        if name.startswith(("G", "M")):
            return (
                f": {name} moved it in the machine's frame, and the program does not state where it went; "
                "name it in a G0 behind that"
            )
        return f": it was not programmed {name}" if name else ""

    def rotary_turn(self) -> RotaryTurn | None:
        """The turn of the rotary axes under tool-centre-point control in this block; None where there is none."""
        s = self.setup
        if (
            self.turned_from is None
            or self.turns_in_plane
            or s.tcp not in ("angles", "vector")
            or s.tilted == "aligned"
        ):
            return None
        if s.machine is None or s.vector is not None:
            return None
        return RotaryTurn(s.machine, self.turned_from, s.angles)

    def cut(self, to: list[float], axis: Vector, line: int) -> None:
        """Add a straight cut.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).

        Raises:
            InputError: the cut begins at a lost coordinate, so its direction is not in the file.
        """
        for k in range(3):
            if math.isnan(self.p[k]) and self.lost[k]:
                raise self.source.build_error(
                    f"cuts while {AXES[k]} is not known{self.describe_unknown_position(k)}", line
                )
        self.begin_path(line)
        if self.turned_from is not None and self.setup.by_machine and not any(map(math.isnan, (*to, *self.p))):
            self.end_contour("a move of rotary axes follows")
            self.swept_cut(to, self.turned_from, line)
            return
        if self.setup.tcp and self.setup.angles and len(self.out):
            self.plunges.append((len(self.out), dict(self.setup.angles)))
        if axis != self.axis:
            self.end_contour("the tool axis turns")
        elif self.corner is not None and to == self.p:
            return  # no element: the corner waits for the next one
        feed = self.feed_mm_min(math.dist(to, self.p), line)
        one = ContourSegment(start=np.array(self.p), end=np.array(to), first=len(self.out), feed=feed)
        one = self.turn_corner(one, axis, line)
        turn = self.rotary_turn()
        steps = 1 if turn is None or any(map(math.isnan, (*to, *self.p))) else turn.steps()
        start = list(self.p)
        for k in range(1, steps if turn is not None else 1):
            between = [a + k / steps * (b - a) for a, b in zip(start, to, strict=True)]
            self.go(between, turn.axis(k / steps), MoveKind.CUT, feed, line)  # type: ignore[union-attr]
        self.go(to, axis, MoveKind.CUT, feed, line)
        self.segment = one

    def begin_path(self, line: int) -> None:
        """Begin a path with a cut: its start becomes a point where it is known.

        Args:
            line: Line number in the file (1-based).
        """
        if len(self.out):
            return
        if any(map(math.isnan, self.p)):
            self.out.warn_once(
                "the program begins with a cut from a position that it does not state; this move is not part of the "
                "path",
                line,
            )
        else:
            self.out.add(self.setup.point((self.p[0], self.p[1], self.p[2])), self.axis, MoveKind.RAPID, math.nan, line)

    # ---- contour corners

    def turn_corner(self, one: ContourSegment, axis: Vector, line: int) -> ContourSegment:
        """Add the pending rounding or chamfer between the previous element and this one.

        Args:
            one: The element behind the corner.
            axis: Tool axis in programmed coordinates, unit vector.
            line: Line number in the file (1-based).

        Returns:
            The part of the element that is left.

        Raises:
            InputError: the corner does not fit between the elements.
        """
        before, corner = self.segment, self.corner or self.modal_corner
        self.corner = None
        if corner is None:
            return one
        if before is None:
            if corner.stays:
                return one
            raise self.source.build_error("a rounding or chamfer without a contour element before it", corner.line)
        try:
            found = fit_corner(corner, before, one, self.plane, self.chord_tolerance())
        except ArcError as problem:
            raise self.source.build_error(str(problem), corner.line) from problem
        if found is None:
            return one
        feed = corner.feed or before.feed
        self.out.replace_points(before.first, self.setup.points(found.before))
        between = self.setup.points(found.between)
        if found.curved:
            self.out.add_arc(between, axis, MoveKind.CUT, feed, corner.line)
        else:
            x, y, z = between[-1].tolist()
            self.out.add((x, y, z), axis, MoveKind.CUT, feed, corner.line)
        self.p = found.between[-1].tolist()
        return dataclasses.replace(one, start=found.between[-1], first=len(self.out))

    def end_contour(self, why: str) -> None:
        """End the contour.

        Args:
            why: Reason, for the message.

        Raises:
            InputError: a rounding or chamfer still waits for the next element.
        """
        if self.corner is not None:
            raise self.source.build_error(
                f"a rounding or chamfer without a contour element after it: {why}", self.corner.line
            )
        self.segment = None

    def chord_tolerance(self) -> float:
        """mm between chord and arc in programmed coordinates, which a scaling may enlarge."""
        return self.tolerance / self.setup.stretch

    def swept_cut(self, to: list[float], angles: dict[str, float], line: int) -> None:
        """Add a cut of linear and rotary axes together without tool-centre-point control: the tip moves on a curve.

        Args:
            to: Target position in programmed coordinates, mm.
            angles: Target angles: axis letter → degrees.
            line: Line number in the file (1-based).
        """
        points, axes = self.setup.sweep(self.p, to, angles, self.tolerance)
        start = self.setup.before_turn(angles, self.p)
        length = float(np.linalg.norm(np.diff(np.vstack([start, points]), axis=0), axis=1).sum())
        if self.feed_mode == "minute":
            self.out.warn_once("feeds of blocks that turn a rotary axis are taken along the tip's way", line)
        feed = self.feed_mm_min(length, line)
        for (x, y, z), (i, j, k) in zip(points.tolist(), axes.tolist(), strict=True):
            self.out.add((x, y, z), (i, j, k), MoveKind.CUT, feed, line)
        self.p, self.axis, self.lost = to, self.setup.tool_axis(), [""] * 3
