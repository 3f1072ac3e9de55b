"""Transform from program coordinates to the workpiece: work offsets, shifts, tilted planes, rotary axes.

p_workpiece = T_machine ∘ T_offset ∘ T_datum ∘ T_local p.

* T_machine: rotary axes without tool-centre-point control (see :mod:`machopt.path_building.rotary_axes`);
* T_offset: a work offset other than the first;
* T_datum: a shift of the origin by the program (G52, CYCL DEF 7, G92 after the path began);
* T_local: a rotated or tilted plane.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError
from machopt.path_building.coordinate_systems import SystemTransform
from machopt.path_building.point_collector import PathBuilder, Vector
from machopt.path_building.rotary_axes import HELP, PLACED_HELP, RotaryMachine
from machopt.toolpath.readers.gcode.geometry.tilted_planes import compute_spatial_plane

_Z = (0.0, 0.0, 1.0)
_TURNED = 1e-9  # deg
_MIXED = 1e-9  # share of one axis in another below which they are square to each other
_MOST_STEPS = 5_000  # of one block: 40 turns at 100 mm within 5 µm
_UPRIGHT = math.cos(math.radians(0.1))


@dataclass(frozen=True, kw_only=True)
class CoordinateSetup:
    """Modes and coordinate systems that hold at one place of the program; changed copies replace it."""

    machine: RotaryMachine | None
    out: PathBuilder
    datum: Vector = (0.0, 0.0, 0.0)  # mm, shift of the origin by the program itself, from its work offset
    offset: SystemTransform | None = None
    local: SystemTransform | None = None
    tilted: str = ""  # "not yet": a plane, the tool not upright on it; "aligned"; "followed": by rotary words of TCP
    aligned_by_control: bool = False  # by the control itself (G53.1, CYCLE800, PLANE): it knows the rotary axes' places
    tcp: str | None = None  # "angles" | "vector" | "spatial": rotary words are angles about the coordinates' own axes
    vector: Vector | None = None  # last tool vector, workpiece
    angles: dict[str, float] = field(default_factory=dict)  # deg
    missing_place_reason: str = ""  # why coordinates have no place in the workpiece at all: an offset that is not given
    left_tilted_plane: bool = False  # a tilted plane was left and no rotary word given since

    def with_changes(self, **changes: object) -> CoordinateSetup:
        """Return a copy with other field values.

        Args:
            **changes: Fields and their new values.
        """
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def turn_rotary_axes(self, angles: dict[str, float]) -> CoordinateSetup:
        """Return the setup after rotary words; in a tilted plane they align the tool with the plane.

        Args:
            angles: Rotary angles: axis letter → degrees.
        """
        if self.left_tilted_plane:
            self.out.warn_once("rotary axes that are not named after a tilted plane are assumed to be at 0")
        after = self.with_changes(
            angles={**self.angles, **angles}, left_tilted_plane=False, vector=None, aligned_by_control=False
        )
        if not self.tilted:
            return after
        if self.tcp is not None:
            return after.with_changes(tilted="followed")
        if self.tilted == "not yet":
            self.out.warn_once("rotary words in a tilted plane are taken as those that put the tool upright on it")
        after = after.with_changes(tilted="aligned")
        if self.machine is not None and list_turned_angles(after.angles):
            cosine = sum(a * b for a, b in zip(self.machine.tool_axis(after.angles), after.tool_axis(), strict=True))
            if cosine < _UPRIGHT:
                off = math.degrees(math.acos(max(min(cosine, 1.0), -1.0)))
                self.out.warn_once(
                    f"the rotary words and machine {self.machine.name} put the tool {off:.1f}° off the tilted plane's "
                    "normal; the plane holds"
                )
        return after

    # ---- what is known

    @property
    def by_machine(self) -> bool:
        """True where X, Y, Z are the machine's and the rotary axes' places are known."""
        return self.tcp is None and not self.tilted and self.machine is not None and self.machine.has_known_tip

    def describe_unknown_place(self) -> str | None:
        """Describe why the position of a move in the workpiece is unknown, None where it is known."""
        if self.missing_place_reason:
            return self.missing_place_reason
        if self.tilted == "not yet" and self.transfer is not None and self.transfer.z[2] < 1.0 - 1e-9:
            return (
                "cuts in a tilted plane before the tool was put upright on it (G53.1, rotary words, PLANE … with TURN "
                "or MOVE instead of STAY): where the tool points is not known"
            )
        if self.tcp == "spatial" and self.is_rotated and self.vector is None:
            return (
                "spatial angles (TCPM AXIS SPAT) in turned or tilted coordinates are not read; post tool vectors (LN)"
            )
        if self.tcp is not None or self.tilted:
            return None
        if self.left_tilted_plane:
            return (
                "cuts after a tilted plane was left and before any rotary word: the positions of the rotary axes are "
                "not known; post the rotary words after the plane is cancelled"
            )
        if self.by_machine or not list_turned_angles(self.angles):
            return None
        angles = " ".join(f"{c}{v:g}" for c, v in sorted(self.angles.items()))
        return (
            f"cuts with turned rotary axes ({angles}) and without tool-centre-point control: X, Y, Z are then the "
            f"machine's. Post it with G43.4, G234, TRAORI or M128, {PLACED_HELP}, or export APT/CL data"
        )

    def check_letters(self, line: int) -> None:
        """Check that the rotary words are axes of the machine.

        Args:
            line: Line number in the file (1-based).

        Raises:
            InputError: the machine has no such axis, or the machine is not given and its tool axis is needed.
        """
        if self.tcp == "spatial":
            return  # of the coordinates, whatever the machine
        strange = sorted(list_turned_angles(self.angles).keys() - set(self.machine.letters if self.machine else "ABC"))
        if strange and self.machine is not None and not self.tilted:
            raise self.out.source.build_option_question(
                "machine", f"rotary word {strange[0]} but machine {self.machine.name} has no such axis", line
            )
        if self.tcp == "angles" and list_turned_angles(self.angles) and self.machine is None:
            raise self.out.source.build_option_question(
                "machine",
                f"rotary words ({', '.join(sorted(list_turned_angles(self.angles)))}) under tool-centre-point "
                f"control: the tool "
                f"axis depends on the machine; give --machine, one of {HELP}",
                line,
            )

    def tool_axis(self) -> Vector:
        """Unit vector from tip to shank, workpiece."""
        if self.tcp is not None and self.vector is not None:
            return self.vector
        if self.tcp == "spatial":
            return compute_spatial_plane(*(self.angles.get(letter, 0.0) for letter in "ABC")).direction(_Z)
        if self.tilted == "aligned":
            return self.direction(_Z)
        if self.machine is not None and list_turned_angles(self.angles):
            return self.machine.tool_axis(self.angles)
        return _Z

    # ---- coordinates

    @cached_property
    def transfer(self) -> SystemTransform | None:
        """Programmed coordinates in the workpiece; None: they are equal."""
        found = self.local
        if any(self.datum):
            shift = SystemTransform.shift(*self.datum)
            found = shift if found is None else found.then(shift)
        if self.offset is not None:
            found = self.offset if found is None else found.then(self.offset)
        if self.by_machine and list_turned_angles(self.angles):
            assert self.machine is not None
            tip = self.machine.tip(self.angles)
            found = tip if found is None else found.then(tip)
        return None if found is None or found.nothing else found

    @cached_property
    def is_rotated(self) -> bool:
        transfer = self.transfer
        return transfer is not None and not transfer.only_shifts

    @cached_property
    def stretch(self) -> float:
        """The largest factor by which programmed lengths grow; 1 without a scaling."""
        transfer = self.transfer
        if transfer is None or transfer.rigid:
            return 1.0
        return float(np.linalg.norm(transfer.R, ord=2))

    @property
    def height_factor(self) -> float:
        """What heights along the program's z grow by; below zero where z is mirrored."""
        transfer = self.transfer
        if transfer is None or transfer.rigid:
            return 1.0
        length = float(np.linalg.norm(transfer.R[:, 2]))
        upside_down = transfer.R[2, 2] < 0.0 and self.local is not None and self.tilted != "aligned"
        return -length if upside_down else length

    @cached_property
    def even(self) -> bool:
        """Lengths grow alike in every direction, so that an arc stays one."""
        transfer = self.transfer
        if transfer is None or transfer.rigid:
            return True
        squares = transfer.R.T @ transfer.R
        return bool(np.allclose(squares, squares[0, 0] * np.eye(3), rtol=0.0, atol=1e-9 * squares[0, 0]))

    def mixes(self, unknown: list[bool]) -> bool:
        """Return whether an unknown coordinate enters another coordinate of the workpiece.

        Args:
            unknown: Whether each programmed coordinate is unknown.
        """
        if not self.is_rotated or not any(unknown):
            return False
        transfer = self.transfer
        assert transfer is not None
        into = np.abs(transfer.R) > _MIXED
        return any(unknown[k] and bool(into[j, k]) for k in range(3) for j in range(3) if j != k)

    def point(self, p: Vector) -> Vector:
        """Transform one point into the workpiece.

        Args:
            p: Programmed position, mm.

        Returns:
            Position in the workpiece, mm.
        """
        transfer = self.transfer
        if transfer is None:
            return p
        if any(map(math.isnan, p)):  # coordinates that are not known keep the others out of nothing
            x, y, z = self.points(np.array([p]))[0].tolist()
            return x, y, z
        return transfer.point(p)

    def points(self, p: Array) -> Array:
        """Transform points into the workpiece.

        Args:
            p: Programmed positions (N, 3), mm.

        Returns:
            Positions (N, 3) in the workpiece, mm.
        """
        transfer = self.transfer
        if transfer is None:
            return p
        if transfer.only_shifts:
            return p + transfer.t
        unknown = np.isnan(p)
        if not unknown.any():
            return transfer.points(p)
        lost = unknown.astype(float) @ (np.abs(transfer.R) > _MIXED).T > 0.0
        return np.where(lost, np.nan, transfer.points(np.where(unknown, 0.0, p)))

    def direction(self, d: Vector) -> Vector:
        """Transform a direction into the workpiece.

        Args:
            d: Programmed direction, unit vector.

        Returns:
            Direction in the workpiece, unit vector.
        """
        transfer = self.transfer
        return d if transfer is None else transfer.direction(d)

    def list_axes_moved_by_machine_z(self) -> list[int]:
        """Coordinates of a tilted plane that a move of the machine's Z may change: along the tool or the workpiece."""
        assert self.transfer is not None
        workpiece_z = self.transfer.R[2]  # in the plane's axes
        return [k for k in range(3) if k == 2 or abs(float(workpiece_z[k])) > _MIXED]

    def convert_from_system(self, before: SystemTransform | None, p: list[float]) -> tuple[list[float], bool]:
        """Compute the programmed coordinates of a position that was given under another transform.

        Args:
            before: Earlier transform into the workpiece; None for the identity.
            p: Coordinates under the earlier transform, mm; NaN where not known.

        Returns:
            The coordinates in mm, NaN where not known, and True where the systems are only shifted.
        """
        none = SystemTransform(np.eye(3), np.zeros(3))
        change = (before or none).then((self.transfer or none).inverse())
        if change.only_shifts:
            return [a + b for a, b in zip(p, change.t.tolist(), strict=True)], True
        known = np.isfinite(p)
        unknown = (np.abs(change.R) > _MIXED) @ ~known  # coordinates that an unknown one goes into
        after = change.R @ np.where(known, p, 0.0) + change.t
        return np.where(unknown, np.nan, after).tolist(), False

    # ---- linear and rotary axes at once

    def before_turn(self, angles: dict[str, float], p: list[float]) -> Array:
        """Compute the position of a programmed point in the workpiece under other rotary angles.

        Args:
            angles: Rotary angles: axis letter → degrees.
            p: Programmed position, mm.

        Returns:
            Position (3,) in the workpiece, mm.
        """
        return np.array(self.with_changes(angles=angles).point((p[0], p[1], p[2])))

    def sweep(
        self, start: list[float], end: list[float], angles: dict[str, float], tolerance: float
    ) -> tuple[Array, Array]:
        """Tip and tool axis along a block that moves all axes in proportion.

        Args:
            start, end: programmed coordinates (mm).
            angles: rotary angles at the start (deg); those at the end are the set-up's.
            tolerance: largest distance of a chord from the tip's way (mm).
        Returns:
            (N, 3) chord ends without the start, and (N, 3) tool axes.
        Raises:
            ArcError: more than _MOST_STEPS chords.
        """
        letters = sorted(self.angles.keys() | angles.keys())
        before = np.array([angles.get(c, 0.0) for c in letters])
        after = np.array([self.angles.get(c, 0.0) for c in letters])
        a, b = np.array(start), np.array(end)
        arm = max(float(np.linalg.norm(a)), float(np.linalg.norm(b))) + 4.0 * self._reach()
        swing = float(np.radians(np.abs(after - before)).sum())
        # a point on an arm r that turns by θ leaves its chord by r θ²/8; the linear motion meanwhile by r θ d/4
        bend = arm * swing**2 / 8.0 + float(np.linalg.norm(b - a)) * swing / 4.0
        wanted = math.sqrt(bend / tolerance)
        if not wanted <= _MOST_STEPS:
            raise ArcError(f"{wanted:.0f} chords for one block that turns by {math.degrees(swing):g}°: too many")
        steps = max(math.ceil(wanted), 1)
        points, axes = np.empty((steps, 3)), np.empty((steps, 3))
        for k in range(steps):
            s = (k + 1) / steps
            now = self.with_changes(angles=dict(zip(letters, (before + s * (after - before)).tolist(), strict=True)))
            x, y, z = (a + s * (b - a)).tolist()
            points[k], axes[k] = now.point((x, y, z)), now.tool_axis()
        return points, axes

    def _reach(self) -> float:
        machine = self.machine
        if machine is None:
            return 0.0
        return max([abs(v) for c in machine.centres for v in c] + [machine.pivot or 0.0])


def list_turned_angles(angles: dict[str, float]) -> dict[str, float]:
    """Return the rotary angles that are not zero.

    Args:
        angles: Rotary angles: axis letter → degrees.

    Returns:
        Axis letter → degrees.
    """
    return {c: v for c, v in angles.items() if abs(v) > _TURNED}
