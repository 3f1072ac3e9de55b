"""Polar coordinates: G16 of Fanuc, and AP=, RP= about a pole (G110, G111, G112) of Sinumerik."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock

PLANE_AXES = {2: (0, 1), 1: (2, 0), 0: (1, 2)}  # index of the plane's normal → first and second axis


def find_plane_axes(plane: Array) -> tuple[int, int]:
    """Return the axes of a working plane: G17 (X, Y), G18 (Z, X) or G19 (Y, Z).

    Args:
        plane: Normal of the working plane (3,), unit vector.

    Returns:
        Indices of the first and second axis.
    """
    return PLANE_AXES[int(np.argmax(np.abs(plane)))]


@dataclass
class PolarCoordinates:
    """Radius and angle that hold, in mm and degrees; the pole is in programmed coordinates."""

    on: bool = False  # G16
    radius: float = math.nan
    angle: float = math.nan
    pole: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def switch(self, *, on: bool) -> None:
        """Switch polar coordinates on or off and forget radius and angle.

        Args:
            on: Whether polar coordinates are active.
        """
        self.on, self.radius, self.angle = on, math.nan, math.nan

    def words(self, words: dict[str, float], plane: Array, scale: float, *, incremental: bool) -> None:
        """Convert G16 words in place: the first axis of the plane is the radius about the zero, the second the angle.

        Args:
            words: Words of the block: letter or name → number; words that are used are removed in place.
            plane: Normal of the working plane (3,), unit vector.
            scale: mm per unit of the program.
            incremental: Whether increments are active (G91).

        Raises:
            ArcError: a radius under G91, or radius or angle was never given.
        """
        names = ["XYZ"[k] for k in find_plane_axes(plane)]
        if not self.on or not words.keys() & set(names):
            return
        if names[0] in words:
            if incremental:
                raise ArcError("a polar radius under G91 (G16) counts from the present place: not supported")
            self.radius = words.pop(names[0]) * scale
        if names[1] in words:
            self.angle = words.pop(names[1]) + (self.angle if incremental else 0.0)
        if math.isnan(self.radius) or math.isnan(self.angle):
            raise ArcError("polar coordinates (G16) of which radius or angle was not given yet")
        words[names[0]] = self.radius * math.cos(math.radians(self.angle)) / scale
        words[names[1]] = self.radius * math.sin(math.radians(self.angle)) / scale

    def set_pole(
        self, g: int, words: dict[str, float], b: ProgramBlock, p: list[float], plane: Array, scale: float
    ) -> None:
        """Carry out G110, G111 or G112 with X, Y, Z or AP, RP.

        G110 counts from the last position, G111 from the zero, G112 from the last pole.

        Args:
            g: Number of the G word.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            b: The block: its words, calls and line number.
            p: Present position in programmed mm; NaN where not known.
            plane: Normal of the working plane (3,), unit vector.
            scale: mm per unit of the program.

        Raises:
            ArcError: the reference position is not known.
        """
        origin = {1100: p, 1110: [0.0, 0.0, 0.0], 1120: self.pole}[g]
        first, second = find_plane_axes(plane)
        to = list(origin)
        if "RP" in b.named or "AP" in b.named:
            angle, radius = math.radians(b.named.pop("AP", 0.0)), b.named.pop("RP", 0.0) * scale
            to[first] += radius * math.cos(angle)
            to[second] += radius * math.sin(angle)
        for k in range(3):
            if "XYZ"[k] in words:
                to[k] += words.pop("XYZ"[k]) * scale
        if math.isnan(to[first]) or math.isnan(to[second]):
            raise ArcError(f"G{g // 10} counts the pole from a place that is not known")
        self.pole, self.radius, self.angle = to, math.nan, math.nan

    def about_pole(
        self, words: dict[str, float], b: ProgramBlock, p: list[float], plane: Array, scale: float, *, incremental: bool
    ) -> bool:
        """Convert AP= and RP= in place to the two absolute words of the plane.

        Args:
            words: Words of the block: letter or name → number; changed in place.
            b: The block: its words, calls and line number.
            p: Present position in programmed mm; NaN where not known.
            plane: Normal of the working plane (3,), unit vector.
            scale: mm per unit of the program.
            incremental: Whether increments are active (G91).

        Returns:
            Whether the block has any of them.

        Raises:
            ArcError: radius or angle is neither given nor known.
        """
        if not b.named.keys() & {"AP", "RP"}:
            return False
        first, second = find_plane_axes(plane)
        if math.isnan(self.radius) or math.isnan(self.angle):  # after another kind of block: the tool position
            d, e = p[first] - self.pole[first], p[second] - self.pole[second]
            self.radius, self.angle = math.hypot(d, e), math.degrees(math.atan2(e, d))
        for name in ("AP", "RP"):
            if name not in b.named:
                continue
            value = b.named.pop(name) * (scale if name == "RP" else 1.0)
            relative = b.modes.get(name, "IC" if incremental else "AC") == "IC"
            if name == "AP":
                self.angle = value + (self.angle if relative else 0.0)
            else:
                self.radius = value + (self.radius if relative else 0.0)
        if math.isnan(self.radius) or math.isnan(self.angle):
            raise ArcError("AP= or RP= alone, from a place that is not known")
        for k, v in ((first, math.cos(math.radians(self.angle))), (second, math.sin(math.radians(self.angle)))):
            words["XYZ"[k]] = (self.pole[k] + self.radius * v) / scale
            b.modes["XYZ"[k]] = "AC"
        return True


def convert_line_angle(
    degrees: float,
    words: dict[str, float],
    b: ProgramBlock,
    p: list[float],
    plane: Array,
    scale: float,
    *,
    incremental: bool,
) -> None:
    """Convert ``,A`` or ANG= in place: a line by its angle to the first axis of the plane and one coordinate.

    Args:
        degrees: Angle, degrees.
        words: Words of the block: letter or name → number; changed in place.
        b: The block: its words, calls and line number.
        p: Present position in programmed mm; NaN where not known.
        plane: Normal of the working plane (3,), unit vector.
        scale: mm per unit of the program.
        incremental: Whether increments are active (G91).

    Raises:
        ArcError: both or none of the coordinates is given, or the line never reaches the coordinate.
    """
    axes = find_plane_axes(plane)
    given = [k for k in axes if "XYZ"[k] in words]
    if len(given) != 1 or any(math.isnan(p[k]) for k in axes):
        raise ArcError(
            "a line by its angle needs one of the plane's two coordinates and a known start; contours whose corner "
            "follows from the next block are not supported: post the corner's coordinates"
        )
    k, other = given[0], axes[0] if given[0] == axes[1] else axes[1]
    along = {axes[0]: math.cos(math.radians(degrees)), axes[1]: math.sin(math.radians(degrees))}
    name = "XYZ"[k]
    relative = b.modes.get(name, "IC" if incremental else "AC") == "IC"
    way = words[name] * scale - (0.0 if relative else p[k])
    if abs(along[k]) < 1e-9:
        raise ArcError(f"a line at {degrees:g}° never gets to another {name}")
    words["XYZ"[other]] = (p[other] + way / along[k] * along[other]) / scale
    b.modes["XYZ"[other]] = "AC"


def convert_polar_words(
    words: dict[str, float], b: ProgramBlock, p: list[float], plane: Array, scale: float, *, incremental: bool
) -> PolarStep:
    """Convert ``@radius ^angle`` of LinuxCNC in place to X and Y; one word alone keeps the value of the other.

    Args:
        words: Words of the block: letter or name → number; words that are used are removed in place.
        b: The block: its words, calls and line number.
        p: Present position in programmed mm; NaN where not known.
        plane: Normal of the working plane (3,), unit vector.
        scale: mm per unit of the program.
        incremental: Whether increments are active (G91).

    Returns:
        The position, and the step of repeats of the block under G91.

    Raises:
        ArcError: outside of G17, together with X or Y, or from an unknown position.
    """
    if find_plane_axes(plane) != (0, 1) or words.keys() & {"X", "Y"}:
        raise ArcError("polar words (@, ^) are accepted in G17 and without X and Y only")
    radius, angle = math.hypot(p[0], p[1]), math.degrees(math.atan2(p[1], p[0]))
    first = radius, angle
    if "@" in words:
        radius = words.pop("@") * scale + (radius if incremental else 0.0)
    if "^" in words:
        angle = words.pop("^") + (angle if incremental else 0.0)
    if math.isnan(radius) or math.isnan(angle):
        raise ArcError("@ or ^ alone, or under G91, from a place that is not known")
    words["X"] = radius * math.cos(math.radians(angle)) / scale
    words["Y"] = radius * math.sin(math.radians(angle)) / scale
    b.modes.update({"X": "AC", "Y": "AC"})
    return PolarStep(radius, angle, radius - first[0], angle - first[1])


@dataclass(frozen=True)
class PolarStep:
    """A place by radius (mm) and angle (deg), and its step from the one before."""

    radius: float
    angle: float
    radius_step: float
    angle_step: float

    def place(self, n: int) -> tuple[float, float]:
        """Compute the position after further steps.

        Args:
            n: Number of steps.

        Returns:
            X and Y, mm.
        """
        radius, angle = self.radius + n * self.radius_step, math.radians(self.angle + n * self.angle_step)
        return radius * math.cos(angle), radius * math.sin(angle)
