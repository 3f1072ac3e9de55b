"""Tilted working planes and programmed shifts: G68, G68.2, CYCLE800, TRANS/ROT, PLANE SPATIAL, CYCL DEF 19.

Each function returns the coordinate system of the following coordinates, as a :class:`SystemTransform` into the one
before (mm). Where a machine setting of Siemens or Heidenhain decides, the usual setting is assumed and the reader
reports it.
"""

from __future__ import annotations

import numpy as np

from machopt.path_building.coordinate_systems import (
    FrameError,
    SystemTransform,
    compute_axis_turn,
    compute_rotation_about,
)
from machopt.path_building.point_collector import Vector

_XYZ = "XYZ"


def compute_rotation_sequence(axes: str, angles_deg: tuple[float, ...], origin: Vector) -> SystemTransform:
    """Compute the transform of consecutive rotations about moving axes: R = R₁ R₂ R₃.

    Args:
        axes: Letters of the axes in order.
        angles_deg: Angle of each rotation, degrees.
        origin: Origin of the rotated system, mm.

    Returns:
        Transform into the system before it.
    """
    R = np.eye(3)
    for axis, angle in zip(axes, angles_deg, strict=True):
        R = R @ compute_axis_turn(axis, angle)
    return SystemTransform(R, np.array(origin))


def compute_g68_2_plane(words: dict[str, float], origin: Vector) -> SystemTransform:
    """Compute the plane of ``G68.2 X Y Z I J K``.

    Without P: Euler angles, R = Rz(I) Rx(J) Rz(K). With P1: roll I, pitch J, yaw K about the fixed axes in the order of
    Q (Q123, the default: R = Rz(K) Ry(J) Rx(I)).

    Args:
        words: Words of the block: letter → number.
        origin: Origin of the plane, mm.

    Returns:
        Transform into the system before it.

    Raises:
        FrameError: another definition of the plane (P2, P3, P4), or an order that does not exist.
    """
    form = round(words.get("P", 0.0))
    i, j, k = (words.get(c, 0.0) for c in "IJK")
    if form == 0:
        return compute_rotation_sequence("ZXZ", (i, j, k), origin)
    if form != 1:
        raise FrameError(f"G68.2 P{form} (plane by points, vectors or projections) is not supported; use P0 or P1")
    order = str(round(words.get("Q", 123.0)))
    if sorted(order) != ["1", "2", "3"]:
        raise FrameError(f"G68.2 P1 Q{order}: expected an order of the axes such as Q123")
    angle = {"1": i, "2": j, "3": k}
    R = np.eye(3)
    for digit in order:  # first rotation first, each about the fixed axes
        R = compute_axis_turn(_XYZ[int(digit) - 1], angle[digit]) @ R
    return SystemTransform(R, np.array(origin))


def compute_g68_rotation(words: dict[str, float], centre: Vector, normal: Vector) -> SystemTransform:
    """Compute ``G68 X Y R`` about the normal of the plane, or ``G68 X Y Z I J K R`` about a vector.

    Args:
        words: Words of the block: letter → number.
        centre: Centre of rotation, mm.
        normal: Normal of the working plane, unit vector.

    Returns:
        Transform into the system before it.
    """
    axis = (words.get("I", 0.0), words.get("J", 0.0), words.get("K", 0.0)) if words.keys() & set("IJK") else normal
    R = compute_rotation_about(axis, words.get("R", 0.0))
    c = np.array(centre)
    return SystemTransform(R, c - R @ c)


def compute_cycle800_plane(values: list[float | None], scale: float) -> SystemTransform | None:
    """Compute the plane of ``CYCLE800(FR, TC, ST, MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, …)``.

    The two lowest bits of MODE and the next two pairs give the axes of consecutive rotations. The two highest bits give
    the meaning of A, B, C: 00 those angles, 01 solid angles (about Z, then the new Y).

    Args:
        values: Arguments of the call; None where empty.
        scale: mm per unit of the program.

    Returns:
        Transform into the system before it, None where the plane ends.

    Raises:
        FrameError: projection angles, direct rotary positions, or a MODE that does not exist.
    """
    v = [0.0 if x is None else x for x in values] + [0.0] * (13 - len(values))
    if not any(v[4:13]):
        return None
    mode = round(v[3])
    origin = np.array(v[4:7]) * scale
    after = np.array(v[10:13]) * scale
    a, b, c = v[7:10]
    kind = mode >> 6
    if kind == 0:
        axes = [(mode >> shift) & 3 for shift in (0, 2, 4)]
        if 0 in axes:
            raise FrameError(f"CYCLE800 with MODE {mode}: expected three axes in its bits, e.g. 57 for X, Y, Z")
        R = compute_rotation_sequence("".join(_XYZ[n - 1] for n in axes), (a, b, c), (0.0, 0.0, 0.0)).R
    elif kind == 1:
        R = compute_axis_turn("Z", a) @ compute_axis_turn("Y", b)
    else:
        what = "projection angles" if kind == 2 else "positions of the rotary axes"
        raise FrameError(f"CYCLE800 with MODE {mode} gives {what}; post it with angles about the axes (MODE 57)")
    return SystemTransform(R, origin + R @ after)


def compute_siemens_rotation(words: dict[str, float]) -> SystemTransform:
    """Compute ``ROT X Y Z``: R = Rz(Z) Ry(Y) Rx(X), the default order of the control (RPY).

    Args:
        words: Words of the block: letter → number.

    Returns:
        Transform into the system before it.
    """
    angles = (words.get("Z", 0.0), words.get("Y", 0.0), words.get("X", 0.0))
    return compute_rotation_sequence("ZYX", angles, (0.0, 0.0, 0.0))


def compute_spatial_plane(a: float, b: float, c: float) -> SystemTransform:
    """Compute ``PLANE SPATIAL SPA SPB SPC`` and ``CYCL DEF 19``: R = Rz(C) Ry(B) Rx(A).

    Args:
        a: Angle about X, degrees.
        b: Angle about Y, degrees.
        c: Angle about Z, degrees.

    Returns:
        Transform into the system before it.
    """
    return compute_rotation_sequence("ZYX", (c, b, a), (0.0, 0.0, 0.0))
