"""Stiffness of the arm at the tool tip from joint stiffness.

Real compliance at the tip, rotation of the tool free: C = J K_θ⁻¹ Jᵀ (jiao2022 eq. 1; dumas2011 eq. 5).
Its 3×3 translation block C_tt gives the deflection d = C_tt f under a force without moment, and the
directional stiffness 1/(eᵀ C_tt e).

jiao2022 (eqs. 13–25) uses K_fd, the top-left block of C⁻¹ instead: the stiffness with the tool's
orientation *held*. Holding it needs a moment that nobody applies, and because a shift of the TCP along a rigid
tool leaves force and translation unchanged while rotation is zero, K_fd does not depend on the tool's length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.stiffness import Stiffness
from machopt.model.robot import Robot

Array = NDArray[np.float64]
FACE_TOLERANCE = 1e-6  # m; a TCP this near a face, edge or corner of the grid belongs to all its cells


@dataclass(frozen=True)
class JointStiffness:
    """Joint stiffness at given TCP positions."""

    k: Array  # (..., 6) N·m/rad
    in_grid: NDArray[np.bool_]  # (...,) False: outside the identified grid, constant values used


def joint_stiffness(stiffness: Stiffness, position: Array) -> JointStiffness:
    """K_θ(j) of jiao2022 section 2.3: the cell's values, averaged on shared faces, edges and corners.

    Args:
        position: (..., 3) TCP position in base_link, m.
    """
    position = np.asarray(position, float)
    lead = position.shape[:-1]
    grid = stiffness.grid
    if grid is None:
        return JointStiffness(np.broadcast_to(stiffness.joints, (*lead, 6)), np.ones(lead, bool))
    shape = np.array(grid.shape)
    x = ((position - grid.origin) / grid.cell).reshape(-1, 3)
    eps = FACE_TOLERANCE / grid.cell
    low = np.floor(x - eps).astype(int)  # the cells touched along each axis: low … high (one or two)
    high = np.floor(x + eps).astype(int)
    total, count = np.zeros((len(x), 6)), np.zeros(len(x))
    for corner in np.ndindex(2, 2, 2):
        pick = np.where(np.array(corner) == 1, high, low)
        new = np.all((np.array(corner) == 0) | (high != low), axis=1)  # do not count a cell twice
        inside = new & np.all((pick >= 0) & (pick < shape), axis=1)
        index = pick[inside, 0] + shape[0] * (pick[inside, 1] + shape[1] * pick[inside, 2])
        total[inside] += grid.joints[index]
        count[inside] += 1
    found = count > 0
    k = np.where(found[:, None], total / np.maximum(count, 1)[:, None], stiffness.joints)
    return JointStiffness(k.reshape(*lead, 6), found.reshape(lead))


def translational_compliance(J: Array, k: Array) -> Array:
    """C_tt = J_v K_θ⁻¹ J_vᵀ, (..., 3, 3) m/N, from the Jacobian (..., 6, 6) at the TCP and k (..., 6) N·m/rad."""
    Jv = J[..., :3, :]
    return (Jv / k[..., None, :]) @ np.swapaxes(Jv, -1, -2)


def directional_compliance(J: Array, k: Array, direction: Array) -> Array:
    """eᵀ C_tt e in m/N for unit directions (..., 3), without forming C: Σ_i (J_v,i · e)² / k_i."""
    along = np.einsum("...ci,...c->...i", J[..., :3, :], direction)
    return np.asarray(np.sum(along**2 / k, axis=-1))


def deflection(J: Array, k: Array, force: Array) -> Array:
    """Displacement (..., 3) m of the TCP under a force (..., 3) N without moment."""
    Jv = J[..., :3, :]
    return np.asarray(np.einsum("...ci,...i->...c", Jv, np.einsum("...ci,...c->...i", Jv, force) / k))


def held_stiffness(J: Array, k: Array) -> Array:
    """K_fd of jiao2022 eq. 13: top-left block of (J K_θ⁻¹ Jᵀ)⁻¹ = J⁻ᵀ K_θ J⁻¹, (..., 3, 3) N/m.

    Invalid at singular configurations (J⁻¹ does not exist).
    """
    Ji = np.linalg.inv(J)[..., :3]  # joint motion for a translation with the orientation held
    return np.swapaxes(Ji, -1, -2) @ (k[..., :, None] * Ji)


def jiao_index(J: Array, k: Array, direction: Array) -> Array:
    """k_x, k_y or k_z of jiao2022 eqs. 16–25 along a unit direction (..., 3), N/m.

    The paper's λ are the eigenvalues of K_fdᵀ K_fd, and k = (Σ e_i²/λ_i²)^(−1/4) in its principal axes,
    which is (eᵀ (K_fdᵀ K_fd)⁻² e)^(−1/4) = |S² e|^(−1/2) with S = K_fd⁻¹.
    """
    S = np.linalg.inv(held_stiffness(J, k))
    s2e = np.einsum("...ij,...jk,...k->...i", S, S, direction)
    return np.asarray(np.linalg.norm(s2e, axis=-1) ** -0.5)


def jiao_normal_index(k_y: Array, k_z: Array, theta: Array) -> Array:
    """k_ν of jiao2022 eq. 43: stiffness normal to the path in the plane normal to the tool axis."""
    return np.hypot(k_z * np.cos(theta), k_y * np.sin(theta))


class ArmElasticity:
    """The arm with its tool and stiffness: everything elastic at a set of configurations."""

    def __init__(self, robot: Robot, T_flange_tcp: Array, stiffness: Stiffness) -> None:
        self.robot, self.T_flange_tcp, self.stiffness = robot, T_flange_tcp, stiffness

    def jacobian(self, q: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Jacobian at the TCP (..., 6, 6) in base_link axes, k (..., 6) there, and whether the grid covers it."""
        T, J = self.robot.fk_jacobian(q, self.T_flange_tcp)
        joint = joint_stiffness(self.stiffness, T[..., :3, 3])
        return J, joint.k, joint.in_grid
