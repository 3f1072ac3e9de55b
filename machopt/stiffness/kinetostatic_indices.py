"""Kinetostatic indices of a posture: dexterity, characteristic length, and the effect of the load on stiffness.

κ_F(J_N) measures how far a posture is from singular once lengths are divided by a characteristic length L
(dumas2011 eqs. 11–12, khan2006). K_C is the change of the joint torques of a constant load with the
deformation of the arm: K_X = J⁻ᵀ (K_θ − K_C) J⁻¹ (dumas2011 eqs. 8–10). All functions accept arrays with leading
dimensions and need no cell; J is the geometric Jacobian at the TCP in base axes, linear part first, as
:meth:`machopt.kinematics.robot.Robot.compute_fk_jacobian` returns it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import cross_product

RANK_TOLERANCE = 1e-12  # a singular value this much smaller than the largest is rounding: the posture is singular
UNAFFECTED_SHARE = 1e-9  # a direction with a smaller share in a lost one is not affected by the singularity


@dataclass(frozen=True)
class CharacteristicLength:
    """Length that makes J_N as well conditioned as the arm can be, with the posture."""

    length: float  # m
    condition: float  # κ_F there, 1 for an isotropic arm
    q: Array  # (6,) rad; joint 1 has no influence and is 0


@dataclass(frozen=True)
class GeometricInfluence:
    """Error of the TCP's displacement under a load if K_C is neglected."""

    nu_p: Array  # (...,) share of the translation, 0 … 1
    nu_r: Array  # (...,) rad, largest change of a rotation about a base axis


def compute_frobenius_condition(J: Array, length: float) -> Array:
    """Return the condition number κ_F of the normalised Jacobian, 1 at best.

    κ_F = (1/6) √(tr(J_Nᵀ J_N) tr((J_Nᵀ J_N)⁻¹)) with J_N = diag(1/L, 1/L, 1/L, 1, 1, 1) J.

    Args:
        J: (..., 6, 6) at the TCP, linear rows in m.
        length: L in m, > 0.

    Returns:
        (...,) ≥ 1; inf where J is singular, NaN where it is not finite.

    Source: dumas2011 eqs. 11 and 12; tian2025 eq. 26.
    """
    J = np.asarray(J, float)
    finite = np.asarray(np.isfinite(J).all(axis=(-2, -1)))
    scaled = np.where(finite[..., None, None], J, np.eye(6)) * _compute_row_scale(length)
    s = np.linalg.svd(scaled, compute_uv=False)
    singular = s[..., -1] <= RANK_TOLERANCE * s[..., 0]
    s = np.where(singular[..., None], 1.0, s)
    kappa = np.sqrt(np.sum(s**2, axis=-1) * np.sum(s**-2, axis=-1)) / 6
    return np.where(finite, np.where(singular, np.inf, kappa), np.nan)


def compute_conditioning_index(J: Array, length: float) -> Array:
    """Return the kinetostatic conditioning index 1/κ_F as a share, (...,) in 0 … 1; 0 where J is singular.

    khan2006 gives it in percent of the same number; zhang2025 (KCI > 0.45) and tian2025 (eq. 25, K_c) as a share.

    Args:
        J: (..., 6, 6) at the TCP, linear rows in m.
        length: L in m, > 0.
    """
    return 1.0 / compute_frobenius_condition(J, length)


def compute_characteristic_length(
    robot: Robot, T_flange_tcp: Array, limits: tuple[Array, Array] | None = None, starts: int = 2048, refined: int = 16
) -> CharacteristicLength:
    """Return the L that minimises κ_F over postures and L together.

    For one posture the best L is closed form: with a, b the squared Frobenius norms of the linear and angular rows
    of J and c, d those of the matching columns of J⁻¹, 36 κ_F² = (a/L² + b)(c L² + d) is least at L⁴ = a d/(b c),
    where 6 κ_F = √(ac) + √(bd). That is minimised over joints 2 to 6 with its analytic gradient (∂J⁻¹ = −J⁻¹ ∂J J⁻¹)
    from the best of a Halton sequence, so the result is deterministic.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4), TCP relative to the flange.
        limits: lower and upper joint limits (6,) in rad; None for full turns, as in the source.
        starts: postures of the Halton sequence.
        refined: number of the best of them that are minimised.

    Returns:
        The length, κ_F and posture of the least found. L depends on the TCP: a longer tool has another.

    Source: dumas2011 section 3.1 after khan2006 (its reference 28).
    """
    from scipy.optimize import minimize
    from scipy.stats import qmc

    lower, upper = (np.full(6, -np.pi), np.full(6, np.pi)) if limits is None else limits
    unit = qmc.Halton(d=5, scramble=False).random(starts)
    q = np.zeros((starts, 6))
    q[:, 1:] = lower[1:] + unit * (upper[1:] - lower[1:])
    order = np.argsort(_compute_best_condition(robot.compute_fk_jacobian(q, T_flange_tcp)[1])[0])

    def cost(x: Array) -> tuple[float, Array]:
        value, gradient, _ = _compute_best_condition(robot.compute_fk_jacobian(np.r_[0.0, x], T_flange_tcp)[1])
        return float(value), gradient[1:]

    bounds = None if limits is None else list(zip(lower[1:], upper[1:], strict=True))
    fits = [
        minimize(cost, q[i, 1:], jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-14, "gtol": 1e-9})
        for i in order[:refined]
    ]
    best = np.r_[0.0, min(fits, key=lambda fit: float(fit.fun)).x]
    value, _, length = _compute_best_condition(robot.compute_fk_jacobian(best, T_flange_tcp)[1])
    return CharacteristicLength(float(length), float(value), best)


def compute_jacobian_derivative(J: Array) -> Array:
    """∂J/∂θ_k from J alone.

    With columns (v_i, z_i): ∂z_i/∂θ_k = z_k × z_i for k < i, else 0; ∂v_i/∂θ_k = z_k × v_i for k ≤ i, else z_i × v_k.

    Args:
        J: (..., 6, 6) at the TCP in base axes.

    Returns:
        (..., 6, 6, 6), entry [..., k, :, :] = ∂J/∂θ_k, m/rad and 1/rad.
    """
    v, z = np.swapaxes(J[..., :3, :], -1, -2), np.swapaxes(J[..., 3:, :], -1, -2)
    k, i = np.indices((J.shape[-1], J.shape[-1]))
    lin = cross_product(z[..., :, None, :], v[..., None, :, :])  # [..., k, i, :]
    lin = np.where((k <= i)[..., None], lin, np.swapaxes(lin, -2, -3))
    ang = np.where((k < i)[..., None], cross_product(z[..., :, None, :], z[..., None, :, :]), 0.0)
    return np.swapaxes(np.concatenate([lin, ang], axis=-1), -1, -2)


def compute_geometric_stiffness(J: Array, wrench: Array) -> Array:
    """Complementary stiffness K_C = [∂Jᵀ/∂θ_1 w … ∂Jᵀ/∂θ_6 w] of a load that keeps its components in base axes.

    Args:
        J: (..., 6, 6) at the TCP.
        wrench: (..., 6) N and N·m acting on the arm, moment about the TCP, in base axes; it moves with the TCP
            and does not turn.

    Returns:
        (..., 6, 6) N·m/rad, entry [i, k] = ∂(Jᵀw)_i/∂θ_k.

    The force's part is symmetric. The moment's is not: [i, k] − [k, i] = (z_k × z_i)·m for k < i, because a moment
    about fixed axes is not conservative (its work depends on the way). Invalid for a load that turns with the tool.

    Source: dumas2011 eq. 9.
    """
    J, wrench = np.asarray(J, float), np.asarray(wrench, float)
    v, z = np.swapaxes(J[..., :3, :], -1, -2), np.swapaxes(J[..., 3:, :], -1, -2)
    force, moment = wrench[..., None, :3], wrench[..., None, 3:]
    by_force = cross_product(force, z) @ np.swapaxes(v, -1, -2)  # [..., a, b] = f·(z_a × v_b), valid for a ≤ b
    by_moment = cross_product(moment, z) @ np.swapaxes(z, -1, -2)  # [..., k, i] = m·(z_k × z_i), valid for k < i
    upper = np.triu(np.ones(by_force.shape[-2:], bool))
    out = np.where(upper, by_force, np.swapaxes(by_force, -1, -2))
    return np.asarray(out + np.where(np.triu(upper, 1).T, np.swapaxes(by_moment, -1, -2), 0.0))


def compute_loaded_compliance(J: Array, k: Array, K_C: Array) -> Array:
    """Compliance of the loaded arm, J (K_θ − K_C)⁻¹ Jᵀ; no inverse of J is needed.

    Args:
        J: (..., 6, 6) at the TCP.
        k: (..., 6) joint stiffness, N·m/rad.
        K_C: (..., 6, 6) N·m/rad of :func:`compute_geometric_stiffness`; zeros give the unloaded compliance.

    Returns:
        (..., 6, 6), m and rad per N and N·m. NaN where K_θ − K_C is not positive definite: the springs do not hold
        that load.

    Source: dumas2011 eq. 10, inverted.
    """
    own = np.eye(K_C.shape[-1])
    K = np.asarray(k, float)[..., None] * own - K_C
    holds = np.linalg.eigvalsh(0.5 * (K + np.swapaxes(K, -1, -2)))[..., 0] > 0.0
    K = np.where(holds[..., None, None], K, own)
    return np.where(holds[..., None, None], J @ np.linalg.solve(K, np.swapaxes(J, -1, -2)), np.nan)


def compute_geometric_influence(J: Array, k: Array, K_C: Array, wrench: Array) -> GeometricInfluence:
    """Return ν_p and ν_r: comparison of the TCP's displacement under a wrench with and without K_C.

    ν_p = | |δp| − |δp₀| | / max(|δp|, |δp₀|); ν_r = max over x, y, z of |δr − δr₀|.

    Args:
        J: (..., 6, 6) as for :func:`compute_loaded_compliance`.
        k: (..., 6) N·m/rad.
        K_C: (..., 6, 6) N·m/rad.
        wrench: (..., 6) N and N·m at the TCP in base axes, the one of K_C.

    Returns:
        Shares and rad; 0 where nothing moves, NaN where the springs cannot support the load.

    Source: dumas2011 eqs. 14 and 15 (which gives ν_r in degrees).
    """
    wrench = np.asarray(wrench, float)
    loaded = np.einsum("...ij,...j->...i", compute_loaded_compliance(J, k, K_C), wrench)
    plain = np.einsum("...ij,...j->...i", compute_loaded_compliance(J, k, np.zeros_like(K_C)), wrench)
    p, p0 = np.linalg.norm(loaded[..., :3], axis=-1), np.linalg.norm(plain[..., :3], axis=-1)
    larger = np.maximum(p, p0)
    nu_p = np.abs(p - p0) / np.where(larger == 0.0, 1.0, larger)
    return GeometricInfluence(nu_p, np.abs(loaded[..., 3:] - plain[..., 3:]).max(axis=-1))


def compute_directional_stiffness(
    J: Array, k: Array, direction: Array, constrained: Literal["nothing", "position", "pose"]
) -> Array:
    """Return the stiffness along a direction, with different constraints of the other motions.

    ``nothing``: 1/(eᵀ C e), free motion under a force along e. ``position``: eᵀ C_tt⁻¹ e, the tip constrained to the
    line.
    ``pose``: eᵀ (J⁻ᵀ K_θ J⁻¹)_tt e, the diagonal entry of K_m, tip on the line and no tool rotation.
    Each constrains more than the previous one and is never less.

    Args:
        J: (..., 6, 6) at the TCP.
        k: (..., 6) N·m/rad.
        direction: (..., 3) unit, base axes.
        constrained: constrained motions.

    Returns:
        (...,) N/m; inf where a singularity blocks that motion (for ``pose`` this is a property of the
        definition: a cutter only experiences ``nothing``).

    Source: tian2025 eqs. 9 and 11 (either may be meant in its sections 4.2–4.4); dumas2011 eq. 13.
    """
    e = np.asarray(direction, float)
    rows = J if constrained == "pose" else J[..., :3, :]
    spring = rows / np.sqrt(np.asarray(k, float))[..., None, :]
    if constrained == "nothing":
        compliance = np.sum(np.einsum("...ci,...c->...i", spring, e) ** 2, axis=-1)
        gives = compliance > 0.0
        return np.where(gives, 1.0 / np.where(gives, compliance, 1.0), np.inf)
    if constrained == "pose":
        e = np.concatenate([e, np.zeros_like(e)], axis=-1)
    U, s, _ = np.linalg.svd(spring, full_matrices=False)  # C = U s² Uᵀ
    share = np.einsum("...cj,...c->...j", U, e) ** 2
    lost = s <= RANK_TOLERANCE * s[..., :1]
    blocked = np.any(lost & (share > UNAFFECTED_SHARE**2), axis=-1)
    value = np.sum(np.where(lost, 0.0, share / np.where(lost, 1.0, s) ** 2), axis=-1)
    return np.where(blocked, np.inf, value)


def _compute_row_scale(length: float) -> Array:
    return np.array([1 / length] * 3 + [1.0] * 3)[:, None]


def _compute_best_condition(J: Array) -> tuple[Array, Array, Array]:
    """κ_F at the posture's own best L, its gradient (..., 6) over the joints, and that L; huge and flat if singular."""
    s = np.linalg.svd(J, compute_uv=False)
    regular = s[..., -1] > RANK_TOLERANCE * s[..., 0]
    Ji = np.linalg.inv(np.where(regular[..., None, None], J, np.eye(6)))
    a, b, c, d = (np.sum(M**2, axis=(-2, -1)) for M in (J[..., :3, :], J[..., 3:, :], Ji[..., :3], Ji[..., 3:]))
    value = (np.sqrt(a * c) + np.sqrt(b * d)) / 6
    dJ = compute_jacobian_derivative(J)
    dJi = -Ji[..., None, :, :] @ dJ @ Ji[..., None, :, :]

    def slope(M: Array, dM: Array) -> Array:
        return np.asarray(2 * np.einsum("...ij,...kij->...k", M, dM))

    da, dc = slope(J[..., :3, :], dJ[..., :3, :]), slope(Ji[..., :3], dJi[..., :3])
    dd = slope(Ji[..., 3:], dJi[..., 3:])  # b, the six unit axes, is always 6
    root_ac, root_bd = np.sqrt(a * c)[..., None], np.sqrt(b * d)[..., None]
    gradient = ((da * c[..., None] + a[..., None] * dc) / root_ac + b[..., None] * dd / root_bd) / 12
    value = np.where(regular, value, 1e9)
    return value, np.where(regular[..., None], gradient, 0.0), (a * d / (b * c)) ** 0.25
