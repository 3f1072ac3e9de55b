"""A mesh as the verifier loads it: another library, which must see the same body (the only importer of coal here)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.formats.mesh.fail import Fail
from machopt.triangulated import corners_of

_SAME = 1e-4  # of the longest side; text formats are printed with six digits and more
_LOST = 0.02  # share of triangles that may be left out as slivers without an area


def check_same(path: Path, vertices: Array, faces: NDArray[np.int64], fail: Fail) -> None:
    """Load a mesh again and compare.

    Args:
        path: the file.
        vertices: (V, 3) as the planner reads them, equal ones merged.
        faces: (F, 3).
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: the verifier cannot load the file, or sees another body.
    """
    import coal

    try:
        # under the plainest tree that coal has: only the surface is compared
        other = coal.MeshLoader(coal.NODE_TYPE.BV_AABB).load(str(path), np.ones(3))
    except (ValueError, RuntimeError):  # its message holds the rest of the file
        raise fail(
            f"mesh {path.name} cannot be loaded by the verifier; a fresh export as binary STL would work"
        ) from None
    other.computeLocalAABB()
    theirs = np.array([other.aabb_local.min_, other.aabb_local.max_])
    used = vertices[corners_of(faces, len(vertices))]
    near = _SAME * float(np.ptp(used, axis=0).max())
    boxes = [np.array([v.min(0), v.max(0)]) for v in (used, vertices)]  # points of no triangle may count there
    solid = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    fewest = (1.0 - _LOST) * np.count_nonzero(solid) - 1.0
    if min(float(np.abs(theirs - b).max()) for b in boxes) > near or not fewest <= other.num_tris <= len(faces):
        raise fail(
            f"mesh {path.name} is read differently by planner ({len(faces)} triangles, "
            f"{_mm(boxes[0])}) and verifier ({other.num_tris}, {_mm(theirs)}), so it is damaged; a fresh export as "
            "binary STL would work"
        )


def _mm(box: Array) -> str:
    return " × ".join(f"{v:.6g}" for v in box[1] - box[0])
