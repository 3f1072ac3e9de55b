"""Arc centres of G2 and G3: relative, absolute or unsigned I, J, K, and modal radii.

Controls agree on I, J, K from the start point and on a radius that is valid for one block only. Some posts write
other forms. These are tried only where the usual reading is impossible. They must fit the arc end, and a warning
reports them.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import RADIUS_FAULT, RADIUS_WARN, ArcError, compute_centre_from_radius
from machopt.path_building.point_collector import PathBuilder


@dataclass
class ArcCentres:
    """How a program writes its arc centres, as found so far. Lengths in mm."""

    out: PathBuilder
    absolute: bool = False  # G90.1
    radius_stays: float = math.nan  # of the arc before, for posts that leave R out when it does not change
    wrong_signs: int = 0
    full_circles: list[int] = field(default_factory=list)  # lines

    def by_radius(self, start: Array, end: Array, radius: float, normal: Array) -> Array:
        """Compute the centre from the end and the radius.

        Args:
            start: Start point (3,), mm.
            end: End point (3,), mm.
            radius: Radius, mm; negative for an arc above 180°.
            normal: Axis of right-handed travel (3,), unit vector.

        Returns:
            Centre (3,), mm.
        """
        self.radius_stays = radius
        return compute_centre_from_radius(start, end, radius, normal)

    def by_opening(self, start: Array, end: Array, opening: float, normal: Array) -> Array:
        """Compute the centre from the end and the opening angle.

        r = d / (2 sin(opening/2)), d from start to end.

        Args:
            start: Start point (3,), mm.
            end: End point (3,), mm.
            opening: Opening angle, rad.
            normal: Axis of right-handed travel (3,), unit vector.

        Returns:
            Centre (3,), mm.

        Raises:
            ArcError: start and end coincide.
        """
        self.radius_stays = math.nan
        radius = _compute_length((end - start) * (1.0 - np.abs(normal))) / (2.0 * math.sin(opening / 2.0))
        return compute_centre_from_radius(start, end, math.copysign(radius, math.pi - opening), normal)

    def find_stated_centre(self, start: Array, offsets: Array, modes: list[str]) -> Array:
        """Compute the centre from I, J, K that state their own reference.

        Args:
            start: Start point (3,), mm.
            offsets: I, J, K (3,), mm; NaN where not given.
            modes: Reference of each value: AC the zero, IC or empty the start.

        Returns:
            Centre (3,), mm.
        """
        self.radius_stays = math.nan
        absolute = [m not in ("", "IC") for m in modes]
        given = np.where(np.isnan(offsets), 0.0, offsets)
        return np.where(absolute, given, start + given)

    def find_default_centre(self, start: Array, end: Array, normal: Array, line: int) -> Array:
        """Find the centre of an arc block without I, J, K and R.

        Args:
            start: Start point (3,), mm.
            end: End point (3,), mm.
            normal: Axis of right-handed travel (3,), unit vector.
            line: Line number in the file (1-based).

        Returns:
            Centre (3,), mm.

        Raises:
            ArcError: no radius of an earlier arc fits.
        """
        flat = 1.0 - np.abs(normal)
        if math.isnan(self.radius_stays) or not _compute_length((end - start) * flat) > 1e-9:
            raise ArcError("an arc without I, J, K or R (they hold for one block only); was G1 meant?")
        centre = compute_centre_from_radius(start, end, self.radius_stays, normal)
        self.out.warn_once(
            "arcs without I, J, K or R take the radius of the arc before them, as the post leaves an unchanged R out "
            "(a control without modal R would go straight)",
            line,
        )
        return centre

    def by_offsets(self, start: Array, end: Array, offsets: Array, normal: Array, line: int) -> Array:
        """Find the centre from I, J, K.

        Args:
            start: Start point (3,), mm.
            end: End point (3,), mm.
            offsets: I, J, K (3,), mm; NaN where not given.
            normal: Axis of right-handed travel (3,), unit vector.
            line: Line number in the file (1-based).

        Returns:
            Centre (3,), mm.

        Raises:
            ArcError: a full circle in a program whose I, J, K have no signs.
        """
        self.radius_stays = math.nan
        flat = 1.0 - np.abs(normal)
        missing = np.isnan(offsets)
        known = np.where(missing, 0.0, offsets)
        relative, absolute = start + known, np.where(missing, start, offsets)
        first, second = (absolute, relative) if self.absolute else (relative, absolute)

        def mismatch(c: Array) -> float:
            return abs(_compute_length((start - c) * flat) - _compute_length((end - c) * flat))

        if _compute_length((end - start) * flat) < 1e-6:
            self.full_circles.append(line)
            self._check_circles()
            return first
        if mismatch(first) <= RADIUS_WARN:
            return first
        if mismatch(second) <= RADIUS_WARN:
            word = "offsets" if self.absolute else "absolute"
            self.out.warn_once(f"I, J, K fit only as {word} centres; read that way", line)
            return second
        if self.absolute or mismatch(first) <= min(RADIUS_FAULT * _compute_length((start - first) * flat), 0.5):
            return first
        signs = [np.array(s) for s in itertools.product((1.0, -1.0), repeat=3)]
        others = {tuple((start + s * known).tolist()) for s in signs}
        fitting = [np.array(c) for c in sorted(others) if mismatch(np.array(c)) <= RADIUS_WARN]
        if len(fitting) != 1:
            return first  # the check of the radius will refuse it
        self.wrong_signs += 1
        self.out.warn_once(
            "I, J, K fit only with another sign: the post writes them wrong; read so that they fit", line
        )
        self._check_circles()
        return fitting[0]

    def _check_circles(self) -> None:
        if self.wrong_signs and self.full_circles:
            raise ArcError(
                "other arcs of this program have I, J, K with a wrong sign (or none), so on which side of its start "
                f"the full circle in line {self.full_circles[0]} lies is not known; post it with signed I, J, K or "
                "with arcs of less than a full turn"
            )


def _compute_length(v: Array) -> float:
    x, y, z = v.tolist()
    return math.sqrt(x * x + y * y + z * z)
