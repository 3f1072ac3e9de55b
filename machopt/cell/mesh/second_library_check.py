"""Check that the verifier's mesh library loads the same body (the only module that imports coal here)."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from machopt.cell.mesh.mesh_errors import ErrorFactory
from machopt.file_formats.file_reading import MESH, read_file
from machopt.numerics.array_types import Array
from machopt.numerics.mesh_construction import find_used_vertices, parse_binary_stl

_UNIT = re.compile(rb"<unit\b[^>]*?\bmeter\s*=\s*[\"']\s*([-+0-9.eE]+)\s*[\"']")
_SAME = 1e-4  # of the longest side; text formats are printed with six digits and more
_LOST = 0.02  # share of triangles that may be left out as slivers without an area


def compare_with_second_library(
    path: Path, vertices: Array, faces: NDArray[np.int64], fail: ErrorFactory, metre: float = 1.0
) -> None:
    """Load a mesh again and compare.

    Args:
        path: the file.
        vertices: (V, 3) as the planner reads them, equal ones merged.
        faces: (F, 3).
        fail: makes the error that names where the mesh is used.
        metre: m per unit of a COLLADA file, whose corners are in m.

    Raises:
        InputError: the verifier cannot load the file, or sees another body.
    """
    compare_bodies(path.name, load_with_second_library(path, metre, fail), vertices, faces, fail)


def compare_with_collada(copy: Path, fail: ErrorFactory) -> None:
    """Compare a converted mesh with the COLLADA file in the same folder, which the verifier reads.

    Args:
        copy: ``NAME.dae.stl``; nothing is done where ``NAME.dae`` does not exist.
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: the original cannot be loaded by the verifier's library, or holds another body.
    """
    original = find_collada_original(copy)
    if original is None:
        return
    surface = parse_binary_stl(read_file(copy, expected="a mesh", most=MESH))
    if surface is None:
        raise fail(f"mesh {copy.name} is no binary STL; a fresh `machopt init` would work")
    data = read_file(original, expected="COLLADA", most=MESH)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise fail(f"mesh {original.name} declares a document type or entities; a file without them would work")
    metre = read_metre(data)
    compare_bodies(
        original.name, load_with_second_library(original, metre, fail), surface.vertices, surface.faces, fail
    )


def find_collada_original(copy: Path) -> Path | None:
    """Find the COLLADA file of which a mesh is a copy, in the same folder.

    Args:
        copy: Path of the mesh.

    Returns:
        Path of the COLLADA file, None where there is none.
    """
    if copy.suffixes[-2:] != [".dae", ".stl"]:
        return None
    original = copy.with_suffix("")
    return original if original.is_file() else None


def read_metre(data: bytes) -> float:
    """Read the unit of a COLLADA file.

    Args:
        data: Content of the file.

    Returns:
        m per unit.
    """
    found = _UNIT.search(data)
    return float(found[1]) if found else 1.0


def load_with_second_library(path: Path, scale: float, fail: ErrorFactory) -> Any:
    """Load a mesh with the library of the verifier.

    Args:
        path: Path of the file.
        scale: Factor to m.
        fail: Function that builds an error from a message.

    Returns:
        The mesh of the library.

    Raises:
        InputError: the library cannot load the file.
    """
    import coal

    # under the plainest tree that coal has: only the surface is compared
    loader = coal.MeshLoader(coal.NODE_TYPE.BV_AABB)
    try:
        other = loader.load(str(path), np.full(3, scale))
    except (ValueError, RuntimeError):  # its message holds the rest of the file
        try:
            if path.suffix.lower() != ".dae":
                raise
            with tempfile.TemporaryDirectory() as folder:  # its importer reads no comments inside of numbers
                plain = Path(folder) / path.name
                ElementTree.parse(path).write(plain, encoding="utf-8", xml_declaration=True)
                other = loader.load(str(plain), np.full(3, scale))
        except (ValueError, RuntimeError, ElementTree.ParseError):
            raise fail(
                f"mesh {path.name} cannot be loaded by the verifier; a fresh export as binary STL would work"
            ) from None
    other.computeLocalAABB()
    return other


def compare_bodies(name: str, other: Any, vertices: Array, faces: NDArray[np.int64], fail: ErrorFactory) -> None:
    """Refuse a mesh of which two libraries see different bodies.

    Args:
        name: of the file.
        other: as :func:`load_with_second_library` gives it.
        vertices: (V, 3) as the planner reads them.
        faces: (F, 3).
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: the boxes or the numbers of triangles differ.
    """
    theirs = np.array([other.aabb_local.min_, other.aabb_local.max_])
    used = vertices[find_used_vertices(faces, len(vertices))]
    near = _SAME * float(np.ptp(used, axis=0).max())
    boxes = [np.array([v.min(0), v.max(0)]) for v in (used, vertices)]  # points of no triangle may count there
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    solid = (a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)
    fewest = (1.0 - _LOST) * np.count_nonzero(solid & (_compute_areas(a, b, c) > 0.0)) - 1.0
    if min(float(np.abs(theirs - b).max()) for b in boxes) > near or not fewest <= other.num_tris <= len(faces):
        raise fail(
            f"mesh {name} is read differently by planner ({len(faces)} triangles, "
            f"{_format_mm(boxes[0])}) and verifier ({other.num_tris}, {_format_mm(theirs)}), so it is damaged; "
            f"a fresh export as "
            "binary STL would work"
        )


def _compute_areas(a: Array, b: Array, c: Array) -> Array:
    """(F,) twice the area of triangles."""
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _format_mm(box: Array) -> str:
    return " × ".join(f"{v:.6g}" for v in box[1] - box[0])
