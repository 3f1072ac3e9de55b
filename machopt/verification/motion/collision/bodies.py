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
RANDOM_POSES = 120  # random poses that tell link pairs that touch by construction
TOUCHING, COARSE = 0.90, 0.40  # share of them in touch: any pair; links two apart (their meshes often overlap)


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


def list_checked_pairs(
    cell: Cell, arm: UrdfKinematics, bodies: list[CoalBody], clearance: float = 0.0
) -> list[tuple[CoalBody, CoalBody]]:
    """Return the pairs that must not touch: (fixed or lower body, moving or higher body).

    Robot bodies from link 2 on are paired with workpiece and obstacles. Links and tool are paired with links at least
    two apart. The cutter is paired with obstacles and links 0 … 5, and, shortened, with the workpiece. External
    joints add the pairs of :func:`_list_external_pairs`.

    Excluded are pairs that touch in most random poses, like link 1 and the robot's pedestal. Excluded are also pairs
    that are always nearer than ``clearance``, and those that the cell allows to touch.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
        clearance: Required clearance, m.
    """
    out, robot = list_candidate_pairs(cell, arm, bodies)
    for a, b in robot:
        T = sample_random_placements(cell, arm, a, b, RANDOM_POSES)
        if np.mean([is_near(a, b, x, clearance) for x in T]) > TOUCHING:
            continue
        if not (is_two_apart(a, b) and np.mean([is_near(a, b, x) for x in T]) > COARSE):
            out.append((a, b))
    return out


def list_candidate_pairs(
    cell: Cell, arm: UrdfKinematics, bodies: list[CoalBody]
) -> tuple[list[tuple[CoalBody, CoalBody]], list[tuple[CoalBody, CoalBody]]]:
    """Return pairs that are always checked, and pairs of robot and tool that may touch by construction.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
    """
    may = list_allowed_contacts(cell)
    out: list[tuple[CoalBody, CoalBody]] = []
    robot = _list_external_pairs(arm, bodies, may) if cell.external_joints else []
    for a in bodies:
        for b in bodies:
            if (a.name, b.name) in may:
                continue
            if a.kind == "link" and a.link < 0:
                out += [(a, b)] if b.kind == "cutter" else []
            elif a.kind in ("workpiece", "obstacle"):
                if b.kind in ("cutter", "grazing"):
                    wanted = (b.kind == "grazing") == (a.kind == "workpiece")
                    out += [(a, b)] if wanted else []
                elif b.link >= 1:
                    (out if b.link >= 2 else robot).append((a, b))
            elif a.kind == "link" and b.kind == "cutter" and a.link <= 5:
                (out if a.link <= 4 else robot).append((a, b))
            elif a.kind == "link" and b.kind in ("link", "tool") and b.link - a.link >= 2:
                robot.append((a, b))
    return out, robot


def is_two_apart(a: CoalBody, b: CoalBody) -> bool:
    """Return whether exactly one link lies between two bodies of the arm; meshes of such links often overlap.

    Args:
        a: The first body.
        b: The second body.
    """
    return a.kind == "link" and a.link >= 0 and b.link - a.link == 2 and b.kind != "cutter"


def sample_random_placements(cell: Cell, arm: UrdfKinematics, a: CoalBody, b: CoalBody, count: int) -> Array:
    """Return (count, 4, 4) poses of b's carrier in a's carrier at random joint positions, other than the planner's.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        a: The first body.
        b: The second body.
        count: Number of poses.
    """
    rng = np.random.default_rng(20)
    lower, upper = cell.limits.lower, cell.limits.upper
    x = lower + (upper - lower) * rng.random((count, len(lower)))
    world = arm.compute_placements(x[:, :6], x[:, 6:])
    return np.asarray(
        world[:, b.carrier] if a.carrier < 0 else invert_transforms(world[:, a.carrier]) @ world[:, b.carrier]
    )


def _list_external_pairs(
    arm: UrdfKinematics, bodies: list[CoalBody], may: set[tuple[str, str]]
) -> list[tuple[CoalBody, CoalBody]]:
    """Pairs beyond those of an arm on a floor, by which joints lie between the two bodies.

    What stands in the hall or rides on a positioner (a machine's link, the part, an obstacle) against base and link 1
    of the arm, and against each other; a machine's own links against the arm's others and the tool too. Two links of
    one machine are neighbours with a single joint between them; a part on a turning table can meet its cheeks.
    """
    things = [b for b in bodies if b.link < 0]
    out = []
    for n, a in enumerate(things):
        low = a.kind == "link"
        rivals = [b for b in bodies if b.kind == "link" and b.link >= 0 and (low or b.link == 0)]
        rivals += [b for b in bodies if low and b.kind == "tool"]
        for b in (*rivals, *things[n + 1 :]):
            moved = arm.list_moving_joints(a.carrier), arm.list_moving_joints(b.carrier)
            between = len(moved[0] ^ moved[1])
            links = [x for x in (a, b) if x.kind == "link"]
            if len(links) == 2:
                facing = any(_is_on_workpiece(arm, x) and _is_on_base(arm, y) for x, y in (links, links[::-1]))
                neighbours = between < 2 and not facing
            else:
                neighbours = False
            if between and not neighbours and (a.name, b.name) not in may:
                out.append((b, a) if b.carrier < 0 else (a, b))
    return out


def _is_on_base(arm: UrdfKinematics, body: CoalBody) -> bool:
    """It rides on what carries base_link, or on the arm."""
    return body.link >= (1 if arm.is_workpiece_on_base else 0) or bool(
        arm.list_moving_joints(body.carrier) & arm.list_moving_joints(arm.base)
    )


def _is_on_workpiece(arm: UrdfKinematics, body: CoalBody) -> bool:
    """It rides with the workpiece on a positioner."""
    return bool(arm.list_moving_joints(body.carrier) & arm.list_moving_joints(arm.workpiece_placement))


def list_allowed_contacts(cell: Cell) -> set[tuple[str, str]]:
    """Return the names of body pairs that the cell allows to touch, in both orders.

    Args:
        cell: The robot cell.
    """
    one_way = {(a, b) for pair in cell.may_touch for a in pair.first for b in pair.second}
    return one_way | {(b, a) for a, b in one_way}


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
