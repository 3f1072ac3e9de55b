"""What holds the workpiece or the robot, and whether what moves would stand in something that stays.

Two bodies hold each other where less than GAP lies between them. What hangs together with the part moves with it,
unless something rests on it that stays: its fixture and the fixture's legs move, the floor that robot and fixture stand
on does not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.model.bodies import Body, cell_bodies, inside, robot_bodies
from machopt.model.lines import Carriers
from machopt.model.machine import load_machine
from machopt.model.robot import load_chain
from machopt.placement.asked import Shift

if TYPE_CHECKING:
    from trimesh.collision import CollisionManager

GAP = 0.010  # m; a fixture drawn with so much room below the part still holds it
LEVEL = 1e-6  # m; of two bodies that touch the one whose lowest point is higher rests on the other
SINK = 1e-3  # m; what rests on something that stays may go down so far
PART, BASE = "workpiece", "base_link"


@dataclass(frozen=True, eq=False)
class Standing:
    """The bodies that stand still, in world: the part's as one, those of base_link as one, and the obstacles.

    External joints are at home, and each link of a rail or a positioner that has a body is one more.
    """

    bodies: Mapping[str, tuple[Body, ...]]
    T_world_base: Array  # the bodies' vertices are in base_link where the cell has it, all joints at zero
    links: frozenset[str] = frozenset()  # of them, those of rails and positioners: they never move along

    @classmethod
    def of(cls, cell: Cell) -> Standing:
        robot, shapes = load_chain(cell)
        carriers = Carriers(cell, load_machine(cell, robot))
        machine, found, links = carriers.machine, dict[str, list[Body]](), set()
        for body in cell_bodies(cell, carriers):
            if body.kind in ("workpiece", "obstacle"):
                found.setdefault(PART if body.kind == "workpiece" else body.name, []).append(body)
        base = tuple(s for s in shapes if s.link == 0)
        for shape, body in zip(base, robot_bodies(carriers, base), strict=True):
            own = not machine.external or shape.part == cell.base_link
            name = BASE if own else shape.part
            links |= set() if own else {name}
            found.setdefault(name, []).append(body)
        if machine.external:
            R, p = machine.links(np.append(np.zeros(6), cell.external_home)[None])
            hall = machine.hall
            back = R[0, hall].T
            found = {
                name: [_turned(b, back @ R[0, b.link], back @ (p[0, b.link] - p[0, hall])) for b in bodies]
                for name, bodies in found.items()
            }
        return cls({name: tuple(b) for name, b in found.items()}, cell.T_world_base, frozenset(links))

    def holding(self, *, base: bool) -> frozenset[str]:
        """Obstacles that move along with the part (or with base_link).

        They hang together with it, and nothing that stays rests on any of them.
        """
        start, other = (BASE, PART) if base else (PART, BASE)
        graph = self._graph()
        lowest = {name: min(self._height(b) for b in bodies) for name, bodies in self.bodies.items()}
        kept = set(graph) - self.links - {other} - graph.get(other, set()) | {start}
        while True:
            kept = _joined(graph, start, kept)
            stays = {m for m in kept - {start} for n in graph[m] - kept if lowest[n] > lowest[m] + LEVEL}
            if not stays:
                return frozenset(kept - {start})
            kept -= stays

    def refusal(self, moving: frozenset[str], *, base: bool) -> Refusal:
        """What answers for each shift why the cell cannot stand so."""
        movers = moving | {BASE if base else PART}
        return Refusal.of(self, frozenset(n for n in self.bodies if n in movers))

    def _height(self, body: Body) -> float:
        """m above the world's origin, of the lowest point."""
        T = self.T_world_base
        return float((body.vertices @ T[2, :3]).min() + T[2, 3])

    def _graph(self) -> dict[str, set[str]]:
        managers = {name: _manager({name: bodies}, self.T_world_base) for name, bodies in self.bodies.items()}
        graph: dict[str, set[str]] = {name: set() for name in managers}
        names = list(managers)
        for k, a in enumerate(names):
            for b in names[k + 1 :]:
                if managers[a].min_distance_other(managers[b]) <= GAP:
                    graph[a].add(b)
                    graph[b].add(a)
        return graph


@dataclass(frozen=True, eq=False, kw_only=True)
class Refusal:
    """Holds what moves against what stays, place by place."""

    standing: Standing
    movers: frozenset[str]
    stayers: Any  # CollisionManager
    moving: Any
    touching: frozenset[frozenset[str]]  # pairs that touch where the cell has them
    resting: tuple[str, ...]  # what stays and carries something that moves
    held_by: tuple[str, ...]  # what stays within GAP of something that moves

    @classmethod
    def of(cls, standing: Standing, movers: frozenset[str]) -> Refusal:
        moving = _manager({n: b for n, b in standing.bodies.items() if n in movers}, standing.T_world_base)
        stayers = _manager({n: b for n, b in standing.bodies.items() if n not in movers}, standing.T_world_base)
        hit, pairs = moving.in_collision_other(stayers, return_names=True) if movers else (False, set())
        touching = frozenset(frozenset((_plain(a), _plain(b))) for a, b in pairs) if hit else frozenset()
        resting, held_by = set(), set()
        for name, bodies in standing.bodies.items():
            if name not in movers and movers:
                one = _manager({name: bodies}, standing.T_world_base)
                distance = moving.min_distance_other(one)
                resting |= {name} if distance <= SINK else set()
                held_by |= {name} if distance <= GAP else set()
        return cls(
            standing=standing,
            movers=movers,
            stayers=stayers,
            moving=moving,
            touching=touching,
            resting=tuple(sorted(resting)),
            held_by=tuple(sorted(held_by)),
        )

    def lost_support(self, S: Array) -> tuple[str, ...]:
        """What stays and holds what moves today, and would be farther than GAP from it at a place.

        Args:
            S: (4, 4) the shift in world.
        """
        self._move(S)
        return tuple(name for name in self.held_by if self.moving.min_distance_other(self._alone(name)) > GAP)

    def _alone(self, name: str) -> CollisionManager:
        return _manager({name: self.standing.bodies[name]}, self.standing.T_world_base)

    def _move(self, S: Array) -> None:
        for name in sorted(self.movers):
            for k, _ in enumerate(self.standing.bodies[name]):
                self.moving.set_transform(f"{name}#{k}", S)

    def why(self, shift: Shift, S: Array) -> str:
        """One sentence, empty where the cell can stand so. S (4, 4): the shift in world."""
        if self.resting and shift.z < -SINK:
            return f"it rests on {', '.join(self.resting)} and would sink into it"
        self._move(S)
        hit, pairs = self.moving.in_collision_other(self.stayers, return_names=True)
        if hit:
            new = {frozenset((_plain(a), _plain(b))) for a, b in pairs} - self.touching
            if new:
                pair = min(new, key=sorted)
                a, b = sorted(pair, key=lambda n: n not in self.movers)
                return f"{a} would stand in {b}"
        return self._swallowed(S)

    def _swallowed(self, S: Array) -> str:
        """A body wholly inside another touches no surface."""
        T = self.standing.T_world_base
        back = np.linalg.inv(T) @ S @ T
        for name in sorted(self.movers):
            for a in self.standing.bodies[name]:
                there = back[:3, :3] @ a.vertices[0] + back[:3, 3]
                for other in sorted(set(self.standing.bodies) - self.movers):
                    if frozenset((name, other)) in self.touching:
                        continue
                    for b in self.standing.bodies[other]:
                        here = back[:3, :3].T @ (b.vertices[0] - back[:3, 3])
                        if inside(b, there) or inside(a, here):
                            return f"{name} would stand in {other}"
        return ""


def _turned(body: Body, R: Array, p: Array) -> Body:
    """The body elsewhere; the spheres around it are not asked for here."""
    vertices, centre = body.vertices @ R.T + p, R @ body.box_centre + p
    return replace(body, vertices=vertices, box_rotation=R @ body.box_rotation, box_centre=centre)


def _manager(bodies: Mapping[str, Iterable[Body]], T_world_base: Array) -> CollisionManager:
    import trimesh
    from trimesh.collision import CollisionManager

    out = CollisionManager()
    for name, parts in bodies.items():
        for k, body in enumerate(parts):
            at = body.vertices @ T_world_base[:3, :3].T + T_world_base[:3, 3]
            out.add_object(f"{name}#{k}", trimesh.Trimesh(at, body.faces, process=False))
    return out


def _plain(name: str) -> str:
    return name.rsplit("#", 1)[0]


def _joined(graph: Mapping[str, set[str]], start: str, among: set[str]) -> set[str]:
    """What hangs together with a body, by way of ``among`` only."""
    found, front = {start}, {start}
    while front:
        front = {n for name in front for n in graph.get(name, set())} & among - found
        found |= front
    return found
