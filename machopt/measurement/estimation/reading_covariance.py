"""Covariance of a single reading: stated uncertainties propagated to the displacement.

A displacement has its own error. Its equation also contains the recorded load and joint angles, whose errors act
through the arm: V_n = σ_d² I + C(q_n) Σ_w C(q_n)ᵀ + σ_q² D_n D_nᵀ with the compliance C = ∂δ/∂w and D = ∂δ/∂q
(effective variance). C is what is being identified, so this is repeated with the fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.measurements.recording import StandardUncertainty
from machopt.data_types.stiffness import LEAST_STIFFNESS
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.numerics.array_types import Array
from machopt.stiffness.terms import LinearTerm


def compute_reading_covariance(
    experiment: LoadTestExperiment,
    compliance: Array,
    terms: Sequence[LinearTerm],
    stated: StandardUncertainty,
    typical: Array,
) -> Array:
    """Compute the covariance V_n of a single reading, separately for translation and rotation.

    Args:
        experiment: N readings with D coordinates.
        compliance: (n,) current joint compliance, rad/(N·m).
        terms: Terms with their current values.
        stated: Standard uncertainty of each channel; None if not stated.
        typical: (D/3,) error of a coordinate if the uncertainty of displacement or rotation is not stated, m
            and rad.

    Returns:
        (D/3, N, 3, 3) m² and rad².
    """
    channels = experiment.dimensions // 3
    own = (stated.displacement, stated.rotation)
    out = np.empty((channels, len(experiment), 3, 3))
    floor = thresholds.SHARES.rank * np.median(np.abs(experiment.measured.reshape(-1, channels, 3)), axis=(0, 2))
    for c in range(channels):
        sigma = own[c]
        out[c] = max(typical[c] if sigma is None else sigma, floor[c], np.finfo(float).tiny) ** 2 * np.eye(3)
    load = np.repeat([stated.force or 0.0, stated.moment or 0.0], 3)
    if load.any():
        CL = _compute_tcp_compliance(experiment, _clip_compliance(compliance), terms) * load
        for c in range(channels):
            part = CL[:, 3 * c : 3 * c + 3]
            out[c] += part @ np.swapaxes(part, 1, 2)
    if stated.joint:
        D = (
            compute_joint_sensitivity(experiment.state.J, experiment.wrench, _clip_compliance(compliance))
            * stated.joint
        )
        for c in range(channels):
            part = D[:, 3 * c : 3 * c + 3]
            out[c] += part @ np.swapaxes(part, 1, 2)
    return out


def compute_joint_sensitivity(J: Array, wrench: Array, compliance: Array) -> Array:
    """∂δ/∂q (N, 6, n) of δ = Σ_a c_a J_a (J_aᵀ w) for a wrench fixed in base axes at the TCP.

    Column a of J is (v_a, z_a). Turning joint i carries joint a > i along, and moves only the TCP for a < i:
    ∂J_a/∂q_i = (z_i × v_a, z_i × z_a) for i ≤ a, (z_a × v_i, 0) for i > a.

    Args:
        J: (N, 6, n) at the TCP, base_link axes.
        wrench: (N, 6) N, N·m.
        compliance: (n,) rad/(N·m).
    """
    v, z = np.moveaxis(J[:, :3], 2, 0), np.moveaxis(J[:, 3:], 2, 0)  # (n, N, 3)
    tau = np.einsum("nca,nc->na", J, wrench)
    out = np.zeros_like(J)
    joints = J.shape[2]
    for i in range(joints):
        for a in range(joints):
            if compliance[a] == 0:
                continue
            turned = np.zeros((len(J), 6))
            turned[:, :3] = _compute_cross_product(z[min(a, i)], v[max(a, i)])
            if i < a:
                turned[:, 3:] = _compute_cross_product(z[i], z[a])
            torque = np.einsum("nc,nc->n", turned, wrench)
            out[:, :, i] += compliance[a] * (turned * tau[:, a, None] + J[:, :, a] * torque[:, None])
    return out


def _clip_compliance(compliance: Array) -> Array:
    """Limit compliances to a plausible range, so that an unobserved joint does not inflate the noise."""
    return np.asarray(np.clip(compliance, 0.0, 1.0 / LEAST_STIFFNESS))


def _compute_tcp_compliance(experiment: LoadTestExperiment, compliance: Array, terms: Sequence[LinearTerm]) -> Array:
    """C (N, D, 6) = ∂δ/∂w."""
    J = experiment.state.J
    C = (J * compliance) @ np.swapaxes(J, 1, 2)
    for term in terms:
        for column in range(6):
            unit = np.broadcast_to(np.eye(6)[column], (len(J), 6))
            C[:, :, column] += term.compute_response(experiment.state, unit) @ term.values
    return np.asarray(C[:, : experiment.dimensions])


def _compute_cross_product(a: Array, b: Array) -> Array:
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
