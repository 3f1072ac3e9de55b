"""Motion of one block: rotary words and tool vectors, then the straight move, arc or hole."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.path_building.point_collector import Vector
from machopt.path_building.rotary_moves import compute_start_angle
from machopt.toolpath.readers.gcode.drilling_moves import DrillingMoveReader
from machopt.toolpath.readers.gcode.geometry.contour_corners import ContourCorner, CornerKind
from machopt.toolpath.readers.gcode.geometry.coordinate_setup import list_turned_angles
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock

_TURNED = 1e-9  # deg
THROUGH, TANGENTIAL, TAP = 4, 5, 6  # CIP, CT and G33.1, besides the motions 0 … 3 of G0 … G3
CORNERS: dict[str, CornerKind] = {"RND": "round", "CHR": "setback", "CHF": "length", ",R": "round", ",C": "setback"}


class BlockMotionReader(DrillingMoveReader):
    """Carries out what the words of a block move."""

    def move(self, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out the motion of one block.

        Args:
            words: Words of the block: letter or name → number; may be changed in place.
            b: The block: its words, calls and line number.

        Raises:
            InputError: the words describe no supported motion, or its position in the workpiece is not known.
        """
        self.turned_from = self.axis_before_turn = None
        vector = self.vector(words, b)
        turns = vector is None and self.turn(words, b)
        polar = bool(b.named.keys() & {"AP", "RP"})
        target = self.target(words, b)
        has_point = target is not None
        cycle = self.cycle_of_block(words, b)
        if cycle is not None and (has_point or self.once == b.line):
            self.holes(cycle, words, target, b)
            return
        arc_words = bool(words.keys() & set("IJKR") or b.named.keys() & {"CR", "AR"})
        if "AR" in b.named and (self.motion not in (2, 3) or polar):
            raise self.source.build_error(
                "AR= is the opening angle of a G2 or G3 by its end or its centre; found neither", b.line
            )
        arc_only = self.motion in (2, 3) and arc_words
        moves_tip = turns and (self.setup.tcp or self.setup.by_machine)
        if not (has_point or arc_only or vector is not None or moves_tip):
            self.take_corner(b, element=False)
            self.report_unused_words(words, b)
            return
        if self.motion is None:
            raise self.source.build_error("moves before any G0, G1, G2 or G3 was given", b.line)
        to = list(self.p) if target is None else target
        why = self.setup.describe_unknown_place()
        if why:
            self.not_known(why, to, target, b.line)
            return
        axis = self.setup.tool_axis() if vector is None else vector
        if self.motion in (2, 3, THROUGH, TANGENTIAL) and self.turned_from is not None and self.setup.by_machine:
            raise self.source.build_error("an arc that turns a rotary axis without tool-centre-point control", b.line)
        if self.motion == 0:
            self.go(to, axis, MoveKind.RAPID, math.nan, b.line)
        elif self.motion == 1:
            self.cut(to, axis, b.line)
        elif self.motion == THROUGH:
            self.through(to, axis, b)
        elif self.motion == TANGENTIAL:
            self.tangential(to, axis, b.line)
            self.motion = TANGENTIAL
        elif self.motion == TAP:
            self.tap(to, axis, words, b.line)
        elif polar and not arc_words:
            self.about_the_pole(to, axis, b)
        else:
            self.arc(to, axis, words, b)
        self.take_corner(b, element=self.motion != 0)
        self.report_unused_words(words, b)

    def tap(self, to: list[float], axis: Vector, words: dict[str, float], line: int) -> None:
        """Carry out G33.1: to the target and back to the start, K of travel per spindle turn.

        Args:
            to: Target position in programmed coordinates, mm.
            axis: Tool axis in programmed coordinates, unit vector.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            line: Line number in the file (1-based).

        Raises:
            InputError: K is not given, or the start is not known.
        """
        if not words.get("K"):
            raise self.source.build_error("G33.1 without K, the way a turn of the spindle", line)
        if any(map(math.isnan, self.p)):
            raise self.source.build_error("G33.1 goes back to its start, which is not known", line)
        start, modal = list(self.p), (self.feed, self.feed_scale, self.feed_mode)
        self.feed, self.feed_scale = abs(words.pop("K")) * self.scale * self.rpm / self.feed_unit, self.feed_unit
        self.feed_mode = "minute"
        self.cut(to, axis, line)
        self.cut(start, axis, line)
        self.feed, self.feed_scale, self.feed_mode = modal

    def take_corner(self, b: ProgramBlock, *, element: bool) -> None:
        """Read a corner: RND=, CHF=, CHR=, ``,R`` or ``,C`` between this element and the next one.

        Args:
            b: The block: its words, calls and line number.
            element: Whether the block holds a contour element.

        Raises:
            InputError: the size is not positive, or the block has no contour element.
        """
        feed = None
        for name in ("FRCM", "FRC"):
            if name in b.named:
                feed = b.named[name] * self.feed_unit
                if name == "FRCM":
                    self.corner_feed = feed or None
        if "RNDM" in b.named:
            size = b.named["RNDM"] * self.scale
            self.modal_corner = ContourCorner("round", size, b.line, self.corner_feed, stays=True) if size else None
        for name, kind in CORNERS.items():
            size = b.named.get(name, 0.0) * self.scale
            if size < 0.0:
                raise self.source.build_error(f"{name.strip(',')} of {size:g} mm; expected a size above zero", b.line)
            if size:
                if not element:
                    raise self.source.build_error(f"{name} without a contour element in its block", b.line)
                self.corner = ContourCorner(kind, size, b.line, feed or self.corner_feed)

    def not_known(self, why: str, to: list[float], target: list[float] | None, line: int) -> None:
        """Handle a move whose position in the workpiece is not known: rapids are left out, cuts are refused.

        Args:
            why: Reason, for the message.
            to: Target position in programmed coordinates, mm.
            target: Target of the block in programmed mm, None where it has no X, Y or Z.
            line: Line number in the file (1-based).

        Raises:
            InputError: the move is a cut.
        """
        if self.motion != 0:
            raise self.source.build_error(why, line)
        for k in range(3):
            if target is None or not math.isnan(to[k]):
                self.p[k], self.lost[k] = math.nan, "with turned rotary axes"
        self.out.ignore("rapid with turned rotary axes and no tool-centre-point control", line, understood=True)

    def report_unused_words(self, words: dict[str, float], b: ProgramBlock) -> None:
        """Report the words of a block that nothing has used.

        Args:
            words: Words of the block: letter or name → number.
            b: The block: its words, calls and line number.
        """
        for letter in words:
            unused = letter in "RIJK" and self.motion in (0, 1) and self.canned is None and self.modal_call is None
            if letter not in "XYZABCIJKRPLQ" or letter in "PLQ" or unused:
                self.out.ignore(letter, b.line, understood=False)

    def vector(self, words: dict[str, float], b: ProgramBlock) -> Vector | None:
        """Read the tool vector of a block.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Returns:
            Tool axis as a unit vector, None where the block has no vector.

        Raises:
            InputError: the vector is zero or not finite, or TRAORI is not active.
        """
        named = [b.named.get(n) for n in ("A3", "B3", "C3")]
        if any(v is not None for v in named):
            if self.setup.tcp is None:
                raise self.source.build_error("a tool vector (A3=, B3=, C3=) outside of TRAORI", b.line)
            i, j, k = (v or 0.0 for v in named)
        elif self.setup.tcp == "vector" and self.motion in (0, 1) and words.keys() & set("IJK"):
            i, j, k = (words.pop(c, 0.0) for c in "IJK")
        else:
            return None
        self.rotary_words = True
        length = math.sqrt(i * i + j * j + k * k)
        if not 1e-6 < length < 1e9:
            raise self.source.build_error("the tool vector is zero or not finite", b.line)
        vector = self.setup.direction((i / length, j / length, k / length))
        self.setup = self.setup.with_changes(vector=vector)
        return vector

    def turn(self, words: dict[str, float], b: ProgramBlock) -> bool:
        """Read the rotary words of a block.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Returns:
            Whether the block has rotary words.
        """
        self.turned_from, self.axis_before_turn = None, self.axis
        given: dict[str, float] = {}
        before_turn = dict(self.setup.angles)
        for letter in "ABC":
            if letter in words:
                value = words.pop(letter)
                relative = self.incremental if letter not in b.modes else b.modes[letter] == "IC"
                at = self.setup.angles.get(letter, 0.0)
                given[letter] = value + (at if relative else 0.0)
                mode = "DC" if self.shortest_turns else b.modes.get(letter, "")
                before_turn[letter] = compute_start_angle(at, given[letter], mode)
        if not given:
            return False
        self.rotary_words = True
        if any(abs(v - before_turn[c]) > _TURNED for c, v in given.items()):
            self.turned_from = before_turn
        before = self.setup.transfer
        self.setup = self.setup.turn_rotary_axes(given)
        self.setup.check_letters(b.line)
        self.follow_turn(before)
        return True

    def compare_rotary_signs(self) -> None:
        """Plunges run along the tool axis: say so where they do only with the other sign of the angles."""
        machine = self.setup.machine
        if machine is None or not self.plunges:
            return
        if machine.name == "three-axis":
            return
        other = machine.turning_the_other_way()
        p, move = self.out.positions(), self.out.moves()
        chosen = opposite = 0
        for k, angles in self.plunges:
            if move[k - 1] != MoveKind.RAPID or not list_turned_angles(angles):
                continue
            step = p[k] - p[k - 1]
            length = float(np.linalg.norm(step))
            a, o = np.array(machine.tool_axis(angles)), np.array(other.tool_axis(angles))
            if length < 0.1 or float(a @ o) > math.cos(math.radians(5.0)):
                continue
            chosen += bool(-(step @ a) > 0.999 * length)
            opposite += bool(-(step @ o) > 0.999 * length)
        self.out.meta["plunges_along_axis"] = f"{chosen} with {machine.name}, {opposite} with {other.name}"
        if opposite > 2 * chosen:
            self.out.warn(
                f"{opposite} plunges run along the tool axis of machine {other.name}, {chosen} along that of "
                f"{machine.name}: the rotary signs may be the other way round"
            )
