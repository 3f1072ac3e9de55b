"""Is a mesh file what collision checking needs: readable, made of triangles, and in metres once scaled?"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from machopt.errors import InputError

Fail = Callable[[str], InputError]

_LARGEST = 50.0  # m; a robot cell is smaller, a mesh in mm taken as metres is larger
_SMALLEST = 1e-3  # m; nothing in a cell that collides is smaller, a mesh scaled twice is
_READABLE = (".stl", ".obj", ".ply", ".off")
# what trimesh's readers let through on a broken file; its own HeaderError is an Exception of no other kind
_BROKEN = (ValueError, KeyError, IndexError, TypeError, AttributeError, OSError, EOFError, struct.error)


def check_mesh(path: Path, scale: float, fail: Fail, remedy: str) -> str | None:
    """Read a mesh and judge its size.

    Args:
        path: an existing file.
        scale: metres per unit of the file.
        fail: makes the error that names where the mesh is used.
        remedy: how to scale it down by 1000 there.

    Returns:
        A warning, or None.

    Raises:
        InputError: unknown suffix, broken, without triangles, not finite, or larger than any cell.
    """
    if path.suffix.lower() not in _READABLE:
        raise fail(f"mesh {path.name} is of type {path.suffix or 'none'!r}; readable: {', '.join(_READABLE)}")
    from trimesh import load_mesh
    from trimesh.exchange.stl import HeaderError

    try:
        mesh = load_mesh(path, process=False)
        points = np.asarray(mesh.vertices, float)[np.unique(np.asarray(mesh.faces))]
    except (*_BROKEN, HeaderError) as err:
        raise fail(f"mesh {path.name} cannot be read: {err or type(err).__name__}") from None
    if len(points) == 0:
        raise fail(f"mesh {path.name} holds no triangles")
    if not np.isfinite(points).all():
        raise fail(f"mesh {path.name} holds coordinates that are not finite")
    extent = float(np.ptp(points, axis=0).max()) * scale
    if extent > _LARGEST:
        raise fail(f"mesh {path.name} is {extent:.4g} m wide; the file is probably in mm, so {remedy} would work")
    if extent < _SMALLEST:
        return f"mesh {path.name} is only {extent * 1e3:.3g} mm wide; is its scale {scale:g} meant?"
    return None
