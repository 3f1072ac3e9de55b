"""Search options: ranges of the shift, number of places, and moved bodies."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import degrees, pi

import numpy as np

from machopt.errors import InputError, OptionError
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, compute_axis_rotation

UP_AXIS = np.array([0.0, 0.0, 1.0])
ROTATION_LEVER_M = 0.3  # m per rad: equivalent shift of a rotation for the grid of places
MAX_SHIFT_M = 20.0  # m; a longer shift is probably in another unit

Range = tuple[float, float]


@dataclass(frozen=True, order=True)
class PlacementShift:
    """A place, as the shift of the part (or the base) from its place in the cell, along the axes of the world."""

    x: float = 0.0  # m
    y: float = 0.0
    z: float = 0.0
    turn: float = 0.0  # rad, about the world's z axis through the centre of the toolpaths (or base_link's origin)

    def build_matrix(self, centre: Array) -> Array:
        """Return the (4, 4) matrix that multiplies the world pose of a moved body from the left.

        Args:
            centre: (3,) m, centre of the rotation in world.
        """
        R = compute_axis_rotation(UP_AXIS, np.array(self.turn))
        return build_transform(R, centre + np.array(self.translation) - R @ centre)

    @property
    def text(self) -> str:
        """Description in mm and degrees, only values that are not zero."""
        parts = [f"{name} {1e3 * v:+.0f} mm" for name, v in zip("xyz", self.translation, strict=True) if abs(v) >= 5e-4]
        if abs(self.turn) >= 1e-4:
            parts.append(f"turned {degrees(self.turn):+.1f}°")
        return ", ".join(parts) or "unchanged"

    @property
    def translation(self) -> tuple[float, float, float]:
        return self.x, self.y, self.z


NO_SHIFT = PlacementShift()


@dataclass(frozen=True, kw_only=True)
class PlacementOptions:
    """Options of a placement search; lengths in m, angles in rad."""

    x: Range = (-0.3, 0.3)
    y: Range = (-0.3, 0.3)
    z: Range = (0.0, 0.0)
    turn: Range = (0.0, 0.0)
    places: int = 200  # maximum number, without the present one
    base: bool = False  # the robot is moved instead of the workpiece
    carry: tuple[str, ...] | None = None  # obstacles that move along; None: those that support the moved body
    stay: tuple[str, ...] = ()  # supporting obstacles that stay
    best: int = 3  # number of places that are written as full plans
    plans: int = 40  # maximum number of fully planned places
    seconds: float = 600.0  # s, time after which no further place is started

    def __post_init__(self) -> None:
        for name, (low, high), most, unit in (
            ("x", self.x, MAX_SHIFT_M, "m"),
            ("y", self.y, MAX_SHIFT_M, "m"),
            ("z", self.z, MAX_SHIFT_M, "m"),
            ("turn", self.turn, 2 * pi, "rad"),
        ):
            if not (np.isfinite([low, high]).all() and low <= high and max(-low, high) <= most):
                raise InputError(
                    f"the range {low:g} to {high:g} {unit} is none; least before greatest, and at most {most:.3g} "
                    f"{unit} either way, would work",
                    where=f"--{name}-{'deg' if name == 'turn' else 'mm'}",
                )
        for name, value in (("places", self.places), ("best", self.best), ("plans", self.plans)):
            if value < 1:
                raise OptionError(f"{value} is not enough; 1 or more would work", where=f"--{name}")
        if not self.seconds > 0:
            raise OptionError("no time is left; a positive number of minutes would work", where="--minutes")


def build_shift_grid(search: PlacementOptions) -> tuple[PlacementShift, ...]:
    """Return the places: the present one first, then an even grid over the ranges with at most the requested number.

    Args:
        search: search options.

    Raises:
        InputError: the ranges contain no place except the present one.
    """
    low = np.array([search.x[0], search.y[0], search.z[0], search.turn[0]])
    high = np.array([search.x[1], search.y[1], search.z[1], search.turn[1]])
    span = high - low
    size = span * [1.0, 1.0, 1.0, ROTATION_LEVER_M]
    counts = _count_grid_values(size, search.places)
    axes = [
        np.linspace(a, b, n) if n > 1 else np.array([0.5 * (a + b)]) for a, b, n in zip(low, high, counts, strict=True)
    ]
    grid = [PlacementShift(*(float(v) + 0.0 for v in values)) for values in product(*axes)]
    out = (NO_SHIFT, *(s for s in grid if max(abs(v) for v in (*s.translation, ROTATION_LEVER_M * s.turn)) > 1e-9))
    if len(out) == 1 and (size > 0).any():
        least = 2 ** int((size > 0).sum())
        raise OptionError(
            f"{search.places} leave one place, the middle of the ranges, where the cell has it already; {least}, two "
            "along each range, would work",
            where="--places",
        )
    if len(out) == 1:
        raise OptionError(
            "the ranges hold no other place than the one the cell has; e.g. --x-mm -300 300 would work", where="--x-mm"
        )
    return out


def compute_grid_steps(search: PlacementOptions) -> PlacementShift:
    """Return the distance of neighbouring places; 0 along axes with one value.

    Args:
        search: search options.
    """
    ranges = (search.x, search.y, search.z, search.turn)
    span = np.array([high - low for low, high in ranges])
    counts = _count_grid_values(span * [1.0, 1.0, 1.0, ROTATION_LEVER_M], search.places)
    return PlacementShift(*(float(d) / (n - 1) if n > 1 else 0.0 for d, n in zip(span, counts, strict=True)))


def clip_shift(search: PlacementOptions, shift: PlacementShift) -> PlacementShift:
    """Return the shift clipped to the ranges.

    Args:
        search: search options.
        shift: shift to clip.
    """
    ranges = (search.x, search.y, search.z, search.turn)
    return PlacementShift(
        *(float(np.clip(v, *r)) for v, r in zip((*shift.translation, shift.turn), ranges, strict=True))
    )


def _count_grid_values(size: Array, most: int) -> tuple[int, ...]:
    """Return the number of values along each axis: one step for all of them, as small as ``most`` places allow."""
    moving = size > 0
    if not moving.any():
        return (1,) * len(size)

    def at(step: float) -> Array:
        return np.where(moving, np.floor(size / step + 1e-9) + 1, 1)

    coarse, fine = float(size.max()) * 2, float(size.max()) / (most + 1)
    for _ in range(60):
        middle = 0.5 * (coarse + fine)
        if at(middle).prod() <= most:
            coarse = middle
        else:
            fine = middle
    return tuple(int(n) for n in at(coarse))
