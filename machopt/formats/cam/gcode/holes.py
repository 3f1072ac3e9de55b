"""Drilling cycles of G-code and Sinumerik, carried out at the holes they are called for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.toolpath import Move
from machopt.formats.cam.gcode.arcmotion import ArcReader
from machopt.formats.cam.gcode.blocks import Block
from machopt.formats.cam.gcode.cycles import Canned
from machopt.formats.cam.gcode.state import AXES
from machopt.formats.holecycle import CycleError, HoleCycle, drill

_Z = (0.0, 0.0, 1.0)
_PARALLEL = 1.0 - 1e-6  # cosine: the tool stands along the program's z


class HoleReader(ArcReader):
    """Canned cycles, modal cycle calls and their holes."""

    def along_z(self) -> bool:
        """True where the tool stands along the program's z axis."""
        z = self.setup.direction(_Z)
        return sum(a * b for a, b in zip(self.axis, z, strict=True)) > _PARALLEL

    def begin_cycle(self, code: int, b: Block) -> None:
        if code in (76, 77, 87, 88):
            self.out.warn_once(f"G{code} is read as a plain boring stroke", b.line)
        if self.plane[2] != 1.0:
            raise self.source.error(f"G{code} outside of G17 drills along another axis: not supported", b.line)
        if self.canned is None:
            if math.isnan(self.p[2]):
                raise self.source.error(self.setup.nowhere or f"G{code} begins where Z is not known", b.line)
            self.canned = Canned(initial=self.p[2])
        self.canned.code = code

    def depth_axis(self) -> int:
        """Index of the axis that cycles drill along: the normal of the working plane."""
        return int(np.argmax(np.abs(self.plane)))

    def cycle_of_block(self, words: dict[str, float], b: Block) -> HoleCycle | None:
        if self.canned is None:
            return self.modal_call
        c = self.canned
        if not self.along_z():
            raise self.source.error(f"G{c.code} with a tool that does not stand along Z is not supported", b.line)
        c.take(words, b, self.scale, incremental=self.incremental)
        for letter in "IJK":
            if letter in words and letter != "K":
                self.out.ignore(f"{letter} in a cycle", b.line, understood=False)
                words.pop(letter)
        if c.z is None and c.r is None and not words:
            return None
        if c.code in (73, 83) and not c.q > 0.0:
            self.out.warn_once(f"G{c.code} without a peck depth Q above zero: one stroke", b.line)
        return c.at_hole(back_to_initial=self.back_to_initial)

    def holes(self, cycle: HoleCycle, words: dict[str, float], target: list[float] | None, b: Block) -> None:
        """The hole of this block, and its repeats."""
        why = self.setup.why_unknown()
        if why:
            raise self.source.error(why, b.line)
        if not self.along_z():
            raise self.source.error(f"{cycle.name} with a tool that does not stand along Z is not supported", b.line)
        if math.isnan(cycle.feed):
            if self.feed_mode == "inverse":
                raise self.source.error(
                    f"{cycle.name} under G93: a cycle's feed is no time for a block; G94 before it", b.line
                )
            cycle = replace(cycle, feed=self.feed_mm_min(0.0, b.line))
        if abs(self.setup.height_factor - 1.0) > 1e-9:
            raise self.source.error(
                f"{cycle.name} under a scaling or mirroring of Z: which of its heights it changes depends on the "
                "control; post the hole as G0 and G1",
                b.line,
            )
        self.end_contour("a drilling cycle follows")
        repeats = 1
        for letter in ("L", "K"):
            if letter in words:
                repeats = round(words.pop(letter))
        if repeats > 10_000:
            raise CycleError(f"{repeats} repeats of one cycle; the limit is 10000")
        along = self.depth_axis()
        place = self.p if target is None else target
        across = [k for k in range(3) if k != along]
        if any(math.isnan(place[k]) for k in across):
            raise self.source.error(
                f"a drilling cycle where {' or '.join(AXES[k] for k in across)} is not known", b.line
            )
        step = [place[k] - self.p[k] if self.incremental and k != along else 0.0 for k in range(3)]
        normal = self.setup.direction((float(along == 0), float(along == 1), float(along == 2)))
        for n in range(repeats):
            hole = [0.0 if k == along else place[k] + n * step[k] for k in range(3)]
            before = None
            if not any(math.isnan(v) for v in self.p):
                before = self.setup.point((self.p[0], self.p[1], self.p[2]))
            height = drill(self.out, cycle, self.setup.point((hole[0], hole[1], hole[2])), normal, b.line, before)
            hole[along] = height
            self.p, self.lost = hole, [""] * 3
        if self.once == b.line:
            self.modal_call = None

    def straight(self, points: Array, feed: float, line: int) -> None:
        """Cuts through (N, 3) programmed points one after the other."""
        for x, y, z in points.tolist():
            self.go([x, y, z], self.setup.tool_axis(), Move.CUT, feed, line)
