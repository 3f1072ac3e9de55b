"""Collision bodies as triangle meshes in base_link at zero, each with a box and a few spheres around it.

Each body moves with a link of the machine's chain (:mod:`machopt.kinematics.machine`). For an arm alone, link 0 is
base_link with everything that is fixed. At zero all joints are zero.

Boxes, cylinders and spheres become triangles too (round ones circumscribed, so never smaller than they are):
triangle–triangle distances are exact and need no iteration, and one code path serves all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.cell.mesh.collada_reader import read_collada
from machopt.data_types.cell import Cell, CollisionShape, CutterGeometry
from machopt.errors import MeshError
from machopt.kinematics.machine import Machine
from machopt.kinematics.machine_lines import LinkCarriers
from machopt.kinematics.robot import LinkShape
from machopt.numerics import mesh_construction
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.identity_cache import IdentityCache
from machopt.numerics.rigid_transforms import invert_transform

BodyKind = Literal["link", "tool", "cutter", "workpiece", "obstacle"]

CYLINDER_SIDES = 48  # circumscribed: at most 0.22 % outside the true radius
SPHERE_SUBDIVISIONS = 3  # 1,280 faces, at most 0.7 % outside the true radius
SPHERE_SLABS = 6  # maximum number of spheres around one body
CONTACT_TOLERANCE_M = 1e-4  # m, reduction of the cutter in the cutter–workpiece test of moves that do not cut


@dataclass(frozen=True, eq=False, kw_only=True)
class CollisionBody:
    """A closed or open surface that moves with one link of the chain (0: what the part moves with)."""

    name: str
    kind: BodyKind
    link: int  # 0 … 6 + E
    vertices: Array  # (V, 3) m, in base_link at zero
    faces: NDArray[np.int64]  # (F, 3)
    box_rotation: Array  # (3, 3) columns: axes of a box around the body, in base_link at zero
    box_centre: Array  # (3,) m
    box_half: Array  # (3,) m
    sphere_centres: Array  # (K, 3) m; K spheres that cover the box
    sphere_radius: float  # m, of each
    unattached_links: tuple[int, ...] = ()  # adjacent links in the chain that are not attached to it


_CLOSED: IdentityCache[CollisionBody, bool] = IdentityCache()  # whether the surface of a body is closed


def build_robot_bodies(carriers: LinkCarriers, shapes: tuple[LinkShape, ...]) -> list[CollisionBody]:
    """Return the URDF's collision shapes as bodies.

    Args:
        carriers: links of the chain that carry the links of the URDF.
        shapes: collision shapes of the URDF.
    """
    out = []
    for s in shapes:
        by = carriers.find_for_shape(s)
        out.append(
            replace(_build_body(s.shape, "link", by.link, s.shape.T_parent_shape), unattached_links=by.unattached_links)
        )
    return out


def build_cell_bodies(cell: Cell, carriers: LinkCarriers) -> list[CollisionBody]:
    """Return tool, workpiece and obstacles of the cell (without the cutter, see :func:`build_cutter_body`).

    Args:
        cell: robot cell.
        carriers: links of the chain that carry the links of the URDF.
    """
    machine = carriers.machine
    T_base_world = invert_transform(machine.T_world_base_zero)
    flange = machine.robot.T_base_flange_zero
    out = [_build_body(s, "tool", machine.base_link + 6, flange @ s.T_parent_shape) for s in cell.tool.geometry]
    T_base_part = machine.T_base_workpiece_zero
    out += [_build_body(s, "workpiece", 0, T_base_part @ s.T_parent_shape) for s in cell.workpiece.geometry]
    for s in cell.obstacles:
        link, T = (machine.world_link, T_base_world) if s.link == "world" else carriers.locate_link(s.link)
        out.append(_build_body(s, "obstacle", link, T @ s.T_parent_shape))
    return out


def build_cutter_body(cell: Cell, machine: Machine, cutter: CutterGeometry, shrink: float = 0.0) -> CollisionBody:
    """Return the cutter as a cylinder from the TCP back along −z.

    Args:
        cell: robot cell with the tool frame.
        machine: chain of the cell.
        cutter: dimensions of the cutter.
        shrink: m, reduction of its radius and its length at the tip.
    """
    radius = max(cutter.diameter / 2 - shrink, cutter.diameter / 4)
    length = max(cutter.length - shrink, cutter.length / 2)
    T = machine.robot.T_base_flange_zero @ cell.tool.T_flange_tcp
    centre = np.eye(4)
    centre[2, 3] = -cutter.length + length / 2
    return _build_body(
        CollisionShape(name="cutter", kind="cylinder", size=(radius, length), mesh=None, T_parent_shape=np.eye(4)),
        "cutter",
        machine.base_link + 6,
        T @ centre,
    )


def build_tool_bodies(cell: Cell) -> list[CollisionBody]:
    """Return the tool's bodies alone, in the flange frame.

    Args:
        cell: robot cell with the tool.
    """
    return [_build_body(s, "tool", 0, s.T_parent_shape) for s in cell.tool.geometry]


def list_candidate_pairs(bodies: list[CollisionBody]) -> list[tuple[int, int]]:
    """Return the pairs (lower link first) that could touch, without the cutter's.

    Args:
        bodies: all bodies.
    """
    out = []
    for i, a in enumerate(bodies):
        for j, b in enumerate(bodies):
            if a.link >= b.link:
                continue
            both = a.kind in ("link", "tool") and b.kind in ("link", "tool")
            if not (both and is_directly_attached(a, b)):
                out.append((i, j))
    return out


def list_adjacent_pairs(bodies: list[CollisionBody]) -> list[tuple[int, int]]:
    """Return the pairs that are not compared because one is attached to the other: adjacent links, the last one and the
    tool.

    Bodies fixed to each other are not included.

    Args:
        bodies: all bodies.
    """
    moving = [(i, b) for i, b in enumerate(bodies) if b.kind in ("link", "tool")]
    return [(i, j) for i, a in moving for j, b in moving if a.link < b.link and is_directly_attached(a, b)]


def list_allowed_contacts(cell: Cell) -> dict[frozenset[str], str]:
    """Return the pairs of body names that the cell allows to touch, with the place in the file.

    Args:
        cell: robot cell with ``may_touch``.
    """
    return {
        frozenset((a, b)): f"may touch: {pair.source} ({pair.a} ~ {pair.b})"
        for pair in cell.may_touch
        for a in pair.first
        for b in pair.second
    }


def is_directly_attached(a: CollisionBody, b: CollisionBody) -> bool:
    """Return whether two bodies of the machine are directly attached to each other.

    Args:
        a: first body.
        b: second body.
    """
    return count_links_between(a, b) == 1 and b.link not in a.unattached_links and a.link not in b.unattached_links


def count_links_between(a: CollisionBody, b: CollisionBody) -> int:
    """Return the number of steps along the chain; the tool is one beyond the last link.

    Args:
        a: first body.
        b: second body.
    """
    return abs((a.link + (a.kind == "tool")) - (b.link + (b.kind == "tool")))


def is_point_inside(body: CollisionBody, point: Array) -> bool:
    """Return whether a point lies in the solid of a body (:func:`find_points_inside`).

    Args:
        body: body with the surface.
        point: (3,) m, in base_link at zero.
    """
    return bool(find_points_inside(body, np.asarray(point, float)[None])[0])


def find_points_inside(body: CollisionBody, points: Array) -> Bools:
    """Return (n,) whether points lie in the solid bounded by a closed, outward-oriented surface.

    Sums the solid angles of the triangles (Van Oosterom and Strackee 1983, eq. 8). Open surfaces bound
    nothing, and a room with inward normals is hollow.

    Args:
        body: body with the surface.
        points: (n, 3) m, in base_link at zero.
    """
    local = (points - body.box_centre) @ body.box_rotation
    inside: Bools = np.asarray((np.abs(local) <= body.box_half).all(axis=1))
    if not inside.any():
        return inside
    if not _CLOSED.get(body, lambda known: is_closed_surface(known.faces)):
        return np.zeros(len(points), bool)
    vertices, faces = np.ascontiguousarray(body.vertices, float), np.ascontiguousarray(body.faces, np.int64)
    inside[inside] = _sum_solid_angles(vertices, faces, np.ascontiguousarray(points[inside], float)) > 2.0 * np.pi
    return inside


@jit_compile
def _sum_solid_angles(vertices: Array, faces: NDArray[np.int64], points: Array) -> Array:
    """Return (n,) sr, the signed solid angle of a surface as seen from points (n, 3)."""
    out = np.zeros(len(points))
    v, length, dot = np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(len(points)):
        for f in range(len(faces)):
            for k in range(3):
                for c in range(3):
                    v[k, c] = vertices[faces[f, k], c] - points[n, c]
                length[k] = np.sqrt(v[k, 0] ** 2 + v[k, 1] ** 2 + v[k, 2] ** 2)
            for k in range(3):
                m = (k + 1) % 3
                dot[k] = v[k, 0] * v[m, 0] + v[k, 1] * v[m, 1] + v[k, 2] * v[m, 2]
            top = v[0, 0] * (v[1, 1] * v[2, 2] - v[1, 2] * v[2, 1])
            top += v[0, 1] * (v[1, 2] * v[2, 0] - v[1, 0] * v[2, 2])
            top += v[0, 2] * (v[1, 0] * v[2, 1] - v[1, 1] * v[2, 0])
            below = length[0] * length[1] * length[2]
            below += dot[0] * length[2] + dot[1] * length[0] + dot[2] * length[1]
            out[n] += 2.0 * np.arctan2(top, below)
    return out


def is_closed_surface(faces: NDArray[np.int64]) -> bool:
    """Return whether every edge occurs once in each direction.

    Args:
        faces: (F, 3) vertex indices.
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = int(faces.max()) + 1
    forth, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    return bool(np.array_equal(np.sort(forth), np.sort(back)))


def _build_body(shape: CollisionShape, kind: BodyKind, link: int, T_base_shape: Array) -> CollisionBody:
    vertices, faces = triangulate_shape(shape)
    body = _add_bounding_volumes(
        CollisionBody(
            name=shape.name,
            kind=kind,
            link=link,
            vertices=vertices,
            faces=faces,
            box_rotation=np.eye(3),
            box_centre=np.zeros(3),
            box_half=np.zeros(3),
            sphere_centres=np.zeros((1, 3)),
            sphere_radius=0.0,
        )
    )
    R, t = T_base_shape[:3, :3], T_base_shape[:3, 3]
    return replace(
        body,
        vertices=vertices @ R.T + t,
        box_rotation=R @ body.box_rotation,
        box_centre=R @ body.box_centre + t,
        sphere_centres=body.sphere_centres @ R.T + t,
    )


def triangulate_shape(shape: CollisionShape) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices (V, 3) m and faces (F, 3) of a shape in its own frame; round ones circumscribed.

    Args:
        shape: mesh, box, cylinder or sphere.

    Raises:
        InputError: a mesh cannot be read.
    """
    if shape.kind == "mesh":
        return _load_mesh(shape)
    if shape.kind == "box":
        return mesh_construction.build_box(shape.size)
    if shape.kind == "cylinder":
        outer = shape.size[0] / np.cos(np.pi / CYLINDER_SIDES)
        return mesh_construction.build_cylinder(outer, shape.size[1], CYLINDER_SIDES)
    import trimesh  # late: few cells have spheres

    mesh = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=1.0)
    depth = np.einsum("ij,ij->i", mesh.face_normals, mesh.vertices[mesh.faces[:, 0]]).min()
    mesh.apply_scale(shape.size[0] / depth)
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def _load_mesh(shape: CollisionShape) -> tuple[Array, NDArray[np.int64]]:
    path = Path(shape.mesh) if shape.mesh is not None else Path("")
    if not path.is_file():
        raise MeshError(f"mesh of {shape.name!r} is not a file", file=path)
    plain = mesh_construction.parse_binary_stl(path.read_bytes()) if path.suffix.lower() == ".stl" else None
    if path.suffix.lower() == ".dae":
        corners = read_collada(path).corners  # m
        plain = mesh_construction.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    vertices, faces = mesh_construction.merge_equal_vertices(
        _load_with_trimesh(shape, path) if plain is None else plain
    )
    if not len(faces) or not np.isfinite(vertices).all():
        raise MeshError(f"mesh of {shape.name!r} holds no finite triangles", file=path)
    return vertices * shape.size[0], faces


def _load_with_trimesh(shape: CollisionShape, path: Path) -> mesh_construction.TriangleMesh:
    """Load a mesh of any format that trimesh reads."""
    import trimesh

    try:
        mesh = trimesh.load(path, force="mesh")
    except (ValueError, TypeError, KeyError, IndexError, NotImplementedError, ImportError) as error:
        raise MeshError(
            f"mesh of {shape.name!r} cannot be read ({error}); STL, OBJ or PLY would work", file=path
        ) from error
    return mesh_construction.TriangleMesh(np.array(mesh.vertices, float), np.array(mesh.faces, np.int64))


def _add_bounding_volumes(body: CollisionBody) -> CollisionBody:
    """Add a box (own or principal axes, the smaller) and spheres along its longest side to the body."""
    v = body.vertices
    principal = np.linalg.eigh(np.cov((v - v.mean(0)).T))[1]
    boxes = []
    for R in (np.eye(3), principal * np.sign(np.linalg.det(principal))):
        low, high = (v @ R).min(0), (v @ R).max(0)
        boxes.append((float(np.prod(high - low + 1e-6)), R, R @ (low + high) / 2, (high - low) / 2))
    _, R, centre, half = min(boxes, key=lambda box: box[0])
    long = int(np.argmax(half))
    across = float(np.linalg.norm(np.delete(half, long)))
    count = int(np.clip(np.ceil(half[long] / max(across, 1e-9)), 1, SPHERE_SLABS))
    offset = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    return replace(
        body,
        box_rotation=R,
        box_centre=centre,
        box_half=half,
        sphere_centres=centre + np.outer(offset * half[long], R[:, long]),
        sphere_radius=float(np.hypot(half[long] / count, across)),
    )
