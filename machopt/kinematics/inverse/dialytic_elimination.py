"""All real inverse kinematics of a general 6R arm by dialytic elimination, batched and without symbolic algebra.

Let E_i be the rotation about line i and G = T_base_flange · T_zero⁻¹ = E₁…E₆. For k ∈ {1, 2, 3} the line of joint
d = k+3 is not moved by E_d, so with its direction w and point p

    E_k E_{k+1} E_{k+2} (p, w) = E_{k−1}⁻¹ … E₁⁻¹ · G · E₆⁻¹ … E_{d+1}⁻¹ (p, w)        (two joints on the right)

Seen from a point of axis k the fourteen numbers p, w, p·p, p·w, p×w, w(p·p) − 2p(p·w) of both sides are
multilinear in (1, cos qᵢ, sin qᵢ), so their coefficients follow exactly from three samples of each angle. The
eight right-hand monomials are eliminated by the left null space, six equations in three angles remain; in
half-angle tangents, and multiplied by 1 and x_u, they are (A₀ + A₁x_e + A₂x_e²) m = 0 with twelve monomials
m = x_u^i x_v^j: an eigenvalue problem whose real eigenvalues are the solutions for q_e.

Source: Raghavan & Roth 1993 (J. Mech. Design 115:502–508) for the fourteen equations; Manocha & Canny 1994
(IEEE Trans. Robot. Autom. 10:648–657) for the eigenvalue form.
The choice of k, of the direction of the chain, of x_e and x_u decides the conditioning; the arm's best choices are
found once by trial on random configurations.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_axis_rotation, invert_transform

SAMPLES = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0  # three angles fix a first-order trigonometric polynomial
TO_COEFFICIENTS = np.linalg.inv(np.stack([np.ones(3), np.cos(SAMPLES), np.sin(SAMPLES)], axis=1))
NEARLY_REAL = 0.03  # |Im x|/(1 + |x|²): double roots split by √rounding; Newton decides what is real
SHARED_ROOT_RAD = 1e-5  # rad; solutions closer in the eigenvalue's angle than this may come out mixed
RANK_TOLERANCE = 1e-9  # of the largest singular value; two-parallel and meeting axes make some monomials dependent
POSE_BLOCK_SIZE = 2048  # poses per block: their 24×24 matrices fit the cache of a small machine


@dataclass(frozen=True)
class EliminationChoice:
    """Choice among the equivalent eliminations."""

    reverse: bool  # the chain is read from the flange to the base
    k: int  # 1, 2 or 3: the first joint on the left-hand side
    e: int  # 0, 1, 2: which of the three left joints is the eigenvalue
    u: int  # which is multiplied
    phase: tuple[float, float, float]  # rad, zero of each half-angle tangent

    @property
    def v(self) -> int:
        """The left joint that is neither e nor u."""
        return 3 - self.e - self.u


@dataclass(frozen=True, kw_only=True)
class DialyticElimination:
    """One elimination of one arm, with lengths in units of the arm's size."""

    choice: EliminationChoice
    axis: Array  # (6, 3) in reading order
    point: Array  # (6, 3) in units of ``length``
    length: float  # m
    T_end_base: Array  # (4, 4) inverse of the flange pose at q = 0, m
    left: Array = field(repr=False)  # (14, 3, 3, 3) coefficients of the left side in (1, c, s)³
    left_half: Array = field(repr=False)  # (14, 3, 3, 3) the same in half-angle tangents, axes in order e, u, v
    one_half: Array = field(repr=False)  # (3, 3, 3) the constant 1 likewise

    @classmethod
    def build(cls, robot: Robot, choice: EliminationChoice) -> DialyticElimination:
        """Compute the constant coefficients of an arm.

        Args:
            robot: kinematic model.
            choice: elimination to use.
        """
        length = _compute_arm_size(robot)
        step = -1 if choice.reverse else 1
        axis, point = step * robot.axis[::step], robot.point[::step] / length
        k = choice.k - 1
        grid = np.stack(np.meshgrid(SAMPLES, SAMPLES, SAMPLES, indexing="ij"), axis=-1)
        p, w = np.broadcast_to(point[k + 3], (3, 3, 3, 3)), np.broadcast_to(axis[k + 3], (3, 3, 3, 3))
        for j in (2, 1, 0):
            p, w = _rotate_line(axis[k + j], point[k + j], grid[..., j], p, w)
        c = TO_COEFFICIENTS
        left = np.einsum("xyzn,ax,by,cz->nabc", _build_line_equations(p - point[k], w), c, c, c, optimize=True)
        order = (choice.e, choice.u, choice.v)
        W = [_build_half_angle_matrix(choice.phase[j]) for j in order]
        half = np.einsum("nabc,ai,bj,ck->nijk", left.transpose(0, *(1 + j for j in order)), *W, optimize=True)
        one = np.einsum("i,j,k->ijk", W[0][0], W[1][0], W[2][0])
        return cls(
            choice=choice,
            axis=axis,
            point=point,
            length=length,
            T_end_base=invert_transform(robot.T_base_flange_zero),
            left=left,
            left_half=half,
            one_half=one,
        )

    def find_candidates(self, T_base_flange: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return rough solutions that need Newton refinement and a check.

        Args:
            T_base_flange: (M, 4, 4) flange poses in base_link.

        Returns:
            q (K, 6) rad and the pose each belongs to (K,).
        """
        parts = [
            self._find_candidates_of_block(T_base_flange[i : i + POSE_BLOCK_SIZE], i)
            for i in range(0, len(T_base_flange), POSE_BLOCK_SIZE)
        ]
        if not parts:
            return np.empty((0, 6)), np.empty(0, np.int64)
        return np.concatenate([q for q, _ in parts]), np.concatenate([m for _, m in parts])

    def find_shared_eigenvalues(self, q: Array, pose: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the poses with two candidates that share the eigenvalue's angle.

        Args:
            q: (K, 6) rad, candidates.
            pose: (K,) pose of each.
        """
        joint = self.choice.k - 1 + self.choice.e
        turned = q[:, 5 - joint if self.choice.reverse else joint] - self.choice.phase[self.choice.e]
        angle = np.mod(turned, 2.0 * np.pi)  # the wrap is at the phase, away from round angles
        order = np.lexsort((angle, pose))
        close = (np.diff(pose[order]) == 0) & (np.diff(angle[order]) < SHARED_ROOT_RAD)
        shared: NDArray[np.int64] = pose[order][1:][close]
        return shared

    def _find_candidates_of_block(self, T_base_flange: Array, first: int) -> tuple[Array, NDArray[np.int64]]:
        G = np.asarray(T_base_flange, float) @ self.T_end_base
        if self.choice.reverse:
            G = invert_transform(G)
        G[:, :3, 3] /= self.length
        right = self._build_right_side(G)  # (M, 14, 9), constant first
        U, S, Vt = np.linalg.svd(right[:, :, 1:])
        N = np.swapaxes(U[:, :, 8:], 1, 2)  # (M, 6, 14)
        P = np.tensordot(N, self.left_half, axes=(2, 0))
        P -= (N @ right[:, :, :1])[..., None, None] * self.one_half
        value, vector, pose = _solve_eigenproblem(P)
        q_left = np.empty((len(value), 3))
        for j, x in zip((self.choice.e, self.choice.u, self.choice.v), _compute_angles(value, vector), strict=True):
            q_left[:, j] = self.choice.phase[j] + x
        basis = [np.stack([np.ones(len(value)), np.cos(q_left[:, j]), np.sin(q_left[:, j])]) for j in range(3)]
        state = np.einsum("nabc,am,bm,cm->mn", self.left, *basis, optimize=True) - right[pose, :, 0]
        weight = np.where(S[:, :1] * RANK_TOLERANCE < S, 1.0 / np.where(S > 0, S, 1.0), 0.0)
        y = np.einsum("mji,mj->mi", Vt[pose], weight[pose] * np.einsum("mni,mn->mi", U[pose, :, :8], state))
        y = np.concatenate([np.ones((len(y), 1)), y], axis=1).reshape(-1, 3, 3)
        return self._assemble_angles(G[pose], q_left, y), pose + first

    def _build_right_side(self, G: Array) -> Array:
        """Coefficients (M, 14, 9) of the right side in the monomials of the two right joints, 1 first."""
        k = self.choice.k - 1
        p, w = np.broadcast_to(self.point[k + 3], (3, 3, 3)), np.broadcast_to(self.axis[k + 3], (3, 3, 3))
        angle = dict(zip(self._solve_right_joints(), np.meshgrid(SAMPLES, SAMPLES, indexing="ij"), strict=True))
        for j in range(k + 4, 6):
            p, w = _rotate_line(self.axis[j], self.point[j], -angle[j], p, w)
        p = np.einsum("mij,abj->mabi", G[:, :3, :3], p) + G[:, None, None, :3, 3]
        w = np.einsum("mij,abj->mabi", G[:, :3, :3], w)
        for j in range(k):
            p, w = _rotate_line(self.axis[j], self.point[j], -angle[j], p, w)
        S = _build_line_equations(p - self.point[k], w)
        c = TO_COEFFICIENTS
        right: Array = np.einsum("mxyn,ax,by->mnab", S, c, c, optimize=True)
        return right.reshape(len(G), 14, 9)

    def _solve_right_joints(self) -> tuple[int, int]:
        k = self.choice.k - 1
        first, second = (*range(k), *range(k + 4, 6))
        return first, second

    def _assemble_angles(self, G: Array, q_left: Array, y: Array) -> Array:
        """The six angles (K, 6) in the arm's own order; the joint d comes from the remaining rotation."""
        k, d = self.choice.k - 1, self.choice.k + 2
        q = np.empty((len(G), 6))
        q[:, k : k + 3] = q_left
        first, second = self._solve_right_joints()
        q[:, first] = np.arctan2(y[:, 2, 0], y[:, 1, 0])
        q[:, second] = np.arctan2(y[:, 0, 2], y[:, 0, 1])
        R = G[:, :3, :3]
        for j in range(d):  # E_{d−1}⁻¹ … E₁⁻¹ G
            R = compute_axis_rotation(self.axis[j], -q[:, j]) @ R
        for j in range(5, d, -1):  # … E₆⁻¹ … E_{d+1}⁻¹
            R = R @ compute_axis_rotation(self.axis[j], -q[:, j])
        vee = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=-1)
        q[:, d] = np.arctan2(vee @ self.axis[d], np.trace(R, axis1=1, axis2=2) - 1.0)
        return q[:, ::-1] if self.choice.reverse else q


def _solve_eigenproblem(P: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Nearly real eigenvalues x_e (K,), their monomials (K, 4, 3) and poses (K,) from six equations (M, 6, 3, 3, 3)."""
    M = len(P)
    rows = np.zeros((3, M, 2, 6, 4, 3))
    for a in range(3):
        rows[a, :, 0, :, 0:3] = P[:, :, a]
        rows[a, :, 1, :, 1:4] = P[:, :, a]  # the same times x_u
    A = rows.reshape(3, M, 12, 12)
    usable = np.isfinite(np.linalg.slogdet(A[2])[1])  # otherwise solve would reject the whole batch
    companion = np.zeros((M, 24, 24))
    companion[:, :12, 12:] = np.eye(12)
    companion[usable, 12:] = -np.linalg.solve(A[2][usable], np.concatenate([A[0], A[1]], axis=-1)[usable])
    usable &= np.isfinite(companion).all(axis=(1, 2))
    companion[~usable] = 0.0
    value, vector = np.linalg.eig(companion)
    near = (np.abs(value.imag) < NEARLY_REAL * (1.0 + np.abs(value) ** 2)) & usable[:, None]
    pose, index = np.nonzero(near)
    x = value[pose, index]
    v = vector[pose, :, index].reshape(-1, 2, 12)
    m = np.where((np.abs(x) > 1.0)[:, None], v[:, 1], v[:, 0])
    return x.real, m.reshape(-1, 4, 3), pose


def _compute_angles(value: Array, m: Array) -> tuple[Array, Array, Array]:
    """Angles (K,) each of e, u, v: twice the arc tangent of ratios of the largest neighbouring monomials."""
    K = np.arange(len(m))
    size = np.abs(m)
    column = np.argmax(size.sum(axis=1), axis=1)
    mu = m[K, :, column]  # (K, 4)
    i = np.where(np.abs(mu[:, 0]) > np.abs(mu[:, 3]), 0, 2)
    row = np.argmax(size.sum(axis=2), axis=1)
    mv = m[K, row]  # (K, 3)
    j = np.where(np.abs(mv[:, 0]) > np.abs(mv[:, 2]), 0, 1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        xu = (mu[K, i + 1] / mu[K, i]).real
        xv = (mv[K, j + 1] / mv[K, j]).real
    return 2 * np.arctan(value), 2 * np.arctan(xu), 2 * np.arctan(xv)


def _build_line_equations(p: Array, w: Array) -> Array:
    """p, w, p·p, p·w, p×w, w(p·p) − 2p(p·w): (..., 14) from a point and a direction (..., 3)."""
    pp, pl = np.sum(p * p, axis=-1, keepdims=True), np.sum(p * w, axis=-1, keepdims=True)
    return np.concatenate([p, w, pp, pl, np.cross(p, w), w * pp - 2.0 * p * pl], axis=-1)


def _rotate_line(axis: Array, point: Array, angle: Array, p: Array, w: Array) -> tuple[Array, Array]:
    """Turn points p and directions w (..., 3) about a line."""
    R = compute_axis_rotation(axis, angle)
    return np.einsum("...ij,...j->...i", R, p - point) + point, np.einsum("...ij,...j->...i", R, w)


def _build_half_angle_matrix(phase: float) -> Array:
    """(3, 3): rows 1, cos q, sin q times (1 + x²) in powers of x, with q = phase + 2 atan x."""
    c, s = np.cos(phase), np.sin(phase)
    return np.array([[1.0, 0.0, 1.0], [c, -2.0 * s, -c], [s, 2.0 * c, -s]])


def _compute_arm_size(robot: Robot) -> float:
    """A length of the arm in m, to make the equations dimensionless."""
    chain = np.vstack([robot.point, robot.T_base_flange_zero[:3, 3]])
    return float(max(np.linalg.norm(chain - chain[0], axis=1).max() / 2.0, 1e-3))
