"""Exact distances between two bodies' surfaces (the only importer of fcl)."""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.collision.bodies import CollisionBody, find_points_inside
from machopt.numerics.array_types import Array, Bools


class FclSurfaces:
    """Bodies as fcl triangle meshes; each query places only the second one, relative to the first one's link.

    Args:
        bodies: with vertices in base_link at q = 0.
    """

    def __init__(self, bodies: list[CollisionBody]) -> None:
        self._bodies = bodies
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
        R, t = T[:, :3, :3], T[:, :3, 3]
        inside = find_points_inside(a, R @ b.vertices[0] + t)
        rest = np.flatnonzero(~inside)
        inside[rest] = find_points_inside(b, np.einsum("sji,sj->si", R[rest], a.vertices[0] - t[rest]))
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
