"""TCP orientations in robot tables: angles, quaternions, rotation vectors. Tool axis −z, reference +x.

Each format becomes (N, 3, 3) matrices whose columns are the TCP axes in the workpiece.
"""

from __future__ import annotations

from dataclasses import dataclass

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import (
    compute_rpy_matrix,
    convert_quaternion_to_matrix,
    convert_vector_to_rotation,
    normalise_vectors,
)

UNIT_QUATERNION = 1e-3  # off from unit length: printed decimals; beyond it the numbers are something else


@dataclass(frozen=True)
class OrientationFormat:
    """One way to write an attitude: its columns, with the endings they may have, and what they mean."""

    columns: tuple[str, ...]
    angles: bool  # carry _deg or _rad
    words: str


ORIENTATION_FORMATS = {
    "abc": OrientationFormat(("a", "b", "c"), True, "R = Rz(a) Ry(b) Rx(c)"),
    "wpr": OrientationFormat(("w", "p", "r"), True, "R = Rz(r) Ry(p) Rx(w)"),
    "rpy": OrientationFormat(("roll", "pitch", "yaw"), True, "R = Rz(yaw) Ry(pitch) Rx(roll)"),
    "quaternion": OrientationFormat(("qw", "qx", "qy", "qz"), False, "unit quaternion"),
    "q1234": OrientationFormat(("q1", "q2", "q3", "q4"), False, "unit quaternion, scalar first"),
    "vector": OrientationFormat(("rvx", "rvy", "rvz"), True, "rotation vector: axis times angle"),
}


def compute_rotations(kind: str, values: Array) -> Array:
    """Compute rotation matrices from orientation columns.

    Args:
        kind: One of :data:`ORIENTATION_FORMATS`.
        values: Orientation values (N, 3) or (N, 4), angles in rad.

    Returns:
        Rotations (N, 3, 3) whose columns are the TCP axes in the workpiece.
    """
    if kind == "abc":
        return compute_rpy_matrix(values[:, ::-1])
    if kind in ("wpr", "rpy"):
        return compute_rpy_matrix(values)
    if kind == "vector":
        return convert_vector_to_rotation(values)
    return convert_quaternion_to_matrix(normalise_vectors(values))
