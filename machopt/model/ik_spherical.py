"""Closed-form inverse kinematics of arms with a spherical wrist and parallel axes 2 and 3.

Canonical subproblems (Paden 1986; Murray, Li & Sastry 1994, section 3.3) on the six lines of
:class:`~machopt.model.robot.Robot`, so any zero position, sign or offset of a URDF is taken as it is.
Always eight branches in a fixed order: index = 4·shoulder + 2·elbow + wrist, each 0 or 1, so "the same
branch along the path" is the same index.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.model.robot import Robot
from machopt.se3 import axis_rotation, wrap

Array = NDArray[np.float64]
PARALLEL = 1e-6  # rad; two axes of a URDF with printed decimals count as parallel below this
CONCURRENT = 2e-6  # m; three axes meet when each passes within this of one point


@dataclass(frozen=True)
class Branches:
    """All branches for M poses.

    Where a branch does not exist its joints are NaN and ``shortfall`` tells how much length is missing.
    """

    q: Array  # (M, B, 6) rad in (−π, π]
    shoulder: Array  # (M, B) m, distance of the wrist centre from the shoulder singularity
    elbow: Array  # (M, B) rad, angle of the elbow from stretched or folded
    wrist: Array  # (M, B) rad, angle between axes 4 and 6 from aligned
    shortfall: Array  # (M,) m, how far the wrist centre lies outside the reach of every branch; 0 inside


def wrist_centre(robot: Robot) -> Array | None:
    """The common point of axes 4, 5 and 6 at q = 0, (3,) m in base_link, or None."""
    A = np.vstack([np.eye(3) - np.outer(h, h) for h in robot.axis[3:]])
    b = np.concatenate([(np.eye(3) - np.outer(h, h)) @ p for h, p in zip(robot.axis[3:], robot.point[3:], strict=True)])
    centre = np.linalg.lstsq(A, b, rcond=None)[0]
    off = np.linalg.norm((A @ centre - b).reshape(3, 3), axis=1)
    return centre if off.max() < CONCURRENT else None


class SphericalWristSolver:
    """Closed form for a spherical wrist with axes 2 and 3 parallel and axis 1 not parallel to them.

    Raises:
        ValueError: the arm is of another kind (use the general solver).
    """

    branches = 8
    branch_stable = True  # the index names the same assembly mode everywhere

    def __init__(self, robot: Robot) -> None:
        centre = wrist_centre(robot)
        if centre is None or not self.fits(robot):
            raise ValueError("the arm has no spherical wrist behind two parallel axes")
        self.robot, self.centre = robot, centre

    @staticmethod
    def fits(robot: Robot) -> bool:
        h = robot.axis
        parallel = np.linalg.norm(np.cross(h[1], h[2])) < PARALLEL
        skewed = np.linalg.norm(np.cross(h[0], h[1])) > 0.1 and np.linalg.norm(np.cross(h[3], h[4])) > 0.1
        return bool(
            parallel and skewed and np.linalg.norm(np.cross(h[4], h[5])) > 0.1 and wrist_centre(robot) is not None
        )

    def solve_grid(self, T_base_flange: Array) -> Branches:
        """All branches of (N, R, 4, 4) poses, flattened to N·R rows."""
        return self.solve(T_base_flange.reshape(-1, 4, 4))

    def solve(self, T_base_flange: Array) -> Branches:
        """All eight branches.

        Args:
            T_base_flange: (M, 4, 4).
        """
        r, h, W = self.robot, self.robot.axis, self.centre
        zero = r.T_base_flange_zero
        R06 = T_base_flange[:, :3, :3] @ zero[:3, :3].T
        pw = T_base_flange[:, :3, 3] + R06 @ (W - zero[:3, 3])
        M = len(pw)
        # joint 1: the component along axis 2 is untouched by joints 2 and 3
        u = pw - r.point[0]
        along = u @ h[0]
        A = u @ h[1] - along * (h[0] @ h[1])
        B = -np.cross(h[0], u) @ h[1]
        C = np.full(M, (W - r.point[0]) @ h[1]) - along * (h[0] @ h[1])
        q1, margin1, miss1 = _harmonic(A, B, C)  # (M, 2), (M,), (M,)
        q1 = np.repeat(q1, 2, axis=1)  # columns: shoulder 0, 0, 1, 1
        # joint 3: distance from axis 2 to the wrist centre
        v = np.einsum("msij,mj->msi", axis_rotation(h[0], -q1), u) + r.point[0] - r.point[1]
        a, b = r.point[2] - r.point[1], W - r.point[2]
        ha, hb = h[2] @ a, h[2] @ b
        c = (np.sum(v[:, ::2] ** 2, axis=-1) - a @ a - b @ b) / 2 - ha * hb  # (M, 2)
        An, Bn = a @ b - ha * hb, a @ np.cross(h[2], b)
        q3_, angle3, miss3 = _harmonic(np.full(c.shape, An), np.full(c.shape, Bn), c)  # (M, 2, 2)
        q3 = q3_.reshape(M, 4)
        w = a + np.einsum("msij,j->msi", axis_rotation(h[2], q3), b)
        q2 = _angle_about(h[1], w, v)
        # wrist
        R13 = axis_rotation(h[0], q1) @ axis_rotation(h[1], q2) @ axis_rotation(h[2], q3)
        Rr = np.swapaxes(R13, -1, -2) @ R06[:, None]
        h45, h56 = h[4] @ h[3], h[4] @ h[5]
        C5 = np.einsum("i,msij,j->ms", h[3], Rr, h[5]) - h45 * h56
        q5, angle5, _ = _harmonic(
            np.full(C5.shape, h[3] @ h[5] - h45 * h56), np.full(C5.shape, h[3] @ np.cross(h[4], h[5])), C5
        )
        R5 = axis_rotation(h[4], q5)  # (M, 4, 2, 3, 3)
        q4 = _angle_about(h[3], R5 @ h[5], (Rr @ h[5])[:, :, None])
        q6 = -_angle_about(h[5], np.einsum("mswji,j->mswi", R5, h[3]), np.einsum("msji,j->msi", Rr, h[3])[:, :, None])
        q = np.empty((M, 4, 2, 6))
        q[..., 0], q[..., 1], q[..., 2] = q1[..., None], q2[..., None], q3[..., None]
        q[..., 3], q[..., 4], q[..., 5] = q4, q5, q6
        q = wrap(q.reshape(M, 8, 6))
        q[~np.isfinite(q).all(axis=-1)] = np.nan  # a branch exists whole or not at all
        elbow = np.repeat(angle3, 2, axis=1)  # (M, 4)
        reach = np.hypot(An, Bn)
        # missing length: the chord |v| against the longest and the shortest the two links can make
        chord = np.sqrt(np.maximum(np.sum(v[:, ::2] ** 2, axis=-1), 0))
        base = a @ a + b @ b + 2 * ha * hb
        far, near = np.sqrt(base + 2 * reach), np.sqrt(max(base - 2 * reach, 0.0))
        short = np.where(miss3, np.maximum(chord - far, near - chord), 0.0).min(axis=1)
        short = np.where(miss1, np.abs(C) - np.hypot(A, B), short)
        return Branches(
            q=q,
            shoulder=np.repeat(np.where(miss1, np.nan, np.sin(margin1) * np.hypot(A, B))[:, None], 8, axis=1),
            elbow=np.repeat(elbow, 2, axis=1),
            wrist=np.repeat(angle5.reshape(M, 4), 2, axis=1),
            shortfall=np.maximum(short, 0.0),
        )


def _harmonic(A: Array, B: Array, C: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Both solutions of A cos q + B sin q = C on a new last axis, NaN where there is none.

    Also the angle of the solutions from their merging point (0 = double root; sine of it for joint 1's
    margin is taken by the caller as a length), and where there is none.
    """
    n = np.hypot(A, B)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = C / n
    miss = ~(np.abs(ratio) <= 1.0)
    half = np.arccos(np.where(miss, np.nan, np.clip(ratio, -1, 1)))
    centre = np.arctan2(B, A)
    q = np.stack([centre + half, centre - half], axis=-1)
    return q, np.minimum(half, np.pi - half), miss


def _angle_about(h: Array, source: Array, target: Array) -> Array:
    """Angle about h that turns ``source`` onto ``target`` (components normal to h)."""
    cross = np.cross(source, target) @ h
    dot = np.sum(source * target, axis=-1) - (source @ h) * (target @ h)
    return np.asarray(np.arctan2(cross, dot))
