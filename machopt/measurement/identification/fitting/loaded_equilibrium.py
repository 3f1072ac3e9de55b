"""Identification at the loaded equilibrium, including the effect of load and weight on the lever arms (K_C).

Joint springs deflect to equilibrium: θ = θ_cmd + C τ(θ) with τ = J(θ)ᵀ w + g(θ) and C = diag(c). A reading is the
difference of two such states, with and without load. Differentiation gives (I − C H) ∂θ/∂c_j = τ_j e_j with H =
∂τ/∂θ: K_C of dumas2011 eqs. 8–10, together with that of the weight.

The fit iterates. :meth:`LoadedEquilibriumModel.linearise` writes the readings as equations linear about the current
compliances, in the form of :class:`~machopt.measurement.estimation.load_test_equations.LoadTestExperiment`. All
methods for linear equations (weights, bounds, covariance) apply, and the next solution is the next linearisation
point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.errors import RecordingError
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.rigid_transforms import convert_to_rotation_vector, skew_matrix
from machopt.stiffness.kinetostatic_indices import compute_geometric_stiffness
from machopt.stiffness.terms import LinearTerm

EQUILIBRIUM_TOLERANCE = 1e-13  # rad
MOST_STEPS = 30  # Newton's method typically needs 3 to 5 from the commanded joints
CONVERGENCE_TOLERANCE = 1e-6  # relative change of a compliance at which the iteration ends
MOST_ROUNDS = 20


@dataclass(frozen=True, kw_only=True)
class LinearisedExperiment(LoadTestExperiment):
    """Readings as equations linear about given compliances; the nonlinear rest is subtracted from ``measured``.

    y − (d(c₀) − S c₀) = S c + Σ_p x_p B_p w + error. Residuals equal those of the exact prediction at c₀.
    """

    sensitivity: Array  # (N, D, n) ∂d/∂c, S

    def select_readings(self, rows: NDArray[np.bool_] | Ints) -> LoadTestExperiment:
        """Return the selected readings.

        Args:
            rows: (N,) mask or indices of readings.

        Returns:
            The experiment with these readings.
        """
        plain = LoadTestExperiment(
            **{f.name: getattr(self, f.name) for f in fields(LoadTestExperiment)}
        ).select_readings(rows)
        return LinearisedExperiment(
            **{f.name: getattr(plain, f.name) for f in fields(LoadTestExperiment)}, sensitivity=self.sensitivity[rows]
        )

    def response(self, terms: Sequence[LinearTerm] = ()) -> Array:
        """Return the response matrix: sensitivities to the joint compliances, then the columns of terms.

        Args:
            terms: Linear terms fitted together with the joints.

        Returns:
            (N, D, n + P) m, rad per unit of each coefficient.
        """
        parts = [t.compute_response(self.state, self.wrench)[:, : self.dimensions] for t in terms]
        return np.concatenate([self.sensitivity, *parts], axis=-1)


@dataclass(frozen=True)
class LoadedEquilibriumModel:
    """Readings with the arm model needed to compute loaded equilibria."""

    experiment: LoadTestExperiment
    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    masses: RobotMasses | None = None  # None: weight is neglected

    def predict(self, compliance: Array) -> tuple[Array, Array]:
        """Predict the displacement under the recorded loads and its derivative, in base axes.

        Args:
            compliance: (n,) joint compliance, rad/(N·m); zero is a rigid joint.

        Returns:
            Displacement (N, D) m, rad of the loaded relative to the unloaded pose, and its derivative (N, D, n).

        Raises:
            InputError: The springs are unstable under a recorded load.

        Source:
            dumas2011 eqs. 3–10, solved instead of linearised.
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
        """Return the readings as linear equations about given compliances.

        Terms other than joints are evaluated at the commanded joints; their product with joint deflections is of
        second order.

        Args:
            compliance: (n,) joint compliance, rad/(N·m).

        Returns:
            The linearised experiment.
        """
        e = self.experiment
        d, S = self.predict(compliance)
        given = {f.name: getattr(e, f.name) for f in fields(LoadTestExperiment)}
        return LinearisedExperiment(**{**given, "measured": e.measured - d + S @ compliance}, sensitivity=S)

    def _settle(self, c: Array, wrench: Array) -> tuple[ArmState, Array]:
        """Return the equilibrium state and ∂θ/∂c (N, n, n)."""
        command = self.experiment.state.q
        if self.masses is None and not wrench.any():  # no joint is loaded
            return self.experiment.state, np.zeros((*command.shape, command.shape[1]))
        theta, eye = command.copy(), np.eye(command.shape[1])
        for _ in range(MOST_STEPS):
            state, tau, H = self._compute_torque(theta, wrench)
            matrix = eye - c[:, None] * H
            step = np.linalg.solve(matrix, (command + c * tau - theta)[..., None])[..., 0]
            theta = theta + step
            if not np.abs(theta - command).max() < 1.0:  # also NaN: a deflection of a radian means instability
                break
            if np.abs(step).max() < EQUILIBRIUM_TOLERANCE:
                return state, np.linalg.inv(matrix) * tau[:, None, :]
        away = np.abs(theta - command).max(axis=1)
        worst = int(np.argmax(np.where(np.isfinite(away), away, np.inf)))
        raise RecordingError(
            f"the springs do not hold the load of the reading on "
            f"{self.experiment.format_reading_location(worst)} (compliances "
            f"{_format_compliances(c)} rad/(N·m)): there is no equilibrium near the recorded joints; check the "
            f"load's unit, or "
            "identify without the geometric stiffness",
            file=self.experiment.source,
        )

    def _compute_torque(self, theta: Array, wrench: Array) -> tuple[ArmState, Array, Array]:
        state = self.robot.compute_state(theta, self.T_flange_tcp, bodies=self.masses is not None)
        tau = np.einsum("nci,nc->ni", state.J, wrench)
        H = compute_geometric_stiffness(state.J, wrench)
        if self.masses is not None:
            weight, slope = compute_gravity_torque(self.robot, self.masses, state)
            tau, H = tau + weight, H + slope
        return state, tau, H


@dataclass(frozen=True)
class EquilibriumFit:
    """Compliances fitted at the loaded equilibria."""

    compliance: Array  # (n,) rad/(N·m)
    linear: LinearisedExperiment  # about ``compliance``; used for covariance and residuals
    start: Array  # (n,) rad/(N·m), linear fit
    influence: Array  # (N,) relative change of the translation by K_C, weight and finite rotations
    rounds: int


def refine_at_equilibrium(
    equilibrium: LoadedEquilibriumModel, start: Array, fit: Callable[[LoadTestExperiment], Array] | None = None
) -> EquilibriumFit:
    """Fit by Gauss–Newton: linearise at the equilibria, fit, and repeat until convergence.

    Args:
        equilibrium: Readings and arm model.
        start: (n,) compliance of the linear fit, rad/(N·m).
        fit: Function that fits joint compliances (n,) ≥ 0 to a linear experiment; None: unweighted least
            squares with rotations scaled to translations.

    Returns:
        The fit.

    Raises:
        InputError: The springs are unstable, or the iteration does not converge.
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
    raise RecordingError(
        f"compliances at the loaded equilibrium still change by {change:.1g} of their size after {MOST_ROUNDS} rounds; "
        "identify without the geometric stiffness, or measure more poses",
        file=equilibrium.experiment.source,
    )


def compute_nonlinear_share(equilibrium: LoadedEquilibriumModel, compliance: Array) -> Array:
    """Compute the relative error of the linear law J C Jᵀ w in the translation, | |d| − |d_lin| | / max of both.

    The same ratio as ν_p of dumas2011 eq. 14, with finite rotations and, with masses, with weight.

    Args:
        equilibrium: Readings and arm model.
        compliance: (n,) joint compliance, rad/(N·m).

    Returns:
        (N,) 0 to 1.
    """
    exact = np.linalg.norm(equilibrium.predict(compliance)[0][:, :3], axis=1)
    plain = np.linalg.norm(equilibrium.experiment.response()[:, :3] @ compliance, axis=1)
    return np.asarray(np.abs(exact - plain) / np.maximum(np.maximum(exact, plain), np.finfo(float).tiny))


def fit_unweighted_compliances(experiment: LoadTestExperiment) -> Array:
    """Fit compliances by bounded least squares, unweighted except for the scale between translation and rotation.

    Args:
        experiment: Load tests in base axes.

    Returns:
        (n,) rad/(N·m).
    """
    from scipy.optimize import lsq_linear

    A, y = experiment.response()[..., : experiment.joint_count], experiment.measured
    size = [np.sqrt(np.mean(y[:, a : a + 3] ** 2)) for a in range(0, y.shape[1], 3)]
    scale = 1.0 / np.repeat(np.maximum(size, np.finfo(float).tiny), 3)
    X, z = (A * scale[:, None]).reshape(-1, experiment.joint_count), (y * scale).reshape(-1)
    column = np.linalg.norm(X, axis=0)
    column = np.where(column > 0, column, 1.0)
    return np.asarray(lsq_linear(X / column, z, bounds=(0.0, np.inf), tol=1e-14).x / column)


def _format_compliances(values: Array) -> str:
    return ", ".join(f"{v:.3g}" for v in values)
