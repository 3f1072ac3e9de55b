"""Collision bodies as coal geometry: URDF shapes, tool, cutter, workpiece and obstacles, and the pairs to check."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell, CollisionShape, CutterGeometry
from machopt.errors import OutputFolderError
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.verification.motion.collision.convex_parts import ConvexParts, build_convex_parts
from machopt.verification.motion.collision.distance_bounds import bound_distances as verification_bound_distances
from machopt.verification.motion.collision.original_meshes import load_mesh
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CUTTER_SHRINK_M = 1e-4  # m, cutter smaller in rapid moves, which may start and end where it just touches


@dataclass(frozen=True, kw_only=True)
class CoalBody:
    """Collision body as coal geometry, with its carrier."""

    name: str
    kind: str  # link, tool, cutter, grazing (the cutter drawn in), workpiece, obstacle
    link: (
        int  # 0 … 6; the tool side 7; −1 what base_link does not carry: the hall, rails below it, positioner, workpiece
    )
    carrier: int  # entry of Arm.placements that carries it, −1 the world
    place: Array  # (4, 4) in the carrier
    placed: Any  # the same for coal
    shape: Any  # coal geometry
    box_centre: Array  # (3,) m, centre of its own axis-aligned box
    half_size: Array  # (3,) m
    balls: Array  # (K, 3) m, centres of spheres that cover the box
    radius: float  # m

    @cached_property
    def parts(self) -> ConvexParts | None:
        """Convex parts for :func:`bound_distances`; None for an unknown shape."""
        return build_convex_parts(self.shape)


def bound_sphere_box_distance(a: CoalBody, b: CoalBody, T: Array) -> Array:
    """Return (K,) lower bounds of the distance, m, from spheres around one body and a box around the other.

    Args:
        a: The first body.
        b: The second body.
        T: (K, 4, 4) poses of b's carrier in a's carrier.
    """
    turned = a.radius < b.radius
    if turned:
        a, b = b, a
    balls = b.balls @ b.place[:3, :3].T + b.place[:3, 3]
    back = invert_transforms(a.place)
    return np.asarray(
        _bound_sphere_box_distance(np.ascontiguousarray(T), turned, back, a.box_centre, a.half_size, balls, b.radius)
    )


@jit_compile
def _bound_sphere_box_distance(
    T: Array, turned: bool, back: Array, middle: Array, half: Array, balls: Array, radius: float
) -> Array:
    """The spheres stand at T (K, 4, 4) seen from the box's carrier, or that at T seen from theirs (``turned``)."""
    out = np.empty(len(T))
    for n in range(len(T)):
        least = np.inf
        for k in range(len(balls)):
            x, y, z = balls[k]
            if turned:
                x, y, z = x - T[n, 0, 3], y - T[n, 1, 3], z - T[n, 2, 3]
                x, y, z = (
                    T[n, 0, 0] * x + T[n, 1, 0] * y + T[n, 2, 0] * z,
                    T[n, 0, 1] * x + T[n, 1, 1] * y + T[n, 2, 1] * z,
                    T[n, 0, 2] * x + T[n, 1, 2] * y + T[n, 2, 2] * z,
                )
            else:
                x, y, z = (
                    T[n, 0, 0] * x + T[n, 0, 1] * y + T[n, 0, 2] * z + T[n, 0, 3],
                    T[n, 1, 0] * x + T[n, 1, 1] * y + T[n, 1, 2] * z + T[n, 1, 3],
                    T[n, 2, 0] * x + T[n, 2, 1] * y + T[n, 2, 2] * z + T[n, 2, 3],
                )
            away = 0.0
            for c in range(3):
                local = back[c, 0] * x + back[c, 1] * y + back[c, 2] * z + back[c, 3] - middle[c]
                off = max(abs(local) - half[c], 0.0)
                away += off * off
            least = min(least, away)
        out[n] = np.sqrt(least) - radius
    return out


def build_bodies(cell: Cell, arm: UrdfKinematics) -> list[CoalBody]:
    """Return every collision body of the cell, as pinocchio and coal load it.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.

    Raises:
        OutputFolderError: a body of the URDF cannot be loaded.
    """
    import pinocchio as pin

    text = cell.urdf_text
    for name, folder in cell.packages.items():  # a package's folder may have another name than the package
        from xml.sax.saxutils import quoteattr  # it loads all of urllib

        text = text.replace(f"package://{name}/", quoteattr(f"{folder}/")[1:-1])
    folders = [str(cell.urdf.parent), str(cell.folder)]
    try:
        geometry = pin.buildGeomFromUrdfString(arm.model, text, pin.GeometryType.COLLISION, package_dirs=folders)
    except ValueError as problem:
        raise OutputFolderError(
            f"its collision bodies cannot be loaded: {_shorten_message(problem)}", file=cell.urdf
        ) from None
    out = []
    for g in geometry.geometryObjects:
        joint, shape = int(g.parentJoint), g.geometry
        if g.meshPath.lower().endswith((".dae.stl", ".dae")):
            shape = load_mesh(Path(g.meshPath), np.asarray(g.meshScale, float))
        out.append(_build_body(g.name, "link", arm.link_of(int(g.parentFrame)), joint, g.placement.homogeneous, shape))
    flange, part = arm.model.njoints, arm.model.njoints + 1
    out += [_build_body(s.name, "tool", 7, flange, s.T_parent_shape, _build_coal_shape(s)) for s in cell.tool.geometry]
    out += [
        _build_body(s.name, "workpiece", -1, part, s.T_parent_shape, _build_coal_shape(s))
        for s in cell.workpiece.geometry
    ]
    for s in cell.obstacles:
        carrier, place = arm.find_placement(s.link)
        out.append(_build_body(s.name, "obstacle", -1, carrier, place @ s.T_parent_shape, _build_coal_shape(s)))
    if cell.tool.cutter is not None:
        out += [_build_cutter(cell.tool.cutter, cell.tool.T_flange_tcp, flange, kind) for kind in ("cutter", "grazing")]
    return out


def _build_cutter(cutter: CutterGeometry, T_flange_tcp: Array, flange: int, kind: str) -> CoalBody:
    """From the TCP back along −z; drawn in where it may graze: what it cuts it may touch when a rapid move starts."""
    import coal

    less = CUTTER_SHRINK_M if kind == "grazing" else 0.0
    radius = max(cutter.diameter / 2 - less, cutter.diameter / 4)
    length = max(cutter.length - less, cutter.length / 2)
    back = np.eye(4)
    back[2, 3] = length / 2 - cutter.length
    return _build_body("cutter", kind, 7, flange, T_flange_tcp @ back, coal.Cylinder(radius, length))


def _build_coal_shape(shape: CollisionShape) -> Any:
    import coal

    if shape.kind == "box":
        return coal.Box(*shape.size)
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    if shape.kind == "sphere":
        return coal.Sphere(*shape.size)
    return load_mesh(Path(str(shape.mesh)), np.full(3, shape.size[0]))


def _shorten_message(problem: ValueError) -> str:
    """The beginning of a loader's message, which may hold the rest of the file."""
    return " ".join(str(problem).split())[:200]


def compute_reach(b: CoalBody) -> float:
    """Return the greatest distance of a body's points from the origin of its carrier, m.

    Args:
        b: The body.
    """
    return float(np.linalg.norm(b.place[:3, 3]) + np.linalg.norm(b.box_centre) + np.linalg.norm(b.half_size))


def invert_transforms(T: Array) -> Array:
    """Return the inverses of rigid transforms.

    Args:
        T: (..., 4, 4) rigid transforms.
    """
    out = T.copy()
    out[..., :3, :3] = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, 3] = -(out[..., :3, :3] @ T[..., :3, 3:])[..., 0]
    return out


def is_near(a: CoalBody, b: CoalBody, T: Array, margin: float = 0.0) -> bool:
    """Return whether two bodies are within a margin of each other.

    Args:
        a: The first body.
        b: The second body.
        T: (4, 4) pose of b's carrier in a's carrier.
        margin: Distance, m.
    """
    import coal

    request = coal.CollisionRequest()
    request.security_margin = margin
    return bool(
        coal.collide(a.shape, a.placed, b.shape, _build_coal_transform(T @ b.place), request, coal.CollisionResult())
    )


def compute_distance(a: CoalBody, b: CoalBody, T: Array) -> float:
    """Return the distance of two bodies, m; at most 0 in contact.

    Args:
        a: The first body.
        b: The second body.
        T: (4, 4) pose of b's carrier in a's carrier.
    """
    import coal

    return float(
        coal.distance(
            a.shape,
            a.placed,
            b.shape,
            _build_coal_transform(T @ b.place),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )


def bound_distances(
    a: CoalBody, b: CoalBody, T: Array, rows: NDArray[np.intp], way: Array | None = None, claim: Array | None = None
) -> tuple[Array, Array]:
    """Return (K,) lower and upper bounds of the distance in some rows, m.

    See :func:`machopt.verification.motion.collision.distance_bounds.bound_distances`.

    Args:
        a: The first body.
        b: The second body.
        T: (K, 4, 4) poses of b's carrier in a's carrier.
        rows: (R,) rows to bound.
        way: (K,) cumulative motion of b relative to a, m; None: no row bounds the distance of another.
        claim: (K,) stated distances, m; it is enough to show that the distance is not below them.
    """
    if a.parts is None or b.parts is None:
        return np.zeros(len(T)), np.full(len(T), np.inf)
    return verification_bound_distances(a.parts, b.parts, invert_transforms(a.place) @ T @ b.place, rows, way, claim)


def _build_coal_transform(T: Array) -> Any:
    import coal

    return coal.Transform3s(T[:3, :3], T[:3, 3])


def _build_body(name: str, kind: str, link: int, carrier: int, place: Array, shape: Any) -> CoalBody:
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    middle, half = (low + high) / 2, (high - low) / 2
    long = int(np.argmax(half))
    across = float(np.linalg.norm(np.delete(half, long)))
    count = int(np.clip(np.ceil(half[long] / max(across, 1e-6)), 1, 8))
    balls = np.tile(middle, (count, 1))
    balls[:, long] += half[long] * ((2 * np.arange(count) + 1) / count - 1)
    place = np.asarray(place)
    return CoalBody(
        name=name,
        kind=kind,
        link=link,
        carrier=carrier,
        place=place,
        placed=_build_coal_transform(place),
        shape=shape,
        box_centre=middle,
        half_size=half,
        balls=balls,
        radius=float(np.hypot(half[long] / count, across)),
    )
