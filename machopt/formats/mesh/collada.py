"""Triangles of a COLLADA file (.dae), for a copy as STL: no library reads it for planner and verifier alike.

COLLADA 1.4.1 (Khronos, 2008): ``library_geometries`` placed by the nodes of the scene. As RViz and MoveIt read the
meshes of a URDF, the file's unit counts and its ``up_axis`` does not: the coordinates are those of the link.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from machopt.arrays import Array
from machopt.errors import InputError
from machopt.formats.opener import MESH, read_text
from machopt.formats.urdf.markup import Element, parse_markup
from machopt.se3 import axis_rotation

_FACES = ("triangles", "polylist", "polygons")
_STRIPS = ("tristrips", "trifans")
_DEEPEST = 20  # nodes in nodes; a reference to itself ends here
_UNKNOWN = ("skew", "lookat", "instance_controller")


def read_collada(path: Path) -> Array:
    """(n, 3, 3) corners of the triangles, m.

    Raises:
        InputError: not COLLADA, cut, without triangles, or with something that would move them and is not read.
    """
    root = parse_markup(read_text(path, expected="COLLADA", most=MESH), path, "COLLADA")
    if root.tag != "COLLADA":
        raise InputError(f"is no COLLADA: its root is <{root.tag}>; an STL would work", file=path)
    try:
        found = _Reader(root, path).scene()
    except (ValueError, KeyError, IndexError, StopIteration) as problem:  # a number, a name or an index that is not one
        raise InputError(f"is a damaged COLLADA file: {problem}; an STL would work", file=path) from None
    corners = np.concatenate(found) if found else np.empty((0, 3, 3))
    if not len(corners) or not np.isfinite(corners).all():
        raise InputError("holds no triangles whose corners are numbers; an STL would work", file=path)
    return corners


def stl_bytes(corners: Array) -> bytes:
    """A binary STL of triangles (n, 3, 3)."""
    rows = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
    rows["corners"] = corners
    return b"\0" * 80 + struct.pack("<I", len(corners)) + rows.tobytes()


class _Reader:
    def __init__(self, root: Element, path: Path) -> None:
        self.path = path
        self.by_id = {e.attributes["id"]: e for e in root.descendants() if "id" in e.attributes}
        self.root = root
        asset = root.first("asset")
        unit = asset.first("unit") if asset else None
        self.metre = float(unit.attributes.get("meter", "1")) if unit else 1.0

    def scene(self) -> list[Array]:
        scene = self.root.first("scene")
        shown = scene.first("instance_visual_scene") if scene else None
        if shown is None:
            raise InputError("shows no scene; an STL would work", file=self.path)
        T = np.diag([self.metre, self.metre, self.metre, 1.0])
        return [t for node in self._at(shown.attributes["url"]).named("node") for t in self._node(node, T, 0)]

    def _node(self, node: Element, T: Array, depth: int) -> list[Array]:
        if depth > _DEEPEST:
            raise InputError(f"has nodes more than {_DEEPEST} deep, or one in itself", file=self.path)
        out: list[Array] = []
        for e in node.children:
            if e.tag in _UNKNOWN:
                raise InputError(
                    f"has a <{e.tag}>, which is not read; an STL would work", file=self.path, where=f"line {e.line}"
                )
            T = T @ _transform(e)
        for e in node.children:
            if e.tag == "instance_geometry":
                found = self._geometry(self._at(e.attributes["url"]))
                out += [t @ T[:3, :3].T + T[:3, 3] for t in found]
            elif e.tag == "instance_node":
                out += self._node(self._at(e.attributes["url"]), T, depth + 1)
            elif e.tag == "node":
                out += self._node(e, T, depth + 1)
        return out

    def _geometry(self, geometry: Element) -> list[Array]:
        mesh = geometry.first("mesh")
        if mesh is None:
            raise InputError("has a geometry that is no mesh; an STL would work", file=self.path)
        for e in mesh.children:
            if e.tag in _STRIPS:
                raise InputError(
                    f"has <{e.tag}>, which is not read; an STL would work", file=self.path, where=f"line {e.line}"
                )
        return [self._faces(e) for e in mesh.children if e.tag in _FACES]

    def _faces(self, faces: Element) -> Array:
        """(n, 3, 3) corners; polygons as fans."""
        inputs = faces.named("input")
        vertex = next(i for i in inputs if i.attributes["semantic"] == "VERTEX")
        stride = 1 + max(int(i.attributes.get("offset", "0")) for i in inputs)
        points = self._positions(vertex.attributes["source"])
        at = int(vertex.attributes.get("offset", "0"))
        told = [np.array(p.text.split(), int)[at::stride] for p in faces.named("p")]
        if faces.tag == "polygons":
            counts, index = np.array([len(t) for t in told], int), np.concatenate([*told, np.empty(0, int)])
        else:
            index = np.concatenate([*told, np.empty(0, int)])
            given = faces.first("vcount")
            counts = np.array(given.text.split(), int) if given else np.full(len(index) // 3, 3)
        if counts.sum() != len(index) or (len(index) and not 0 <= index.min() <= index.max() < len(points)):
            raise ValueError(f"line {faces.line}: the corners of <{faces.tag}> are not those it counts")
        begin = np.repeat(np.cumsum(counts) - counts, np.maximum(counts - 2, 0))
        step = np.concatenate([np.arange(1, n - 1) for n in counts if n > 2] or [np.empty(0, int)])
        return np.asarray(points[index[np.stack([begin, begin + step, begin + step + 1], axis=1)]], float)

    def _positions(self, url: str) -> Array:
        """(n, 3) in the file's unit."""
        source = next(
            i.attributes["source"] for i in self._at(url).named("input") if i.attributes["semantic"] == "POSITION"
        )
        element = self._at(source)
        values = next(e for e in element.descendants() if e.tag == "float_array").text.split()
        accessor = next((e for e in element.descendants() if e.tag == "accessor"), None)
        stride = int(accessor.attributes.get("stride", "3")) if accessor else 3
        return np.array(values, float).reshape(-1, stride)[:, :3]

    def _at(self, url: str) -> Element:
        return self.by_id[url.removeprefix("#")]


def _transform(e: Element) -> Array:
    """(4, 4) of a node's own element; the unit matrix for one that moves nothing."""
    T = np.eye(4)
    if e.tag not in ("matrix", "translate", "rotate", "scale"):
        return T
    v = np.array(e.text.split(), float)
    if e.tag == "matrix":
        return np.asarray(v.reshape(4, 4), float)
    if e.tag == "rotate":
        T[:3, :3] = axis_rotation(v[:3] / np.linalg.norm(v[:3]), np.radians(v[3]))
    elif e.tag == "scale":
        T[:3, :3] = np.diag(v[:3])
    else:
        T[:3, 3] = v[:3]
    return T
