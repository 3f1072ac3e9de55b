"""Effect of the number of tests and of measurement errors (dumas2011 sections 5.1 and 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.measurements.recording import StandardUncertainty
from machopt.kinematics.robot import Robot
from machopt.measurement.estimation.error_clusters import build_normal_equations, sum_channel_equations
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array, Ints

SIZES = 24  # most subset sizes
SUBSETS = 60
DRAWS = 200
FEWEST_DRAWS = 20
READINGS_AT_MOST = 100_000  # limit on draws × readings of a Monte-Carlo study


@dataclass(frozen=True)
class SubsetStudyResult:
    """Joint stiffness from random subsets of the tests; NaN if a subset does not determine a joint."""

    tests: Ints  # (S,) size of the subset
    k: Array  # (S, R, n) N·m/rad, R random subsets of each size

    @property
    def spread(self) -> Array:
        """Relative standard deviation (S, n) of the compliance, equal to that of k to first order."""
        with np.errstate(invalid="ignore", divide="ignore"):
            c = 1.0 / self.k
        out = np.full((len(self.tests), self.k.shape[2]), np.nan)
        for s, part in enumerate(c):
            for j in range(part.shape[1]):
                good = part[np.isfinite(part[:, j]), j]
                if len(good) > len(part) // 2:
                    out[s, j] = good.std() / good.mean()
        return out


@dataclass(frozen=True)
class MonteCarloResult:
    """Joint compliances for randomly perturbed measurements."""

    compliance: Array  # (R, n) rad/(N·m), without bounds; NaN for joints not identified
    uncertainty: StandardUncertainty  # of the perturbations
    assumed: tuple[str, ...]  # channels whose uncertainty was estimated from the residuals

    @property
    def spread(self) -> Array:
        """Relative standard deviation (6,) of the compliance, equal to that of k to first order."""
        return np.asarray(self.compliance.std(axis=0, ddof=1) / np.abs(self.compliance.mean(axis=0)))


def run_subset_study(
    fit: StiffnessFit, settled: SettledCoefficients, rng: np.random.Generator, *, of: str = "readings"
) -> SubsetStudyResult:
    """Compute the stiffness from random subsets of n tests, from the fewest possible to all, without repetition.

    Args:
        fit: Fit; its weights apply to every subset.
        settled: Final coefficients; unidentified joints keep the cell's value.
        rng: Random generator.
        of: "readings" (the tests of the paper) or "poses" (all readings of a pose at once).

    Returns:
        Stiffness by subset size.

    Source:
        Dumas et al. 2011, section 5.1 and fig. 7.
    """
    if of == "poses":
        H, h = fit.normal.H, fit.normal.h
    else:
        H, h = _build_equations_by_reading(fit)
    N, P = h.shape
    least = 1 if of == "poses" else max(1, -(-P // fit.y.shape[1]))
    sizes = np.unique(np.round(np.geomspace(least, N, SIZES)).astype(np.int64))
    together = np.concatenate([H.reshape(N, -1), h], axis=1)
    k = np.full((len(sizes), SUBSETS, settled.joint_count), np.nan)
    identified = np.array([s.identified for s in settled.joint_status])
    for r in range(SUBSETS):
        order = rng.permutation(N)
        starts = np.concatenate([[0], sizes[:-1]])
        parts = np.add.reduceat(together[order], starts, axis=0)
        for s, total in enumerate(np.cumsum(parts, axis=0)):
            Hs = total[: P * P].reshape(P, P)
            values = np.linalg.eigvalsh(Hs + np.diag(settled.pull))
            if values[0] <= 1e-9 * values[-1]:
                continue
            c = settled.solve(fit, Hs, total[P * P :])[: settled.joint_count]
            k[s, r] = np.where(identified & (c > 0), 1.0 / np.where(c > 0, c, 1.0), np.nan)
    return SubsetStudyResult(sizes, k)


def run_monte_carlo(
    fit: StiffnessFit,
    settled: SettledCoefficients,
    robot: Robot,
    T_flange_tcp: Array,
    rng: np.random.Generator,
    *,
    draws: int = DRAWS,
    uncertainty: StandardUncertainty | None = None,
) -> MonteCarloResult:
    """Repeat the fit with displacements, loads and joint angles perturbed by their uncertainty.

    Errors are independent between readings, as in the paper.

    Args:
        fit: Fit; its weights apply to every draw.
        settled: Final coefficients; unidentified joints get NaN.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        rng: Random generator.
        draws: Largest number of draws; fewer for long recordings.
        uncertainty: Uncertainty of the perturbations; None: as stated. An unstated displacement uncertainty is
            estimated from the residuals.

    Returns:
        Compliances of all draws.

    Source:
        Dumas et al. 2011, section 5.2.
    """
    e = fit.experiment
    used, assumed = _complete_uncertainty(fit, e.uncertainty if uncertainty is None else uncertainty)
    own = np.repeat([used.displacement or 0.0, used.rotation or 0.0], 3)[: e.dimensions]
    load = np.repeat([used.force or 0.0, used.moment or 0.0], 3)
    count = int(np.clip(READINGS_AT_MOST // len(e), FEWEST_DRAWS, draws))
    out = np.empty((count, settled.joint_count))
    for r in range(count):
        q = e.state.q + (used.joint or 0.0) * rng.standard_normal(e.state.q.shape)
        state = robot.compute_state(q, T_flange_tcp, bodies=bool(fit.terms)) if used.joint else e.state
        drawn = LoadTestExperiment(
            source=e.source,
            state=state,
            T_base_tcp=state.T_base_tool,
            wrench=e.wrench + load * rng.standard_normal(e.wrench.shape),
            measured=e.measured,
            pose=e.pose,
            cycle=e.cycle,
            session=e.session,
            line=e.line,
        )
        A = drawn.response(fit.terms) * fit.column
        y = fit.y + own * rng.standard_normal(fit.y.shape)
        out[r] = _solve_coefficients(fit, A, y)[: settled.joint_count]
    out[:, [not s.identified for s in settled.joint_status]] = np.nan
    return MonteCarloResult(out, used, assumed)


def _complete_uncertainty(
    fit: StiffnessFit, stated: StandardUncertainty
) -> tuple[StandardUncertainty, tuple[str, ...]]:
    """Return the uncertainty with what is not stated estimated from the residuals, and the names of what was."""
    e, scatter = fit.experiment, fit.weighting.scatter(fit.clusters)
    assumed = []
    if stated.displacement is None:
        assumed.append("displacement")
    if e.dimensions == 6 and stated.rotation is None:
        assumed.append("rotation")
    used = StandardUncertainty(
        displacement=scatter[0].total if stated.displacement is None else stated.displacement,
        rotation=(scatter[1].total if stated.rotation is None else stated.rotation) if e.dimensions == 6 else None,
        force=stated.force,
        moment=stated.moment,
        joint=stated.joint,
    )
    return used, tuple(assumed)


def _build_equations_by_reading(fit: StiffnessFit) -> tuple[Array, Array]:
    """Return the normal equations of each reading; shared errors count as errors of the single reading."""
    N, P = len(fit.y), len(fit.x)
    H, h = np.zeros((N, P, P)), np.zeros((N, P))
    w = fit.weighting
    for c, share in enumerate(w.components):
        rows = slice(3 * c, 3 * c + 3)
        V = np.linalg.inv(w.precision[c]) + (share.cycle + share.visit) * np.eye(3)
        W = np.linalg.inv(V) / share.scale
        A = fit.A[:, rows] * fit.column
        H += np.swapaxes(A, 1, 2) @ W @ A
        h += np.einsum("nip,nij,nj->np", A, W, fit.y[:, rows], optimize=True)
    return H, h


def _solve_coefficients(fit: StiffnessFit, A: Array, y: Array) -> Array:
    H, h = np.zeros((len(fit.x), len(fit.x))), np.zeros(len(fit.x))
    for c, share in enumerate(fit.weighting.components):
        rows = slice(3 * c, 3 * c + 3)
        parts = sum_channel_equations(fit.clusters, fit.weighting.precision[c], A[:, rows], y[:, rows], 0.0)
        Hc, hc = build_normal_equations(fit.clusters, parts, share).total()
        H, h = H + Hc, h + hc
    return np.asarray(np.linalg.pinv(H, rcond=1e-10, hermitian=True) @ h * fit.column)
