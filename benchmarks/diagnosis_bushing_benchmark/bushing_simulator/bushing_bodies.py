"""Rigid bodies in maximal coordinates, bushings and spring struts between them, and their force balance.

Each body b has an origin p_b and a rotation R_b (twelve numbers, six degrees of freedom). Its frame lies at its
upstream bushing.
A bushing between parent a and body b has the strain

    A   = R_a M_R exp(axis · rest)                     frame at rest
    ξ_t = Aᵀ (p_b − p_a − R_a M_p),  ξ_r = log(Aᵀ R_b)     (1)

and the energy U = ½ ξᵀ K ξ. A strut has U = F₀ L + ½ k (L − L₀)² with the length L between its two anchors.
Virtual work of (1) gives
forces and moments at both bodies exactly; the tangent is BᵀKB without the geometric part, so that the Newton
iteration is
linear with a ratio near load/stiffness (1e-3) while its fixed point is the exact equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from bushing_simulator.rotations import (
    build_skew,
    compute_axis_rotation,
    compute_inverse_left_jacobian,
    compute_rotation,
    compute_rotation_vector,
)

GRAVITY = np.array([0.0, 0.0, -9.80665])  # m/s²


@dataclass(frozen=True)
class Body:
    """A rigid body and the bushing that joins it to the previous one."""

    name: str
    marker_position: np.ndarray  # (3,) m, in the parent
    marker_rotation: np.ndarray  # (3, 3), in the parent
    stiffness: np.ndarray  # (6, 6) N/m, N, N·m/rad: translation first, in the frame at rest
    mass: float = 0.0  # kg
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m, in the body
    axis: np.ndarray | None = None  # joint axis, or None for a bushing inside a link
    joint: int = -1  # 0 … 5, or -1
    law: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None  # wrench and tangent of a strain (N, 6)


@dataclass(frozen=True)
class Strut:
    """A spring between two anchors; body −1 is the ground."""

    body_a: int
    anchor_a: np.ndarray  # (3,) m
    body_b: int
    anchor_b: np.ndarray  # (3,) m
    preload: float  # N, pull at the free length
    stiffness: float  # N/m
    length: float  # m


@dataclass(frozen=True)
class PointLoad:
    """A force that keeps its direction, at a point of a body."""

    body: int
    point: np.ndarray  # (3,) m, in the body
    force: np.ndarray  # (N, 3) N, in the base


@dataclass
class Posture:
    """Places of all bodies of a batch."""

    positions: np.ndarray  # (N, B, 3) m
    rotations: np.ndarray  # (N, B, 3, 3)


class MultibodyChain:
    """Bodies in a chain with struts; all postures of a batch are computed at once."""

    def __init__(self, bodies: list[Body], struts: list[Strut]) -> None:
        self.bodies, self.struts = bodies, struts

    def place_at_rest(self, rest: np.ndarray, growth: np.ndarray | None = None) -> Posture:
        """Return the posture without strain.

        Args:
            rest: (N, 6) rad, rest angle of each joint.
            growth: (N, B, 3) m added to each marker position (thermal), or None.
        """
        count = len(rest)
        R, p = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        positions, rotations = [], []
        for index, body in enumerate(self.bodies):
            marker = body.marker_position + (growth[:, index] if growth is not None else 0.0)
            p = p + np.einsum("nij,nj->ni", R, np.broadcast_to(marker, (count, 3)))
            R = R @ body.marker_rotation
            if body.joint >= 0:
                R = R @ compute_axis_rotation(body.axis, rest[:, body.joint])
            positions.append(p)
            rotations.append(R)
        return Posture(np.stack(positions, 1), np.stack(rotations, 1))

    def compute_strain(self, posture: Posture, index: int, rest: np.ndarray, growth: np.ndarray | None) -> dict:
        """Return strain (1), frame and lever of one bushing."""
        body = self.bodies[index]
        count = len(rest)
        if index:
            Ra, pa = posture.rotations[:, index - 1], posture.positions[:, index - 1]
        else:
            Ra, pa = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        marker = body.marker_position + (growth[:, index] if growth is not None else 0.0)
        A = Ra @ body.marker_rotation
        if body.joint >= 0:
            A = A @ compute_axis_rotation(body.axis, rest[:, body.joint])
        place = pa + np.einsum("nij,nj->ni", Ra, np.broadcast_to(marker, (count, 3)))
        pb, Rb = posture.positions[:, index], posture.rotations[:, index]
        translation = np.einsum("nji,nj->ni", A, pb - place)
        rotation = compute_rotation_vector(np.swapaxes(A, 1, 2) @ Rb)
        return {"xi": np.concatenate([translation, rotation], 1), "A": A, "lever": pb - pa}

    def compute_bushing(self, strain: dict, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return wrench F (N, 6) in frame A, tangent, and the strain matrices B of parent and body."""
        body, xi, A = self.bodies[index], strain["xi"], strain["A"]
        if body.law is not None:
            F, K = body.law(xi)
        else:
            F, K = xi @ body.stiffness, np.broadcast_to(body.stiffness, (len(xi), 6, 6))
        At = np.swapaxes(A, 1, 2)
        turn = compute_inverse_left_jacobian(xi[:, 3:]) @ At
        Bb = np.zeros((len(xi), 6, 6))
        Bb[:, :3, :3], Bb[:, 3:, 3:] = At, turn
        Ba = -Bb
        Ba[:, :3, 3:] = At @ build_skew(strain["lever"])  # −Aᵀ(δθ × r) = Aᵀ [r]× δθ
        return F, K, Ba, Bb

    def find_anchor(self, posture: Posture, body: int, anchor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return place (N, 3) of an anchor and its lever from the body's origin, in the base."""
        count = len(posture.positions)
        if body < 0:
            return np.broadcast_to(anchor, (count, 3)), np.zeros((count, 3))
        lever = posture.rotations[:, body] @ anchor
        return posture.positions[:, body] + lever, lever

    def compute_balance(
        self, posture: Posture, rest: np.ndarray, loads: list[PointLoad], growth: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return residual (N, B, 6), tangent blocks (diagonal, lower), and bushing wrenches (N, B, 6)."""
        count, bodies = len(rest), len(self.bodies)
        residual = np.zeros((count, bodies, 6))
        diagonal, lower = np.zeros((count, bodies, 6, 6)), np.zeros((count, bodies, 6, 6))
        wrench = np.zeros((count, bodies, 6))
        for index, body in enumerate(self.bodies):
            F, K, Ba, Bb = self.compute_bushing(self.compute_strain(posture, index, rest, growth), index)
            wrench[:, index] = F
            residual[:, index] += np.einsum("nki,nk->ni", Bb, F)
            KB = K @ Bb
            diagonal[:, index] += np.swapaxes(Bb, 1, 2) @ KB
            if index:
                residual[:, index - 1] += np.einsum("nki,nk->ni", Ba, F)
                lower[:, index] += np.swapaxes(KB, 1, 2) @ Ba
                diagonal[:, index - 1] += np.swapaxes(Ba, 1, 2) @ K @ Ba
            if body.mass:
                self._add_force(residual, posture, index, body.center, -body.mass * GRAVITY)
        for load in loads:
            self._add_force(residual, posture, load.body, load.point, -load.force)
        for strut in self.struts:
            self._add_strut(residual, diagonal, lower, posture, strut)
        return residual, diagonal, lower, wrench

    def _add_force(
        self, residual: np.ndarray, posture: Posture, body: int, point: np.ndarray, force: np.ndarray
    ) -> None:
        lever = posture.rotations[:, body] @ point
        residual[:, body, :3] += force
        residual[:, body, 3:] += np.cross(lever, np.broadcast_to(force, lever.shape))

    def _add_strut(
        self, residual: np.ndarray, diagonal: np.ndarray, lower: np.ndarray, posture: Posture, strut: Strut
    ) -> None:
        place_a, lever_a = self.find_anchor(posture, strut.body_a, strut.anchor_a)
        place_b, lever_b = self.find_anchor(posture, strut.body_b, strut.anchor_b)
        line = place_b - place_a
        length = np.linalg.norm(line, axis=1)
        n = line / length[:, None]
        pull = strut.preload + strut.stiffness * (length - strut.length)
        rows = {}
        for body, lever, sign in ((strut.body_a, lever_a, -1.0), (strut.body_b, lever_b, 1.0)):
            if body >= 0:
                rows[body] = sign * np.concatenate([n, np.cross(lever, n)], 1)
                residual[:, body] += pull[:, None] * rows[body]
                diagonal[:, body] += strut.stiffness * rows[body][:, :, None] * rows[body][:, None, :]
        for body in rows:
            if body - 1 in rows:
                lower[:, body] += strut.stiffness * rows[body][:, :, None] * rows[body - 1][:, None, :]

    def compute_energy(self, posture: Posture, rest: np.ndarray, loads: list[PointLoad]) -> np.ndarray:
        """Return the total potential (N,) in J: bushings, struts, weights, loads. Bushings with a law are left out."""
        total = np.zeros(len(rest))
        for index, body in enumerate(self.bodies):
            xi = self.compute_strain(posture, index, rest, None)["xi"]
            if body.law is None:
                total += 0.5 * np.einsum("ni,ij,nj->n", xi, body.stiffness, xi)
            total -= body.mass * self.find_anchor(posture, index, body.center)[0] @ GRAVITY
        for load in loads:
            total -= np.einsum("ni,ni->n", load.force, self.find_anchor(posture, load.body, load.point)[0])
        for strut in self.struts:
            a, b = (
                self.find_anchor(posture, *x)[0]
                for x in ((strut.body_a, strut.anchor_a), (strut.body_b, strut.anchor_b))
            )
            stretch = np.linalg.norm(b - a, axis=1) - strut.length
            total += strut.preload * stretch + 0.5 * strut.stiffness * stretch**2
        return total


def solve_block_tridiagonal(diagonal: np.ndarray, lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve the symmetric block-tridiagonal system of a chain by elimination from the base to the tip.

    Args:
        diagonal: (N, B, 6, 6). lower: (N, B, 6, 6), block (b, b−1) at index b. right: (N, B, 6).
    """
    bodies = diagonal.shape[1]
    D, y = [diagonal[:, 0]], [right[:, 0]]
    for b in range(1, bodies):
        L = np.swapaxes(np.linalg.solve(D[-1], np.swapaxes(lower[:, b], 1, 2)), 1, 2)  # lower · D⁻¹, D symmetric
        D.append(diagonal[:, b] - L @ np.swapaxes(lower[:, b], 1, 2))
        y.append(right[:, b] - np.einsum("nij,nj->ni", L, y[-1]))
    x = [np.linalg.solve(D[-1], y[-1][..., None])[..., 0]]
    for b in range(bodies - 2, -1, -1):
        rest = y[b] - np.einsum("nji,nj->ni", lower[:, b + 1], x[0])
        x.insert(0, np.linalg.solve(D[b], rest[..., None])[..., 0])
    return np.stack(x, 1)


def move_posture(posture: Posture, step: np.ndarray) -> Posture:
    """Return the posture after a step (N, B, 6): translation added, rotation applied from the left."""
    return Posture(posture.positions + step[..., :3], compute_rotation(step[..., 3:]) @ posture.rotations)
