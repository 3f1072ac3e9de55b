"""Heidenhain coordinate systems: datum shifts, mirrors, scales, rotations and tilted planes, in required order."""

from __future__ import annotations

import re

import numpy as np

from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.path_building.coordinate_systems import FrameError, SystemTransform
from machopt.toolpath.readers.gcode.gcode_reader import GcodeReader
from machopt.toolpath.readers.gcode.geometry.tilted_planes import compute_rotation_sequence, compute_spatial_plane

NUMBER = r"([+-]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))"
_ANGLE = re.compile(r"(SP[ABC]|EUL(?:PR|NU|ROT)|[BN][XYZ])\s*" + NUMBER)
_ZERO = (0.0, 0.0, 0.0)
_ROTARY = {f"{i}{c}" for i in ("", "I") for c in "ABC"}


def parse_value(text: str) -> float:
    """Parse a number that may contain blanks.

    Args:
        text: Text of the number.

    Returns:
        The number.
    """
    return float("".join(text.split()))


class DatumAndPlaneReader(GcodeReader):
    """What the program's coordinates are in."""

    stays = False  # the last PLANE left the rotary axes where they were
    cycle_19 = False  # the last tilt was cycle 19, which fills Q120 to Q122

    def __init__(self, source: SourceFile, options: ReadOptions) -> None:
        super().__init__(source, options)
        self.chain: dict[str, SystemTransform] = {}  # datum, plane, turn: in the order they were switched on
        self.turned_by = 0.0  # deg, CYCL DEF 10
        self.preset: float | None = None

    def chain_changed(self) -> None:
        """The datum outside of a tilted plane is a shift, everything else a plane of its own."""
        shift = self.chain.get("datum") if next(iter(self.chain), None) == "datum" else None
        self.shifts["datum"] = [0.0] * 3 if shift is None else shift.t.tolist()
        x, y, z = self.shifts["datum"]
        local: SystemTransform | None = None
        for name, one in reversed(self.chain.items()):
            if not (name == "datum" and shift is not None):
                local = one if local is None else local.then(one)
        if local is not None and local.nothing:
            local = None
        plane = self.chain.get("plane")
        leaving = plane is None and self.setup.tilted != ""
        if leaving:
            self.end_tilt()
        self.change_setup(datum=(x, y, z), local=local)
        if any(self.setup.datum):
            self.out.warn_once(
                "the program shifts its datum: points count from the preset before the shift (where the "
                "cell's workpiece is the shifted datum, take the shift out of the file)"
            )

    def shift_datum(self, words: dict[str, float], line: int, word: str = "CYCL DEF 7") -> None:
        """Carry out CYCL DEF 7 or TRANS DATUM; in a tilted plane it shifts along the tilted axes.

        Args:
            words: Words of the block: letter or name → number.
            line: Line number in the file (1-based).
            word: Name of the statement, for messages.
        """
        name = "datum" if "plane" not in self.chain or next(iter(self.chain)) == "datum" else "inner"
        if "plane" in self.chain:
            name = "inner"
        now = self.chain[name].t.copy() if name in self.chain else np.zeros(3)
        for k, letter in enumerate("XYZ"):
            if letter in words:
                now[k] = words[letter] * self.scale
            elif "I" + letter in words:
                now[k] += words["I" + letter] * self.scale
        if name in self.chain or now.any():
            self.chain[name] = SystemTransform(np.eye(3), now)
        if not now.any():
            self.chain.pop(name, None)
            self.chain.pop("inner", None)
        self.chain_changed()
        self.out.ignore(word, line, understood=True)

    def trans(self, text: str, line: int) -> None:
        """Carry out TRANS DATUM, MIRROR, ROTATION, SCALE (as cycles 7, 8, 10 and 11); RESET ends each.

        Args:
            text: Text of the statement.
            line: Line number in the file (1-based).

        Raises:
            InputError: the statement is not supported.
        """
        _, kind, *rest = text.split(maxsplit=2)
        arguments = rest[0] if rest else ""
        off = arguments.startswith("RESET")
        axes = {k: parse_value(v) for k, v in re.findall(r"\b(I?[XYZABC])\s*" + NUMBER, arguments)}
        if kind == "DATUM" and (off or (arguments.startswith("AXIS") and axes and not axes.keys() & _ROTARY)):
            self.shift_datum(dict.fromkeys("XYZ", 0.0) if off else axes, line, "TRANS DATUM")
        elif kind == "MIRROR" and (off or arguments.startswith("AXIS")):
            self.mirror_axes("" if off else arguments.removeprefix("AXIS"), "TRANS MIRROR", line)
        elif kind == "ROTATION" and (found := re.match(r"RESET|(I?)ROT\s*" + NUMBER, arguments)):
            degrees = 0.0 if off else parse_value(found.group(2))
            self.turn_plane(degrees + (self.turned_by if found.group(1) else 0.0), line, "TRANS ROTATION")
        elif kind == "SCALE" and (found := re.match(r"RESET|SCL\s*" + NUMBER, arguments)):
            self.scale_all(1.0 if off else parse_value(found.group(1)), line, "TRANS SCALE")
        else:
            raise self.source.build_error(
                f"{text[:40]!r}: read are TRANS DATUM AXIS X… Y… Z…, MIRROR AXIS, ROTATION ROT…, SCALE SCL… and their "
                "RESET (a datum table is not in the file)",
                line,
            )

    def transform(self, name: str, one: SystemTransform, word: str, line: int) -> None:
        """Set a mirror or scale inside the transforms that are already active; the identity ends it.

        Args:
            name: Name of the transform.
            one: The transform.
            word: Name of the statement, for messages.
            line: Line number in the file (1-based).

        Raises:
            FrameError: tool-centre-point control is active, or the tool axis would be mirrored.
        """
        self.chain.pop(name, None)
        if not one.nothing:
            if self.setup.tcp is not None:
                raise FrameError(f"{word} under tool-centre-point control is not supported")
            self.chain[name] = one
        self.chain_changed()
        self.out.ignore(word, line, understood=True)

    def mirror_axes(self, text: str, word: str, line: int) -> None:
        """Carry out CYCL DEF 8 and G28: mirror the axes that are listed; without axes the mirror ends.

        Args:
            text: Text of the statement.
            word: Name of the statement, for messages.
            line: Line number in the file (1-based).

        Raises:
            InputError: an axis cannot be mirrored.
        """
        named = set(re.findall(r"\b([XYZABC])\b", text))
        if named - {"X", "Y"}:
            raise self.source.build_error(f"{word} mirrors {text.strip()}: only X and Y are supported", line)
        x, y = (-1.0 if c in named else 1.0 for c in "XY")
        self.transform("mirror", SystemTransform.factors(x, y, 1.0), word, line)

    def scale_all(self, factor: float, line: int, word: str = "CYCL DEF 11") -> None:
        """Carry out CYCL DEF 11 and TRANS SCALE: one factor for all lengths.

        Args:
            factor: The factor.
            line: Line number in the file (1-based).
            word: Name of the statement, for messages.

        Raises:
            InputError: the factor is not positive.
        """
        if not factor > 0.0:
            raise self.source.build_error(f"{word} with a factor of {factor:g}; expected one above zero", line)
        self.transform("scale", SystemTransform.factors(factor, factor, factor), word, line)

    def turn_plane(self, degrees: float, line: int, word: str = "CYCL DEF 10") -> None:
        """Carry out CYCL DEF 10 and TRANS ROTATION: rotation in the plane.

        Args:
            degrees: Angle, degrees.
            line: Line number in the file (1-based).
            word: Name of the statement, for messages.
        """
        self.chain.pop("turn", None)
        self.turned_by = degrees
        if degrees:
            self.chain["turn"] = SystemTransform.rotation("Z", degrees)
        self.chain_changed()
        self.out.ignore(word, line, understood=True)

    def set_plane(self, plane: SystemTransform | None, line: int) -> None:
        """Set the plane of PLANE … or CYCL DEF 19: the tool is perpendicular to it.

        Args:
            plane: Transform of the plane into the system before it; None ends it.
            line: Line number in the file (1-based).
        """
        self.chain.pop("plane", None)
        self.chain.pop("inner", None)
        if plane is None or plane.nothing:
            self.chain_changed()
            return
        self.chain["plane"] = plane
        self.chain_changed()
        upright = abs(plane.z[2] - 1.0) < 1e-9
        tilted = "not yet" if self.stays else "aligned"  # STAY: the axes wait for L A+Q120 B+Q121 C+Q122
        self.change_setup(tilted="" if upright else tilted, aligned_by_control=not upright and not self.stays)
        self.out.meta["tilted_planes"] = str(int(self.out.meta.get("tilted_planes", "0")) + 1)

    def plane_statement(self, text: str, line: int) -> None:
        """Carry out a PLANE statement.

        Args:
            text: Text of the statement.
            line: Line number in the file (1-based).

        Raises:
            InputError: this kind of PLANE is not supported.
        """
        kind = text.split()[1] if len(text.split()) > 1 else ""
        self.stays, self.cycle_19 = re.search(r"\bSTAY\b", text) is not None, False
        v = {name: parse_value(n) for name, n in _ANGLE.findall(text)}
        if kind == "RESET":
            self.set_plane(None, line)
            if re.search(r"\b(?:TURN|MOVE)\b", text):  # the control brings the rotary axes to zero
                self.change_setup(left_tilted_plane=False, angles={})
        elif kind == "SPATIAL":
            self.set_plane(compute_spatial_plane(v.get("SPA", 0.0), v.get("SPB", 0.0), v.get("SPC", 0.0)), line)
        elif kind == "EULER":
            angles = (v.get("EULPR", 0.0), v.get("EULNU", 0.0), v.get("EULROT", 0.0))
            self.set_plane(compute_rotation_sequence("ZXZ", angles, _ZERO), line)
        elif kind.startswith("RELATIV"):
            more = compute_spatial_plane(v.get("SPA", 0.0), v.get("SPB", 0.0), v.get("SPC", 0.0))
            self.set_plane(more.then(self.chain["plane"]) if "plane" in self.chain else more, line)
        elif kind == "VECTOR":
            self.set_plane(
                _compute_plane_from_vectors([v.get("B" + c, 0.0) for c in "XYZ"], [v.get("N" + c, 0.0) for c in "XYZ"]),
                line,
            )
        else:
            raise self.source.build_error(
                f"{text[:24]!r}: PLANE {kind} (by points, projections or axis angles) is not supported; use PLANE "
                "SPATIAL, EULER or VECTOR",
                line,
            )

    def tilt_angles(self, angles: dict[str, float], line: int) -> None:
        """Carry out CYCL DEF 19 (G80) as spatial angles.

        Args:
            angles: Axis letter → degrees.
            line: Line number in the file (1-based).
        """
        if sum(v != 0.0 for v in angles.values()) > 1:
            self.out.warn_once(
                "cycle 19 is read as spatial angles A, B, C; a machine setting can make them axis angles", line
            )
        a, b, c = (angles.get(k, 0.0) for k in "ABC")
        self.stays, self.cycle_19 = False, True
        self.set_plane(compute_spatial_plane(a, b, c), line)

    def insert_computed_angles(self, text: str, line: int) -> str:
        """Replace Q120 to Q122 in a line by the angles that PLANE … STAY or cycle 19 computed.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).

        Returns:
            The line with numbers.

        Raises:
            InputError: neither statement precedes the line.
        """
        if not (self.stays or self.cycle_19):
            raise self.source.build_error(
                "Q120, Q121, Q122 hold the axes of PLANE … STAY or cycle 19, and there is none before", line
            )
        if self.setup.tilted:
            self.change_setup(tilted="aligned", aligned_by_control=True)
        else:
            self.change_setup(
                tilted="", aligned_by_control=False, left_tilted_plane=False, angles={}
            )  # they hold zeros
        return " ".join(text.replace("COMPUTED", " ").split())

    def use_preset(self, number: float) -> None:
        """Carry out CYCL DEF 247: another datum of the preset table is another work offset.

        Args:
            number: Number of the preset.
        """
        if self.preset is None and len(self.out):
            self.out.warn(
                f"preset {number:g} is chosen after points of a preset that the program does not name: all points are "
                "read in one frame"
            )
        if self.preset is None or not len(self.out):
            self.preset = number
        self.take_offset(f"preset {number:g}", f"preset {self.preset:g}")


def _compute_plane_from_vectors(base: list[float], normal: list[float]) -> SystemTransform:
    """PLANE VECTOR: z along the normal, x along the base vector made square to it."""
    z = np.array(normal)
    length = float(np.linalg.norm(z))
    if not length > 1e-9:
        raise FrameError("PLANE VECTOR with a zero normal (NX, NY, NZ)")
    z = z / length
    x = np.array(base) - float(np.array(base) @ z) * z
    length = float(np.linalg.norm(x))
    if not length > 1e-9:
        raise FrameError("PLANE VECTOR with a base vector (BX, BY, BZ) that is zero or along the normal")
    x = x / length
    return SystemTransform(np.column_stack([x, np.cross(z, x), z]), np.zeros(3))
