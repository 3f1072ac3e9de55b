"""Surface of a mesh file: whether its triangles enclose a volume, completely or nearly."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.cell.mesh.collada_reader import read_collada
from machopt.cell.mesh.file_integrity import read_whole_mesh
from machopt.cell.mesh.mesh_errors import ErrorFactory
from machopt.cell.mesh.second_library_check import (
    compare_with_collada,
    compare_with_second_library,
    find_collada_original,
)
from machopt.errors import InputError
from machopt.numerics import mesh_construction
from machopt.numerics.array_types import Array
from machopt.numerics.content_cache import ContentCache
from machopt.numerics.mesh_construction import TriangleMesh

_LEAST_TRIANGLES = 4  # a tetrahedron; fewer enclose nothing
_FLAT = 1e-7  # thickness over width below which single precision cannot distinguish a body from a sheet
_HOLLOW = 1e-9  # volume over that of the box around it, likewise
_NAMED = 6  # meshes in one warning
# what trimesh's readers let through on a broken file
_BROKEN = (
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    OSError,
    EOFError,
    struct.error,
    NotImplementedError,
    OverflowError,
    ZeroDivisionError,
)


@dataclass(frozen=True)
class MeshSurface:
    """A mesh in the file's own unit."""

    name: str
    extent: float  # longest side of its box
    open_edges: int  # edges that not exactly two triangles share, run through once each way
    inward: bool  # closed, with the triangles facing inwards


SURFACES: ContentCache[MeshSurface] = ContentCache(64)
"""Of STL files that were found whole, by name and content: jobs in one process mostly use the same cell."""


def read_surface(path: Path, fail: ErrorFactory) -> MeshSurface:
    """Read a mesh.

    Args:
        path: the file.
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: not whole (see :mod:`machopt.cell.mesh.file_integrity`), not readable, coordinates that are not
            finite, fewer than four triangles, flat or without volume, or seen differently by the verifier.
    """
    data = read_whole_mesh(path, fail)

    def check() -> MeshSurface:
        return _check_surface(path, read_triangles(path, data, fail), fail)

    alone = path.suffix.lower() == ".stl" and find_collada_original(path) is None  # the check reads no other file
    return SURFACES.get((path.name, data), check) if alone else check()


def read_collada_surface(path: Path, fail: ErrorFactory) -> tuple[MeshSurface, str]:
    """Read a COLLADA mesh; its counts are compared with those of the file.

    Args:
        path: the file.
        fail: makes the error that names where the mesh is used.

    Returns:
        The surface in m, and the axis that points up: X_UP, Y_UP or Z_UP.

    Raises:
        InputError: as :func:`read_surface`, and where the file holds what would move triangles and is not read.
    """
    try:
        found = read_collada(path)
    except InputError as problem:
        raise fail(f"mesh {path.name} {problem.reason}") from None
    faces = np.arange(3 * len(found.corners)).reshape(-1, 3)
    surface = TriangleMesh(found.corners.reshape(-1, 3), faces)
    return _check_surface(path, surface, fail, metre=found.counts.metre), found.counts.up_axis


def _check_surface(path: Path, surface: TriangleMesh, fail: ErrorFactory, *, metre: float = 1.0) -> MeshSurface:
    """Check a mesh that was read; the verifier's library must see the same body, scaled by ``metre``."""
    used = surface.vertices[mesh_construction.find_used_vertices(surface.faces, len(surface.vertices))]
    if not len(used):
        raise fail(f"mesh {path.name} holds no triangles")
    if not np.isfinite(used).all():
        raise fail(f"mesh {path.name} holds coordinates that are not finite")
    if len(surface.faces) < _LEAST_TRIANGLES:
        raise fail(
            f"mesh {path.name} holds {len(surface.faces)} triangle{'s'[: len(surface.faces) > 1]}, which enclose "
            "nothing; a body, or a box in its place, would work"
        )
    box = np.ptp(used, axis=0)
    thickness = np.linalg.svd((used - used.mean(0)) / max(float(box.max()), 1e-300), compute_uv=False)
    if not box.max() > 0.0 or thickness[-1] <= _FLAT * thickness[0]:
        raise fail(f"mesh {path.name} is flat and encloses nothing; a body, or a box in its place, would work")
    vertices, faces = mesh_construction.merge_equal_vertices(surface)
    compare_with_second_library(path, vertices, faces, fail, metre)
    compare_with_collada(path, fail)
    open_edges = _count_open_edges(faces)
    volume = 0.0 if open_edges else _compute_volume(vertices - used.mean(0), faces)
    if not open_edges and abs(volume) <= _HOLLOW * float(np.prod(box)):
        raise fail(f"mesh {path.name} has no volume: its triangles face each other; a body would work")
    return MeshSurface(path.name, float(box.max()), open_edges, volume < 0.0)


def read_triangles(path: Path, data: bytes, fail: ErrorFactory) -> TriangleMesh:
    """Return the triangles of a mesh file in its own unit.

    Args:
        path: the file.
        data: its content.
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: not readable.
    """
    plain = mesh_construction.parse_binary_stl(data) if path.suffix.lower() == ".stl" else None
    return _read_with_trimesh(path, data, fail) if plain is None else plain


def _read_with_trimesh(path: Path, data: bytes, fail: ErrorFactory) -> TriangleMesh:
    """The triangles of any format that trimesh reads."""
    from trimesh import load_mesh
    from trimesh.exchange.stl import HeaderError

    try:
        with np.errstate(all="ignore"):  # of numbers that are not finite, which the caller refuses
            mesh: Any = load_mesh(io.BytesIO(data), file_type=path.suffix.lower()[1:], process=False)
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    except ImportError:  # of a library that guesses encodings
        raise fail(f"mesh {path.name} cannot be read: it holds bytes that are no text") from None
    except (*_BROKEN, HeaderError) as err:
        raise fail(f"mesh {path.name} cannot be read: {err or type(err).__name__}") from None
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise fail(f"mesh {path.name} names corners {faces.min()} to {faces.max()} of {len(vertices)}; it is damaged")
    return TriangleMesh(vertices, faces)


def find_open_surfaces(surfaces: Sequence[MeshSurface]) -> list[str]:
    """Warn of meshes whose surface is not closed, and of the effect on collision checks.

    Args:
        surfaces: Surfaces of the meshes.

    Returns:
        One warning each.
    """
    out = []
    gaps = list(dict.fromkeys(f"{s.name} ({s.open_edges} open edges)" for s in surfaces if s.open_edges))
    if gaps:
        out.append(
            f"meshes that are not closed: {_join_names(gaps)}. Contact with their surface is found; a body that lies "
            "wholly inside one is not. A closed mesh would work"
        )
    turned = list(dict.fromkeys(s.name for s in surfaces if s.inward))
    if turned:
        out.append(
            f"meshes whose triangles face inwards: {_join_names(turned)}. They are taken as hollow: what lies wholly "
            "inside one does not collide. Flipped normals would work"
        )
    return out


def _join_names(names: list[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _count_open_edges(faces: NDArray[np.int64]) -> int:
    """Edges not run through once in each direction."""
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    if not len(faces):
        return 0
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = int(faces.max()) + 1
    low, high = edges.min(axis=1), edges.max(axis=1)
    ways = np.sort(2 * (low * n + high) + (edges[:, 0] == low))  # an edge's ways back, then those forth
    begins = np.flatnonzero(np.append(True, np.diff(ways >> 1) != 0))
    forth = np.add.reduceat(ways & 1, begins)
    return int(np.count_nonzero(2 * forth != np.diff(np.append(begins, len(ways)))))


def _compute_volume(vertices: Array, faces: NDArray[np.int64]) -> float:
    """Signed; positive where the triangles face outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
