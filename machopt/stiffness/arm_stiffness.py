"""Stiffness of the arm at the tool tip from joint stiffness.

Compliance at the tip with free tool rotation: C = J K_θ⁻¹ Jᵀ (jiao2022 eq. 1; dumas2011 eq. 5).
Its 3×3 translation block C_tt gives the deflection d = C_tt f under a force without moment, and the
directional stiffness 1/(eᵀ C_tt e).

jiao2022 (eqs. 13–25) uses K_fd, the top-left block of C⁻¹ instead: the stiffness with the tool's
orientation *constrained*. The constraint needs a moment that nothing applies. Because a shift of the TCP along a rigid
tool leaves force and translation unchanged while rotation is zero, K_fd does not depend on the tool's length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.stiffness import ArmStiffness
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.errors import CellError
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.stiffness.discrepancy_mean import DiscrepancyMean
from machopt.stiffness.external_joint_compliance import KnownCompliance
from machopt.stiffness.joint_compliance import compute_deflection, compute_directional_compliance, compute_jiao_index
from machopt.stiffness.joint_stiffness import compute_joint_stiffness
from machopt.stiffness.kinetostatic_indices import compute_geometric_stiffness
from machopt.stiffness.terms.stability_check import UnstableTerm, limit_to_spring_range
from machopt.stiffness.terms.stability_check import find_unstable_term as stiffness_find_unstable_term
from machopt.stiffness.terms.term_builder import compile_terms
from machopt.stiffness.terms.term_interface import ElasticContribution, LinearTerm, LoadedArm


@dataclass(frozen=True, kw_only=True)
class ElasticState:
    """Elasticity at M configurations: displacement by a wrench at the TCP on top of weight. base_link axes throughout.

    Terms that follow the joint's torque along a curve use the given wrench in :meth:`compute_twist` and
    :meth:`compute_deflection`. In :meth:`compute_compliance_along`, :meth:`compute_compliance` and
    :meth:`compute_jiao_index` they count with the tangent under weight alone.
    """

    state: ArmState  # with bodies where there are terms
    k: Array  # (M, 6) N·m/rad; with a gravity compensator, gear and spring together
    # with values; body springs as one matrix; a compensator is in k; what external joints do is known as a matrix
    terms: tuple[ElasticContribution, ...] = ()
    geometric: bool = False  # count K_C of the load itself (dumas2011 eqs. 8–10)
    weight: Array | None = None  # (M, 6) N·m, torque of links and tool at the joints; None: zero
    gears: Array | None = None  # (M, 6) N·m/rad of the gears alone where one has a parallel spring; None: k

    def compute_twist(self, wrench: Array) -> Array:
        """Return the twist (M, 6) of the TCP in m and rad under a wrench.

        NaN where K_C counts and the springs cannot support the load (K_θ − K_C not positive definite).

        Args:
            wrench: (M, 6) N and N·m at the TCP.
        """
        J = self.state.J
        tau = np.einsum("...ci,...c->...i", J, wrench)
        if self.geometric:
            K = _build_diagonal(self.k) - compute_geometric_stiffness(J, wrench)
            holds = _is_positive_definite(K, self.k)[..., None]
            bent = np.linalg.solve(np.where(holds[..., None], K, np.eye(K.shape[-1])), tau[..., None])[..., 0]
            bent = np.where(holds, bent, np.nan)
        else:
            bent = tau / self.k
        twist = np.einsum("...ci,...i->...c", J, bent)
        for term in self.terms:
            twist = twist + term.compute_twist(self.loaded_state, wrench, small=False)
        return np.asarray(twist)

    def compute_deflection(self, force: Array) -> Array:
        """Return the displacement (M, 3) in m of the TCP under a force without moment.

        Args:
            force: (M, 3) N.
        """
        if not self.terms and not self.geometric:
            return compute_deflection(self.state.J, self.k, force)
        return self.compute_twist(_convert_to_wrench(force))[..., :3]

    def compute_compliance_along(self, direction: Array) -> Array:
        """Return eᵀ C_tt e in m/N for a small load (without K_C).

        Args:
            direction: (M, 3) unit.
        """
        bare = compute_directional_compliance(self.state.J, self.k, direction)
        for term in self.terms:
            twist = term.compute_twist(self.loaded_state, _convert_to_wrench(direction), small=True)
            more = np.einsum("...c,...c->...", twist[..., :3], direction)
            bare = bare + more if term.retained_share is None else np.maximum(bare + more, term.retained_share * bare)
        return np.asarray(bare)

    def compute_compliance(self) -> Array:
        """Return C (M, 6, 6) at the TCP for a small load: J K_θ⁻¹ Jᵀ plus every term's, transformed to the TCP."""
        J = self.state.J
        C = (J / self.k[..., None, :]) @ np.swapaxes(J, -1, -2)
        for term in self.terms:
            for c in range(6):
                unit = np.broadcast_to(np.eye(6)[c], (*J.shape[:-2], 6))
                C[..., :, c] += term.compute_twist(self.loaded_state, unit, small=True)
        return np.asarray(C)

    def compute_jiao_index(self, direction: Array) -> Array:
        """Return k_x of jiao2022 in N/m; the terms' compliance counts too.

        Args:
            direction: (M, 3) unit.
        """
        if not self.terms:
            return compute_jiao_index(self.state.J, self.k, direction)
        S = np.linalg.inv(np.linalg.inv(self.compute_compliance())[..., :3, :3])
        return np.asarray(np.linalg.norm(np.einsum("...ij,...jk,...k->...i", S, S, direction), axis=-1) ** -0.5)

    def compute_sensitivity(self, force: Array, direction: Array, *, small: bool = False) -> Array:
        """Return ∂(eᵀ d)/∂c_j (M, 6) in N·m·m: derivative of the displacement d under f along e by each joint's
        compliance.

        Without K_C that is (J_v,j · e)(J_v,j · f). With the covariance
        Σ of the compliances the variance of that displacement is gᵀ Σ g. c_j is the compliance of the gear alone; terms
        that
        depend on the joint's torque do not depend on it.

        Args:
            force: (M, 3) N, f.
            direction: (M, 3) unit, e.
            small: leave out K_C, as :meth:`compute_compliance_along` does.
        """
        if self.gears is not None:  # c = 1/(1/c_gear + spring), so ∂c/∂c_gear = (k_gear/k)²
            together = replace(self, gears=None).compute_sensitivity(force, direction, small=small)
            return np.asarray(together * (self.gears / self.k) ** 2)
        Jv = self.state.J[..., :3, :]
        along, tau = (np.einsum("...ci,...c->...i", Jv, v) for v in (direction, force))
        if small or not self.geometric:
            return np.asarray(along * tau)
        # bent = (K − K_C)⁻¹ τ, so ∂bent/∂c_j = (K − K_C)⁻¹ e_j k_j² bent_j
        K = _build_diagonal(self.k) - compute_geometric_stiffness(self.state.J, _convert_to_wrench(force))
        bent = np.linalg.solve(K, tau[..., None])[..., 0]
        carried = np.linalg.solve(np.swapaxes(K, -1, -2), along[..., None])[..., 0]
        return np.asarray(carried * self.k**2 * bent)

    def compute_jiao_sensitivity(self, direction: Array, lines: Array | None = None) -> Array:
        """Return ∂(1/k_x)/∂c_j (M, 6) of :meth:`compute_jiao_index`, in rad⁻¹·m/N·N·m.

        S = K_fd⁻¹ = P C Pᵀ with P = [1, −C_tr C_rr⁻¹], stationary in P, so ∂S/∂c_j = (P J_j)(P J_j)ᵀ; 1/k_x = |S² e|^½.

        Args:
            direction: (M, 3) unit.
            lines: (M, 6, K) TCP twist per unit displacement of other springs; None: the arm's joints.
        """
        if self.gears is not None and lines is None:
            return np.asarray(
                replace(self, gears=None).compute_jiao_sensitivity(direction) * (self.gears / self.k) ** 2
            )
        C = self.compute_compliance()
        P = np.concatenate(
            [
                np.broadcast_to(np.eye(3), (*C.shape[:-2], 3, 3)),
                -np.swapaxes(np.linalg.solve(C[..., 3:, 3:], C[..., 3:, :3]), -1, -2),
            ],
            axis=-1,
        )
        S, turned = (
            P @ C @ np.swapaxes(P, -1, -2),
            P @ (self.state.J if lines is None else lines),
        )  # (M, 3, 3), (M, 3, 6)
        Se = np.einsum("...ij,...j->...i", S, direction)
        SSe = np.einsum("...ij,...j->...i", S, Se)
        size = np.linalg.norm(SSe, axis=-1)[..., None]
        SSSe = np.einsum("...ij,...j->...i", S, SSe)
        # (S² e)ᵀ (∂S S + S ∂S) e with ∂S = t tᵀ is (t·SSe)(t·Se) + (t·SSSe)(t·e)
        on_e, on_Se, on_SSe, on_SSSe = (np.einsum("...ci,...c->...i", turned, v) for v in (direction, Se, SSe, SSSe))
        return np.asarray(0.5 * size**-1.5 * (on_SSe * on_Se + on_SSSe * on_e))

    @property
    def loaded_state(self) -> LoadedArm:
        """State of the arm that its terms are evaluated with."""
        return LoadedArm(self.state, self.k if self.gears is None else self.gears, self.weight)


class ArmElasticity:
    """Compliance model of the arm with its tool: all elastic effects at a set of configurations.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        stiffness: its springs and terms.
        limits: lower and upper (6,) rad, range in which angle-dependent springs must be valid; None: at any angle.
        masses: of links and tool, for terms that depend on the whole torque of a joint; None: weight counts as zero.
            ``warnings`` reports where that matters.
        counted: include the mean model discrepancy of the file, where the file enables it.

    Raises:
        InputError: a term of the stiffness that does not exist, does not fit the arm or makes it unstable under load.
    """

    def __init__(
        self,
        robot: Robot,
        T_flange_tcp: Array,
        stiffness: ArmStiffness,
        limits: tuple[Array, Array] | None = None,
        masses: RobotMasses | None = None,
        *,
        counted: bool = False,
    ) -> None:
        self.robot, self.T_flange_tcp, self.stiffness = robot, T_flange_tcp, stiffness
        file = stiffness.file
        compiled, self.geometric = compile_terms(stiffness.terms, robot, T_flange_tcp, file)
        if self.geometric and robot.coupling is not None:
            raise CellError(
                "geometric_stiffness is not counted for an arm with joints that mimic others; a file without that term "
                "would work",
                file=file,
                where="terms",
            )
        for term in compiled:
            missing = [c.name for c, v in zip(term.coefficients, term.values, strict=True) if not np.isfinite(v)]
            missing += term.missing_keys
            if missing:
                raise CellError(
                    f"{term.effect} at {term.location} lacks values for {', '.join(missing)}", file=file, where="terms"
                )
        compiled, wrong = _limit_to_springs(compiled, stiffness, limits)
        if wrong is not None:
            raise CellError(wrong.reason, file=file, where="terms")
        self.terms = tuple(t.with_joint_stiffness(self._compute_gear_stiffness) for t in compiled)
        self._known: tuple[ElasticContribution, ...] = tuple(
            f for t in self.terms if (f := t.combine_coefficients()) is not None
        )
        self.shift: DiscrepancyMean | None = None
        found = stiffness.discrepancy
        if counted and found is not None and found.counted:
            self.shift = DiscrepancyMean.build(found, robot, T_flange_tcp, self.terms, masses, geometric=self.geometric)
            self._known = (*self._known, self.shift)
        self._balancers = tuple((t.parallel_joint, t) for t in self.terms if t.parallel_joint is not None)
        weighed = [t for t in self.terms if t.depends_on_weight]
        self.masses = masses
        self._masses = masses if weighed else None
        self.warnings: tuple[str, ...] = ()
        if weighed and (masses is None or not (masses.body < len(robot.joints)).any()):
            names = ", ".join(f"{t.effect} at {t.location}" for t in weighed)
            self.warnings = (
                f"{names}: depends on the whole torque of the joint, but no mass of a link is known; the arm's weight "
                "counts as zero (an <inertial> in each link of the URDF would tell).",
            )

    def evaluate(self, q: Array, k: Array | None = None, beside: Array | None = None) -> ElasticState:
        """Return the elastic state of configurations.

        Args:
            q: (M, 6) rad.
            k: (M, 6) N·m/rad, joint stiffness if already known.
            beside: (M, 6, 6) compliance of the external joints at the TCP
                (:mod:`machopt.stiffness.external_joint_compliance`).
        """
        state = self.robot.compute_state(q, self.T_flange_tcp, bodies=bool(self.terms or self._known))
        if k is None:
            k = self._compute_gear_stiffness(state)
        weight = None if self._masses is None else compute_weight_torque(self.robot, self._masses, state)
        terms = self._known if beside is None else (*self._known, KnownCompliance(beside))
        if not self._balancers:
            return ElasticState(state=state, k=k, terms=terms, geometric=self.geometric, weight=weight)
        return ElasticState(
            state=state,
            k=self._add_parallel_stiffness(k, q),
            terms=terms,
            geometric=self.geometric,
            weight=weight,
            gears=k,
        )

    def _compute_gear_stiffness(self, state: ArmState) -> Array:
        """(..., 6) N·m/rad of the joints' own springs at the TCP's position."""
        return compute_joint_stiffness(self.stiffness, state.T_base_tool[..., :3, 3]).k

    def _add_parallel_stiffness(self, k: Array, q: Array) -> Array:
        out = np.array(k)
        for i, term in self._balancers:
            out[..., i] += term.compute_parallel_stiffness(np.asarray(q, float)[..., i])
        return out

    def compute_jacobian(self, q: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the Jacobian at the TCP (..., 6, 6) in base_link axes, k (..., 6) there, and whether the grid covers
        it.

        Args:
            q: (..., 6) rad.
        """
        T, J = self.robot.compute_fk_jacobian(q, self.T_flange_tcp)
        joint = compute_joint_stiffness(self.stiffness, T[..., :3, 3])
        return J, self._add_parallel_stiffness(joint.k, q) if self._balancers else joint.k, joint.is_in_grid


def find_unstable_term(
    stiffness: ArmStiffness, robot: Robot, T_flange_tcp: Array, limits: tuple[Array, Array] | None = None
) -> UnstableTerm | None:
    """Return the term for which :class:`ArmElasticity` would refuse a stiffness whose terms are all complete.

    Args:
        stiffness: stiffness model of the arm.
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        limits: lower and upper (6,) rad; None: any angle.
    """
    compiled, _ = compile_terms(stiffness.terms, robot, T_flange_tcp, stiffness.file)
    return _limit_to_springs(compiled, stiffness, limits)[1]


def _limit_to_springs(
    compiled: tuple[LinearTerm, ...], stiffness: ArmStiffness, limits: tuple[Array, Array] | None
) -> tuple[tuple[LinearTerm, ...], UnstableTerm | None]:
    """Return the terms limited to where each is a spring, and the unstable one, if any."""
    k = stiffness.joints[None]
    if stiffness.grid is not None:
        k = np.concatenate([k, stiffness.grid.joints])
    limited = limit_to_spring_range(compiled, k, limits)
    return limited, stiffness_find_unstable_term(limited, k, limits)


def _build_diagonal(k: Array) -> Array:
    return k[..., :, None] * np.eye(k.shape[-1])


def _is_positive_definite(K: Array, k: Array) -> NDArray[np.bool_]:
    """Return (...,) whether K = K_θ − K_C is positive definite; checked only where K_C is not small compared with the
    softest
    joint.
    """
    off = np.linalg.norm(K - _build_diagonal(k), axis=(-2, -1))
    holds = np.asarray(off < k.min(axis=-1))
    if not holds.all():
        doubtful = 0.5 * (K[~holds] + np.swapaxes(K[~holds], -1, -2))
        holds[~holds] = np.linalg.eigvalsh(doubtful)[..., 0] > 0.0
    return holds


def _convert_to_wrench(force: Array) -> Array:
    return np.concatenate([force, np.zeros_like(force)], axis=-1)
