"""Reader of COLLADA files (.dae), whose triangles are copied to an STL for the planner.

COLLADA 1.4.1 and 1.5 (Khronos). The pycollada library reads the geometries and the node transforms of the scene. Its
triangles are compared with the counts of the file (:mod:`machopt.cell.mesh.collada_counts`), so nothing is lost. The
verifier's library must load the same body (:mod:`machopt.cell.mesh.second_library_check`). As in RViz and MoveIt, the
unit of the file applies and its ``up_axis`` does not: the coordinates are those of the link.
"""

from __future__ import annotations

import io
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from machopt.cell.mesh.collada_counts import ColladaCounts, count_collada
from machopt.cell.mesh.polygon_triangulation import triangulate_polygons
from machopt.cell.urdf.xml_tree import parse_markup
from machopt.errors import MeshError
from machopt.file_formats.file_reading import MESH, read_text
from machopt.numerics.array_types import Array

_NAMESPACE = "http://www.collada.org/2005/11/COLLADASchema"
_KEPT = ("asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene")
_LEFT_OUT = ("extra", "bind_material", "instance_camera", "instance_light", "technique")
_BROKEN = (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError, StopIteration)


@dataclass(frozen=True, eq=False)
class ColladaMesh:
    """A mesh as one list of triangles."""

    corners: Array  # (n, 3, 3) m
    counts: ColladaCounts


def read_collada(path: Path) -> ColladaMesh:
    """Read a COLLADA file.

    Args:
        path: Path of the file.

    Returns:
        Triangles of the scene, m.

    Raises:
        InputError: not COLLADA, cut, without triangles, or with something that would make or move them and is not read.
    """
    text = read_text(path, expected="COLLADA", most=MESH)
    counts = count_collada(parse_markup(text, path, "COLLADA"), path)
    if not counts.triangles:
        raise MeshError("holds no triangles in its scene; an STL would work", file=path)
    found, errors = _read_triangles(text, path)
    if len(found) != counts.triangles:
        reason = f" ({errors[0]})" if errors else ""
        raise MeshError(
            f"counts {counts.triangles} triangles in its scene, and {len(found)} can be read{reason}; a fresh export, "
            "or an STL, would work",
            file=path,
        )
    corners = np.asarray(found * counts.metre, float)
    if not np.isfinite(corners).all():
        raise MeshError("holds triangles whose corners are not finite; an STL would work", file=path)
    return ColladaMesh(corners, counts)


_UP = {  # rows: the axes of a scene with Z up in those of the file (COLLADA 1.4.1, up_axis)
    "X_UP": ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)),
    "Y_UP": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "Z_UP": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}


def compute_up_rotation(up_axis: str) -> Array:
    """Return the transform (4, 4) that turns the stated axis of a file to z.

    Bodies of a cell follow the axis that the file states. Bodies of a URDF do not, as in RViz and MoveIt.

    Args:
        up_axis: X_UP, Y_UP or Z_UP.
    """
    T = np.eye(4)
    T[:3, :3] = _UP[up_axis]
    return T


def build_binary_stl(corners: Array) -> bytes:
    """Build a binary STL file.

    Args:
        corners: Triangle corners (n, 3, 3).

    Returns:
        Content of the file.
    """
    rows = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
    rows["corners"] = corners
    return b"\0" * 80 + struct.pack("<I", len(corners)) + rows.tobytes()


def _read_triangles(text: str, path: Path) -> tuple[Array, list[str]]:
    """(n, 3, 3) in the file's unit, as pycollada reads them, and what it could not read."""
    try:
        import collada
    except ImportError:
        raise MeshError(
            "is COLLADA, and the Python package pycollada is not installed; `pip install pycollada`, or an STL, "
            "would work",
            file=path,
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of materials and textures, which are not used
            # errors of geometries that the scene places are seen by the count
            file: Any = collada.Collada(io.BytesIO(_remove_appearance(text)), ignore=[collada.common.DaeError])
            bound = [] if file.scene is None else list(file.scene.objects("geometry"))
            parts = [_list_triangle_corners(part) for geometry in bound for part in geometry.primitives()]
    except (*_BROKEN, collada.common.DaeError) as problem:
        message = " ".join(str(problem).split())[:200]
        raise MeshError(f"is a damaged COLLADA file: {message}; an STL would work", file=path) from None
    errors = [" ".join(str(e).split())[:200] for e in file.errors]
    return np.concatenate([np.empty((0, 3, 3)), *parts]), errors


def _remove_appearance(text: str) -> bytes:
    """The same file in one name space without appearance, lights and cameras, whose mistakes would drop geometries."""
    root = ElementTree.fromstring(text)  # document types and entities were refused
    for e in root.iter():
        e.tag = f"{{{_NAMESPACE}}}{_strip_namespace(e)}"
        for child in [
            c for c in e if _strip_namespace(c) in _LEFT_OUT or (e is root and _strip_namespace(c) not in _KEPT)
        ]:
            e.remove(child)
        if _strip_namespace(e) == "accessor" and not any(p.get("name") for p in e):
            e[:] = [ElementTree.Element("param", name=name, type="float") for name in "XYZ"]
        elif _strip_namespace(e) == "mesh":
            _remove_normals_and_colours(e)
    return ElementTree.tostring(root)


def _remove_normals_and_colours(mesh: ElementTree.Element) -> None:
    """Leave out normals, colours and the like; their places between the indices stay."""
    vertices = next(v for v in mesh if _strip_namespace(v) == "vertices")
    for i in [i for i in vertices if i.get("semantic") != "POSITION"]:
        vertices.remove(i)
    used = vertices[0].get("source", "")
    for source in [s for s in mesh if _strip_namespace(s) == "source" and f"#{s.get('id')}" != used]:
        mesh.remove(source)
    for part in mesh:
        for i in [i for i in part if _strip_namespace(i) == "input" and part is not vertices]:
            i.set("offset", i.get("offset", "0"))
            if i.get("semantic") != "VERTEX":
                i.attrib.update(semantic="COLOR", source=used)  # a meaning whose indices are not used


def _strip_namespace(e: ElementTree.Element) -> str:
    return e.tag.rpartition("}")[2]


def _list_triangle_corners(part: Any) -> Array:
    """(n, 3, 3) of one group of faces, placed; none of lines."""
    import collada

    if isinstance(part, collada.triangleset.BoundTriangleSet):
        return np.asarray(part.vertex[part.vertex_index], float).reshape(-1, 3, 3)
    if isinstance(part, collada.polylist.BoundPolylist):
        return triangulate_polygons(
            np.asarray(part.vertex, float), np.asarray(part.vertex_index), part.original.vcounts
        )
    return np.empty((0, 3, 3))
