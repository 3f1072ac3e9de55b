"""Contacts along a motion, at the samples and between them, by coal.

A pair is free between two rows when neither touches, with the second body's relative motion D in between, a copy
grown by D/2 (coal's security margin) at either row: every point of the way is within D/2 of one of them. Where
that is not so, the stretch is halved, first at samples, then between two samples, linear in the joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell, Cutter, Shape
from machopt.errors import InputError
from machopt.verify.arm import Arm

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

STEP = np.radians(0.5)  # joint motion between rows that are looked at first
FLOOR = 1e-4  # m, motion below which a stretch is not halved any more
DRAWN_IN = 1e-4  # m, cutter smaller in rapid moves, which may start and end where it just touches
POSES = 120  # random poses that tell link pairs that touch by construction
TOUCHING, COARSE = 0.90, 0.40  # share of them in touch: any pair; links two apart (their meshes often overlap)


@dataclass(frozen=True)
class Body:
    name: str
    kind: str  # link, tool, cutter, workpiece, obstacle
    link: int  # 0 … 6; the tool side 7; −1 what does not belong to the robot
    carrier: int  # entry of Arm.placements that carries it, −1 the world
    place: Array  # (4, 4) in the carrier
    shape: Any  # coal geometry
    middle: Array  # (3,) m, centre of its own axis-aligned box
    half: Array  # (3,) m
    balls: Array  # (K, 3) m, centres of spheres that cover the box
    radius: float  # m


@dataclass(frozen=True)
class Contact:
    """One pair of bodies in contact somewhere along the motion."""

    pair: str
    sample: int  # first one, or the one before a contact in between
    count: int  # stretches in contact


def contacts(cell: Cell, arm: Arm, q: Array, external: Array, rapid: Bools) -> list[Contact]:
    """Every pair of bodies that touches along the motion.

    Args:
        q: (S, 6) rad.
        external: (S, E) rad or m.
        rapid: (S,) the move to the sample is a rapid one: the cutter must not touch the workpiece.
    """
    joints = np.hstack([q, external])
    parts = np.maximum(np.ceil(np.abs(np.diff(joints, axis=0)).max(axis=1) / STEP), 1).astype(int)
    place = np.concatenate([[0.0], *(n + (np.arange(p) + 1.0) / p for n, p in enumerate(parts))])
    rows = np.column_stack([np.interp(place, np.arange(len(q)), column) for column in joints.T])
    scene = _Scene(cell, arm, rows)
    fast = rapid[np.ceil(place - 1e-9).astype(int)]
    stops = _stops(rows, fast)
    out = []
    for a, b in _pairs(cell, arm, scene.bodies):
        asked = fast[stops[1:]] if (a.kind, b.kind) == ("workpiece", "cutter") else np.ones(len(stops) - 1, bool)
        hits = scene.follow(a, b, stops, asked)
        if hits:
            out.append(Contact(f"{a.name} ~ {b.name}", int(place[hits[0]]), len(hits)))
    return out


class _Scene:
    """Bodies and where they are in each row."""

    def __init__(self, cell: Cell, arm: Arm, rows: Array) -> None:
        self.arm, self.rows = arm, rows
        self.bodies = _bodies(cell, arm)
        self.world = arm.placements(rows[:, :6], rows[:, 6:])
        self.turn = np.abs(np.diff(rows, axis=0)).sum(axis=1)
        origins = self.world[:, :-1, :3, 3]
        size = max((_reach(b) for b in self.bodies if b.link >= 0), default=0.0)
        arm_length = float(np.linalg.norm(origins - origins[:, :1], axis=-1).max())
        self.lever = 2.0 * (arm_length + size)  # m, no point of the robot is farther from any axis
        self._relative: dict[tuple[int, int], Array] = {}

    def relative(self, a: Body, b: Body) -> Array:
        """(M, 4, 4) b's carrier seen from a's."""
        key = (a.carrier, b.carrier)
        if key not in self._relative:
            T = self.world[:, b.carrier]
            self._relative[key] = T if a.carrier < 0 else _inverse(self.world[:, a.carrier]) @ T
        return self._relative[key]

    def follow(self, a: Body, b: Body, stops: NDArray[np.int64], asked: Bools) -> list[int]:
        """Rows (one a stretch) in which a and b touch, or before the next of which they do."""
        T = self.relative(a, b)
        gap = _gap(a, b, T[stops])
        most = 2.0 * self.lever * np.diff(np.append(0.0, np.cumsum(self.turn))[stops])  # twice what the way can be
        if not (asked & (gap[1:] + gap[:-1] <= most)).any():
            return []
        way = np.append(0.0, np.cumsum(self._way(b, T)))
        doubt = asked & (gap[1:] + gap[:-1] <= way[stops[1:]] - way[stops[:-1]])
        chase = _Chase(self, a, b, T, way)
        hits = []
        for k in np.flatnonzero(doubt):
            row = chase.stretch(int(stops[k]), int(stops[k + 1]))
            if row >= 0:
                hits.append(row)
        return hits

    def _way(self, b: Body, T: Array) -> Array:
        """(M − 1,) m: |x(t) − x(start)| + |x(end) − x(t)| for all points x of b, at most.

        The chord, of the centre and by rotation, and what the path bends off it: a point's second derivative is at
        most (Σ|Δq|)² times the longest lever, the bend therefore an eighth of that, there and back a quarter.
        """
        centre = T[:, :3, :3] @ (b.place[:3, :3] @ b.middle + b.place[:3, 3]) + T[:, :3, 3]
        R = T[:, :3, :3]
        trace = np.einsum("nij,nij->n", R[1:], R[:-1])
        angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        chord = np.linalg.norm(np.diff(centre, axis=0), axis=1) + angle * np.linalg.norm(b.half)
        bend: Array = chord + self.turn**2 * self.lever / 4.0
        return bend


@dataclass
class _Chase:
    """Looks for the contact of one pair in a stretch."""

    scene: _Scene
    a: Body
    b: Body
    T: Array  # (M, 4, 4) b's carrier seen from a's
    way: Array  # (M,) m, cumulative motion

    def __post_init__(self) -> None:
        import coal

        self._coal = coal
        self._still = coal.Transform3s(self.a.place[:3, :3], self.a.place[:3, 3])
        self._seen: dict[int, bool] = {}

    def stretch(self, first: int, last: int) -> int:
        """Row of a contact, −1 if there is none."""
        for row in (first, last):
            if row not in self._seen:
                self._seen[row] = self._near(self.T[row], 0.0)
            if self._seen[row]:
                return row
        way = float(self.way[last] - self.way[first])
        if not self._near(self.T[first], way / 2) and not self._near(self.T[last], way / 2):
            return -1
        if last - first > 1:
            middle = (first + last) // 2
            row = self.stretch(first, middle)
            return row if row >= 0 else self.stretch(middle, last)
        ends = self.scene.rows[first], self.scene.rows[last]
        return first if self._between(*ends, self.T[first], self.T[last], way) else -1

    def _between(self, qa: Array, qb: Array, Ta: Array, Tb: Array, way: float) -> bool:
        if way < FLOOR or not (self._near(Ta, way / 2) or self._near(Tb, way / 2)):
            return False
        q = 0.5 * (qa + qb)
        world = self.scene.arm.placements(q[None, :6], q[None, 6:])[0]
        T = world[self.b.carrier]
        if self.a.carrier >= 0:
            T = _inverse(world[self.a.carrier]) @ T
        if self._near(T, 0.0):
            return True
        return self._between(qa, q, Ta, T, 0.5 * way) or self._between(q, qb, T, Tb, 0.5 * way)

    def _near(self, T: Array, margin: float) -> bool:
        """b, carried by T, is within ``margin`` of a."""
        request = self._coal.CollisionRequest()
        request.security_margin = margin
        T = T @ self.b.place
        place = self._coal.Transform3s(T[:3, :3], T[:3, 3])
        return bool(self._coal.collide(self.a.shape, self._still, self.b.shape, place, request,
                                       self._coal.CollisionResult()))  # fmt: skip


def _reach(b: Body) -> float:
    """m, farthest point from the carrier's origin."""
    return float(np.linalg.norm(b.place[:3, 3]) + np.linalg.norm(b.middle) + np.linalg.norm(b.half))


def _inverse(T: Array) -> Array:
    """Of rigid transforms (..., 4, 4)."""
    out = T.copy()
    out[..., :3, :3] = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, 3] = -(out[..., :3, :3] @ T[..., :3, 3:])[..., 0]
    return out


def _stops(rows: Array, fast: Bools) -> NDArray[np.int64]:
    """Rows STEP apart in the joint that moves farthest, and those where rapid moves begin and end."""
    gone = np.append(0.0, np.cumsum(np.abs(np.diff(rows, axis=0)).max(axis=1)))
    keep = np.append(True, np.diff(np.floor(gone / STEP)) > 0)
    keep[:-1] |= fast[1:] != fast[:-1]
    keep[[0, -1]] = True
    return np.flatnonzero(keep)


def _gap(a: Body, b: Body, T: Array) -> Array:
    """(K,) m, a bound below the distance: spheres around one against the box around the other."""
    if a.radius < b.radius:
        a, b, T = b, a, _inverse(T)
    balls = b.balls @ b.place[:3, :3].T + b.place[:3, 3]
    seen = np.einsum("nij,kj->nki", T[:, :3, :3], balls) + T[:, None, :3, 3]
    local = (seen - a.place[:3, 3]) @ a.place[:3, :3] - a.middle
    away = np.linalg.norm(np.maximum(np.abs(local) - a.half, 0.0), axis=2).min(axis=1)
    bound: Array = away - b.radius
    return bound


def _pairs(cell: Cell, arm: Arm, bodies: list[Body]) -> list[tuple[Body, Body]]:
    """What is checked: (still or lower, moving or higher)."""
    out, robot = [], []
    for a in bodies:
        for b in bodies:
            if a.kind in ("workpiece", "obstacle") and (b.link >= 2 or b.kind == "cutter"):
                out.append((a, b))
            elif a.kind in ("workpiece", "obstacle") and b.link == 1:
                robot.append((a, b))
            elif a.kind == "link" and ((b.kind in ("link", "tool") and b.link - a.link >= 2)
                                       or (b.kind == "cutter" and a.link <= 4)):  # fmt: skip
                (out if b.kind == "cutter" else robot).append((a, b))
    rng = np.random.default_rng(20)  # the planner's poses are others
    lower, upper = cell.limits.lower[:6], cell.limits.upper[:6]
    q = lower + (upper - lower) * rng.random((POSES, 6))
    world = arm.placements(q, np.tile(cell.external_home, (POSES, 1)))
    for a, b in robot:
        T = world[:, b.carrier] if a.carrier < 0 else _inverse(world[:, a.carrier]) @ world[:, b.carrier]
        share = np.mean([_touch(a, b, x @ b.place) for x in T])
        coarse = a.kind == "link" and b.link - a.link == 2 and share > COARSE
        if share <= TOUCHING and not coarse:
            out.append((a, b))
    return out


def _touch(a: Body, b: Body, T: Array) -> bool:
    import coal

    still, place = coal.Transform3s(a.place[:3, :3], a.place[:3, 3]), coal.Transform3s(T[:3, :3], T[:3, 3])
    return bool(coal.collide(a.shape, still, b.shape, place, coal.CollisionRequest(), coal.CollisionResult()))


def _bodies(cell: Cell, arm: Arm) -> list[Body]:
    import pinocchio as pin

    text = cell.urdf.read_text(encoding="utf-8")
    for name, folder in cell.packages.items():  # a package's folder may have another name than the package
        text = text.replace(f"package://{name}/", f"{folder}/")
    folders = [str(cell.urdf.parent), str(cell.folder)]
    geometry = pin.buildGeomFromUrdfString(arm.model, text, pin.GeometryType.COLLISION, package_dirs=folders)
    described = len(ElementTree.fromstring(text).findall("{*}link/{*}collision"))
    if len(geometry.geometryObjects) != described:
        raise InputError(f"describes {described} collision bodies, of which {len(geometry.geometryObjects)} can be "
                         "checked", file=cell.urdf)  # fmt: skip
    out = []
    for g in geometry.geometryObjects:
        joint = int(g.parentJoint)
        out.append(_body(g.name, "link", arm.link_of(joint), joint, g.placement.homogeneous, g.geometry))
    flange, part = arm.model.njoints, arm.model.njoints + 1
    out += [_body(s.name, "tool", 7, flange, s.T_parent_shape, _shape(s)) for s in cell.tool.geometry]
    out += [_body(s.name, "workpiece", -1, part, s.T_parent_shape, _shape(s)) for s in cell.workpiece.geometry]
    out += [_body(s.name, "obstacle", -1, -1, s.T_parent_shape, _shape(s)) for s in cell.obstacles]
    if cell.tool.cutter is not None:
        out.append(_cutter(cell.tool.cutter, cell.tool.T_flange_tcp, flange))
    return out


def _cutter(cutter: Cutter, T_flange_tcp: Array, flange: int) -> Body:
    """From the TCP back along −z, drawn in: what it may touch while cutting it may graze when a rapid starts."""
    import coal

    radius = max(cutter.diameter / 2 - DRAWN_IN, cutter.diameter / 4)
    length = max(cutter.length - DRAWN_IN, cutter.length / 2)
    back = np.eye(4)
    back[2, 3] = length / 2 - cutter.length
    return _body("cutter", "cutter", 7, flange, T_flange_tcp @ back, coal.Cylinder(radius, length))


def _shape(shape: Shape) -> Any:
    import coal

    if shape.kind == "box":
        return coal.Box(*shape.size)
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    if shape.kind == "sphere":
        return coal.Sphere(*shape.size)
    return coal.MeshLoader().load(str(shape.mesh), np.full(3, shape.size[0]))


def _body(name: str, kind: str, link: int, carrier: int, place: Array, shape: Any) -> Body:
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    middle, half = (low + high) / 2, (high - low) / 2
    long = int(np.argmax(half))
    across = float(np.linalg.norm(np.delete(half, long)))
    count = int(np.clip(np.ceil(half[long] / max(across, 1e-6)), 1, 8))
    balls = np.tile(middle, (count, 1))
    balls[:, long] += half[long] * ((2 * np.arange(count) + 1) / count - 1)
    return Body(name, kind, link, carrier, np.asarray(place), shape, middle, half, balls,
                float(np.hypot(half[long] / count, across)))  # fmt: skip
