"""Closed-form inverse kinematics of the spherical wrist in NumPy: reference for the compiled kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.inverse.solver import SingularityMargins
from machopt.kinematics.inverse.spherical_wrist import KinematicBranches, find_wrist_centre
from machopt.kinematics.robot import Robot
from machopt.numerics.rigid_transforms import compute_axis_rotation, wrap_angle

Array = NDArray[np.float64]


class Reference:
    def __init__(self, robot: Robot) -> None:
        centre = find_wrist_centre(robot)
        assert centre is not None
        self.robot, self.centre = robot, centre

    def solve(self, T_base_flange: Array) -> KinematicBranches:
        """Return all eight branches.

        Args:
            T_base_flange: (M, 4, 4).
        """
        r, h, W = self.robot, self.robot.axis, self.centre
        zero = r.T_base_flange_zero
        R06 = T_base_flange[:, :3, :3] @ zero[:3, :3].T
        pw = T_base_flange[:, :3, 3] + R06 @ (W - zero[:3, 3])
        M = len(pw)
        # joint 1: joints 2 and 3 do not change the component along axis 2
        u = pw - r.point[0]
        along = u @ h[0]
        A = u @ h[1] - along * (h[0] @ h[1])
        B = -np.cross(h[0], u) @ h[1]
        C = np.full(M, (W - r.point[0]) @ h[1]) - along * (h[0] @ h[1])
        q1, margin1, miss1 = _harmonic(A, B, C)  # (M, 2), (M,), (M,)
        q1 = np.repeat(q1, 2, axis=1)  # columns: shoulder 0, 0, 1, 1
        # joint 3: distance from axis 2 to the wrist centre
        v = np.einsum("msij,mj->msi", compute_axis_rotation(h[0], -q1), u) + r.point[0] - r.point[1]
        a, b = r.point[2] - r.point[1], W - r.point[2]
        ha, hb = h[2] @ a, h[2] @ b
        c = (np.sum(v[:, ::2] ** 2, axis=-1) - a @ a - b @ b) / 2 - ha * hb  # (M, 2)
        An, Bn = a @ b - ha * hb, a @ np.cross(h[2], b)
        q3_, angle3, miss3 = _harmonic(np.full(c.shape, An), np.full(c.shape, Bn), c)  # (M, 2, 2)
        q3 = q3_.reshape(M, 4)
        w = a + np.einsum("msij,j->msi", compute_axis_rotation(h[2], q3), b)
        q2 = _angle_about(h[1], w, v)
        # wrist
        R13 = compute_axis_rotation(h[0], q1) @ compute_axis_rotation(h[1], q2) @ compute_axis_rotation(h[2], q3)
        Rr = np.swapaxes(R13, -1, -2) @ R06[:, None]
        h45, h56 = h[4] @ h[3], h[4] @ h[5]
        C5 = np.einsum("i,msij,j->ms", h[3], Rr, h[5]) - h45 * h56
        q5, angle5, _ = _harmonic(
            np.full(C5.shape, h[3] @ h[5] - h45 * h56), np.full(C5.shape, h[3] @ np.cross(h[4], h[5])), C5
        )
        R5 = compute_axis_rotation(h[4], q5)  # (M, 4, 2, 3, 3)
        q4 = _angle_about(h[3], R5 @ h[5], (Rr @ h[5])[:, :, None])
        q6 = -_angle_about(h[5], np.einsum("mswji,j->mswi", R5, h[3]), np.einsum("msji,j->msi", Rr, h[3])[:, :, None])
        q = np.empty((M, 4, 2, 6))
        q[..., 0], q[..., 1], q[..., 2] = q1[..., None], q2[..., None], q3[..., None]
        q[..., 3], q[..., 4], q[..., 5] = q4, q5, q6
        q = wrap_angle(q.reshape(M, 8, 6))
        q[~np.isfinite(q).all(axis=-1)] = np.nan  # all joints of a branch exist or none
        elbow = np.repeat(angle3, 2, axis=1)  # (M, 4)
        reach = np.hypot(An, Bn)
        # missing length: the chord |v| relative to the longest and the shortest chord of the two links
        chord = np.sqrt(np.maximum(np.sum(v[:, ::2] ** 2, axis=-1), 0))
        base = a @ a + b @ b + 2 * ha * hb
        far, near = np.sqrt(base + 2 * reach), np.sqrt(max(base - 2 * reach, 0.0))
        short = np.where(miss3, np.maximum(chord - far, near - chord), 0.0).min(axis=1)
        short = np.where(miss1, np.abs(C) - np.hypot(A, B), short)
        shoulder = np.repeat(np.where(miss1, np.nan, np.sin(margin1) * np.hypot(A, B))[:, None], 8, axis=1)
        wrist = np.repeat(angle5.reshape(M, 4), 2, axis=1)
        return KinematicBranches(
            q, np.stack([shoulder, np.repeat(elbow, 2, axis=1), wrist], axis=1), np.maximum(short, 0.0)
        )


def reference_reasons(branches: KinematicBranches, margins: SingularityMargins) -> NDArray[np.uint8]:
    exists = np.isfinite(branches.q).all(axis=-1)
    out = np.full(exists.shape, InfeasibilityReason.UNREACHABLE, np.uint8)
    out[exists] = InfeasibilityReason.OK
    with np.errstate(invalid="ignore"):
        out[exists & (branches.wrist < margins.wrist)] = InfeasibilityReason.SINGULAR_WRIST
        out[exists & (branches.elbow < margins.elbow)] = InfeasibilityReason.SINGULAR_ELBOW
        out[exists & (branches.shoulder < margins.shoulder)] = InfeasibilityReason.SINGULAR_SHOULDER
    return out


def _harmonic(A: Array, B: Array, C: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return both solutions of A cos q + B sin q = C on a new last axis, NaN if there is none.

    Also return the angle of the solutions from their double root (0 = double root; the caller converts its sine to a
    length for the margin of joint 1), and whether there is no solution.
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
    """Return the angle about h that rotates ``source`` to ``target`` (components normal to h)."""
    cross = np.cross(source, target) @ h
    dot = np.sum(source * target, axis=-1) - (source @ h) * (target @ h)
    return np.asarray(np.arctan2(cross, dot))
