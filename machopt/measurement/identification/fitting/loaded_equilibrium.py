"""Identification at the loaded equilibrium: what the load and the weight themselves do to the lever arms (K_C) counts.

Joint springs turn until they bear what hangs on them, θ = θ_cmd + C τ(θ) with τ = J(θ)ᵀ w + g(θ) and C = diag(c). A
reading is the difference of two such states, with the load and without it. Differentiated, (I − C H) ∂θ/∂c_j = τ_j e_j
with H = ∂τ/∂θ, which is K_C of dumas2011 eqs. 8–10 and that of the weight beside it.

A fit goes back and forth: :meth:`LoadedEquilibriumModel.linear` writes the readings as equations that are linear about
the
compliances so far, in the very form of :class:`~machopt.measurement.estimation.load_test_equations.LoadTestExperiment`,
so that every method for
linear equations (weights, bounds, covariance) serves here too, and the next solution is the next point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.errors import InputError
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.rigid_transforms import convert_to_rotation_vector, skew_matrix
from machopt.stiffness.kinetostatic_indices import compute_geometric_stiffness
from machopt.stiffness.terms import LinearTerm

EQUILIBRIUM_TOLERANCE = 1e-13  # rad
MOST_STEPS = 30  # Newton from the commanded joints takes 3 to 5
CONVERGENCE_TOLERANCE = (
    1e-6  # change of a compliance, of the largest one, at which relinearising ends: iterated fits are no finer
)
MOST_ROUNDS = 20


@dataclass(frozen=True, kw_only=True)
class LinearisedExperiment(LoadTestExperiment):
    """The readings as equations linear about given compliances: ``measured`` has the rest of the law taken off.

    y − (d(c₀) − S c₀) = S c + Σ_p x_p B_p w + error; residuals are those of the exact prediction at c₀.
    """

    sensitivity: Array  # (N, D, 6) ∂d/∂c, S

    def select_readings(self, rows: NDArray[np.bool_] | Ints) -> LoadTestExperiment:
        plain = LoadTestExperiment(
            **{f.name: getattr(self, f.name) for f in fields(LoadTestExperiment)}
        ).select_readings(rows)
        return LinearisedExperiment(
            **{f.name: getattr(plain, f.name) for f in fields(LoadTestExperiment)}, sensitivity=self.sensitivity[rows]
        )

    def response(self, terms: Sequence[LinearTerm] = ()) -> Array:
        parts = [t.compute_response(self.state, self.wrench)[:, : self.dimensions] for t in terms]
        return np.concatenate([self.sensitivity, *parts], axis=-1)


@dataclass(frozen=True)
class LoadedEquilibriumModel:
    """The readings and what is needed to let the arm settle under them."""

    experiment: LoadTestExperiment
    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    masses: RobotMasses | None = None  # None: weight does not matter

    def predict(self, compliance: Array) -> tuple[Array, Array]:
        """Displacement under the recorded loads and its derivative.

        Args:
            compliance: (6,) rad/(N·m); zero is a rigid joint.

        Returns:
            d (N, D) m, rad: pose at rest with the load against that without, base axes; ∂d/∂c (N, D, 6).

        Raises:
            InputError: springs that do not hold a recorded load.

        Source: dumas2011 eqs. 3–10, solved instead of linearised.
        """
        e, c = self.experiment, np.asarray(compliance, float)
        free, free_turn = self._settle(c, np.zeros_like(e.wrench))
        loaded, loaded_turn = self._settle(c, e.wrench)
        p = loaded.T_base_tool[:, :3, 3] - free.T_base_tool[:, :3, 3]
        dp = loaded.J[:, :3] @ loaded_turn - free.J[:, :3] @ free_turn
        if e.dimensions == 3:
            return p, dp
        R = loaded.T_base_tool[:, :3, :3] @ np.swapaxes(free.T_base_tool[:, :3, :3], 1, 2)
        phi = convert_to_rotation_vector(R)
        # R's own velocity is ω₁ − R ω₀; a rotation vector follows it by the inverse left Jacobian, φ⁴ left out
        K = skew_matrix(phi)
        back = np.eye(3) - 0.5 * K + (K @ K) / 12.0
        dphi = back @ (loaded.J[:, 3:] @ loaded_turn - R @ (free.J[:, 3:] @ free_turn))
        return np.concatenate([p, phi], axis=1), np.concatenate([dp, dphi], axis=1)

    def linearise(self, compliance: Array) -> LinearisedExperiment:
        """The readings as linear equations about ``compliance`` (6,), to be fitted like any experiment.

        Terms beside the joints stay as they are, taken at the commanded joints; their product with the joints' turning
        is of second order and left out.
        """
        e = self.experiment
        d, S = self.predict(compliance)
        given = {f.name: getattr(e, f.name) for f in fields(LoadTestExperiment)}
        return LinearisedExperiment(**{**given, "measured": e.measured - d + S @ compliance}, sensitivity=S)

    def _settle(self, c: Array, wrench: Array) -> tuple[ArmState, Array]:
        """State at rest and ∂θ/∂c (N, 6, 6)."""
        command = self.experiment.state.q
        if self.masses is None and not wrench.any():  # nothing turns a joint
            return self.experiment.state, np.zeros((len(command), 6, 6))
        theta, eye = command.copy(), np.eye(6)
        for _ in range(MOST_STEPS):
            state, tau, H = self._torque(theta, wrench)
            matrix = eye - c[:, None] * H
            step = np.linalg.solve(matrix, (command + c * tau - theta)[..., None])[..., 0]
            theta = theta + step
            if not np.abs(theta - command).max() < 1.0:  # also NaN: bent by a radian, no spring of a machine holds it
                break
            if np.abs(step).max() < EQUILIBRIUM_TOLERANCE:
                return state, np.linalg.inv(matrix) * tau[:, None, :]
        away = np.abs(theta - command).max(axis=1)
        worst = int(np.argmax(np.where(np.isfinite(away), away, np.inf)))
        raise InputError(
            f"the springs do not hold the load of the reading on "
            f"{self.experiment.format_reading_location(worst)} (compliances "
            f"{_format_compliances(c)} rad/(N·m)): there is no equilibrium near the recorded joints; check the "
            f"load's unit, or "
            "identify without the geometric stiffness",
            file=self.experiment.source,
        )

    def _torque(self, theta: Array, wrench: Array) -> tuple[ArmState, Array, Array]:
        state = self.robot.compute_state(theta, self.T_flange_tcp, bodies=self.masses is not None)
        tau = np.einsum("nci,nc->ni", state.J, wrench)
        H = compute_geometric_stiffness(state.J, wrench)
        if self.masses is not None:
            weight, slope = compute_gravity_torque(self.robot, self.masses, state)
            tau, H = tau + weight, H + slope
        return state, tau, H


@dataclass(frozen=True)
class EquilibriumFit:
    """Compliances that explain the readings at their equilibria, and how much that changed."""

    compliance: Array  # (6,) rad/(N·m)
    linear: LinearisedExperiment  # about ``compliance``: what covariance and residuals are taken from
    start: Array  # (6,) rad/(N·m) of the plain linear fit
    influence: Array  # (N,) share of the translation that K_C, weight and finite turning change at ``compliance``
    rounds: int


def refine_at_equilibrium(
    equilibrium: LoadedEquilibriumModel, start: Array, fit: Callable[[LoadTestExperiment], Array] | None = None
) -> EquilibriumFit:
    """Gauss–Newton: linearise at the equilibria, fit, repeat until the compliances stand.

    Args:
        equilibrium: readings and arm.
        start: (6,) rad/(N·m) of the linear fit.
        fit: a linear experiment to joint compliances (6,), at least zero; None for plain least squares, a rotation
            weighing as much against a translation as it is smaller in the readings.

    Raises:
        InputError: springs that do not hold a load; compliances that do not settle.
    """
    solve = fit_unweighted_compliances if fit is None else fit
    c = np.maximum(np.asarray(start, float), 0.0)
    for rounds in range(1, MOST_ROUNDS + 1):
        new = np.maximum(solve(equilibrium.linearise(c)), 0.0)
        change = np.abs(new - c).max() / max(np.abs(new).max(), np.finfo(float).tiny)
        c = new
        if change < CONVERGENCE_TOLERANCE:
            linear = equilibrium.linearise(c)
            return EquilibriumFit(c, linear, np.asarray(start, float), compute_nonlinear_share(equilibrium, c), rounds)
    raise InputError(
        f"compliances at the loaded equilibrium still change by {change:.1g} of their size after {MOST_ROUNDS} rounds; "
        "identify without the geometric stiffness, or measure more poses",
        file=equilibrium.experiment.source,
    )


def compute_nonlinear_share(equilibrium: LoadedEquilibriumModel, compliance: Array) -> Array:
    """(N,) | |d| − |d_lin| | / max of both: how much of a translation the linear law J C Jᵀ w misses.

    The same ratio as ν_p of dumas2011 eq. 14, here with finite turning and, if there are masses, with weight.
    """
    exact = np.linalg.norm(equilibrium.predict(compliance)[0][:, :3], axis=1)
    plain = np.linalg.norm(equilibrium.experiment.response()[:, :3] @ compliance, axis=1)
    return np.asarray(np.abs(exact - plain) / np.maximum(np.maximum(exact, plain), np.finfo(float).tiny))


def fit_unweighted_compliances(experiment: LoadTestExperiment) -> Array:
    """(6,) compliances by bounded least squares, unweighted but for the unlike units of translation and rotation."""
    from scipy.optimize import lsq_linear

    A, y = experiment.response()[..., :6], experiment.measured
    size = [np.sqrt(np.mean(y[:, a : a + 3] ** 2)) for a in range(0, y.shape[1], 3)]
    scale = 1.0 / np.repeat(np.maximum(size, np.finfo(float).tiny), 3)
    X, z = (A * scale[:, None]).reshape(-1, 6), (y * scale).reshape(-1)
    column = np.linalg.norm(X, axis=0)
    column = np.where(column > 0, column, 1.0)
    return np.asarray(lsq_linear(X / column, z, bounds=(0.0, np.inf), tol=1e-14).x / column)


def _format_compliances(values: Array) -> str:
    return ", ".join(f"{v:.3g}" for v in values)
