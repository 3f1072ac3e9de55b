"""Model discrepancy: the error of a stiffness on new poses, as a probabilistic model of missing effects.

The residuals r of the readings are explained by the errors of the springs and by all effects that may be missing
(:mod:`machopt.stiffness.discrepancy_columns`):

    r = A x + B u + e,   x free,   u ~ N(0, Λ),   Λ = (λ · size)²

There is one λ for elastic effects and one for load-dependent gear stiffness. They are estimated by restricted maximum
likelihood (Patterson & Thompson 1971), e from replicates together with all columns; both are averaged over a grid of
λ. Kennedy & O'Hagan 2001 call such a part model discrepancy. Here it is no process over space but over the machine's
interfaces, so that two redundancy angles of one job share what they physically share. The posterior of (x, u), mean μ
and covariance S, is stored in stiffness.yaml. The values in the file stay those of the model; predictions get the
uncertainty of μ and S.

Two measures keep S realistic although the assumed effects are not exact. The data part of S is cluster-robust (one
cluster per pose, as in :mod:`machopt.measurement.identification.assessment.coefficient_uncertainty`, if larger). What
cross-validation over regions of poses shows beyond S and noise is added as ``local``, an independent compliance of
every pose.

If the springs explain the readings (twice the log-likelihood rises by less than ``LEVELS.gain_three_sigma``), all
effects are dropped except one: the effect of weight and load on posture and lever arms (``loaded``). It is present in
every arm, known to first order, and small loads hide it without reducing it. With known masses it is included in full
with a prior of 1 ± PRIOR_LOADED. A file with ``geometric_stiffness`` already includes the load's part; the rest
stays in ``loaded``.

Backlash is treated separately. Load tests whose total torques never change sign do not show it, but a job whose
torques do is fully affected. Therefore each model is complemented by variants with typical backlash in one gear, with
a prior probability of one in four. Readings with a torque reversal soon rule it out. The test whether springs explain
the readings excludes these variants, because backlash would absorb part of a nonlinear stiffness.

A gear law in the file was fitted to these readings, and another law might have fitted as well. There the test proves
less: every λ counts by its likelihood, and so does ``local``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.discrepancy_names import JOINT, format_joint_name, format_term_name, parse_discrepancy_name
from machopt.data_types.stiffness import ArmStiffness, ModelDiscrepancy
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.estimation.error_clusters import (
    ErrorClusters,
    NormalEquations,
    VarianceComponents,
    build_normal_equations,
    sum_channel_equations,
)
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.variance_components import estimate_variance_components
from machopt.measurement.identification.assessment.discrepancy_prior import ScaledColumns, build_scaled_columns
from machopt.measurement.identification.assessment.hysteresis_half_width import (
    add_arrival_side,
    estimate_loop_half_widths,
)
from machopt.measurement.identification.assessment.prior_spread_models import (
    GRID,
    LambdaLikelihood,
    average_models,
    compute_log_likelihood,
    rate_spreads,
    select_possible_columns,
)
from machopt.measurement.identification.assessment.sparse_discrepancy import generate_sparse_spreads, list_places
from machopt.measurement.identification.assessment.unmodelled_pose_variance import DIRECTIONS, estimate_pose_variance
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.discrepancy_columns import PLAY_COLUMN, DiscrepancyColumns

BACKLASH_PRIOR_ODDS = 1.0 / 3.0  # prior odds of backlash
MAX_DROPPED_VARIANCE = 1e-6  # share of the variance over the measured poses that omitted modes may have
BLOCKS = 4  # regions along each direction
LEAST_WEIGHT = 1e-3  # least weight of a λ relative to the best one


@dataclass(frozen=True, kw_only=True)
class ResidualReadings:
    """Residuals of a model on a recording, with their weights."""

    residual: Array  # (N, D) m, rad
    wrench: Array  # (N, 6)
    clusters: ErrorClusters
    precision: Array  # (C, N, 3, 3) inverse covariance of a single reading's error
    robust: Array  # (N, D) outlier weights in [0, 1]
    components: tuple[VarianceComponents, ...]  # estimated with the springs alone
    stated: tuple[bool, ...]  # whether the uncertainty is stated, by channel


@dataclass(frozen=True, kw_only=True)
class DiscrepancyEstimate:
    """Model discrepancy, and the error of the joint springs."""

    discrepancy: ModelDiscrepancy
    spring_error: Array  # (n, n) mean square error of the joint compliances, (rad/(N·m))²


def estimate_model_discrepancy(
    suspects: DiscrepancyColumns, state: ArmState, k: Array, readings: ResidualReadings
) -> DiscrepancyEstimate:
    """Estimate the model discrepancy; if the readings show none, that of the model's own coefficients.

    Args:
        suspects: Columns of possible effects; its ``names`` are those of the model's own coefficients.
        state: Arm states of the readings, with bodies.
        k: (6,) joint stiffness of the model, N·m/rad.
        readings: Residuals of the model.

    Returns:
        The discrepancy. Its modes leave out what moves no TCP, such as torsion of the base against joint 1; the error
        of the springs contains that.
    """
    columns = build_scaled_columns(suspects, state, k, readings.wrench, readings.residual.shape[1])
    unit, names = columns.unit, columns.names
    readings = replace(readings, residual=readings.residual - columns.Z @ columns.known)  # from the prior mean
    equations, noise, scatter = _build_normal_equations(columns.Z, readings)
    H, h = equations.total()
    has_gear_laws = bool(suspects.terms)  # with fitted gear laws a remainder is always possible
    models, misfit = _select_models(H, h, columns, has_gear_laws=has_gear_laws)
    mean, covariance = average_models(equations, models + _list_backlash_variants(H, h, models, columns))
    modes = select_significant_modes(covariance, _compute_displacement_metric(H, names))
    keep = np.abs(covariance).sum(axis=0) > 0
    left = readings.residual[:, :3][readings.robust[:, :3] > thresholds.SHARES.majority]
    local = 0.0
    if misfit or has_gear_laws:
        likeliest = max(models, key=lambda model: model[0])[1]
        in_use = select_possible_columns(H, likeliest)
        local = _estimate_local_discrepancy(columns.Z, state.q, readings, equations, in_use, scatter)
    discrepancy = ModelDiscrepancy(
        parts=tuple(n for n, used in zip(names, keep, strict=True) if used),
        torque=suspects.torque,
        shift=((mean + columns.known) * unit)[keep],
        modes=(modes * unit)[:, keep],
        left=float(np.sqrt(np.mean(left**2))) if left.size else 0.0,
        noise=noise,
        misfit=misfit,
        local=local,
    )
    springs = np.s_[: state.q.shape[1]]
    return DiscrepancyEstimate(
        discrepancy=discrepancy,
        spring_error=(covariance + np.outer(mean, mean))[springs, springs] * np.outer(unit[springs], unit[springs]),
    )


def _select_models(
    H: Array, h: Array, columns: ScaledColumns, *, has_gear_laws: bool
) -> tuple[list[LambdaLikelihood], bool]:
    """Return the models whose likelihood is near the best one's, and whether the springs leave a misfit."""
    rated = rate_spreads(H, h, columns.group)
    plain = next(model for model in rated if model[2] == 0.0)  # springs and the effect of the load itself
    misfit = bool(2.0 * (max(model[0] for model in rated) - plain[0]) >= thresholds.LEVELS.gain_three_sigma)
    if not misfit and not has_gear_laws:
        rated = [plain]
    if misfit:
        places, score = list_places(columns.names, columns.own), partial(compute_log_likelihood, H, h)
        sparse = generate_sparse_spreads(plain[1], places, GRID[1:], score)
        rated += [(likelihood, spread, 1.0) for likelihood, spread in sparse]
    top = max(model[0] for model in rated)
    return [model for model in rated if model[0] > top + np.log(LEAST_WEIGHT)], misfit


def _list_backlash_variants(
    H: Array, h: Array, models: Sequence[LambdaLikelihood], columns: ScaledColumns
) -> list[LambdaLikelihood]:
    """Return each model with typical backlash in one gear, for each gear."""
    return [one for m in models for one in _add_usual_backlash(H, h, m, columns.names, columns.usual)]


def _compute_displacement_metric(H: Array, names: Sequence[str]) -> Array:
    """Return the mean square displacement of columns at the measured poses; backlash counts at least as its joint's
    spring.
    """
    out = H + 1e-12 * np.trace(H) * np.eye(len(H))
    for n, part in enumerate(parse_discrepancy_name(name) for name in names):
        if part.kind == PLAY_COLUMN:
            spring = names.index(format_joint_name(JOINT, part.numbers[0] + 1))
            out[n, n] += H[spring, spring]
    return np.asarray(out)


def _add_usual_backlash(
    H: Array, h: Array, model: LambdaLikelihood, names: Sequence[str], usual: Array
) -> list[LambdaLikelihood]:
    """Return the model with typical backlash in one gear, for each gear, with its likelihood."""
    out = []
    for n, name in enumerate(names):
        if parse_discrepancy_name(name).kind == PLAY_COLUMN and usual[n] > model[1][n]:
            spread = model[1].copy()
            spread[n] = usual[n]
            out.append((compute_log_likelihood(H, h, spread) + float(np.log(BACKLASH_PRIOR_ODDS)), spread, model[2]))
    return out


def _split_into_regions(r: ResidualReadings, q: Array) -> list[NDArray[np.intp]]:
    """Return blocks of poses along the two principal directions of the joint angles, for cross-validation."""
    at = np.array([q[r.clusters.readings(g)[0]] for g in range(r.clusters.poses)])
    at = at - at.mean(axis=0)
    axes = np.linalg.svd(at, full_matrices=False)[2][:DIRECTIONS]
    return [part for a in axes for part in np.array_split(np.argsort(at @ a, kind="stable"), BLOCKS) if len(part)]


def _estimate_local_discrepancy(
    Z: Array, q: Array, r: ResidualReadings, e: NormalEquations, found: tuple[NDArray[np.intp], Array], scatter: Array
) -> float:
    """Return the excess error (m/N per coordinate) of left-out regions beyond prediction uncertainty and noise.

    Args:
        found: Columns in use, and their precision by all poses.
        scatter: (N,) variance of the three translations of a reading together, m².
    """
    use, P = found
    H, h = e.H[:, use][:, :, use], e.h[:, use]
    regions = []
    for region in _split_into_regions(r, q):
        rows = np.flatnonzero(np.isin(r.clusters.pose, region))
        rows = rows[(r.robust[rows, :3] > thresholds.SHARES.majority).all(axis=1)]
        S = np.linalg.inv(P - H[region].sum(axis=0))
        X = Z[rows, :3][:, :, use]
        left = r.residual[rows, :3] - X @ (S @ (h.sum(axis=0) - h[region].sum(axis=0)))
        expected = np.einsum("nci,ij,ncj->n", X, S, X, optimize=True) + scatter[rows]
        regions.append([np.sum(left**2), expected.sum(), 3.0 * np.sum(r.wrench[rows, :3] ** 2)])
    return float(np.sqrt(estimate_pose_variance(*np.array(regions).T)))


def _build_normal_equations(Z: Array, r: ResidualReadings) -> tuple[NormalEquations, float, Array]:
    """Return the normal equations of all columns with replicate noise, that noise (m per coordinate), and the
    variance (N,) m²

    of the three translations of each reading.
    """
    out: NormalEquations | None = None
    noise, scatter = 0.0, np.zeros(len(Z))
    for c in range(len(r.precision)):
        rows = slice(3 * c, 3 * c + 3)
        count = float(r.robust[:, rows].sum())
        found = r.components[c]
        part = sum_channel_equations(r.clusters, r.precision[c], Z[:, rows], r.residual[:, rows], count)
        typical = float(1.0 / np.median(r.precision[c][:, [0, 1, 2], [0, 1, 2]]))
        if count > thresholds.COUNTS.min_equations_per_unknown * Z.shape[2]:
            found = estimate_variance_components(r.clusters, part, typical, stated=r.stated[c])
        if c == 0:
            noise = float(np.sqrt(found.scale * (typical + found.cycle + found.visit)))
            own = np.trace(np.linalg.inv(r.precision[c]), axis1=1, axis2=2)
            scatter = found.scale * (own + 3.0 * (found.cycle + found.visit))
        each = build_normal_equations(r.clusters, part, found)
        out = each if out is None else out.add(each)
    assert out is not None
    return out, noise, scatter


def select_significant_modes(covariance: Array, metric: Array) -> Array:
    """Decompose a covariance into modes and drop those with a negligible effect at the measured poses.

    Args:
        covariance: (K, K) covariance of the coefficients.
        metric: (K, K) mean square displacement per unit of the coefficients.

    Returns:
        (R, K) modes m with Σ mᵀm equal to the covariance.
    """
    values, vectors = np.linalg.eigh(metric)
    root = (vectors * np.sqrt(np.maximum(values, 1e-15 * values[-1]))) @ vectors.T
    back = (vectors / np.sqrt(np.maximum(values, 1e-15 * values[-1]))) @ vectors.T
    power, along = np.linalg.eigh(root @ covariance @ root)
    order = np.argsort(power)[::-1]
    power, along = np.maximum(power[order], 0.0), along[:, order]
    last = int(np.searchsorted(np.cumsum(power), (1.0 - MAX_DROPPED_VARIANCE) * power.sum())) + 1
    return np.asarray((back @ (along[:, :last] * np.sqrt(power[:last]))).T)


def estimate_identification_discrepancy(
    fit: StiffnessFit,
    tests: LoadTestExperiment,
    robot: Robot,
    T_flange_tcp: Array,
    stiffness: ArmStiffness,
    masses: RobotMasses | None,
    limits: tuple[Array, Array] | None = None,
) -> ModelDiscrepancy:
    """Estimate the model discrepancy of an identified stiffness.

    Args:
        fit: Fit with the weights of the readings; the residuals are recomputed with the final values.
        tests: Load tests in base axes.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        stiffness: Stiffness as it will be written.
        masses: Link and tool masses; None if unknown.
        limits: Lower and upper joint limits (6,) rad, within which a term must be stable; None: any angle.

    Returns:
        The discrepancy.
    """
    arm = ArmElasticity(robot, T_flange_tcp, stiffness, limits, masses)
    predicted = arm.evaluate(tests.state.q).compute_twist(tests.wrench)[:, : tests.dimensions]
    suspects = list_coefficient_suspects(arm, tests, masses)
    w = fit.weighting
    uncertainty = tests.uncertainty
    readings = ResidualReadings(
        residual=tests.measured - predicted,
        wrench=tests.wrench,
        clusters=fit.clusters,
        precision=w.precision,
        robust=w.robust,
        components=w.components,
        stated=(uncertainty.displacement is not None, uncertainty.rotation is not None)[: len(w.covariance)],
    )
    found = estimate_model_discrepancy(suspects, tests.state, stiffness.joints, readings)
    return add_arrival_side(found.discrepancy, estimate_loop_half_widths(tests, w.robust))


def list_coefficient_suspects(
    arm: ArmElasticity, tests: LoadTestExperiment, masses: RobotMasses | None
) -> DiscrepancyColumns:
    """Build the columns of a model's own coefficients.

    Args:
        arm: Elastic model of the arm.
        tests: Load tests in base axes.
        masses: Link and tool masses; None if unknown.

    Returns:
        The columns.
    """
    torque = np.abs(np.einsum("nci,nc->ni", tests.state.J, tests.wrench))
    typical = np.quantile(torque, 0.9, axis=0)
    own = [format_joint_name(JOINT, j) for j in range(1, tests.joint_count + 1)]
    own += [format_term_name(n, p) for n, t in enumerate(arm.terms) for p in range(len(t.coefficients))]
    return DiscrepancyColumns(
        robot=arm.robot,
        T_flange_tcp=arm.T_flange_tcp,
        names=tuple(own),
        torque=np.maximum(typical, 1e-3 * max(float(typical.max()), 1e-9)),
        terms=arm.terms,
        masses=masses,
        geometric=arm.geometric,
    )
