"""Where a control's program moves the tool: straight moves, arcs, tool-centre-point control, drilling cycles.

The state both G-code and Heidenhain's conversational programs keep; the readers set it word by word. ``p`` is what
the program says, ``setup`` brings it into the workpiece.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.domain.toolpath import Array, Move
from machopt.formats import rotary
from machopt.formats.arcs import arc
from machopt.formats.cam.gcode.arcs import Centres
from machopt.formats.cam.gcode.blocks import Block
from machopt.formats.cam.gcode.cycles import Canned
from machopt.formats.cam.gcode.setup import Setup, turned
from machopt.formats.frames import Transfer
from machopt.formats.holecycle import CycleError, HoleCycle, drill
from machopt.formats.pathbuilder import PathBuilder, Vector, check_radius
from machopt.formats.source import UNIT_NAMES, ReadOptions, Source

_Z = (0.0, 0.0, 1.0)
_AXES = "XYZ"
_PARALLEL = 1.0 - 1e-6  # cosine: the tool stands along the program's z


class MotionReader:
    """State of the control while a program is read, and what a block's coordinates do with it."""

    format = "gcode"
    once = 0  # line of a drilling cycle that is carried out in its own block

    def __init__(self, source: Source, options: ReadOptions, unit: str) -> None:
        self.source, self.options = source, options
        self.out = PathBuilder(source, options, self.format)
        self.setup = Setup(rotary.machine(options.machine) if options.machine else None, self.out)
        self.tolerance = options.arc_tolerance * 1e3  # mm
        self.scale = UNIT_NAMES[unit]
        self.p: list[float] = [math.nan] * 3  # mm, as programmed; NaN: not known
        self.lost = [""] * 3  # what made a coordinate unknown since it was last programmed (G53, G28 …)
        self.axis: Vector = _Z  # in the workpiece
        self.motion: int | None = None
        self.plane = np.array(_Z)
        self.incremental = False
        self.centres = Centres(self.out)
        self.feed_mode, self.feed, self.rpm = "minute", math.nan, math.nan
        self.canned: Canned | None = None
        self.back_to_initial = True
        self.modal_call: HoleCycle | None = None
        self.last_feed = math.nan
        self.plunges: list[tuple[int, dict[str, float]]] = []

    # ---- coordinate systems

    def change_setup(self, **changes: object) -> None:
        """Another coordinate system, tilted plane or mode: the tool does not move, its coordinates change."""
        before = self.setup.transfer
        self.setup = self.setup.changed(**changes)
        self.follow(before)

    def follow(self, before: Transfer | None) -> None:
        """Coordinates of the same place after ``setup`` changed from ``before``."""
        self.axis = self.setup.tool_axis()
        if before is None and self.setup.transfer is None:
            return
        p, each_by_itself = self.setup.carried_over(before, self.p)
        for k in range(3):
            if math.isnan(p[k]) and not each_by_itself:
                self.lost[k] = self.lost[k] or "before the coordinate system turned"
        self.p = p

    def lose(self, words: dict[str, float], name: str, line: int) -> None:
        """A move in the machine's frame: where the tip is in the workpiece is not known after it."""
        axes = [k for k in range(3) if _AXES[k] in words]
        if not axes and name in ("G53", "G153", "SUPA"):
            return  # suppresses an offset, moves nothing
        if axes and self.setup.rotated and not self.setup.by_machine:
            axes = self.setup.moved_by_machine_z() if axes == [2] else [0, 1, 2]
        for k in axes or (range(3) if not words.keys() & set("ABC") else []):
            self.p[k], self.lost[k] = math.nan, name
        angles = {c: 0.0 if name in ("G28", "G30") else words[c] for c in words.keys() & set("ABC")}
        if angles:
            before = self.setup.transfer
            self.setup = self.setup.turned_to(angles)
            self.follow_turn(before)
        self.out.ignore(f"{name} (move in the machine's frame)", line, understood=True)

    def follow_turn(self, before: Transfer | None) -> None:
        """Rotary axes moved: without tool-centre-point control the programmed coordinates stay what they are."""
        self.axis = self.setup.tool_axis()
        if self.setup.tcp or self.setup.tilted:
            self.follow(before)

    # ---- motion

    def move(self, words: dict[str, float], b: Block) -> None:
        vector = self.vector(words, b)
        angles = dict(self.setup.angles)
        turns = vector is None and self.turn(words, b)
        target = self.target(words, b)
        has_point = target is not None
        cycle = self.cycle_of_block(words, b)
        if cycle is not None and (has_point or self.once == b.line):
            self.holes(cycle, words, target, b)
            return
        arc_only = self.motion in (2, 3) and bool(words.keys() & set("IJKR") or "CR" in b.named)
        moves_tip = turns and (self.setup.tcp or self.setup.by_machine)
        if not (has_point or arc_only or vector is not None or moves_tip):
            self.leftovers(words, b)
            return
        if self.motion is None:
            raise self.source.error("moves before any G0, G1, G2 or G3 was given", b.line)
        to = list(self.p) if target is None else target
        why = self.setup.why_unknown()
        if why:
            self.not_known(why, to, target, b.line)
            return
        axis = self.setup.tool_axis() if vector is None else vector
        if self.motion == 0:
            self.go(to, axis, Move.RAPID, math.nan, b.line)
        elif self.motion == 1:
            self.cut(to, axis, b.line, angles if turns else None)
        else:
            self.arc(to, axis, words, b)
        self.leftovers(words, b)

    def not_known(self, why: str, to: list[float], target: list[float] | None, line: int) -> None:
        """A move whose place in the workpiece cannot be told: rapids are left out, cuts refused."""
        if self.motion != 0:
            raise self.source.error(why, line)
        for k in range(3):
            if target is None or not math.isnan(to[k]):
                self.p[k], self.lost[k] = math.nan, "with turned rotary axes"
        self.out.ignore("rapid with turned rotary axes and no tool-centre-point control", line, understood=True)

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
        """One point at ``to`` (programmed coordinates)."""
        for k in range(3):
            if not math.isnan(to[k]):
                self.lost[k] = ""
            elif move == Move.CUT and (self.lost[k] or self.setup.rotated):
                raise self.source.error(f"cuts while {_AXES[k]} is not known{self.how_lost(k)}", line)
        self.p, self.axis = to, axis
        if self.setup.rotated and any(map(math.isnan, to)):
            self.out.ignore("rapid in a tilted plane while a coordinate is not known", line, understood=True)
            return
        self.out.add(self.setup.point((to[0], to[1], to[2])), axis, move, feed, line)

    def how_lost(self, k: int) -> str:
        name = self.lost[k]
        if name in ("G53", "G153", "SUPA"):
            return (
                f": {name} moves in the machine's frame. Where the post writes G53 for its fixture offset 0, set the "
                "operation's fixture offset to 1 (G54) and post again, or give --offset G53=0,0,0"
            )
        if name.startswith(("G", "M")):
            return f": {name} moved it in the machine's frame, and the program does not say where it went"
        return f": it was not programmed {name}" if name else ""

    def cut(self, to: list[float], axis: Vector, line: int, angles: dict[str, float] | None = None) -> None:
        """A straight cut; ``angles`` are those before it where the block turns a rotary axis."""
        length = math.dist(to, self.p)
        if angles is not None and self.setup.by_machine and not any(map(math.isnan, (*to, *self.p))):
            self.swept_cut(to, angles, line)
            return
        if self.setup.tcp and self.setup.angles and len(self.out):
            self.plunges.append((len(self.out), dict(self.setup.angles)))
        self.go(to, axis, Move.CUT, self.feed_mm_min(length, line), line)

    def swept_cut(self, to: list[float], angles: dict[str, float], line: int) -> None:
        """Linear and rotary axes at once without tool-centre-point control: the tip's way is curved."""
        points, axes = self.setup.sweep(self.p, to, angles, self.tolerance)
        start = self.setup.before_turn(angles, self.p)
        length = float(np.linalg.norm(np.diff(np.vstack([start, points]), axis=0), axis=1).sum())
        if self.feed_mode == "minute":
            self.out.warn_once("feeds of blocks that turn a rotary axis are taken along the tip's way", line)
        feed = self.feed_mm_min(length, line)
        for (x, y, z), (i, j, k) in zip(points.tolist(), axes.tolist(), strict=True):
            self.out.add((x, y, z), (i, j, k), Move.CUT, feed, line)
        self.p, self.axis, self.lost = to, self.setup.tool_axis(), [""] * 3

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
        unknown = [math.isnan(v) for v in self.p]
        if any(unknown):
            needed = [_AXES[k] for k in range(3) if unknown[k] and (self.plane[k] == 0.0 or self.setup.rotated)]
            if needed:
                hint = "; a turning program (X and Z only) holds no milling path" if needed == ["Y"] else ""
                raise self.source.error(f"an arc starts where {''.join(needed)} is not known{hint}", b.line)
        start = np.array([0.0 if math.isnan(v) else v for v in self.p])
        end = np.array([a if math.isnan(b) else b for a, b in zip(start.tolist(), to, strict=True)])
        normal = self.plane * (1.0 if self.motion == 3 else -1.0)
        radius = b.named.get("CR", words.get("R"))
        turns = max(round(words.get("P", 1.0)), 1) + round(b.named.get("TURN", 0.0))
        words.pop("P", None)
        if radius is not None:
            centre = self.centres.by_radius(start, end, radius * self.scale, normal)
        else:
            offsets = np.array([words.get(c, math.nan) for c in "IJK"]) * self.scale
            if np.isnan(offsets).all():
                centre = self.centres.without_any(start, end, normal, b.line)
            else:
                centre = self.centres.by_offsets(start, end, offsets, normal, b.line)
        found = arc(start, end, centre, normal, self.tolerance, turns=turns)
        check_radius(found, b.line, self.out)
        length = found.sweep * found.radius
        feed = self.feed_mm_min(math.hypot(length, float((end - start) @ self.plane)), b.line)
        points = np.where(unknown, np.nan, found.points) if any(unknown) else found.points
        self.out.add_arc(self.setup.points(points), axis, Move.CUT, feed, b.line, axis_before=self.axis)
        x, y, z = points[-1].tolist()
        self.p, self.axis = [x, y, z], axis
        for k in range(3):
            self.lost[k] = self.lost[k] if math.isnan(self.p[k]) else ""

    # ---- tool axis

    def vector(self, words: dict[str, float], b: Block) -> Vector | None:
        named = [b.named.get(n) for n in ("A3", "B3", "C3")]
        if any(v is not None for v in named):
            if self.setup.tcp is None:
                raise self.source.error("a tool vector (A3=, B3=, C3=) outside of TRAORI", b.line)
            i, j, k = (v or 0.0 for v in named)
        elif self.setup.tcp == "vector" and self.motion in (0, 1) and words.keys() & set("IJK"):
            i, j, k = (words.pop(c, 0.0) for c in "IJK")
        else:
            return None
        length = math.sqrt(i * i + j * j + k * k)
        if not 1e-6 < length < 1e9:
            raise self.source.error("the tool vector is zero or not finite", b.line)
        vector = self.setup.direction((i / length, j / length, k / length))
        self.setup = self.setup.changed(vector=vector)
        return vector

    def turn(self, words: dict[str, float], b: Block) -> bool:
        """Take the rotary words; True where the block has any."""
        given: dict[str, float] = {}
        for letter in "ABC":
            if letter in words:
                value = words.pop(letter)
                relative = self.incremental if letter not in b.modes else b.modes[letter] == "IC"
                given[letter] = value + (self.setup.angles.get(letter, 0.0) if relative else 0.0)
        if not given:
            return False
        before = self.setup.transfer
        self.setup = self.setup.turned_to(given)
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
            if move[k - 1] != Move.RAPID or not turned(angles):
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

    # ---- cycles

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
                raise self.source.error(f"G{code} begins where Z is not known", b.line)
            self.canned = Canned(initial=self.p[2])
        self.canned.code = code

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
        feed = self.feed * self.scale * (self.rpm if self.feed_mode == "revolution" else 1.0)
        return c.at_hole(back_to_initial=self.back_to_initial, feed=feed)

    def holes(self, cycle: HoleCycle, words: dict[str, float], target: list[float] | None, b: Block) -> None:
        """The hole of this block, and its repeats."""
        why = self.setup.why_unknown()
        if why:
            raise self.source.error(why, b.line)
        if not self.along_z():
            raise self.source.error(f"{cycle.name} with a tool that does not stand along Z is not supported", b.line)
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
            before = None
            if not any(math.isnan(v) for v in self.p):
                before = self.setup.point((self.p[0], self.p[1], self.p[2]))
            height = drill(self.out, cycle, self.setup.point(hole), self.setup.direction(_Z), b.line, before)
            self.p, self.lost = [hole[0], hole[1], height], [""] * 3
        if self.once == b.line:
            self.modal_call = None

    def straight(self, points: Array, feed: float, line: int) -> None:
        """Cuts through (N, 3) programmed points one after the other."""
        for x, y, z in points.tolist():
            self.go([x, y, z], self.setup.tool_axis(), Move.CUT, feed, line)
