"""Where a control's program moves the tool: straight moves, arcs, tool-centre-point control, drilling cycles.

The state both G-code and Heidenhain's conversational programs keep; the readers set it word by word.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.domain.toolpath import Array, Move
from machopt.formats import rotary
from machopt.formats.arcs import RADIUS_WARN, ArcError, arc, from_radius
from machopt.formats.gcode_blocks import Block
from machopt.formats.gcode_cycles import Canned
from machopt.formats.holecycle import CycleError, HoleCycle, drill
from machopt.formats.pathbuilder import PathBuilder, Vector, check_radius
from machopt.formats.rotary import Rotary
from machopt.formats.source import UNIT_NAMES, ReadOptions, Source

_Z = (0.0, 0.0, 1.0)
_AXES = "XYZ"


class MotionReader:
    """State of the control while a program is read, and what a block's coordinates do with it."""

    format = "gcode"
    once = 0  # line of a drilling cycle that is carried out in its own block

    def __init__(self, source: Source, options: ReadOptions, unit: str) -> None:
        self.source, self.options = source, options
        self.out = PathBuilder(source, options, self.format)
        self.machine = Rotary(options.machine) if options.machine else None
        self.tolerance = options.arc_tolerance * 1e3  # mm
        self.scale = UNIT_NAMES[unit]
        self.p: list[float] = [math.nan] * 3  # mm; NaN: not known
        self.lost = [False] * 3  # the machine's own frame was used since the coordinate was last known
        self.axis: Vector = _Z
        self.angles: dict[str, float] = {}
        self.tcp: str | None = None  # "angles" | "vector"
        self.motion: int | None = None
        self.plane = np.array(_Z)
        self.incremental, self.absolute_centre = False, False
        self.feed_mode, self.feed, self.rpm = "minute", math.nan, math.nan
        self.canned: Canned | None = None
        self.back_to_initial = True
        self.modal_call: HoleCycle | None = None
        self.last_feed = math.nan
        self.plunges: list[tuple[int, dict[str, float]]] = []

    # ---- motion

    def out_z(self) -> bool:
        return self.axis == _Z

    def lose(self, words: dict[str, float], name: str, line: int) -> None:
        """A move in the machine's frame: where the tip is in the workpiece is not known after it."""
        axes = [k for k in range(3) if _AXES[k] in words]
        if not axes and name in ("G53", "G153", "SUPA"):
            return  # suppresses an offset, moves nothing
        for k in axes or (range(3) if not words.keys() & set("ABC") else []):
            self.p[k], self.lost[k] = math.nan, True
        for letter in words.keys() & set("ABC"):
            self.angles[letter] = 0.0 if name in ("G28", "G30") else words[letter]
        self.out.ignore(f"{name} (move in the machine's frame)", line, understood=True)

    def move(self, words: dict[str, float], b: Block) -> None:
        vector = self.vector(words, b)
        turned = vector is None and self.turn(words, b)
        target = self.target(words, b)
        has_point = target is not None
        cycle = self.cycle_of_block(words, b)
        if cycle is not None and (has_point or self.once == b.line):
            self.holes(cycle, words, target, b)
            return
        centre = words.keys() & set("IJKR") or "CR" in b.named
        arc_only = self.motion in (2, 3) and bool(centre)
        axis = self.axis if vector is None else vector
        if not (has_point or arc_only or vector is not None or (turned and self.tcp)):
            self.leftovers(words, b)
            return
        if self.motion is None:
            raise self.source.error("moves before any G0, G1, G2 or G3 was given", b.line)
        to = list(self.p) if target is None else target
        tilted = any(abs(v) > 1e-9 for v in self.angles.values()) and self.tcp is None
        if tilted:
            if self.motion != 0:
                raise self.source.error(self.why_not_turned(), b.line)
            for k in range(3):
                if target is None or not math.isnan(to[k]):
                    self.p[k], self.lost[k] = math.nan, True
            self.out.ignore("rapid with turned rotary axes and no tool-centre-point control", b.line, understood=True)
            return
        if self.motion == 0:
            self.go(to, axis, Move.RAPID, math.nan, b.line)
        elif self.motion == 1:
            self.cut(to, axis, b.line, words)
        else:
            self.arc(to, axis, words, b)
        self.leftovers(words, b)

    def leftovers(self, words: dict[str, float], b: Block) -> None:
        for letter in words:
            if letter not in "XYZABCIJKRPLQ" or letter in "PLQ":
                self.out.ignore(letter, b.line, understood=False)

    def target(self, words: dict[str, float], b: Block) -> list[float] | None:
        """Where the block goes to (mm), None where it has no X, Y or Z."""
        if not ("X" in words or "Y" in words or "Z" in words):
            return None
        to = list(self.p)
        for k, letter in enumerate(_AXES):
            if letter in words:
                value = words[letter] * self.scale
                if self.incremental if letter not in b.modes else b.modes[letter] == "IC":
                    if math.isnan(to[k]):
                        if self.lost[k]:
                            raise self.source.error(
                                f"incremental {letter} after a move in the machine's frame: its start is not known",
                                b.line,
                            )
                        self.out.warn_once("the first incremental moves start from 0", b.line)
                        to[k] = 0.0
                    value += to[k]
                to[k] = value
        return to

    def go(self, to: list[float], axis: Vector, move: int, feed: float, line: int) -> None:
        for k in range(3):
            if not math.isnan(to[k]):
                self.lost[k] = False
            elif move == Move.CUT and self.lost[k]:
                raise self.source.error(
                    f"cuts while {_AXES[k]} is not known: it was last moved in the machine's frame (G53, G28 …)", line
                )
        self.p, self.axis = to, axis
        self.out.add((to[0], to[1], to[2]), axis, move, feed, line)

    def cut(self, to: list[float], axis: Vector, line: int, words: dict[str, float]) -> None:
        length = math.dist(to, self.p)
        if self.tcp and self.angles and len(self.out):
            self.plunges.append((len(self.out), dict(self.angles)))
        self.go(to, axis, Move.CUT, self.feed_mm_min(length, line), line)

    def feed_mm_min(self, length: float, line: int) -> float:
        if self.feed_mode == "minute":
            return self.feed * self.scale
        if self.feed_mode == "revolution":
            return self.feed * self.rpm * self.scale
        feed = self.feed * length  # G93: F is 1/min for the block
        if not (math.isfinite(feed) and feed > 1e-6):
            if math.isnan(self.feed) or math.isnan(self.last_feed):
                return math.nan
            self.out.warn_once("G93 blocks without travel of the tip keep the feed before them", line)
            return self.last_feed
        self.last_feed = feed
        return feed

    def arc(self, to: list[float], axis: Vector, words: dict[str, float], b: Block) -> None:
        start = np.array(self.p)
        if np.isnan(start).any():
            names = "".join(_AXES[k] for k in range(3) if math.isnan(self.p[k]))
            plane_needs = [k for k in range(3) if self.plane[k] == 0.0 and math.isnan(self.p[k])]
            if plane_needs:
                raise self.source.error(f"an arc starts where {names} is not known", b.line)
            start = np.nan_to_num(start)
        end = np.where(np.isnan(to), start, to)
        normal = self.plane * (1.0 if self.motion == 3 else -1.0)
        radius = b.named.get("CR", words.get("R"))
        turns = max(round(words.get("P", 1.0)), 1) + round(b.named.get("TURN", 0.0))
        words.pop("P", None)
        if radius is not None:
            centre = from_radius(start, end, radius * self.scale, normal)
        else:
            offsets = np.array([words.get(c, math.nan) for c in "IJK"]) * self.scale
            if np.isnan(offsets).all():
                raise ArcError("an arc without I, J, K or R; they hold for one block only")
            centre = self.centre(start, end, offsets, b)
        found = arc(start, end, centre, normal, self.tolerance, turns=turns)
        check_radius(found, b.line, self.out)
        points = found.points
        unknown = np.isnan(np.array(self.p))
        if unknown.any():
            points = np.where(unknown, np.nan, points)
        length = found.sweep * found.radius
        feed = self.feed_mm_min(math.hypot(length, float((end - start) @ self.plane)), b.line)
        self.out.add_arc(points, axis, Move.CUT, feed, b.line, axis_before=self.axis)
        x, y, z = points[-1].tolist()
        self.p, self.axis = [x, y, z], axis

    def centre(self, start: Array, end: Array, offsets: Array, b: Block) -> Array:
        """Centre from I, J, K; absolute only where they fit that way and not the usual one."""
        relative = start + np.nan_to_num(offsets)
        absolute = np.where(np.isnan(offsets), start, offsets)
        first, second = (absolute, relative) if self.absolute_centre else (relative, absolute)
        flat = 1.0 - np.abs(self.plane)

        def mismatch(c: Array) -> float:
            r0, r1 = float(np.linalg.norm((start - c) * flat)), float(np.linalg.norm((end - c) * flat))
            return abs(r0 - r1)

        if mismatch(first) > RADIUS_WARN and mismatch(second) <= RADIUS_WARN:
            self.out.warn_once(
                f"I, J, K fit only as {'offsets' if self.absolute_centre else 'absolute'} centres; read that way",
                b.line,
            )
            return second
        return first

    # ---- tool axis

    def vector(self, words: dict[str, float], b: Block) -> Vector | None:
        named = [b.named.get(n) for n in ("A3", "B3", "C3")]
        if any(v is not None for v in named):
            if self.tcp is None:
                raise self.source.error("a tool vector (A3=, B3=, C3=) outside of TRAORI", b.line)
            i, j, k = (v or 0.0 for v in named)
        elif self.tcp == "vector" and self.motion in (0, 1) and words.keys() & set("IJK"):
            i, j, k = (words.pop(c, 0.0) for c in "IJK")
        else:
            return None
        length = math.sqrt(i * i + j * j + k * k)
        if not length > 1e-6:
            raise self.source.error("the tool vector is zero", b.line)
        return (i / length, j / length, k / length)

    def turn(self, words: dict[str, float], b: Block) -> bool:
        """Take the rotary words; True where the block has any."""
        given = [c for c in "ABC" if c in words]
        for letter in given:
            value = words.pop(letter)
            relative = self.incremental if letter not in b.modes else b.modes[letter] == "IC"
            self.angles[letter] = value + (self.angles.get(letter, 0.0) if relative else 0.0)
        if self.tcp == "angles" and (given or self.angles):
            self.axis = self.axis_of_angles(b.line)
        return bool(given)

    def axis_of_angles(self, line: int) -> Vector:
        turned = {c: v for c, v in self.angles.items() if abs(v) > 1e-9}
        if not turned:
            return _Z
        if self.machine is None:
            raise self.source.error(
                f"rotary words ({', '.join(sorted(turned))}) under tool-centre-point control: the tool axis depends on "
                f"the machine; give --machine, one of {rotary.HELP}",
                line,
            )
        strange = sorted(turned.keys() - set(self.machine.letters))
        if strange:
            raise self.source.error(f"rotary word {strange[0]} but machine {self.machine.name} has no such axis", line)
        return self.machine.tool_axis(self.angles)

    def why_not_turned(self) -> str:
        angles = " ".join(f"{c}{v:g}" for c, v in sorted(self.angles.items()))
        return (
            f"cuts with turned rotary axes ({angles}) and without tool-centre-point control: X, Y, Z are then the "
            "machine's, and its pivot lengths are not in the file. Post it with G43.4, G234, TRAORI or M128, or export "
            "APT/CL data"
        )

    def compare_rotary_signs(self) -> None:
        """Plunges run along the tool axis: say so where they do only with the other sign of the angles."""
        if self.machine is None or not self.plunges:
            return
        other = Rotary(
            self.machine.name.removesuffix("-reversed")
            if self.machine.sign < 0.0
            else self.machine.name.replace("head", "table").replace("mixed", "table") + "-reversed"
        )
        p, move = self.out.positions(), self.out.moves()
        chosen = opposite = 0
        for k, angles in self.plunges:
            if move[k - 1] != Move.RAPID:
                continue
            step = p[k] - p[k - 1]
            length = float(np.linalg.norm(step))
            a, o = np.array(self.machine.tool_axis(angles)), np.array(other.tool_axis(angles))
            if length < 0.1 or float(a @ o) > math.cos(math.radians(5.0)):
                continue
            chosen += bool(-(step @ a) > 0.999 * length)
            opposite += bool(-(step @ o) > 0.999 * length)
        self.out.meta["plunges_along_axis"] = f"{chosen} with {self.machine.name}, {opposite} with {other.name}"
        if opposite > 2 * chosen:
            self.out.warn(
                f"{opposite} plunges run along the tool axis of machine {other.name}, {chosen} along that of "
                f"{self.machine.name}: the rotary signs may be the other way round"
            )

    # ---- cycles

    def begin_cycle(self, code: int, b: Block) -> None:
        if code in (76, 87, 88):
            self.out.warn_once(f"G{code} is read as a plain boring stroke", b.line)
        if self.canned is None:
            if math.isnan(self.p[2]):
                raise self.source.error(f"G{code} begins where Z is not known", b.line)
            self.canned = Canned(initial=self.p[2])
        self.canned.code = code

    def cycle_of_block(self, words: dict[str, float], b: Block) -> HoleCycle | None:
        if self.canned is None:
            return self.modal_call
        c = self.canned
        if not self.out_z():
            raise self.source.error(f"G{c.code} with a tilted tool axis is not supported", b.line)
        if "R" in words:
            c.r = words.pop("R") * self.scale + (c.initial if self.incremental else 0.0)
        if "Z" in words:
            c.z = words.pop("Z") * self.scale + ((c.r or 0.0) if self.incremental else 0.0)
        if "Q" in words:
            c.q = abs(words.pop("Q")) * self.scale
        if "P" in words:
            p = words.pop("P")
            c.dwell = p / 1e3 if "P" in b.integers and p >= 100.0 else p
        for letter in "IJK":
            if letter in words and letter != "K":
                self.out.ignore(f"{letter} in a cycle", b.line, understood=False)
                words.pop(letter)
        if c.z is None and c.r is None and not words:
            return None
        feed = self.feed * self.scale * (self.rpm if self.feed_mode == "revolution" else 1.0)
        return c.at_hole(back_to_initial=self.back_to_initial, feed=feed)

    def holes(self, cycle: HoleCycle, words: dict[str, float], target: list[float] | None, b: Block) -> None:
        if math.isnan(cycle.feed):
            cycle = HoleCycle(**{**cycle.__dict__, "feed": self.feed * self.scale})
        repeats = 1
        for letter in ("L", "K"):
            if letter in words:
                repeats = round(words.pop(letter))
        if repeats > 10_000:
            raise CycleError(f"{repeats} repeats of one cycle; the limit is 10000")
        x, y = (self.p[0], self.p[1]) if target is None else (target[0], target[1])
        if math.isnan(x) or math.isnan(y):
            raise self.source.error("a drilling cycle where X or Y is not known", b.line)
        dx, dy = (x - self.p[0], y - self.p[1]) if self.incremental else (0.0, 0.0)
        for n in range(repeats):
            hole = (x + n * dx, y + n * dy, 0.0)
            before = None if any(math.isnan(v) for v in self.p) else (self.p[0], self.p[1], self.p[2])
            after = drill(self.out, cycle, hole, _Z, b.line, before)
            self.p, self.lost = list(after), [False] * 3
        if self.once == b.line:
            self.modal_call = None
