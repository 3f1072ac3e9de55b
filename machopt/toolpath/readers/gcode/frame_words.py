"""Words that rotate, mirror or scale program coordinates: G68, G68.2 with G53.1, G51, Siemens frames."""

from __future__ import annotations

import dataclasses
import math

from machopt.file_formats.plain_decimals import parse_plain_decimal
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.path_building.coordinate_systems import FrameError, SystemTransform
from machopt.path_building.point_collector import Vector
from machopt.toolpath.readers.gcode.geometry.tilted_planes import (
    compute_cycle800_plane,
    compute_g68_2_plane,
    compute_g68_rotation,
    compute_siemens_rotation,
)
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.work_offsets import XYZ, WorkOffsetReader

_INNER = ("mirror", "scale", "rotation", "program")  # the order they are applied in; "program": Sinumerik's
_DIRECTION = 13  # place of DIR in CYCLE800: 0 moves no axis


class FrameWordReader(WorkOffsetReader):
    """Carries out the words that change how the program's axes run."""

    def __init__(self, source: SourceFile, options: ReadOptions, unit: str) -> None:
        super().__init__(source, options, unit)
        self.tilted_plane: SystemTransform | None = None
        self.inner: dict[str, SystemTransform] = {}  # of _INNER, inside of the tilted plane
        self.mirrors: dict[int, float] = {}  # axis → place, G51.1
        self.given_centres = self.setup.machine.centres if self.setup.machine else ()

    def dynamic_offset(self, *, on: bool) -> None:
        """Carry out G254 and G255 (Haas): the zero moves with the table, so the part turns about the program zero.

        Args:
            on: Whether the dynamic offset is switched on.
        """
        machine = self.setup.machine
        if machine is not None and machine.kind == "table":
            centres = ((0.0, 0.0, 0.0),) if on else self.given_centres
            self.change_setup(machine=dataclasses.replace(machine, centres=centres))

    # ---- planes

    def plane_word(self, g: int, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out G68, G69, or G68.2 with G53.1 or G53.6.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; changed in place.
            b: The block: its words, calls and line number.

        Raises:
            FrameError: G53.1 without a tilted plane, or the words describe no plane.
        """
        if g in (680, 682):
            origin = self.read_plane_point(words)
            plane = (
                compute_g68_2_plane(words, origin)
                if g == 682
                else compute_g68_rotation(words, origin, self.plane_normal())
            )
            words.clear()
            if g == 680 and is_upright(plane):
                self.use_inner("rotation", plane)
            else:
                self.tilt(plane, "not yet")
        elif g in (531, 536):
            if not self.setup.tilted:
                raise FrameError("G53.1 without a tilted plane (G68.2) before it")
            self.stand_upright()
        else:
            self.inner.pop("rotation", None)
            self.end_tilt()

    def plane_normal(self) -> Vector:
        x, y, z = self.plane.tolist()
        return x, y, z

    def read_plane_point(self, words: dict[str, float]) -> Vector:
        """Read the origin of a plane from X, Y, Z; a missing one is zero.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.

        Returns:
            Origin, mm.
        """
        x, y, z = (words.pop(c, 0.0) * self.scale for c in XYZ)
        return x, y, z

    def tilt(self, plane: SystemTransform, tilted: str) -> None:
        """Use a plane for the coordinates that follow; an earlier one ends.

        Args:
            plane: Transform of the plane into the system before it.
            tilted: Tool alignment with the plane: ``aligned``, ``not yet``, or empty without a plane.
        """
        self.tilted_plane = None if plane.nothing else plane
        level = is_upright(plane)
        self.change_setup(
            local=self.local(),
            tilted="" if level and tilted == "not yet" else tilted,
            aligned_by_control=tilted == "aligned" and not level,
        )
        self.out.meta["tilted_planes"] = str(int(self.out.meta.get("tilted_planes", "0")) + 1)

    def stand_upright(self) -> None:
        """Align the tool with the plane; the control decides the rotary angles."""
        self.change_setup(tilted="aligned", aligned_by_control=True)

    def end_tilt(self) -> None:
        """Back to the untilted system; after a turn by the control the rotary axes' place is not known."""
        setup = self.setup
        self.tilted_plane = None
        moved = setup.aligned_by_control and setup.transfer is not None and setup.transfer.z[2] < 1.0 - 1e-9
        angles = {} if moved else setup.angles
        self.change_setup(
            local=self.local(),
            tilted="",
            aligned_by_control=False,
            left_tilted_plane=moved or setup.left_tilted_plane,
            angles=angles,
        )

    def local(self) -> SystemTransform | None:
        """Programmed coordinates in the datum's: mirrored, then scaled, then turned, then in the tilted plane."""
        found: SystemTransform | None = None
        for one in (*(self.inner.get(name) for name in _INNER), self.tilted_plane):
            if one is not None:
                found = one if found is None else found.then(one)
        return None if found is None or found.nothing else found

    # ---- mirrors, scales, rotations in the plane

    def use_inner(self, name: str, one: SystemTransform | None) -> None:
        """Set a mirror, scale, rotation or programmable frame inside the plane.

        Args:
            name: Name of the transform.
            one: The transform; None or the identity ends it.

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
        """Carry out G51.1 and G50.1.

        G51.1 mirrors about X, Y, Z. G50.1 ends that for its axes, or for all axes if it has none.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; words that are used are removed in place.
        """
        axes = [k for k in range(3) if XYZ[k] in words]
        for k in axes or (range(3) if g == 501 else ()):
            self.mirrors.pop(k, None)
            value = words.pop(XYZ[k], 0.0) * self.scale
            if g == 511:
                self.mirrors[k] = value
        x, y, z = (-1.0 if k in self.mirrors else 1.0 for k in range(3))
        about = (self.mirrors.get(0, 0.0), self.mirrors.get(1, 0.0), self.mirrors.get(2, 0.0))
        self.use_inner("mirror", SystemTransform.factors(x, y, z, about=about) if self.mirrors else None)

    def scale_word(self, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out G51: X Y Z P, or I J K, scale about a point; negative factors mirror.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Raises:
            FrameError: there is no factor, or a parameter of the control decides its decimals.
        """
        about = self.read_plane_point({c: words.get(c, self.p[k] / self.scale) for k, c in enumerate(XYZ)})
        for c in XYZ:
            words.pop(c, None)
        given = {c: words.pop(c) for c in "PIJK" if c in words}
        if not given:
            raise FrameError(
                "G51 without a factor (P, or I, J, K): which one holds is set by a parameter of the control"
            )
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
                raise FrameError(f"G51 scales {XYZ[k]} about a place that is not known")
        self.use_inner("scale", SystemTransform.factors(x, y, z, about=(where[0], where[1], where[2])))

    # ---- Siemens frames

    def swivel(self, text: str, line: int) -> None:
        """Carry out ``CYCLE800(…)``: a swivelled plane with the tool perpendicular to it; without arguments it ends.

        Args:
            text: Text of the arguments.
            line: Line number in the file (1-based).

        Raises:
            InputError: an argument is not a number.
        """
        values: list[float | None] = []
        for part in text.split(","):
            try:
                values.append(parse_plain_decimal(part) if part.strip() and '"' not in part else None)
            except ValueError:
                raise self.source.build_error(f"CYCLE800: argument {part.strip()!r} is not a number", line) from None
        plane = compute_cycle800_plane(values, self.scale)
        stage = values[2] if len(values) > 2 and values[2] is not None else 0.0
        additive = round(stage) % 10 != 0
        if not additive:
            self.inner.clear()  # a new swivelled plane deletes programmed frames too
        if plane is None:
            if not (additive and self.tilted_plane is not None):
                self.end_tilt()
                if len(values) > _DIRECTION and values[_DIRECTION]:  # swivelled to zero by the cycle itself
                    self.change_setup(left_tilted_plane=False, angles={})
            return
        if round(stage) % 10 == 1 and self.tilted_plane is not None:
            plane = plane.then(self.tilted_plane)
        self.tilt(plane, "aligned")

    def siemens_frame(self, name: str, words: dict[str, float], b: ProgramBlock) -> None:
        """Carry out TRANS, ROT, SCALE or MIRROR: replace the programmable frame, or add to it (ATRANS, AROT, …).

        The frame lies inside a swivelled plane (CYCLE800), which stays active.

        Args:
            name: Name of the call.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.

        Raises:
            FrameError: a factor is not positive.
        """
        kind = name.removeprefix("A") if name != "ASCALE" else "SCALE"
        additive = name.startswith("A")
        if kind == "SCALE":
            x, y, z = (words.pop(c, 1.0) for c in XYZ)
            if not min(x, y, z) > 0.0:
                raise FrameError(f"{name} with a factor that is not above zero")
            one = SystemTransform.factors(x, y, z)
        elif kind == "MIRROR":
            x, y, z = (-1.0 if c in words else 1.0 for c in XYZ)
            one = SystemTransform.factors(x, y, z)
        elif "RPL" in b.named:
            x, y, z = self.plane.tolist()
            one = compute_g68_rotation({"R": b.named["RPL"]}, (0.0, 0.0, 0.0), (x, y, z))
        elif kind == "ROT":
            one = compute_siemens_rotation(words)
        else:
            one = SystemTransform.shift(*self.read_plane_point(words))
        for c in XYZ:
            words.pop(c, None)
        if additive and "program" in self.inner:
            one = one.then(self.inner["program"])
        self.use_inner("program", one)
        if is_upright(one) or (one.nothing and self.tilted_plane is None):
            if self.setup.tilted == "not yet":
                self.change_setup(tilted="" if self.tilted_plane is None else "aligned")
        else:
            self.change_setup(tilted="not yet", aligned_by_control=False)


def is_upright(plane: SystemTransform) -> bool:
    """Return whether the z axis of a plane is that of the system it lies in.

    Args:
        plane: Transform of the plane into the system before it.
    """
    return abs(plane.z[2] - 1.0) < 1e-9
