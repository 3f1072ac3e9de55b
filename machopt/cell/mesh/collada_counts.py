"""Triangle counts of a COLLADA file from its text, to refuse files that a reader would read incompletely.

The count is independent of the library that reads the geometry. Every number of every array in use is checked, and
every declared count is compared with the data. The triangles of all geometries in the scene are summed. A file with
another count in the reader is refused, never read partly.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.cell.urdf.xml_tree import XmlElement
from machopt.errors import InputError, MeshError
from machopt.numerics.array_types import Array

FACES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_LINES = ("lines", "linestrips")
_DEEPEST = 20  # nodes in nodes; a reference to itself ends here
_MOST = 2_000_000  # triangles; a collision mesh has some thousand
_UNIT = 1e-3  # by which a printed unit vector may miss its length
_MOST_NODES = 20_000  # placed by the scene
_MOVES = ("matrix", "translate", "rotate", "scale", "lookat")
_NUMBERS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9}
_DEFORMS = "deforms its geometry; a file without skeleton, or an STL, would work"


@dataclass(frozen=True)
class ColladaCounts:
    """What a COLLADA file states about itself."""

    metre: float  # m per unit of the file
    up_axis: str  # X_UP, Y_UP or Z_UP
    triangles: int  # of all geometries, as often as the scene places them
    placed: int  # geometries, as often as the scene places them


def count_collada(root: XmlElement, path: Path) -> ColladaCounts:
    """Return the counts of a COLLADA file.

    Args:
        root: Root element of the file.
        path: Path of the file.

    Returns:
        Counts of the triangles.

    Raises:
        InputError: a number that is none, a count that is not that of the data, a reference to nothing, or something
            that makes or moves triangles and is not read.
    """
    if root.tag != "COLLADA":
        raise MeshError(f"is no COLLADA: its root is <{root.tag}>; an STL would work", file=path)
    return _TriangleCounter(root, path).count()


class _TriangleCounter:
    def __init__(self, root: XmlElement, path: Path) -> None:
        self.root, self.path = root, path
        self.by_id = {e.attributes["id"]: e for e in root.descendants() if "id" in e.attributes}
        self.known: dict[int, int] = {}  # triangles of a geometry and points of a source, by its element
        self.placed = self.visited = 0

    def count(self) -> ColladaCounts:
        asset = self.root.find_first_child("asset")
        unit = asset.find_first_child("unit") if asset else None
        axis = asset.find_first_child("up_axis") if asset else None
        metre = 1.0
        if unit is not None and "meter" in unit.attributes:
            metre = float(self.numbers(unit, unit.attributes["meter"], 1)[0])
            if not metre > 0.0:
                raise self.error(unit, f"has a unit of {metre:g} m; expected more than zero")
        scene = self.root.find_first_child("scene")
        shown = scene.find_first_child("instance_visual_scene") if scene else None
        if shown is None:
            raise MeshError("shows no scene; an STL would work", file=self.path)
        nodes = self.at(shown, "url").find_children("node")
        total = sum(self.node(node, 0) for node in nodes)
        return ColladaCounts(metre, axis.text.strip() if axis else "Y_UP", total, self.placed)

    def node(self, node: XmlElement, depth: int) -> int:
        self.visited += 1
        if depth > _DEEPEST or self.visited > _MOST_NODES:
            raise self.error(node, f"has nodes more than {_DEEPEST} deep, one in itself, or more than {_MOST_NODES}")
        total = 0
        for e in node.children:
            if e.tag in _MOVES:
                values = self.numbers(e, e.text, _NUMBERS[e.tag])
                if e.tag == "rotate" and abs(np.linalg.norm(values[:3]) - 1.0) > _UNIT:
                    raise self.error(
                        e, "rotates about an axis whose length is not 1, which readers carry out differently"
                    )
            elif e.tag == "skew":
                raise self.error(e, "has a <skew>, which is not read; an STL would work")
            elif e.tag == "instance_controller":
                raise self.error(e, f"has an <{e.tag}>, which {_DEFORMS}")
            elif e.tag == "node":
                total += self.node(e, depth + 1)
            elif e.tag == "instance_node":
                total += self.node(self.at(e, "url"), depth + 1)
            elif e.tag == "instance_geometry":
                self.placed += 1
                total += self.geometry(self.at(e, "url"))
            if total > _MOST:
                raise self.error(e, f"places more than {_MOST} triangles; a decimated mesh would work")
        return total

    def geometry(self, geometry: XmlElement) -> int:
        if id(geometry) not in self.known:
            mesh = geometry.find_first_child("mesh")
            if mesh is None:
                raise self.error(geometry, "has a geometry that is no mesh; an STL would work")
            for e in mesh.children:
                if e.tag not in (*FACES, *_LINES, "source", "vertices", "extra"):
                    raise self.error(e, f"has <{e.tag}> in a mesh, which is not read; an STL would work")
            self.known[id(geometry)] = sum(self.faces(e) for e in mesh.children if e.tag in FACES)
        return self.known[id(geometry)]

    def faces(self, faces: XmlElement) -> int:
        """Triangles of one group of faces; its numbers and counts are checked."""
        if faces.find_first_child("ph") is not None:
            raise self.error(faces, "has polygons with holes, which are not read; triangles, or an STL, would work")
        inputs = faces.find_children("input")
        vertex = [i for i in inputs if i.attributes.get("semantic") == "VERTEX"]
        if len(vertex) != 1:
            raise self.error(faces, f"has <{faces.tag}> with {len(vertex)} inputs of VERTEX; expected one")
        stride = 1 + max(self.offset(i) for i in inputs)
        points = self.positions(vertex[0])
        rows = [self.indices(p, stride, self.offset(vertex[0]), points) for p in faces.find_children("p")]
        found = self.shares(faces, rows)
        stated = faces.attributes.get("count")
        if stated is not None and (not stated.strip().isdigit() or int(stated) != found):
            raise self.error(faces, f"counts {stated} in <{faces.tag}> and holds {found}; a fresh export would work")
        return self.triangles(faces, rows)

    def shares(self, faces: XmlElement, rows: list[int]) -> int:
        """What ``count`` of a group counts: triangles, polygons, strips or fans."""
        if faces.tag == "triangles":
            if any(n % 3 for n in rows):
                raise self.error(faces, "holds corners in <triangles> that are no multiple of three")
            return sum(rows) // 3
        if faces.tag != "polylist":
            return len(rows)
        corners = self.corners(faces)
        if len(rows) > 1 or corners.sum() != sum(rows):
            raise self.error(faces, f"counts {corners.sum()} corners in <polylist> and holds {sum(rows)}")
        return len(corners)

    def triangles(self, faces: XmlElement, rows: list[int]) -> int:
        if faces.tag == "triangles":
            return sum(rows) // 3
        corners = self.corners(faces) if faces.tag == "polylist" else np.array(rows, int)
        return int(np.maximum(corners - 2, 0).sum())

    def corners(self, faces: XmlElement) -> NDArray[np.int_]:
        """(P,) corners of the polygons of a polylist."""
        given = faces.find_first_child("vcount")
        found = np.empty(0) if given is None else self.numbers(given, given.text)
        if (found < 0).any() or (found != found.round()).any():
            raise self.error(faces, "counts the corners of its polygons with numbers that are none")
        return found.astype(int)

    def indices(self, p: XmlElement, stride: int, at: int, points: int) -> int:
        """Corners of one <p>, each of which names a point that is there."""
        values = self.numbers(p, p.text)
        if len(values) % stride:
            raise self.error(p, f"holds {len(values)} indices in <p>, no multiple of {stride}")
        own = values[at::stride]
        if len(own) and not (own.min() >= 0 and own.max() < points and (own == own.round()).all()):
            raise self.error(p, f"names corners {own.min():g} to {own.max():g} of {points} in <p>")
        return len(own)

    def positions(self, vertex: XmlElement) -> int:
        """Number of points that a VERTEX input names; their numbers are checked."""
        inputs = [
            i for i in self.at(vertex, "source").find_children("input") if i.attributes.get("semantic") == "POSITION"
        ]
        if len(inputs) != 1:
            raise self.error(vertex, f"names vertices with {len(inputs)} inputs of POSITION; expected one")
        source = self.at(inputs[0], "source")
        if id(source) in self.known:
            return self.known[id(source)]
        array = source.find_first_child("float_array")
        technique = source.find_first_child("technique_common")
        accessor = technique.find_first_child("accessor") if technique else None
        if array is None or accessor is None:
            raise self.error(source, "has points without <float_array> or <accessor>; a fresh export would work")
        stated = array.attributes.get("count", "")
        values = self.numbers(array, array.text, int(stated) if stated.strip().isdigit() else None)
        names = [p.attributes.get("name", "").upper() for p in accessor.find_children("param")]
        plain = not any(names) or names == ["X", "Y", "Z"]
        stride, offset = accessor.attributes.get("stride", "1"), accessor.attributes.get("offset", "0")
        if (stride.strip(), offset.strip()) != ("3", "0") or not plain or len(values) % 3:
            raise self.error(accessor, "has points that are not three numbers X, Y, Z each; a fresh export would work")
        count = accessor.attributes.get("count", str(len(values) // 3)).strip()
        if count != str(len(values) // 3):
            raise self.error(accessor, f"counts {count} points and holds {len(values) // 3}")
        self.known[id(source)] = len(values) // 3
        return len(values) // 3

    def numbers(self, e: XmlElement, text: str, count: int | None = None) -> Array:
        words = text.split()
        try:
            values = np.array(words, float)
        except ValueError:
            raise self.error(e, f"holds a word in <{e.tag}> that is no number") from None
        if not np.isfinite(values).all():
            raise self.error(e, f"holds numbers in <{e.tag}> that are not finite")
        if count is not None and len(values) != count:
            raise self.error(
                e, f"counts {count} numbers in <{e.tag}> and holds {len(values)}; a fresh export would work"
            )
        return values

    def offset(self, i: XmlElement) -> int:
        text = i.attributes.get("offset", "0").strip()
        if not text.isdigit() or int(text) > 100:
            raise self.error(i, f"has an <input> with the offset {text!r}")
        return int(text)

    def at(self, e: XmlElement, key: str) -> XmlElement:
        url = e.attributes.get(key, "")
        if url.removeprefix("#") not in self.by_id or not url.startswith("#"):
            raise self.error(e, f"names {url!r} in <{e.tag}>, which is not in the file")
        return self.by_id[url[1:]]

    def error(self, e: XmlElement, message: str) -> InputError:
        return MeshError(message, file=self.path, where=f"line {e.line}")
