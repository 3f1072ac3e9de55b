"""Exact distances between two bodies' surfaces (the only importer of fcl)."""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.collision.bodies import CollisionBody, find_points_inside
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile

ROUNDING_M = 1e-9  # m, rounding error of a placed vertex; the exact test follows


class FclSurfaces:
    """Bodies as fcl triangle meshes; each query places only the second one, relative to the first one's link.

    Args:
        bodies: with vertices in base_link at q = 0.
    """

    def __init__(self, bodies: list[CollisionBody]) -> None:
        self._bodies = bodies
        self._boxes: dict[int, tuple[Array, Array, Array]] = {}
        self._objects: dict[int, tuple[Any, Any]] = {}

    def compute_distance(self, pair: tuple[int, int], T: Array) -> float:
        """Return the distance of the surfaces in m; ≤ 0 where they cross.

        Args:
            pair: indices of the two bodies.
            T: (4, 4) motion of the second body relative to the first.
        """
        import fcl

        return float(fcl.distance(*self._place_body(pair, T), fcl.DistanceRequest(), fcl.DistanceResult()))

    def is_contained(self, pair: tuple[int, int], T: Array) -> bool:
        """Return whether one body is wholly inside the other, given that the surfaces do not cross: one vertex decides.

        Args:
            pair: indices of the two bodies.
            T: (4, 4) motion of the second body relative to the first.
        """
        return bool(self.find_contained(pair, T[None])[0])

    def find_contained(self, pair: tuple[int, int], T: Array) -> Bools:
        """Return (S,) whether one body is wholly inside the other, as :meth:`is_contained`.

        Args:
            pair: indices of the two bodies.
            T: (S, 4, 4) motions of the second body relative to the first.
        """
        a, b = (self._bodies[k] for k in pair)
        for k in pair:
            if k not in self._boxes:
                self._boxes[k] = _list_box_arrays(self._bodies[k])
        boxes = self._boxes[pair[0]], self._boxes[pair[1]]
        inside: Bools = _find_boxed_vertices(np.ascontiguousarray(T), a.vertices[0], b.vertices[0], *boxes)
        near = np.flatnonzero(inside)  # few: a vertex outside of the other body's box is not inside that body
        if len(near):
            R, t = T[near, :3, :3], T[near, :3, 3]
            inside[near] = find_points_inside(a, R @ b.vertices[0] + t)
            rest = np.flatnonzero(~inside[near])
            back = np.einsum("sji,sj->si", R[rest], a.vertices[0] - t[rest])
            inside[near[rest]] = find_points_inside(b, back)
        return inside

    def _place_body(self, pair: tuple[int, int], T: Array) -> tuple[Any, Any]:
        import fcl

        moving = self._build_object(pair[1])[1]
        moving.setTransform(fcl.Transform(T[:3, :3], T[:3, 3]))
        return self._build_object(pair[0])[0], moving

    def _build_object(self, k: int) -> tuple[Any, Any]:
        """Return the fixed and the moving object of a body, built at first use, because most pairs never come near."""
        import fcl

        if k not in self._objects:
            mesh = _build_fcl_mesh(self._bodies[k])
            self._objects[k] = fcl.CollisionObject(mesh), fcl.CollisionObject(mesh)
        return self._objects[k]


def _build_fcl_mesh(body: CollisionBody) -> Any:
    import fcl

    model = fcl.BVHModel()
    model.beginModel(len(body.faces), len(body.vertices))
    model.addSubModel(np.ascontiguousarray(body.vertices), np.ascontiguousarray(body.faces))
    model.endModel()
    return model


def _list_box_arrays(body: CollisionBody) -> tuple[Array, Array, Array]:
    """Return centre (3,), axes as columns (3, 3) and half edges (3,) of a body's box, as the kernel takes them."""
    centre, axes, half = (np.array(v, float) for v in (body.box_centre, body.box_rotation, body.box_half))
    return centre, np.ascontiguousarray(axes), half


@jit_compile
def _find_boxed_vertices(
    T: Array, va: Array, vb: Array, box_a: tuple[Array, Array, Array], box_b: tuple[Array, Array, Array]
) -> Bools:
    """Return (S,) whether a vertex (3,) of either body lies in the box of the other one.

    Args:
        T: (S, 4, 4) motions of the second body relative to the first.
        va: vertex of the first body.
        vb: vertex of the second body.
        box_a: centre (3,), axes as columns (3, 3) and half edges (3,) of the first body's box, in m.
        box_b: the same of the second body.
    """
    out = np.zeros(len(T), np.bool_)
    point = np.empty(3)
    for s in range(len(T)):
        for c in range(3):
            point[c] = T[s, c, 0] * vb[0] + T[s, c, 1] * vb[1] + T[s, c, 2] * vb[2] + T[s, c, 3]
        out[s] = _is_in_box(point, box_a)
        if not out[s]:
            x, y, z = va[0] - T[s, 0, 3], va[1] - T[s, 1, 3], va[2] - T[s, 2, 3]
            for c in range(3):
                point[c] = T[s, 0, c] * x + T[s, 1, c] * y + T[s, 2, c] * z
            out[s] = _is_in_box(point, box_b)
    return out


@jit_compile
def _is_in_box(point: Array, box: tuple[Array, Array, Array]) -> bool:
    """Return whether a point (3,) m lies in a box, with a reserve for rounding."""
    centre, axes, half = box
    for c in range(3):
        along = 0.0
        for k in range(3):
            along += (point[k] - centre[k]) * axes[k, c]
        if abs(along) > half[c] + ROUNDING_M:
            return False
    return True
