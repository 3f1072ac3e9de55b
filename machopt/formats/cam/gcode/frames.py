"""Words that move or turn a program's coordinates: work offsets, G52, G92, G68, G68.2 with G53.1, Siemens frames."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from machopt.errors import nearest
from machopt.formats.cam.gcode.blocks import Block
from machopt.formats.cam.gcode.motion import MotionReader
from machopt.formats.cam.gcode.planes import cycle800, g68, g68_2, siemens_rot
from machopt.formats.cam.gcode.words import MANY_OFFSETS
from machopt.formats.frames import FrameError, Transfer
from machopt.formats.pathbuilder import Vector
from machopt.formats.source import Offset, ReadOptions, Source, offset_key

_XYZ = "XYZ"
_FIRST = 540_000  # G54
_INNER = ("mirror", "scale", "rotation", "program")  # the order they are applied in; "program": Sinumerik's
_DIRECTION = 13  # place of DIR in CYCLE800: 0 moves no axis


class FrameReader(MotionReader):
    """Carries out the words that change where the program's zero lies and how its axes run."""

    def __init__(self, source: Source, options: ReadOptions, unit: str) -> None:
        super().__init__(source, options, unit)
        self.work_offset: int | None = None
        self.first_offset: int | None = None
        self.cell_offset = ""  # of the cell's, that points count from
        self.shifts: dict[str, list[float]] = {}  # G52, G92, CYCL DEF 7 in mm
        self.g53_is_an_offset = "G53" in dict(options.offsets)  # as some posts mean it; told by the user only
        self.table: dict[str, Offset] = {}  # offsets the program itself sets by G10 L2 before its path
        self.tilted_plane: Transfer | None = None
        self.inner: dict[str, Transfer] = {}  # of _INNER, inside of the tilted plane
        self.mirrors: dict[int, float] = {}  # axis → place, G51.1
        self.given_centres = self.setup.machine.centres if self.setup.machine else ()

    # ---- origins

    def use_offset(self, g: int, words: dict[str, float], line: int) -> None:
        """G54 … G59.3, G54.1 P, G505 …: another one than the first needs its place given."""
        number = g * 1000 + (round(words.pop("P", 0.0)) if g in MANY_OFFSETS or g == 540 else 0)
        number += round(words.pop("H", 0.0)) if g == 150 else 0  # Okuma's G15 H
        if self.options.cell_offsets:
            if number != self.work_offset:
                self.of_cell(offset_name(number), line)
            self.work_offset = number
            return
        told = offset_key(offset_name(number)) in {**self.table, **dict(self.options.offsets)}
        if self.first_offset is None and len(self.out) and told:
            self.first_offset = _FIRST  # what controls start with
        elif self.first_offset is None and len(self.out):
            self.out.warn(f"points before {offset_name(number)} name no work offset; they are taken in the same", line)
        if self.first_offset is None or not len(self.out):
            self.first_offset = number
        if number != self.work_offset:
            self.take_offset(offset_name(number), offset_name(self.first_offset))
        self.work_offset = number
        self.out.meta["work_offset"] = offset_name(self.first_offset)

    def of_cell(self, name: str, line: int | None = None) -> None:
        """Coordinates from here on count from a work offset of the cell, which is told and placed later.

        Where the tool is in it is not known before all axes are given.
        """
        known, key = self.options.cell_offsets, offset_key(name)
        if key not in known:
            raise self.source.error(
                f"work offset {name} is not in the cell's offsets; {nearest(key, list(known))}", line
            )
        if len(self.out) and not self.cell_offset:
            raise self.source.error(f"points before {name} name no work offset; one before them would work", line)
        if self.cell_offset:
            self.p, self.lost = [math.nan] * 3, ["in the other work offset"] * 3
            self.end_contour("the work offset changes")
        self.cell_offset = key
        self.out.count_from(key)

    def take_offset(self, name: str, first: str) -> None:
        """Coordinates from here on count from work offset ``name``; moves are refused where its place is not given."""
        if self.options.cell_offsets:
            self.of_cell(name)
            return
        places = {**self.table, **dict(self.options.offsets)}
        nowhere = ""
        offset = None
        if name != first:
            key = offset_key(name)
            if key in places:
                origin = np.array(places[key]) - np.array(places.get(offset_key(first), (0.0, 0.0, 0.0)))
                offset = Transfer.shift(*origin.tolist())
            else:
                nowhere = (
                    f"the work offset changes from {first} to {name}: how they lie to each other is not in the file; "
                    f"give it with --offset {name.replace(' ', '')}=X,Y,Z (its origin in {first}, mm), or by the "
                    "cell's offsets, or split the file, one offset in each"
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
        if g == 100 and words.get("L") in (2.0, 20.0) and len(axes) == 3 and not self.incremental:
            n, x, y, z = round(words.get("P", 0.0)), *(words[c] * self.scale for c in _XYZ)
            names = [f"G54.1P{n}"] if words["L"] == 20.0 else ([f"G{53 + n}"] if 1 <= n <= 6 else [])
            self.table.update((name, (x, y, z)) for name in names)
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
        if g in (680, 682):
            origin = self.taken_point(words)
            plane = g68_2(words, origin) if g == 682 else g68(words, origin, self.plane_normal())
            words.clear()
            if g == 680 and upright(plane):
                self.use_inner("rotation", plane)
            else:
                self.tilt(plane, "not yet")
        elif g in (531, 536):
            if not self.setup.tilted:
                raise FrameError("G53.1 without a tilted plane (G68.2) before it")
            self.stand_upright()
        else:
            self.inner.pop("rotation", None)
            self.untilt()

    def plane_normal(self) -> Vector:
        x, y, z = self.plane.tolist()
        return x, y, z

    def taken_point(self, words: dict[str, float]) -> Vector:
        x, y, z = (words.pop(c, 0.0) * self.scale for c in _XYZ)
        return x, y, z

    def tilt(self, plane: Transfer, tilted: str) -> None:
        """Coordinates from here on are those of ``plane``; a former one ends."""
        self.tilted_plane = None if plane.nothing else plane
        level = upright(plane)
        self.change_setup(
            local=self.local(),
            tilted="" if level and tilted == "not yet" else tilted,
            stood_up=tilted == "aligned" and not level,
        )
        self.out.meta["tilted_planes"] = str(int(self.out.meta.get("tilted_planes", "0")) + 1)

    def stand_upright(self) -> None:
        """The control puts the tool upright on the plane; where its rotary axes stand then is its own business."""
        self.change_setup(tilted="aligned", stood_up=True)

    def untilt(self) -> None:
        """Back to the untilted system; after a turn by the control the rotary axes' place is not known."""
        setup = self.setup
        self.tilted_plane = None
        moved = setup.stood_up and setup.transfer is not None and setup.transfer.z[2] < 1.0 - 1e-9
        angles = {} if moved else setup.angles
        self.change_setup(
            local=self.local(), tilted="", stood_up=False, unaligned=moved or setup.unaligned, angles=angles
        )

    def local(self) -> Transfer | None:
        """Programmed coordinates in the datum's: mirrored, then scaled, then turned, then in the tilted plane."""
        found: Transfer | None = None
        for one in (*(self.inner.get(name) for name in _INNER), self.tilted_plane):
            if one is not None:
                found = one if found is None else found.then(one)
        return None if found is None or found.nothing else found

    # ---- mirrors, scales, rotations in the plane

    def use_inner(self, name: str, one: Transfer | None) -> None:
        """A mirror, scale, rotation or programmable frame inside of the plane; None or no change: it ends.

        Raises:
            FrameError: Z or a tool vector would be mirrored.
        """
        if one is None or one.nothing:
            self.inner.pop(name, None)
        else:
            self.inner[name] = one
        self.change_setup(local=self.local())
        self.check_mirror()

    def check_mirror(self) -> None:
        """Refuse what mirrors the tool, or its vectors.

        Raises:
            FrameError: it does.
        """
        if all(one.rigid for one in self.inner.values()):
            return
        if any(one.R[2, 2] < 0.0 and not one.rigid for one in self.inner.values()):
            raise FrameError("mirrors Z: the tool would come from below; not supported")
        if self.setup.tcp is not None:
            raise FrameError("mirrors or scales the coordinates under tool-centre-point control: not supported")
        if not self.setup.even and self.modal_corner is not None:
            raise FrameError("scales X and Y differently while corners are rounded (RNDM): not supported")

    def mirror_word(self, g: int, words: dict[str, float]) -> None:
        """G51.1 mirrors about X, Y, Z; G50.1 ends that for the axes it names (none: all)."""
        axes = [k for k in range(3) if _XYZ[k] in words]
        for k in axes or (range(3) if g == 501 else ()):
            self.mirrors.pop(k, None)
            value = words.pop(_XYZ[k], 0.0) * self.scale
            if g == 511:
                self.mirrors[k] = value
        x, y, z = (-1.0 if k in self.mirrors else 1.0 for k in range(3))
        about = (self.mirrors.get(0, 0.0), self.mirrors.get(1, 0.0), self.mirrors.get(2, 0.0))
        self.use_inner("mirror", Transfer.factors(x, y, z, about=about) if self.mirrors else None)

    def scale_word(self, words: dict[str, float], b: Block) -> None:
        """G51 X Y Z P, or I J K: scales about a point; factors below zero mirror.

        Raises:
            FrameError: no factor, or one whose decimals the control's parameters decide.
        """
        about = self.taken_point({c: words.get(c, self.p[k] / self.scale) for k, c in enumerate(_XYZ)})
        for c in _XYZ:
            words.pop(c, None)
        given = {c: words.pop(c) for c in "PIJK" if c in words}
        if not given:
            raise FrameError("G51 without a factor (P, or I, J, K): which one holds stands in the control's parameters")
        for c, v in given.items():
            if b.bare(c) and not (c != "P" and abs(v) == 1000.0):
                raise FrameError(
                    f"G51 {c}{v:g}: a factor without a decimal point counts thousandths or hundred-thousandths by the "
                    "control's parameters; write it with one (P2.5)"
                )
            if not abs(v) > 1e-6:
                raise FrameError(f"G51 with a factor of {v:g}")
        unit = {c: math.copysign(1.0, v) if c != "P" and b.bare(c) else v for c, v in given.items()}
        x, y, z = ((unit["P"],) * 3) if "P" in unit else (unit.get("I", 1.0), unit.get("J", 1.0), unit.get("K", 1.0))
        where = tuple(0.0 if math.isnan(v) else v for v in about)
        for k, factor in enumerate((x, y, z)):
            if factor != 1.0 and math.isnan(about[k]):
                raise FrameError(f"G51 scales {_XYZ[k]} about a place that is not known")
        self.use_inner("scale", Transfer.factors(x, y, z, about=(where[0], where[1], where[2])))

    # ---- Siemens frames

    def swivel(self, text: str, line: int) -> None:
        """``CYCLE800(…)``: a swivelled plane, the tool upright on it; nothing in it: back."""
        values: list[float | None] = []
        for part in text.split(","):
            try:
                values.append(float(part) if part.strip() and '"' not in part else None)
            except ValueError:
                raise self.source.error(f"CYCLE800: argument {part.strip()!r} is not a number", line) from None
        plane = cycle800(values, self.scale)
        stage = values[2] if len(values) > 2 and values[2] is not None else 0.0
        additive = round(stage) % 10 != 0
        if not additive:
            self.inner.clear()  # a new swivelled plane deletes programmed frames too
        if plane is None:
            if not (additive and self.tilted_plane is not None):
                self.untilt()
                if len(values) > _DIRECTION and values[_DIRECTION]:  # swivelled to zero by the cycle itself
                    self.change_setup(unaligned=False, angles={})
            return
        if round(stage) % 10 == 1 and self.tilted_plane is not None:
            plane = plane.then(self.tilted_plane)
        self.tilt(plane, "aligned")

    def siemens_frame(self, name: str, words: dict[str, float], b: Block) -> None:
        """TRANS, ROT, SCALE, MIRROR replace the programmable frame, with A before them they add to it.

        It lies inside of a swivelled plane (CYCLE800), which stays.
        """
        kind = name.removeprefix("A") if name != "ASCALE" else "SCALE"
        additive = name.startswith("A")
        if kind == "SCALE":
            x, y, z = (words.pop(c, 1.0) for c in _XYZ)
            if not min(x, y, z) > 0.0:
                raise FrameError(f"{name} with a factor that is not above zero")
            one = Transfer.factors(x, y, z)
        elif kind == "MIRROR":
            x, y, z = (-1.0 if c in words else 1.0 for c in _XYZ)
            one = Transfer.factors(x, y, z)
        elif "RPL" in b.named:
            x, y, z = self.plane.tolist()
            one = g68({"R": b.named["RPL"]}, (0.0, 0.0, 0.0), (x, y, z))
        elif kind == "ROT":
            one = siemens_rot(words)
        else:
            one = Transfer.shift(*self.taken_point(words))
        for c in _XYZ:
            words.pop(c, None)
        if additive and "program" in self.inner:
            one = one.then(self.inner["program"])
        self.use_inner("program", one)
        if upright(one) or (one.nothing and self.tilted_plane is None):
            if self.setup.tilted == "not yet":
                self.change_setup(tilted="" if self.tilted_plane is None else "aligned")
        else:
            self.change_setup(tilted="not yet", stood_up=False)


def upright(plane: Transfer) -> bool:
    """Its z axis is that of the system it lies in."""
    return abs(plane.z[2] - 1.0) < 1e-9


def offset_name(number: int) -> str:
    """G54, G59.3, G54.1 P2 … from ten thousand times the G number plus P."""
    g, p = divmod(number, 1000)
    return f"G{g / 10:g}" + (f" {'H' if g == 150 else 'P'}{p}" if p else "")
