"""The general solver behind the planner's interface: branches with their distances from the singularities."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.model.ik_general import GeneralSolver
from machopt.model.ik_spherical import Branches
from machopt.model.robot import Robot
from machopt.se3 import normalise, skew

LENGTH = 0.5  # m, makes the linear rows of the Jacobian comparable with the angular ones


class GeneralBranches:
    """Any 6R arm. Where the wrist is not spherical there is no wrist centre, so margins are measured as follows.

    Three parallel axes (2, 3, 4): wrist = angle between axes 4 and 6; elbow = angle of the two links from
    one line; shoulder = distance of the point where axis 5 meets axis 6 from the plane of axes 1 and 2.
    Other arms: the least singular value of the Jacobian (linear rows over LENGTH), counted for the group of joints
    that its joint motion moves most; the other margins are infinite there.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.general = robot, GeneralSolver.for_robot(robot)
        self.branches, self.branch_stable = self.general.branches, self.general.branch_stable
        reach = np.linalg.norm(np.diff(np.vstack([robot.point, robot.T_base_flange_zero[None, :3, 3]]), axis=0), axis=1)
        self._reach = float(reach[1:].sum())  # m, from axis 2 outwards: no pose beyond it can be reached

    def solve(self, T_base_flange: Array) -> Branches:
        """All branches of (M, 4, 4) poses."""
        return self._measured(T_base_flange, self.general.solve(T_base_flange))

    def solve_grid(self, T_base_flange: Array, q: Array | None = None) -> Branches:
        """All branches of (N, R, 4, 4) neighbouring poses, flattened to N·R rows; far fewer full solutions.

        ``q`` (N·R, B, 6) is filled where it is given.
        """
        N, R = T_base_flange.shape[:2]
        found = self.general.solve_grid(T_base_flange).reshape(N * R, self.branches, 6)
        if q is not None:
            q[:] = found
            found = q
        return self._measured(T_base_flange.reshape(N * R, 4, 4), found)

    def _measured(self, T: Array, q: Array) -> Branches:
        exists = np.asarray(np.isfinite(q).all(axis=-1))
        margin = np.full((len(q), 3, q.shape[1]), np.nan)
        if exists.any():
            found = (
                self._three_parallel(q[exists])
                if self.general.kind == "three_parallel"
                else self._by_jacobian(q[exists])
            )
            np.swapaxes(margin, 1, 2)[exists] = np.stack(found, axis=-1)
        # the way from axis 2 to the flange against the longest the arm can make: a lower bound of what is missing
        beyond = np.linalg.norm(T[:, :3, 3] - self.robot.point[1], axis=1) - self._reach
        short = np.where(exists.any(axis=1), 0.0, np.maximum(beyond, 0.0))
        return Branches(q, margin, short)

    def _three_parallel(self, q: Array) -> tuple[Array, Array, Array]:
        """Each margin as the link sees it that the angle belongs to, so that no chain of poses is needed."""
        h, p = self.robot.axis, self.robot.point
        wrist = _angle_to_line(h[3], _turned(h[4], q[:, 4], h[5]))

        def across(v: Array) -> Array:  # the part normal to the parallel axes
            return np.asarray(v - (v @ h[1])[..., None] * h[1])

        elbow = _angle_to_line(across(p[2] - p[1]), across(_turned(h[2], q[:, 2], p[3] - p[2])))
        meeting = p[4]  # of axes 5 and 6, as link 1 sees it
        for i in (3, 2, 1):
            meeting = _turned(h[i], q[:, i], meeting - p[i]) + p[i]
        shoulder = np.abs((meeting - p[0]) @ normalise(np.cross(h[0], h[1])))
        return shoulder, elbow, wrist

    def _by_jacobian(self, q: Array) -> tuple[Array, Array, Array]:
        _, J = self.robot.fk_jacobian(q)
        J = J.copy()
        J[:, :3] /= LENGTH
        _, sigma, Vt = np.linalg.svd(J)
        weight = Vt[:, -1] ** 2
        group = np.stack([weight[:, 0], weight[:, 1:3].sum(axis=1), weight[:, 3:].sum(axis=1)], axis=1).argmax(axis=1)
        out = [np.where(group == g, sigma[:, -1], np.inf) for g in range(3)]
        return out[0] * LENGTH, out[1], out[2]


def _turned(axis: Array, angle: Array, v: Array) -> Array:
    """Rodrigues: v (3,) or (M, 3) turned about one unit axis (3,) by angles (M,), without matrices."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.asarray(c * v + s * (v @ skew(axis).T) + (1.0 - c) * ((v @ axis)[..., None] * axis))


def _angle_to_line(a: Array, b: Array) -> Array:
    """Angle between two lines, 0 … π/2."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.abs(np.sum(a * b, axis=-1))))
