"""Attitudes of the TCP as robot tables write them: angles, quaternions, rotation vectors. Tool axis −z, reference +x.

Each makes (N, 3, 3) matrices whose columns are the TCP's axes in the workpiece.
"""

from __future__ import annotations

from dataclasses import dataclass

from machopt.arrays import Array
from machopt.se3 import normalise, quaternion_matrix, rotation_from_vector, rpy_matrix

UNIT_QUATERNION = 1e-3  # off from unit length: printed decimals; beyond it the numbers are something else


@dataclass(frozen=True)
class Attitude:
    """One way to write an attitude: its columns, with the endings they may have, and what they mean."""

    columns: tuple[str, ...]
    angles: bool  # carry _deg or _rad
    words: str


ATTITUDES = {
    "abc": Attitude(("a", "b", "c"), True, "R = Rz(a) Ry(b) Rx(c)"),
    "wpr": Attitude(("w", "p", "r"), True, "R = Rz(r) Ry(p) Rx(w)"),
    "rpy": Attitude(("roll", "pitch", "yaw"), True, "R = Rz(yaw) Ry(pitch) Rx(roll)"),
    "quaternion": Attitude(("qw", "qx", "qy", "qz"), False, "unit quaternion"),
    "q1234": Attitude(("q1", "q2", "q3", "q4"), False, "unit quaternion, scalar first"),
    "vector": Attitude(("rvx", "rvy", "rvz"), True, "rotation vector: axis times angle"),
}


def rotations(kind: str, values: Array) -> Array:
    """(N, 3, 3) from (N, 3 or 4) values of one of :data:`ATTITUDES`; angles in radians."""
    if kind == "abc":
        return rpy_matrix(values[:, ::-1])
    if kind in ("wpr", "rpy"):
        return rpy_matrix(values)
    if kind == "vector":
        return rotation_from_vector(values)
    return quaternion_matrix(normalise(values))
