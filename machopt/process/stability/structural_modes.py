"""Modes of arm and tool at the tip: natural frequency, damping, mass-normalised shape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array, make_arrays_read_only


@dataclass(frozen=True)
class StructuralModes:
    """n modes at P points, in ascending frequency.

    A force F at the tip moves it by Σ u (uᵀ F) / (ω² − w² + 2 i ζ ω w) at the frequency w.
    """

    omega: Array  # (P, n) rad/s, undamped natural frequency; 0: no mode
    zeta: Array  # (P, n) damping ratio; NaN: unknown
    shape: Array  # (P, n, 3) 1/√kg, displacement of the tip: travel, normal, axial

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    @property
    def frequency(self) -> Array:
        """Natural frequencies, (P, n) Hz."""
        return self.omega / (2.0 * math.pi)

    @property
    def stiffness(self) -> Array:
        """Modal stiffness at the tip along each mode's direction, ω² / |u|², (P, n) N/m; inf where the tip rests."""
        size = np.sum(self.shape**2, axis=-1)
        return np.where(size > 0.0, self.omega**2 / np.where(size > 0.0, size, 1.0), np.inf)


def compute_arm_modes(
    mass_matrix: Array, compliance: Array, jacobian: Array, damping: Sequence[float] | float = ()
) -> StructuralModes:
    """Return the modes of an arm with elastic joints and locked rotors: (C⁻¹ − ω² M) φ = 0, u = J φ.

    Args:
        mass_matrix: (P, n, n) kg·m², joint space, without the rotors.
        compliance: (n,), (P, n) or (P, n, n) rad/(N·m), of the joints; positive definite.
        jacobian: (P, 3, n) m/rad, displacement of the tip in travel, normal, axial.
        damping: damping ratio of all modes, or of the modes in ascending frequency; those beyond it are unknown.

    Raises:
        CuttingInputError: a mass matrix or compliance that is not positive definite, or impossible damping.
    """
    M, J = np.asarray(mass_matrix, float), np.asarray(jacobian, float)
    count, n = M.shape[:2]
    C = np.asarray(compliance, float)
    scaled, moved = _scale_by_springs(M, J, C, count, n) if C.ndim < 3 else _scale_by_root(M, J, C)
    values, vectors = np.linalg.eigh(scaled)
    values, vectors = values[:, ::-1], vectors[:, :, ::-1]
    if not (values > 0.0).all():
        raise CuttingInputError("the mass matrix is not positive definite: modes need masses and inertias", key="modes")
    omega = np.ascontiguousarray(1.0 / np.sqrt(values))
    shape = np.swapaxes(moved @ vectors * omega[:, None, :], -1, -2)
    return StructuralModes(omega, np.broadcast_to(_list_damping(damping, n), omega.shape).copy(), shape)


def build_tool_modes(
    frequency: Sequence[float], damping: Sequence[float], stiffness: Sequence[float], direction: Array, points: int = 1
) -> StructuralModes:
    """Return the modes of a spindle or cutter at its tip.

    Args:
        frequency: Hz, undamped.
        damping: damping ratios; NaN: unknown.
        stiffness: N/m, modal stiffness at the tip.
        direction: (n, 3) in travel, normal, axial, or (P, n, 3) where it changes along the path; any length.
        points: P, where the direction is the same at all points.

    Raises:
        CuttingInputError: a value that is not positive, or a direction of zero length.
    """
    f, k, zeta = (np.asarray(x, float) for x in (frequency, stiffness, damping))
    if not ((f > 0.0).all() and (k > 0.0).all()):
        raise CuttingInputError("frequency and stiffness of a mode must be larger than 0", key="modes")
    along = np.asarray(direction, float)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    if not (length > 0.0).all():
        raise CuttingInputError("the direction of a mode has zero length", key="modes")
    omega = 2.0 * math.pi * f
    shape = along / length * (omega / np.sqrt(k))[:, None]
    if shape.ndim == 2:
        shape = np.broadcast_to(shape, (points, *shape.shape))
    order = np.argsort(omega, kind="stable")
    checked = _list_damping(list(zeta), len(zeta))
    rows = (len(shape), len(omega))
    return StructuralModes(
        np.broadcast_to(omega[order], rows).copy(), np.broadcast_to(checked[order], rows).copy(), shape[:, order].copy()
    )


def merge_modes(one: StructuralModes, other: StructuralModes) -> StructuralModes:
    """Return the modes of both at the same points, in ascending frequency.

    Args:
        one: of the arm.
        other: of the tool.
    """
    omega = np.concatenate([one.omega, other.omega], axis=1)
    order = np.argsort(omega, axis=1, kind="stable")
    zeta, shape = (
        np.concatenate([one.zeta, other.zeta], axis=1),
        np.concatenate([one.shape, other.shape], axis=1),
    )
    return StructuralModes(
        np.take_along_axis(omega, order, axis=1),
        np.take_along_axis(zeta, order, axis=1),
        np.take_along_axis(shape, order[..., None], axis=1),
    )


def _scale_by_springs(M: Array, J: Array, compliance: Array, count: int, n: int) -> tuple[Array, Array]:
    """Return Lᵀ M L (P, n, n) and J L (P, 3, n) for springs of the joints alone, L Lᵀ = C."""
    if not (compliance > 0.0).all():
        raise CuttingInputError("a joint compliance is not larger than 0", key="stiffness")
    root = np.broadcast_to(np.sqrt(compliance), (count, n))
    return root[:, :, None] * M * root[:, None, :], J * root[:, None, :]


def _scale_by_root(M: Array, J: Array, compliance: Array) -> tuple[Array, Array]:
    """Return Lᵀ M L (P, n, n) and J L (P, 3, n), L Lᵀ = C."""
    try:
        root = np.linalg.cholesky(compliance)
    except np.linalg.LinAlgError as problem:
        raise CuttingInputError("the joint compliance is not positive definite", key="stiffness") from problem
    return np.swapaxes(root, -1, -2) @ M @ root, J @ root


def _list_damping(damping: Sequence[float] | float, n: int) -> Array:
    """Return the damping ratio of each mode, (n,); NaN where it is unknown."""
    values = np.full(n, np.nan)
    if isinstance(damping, Sequence):
        values[: min(len(damping), n)] = list(damping)[:n]
    else:
        values[:] = damping
    if not ((values > 0.0) & (values < 1.0) | np.isnan(values)).all():
        raise CuttingInputError("a damping ratio must be larger than 0 and smaller than 1", key="damping_percent")
    return values
