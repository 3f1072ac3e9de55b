"""Identifiability of each joint, and the values of joints that are not identified.

A joint is judged by the design first: the standard error expected from loads and noise, relative to the cell's
compliance. Not identified are:

- a joint that the loads hardly deflect (its error would be large even as the only unknown),
- a joint that is confounded with another unknown (its error is large because of the others),
- a joint whose interval includes zero compliance: only a lower bound of its stiffness is known.

Such a joint gets the cell's value, limited to what the readings allow; without a cell's value, the lower bound of its
stiffness. Identifiable combinations (two joints that always move together) are preserved: a weak prior pulls the
values to the cell's, and the data override it where they are informative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from machopt.data_types.stiffness import LEAST_STIFFNESS, format_joint_stiffness
from machopt.measurement import thresholds
from machopt.measurement.estimation.bounded_least_squares import minimise_bounded_quadratic
from machopt.measurement.identification.assessment.coefficient_uncertainty import NULL, CoefficientUncertainty
from machopt.measurement.identification.fitting.positive_semidefinite_fit import (
    FittedMatrix,
    fit_semidefinite_matrix,
    has_negative_compliance,
    list_fitted_matrices,
)
from machopt.measurement.identification.fitting.weighted_fit import FitCoefficient, StiffnessFit
from machopt.numerics.array_types import Array, Bools

MAX_SINGLE_COEFFICIENTS = 3  # up to this number the coefficients of a term are judged individually
PRIOR_SIGMA = 0.1  # relative standard deviation of the prior at the cell's compliance
ZERO_SIGMA = 1e-6  # the same for coefficients set to zero, relative to a typical effect


@dataclass(frozen=True)
class CoefficientStatus:
    """Identifiability of one unknown."""

    identified: bool
    reason: str  # why it is not identified; else empty
    expected: float  # relative standard error expected from the design; NaN without a reference
    inflation: float  # variance inflation factor (VIF) caused by the other unknowns; inf if confounded
    torque: float  # N·m, largest torque on the joint; NaN for terms


@dataclass(frozen=True)
class IdentifiableCombination:
    """Identifiable sum of coefficients that are not identified individually."""

    text: str
    value: float  # in the unit of its coefficients
    sigma: float


@dataclass(frozen=True, kw_only=True)
class SettledCoefficients:
    """Final coefficients, and the treatment of unidentified ones in every refit."""

    x: Array  # (P,)
    status: tuple[CoefficientStatus, ...]
    combinations: tuple[IdentifiableCombination, ...]
    pull: Array  # (P,) weight of the prior, for scaled coefficients
    target_values: Array  # (P,) prior means, scaled
    replaced: NDArray[np.bool_]  # (P,) set to ``target_values`` after solving
    covariance: Array  # (n, n) of the joint compliances; an unidentified one has 100 % uncertainty
    matrices: tuple[FittedMatrix, ...] = ()  # terms whose matrix must be positive semidefinite
    has_projected_matrices: tuple[int, ...] = ()  # terms whose fitted matrix was not and was projected

    @property
    def joint_count(self) -> int:
        """Number of joints of the arm, n; their compliances are the first coefficients."""
        return len(self.covariance)

    @property
    def compliance(self) -> Array:
        """Joint compliances (n,) rad/(N·m)."""
        return self.x[: self.joint_count]

    @property
    def joint_status(self) -> tuple[CoefficientStatus, ...]:
        """Status of each joint compliance."""
        return self.status[: self.joint_count]

    def solve(self, fit: StiffnessFit, H: Array, h: Array, *, matrices: bool = False) -> Array:
        """Solve other normal equations in the same scaled coefficients, for example without one pose.

        Args:
            fit: Weighted fit of the stiffness.
            H: (P, P) normal matrix.
            h: (P,) right-hand side.
            matrices: Whether to keep fitted matrices positive semidefinite; slow.

        Returns:
            (P,) coefficients.
        """
        H, h = H + np.diag(self.pull), h + self.pull * self.target_values
        x = minimise_bounded_quadratic(H, h, fit.lower / fit.column)
        x = np.where(self.replaced, self.target_values, x) * fit.column
        for part in self.matrices if matrices else ():
            if has_negative_compliance(part.matrix(x)):
                x = fit_semidefinite_matrix(fit, part, H, h, x, self.replaced)
        return x


def settle_coefficients(
    fit: StiffnessFit, uncertainty: CoefficientUncertainty, prior: Array | None = None
) -> SettledCoefficients:
    """Assess the identifiability of every unknown and set the values of unidentified ones.

    Args:
        fit: Fit with all unknowns free.
        uncertainty: Uncertainty of that fit.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown.

    Returns:
        The final coefficients.
    """
    P = len(fit.unknowns)
    H, h = fit.normal.total()
    ridge = NULL * float(np.diag(H).max())
    M: Array = np.asarray(np.linalg.inv(H + ridge * np.eye(P)), float)  # an unobservable direction gets a huge variance
    correlation: Array = np.asarray(M / np.sqrt(np.outer(np.diag(M), np.diag(M))), float)
    reference = np.full(P, np.nan)
    # a value that the readings certainly show also counts, in case the cell's is far too stiff
    n = fit.joint_count
    reference[:n] = np.abs(fit.compliance) if prior is None else np.maximum(1.0 / prior, uncertainty.interval[:n, 0])
    standing = tuple(_assess_coefficient(fit, uncertainty, H, M, correlation, reference, j) for j in range(P))
    standing = _check_term_significance(fit, uncertainty, standing)
    known = np.array([s.identified for s in standing])
    _keep_whole_terms(fit.unknowns, known)
    draft = _draft_coefficients(fit, uncertainty, prior, standing, known)
    x = fit.x if known.all() else draft.solve(fit, H, h)
    whole = tuple(m for m in list_fitted_matrices(fit) if known[m.first_coefficient].all())
    corrected = tuple(m.term for m in whole if has_negative_compliance(m.matrix(x)))
    if corrected:
        x = replace(draft, matrices=whole).solve(fit, H, h, matrices=True)
    joints = np.flatnonzero(known[:n])
    covariance = np.diag(x[:n] ** 2)
    covariance[np.ix_(joints, joints)] = uncertainty.covariance[np.ix_(joints, joints)]
    together = _find_identifiable_combinations(fit, H, M, correlation, known)
    return replace(
        draft,
        x=x,
        combinations=together,
        covariance=covariance,
        matrices=whole,
        has_projected_matrices=corrected,
    )


def _draft_coefficients(
    fit: StiffnessFit,
    uncertainty: CoefficientUncertainty,
    prior: Array | None,
    standing: tuple[CoefficientStatus, ...],
    known: Bools,
) -> SettledCoefficients:
    """Return the coefficients of the fit with the values to which unidentified ones (P,) are pulled or set."""
    P = len(fit.unknowns)
    pull, towards, replaced = np.zeros(P), np.zeros(P), np.zeros(P, bool)
    blind = np.abs(uncertainty.unobserved_directions).max(axis=1, initial=0.0) > 1e-6
    for j in np.flatnonzero(~known):
        if j >= fit.joint_count:  # an unidentified term is set to zero
            pull[j], replaced[j] = ZERO_SIGMA**-2, True
            continue
        k_low, k_high = uncertainty.stiffness_interval()[j]
        bound = max(k_low, LEAST_STIFFNESS)
        value = bound if prior is None else min(max(float(prior[j]), k_low), k_high)
        towards[j] = 1.0 / value / fit.column[j]
        if prior is None and not blind[j]:
            replaced[j] = True
        else:
            pull[j] = (PRIOR_SIGMA * towards[j]) ** -2
    return SettledCoefficients(
        x=fit.x,
        status=standing,
        combinations=(),
        pull=pull,
        target_values=towards,
        replaced=replaced,
        covariance=np.zeros((fit.joint_count, fit.joint_count)),
    )


def _assess_coefficient(
    fit: StiffnessFit,
    uncertainty: CoefficientUncertainty,
    H: Array,
    M: Array,
    correlation: Array,
    reference: Array,
    j: int,
) -> CoefficientStatus:
    unknown = fit.unknowns[j]
    one, among = (np.sqrt(v) * fit.column[j] if v > 0 else np.inf for v in (_invert_value(H[j, j]), M[j, j]))
    inflation = float((among / one) ** 2) if np.isfinite(one) else np.inf
    inflation = inflation if inflation < 0.01 / NULL else np.inf
    torque = np.nan
    if unknown.joint is not None:
        tau = np.einsum("nc,nc->n", fit.experiment.state.J[:, :, j], fit.experiment.wrench)
        torque = float(np.abs(tau).max())
    scale = reference[j]
    expected = float(among / scale) if scale > 0 else np.nan
    partner = _find_correlated_coefficient(fit.unknowns, correlation, uncertainty.unobserved_directions, j)
    reason = ""
    if not np.isfinite(one) or (scale > 0 and one > thresholds.SHARES.max_relative_error * scale):
        if unknown.joint is None:
            reason = "no reading shows it"
        else:
            none = torque < thresholds.LIMITS.torque
            reason = f"no reading puts {'any torque' if none else f'more than {torque:.3g} N·m'} on {unknown.name}"
            if np.isfinite(one) and scale > 0 and not none:
                reason += (
                    f", which moves the TCP by at most {1e6 * _compute_largest_displacement(fit, j, scale):.0f} µm at "
                    f"{format_joint_stiffness(1 / scale)}; a load with a longer lever arm about its axis would show it"
                )
    elif not np.isfinite(uncertainty.sigma[j]) and not partner:
        reason = "there are no more equations than unknowns: no redundancy is left to estimate its error"
    elif not np.isfinite(uncertainty.sigma[j]) or (scale > 0 and expected > thresholds.SHARES.max_relative_error):
        reason = partner or f"the readings promise no more than ± {100 * expected:.0f} % (1 sigma)"
    elif _has_interval_at_zero(unknown, uncertainty.interval[j]):
        reason = "its interval reaches zero compliance" if unknown.joint else "its interval holds zero"
        if unknown.joint is not None:
            reason += (
                f": stiffer than {format_joint_stiffness(uncertainty.stiffness_interval()[j, 0])} is all that is known"
            )
        reason += f"; it {partner}" if partner else ""
    return CoefficientStatus(not reason, reason, expected, inflation, torque)


def _find_correlated_coefficient(
    unknowns: tuple[FitCoefficient, ...], correlation: Array, unseen: Array, j: int
) -> str:
    """Return the unknown that coefficient j is confounded with; empty if there is none."""
    others = np.abs(correlation[j]).copy()
    others[j] = 0.0
    k = int(np.argmax(others))
    if unseen.shape[1] and np.abs(unseen[j]).max() > 1e-6:
        row = unseen[:, int(np.argmax(np.abs(unseen[j])))]
        names = [
            unknowns[i].name
            for i in np.flatnonzero(np.abs(row) > thresholds.SHARES.small * np.abs(row).max())
            if i != j
        ]
        return f"cannot be distinguished from {' and '.join(names)}: the readings move together" if names else ""
    if others[k] < thresholds.SHARES.inseparable_correlation:
        return ""
    return f"cannot be distinguished from {unknowns[k].name}: correlation {correlation[j, k]:.3f}"


def _find_identifiable_combinations(
    fit: StiffnessFit, H: Array, M: Array, correlation: Array, known: NDArray[np.bool_]
) -> tuple[IdentifiableCombination, ...]:
    """Return pairs of joints that are identified only in combination."""
    out = []
    for i in range(fit.joint_count):
        for j in range(i + 1, fit.joint_count):
            if known[i] or known[j] or correlation[i, j] > -thresholds.SHARES.inseparable_correlation or H[i, i] <= 0:
                continue
            weight = H[i, j] / H[i, i]  # weight of joint j's compliance relative to joint i's, scaled
            ratio = weight * fit.column[i] / fit.column[j]
            variance = M[i, i] + weight**2 * M[j, j] + 2 * weight * M[i, j]
            value = float(fit.x[i] + ratio * fit.x[j])
            sigma = float(np.sqrt(max(variance, 0.0)) * fit.column[i])
            if sigma < thresholds.SHARES.max_relative_error * abs(value):
                out.append(
                    IdentifiableCombination(
                        f"joint {i + 1} and joint {j + 1} together: c{i + 1} + {ratio:.3g} c{j + 1} = "
                        f"{value:.3g} ± {sigma:.1g} rad/(N·m)",
                        value,
                        sigma,
                    )
                )
    return tuple(out)


def _check_term_significance(
    fit: StiffnessFit, uncertainty: CoefficientUncertainty, standing: tuple[CoefficientStatus, ...]
) -> tuple[CoefficientStatus, ...]:
    """Require a more significant coefficient for terms with many: of 21 intervals at 90 %, two miss by chance."""
    out = list(standing)
    for t in range(len(fit.terms)):
        own = [p for p, u in enumerate(fit.unknowns) if u.term == t]
        known = [p for p in own if standing[p].identified]
        if len(own) <= MAX_SINGLE_COEFFICIENTS or not known:
            continue
        sure = 1.0 - (1.0 - uncertainty.level) / 2 / len(own)
        clear = [abs(fit.free[p]) > stdtrit(uncertainty.freedom[p], sure) * uncertainty.sigma[p] for p in known]
        if not any(clear):
            for p in known:
                reason = f"as far from zero as one of {len(own)} coefficients comes by chance"
                out[p] = replace(standing[p], identified=False, reason=reason)
    return tuple(out)


def _keep_whole_terms(unknowns: tuple[FitCoefficient, ...], known: NDArray[np.bool_]) -> None:
    """Keep all coefficients of a term if one is identified, so that matrices stay complete."""
    for t in {u.term for u in unknowns if u.term is not None}:
        own = np.array([u.term == t for u in unknowns])
        if known[own].any():
            known[own] = True


def _has_interval_at_zero(unknown: FitCoefficient, interval: Array) -> bool:
    low, high = interval
    return bool(low <= 0.0 <= high) if unknown.lower < 0 else bool(low <= 0.0)


def _compute_largest_displacement(fit: StiffnessFit, j: int, compliance: float) -> float:
    return float(np.linalg.norm(fit.A[:, :3, j], axis=1).max() * compliance)


def _invert_value(value: float) -> float:
    return 1.0 / value if value > 0 else 0.0
