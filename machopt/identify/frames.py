"""Rigid fits of measured points, how a tool moved by its targets, wrenches and twists at another point.

Error twists and covariances are linear part first: the twist of the fitted frame, taken at a stated point, in the
axes it is fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.errors import InputError
from machopt.se3 import apply, rotation_vector, skew, transform

Array = NDArray[np.float64]

_LINE = 1e-3  # width over length below which targets are on a line: 0.3 mm of 300 mm, ten times a tracker's noise


@dataclass(frozen=True)
class RigidFit:
    """The rigid transform that brings points a onto points b."""

    T_b_a: Array  # (..., 4, 4)
    residuals: Array  # (..., N, 3) m, b − T_b_a a, in b
    rms: Array  # (...,) m, root of the weighted mean of |residual|²
    sigma: Array  # (...,) m, standard deviation of one coordinate of unit weight, from 3N − 6 degrees of freedom
    covariance: Array  # (..., 6, 6) m², m·rad, rad² of the twist of frame a at its origin, in b axes, with this sigma


@dataclass(frozen=True)
class TargetDisplacement:
    """How a body moved, from targets fixed to it."""

    displacement: Array  # (..., 3) m, of the TCP
    rotation: Array  # (..., 3) rad, rotation vector
    rms: Array  # (...,) m, root mean square distance of the targets from a rigid motion
    covariance: Array  # (..., 6, 6) of displacement and rotation
    sigma: float  # m, standard deviation of one coordinate of one target reading: the given one, or estimated


def rigid_fit(a: Array, b: Array, weights: Array | None = None) -> RigidFit:
    """Rigid transform between two sets of points: argmin over T of Σ w |b − T a|².

    R = V diag(1, 1, det(V Uᵀ)) Uᵀ with U S Vᵀ the singular value decomposition of Σ w (a − ā)(b − b̄)ᵀ: a rotation
    also where noise or planar points would make it a reflection.

    Args:
        a: (..., N, 3) m.
        b: (..., N, 3) m, the same points in another frame; broadcasts against ``a``.
        weights: (..., N) above zero, inverse variances up to a factor; None weighs all alike.

    Returns:
        The transform, what is left and its covariance, batched over the leading dimensions.

    Raises:
        InputError: fewer than three points, points on a line, shapes that differ, a number that is not finite, a
            weight that is not above zero.

    Source:
        Kabsch 1976; Umeyama 1991, eqs. 39–43, without the scale.
    """
    a, b, w = _point_sets(a, b, weights)
    for name, points in (("a", a), ("b", b)):
        refuse_line(points, w, f"points {name}")
    T = fit_transform(a, b, w)
    fitted = apply(T, a)
    residuals = b - fitted
    square = np.einsum("...n,...ni,...ni->...", w, residuals, residuals)
    freedom = 3 * a.shape[-2] - 6
    sigma = np.sqrt(square / freedom)
    covariance = sigma[..., None, None] ** 2 * _twist_cofactor(fitted, w, T[..., :3, 3])
    return RigidFit(T, residuals, np.sqrt(square / w.sum(axis=-1)), sigma, covariance)


def displacement_of_targets(before: Array, after: Array, tcp: Array, sigma: float | None = None) -> TargetDisplacement:
    """Displacement and rotation of the tool under load, from three or more targets fixed to it.

    δT = T(after) T(before)⁻¹, here the rigid fit of the targets after to those before; the TCP moves by
    δp = δT·tcp − tcp and δR is turned into its rotation vector.

    Args:
        before: (..., N, 3) m, targets without load, any fixed frame.
        after: (..., N, 3) m, the same targets under load; broadcasts against ``before``.
        tcp: (..., 3) m, the TCP without load, same frame.
        sigma: m, standard deviation of one coordinate of one target reading; None estimates it from all readings
            together, which takes the tool for rigid.

    Returns:
        Displacement of the TCP, rotation, root mean square misfit and covariance, in the frame of the targets.

    Raises:
        InputError: as :func:`rigid_fit`; ``sigma`` is not above zero.

    Source:
        dumas2011, eqs. 27–30, with the fit over all targets in place of a frame built on three.
    """
    refuse_sigma(sigma)
    fit = rigid_fit(before, after)
    R, p = fit.T_b_a[..., :3, :3], fit.T_b_a[..., :3, 3]
    before, after = np.asarray(before, float), np.asarray(after, float)
    centre = before.mean(axis=-2)
    arm = np.asarray(tcp, float) - centre
    # about the targets' centre: δp is a difference of microns and not of metres
    moved = (R @ centre[..., None])[..., 0] + p - centre
    displacement = moved + ((R - np.eye(3)) @ arm[..., None])[..., 0]
    if sigma is None:
        sigma = float(np.sqrt(np.mean(fit.sigma**2) / 2.0))  # a residual holds the noise of both readings
    weights = np.ones(fit.residuals.shape[:-1])
    at = centre + arm + displacement
    cofactor = _twist_cofactor(after - fit.residuals, weights, at)
    return TargetDisplacement(displacement, rotation_vector(R), fit.rms, 2.0 * sigma**2 * cofactor, sigma)


def transport_wrench(wrench: Array, T_t_s: Array) -> Array:
    """The same wrench in the axes and about the origin of another frame: f_t = R f_s, m_t = R m_s + p × R f_s.

    R and p are the rotation and translation of ``T_t_s``. Power is invariant with :func:`transport_twist`.

    Args:
        wrench: (..., 6) N, N·m, force first, in the axes and about the origin of s.
        T_t_s: (..., 4, 4) pose of s in t.

    Returns:
        (..., 6) in the axes and about the origin of t.

    Source:
        tian2025, eqs. 22–23. zhang2025, eq. 24, turns force and moment and leaves out the lever arm p × R f, so it
        holds only where both frames share their origin; that is :func:`rotate_wrench`.
    """
    turned = rotate_wrench(wrench, T_t_s)
    turned[..., 3:] += np.cross(np.asarray(T_t_s, float)[..., :3, 3], turned[..., :3])
    return turned


def rotate_wrench(wrench: Array, T_t_s: Array) -> Array:
    """A wrench in the axes of another frame about its old reference point: f_t = R f_s, m_t = R m_s.

    Args:
        wrench: (..., 6) N, N·m, force first, in the axes of s.
        T_t_s: (..., 4, 4) pose of s in t; its translation is not used.

    Returns:
        (..., 6) in the axes of t, still about the point it was about before.

    Source:
        zhang2025, eq. 24 (written there with quaternions).
    """
    return _turn_halves(wrench, T_t_s)


def transport_twist(twist: Array, T_t_s: Array) -> Array:
    """The same rigid motion in the axes and at the origin of another frame: ω_t = R ω_s, v_t = R v_s + p × R ω_s.

    Args:
        twist: (..., 6) m/s, rad/s (or a small displacement in m, rad), linear part first: of the point at the
            origin of s, in the axes of s.
        T_t_s: (..., 4, 4) pose of s in t.

    Returns:
        (..., 6) of the point at the origin of t, in the axes of t.

    Source:
        the dual of tian2025, eqs. 21–23.
    """
    turned = _turn_halves(twist, T_t_s)
    turned[..., :3] += np.cross(np.asarray(T_t_s, float)[..., :3, 3], turned[..., 3:])
    return turned


def _turn_halves(six: Array, T: Array) -> Array:
    six, R = np.asarray(six, float), np.asarray(T, float)[..., :3, :3]
    if six.shape[-1:] != (6,):
        raise InputError(f"found an array of shape {six.shape}; expected (..., 6), linear part first")
    halves = [np.einsum("...ij,...j->...i", R, six[..., k : k + 3]) for k in (0, 3)]
    return np.concatenate(halves, axis=-1)


def _point_sets(a: Array, b: Array, weights: Array | None) -> tuple[Array, Array, Array]:
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.ndim < 2 or b.ndim < 2 or a.shape[-1] != 3 or a.shape[-2:] != b.shape[-2:]:
        raise InputError(f"found points of shapes {a.shape} and {b.shape}; expected (..., N, 3), the same N in both")
    if a.shape[-2] < 3:
        raise InputError(f"found {a.shape[-2]} points; a rigid transform needs three or more that are not on a line")
    w = np.ones(a.shape[-2]) if weights is None else np.asarray(weights, float)
    try:
        lead = np.broadcast_shapes(a.shape[:-1], b.shape[:-1], w.shape)
    except ValueError:
        raise InputError(f"shapes {a.shape}, {b.shape} and weights {w.shape} do not broadcast") from None
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("a point holds a number that is not finite; leave out targets that were not seen")
    if not (np.isfinite(w).all() and (w > 0).all()):
        raise InputError("a weight is not above zero; leave the point out instead")
    return np.broadcast_to(a, (*lead, 3)), np.broadcast_to(b, (*lead, 3)), np.broadcast_to(w, lead)


def refuse_line(points: Array, w: Array, what: str) -> None:
    """Refuse points that do not fix a rotation.

    Args:
        points: (..., N, 3) m.
        w: (..., N) weights above zero.
        what: the points in the message, plural.

    Raises:
        InputError: they coincide, or lie on a line within 1/1000 of their spread; names the first such set.
    """
    centred = points - (w[..., None] * points).sum(axis=-2, keepdims=True) / w.sum(axis=-1)[..., None, None]
    s = np.linalg.svd(centred, compute_uv=False)
    flat = s[..., 1] <= _LINE * s[..., 0]
    if flat.any():
        at = np.unravel_index(int(np.argmax(flat)), flat.shape)
        where = f" of set {', '.join(str(k + 1) for k in at)}" if at else ""
        width, length = float(s[at][1]), float(s[at][0])
        raise InputError(
            f"{what}{where} lie on a line (spread {width * 1e3:.3g} mm across {length * 1e3:.3g} mm along), so the "
            f"rotation about it is open; a spread across of more than {_LINE * 100:g} % would do"
            if length > 0
            else f"{what}{where} all coincide; three or more that are not on a line would do"
        )


def refuse_sigma(sigma: float | None) -> None:
    """Refuse a standard deviation in m that is given and not above zero.

    Raises:
        InputError: so it is.
    """
    if sigma is not None and not (np.isfinite(sigma) and sigma > 0):
        raise InputError(f"sigma is {sigma}; expected a standard deviation above zero in m")


def fit_transform(a: Array, b: Array, w: Array) -> Array:
    """The transform of :func:`rigid_fit` alone, without its checks.

    Args:
        a: (..., N, 3) m.
        b: (..., N, 3) m, the same points in another frame.
        w: (..., N) weights above zero.

    Returns:
        T_b_a, (..., 4, 4).
    """
    total = w.sum(axis=-1)[..., None]
    a_mean = (w[..., None] * a).sum(axis=-2) / total
    b_mean = (w[..., None] * b).sum(axis=-2) / total
    H = np.einsum("...n,...ni,...nj->...ij", w, a - a_mean[..., None, :], b - b_mean[..., None, :])
    U, _, Vt = np.linalg.svd(H)
    V, Ut = np.swapaxes(Vt, -1, -2).copy(), np.swapaxes(U, -1, -2)
    V[..., 2] *= np.where(np.linalg.det(V @ Ut) < 0, -1.0, 1.0)[..., None]
    R = V @ Ut
    return transform(R, b_mean - np.einsum("...ij,...j->...i", R, a_mean))


def _twist_cofactor(points: Array, w: Array, at: Array) -> Array:
    """(Σ w JᵀJ)⁻¹ (..., 6, 6), J = [1, −(y − at)×]: covariance of the twist at ``at`` for a sigma of one."""
    total = w.sum(axis=-1)[..., None]
    centre = (w[..., None] * points).sum(axis=-2) / total
    y = points - centre[..., None, :]
    second = np.einsum("...n,...ni,...nj->...ij", w, y, y)
    inertia = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    C = np.zeros((*inertia.shape[:-2], 6, 6))
    C[..., :3, :3] = np.eye(3) / total[..., None]
    C[..., 3:, 3:] = np.linalg.inv(inertia)
    A = np.zeros_like(C)
    A[..., :, :] = np.eye(6)
    A[..., :3, 3:] = -skew(at - centre)  # v(at) = v(centre) + ω × (at − centre)
    return np.asarray(A @ C @ np.swapaxes(A, -1, -2))
