"""Stiffness, deflection and their uncertainty recomputed: C = J A Jᵀ + what bodies give, J by pinocchio.

A is the compliance of the joints, 1/k on its diagonal plus the terms of the stiffness file (:mod:`spring_terms`); k is
that
of the grid cell that the programmed TCP position lies in (the mean of all cells it touches, the constant model
outside). With ``geometric_stiffness`` the springs are those of the loaded arm: (K − K_C) δ = Jᵀf.

Columns of points.csv, e the tool axis, n = e × travel, f the process force (``travel`` along the direction of travel,
``normal`` along n, ``axial`` along e):

==================  =============================================================================================
k_axial, k_normal   1/(eᵀ C_tt e) and 1/(nᵀ C_tt n), for a small load: tangents under weight, without K_C
deflection          |d| of the TCP under f without moment, laws and K_C at that load; empty without a force
k_jiao_x            |S² e|^(−1/2), S the inverse of the top-left block of C⁻¹
stiffness_from      whether a cell of the grid holds the place
k_axial_std         √(gᵀ Σ g) k_axial², g_i = (J_i·e)² (k_gear/k)²; Σ of the file, of a cell 1σ of each joint
deflection_std      √(gᵀ Σ g), g_i the derivative of d·d/|d| by the compliance of joint i
==================  =============================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness, StiffnessGrid
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.arm_configuration import ArmConfiguration
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.stiffness import spring_terms
from machopt.verification.motion.stiffness.external_joints import compute_external_compliance, compute_uncertain_twists
from machopt.verification.motion.stiffness.model_discrepancy import DiscrepancyState, StatedDiscrepancy

MIN_COMPLIANCE_SHARE = 0.1  # of a compliance, whatever the file says it lacks
GRID_FACE_TOLERANCE_M = 1e-6  # m; a point this near a face of the stiffness grid belongs to the cells on both sides


@dataclass(frozen=True, kw_only=True)
class ComplianceState:
    """Compliance at N configurations, base_link axes."""

    J: Array  # (N, 6, 6) at the TCP
    gear: Array  # (N, 6) N·m/rad
    k: Array  # (N, 6) N·m/rad, with the balancer in parallel to the gear of joint 2
    linear: Array  # (N, 6, 6) rad/(N·m) of terms in the joints
    curves: tuple[spring_terms.TorqueCurve, ...]
    weight: Array  # (N, 6) N·m
    bodies: Array  # (N, 6, 6) compliance of base, links, tool and external joints at the TCP
    geometric: bool
    cell_sensitivities: tuple[
        tuple[NDArray[np.int64], Array], ...
    ]  # of each row: cells of the grid, ∂c/∂c_cell (cells, 6)
    discrepancy: DiscrepancyState | None = None  # what the file says it lacks
    unsure: Array | None = (
        None  # (N, K, 3) :func:`machopt.verification.motion.stiffness.external_joints.compute_uncertain_twists`
    )

    @cached_property
    def small_load_compliance(self) -> Array:
        """(N, 6, 6) compliance at the TCP for a small load."""
        return (
            self._stated_compliance
            if self.discrepancy is None
            else np.asarray(self._stated_compliance + self.discrepancy.small_load_compliance)
        )

    @cached_property
    def _stated_compliance(self) -> Array:
        """The same of the file's own numbers."""
        A = self.linear + (1.0 / self.k)[:, :, None] * np.eye(6)
        for curve in self.curves:
            weight = self.weight[:, curve.joint] * curve.feels_weight
            A[:, curve.joint, curve.joint] += curve.compute_slope(weight)
        return np.asarray(self.J @ A @ np.swapaxes(self.J, 1, 2) + self.bodies)

    def compute_stiffness_along(self, e: Array) -> Array:
        """Return the (N,) stiffness along unit vectors, N/m; infinite where a vector is zero.

        Args:
            e: (N, 3) unit direction vectors, base_link axes.
        """
        whole, stated = (
            np.einsum("ni,nij,nj->n", e, C[:, :3, :3], e) for C in (self.small_load_compliance, self._stated_compliance)
        )
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.maximum(whole, MIN_COMPLIANCE_SHARE * stated))

    def compute_jiao_stiffness(self, e: Array) -> Array:
        """Return the (N,) stiffness k_x of jiao2022 along unit vectors, N/m.

        Args:
            e: (N, 3) unit direction vectors, base_link axes.
        """
        S = np.linalg.inv(np.linalg.inv(self.small_load_compliance)[:, :3, :3])
        return np.asarray(1.0 / np.sqrt(np.linalg.norm(np.einsum("nij,njk,nk->ni", S, S, e), axis=1)))

    def compute_displacement(self, force: Array) -> Array:
        """Return the (N, 3) displacement of the TCP, m.

        Args:
            force: (N, 3) forces, N, base_link axes.
        """
        tau = np.einsum("nci,nc->ni", self.J[:, :3], force)
        turn = np.einsum("nij,nj->ni", self.linear, tau)
        turn += np.linalg.solve(self._compute_loaded_stiffness(force), tau[..., None])[..., 0]
        for curve in self.curves:
            before = self.weight[:, curve.joint] * curve.feels_weight
            turn[:, curve.joint] += curve.compute_rotation(before + tau[:, curve.joint]) - curve.compute_rotation(
                before
            )
        given = np.einsum("nij,nj->ni", self.bodies[:, :3, :3], force)
        moved = np.einsum("nci,ni->nc", self.J[:, :3], turn) + given
        return np.asarray(moved if self.discrepancy is None else moved + self.discrepancy.compute_mean_shift(force))

    def compute_external_joint_std(self, e: Array, force: Array) -> Array:
        """Return the (N,) standard uncertainty along e from the external joints' stiffness, m.

        Args:
            e: (N, 3) unit direction vectors, base_link axes.
            force: (N, 3) forces, N, base_link axes.
        """
        if self.unsure is None:
            return np.zeros(len(e))
        on_e, on_force = (np.einsum("nkc,nc->nk", self.unsure, v) for v in (e, force))
        return np.asarray(np.linalg.norm(on_e * on_force, axis=1))

    def compute_axial_gradient(self, e: Array) -> Array:
        """Return the (N, 6) derivative of eᵀ C e with respect to each gear's compliance.

        Args:
            e: (N, 3) unit direction vectors, base_link axes.
        """
        return np.asarray(np.einsum("nci,nc->ni", self.J[:, :3], e) ** 2 * (self.gear / self.k) ** 2)

    def compute_deflection_gradient(self, force: Array) -> Array:
        """Return the (N, 6) derivative of |d| with respect to each gear's compliance.

        Args:
            force: (N, 3) forces, N, base_link axes.
        """
        d = self.compute_displacement(force)
        e = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), np.finfo(float).tiny)
        along, tau = (np.einsum("nci,nc->ni", self.J[:, :3], v) for v in (e, force))
        K = self._compute_loaded_stiffness(force)
        bent = np.linalg.solve(K, tau[..., None])[..., 0]
        back = np.linalg.solve(np.swapaxes(K, 1, 2), along[..., None])[..., 0]
        return np.asarray(bent * back * self.k**2 * (self.gear / self.k) ** 2)

    def _compute_loaded_stiffness(self, force: Array) -> Array:
        """(N, 6, 6) K − K_C; K_C the change of Jᵀf with the joints, f·(z_l × (z_h × (p − o_h))), l ≤ h."""
        K = self.k[:, :, None] * np.eye(6)
        if not self.geometric:
            return np.asarray(K)
        z, moved = np.swapaxes(self.J[:, 3:], 1, 2), np.swapaxes(self.J[:, :3], 1, 2)
        low, high = np.minimum.outer(range(6), range(6)), np.maximum.outer(range(6), range(6))
        return np.asarray(K - np.einsum("nijc,nc->nij", np.cross(z[:, low], moved[:, high]), force))


class ComplianceModel:
    """Compliance model of a cell.

    Raises:
        UnknownTermError: The stiffness file has a term without a law here.
    """

    def __init__(self, cell: Cell, arm: UrdfKinematics, stiffness: ArmStiffness) -> None:
        self.cell, self.arm, self.stiffness = cell, arm, stiffness
        unknown = [f"{t.effect} at {t.location}" for t in stiffness.terms if t.effect not in spring_terms.KNOWN_EFFECTS]
        if unknown:
            raise spring_terms.UnknownTermError(", ".join(unknown))
        every = stiffness.joints[None]
        if stiffness.grid is not None:
            every = np.vstack([every, stiffness.grid.joints])
        self._curves = tuple(
            spring_terms.build_torque_curves(stiffness.terms, every, cell.limits.lower[:6], cell.limits.upper[:6])
        )
        zero = arm.compute_configuration(np.zeros((1, 6)), np.zeros((1, len(cell.external_joints))))
        self._zero = zero.frames[0]
        found = stiffness.discrepancy
        T = cell.tool.T_flange_tcp
        self._lack = None if found is None else StatedDiscrepancy(found, stiffness.terms, arm, zero, T, self._curves)
        self._springs = spring_terms.build_body_springs(
            stiffness.terms, zero.origin[0], zero.flange[0], cell.tool.T_flange_tcp
        )

    def evaluate(self, stance: ArmConfiguration, position: Array) -> ComplianceState:
        """Return the compliance at N configurations.

        Args:
            stance: The arm at N configurations, base_link axes.
            position: (N, 3) programmed positions of the TCP in base_link, m.
        """
        gear, holds = self.compute_joint_stiffness(position)
        k = gear.copy()
        k[:, 1] += spring_terms.compute_balancer_stiffness(self.stiffness.terms, stance.q[:, 1])
        weighs = self._lack is not None or any(c.feels_weight for c in self._curves)
        weight = self.arm.compute_gravity_torque(stance.q, stance.external) if weighs else np.zeros((len(gear), 6))
        bodies = np.zeros((len(gear), 6, 6))
        for body, S, C in self._springs:
            now = stance.frames[:, body] @ np.linalg.inv(self._zero[body]) @ S
            bodies += spring_terms.shift_compliance(
                spring_terms.rotate_compliance(C, now[:, :3, :3]), stance.tcp[:, :3, 3] - now[:, :3, 3]
            )
        bodies += compute_external_compliance(self.arm, stance, self.stiffness.external, position)
        return ComplianceState(
            J=stance.J,
            gear=gear,
            k=k,
            linear=spring_terms.compute_joint_compliance(self.stiffness.terms, stance.q),
            curves=self._curves,
            weight=weight,
            bodies=bodies,
            geometric=any(t.effect == "geometric_stiffness" for t in self.stiffness.terms),
            cell_sensitivities=holds,
            discrepancy=None if self._lack is None else self._lack.evaluate(stance, gear, weight),
            unsure=compute_uncertain_twists(self.arm, stance, self.stiffness.external, position),
        )

    def compute_joint_stiffness(self, position: Array) -> tuple[Array, tuple[tuple[NDArray[np.int64], Array], ...]]:
        """Return the (N, 6) joint stiffness, N·m/rad, and the grid cells it is averaged from.

        Args:
            position: (N, 3) positions of the TCP in base_link, m.
        """
        grid = self.stiffness.grid
        k = np.tile(self.stiffness.joints, (len(position), 1))
        holds: list[tuple[NDArray[np.int64], Array]] = []
        for n, cells in enumerate([] if grid is None else find_grid_cells(grid, position)):
            if grid is not None and len(cells):
                k[n] = grid.joints[cells].mean(axis=0)
                # c = n/Σ k_cell, so ∂c/∂c_cell = (k_cell/k)²/n
                holds.append((cells, (grid.joints[cells] / k[n]) ** 2 / len(cells)))
            else:
                holds.append((cells, np.empty((0, 6))))
        return k, tuple(holds) or tuple((np.empty(0, np.int64), np.empty((0, 6))) for _ in position)

    def compute_std(self, softness: ComplianceState, gradient: Array) -> Array:
        """Return the (N,) standard uncertainty √(gᵀ Σ g); NaN where the file gives none.

        Args:
            softness: The compliance at N configurations.
            gradient: (N, 6) derivative with respect to each gear's compliance.
        """
        grid, out = self.stiffness.grid, np.full(len(gradient), np.nan)
        if self._lack is not None:  # it says of the constant model's springs all that there is to say
            out[:] = 0.0
        for n, (cells, share) in enumerate(softness.cell_sensitivities):
            if not len(cells) and self.stiffness.covariance is not None and self._lack is None:
                out[n] = np.sqrt(max(gradient[n] @ self.stiffness.covariance @ gradient[n], 0.0))
            elif len(cells) and grid is not None and grid.std is not None:
                sigma = grid.std[cells] / grid.joints[cells] ** 2
                out[n] = np.linalg.norm(share * gradient[n] * sigma)
            elif len(cells):
                out[n] = np.nan
        return out

    def compute_axial_std(self, soft: ComplianceState, e: Array) -> Array:
        """Return the (N,) standard uncertainty of the stiffness along unit vectors, N/m.

        Args:
            soft: The compliance at N configurations.
            e: (N, 3) unit direction vectors, base_link axes.
        """
        own = np.hypot(self.compute_std(soft, soft.compute_axial_gradient(e)), soft.compute_external_joint_std(e, e))
        if soft.discrepancy is not None:
            own = soft.discrepancy.compute_stated_std(e, e, own, small=True)
        return np.asarray(own * soft.compute_stiffness_along(e) ** 2)

    def compute_deflection_std(self, soft: ComplianceState, force: Array) -> Array:
        """Return the (N,) standard uncertainty of the deflection, m.

        Args:
            soft: The compliance at N configurations.
            force: (N, 3) forces, N, base_link axes.
        """
        d = soft.compute_displacement(force)
        e = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), np.finfo(float).tiny)
        own = np.hypot(
            self.compute_std(soft, soft.compute_deflection_gradient(force)), soft.compute_external_joint_std(e, force)
        )
        if soft.discrepancy is None:
            return np.asarray(own)
        return soft.discrepancy.compute_stated_std(e, force, own, small=False)

    @property
    def has_uncertainty(self) -> bool:
        """Whether the file states the uncertainty of its stiffness."""
        grid = self.stiffness.grid
        return (
            self._lack is not None
            or self.stiffness.covariance is not None
            or (grid is not None and grid.std is not None)
        )


def find_grid_cells(grid: StiffnessGrid, position: Array) -> list[NDArray[np.int64]]:
    """Return the cells whose closed box holds each position; boxes are enlarged by TOUCH.

    Args:
        grid: Stiffness grid of the cell.
        position: (N, 3) positions of the TCP in base_link, m.
    """
    nx, ny, nz = grid.shape
    n = np.arange(nx * ny * nz)
    low = grid.origin + grid.cell * np.column_stack([n % nx, n // nx % ny, n // (nx * ny)])
    return [
        np.flatnonzero(
            ((p >= low - GRID_FACE_TOLERANCE_M) & (p <= low + grid.cell + GRID_FACE_TOLERANCE_M)).all(axis=1)
        )
        for p in position
    ]


def compute_force(travel: Array, axis: Array, along: float, across: float, axial: float) -> Array:
    """Return (N, 3) forces, N.

    Args:
        travel: (N, 3) unit directions of travel.
        axis: (N, 3) unit tool axes.
        along: Component along the direction of travel, N.
        across: Component along axis × travel, N.
        axial: Component along the axis, N.
    """
    return np.asarray(along * travel + across * np.cross(axis, travel) + axial * axis)
