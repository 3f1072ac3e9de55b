"""Words that move or turn a program's coordinates: work offsets, G52, G92, G68, G68.2 with G53.1, Siemens frames."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from machopt.formats.cam.gcode.blocks import Block
from machopt.formats.cam.gcode.motion import MotionReader
from machopt.formats.cam.gcode.planes import cycle800, g68, g68_2, siemens_rot
from machopt.formats.frames import FrameError, Transfer
from machopt.formats.pathbuilder import Vector
from machopt.formats.source import ReadOptions, Source

_XYZ = "XYZ"
_DIRECTION = 13  # place of DIR in CYCLE800: 0 moves no axis


class FrameReader(MotionReader):
    """Carries out the words that change where the program's zero lies and how its axes run."""

    def __init__(self, source: Source, options: ReadOptions, unit: str) -> None:
        super().__init__(source, options, unit)
        self.work_offset: int | None = None
        self.first_offset: int | None = None
        self.shifts: dict[str, list[float]] = {}  # G52, G92, CYCL DEF 7 in mm
        self.g53_is_an_offset = "G53" in dict(options.offsets)  # as some posts mean it; told by the user only
        self.given_centres = self.setup.machine.centres if self.setup.machine else ()

    # ---- origins

    def use_offset(self, g: int, words: dict[str, float], line: int) -> None:
        """G54 … G59.3, G54.1 P, G505 …: another one than the first needs its place given."""
        number = g * 1000 + (round(words.pop("P", 0.0)) if g == 541 else 0)
        if self.first_offset is None and len(self.out):
            self.out.warn(f"points before {offset_name(number)} name no work offset; they are taken in the same", line)
        if self.first_offset is None or not len(self.out):
            self.first_offset = number
        if number != self.work_offset:
            self.take_offset(offset_name(number), offset_name(self.first_offset))
        self.work_offset = number
        self.out.meta["work_offset"] = offset_name(self.first_offset)

    def take_offset(self, name: str, first: str) -> None:
        """Coordinates from here on count from work offset ``name``; moves are refused where its place is not given."""
        places = dict(self.options.offsets)
        nowhere = ""
        offset = None
        if name != first:
            if name in places:
                origin = np.array(places[name]) - np.array(places.get(first, (0.0, 0.0, 0.0)))
                offset = Transfer.shift(*origin.tolist())
            else:
                nowhere = (
                    f"the work offset changes from {first} to {name}: how they lie to each other is not in the file; "
                    f"give it with --offset {name.replace(' ', '')}=X,Y,Z (its origin in {first}, mm), or split the "
                    "file, one offset in each"
                )
        if (self.setup.offset, self.setup.nowhere) != (None, "") or offset is not None or nowhere:
            lost = bool(nowhere or self.setup.nowhere)
            self.change_setup(offset=offset, nowhere=nowhere)
            if lost:
                self.p, self.lost = [math.nan] * 3, ["in the other work offset"] * 3

    def shift_origin(self, g: int, words: dict[str, float], line: int) -> None:
        """G52 and G92; G10 only before the path begins."""
        axes = [c for c in "XYZ" if c in words]
        name = f"G{g / 10:g}"
        if g == 100 and len(self.out) and words.keys() & set("XYZABC"):
            raise self.source.error(f"{name} changes offsets in the middle of the path: not supported", line)
        if words.keys() & set("ABC") and len(self.out):
            raise self.source.error(f"{name} shifts a rotary axis in the middle of the path: not supported", line)
        if g == 520 and axes:
            now = self.shifts.setdefault("G52", [0.0] * 3)
            for c in axes:
                now[_XYZ.index(c)] = words[c] * self.scale
            self.use_shifts()
        elif g == 920 and axes and len(self.out):
            if self.setup.local is not None or self.setup.by_machine:
                raise self.source.error("G92 in a turned coordinate system is not supported", line)
            now = self.shifts.setdefault("G92", [0.0] * 3)
            for c in axes:
                k = _XYZ.index(c)
                if math.isnan(self.p[k]):
                    raise self.source.error(f"G92 {c} where {c} is not known", line)
                now[k] += self.p[k] - words[c] * self.scale
            self.out.warn_once("G92 shifts the origin: points from here on are brought into the first system", line)
            self.use_shifts()
        elif g == 921 or (g == 922 and len(self.out)):
            self.shifts.pop("G92", None)
            self.use_shifts()
        else:
            self.out.ignore(name, line, understood=True)
        words.clear()

    def use_shifts(self) -> None:
        x, y, z = (sum(s[k] for s in self.shifts.values()) for k in range(3))
        if "G52" in self.shifts and (x, y, z) != (0.0, 0.0, 0.0):
            self.out.warn_once("G52 shifts the zero: points count from the work offset before the shift")
        self.change_setup(datum=(x, y, z))

    def dynamic_offset(self, *, on: bool) -> None:
        """G254 and G255 (Haas): the zero goes along with the table, so the part turns about the program's zero."""
        machine = self.setup.machine
        if machine is not None and machine.kind == "table":
            centres = ((0.0, 0.0, 0.0),) if on else self.given_centres
            self.change_setup(machine=dataclasses.replace(machine, centres=centres))

    # ---- planes

    def plane_word(self, g: int, words: dict[str, float], b: Block) -> None:
        """G68, G69, G68.2 with G53.1 or G53.6."""
        try:
            if g in (680, 682):
                origin = self.taken_point(words)
                plane = g68_2(words, origin) if g == 682 else g68(words, origin, self.plane_normal())
                self.tilt(plane, "not yet")
                words.clear()
            elif g in (531, 536):
                if not self.setup.tilted:
                    raise FrameError("G53.1 without a tilted plane (G68.2) before it")
                self.stand_upright()
            else:
                self.untilt()
        except FrameError as problem:
            raise self.source.error(str(problem), b.line) from problem

    def plane_normal(self) -> Vector:
        x, y, z = self.plane.tolist()
        return x, y, z

    def taken_point(self, words: dict[str, float]) -> Vector:
        x, y, z = (words.pop(c, 0.0) * self.scale for c in _XYZ)
        return x, y, z

    def tilt(self, plane: Transfer, tilted: str) -> None:
        """Coordinates from here on are those of ``plane``; a former one ends."""
        upright = abs(plane.z[2] - 1.0) < 1e-9
        self.change_setup(
            local=None if plane.nothing else plane,
            tilted="" if upright and tilted == "not yet" else tilted,
            stood_up=tilted == "aligned" and not upright,
        )
        self.out.meta["tilted_planes"] = str(int(self.out.meta.get("tilted_planes", "0")) + 1)

    def stand_upright(self) -> None:
        """The control puts the tool upright on the plane; where its rotary axes stand then is its own business."""
        self.change_setup(tilted="aligned", stood_up=True)

    def untilt(self) -> None:
        """Back to the untilted system; after a turn by the control the rotary axes' place is not known."""
        setup = self.setup
        moved = setup.stood_up and setup.transfer is not None and setup.transfer.z[2] < 1.0 - 1e-9
        angles = {} if moved else setup.angles
        self.change_setup(local=None, tilted="", stood_up=False, unaligned=moved or setup.unaligned, angles=angles)

    # ---- Siemens frames

    def swivel(self, text: str, line: int) -> None:
        """``CYCLE800(…)``: a swivelled plane, the tool upright on it; nothing in it: back."""
        values: list[float | None] = []
        for part in text.split(","):
            try:
                values.append(float(part) if part.strip() and '"' not in part else None)
            except ValueError:
                raise self.source.error(f"CYCLE800: argument {part.strip()!r} is not a number", line) from None
        try:
            plane = cycle800(values, self.scale)
        except FrameError as problem:
            raise self.source.error(str(problem), line) from problem
        stage = values[2] if len(values) > 2 and values[2] is not None else 0.0
        if plane is None:
            if not (round(stage) % 10 and self.setup.local is not None):
                self.untilt()
                if len(values) > _DIRECTION and values[_DIRECTION]:  # swivelled to zero by the cycle itself
                    self.change_setup(unaligned=False, angles={})
            return
        if round(stage) % 10 == 1 and self.setup.local is not None:
            plane = plane.then(self.setup.local)
        self.tilt(plane, "aligned")

    def siemens_frame(self, name: str, words: dict[str, float], b: Block) -> None:
        """TRANS, ATRANS, ROT, AROT: the programmable frame; without A the former one ends."""
        if "RPL" in b.named:
            x, y, z = self.plane.tolist()
            turned = g68({"R": b.named["RPL"]}, (0.0, 0.0, 0.0), (x, y, z))
        elif name.endswith("ROT"):
            turned = siemens_rot(words)
        else:
            turned = Transfer.shift(*self.taken_point(words))
        if name.startswith("A") and self.setup.local is not None:
            turned = turned.then(self.setup.local)
        for c in _XYZ:
            words.pop(c, None)
        if turned.nothing:
            self.untilt()
        else:
            self.tilt(turned, "not yet")


def offset_name(number: int) -> str:
    """G54, G59.3, G54.1 P2 … from ten thousand times the G number plus P."""
    g, p = divmod(number, 1000)
    return f"G{g / 10:g}" + (f" P{p}" if p else "")
