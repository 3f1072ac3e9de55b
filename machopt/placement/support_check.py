"""Support and collision check of shifted bodies: what supports the workpiece or the robot, and whether moved bodies
collide with fixed ones.

Two bodies support each other where less than CONTACT_GAP_M lies between them. Bodies connected with the part move with
it, unless a fixed body rests on them: its fixture and the fixture's legs move, the floor below robot and fixture does
not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from machopt.collision.bodies import CollisionBody, build_cell_bodies, build_robot_bodies, is_point_inside
from machopt.data_types.cell import Cell
from machopt.kinematics.machine import load_machine
from machopt.kinematics.machine_lines import LinkCarriers
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics.array_types import Array
from machopt.placement.search_options import PlacementShift

if TYPE_CHECKING:
    from trimesh.collision import CollisionManager

CONTACT_GAP_M = 0.010  # m; a fixture with this gap below the part still supports it
HEIGHT_TOLERANCE_M = 1e-6  # m; of two touching bodies the one with the higher lowest point rests on the other
MAX_SINK_M = 1e-3  # m; maximum downward shift of a body that rests on a fixed one
PART, BASE = "workpiece", "base_link"


@dataclass(frozen=True, eq=False)
class SupportModel:
    """Fixed bodies in world: the part's as one, those of base_link as one, and the obstacles.

    External joints are at home, and each link of a rail or a positioner with a body is one more.
    """

    bodies: Mapping[str, tuple[CollisionBody, ...]]
    T_world_base: Array  # the bodies' vertices are in the cell's base_link, all joints at zero
    links: frozenset[str] = frozenset()  # bodies of rails and positioners, which never move along

    @classmethod
    def build(cls, cell: Cell) -> SupportModel:
        """Read the bodies of a cell.

        Args:
            cell: robot cell.
        """
        robot, shapes = load_chain(cell)
        carriers = LinkCarriers(cell, load_machine(cell, robot))
        machine, found, links = carriers.machine, dict[str, list[CollisionBody]](), set()
        for body in build_cell_bodies(cell, carriers):
            if body.kind in ("workpiece", "obstacle"):
                found.setdefault(PART if body.kind == "workpiece" else body.name, []).append(body)
        base = tuple(s for s in shapes if s.link == 0)
        for shape, body in zip(base, build_robot_bodies(carriers, base), strict=True):
            own = not machine.external_count or shape.part == cell.base_link
            name = BASE if own else shape.part
            links |= set() if own else {name}
            found.setdefault(name, []).append(body)
        if machine.external_count:
            R, p = machine.compute_links(np.append(np.zeros(6), cell.external_home)[None])
            hall = machine.world_link
            back = R[0, hall].T
            found = {
                name: [_move_body(b, back @ R[0, b.link], back @ (p[0, b.link] - p[0, hall])) for b in bodies]
                for name, bodies in found.items()
            }
        return cls({name: tuple(b) for name, b in found.items()}, cell.T_world_base, frozenset(links))

    def find_moved_obstacles(self, *, base: bool) -> frozenset[str]:
        """Return the obstacles that move along with the part (or with base_link).

        They are connected with it, and no fixed body rests on any of them.

        Args:
            base: whether the robot is moved.
        """
        start, other = (BASE, PART) if base else (PART, BASE)
        graph = self._build_contact_graph()
        lowest = {name: min(self._get_lowest_point(b) for b in bodies) for name, bodies in self.bodies.items()}
        movable = set(graph) - self.links - {other} - graph.get(other, set()) | {start}
        while True:
            movable = _find_connected_bodies(graph, start, movable)
            stays = {
                m for m in movable - {start} for n in graph[m] - movable if lowest[n] > lowest[m] + HEIGHT_TOLERANCE_M
            }
            if not stays:
                return frozenset(movable - {start})
            movable -= stays

    def build_shift_check(self, moving: frozenset[str], *, base: bool) -> ShiftCheck:
        """Return the check of shifts.

        Args:
            moving: obstacles that move along.
            base: whether the robot is moved.
        """
        movers = moving | {BASE if base else PART}
        return ShiftCheck.build(self, frozenset(n for n in self.bodies if n in movers))

    def _get_lowest_point(self, body: CollisionBody) -> float:
        """Return the height in m of the lowest point above the world's origin."""
        T = self.T_world_base
        return float((body.vertices @ T[2, :3]).min() + T[2, 3])

    def _build_contact_graph(self) -> dict[str, set[str]]:
        managers = {
            name: _build_collision_manager({name: bodies}, self.T_world_base) for name, bodies in self.bodies.items()
        }
        graph: dict[str, set[str]] = {name: set() for name in managers}
        names = list(managers)
        for k, a in enumerate(names):
            for b in names[k + 1 :]:
                if managers[a].min_distance_other(managers[b]) <= CONTACT_GAP_M:
                    graph[a].add(b)
                    graph[b].add(a)
        return graph


@dataclass(frozen=True, eq=False, kw_only=True)
class ShiftCheck:
    """Check of moved bodies against fixed ones, place by place."""

    supports: SupportModel
    moved_bodies: frozenset[str]
    fixed_bodies: Any  # CollisionManager
    moving: Any
    touching: frozenset[frozenset[str]]  # pairs that touch at the present place
    resting: tuple[str, ...]  # fixed bodies that carry a moved one
    existing_supports: tuple[str, ...]  # fixed bodies within CONTACT_GAP_M of a moved one

    @classmethod
    def build(cls, standing: SupportModel, movers: frozenset[str]) -> ShiftCheck:
        """Prepare the check.

        Args:
            standing: bodies of the cell.
            movers: names of the moved bodies.
        """
        moving = _build_collision_manager(
            {n: b for n, b in standing.bodies.items() if n in movers}, standing.T_world_base
        )
        stayers = _build_collision_manager(
            {n: b for n, b in standing.bodies.items() if n not in movers}, standing.T_world_base
        )
        hit, pairs = moving.in_collision_other(stayers, return_names=True) if movers else (False, set())
        touching = frozenset(frozenset((_format_name(a), _format_name(b))) for a, b in pairs) if hit else frozenset()
        resting, held_by = set(), set()
        for name, bodies in standing.bodies.items():
            if name not in movers and movers:
                one = _build_collision_manager({name: bodies}, standing.T_world_base)
                distance = moving.min_distance_other(one)
                resting |= {name} if distance <= MAX_SINK_M else set()
                held_by |= {name} if distance <= CONTACT_GAP_M else set()
        return cls(
            supports=standing,
            moved_bodies=movers,
            fixed_bodies=stayers,
            moving=moving,
            touching=touching,
            resting=tuple(sorted(resting)),
            existing_supports=tuple(sorted(held_by)),
        )

    def find_lost_supports(self, S: Array) -> tuple[str, ...]:
        """Return the fixed bodies that support a moved body now, and would be farther than CONTACT_GAP_M from it.

        Args:
            S: (4, 4) the shift in world.
        """
        self._move_bodies(S)
        return tuple(
            name
            for name in self.existing_supports
            if self.moving.min_distance_other(self._build_single_body(name)) > CONTACT_GAP_M
        )

    def _build_single_body(self, name: str) -> CollisionManager:
        return _build_collision_manager({name: self.supports.bodies[name]}, self.supports.T_world_base)

    def _move_bodies(self, S: Array) -> None:
        for name in sorted(self.moved_bodies):
            for k, _ in enumerate(self.supports.bodies[name]):
                self.moving.set_transform(f"{name}#{k}", S)

    def find_refusal_reason(self, shift: PlacementShift, S: Array) -> str:
        """Return one sentence why the cell is impossible at a place, empty where it is possible.

        Args:
            shift: shift of the place.
            S: (4, 4) the shift in world.
        """
        if self.resting and shift.z < -MAX_SINK_M:
            return f"it rests on {', '.join(self.resting)} and would sink into it"
        self._move_bodies(S)
        hit, pairs = self.moving.in_collision_other(self.fixed_bodies, return_names=True)
        if hit:
            new = {frozenset((_format_name(a), _format_name(b))) for a, b in pairs} - self.touching
            if new:
                pair = min(new, key=sorted)
                a, b = sorted(pair, key=lambda n: n not in self.moved_bodies)
                return f"{a} would intersect {b}"
        return self._find_contained_body(S)

    def _find_contained_body(self, S: Array) -> str:
        """Return a body wholly inside another one, which touches no surface."""
        T = self.supports.T_world_base
        back = np.linalg.inv(T) @ S @ T
        for name in sorted(self.moved_bodies):
            for a in self.supports.bodies[name]:
                there = back[:3, :3] @ a.vertices[0] + back[:3, 3]
                for other in sorted(set(self.supports.bodies) - self.moved_bodies):
                    if frozenset((name, other)) in self.touching:
                        continue
                    for b in self.supports.bodies[other]:
                        here = back[:3, :3].T @ (b.vertices[0] - back[:3, 3])
                        if is_point_inside(b, there) or is_point_inside(a, here):
                            return f"{name} would intersect {other}"
        return ""


def _move_body(body: CollisionBody, R: Array, p: Array) -> CollisionBody:
    """Return the moved body; the spheres around it are not updated, because they are not used here."""
    vertices, centre = body.vertices @ R.T + p, R @ body.box_centre + p
    return replace(body, vertices=vertices, box_rotation=R @ body.box_rotation, box_centre=centre)


def _build_collision_manager(bodies: Mapping[str, Iterable[CollisionBody]], T_world_base: Array) -> CollisionManager:
    import trimesh
    from trimesh.collision import CollisionManager

    out = CollisionManager()
    for name, parts in bodies.items():
        for k, body in enumerate(parts):
            at = body.vertices @ T_world_base[:3, :3].T + T_world_base[:3, 3]
            out.add_object(f"{name}#{k}", trimesh.Trimesh(at, body.faces, process=False))
    return out


def _format_name(name: str) -> str:
    return name.rsplit("#", 1)[0]


def _find_connected_bodies(graph: Mapping[str, set[str]], start: str, among: set[str]) -> set[str]:
    """Return the bodies connected with a body, through bodies of ``among`` only."""
    found, front = {start}, {start}
    while front:
        front = {n for name in front for n in graph.get(name, set())} & among - found
        found |= front
    return found
