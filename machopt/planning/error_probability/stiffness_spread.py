"""Uncertainty of the stiffness as twists of the TCP that scatter: one column per independent error.

    twist(w) = C w + Σ_r g_r D_r w

C is the nominal compliance for small loads, without K_C. g are draws: normal for the covariance of the compliances, for
the grid's standard uncertainties, for a model discrepancy and for the covariance of a term; exp(−s z) − 1 for
``spread_percent`` (each spring by itself). In a grid without standard uncertainties the covariance of the constant
springs holds as a share of each spring. Outside a grid that has them it is the covariance, else ``spread_percent``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel
from machopt.stiffness.arm_stiffness import ArmElasticity, ElasticState
from machopt.stiffness.joint_stiffness import find_grid_cells

SpreadKind = Literal["discrepancy", "covariance", "grid", "percent", "unknown"]


@dataclass(frozen=True, kw_only=True)
class StiffnessSpread:
    """Random part of a stiffness file."""

    kind: SpreadKind  # of the joint springs
    elasticity: ArmElasticity
    discrepancy: DiscrepancyModel | None
    covariance_root: Array  # (6, R) of the joint compliances, rad/(N·m); R = 0 where it does not count
    term_variants: tuple[ArmElasticity, ...]  # one per independent error of a term

    @classmethod
    def build(cls, elasticity: ArmElasticity, limits: tuple[Array, Array]) -> StiffnessSpread:
        """Return the random part of a stiffness file.

        Args:
            elasticity: compliance model of the arm.
            limits: lower and upper (6,) rad of the joints, as the model was built with.
        """
        stiffness = elasticity.stiffness
        kind = _find_kind(stiffness)
        root = np.zeros((6, 0))
        if kind == "covariance":
            assert stiffness.covariance is not None
            values, vectors = np.linalg.eigh(stiffness.covariance)
            root = vectors * np.sqrt(np.maximum(values, 0.0))
        discrepancy = DiscrepancyModel.build(elasticity) if kind == "discrepancy" else None
        return cls(
            kind=kind,
            elasticity=elasticity,
            discrepancy=discrepancy,
            covariance_root=root,
            term_variants=_build_term_variants(elasticity, limits),
        )

    @property
    def is_known(self) -> bool:
        """Whether the file states how uncertain it is, and was measured."""
        return self.kind != "unknown" and not self.elasticity.stiffness.estimated

    @property
    def count(self) -> int:
        """Number of independent errors."""
        return self._count_joint_errors() + len(self.term_variants)

    @property
    def dimensions(self) -> int:
        """Number of standard normal numbers per draw."""
        return self.count

    def _count_joint_errors(self) -> int:
        if self.kind == "discrepancy":
            assert self.discrepancy is not None
            return len(self.discrepancy.ways) - 1
        return 0 if self.kind == "unknown" else 6

    def compute_columns(self, elastic: ElasticState, q: Array, wrench: Array, external: Array | None) -> Array:
        """Return (M, 6, 1 + R): the twist of the TCP under a load, and its change by each error.

        Args:
            elastic: elastic state of the configurations.
            q: (M, 6) rad.
            wrench: (M, 6) N and N·m at the TCP in base_link.
            external: (M, 6, 6) compliance of the external joints at the TCP; None: rigid.
        """
        mean = np.einsum("mij,mj->mi", elastic.compute_compliance(), wrench)
        columns = [mean[:, :, None]]
        if self.kind == "discrepancy":
            assert self.discrepancy is not None
            moved = self.discrepancy.compute_twist(elastic, q, wrench, small=True)
            columns[0] = columns[0] + moved[:, :, :1]
            columns.append(moved[:, :, 1:])
        elif self.kind != "unknown":
            columns.append(self.compute_joint_columns(elastic, wrench))
        for variant in self.term_variants:
            other = variant.evaluate(q, None, external).compute_compliance()
            columns.append((np.einsum("mij,mj->mi", other, wrench) - mean)[:, :, None])
        return np.concatenate(columns, axis=2)

    def compute_joint_columns(self, elastic: ElasticState, wrench: Array) -> Array:
        """Return (M, 6, 6): the change of the twist by each independent error of the springs.

        Args:
            elastic: elastic state of the configurations.
            wrench: (M, 6) N and N·m at the TCP in base_link.
        """
        J, gears = elastic.state.J, elastic.k if elastic.gears is None else elastic.gears
        torque = np.einsum("mci,mc->mi", J, wrench) * (gears / elastic.k) ** 2
        per_compliance = J * torque[:, None, :]  # twist per unit compliance of each joint
        if self.kind == "covariance":
            root = self.covariance_root
            if self.elasticity.stiffness.grid is None:
                return np.asarray(per_compliance @ root)
            return np.asarray((per_compliance / gears[:, None, :]) @ (self.elasticity.stiffness.joints[:, None] * root))
        if self.kind == "percent":
            return np.asarray(per_compliance / gears[:, None, :])
        return np.asarray(per_compliance * self._compute_grid_std(elastic)[:, None, :])

    def _compute_grid_std(self, elastic: ElasticState) -> Array:
        """Return the (M, 6) 1 sigma of the compliances; 0 outside the grid, where no spread is stated."""
        stiffness = self.elasticity.stiffness
        grid = stiffness.grid
        assert grid is not None
        assert grid.std is not None
        position = elastic.state.T_base_tool[..., :3, 3]
        constant = np.zeros(6)
        if stiffness.covariance is not None:
            constant = np.sqrt(np.diag(stiffness.covariance))
        elif stiffness.spread is not None:
            constant = stiffness.spread / stiffness.joints
        out = np.tile(constant, (len(position), 1))
        rows, cells = find_grid_cells(grid, position)
        out[rows] = grid.std[cells] / grid.joints[cells] ** 2
        return out

    def find_stated(self, position: Array) -> NDArray[np.bool_]:
        """Return (M,) whether the file states the spread of the springs at TCP positions.

        Args:
            position: (M, 3) m, in base_link.
        """
        stiffness = self.elasticity.stiffness
        if not self.is_known or self.kind != "grid" or stiffness.covariance is not None or stiffness.spread is not None:
            return np.full(len(position), self.is_known)
        assert stiffness.grid is not None
        out = np.zeros(len(position), bool)
        out[find_grid_cells(stiffness.grid, position)[0]] = True
        return out

    def draw_factors(self, z: Array) -> Array:
        """Return (D, 1 + R): 1, and the draw of each independent error.

        Args:
            z: (D, R) standard normal numbers.
        """
        g = z.copy()
        if self.kind == "percent":
            s = self.elasticity.stiffness.spread
            assert s is not None
            g[:, :6] = np.expm1(-s * z[:, :6])  # of the compliance: the spring is its median times exp(s z)
        return np.concatenate([np.ones((len(z), 1)), g], axis=1)

    def is_positive(self, z: Array) -> Array:
        """Return (D,) whether all compliances of a draw are above zero.

        Args:
            z: (D, R) standard normal numbers.
        """
        if self.kind != "covariance":
            return np.ones(len(z), bool)
        nominal = 1.0 / self.elasticity.stiffness.joints
        return np.asarray((nominal + z[:, :6] @ self.covariance_root.T > 0).all(axis=1))


def _find_kind(stiffness: ArmStiffness) -> SpreadKind:
    if stiffness.discrepancy is not None:
        return "discrepancy"
    if stiffness.grid is not None and stiffness.grid.std is not None:
        return "grid"
    if stiffness.covariance is not None:
        return "covariance"
    return "percent" if stiffness.spread is not None else "unknown"


def _build_term_variants(elasticity: ArmElasticity, limits: tuple[Array, Array]) -> tuple[ArmElasticity, ...]:
    """Return one model per independent error of a term with a covariance, one sigma away."""
    stiffness, out = elasticity.stiffness, []
    for n, term in enumerate(stiffness.terms):
        for shifted in _shift_term(term):
            terms = (*stiffness.terms[:n], shifted, *stiffness.terms[n + 1 :])
            out.append(
                ArmElasticity(
                    elasticity.robot,
                    elasticity.T_flange_tcp,
                    replace(stiffness, terms=terms),
                    limits,
                    elasticity.masses,
                    counted=elasticity.shift is not None,
                )
            )
    return tuple(out)


def _shift_term(term: StiffnessTerm) -> tuple[StiffnessTerm, ...]:
    if term.covariance is None:
        return ()
    values, vectors = np.linalg.eigh(np.array(term.covariance))
    steps = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return tuple(_add_to_parameters(term, step) for step in steps if np.abs(step).max() > 0)


def _add_to_parameters(term: StiffnessTerm, step: Array) -> StiffnessTerm:
    """Return the term with a step added to its numbers, in the order of the parameters."""
    rest, parameters = step.tolist(), {}
    for key, value in term.parameters.items():
        if isinstance(value, bool) or not isinstance(value, int | float | list | tuple):
            parameters[key] = value
        elif isinstance(value, list | tuple):
            parameters[key] = [v + rest.pop(0) if rest else v for v in value]
        else:
            parameters[key] = value + (rest.pop(0) if rest else 0.0)
    return replace(term, parameters=parameters)
