"""Cartesian compliance of an arm whose joints alone are elastic, from its Jacobian (dumas2011 eq. 6)."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def compute_translational_compliance(J: Array, k: Array) -> Array:
    """Return C_tt = J_v K_θ⁻¹ J_vᵀ, (..., 3, 3) m/N.

    Args:
        J: (..., 6, 6) Jacobian at the TCP.
        k: (..., 6) N·m/rad, joint stiffness.
    """
    Jv = J[..., :3, :]
    return (Jv / k[..., None, :]) @ np.swapaxes(Jv, -1, -2)


def compute_directional_compliance(J: Array, k: Array, direction: Array) -> Array:
    """Return eᵀ C_tt e in m/N, without forming C: Σ_i (J_v,i · e)² / k_i.

    Args:
        J: (..., 6, 6) Jacobian at the TCP.
        k: (..., 6) N·m/rad, joint stiffness.
        direction: (..., 3) unit.
    """
    along = np.einsum("...ci,...c->...i", J[..., :3, :], direction)
    return np.asarray(np.sum(along**2 / k, axis=-1))


def compute_deflection(J: Array, k: Array, force: Array) -> Array:
    """Return the displacement (..., 3) in m of the TCP under a force without moment.

    Args:
        J: (..., 6, 6) Jacobian at the TCP.
        k: (..., 6) N·m/rad, joint stiffness.
        force: (..., 3) N, in the axes of J.
    """
    Jv = J[..., :3, :]
    return np.asarray(np.einsum("...ci,...i->...c", Jv, np.einsum("...ci,...c->...i", Jv, force) / k))


def compute_constrained_stiffness(J: Array, k: Array) -> Array:
    """Return K_fd of jiao2022 eq. 13: top-left block of (J K_θ⁻¹ Jᵀ)⁻¹ = J⁻ᵀ K_θ J⁻¹, (..., 3, 3) N/m.

    Invalid at singular configurations (J⁻¹ does not exist).

    Args:
        J: (..., 6, 6) Jacobian at the TCP.
        k: (..., 6) N·m/rad, joint stiffness.
    """
    Ji = np.linalg.inv(J)[..., :3]  # joint motion for a translation with constrained orientation
    return np.swapaxes(Ji, -1, -2) @ (k[..., :, None] * Ji)


def compute_jiao_index(J: Array, k: Array, direction: Array) -> Array:
    """Return k_x, k_y or k_z of jiao2022 eqs. 16–25 along a unit direction, N/m.

    The paper's λ are the eigenvalues of K_fdᵀ K_fd, and k = (Σ e_i²/λ_i²)^(−1/4) in its principal axes,
    which is (eᵀ (K_fdᵀ K_fd)⁻² e)^(−1/4) = |S² e|^(−1/2) with S = K_fd⁻¹.

    Args:
        J: (..., 6, 6) Jacobian at the TCP.
        k: (..., 6) N·m/rad, joint stiffness.
        direction: (..., 3) unit.
    """
    S = np.linalg.inv(compute_constrained_stiffness(J, k))
    s2e = np.einsum("...ij,...jk,...k->...i", S, S, direction)
    return np.asarray(np.linalg.norm(s2e, axis=-1) ** -0.5)
