"""A serial chain of single degrees of freedom, each with its own spring, in batches: positions, forces, curvature.

Every joint, every hinge of a beam, every way the pedestal gives is one degree of freedom x_d, a turn (R) or a shift (P)
about its own axis. With dead loads F_k at points p_k the generalised force and the Hessian of the loads' potential are

    Q_i  = z_i · Σ_{k≥i} ((p_k − o_i) × F_k + M_k)   (R)        Q_i = z_i · Σ_{k≥i} F_k                     (P)
    H_ij = z_i · (A_j z_j − tr(A_j) z_j), i ≤ j      (R, R)      H_ij = z_i · (z_j × Σ_{k≥j} F_k), i ≤ j     (R, P)

with A_j = Σ_{k≥j} (p_k − o_j) F_kᵀ. The moments that a wrench holds constant in base axes have no potential; they act
in Q and are left out of H, which only slows the iteration down.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class Placement:
    """A frame in its parent: p_parent = R p + t."""

    R: Array  # (3, 3)
    t: Array  # (3,) m

    def __matmul__(self, other: Placement) -> Placement:
        return Placement(self.R @ other.R, self.R @ other.t + self.t)


def shift(t: Array) -> Placement:
    """A frame that is only moved."""
    return Placement(np.eye(3), np.asarray(t, float))


def turn_rpy(rpy: Array) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def turn_about(axis: Array, angle: Array) -> Array:
    """Rotation matrices (B, 3, 3) about one unit axis (3,) by angles (B,)."""
    K = cross_matrix(axis)
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))


def cross_matrix(a: Array) -> Array:
    """[a]× of (3,)."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def rotation_vector(R: Array) -> Array:
    """(B, 3) rad of rotations (B, 3, 3) well below half a turn."""
    v = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    s = np.linalg.norm(v, axis=1)
    angle = np.arctan2(s, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    return np.asarray(v * np.where(s > 1e-12, angle / np.maximum(s, 1e-300), 1.0)[:, None])


@dataclass
class Chain:
    """Degrees of freedom from the floor to the tool."""

    turns: list[bool] = field(default_factory=list)  # R or P
    axes: list[Array] = field(default_factory=list)  # unit, in the frame before the motion
    before: list[Placement] = field(default_factory=list)  # from the frame after the last one to this one
    weights: list[tuple[int, float, Array]] = field(default_factory=list)  # frame, kg, centre in it m
    pending: Placement = field(default_factory=lambda: shift(np.zeros(3)))  # fixed step not yet used

    def __len__(self) -> int:
        return len(self.turns)

    def step(self, placement: Placement) -> None:
        """A fixed step before the next degree of freedom."""
        self.pending = self.pending @ placement

    def add(self, turns: bool, axis: Array) -> int:
        """One more degree of freedom; returns its index."""
        self.turns.append(turns)
        self.axes.append(np.asarray(axis, float))
        self.before.append(self.pending)
        self.pending = shift(np.zeros(3))
        return len(self.turns) - 1

    def weigh(self, mass: float, centre: Array) -> None:
        """A mass in the current frame, with what is pending."""
        at = self.pending.R @ np.asarray(centre, float) + self.pending.t
        self.weights.append((len(self), mass, at))

    def forward(self, x: Array) -> Posture:
        """Place the chain at coordinates (B, n)."""
        B, n = x.shape
        R, p = np.broadcast_to(np.eye(3), (B, 3, 3)), np.zeros((B, 3))
        rotation, origin = np.empty((B, n + 1, 3, 3)), np.empty((B, n + 1, 3))
        z, o = np.empty((B, n, 3)), np.empty((B, n, 3))
        rotation[:, 0], origin[:, 0] = R, p
        for d in range(n):
            p = p + R @ self.before[d].t
            R = R @ self.before[d].R
            z[:, d], o[:, d] = R @ self.axes[d], p
            if self.turns[d]:
                R = R @ turn_about(self.axes[d], x[:, d])
            else:
                p = p + z[:, d] * x[:, d, None]
            rotation[:, d + 1], origin[:, d + 1] = R, p
        return Posture(self, z, o, rotation, origin)


@dataclass
class Loads:
    """Dead loads: which frame they hang on, where they act, force and moment in base axes."""

    frame: list[int] = field(default_factory=list)
    point: list[Array] = field(default_factory=list)  # (B, 3) m
    force: list[Array] = field(default_factory=list)  # (B, 3) N
    moment: list[Array] = field(default_factory=list)  # (B, 3) N·m

    def add(self, frame: int, point: Array, force: Array, moment: Array | None = None) -> None:
        self.frame.append(frame)
        self.point.append(point)
        self.force.append(np.broadcast_to(force, point.shape))
        self.moment.append(np.zeros_like(point) if moment is None else moment)


@dataclass(frozen=True)
class Posture:
    """A placed chain."""

    chain: Chain
    z: Array  # (B, n, 3) axes in base
    o: Array  # (B, n, 3) m, a point on each
    R: Array  # (B, n + 1, 3, 3) frames, 0 is the floor
    p: Array  # (B, n + 1, 3) m

    def point(self, frame: int, local: Array) -> Array:
        """(B, 3) of a point fixed in a frame."""
        return np.asarray(self.p[:, frame] + self.R[:, frame] @ local)

    def tip(self) -> tuple[Array, Array]:
        """Position (B, 3) m and rotation (B, 3, 3) of what stands at the end of the chain."""
        end = self.chain.pending
        return self.point(-1, end.t), np.asarray(self.R[:, -1] @ end.R)

    def gravity(self, scale: float = 1.0) -> Loads:
        """The weights as loads."""
        loads = Loads()
        for frame, mass, centre in self.chain.weights:
            loads.add(frame, self.point(frame, centre), np.array([0.0, 0.0, -scale * mass * GRAVITY]))
        return loads

    def generalised(self, loads: Loads, curvature: bool = True) -> tuple[Array, Array]:
        """Q (B, n) and H (B, n, n) of dead loads."""
        B, n, _ = self.z.shape
        P, f, m = (np.stack(a, axis=1) for a in (loads.point, loads.force, loads.moment))  # (B, loads, 3)
        hangs = (np.array(loads.frame)[None, :] == np.arange(n + 1)[:, None]).astype(float)
        F, N = hangs @ f, hangs @ (_cross(P, f) + m)
        A = (hangs @ (P[..., :, None] * f[..., None, :]).reshape(B, -1, 9)).reshape(B, n + 1, 3, 3)
        F, N, A = (np.cumsum(a[:, ::-1], axis=1)[:, ::-1][:, 1:] for a in (F, N, A))
        turns = np.array(self.chain.turns)
        Q = np.where(
            turns, np.einsum("bnc,bnc->bn", self.z, N - _cross(self.o, F)), np.einsum("bnc,bnc->bn", self.z, F)
        )
        if not curvature:
            return Q, np.zeros((B, n, n))
        A = A - self.o[:, :, :, None] * F[:, :, None, :]
        trace = np.trace(A, axis1=2, axis2=3)
        h = np.where(
            turns[:, None], np.einsum("bnij,bnj->bni", A, self.z) - trace[:, :, None] * self.z, _cross(self.z, F)
        )
        H = (self.z * turns[:, None]) @ np.swapaxes(h, 1, 2)
        upper = np.triu(np.ones((n, n), bool))
        H = np.where(upper, H, 0.0)
        return Q, np.asarray(H + np.swapaxes(np.where(np.eye(n, dtype=bool), 0.0, H), 1, 2))

    def jacobian(self) -> Array:
        """(B, 6, n) of the tip: m and rad per unit of each degree of freedom."""
        tip, _ = self.tip()
        turns = np.array(self.chain.turns)[:, None]
        linear = np.where(turns, _cross(self.z, tip[:, None] - self.o), self.z)
        return np.asarray(np.swapaxes(np.concatenate([linear, np.where(turns, self.z, 0.0)], axis=2), 1, 2))


def _cross(a: Array, b: Array) -> Array:
    """a × b along the last axis; several times as fast as numpy's for many short rows."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
