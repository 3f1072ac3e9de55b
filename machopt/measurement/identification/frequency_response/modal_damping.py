"""Damping ratios of the arm's modes in the measured poses, for ``modes.damping_percent`` of process.yaml.

(K − ω² M) φ = 0 with φᵀ M φ = 1, and ζ_i = Σ_j η_j s(ω_i) k_j φ_ji²/(2 ω_i²) for small damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.identification.frequency_response.response_fit import ResponseFit
from machopt.measurement.identification.frequency_response.response_model import JOINTS, ResponseModel
from machopt.numerics.array_types import Array, make_arrays_read_only

STEP = 1e-5  # of log k and log η, for the derivative of a ratio


@dataclass(frozen=True, kw_only=True)
class ModalDamping:
    """Modes in ascending frequency over P measured poses."""

    frequency: Array  # (P, 6) Hz
    ratio: Array  # (P, 6) damping ratio
    mean: Array  # (6,) over the poses
    sigma: Array  # (6,) 1 sigma of the mean, by the covariance of the unknowns
    known: int  # number of first modes that are determined and within the measured frequencies

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


def compute_modal_damping(model: ResponseModel, response_fit: ResponseFit, covariance: Array) -> ModalDamping:
    """Return the damping of the modes in the measured poses.

    Args:
        model: Model of all rows.
        response_fit: Fit.
        covariance: (12, 12) of the unknowns.
    """
    e = model.equations
    _, first = np.unique(np.round(e.q, 6), axis=0, return_index=True)
    mass = e.mass[np.sort(first)]
    frequency, ratio = _compute_ratios(model, response_fit.x, mass)
    slopes = np.empty((JOINTS, 2 * JOINTS))
    for n in range(2 * JOINTS):
        step = STEP * (np.arange(2 * JOINTS) == n)
        more, less = (
            _compute_ratios(model, response_fit.x + sign * step, mass)[1].mean(axis=0) for sign in (1.0, -1.0)
        )
        slopes[:, n] = (more - less) / (2.0 * STEP)
    mean = ratio.mean(axis=0)
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
    band = e.omega[[e.omega.argmin(), e.omega.argmax()]] / (2.0 * math.pi)
    outside = (frequency.min(axis=0) < band[0]) | (frequency.max(axis=0) > band[1])
    unknown = (sigma > thresholds.SHARES.max_relative_error * mean) | outside
    known = int(np.argmax(unknown)) if unknown.any() else JOINTS
    return ModalDamping(frequency=frequency, ratio=ratio, mean=mean, sigma=sigma, known=known)


def _compute_ratios(model: ResponseModel, x: Array, mass: Array) -> tuple[Array, Array]:
    """Return frequencies in Hz and damping ratios, (P, 6) each."""
    k, eta = np.exp(x[:JOINTS]), np.exp(x[JOINTS:])
    root = np.linalg.inv(np.linalg.cholesky(mass))  # M = L Lᵀ; φ = L⁻ᵀ v
    squares, vectors = np.linalg.eigh(root @ (k[:, None] * np.swapaxes(root, -1, -2)))
    shapes = np.swapaxes(root, -1, -2) @ vectors
    omega = np.sqrt(squares)
    scale = omega / model.equations.reference if model.law == "viscous" else np.ones_like(omega)
    ratio = scale * np.einsum("j,pji->pi", eta * k, shapes**2) / (2.0 * squares)
    return omega / (2.0 * math.pi), np.asarray(ratio)
