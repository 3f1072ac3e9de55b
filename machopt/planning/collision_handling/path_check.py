"""Collisions of a path at and between its planning points, as it is driven: straight in space, not in the joints."""

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
from machopt.planning.sampling.configurations import PlanningArm
from machopt.planning.sampling.joint_path import CONVERGED, SAME_BRANCH
from machopt.planning.stations.planning_path import PlanningPath

NEAR = np.radians(3.0)  # joint step up to which the way between two points is taken as straight in the joints


@dataclass(frozen=True)
class PathCollisions:
    """Contacts of one assignment at and between the planning points of each run."""

    hit: Bools  # (P,) at the point or on the way to it
    pair: NDArray[np.int32]  # (P,) index into the model's pairs, −1 where free
    lost: Bools  # (P,) no configuration leads from the point before to this one

    @property
    def free(self) -> bool:
        return not bool(self.hit.any() or self.lost.any())


@dataclass(frozen=True)
class PathCollisionChecker:
    """What a motion is held against."""

    path: PlanningPath
    arm: PlanningArm
    robot: Robot
    model: CollisionModel | None  # None: contacts are not looked for
    step: float  # rad, joint step between collision checks

    @classmethod
    def of(
        cls, path: PlanningPath, arm: PlanningArm, robot: Robot, model: CollisionModel | None, options: PlanOptions
    ) -> PathCollisionChecker:
        return cls(path, arm, robot, model, options.collision_step)

    def whole(self, phi: Array, q: Array, cuts: tuple[int, ...] = ()) -> PathCollisions:
        """Every stretch with a configuration.

        Args:
            phi: (P,) rad.
            q: (P, 6) rad, NaN where there is none.
            cuts: planning points that are not driven to from the point before.
        """
        n = len(q)
        hit, pair, lost = np.zeros(n, bool), np.full(n, -1, np.int32), np.zeros(n, bool)
        known = np.asarray(np.isfinite(q).all(axis=1))
        begins = np.zeros(n, bool)
        begins[list(cuts)] = True
        for first, last in self.path.runs:
            rows = np.arange(first, last + 1)[known[first : last + 1]]
            for part in np.split(rows, np.flatnonzero((np.diff(rows) != 1) | begins[rows[1:]]) + 1):
                if len(part):
                    hit[part], pair[part], lost[part] = self._known(part, phi[part], q[part])
        return PathCollisions(hit, pair, lost)

    def _known(self, rows: NDArray[np.intp], phi: Array, q: Array) -> tuple[Bools, NDArray[np.int32], Bools]:
        """The same as :meth:`stretch`, of an earlier plan where there is one that came this very way."""

        def inputs() -> tuple[object, ...]:
            p = self.path
            where = (p.position[rows], p.axis[rows], p.reference[rows], p.external[rows], bool(p.may_touch[rows[0]]))
            return self.model, self.robot, self.arm, self.step, where, phi, q

        return compute_cached("contacts", inputs, lambda: self.stretch(rows, phi, q))

    def stretch(self, rows: NDArray[np.intp], phi: Array, q: Array) -> tuple[Bools, NDArray[np.int32], Bools]:
        """(n,) hit, pair and lost of successive planning points ``rows`` (n,) at phi (n,) rad and q (n, 6) rad."""
        n = len(rows)
        dense, owner, lost = self._filled(rows, phi, q)
        hit, pair = np.zeros(n, bool), np.full(n, -1, np.int32)
        if self.model is not None:
            touch = np.full(len(dense), bool(self.path.may_touch[rows[0]]))
            found = self.model.check_motion(dense, touch, self.step)
            for m in np.flatnonzero(found.hit)[::-1]:  # the first contact of each way is told
                hit[owner[m]], pair[owner[m]] = True, found.pair[m]
        return hit, pair, lost

    def _filled(self, rows: NDArray[np.intp], phi: Array, q: Array) -> tuple[Array, NDArray[np.intp], Bools]:
        """Configurations (M, 6 + E), more of them where a step is long, whose way (M,) each belongs to, lost (n,)."""
        n = len(rows)
        lost = np.zeros(n, bool)
        pieces = np.ones(n, int)
        pieces[1:] = np.maximum(np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) / NEAR), 1).astype(int)
        if (pieces == 1).all():
            return self.path.whole(q, rows), np.arange(n), lost
        owner = np.repeat(np.arange(n), pieces)
        share = np.concatenate([np.arange(1, k + 1) / k for k in pieces])
        inner = np.flatnonzero(share < 1.0)
        b, f = owner[inner], share[inner]
        a = b - 1
        g = f[:, None]
        between, bad = self._between(rows[a], rows[b], f, (1 - f) * phi[a] + f * phi[b], (1 - g) * q[a] + g * q[b])
        out = self.path.whole(q, rows)[owner]
        out[inner] = between
        lost[b[bad]] = True
        return out, owner, lost

    def _between(
        self, a: NDArray[np.intp], b: NDArray[np.intp], f: Array, phi: Array, seed: Array
    ) -> tuple[Array, Bools]:
        """Configurations (n, 6 + E) a share f (n,) of the way from planning points a to b (n,); where there is none."""
        path = self.path

        def between(values: Array) -> Array:
            g = f.reshape(-1, *(1,) * (values.ndim - 1))
            return np.asarray((1 - g) * values[a] + g * values[b])

        R = compute_tool_rotation(normalise_vectors(between(path.axis)), between(path.reference), phi)
        stands = between(path.external)
        pose = self.arm.in_base(stands, build_transform(R, between(path.position)))
        exact, error = refine_by_newton(self.robot, pose, seed, self.arm.T_flange_tcp, iterations=6)
        bad = ~((error <= CONVERGED) & (np.abs(exact - seed).max(axis=1) <= SAME_BRANCH))
        return np.hstack([np.where(bad[:, None], seed, exact), stands]), bad

    def on_the_way(
        self, row: int, phi: tuple[Array, Array], q: tuple[Array, Array], wanted: Array
    ) -> tuple[Array, Array, Bools]:
        """Of ways (n,) to planning point ``row`` from the one before, configurations that :meth:`stretch` looks at.

        Args:
            phi: (n,) rad, at either end.
            q: (n, 6) rad, at either end.
            wanted: (n,) share of each way.

        Returns:
            the share nearest to that (n,), the configuration there (n, 6 + E), and whether it is one between the ends.
        """
        pieces = np.maximum(np.ceil(np.abs(q[1] - q[0]).max(axis=1, initial=0.0) / NEAR), 1)
        f = np.clip(np.round(wanted * pieces), 1, np.maximum(pieces - 1, 1)) / pieces
        g, b = f[:, None], np.full(len(f), row, np.intp)
        at, bad = self._between(b - 1, b, f, (1 - f) * phi[0] + f * phi[1], (1 - g) * q[0] + g * q[1])
        return f, at, ~bad & (pieces > 1)
