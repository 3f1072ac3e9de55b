"""Collisions of a path at and between its planning points, along straight tool moves in space, not in joint space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.plan_options import PlanOptions
from machopt.kinematics.inverse.solver import refine_by_newton
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation, normalise_vectors
from machopt.planning.cache import compute_cached
from machopt.planning.sampling.joint_path import CONVERGED, SAME_BRANCH
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath

NEAR = np.radians(3.0)  # joint step up to which the move between two points is interpolated in joint space

BATCH_POINTS = 500  # planning points of short runs that are checked in one call


@dataclass(frozen=True)
class PathCollisions:
    """Contacts of one assignment at and between the planning points of each run."""

    hit: Bools  # (P,) at the point or on the way to it
    pair: NDArray[np.int32]  # (P,) index into the model's pairs, −1 where free
    lost: Bools  # (P,) no configuration leads from the point before to this one

    @property
    def free(self) -> bool:
        """Whether the assignment has neither a contact nor a lost configuration."""
        return not bool(self.hit.any() or self.lost.any())


@dataclass(frozen=True)
class PathCollisionChecker:
    """Path, arm and collision model for the collision check of one motion."""

    path: PlanningPath
    arm: PlanningArm
    robot: Robot
    model: CollisionModel | None  # None: no contact check
    step: float  # rad, joint step between collision checks

    @classmethod
    def build(
        cls, path: PlanningPath, arm: PlanningArm, robot: Robot, model: CollisionModel | None, options: PlanOptions
    ) -> PathCollisionChecker:
        """Return the checker of a path with the collision step of the options.

        Args:
            path: planning points.
            arm: arm model relative to its base.
            robot: kinematic model of the robot.
            model: collision bodies and pairs; None disables the contact check.
            options: plan options with ``collision_step``.
        """
        return cls(path, arm, robot, model, options.collision_step)

    def whole(self, phi: Array, q: Array, cuts: tuple[int, ...] = ()) -> PathCollisions:
        """Return the contacts of every stretch with a configuration.

        Args:
            phi: (P,) rad.
            q: (P, 6) rad, NaN where there is none.
            cuts: planning points that are not reached by a straight move from the previous point.
        """
        n = len(q)
        hit, pair, lost = np.zeros(n, bool), np.full(n, -1, np.int32), np.zeros(n, bool)
        known = np.asarray(np.isfinite(q).all(axis=1))
        begins = np.zeros(n, bool)
        begins[list(cuts)] = True
        stretches: list[NDArray[np.intp]] = []
        for first, last in self.path.runs:
            rows = np.arange(first, last + 1)[known[first : last + 1]]
            parts = np.split(rows, np.flatnonzero((np.diff(rows) != 1) | begins[rows[1:]]) + 1)
            stretches += [part for part in parts if len(part)]
        for batch in _group_stretches(stretches):
            part = np.concatenate(batch)
            hit[part], pair[part], lost[part] = self._check_with_cache(batch, phi[part], q[part])
        return PathCollisions(hit, pair, lost)

    def _check_with_cache(
        self, batch: list[NDArray[np.intp]], phi: Array, q: Array
    ) -> tuple[Bools, NDArray[np.int32], Bools]:
        """Return the result of :meth:`stretches`, from the cache where an earlier plan had the same ones."""
        rows = np.concatenate(batch)

        def inputs() -> tuple[object, ...]:
            p = self.path
            where = (p.position[rows], p.axis[rows], p.reference[rows], p.external[rows], p.may_touch[rows])
            return self.model, self.robot, self.arm, self.step, where, [len(part) for part in batch], phi, q

        return compute_cached("contacts", inputs, lambda: self.stretches(batch, phi, q))

    def stretch(self, rows: NDArray[np.intp], phi: Array, q: Array) -> tuple[Bools, NDArray[np.int32], Bools]:
        """Return hit, pair and lost, each (n,), of successive planning points.

        Args:
            rows: (n,) planning points.
            phi: (n,) rad, rotation at each.
            q: (n, 6) rad, joints at each.
        """
        return self.stretches([rows], phi, q)

    def stretches(self, batch: list[NDArray[np.intp]], phi: Array, q: Array) -> tuple[Bools, NDArray[np.int32], Bools]:
        """Return hit, pair and lost, each (n,), of several stretches; nothing is checked between two of them.

        Args:
            batch: planning points of each stretch, n in all.
            phi: (n,) rad, rotation at each.
            q: (n, 6) rad, joints at each.
        """
        rows = np.concatenate(batch)
        n, lengths = len(rows), [len(part) for part in batch]
        starts = np.zeros(n, bool)
        starts[np.cumsum([0, *lengths[:-1]])] = True
        dense, owner, lost = self._refine_long_steps(rows, phi, q, starts)
        hit, pair = np.zeros(n, bool), np.full(n, -1, np.int32)
        if self.model is not None:
            touch = np.repeat(self.path.may_touch[[part[0] for part in batch]], lengths)[owner]
            is_first = starts[owner] & (np.diff(owner, prepend=-1) != 0)
            found = self.model.check_motion(dense, touch, self.step, starts=is_first)
            for m in np.flatnonzero(found.hit)[::-1]:  # the first contact of each move is reported
                hit[owner[m]], pair[owner[m]] = True, found.pair[m]
        return hit, pair, lost

    def _refine_long_steps(
        self, rows: NDArray[np.intp], phi: Array, q: Array, starts: Bools
    ) -> tuple[Array, NDArray[np.intp], Bools]:
        """Return configurations (M, 6 + E), refined where a step is long; also the point (M,) each leads to and lost
        (n,).
        """
        n = len(rows)
        lost = np.zeros(n, bool)
        pieces = np.ones(n, int)
        pieces[1:] = np.maximum(np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) / NEAR), 1).astype(int)
        pieces[starts] = 1
        if (pieces == 1).all():
            return self.path.whole(q, rows), np.arange(n), lost
        owner = np.repeat(np.arange(n), pieces)
        share = np.concatenate([np.arange(1, k + 1) / k for k in pieces])
        inner = np.flatnonzero(share < 1.0)
        b, f = owner[inner], share[inner]
        a = b - 1
        g = f[:, None]
        between, bad = self._interpolate_configurations(
            rows[a], rows[b], f, (1 - f) * phi[a] + f * phi[b], (1 - g) * q[a] + g * q[b]
        )
        out = self.path.whole(q, rows)[owner]
        out[inner] = between
        lost[b[bad]] = True
        return out, owner, lost

    def _interpolate_configurations(
        self, a: NDArray[np.intp], b: NDArray[np.intp], f: Array, phi: Array, seed: Array
    ) -> tuple[Array, Bools]:
        """Return configurations (n, 6 + E) at a share f (n,) of the move from planning points a to b (n,), and where
        none exists.
        """
        path = self.path

        def between(values: Array) -> Array:
            g = f.reshape(-1, *(1,) * (values.ndim - 1))
            return np.asarray((1 - g) * values[a] + g * values[b])

        R = compute_tool_rotation(normalise_vectors(between(path.axis)), between(path.reference), phi)
        external = between(path.external)
        pose = self.arm.in_base(external, build_transform(R, between(path.position)))
        exact, error = refine_by_newton(self.robot, pose, seed, self.arm.T_flange_tcp, iterations=6)
        bad = ~((error <= CONVERGED) & (np.abs(exact - seed).max(axis=1) <= SAME_BRANCH))
        return np.hstack([np.where(bad[:, None], seed, exact), external]), bad

    def on_the_way(
        self, row: int, phi: tuple[Array, Array], q: tuple[Array, Array], wanted: Array
    ) -> tuple[Array, Array, Bools]:
        """Return configurations that :meth:`stretch` would check on moves (n,) to planning point ``row`` from the
        previous one.

        Args:
            row: planning point at the end of the moves.
            phi: (n,) rad, at either end.
            q: (n, 6) rad, at either end.
            wanted: (n,) share of each move.

        Returns:
            The share nearest to that (n,), the configuration there (n, 6 + E), and whether it lies between the ends.
        """
        pieces = np.maximum(np.ceil(np.abs(q[1] - q[0]).max(axis=1, initial=0.0) / NEAR), 1)
        f = np.clip(np.round(wanted * pieces), 1, np.maximum(pieces - 1, 1)) / pieces
        g, b = f[:, None], np.full(len(f), row, np.intp)
        at, bad = self._interpolate_configurations(
            b - 1, b, f, (1 - f) * phi[0] + f * phi[1], (1 - g) * q[0] + g * q[1]
        )
        return f, at, ~bad & (pieces > 1)


def _group_stretches(stretches: list[NDArray[np.intp]]) -> list[list[NDArray[np.intp]]]:
    """Return the stretches in groups of at least BATCH_POINTS planning points, the last one aside."""
    groups: list[list[NDArray[np.intp]]] = []
    size = BATCH_POINTS
    for stretch in stretches:
        if size >= BATCH_POINTS:
            groups.append([])
            size = 0
        groups[-1].append(stretch)
        size += len(stretch)
    return groups
