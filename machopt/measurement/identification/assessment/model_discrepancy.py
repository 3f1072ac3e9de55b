"""What a stiffness leaves on poses it has not seen, as an uncertainty of what it may lack.

The readings less the model, r, are held against the springs' errors and everything that may be missing
(:mod:`machopt.stiffness.discrepancy_columns`):

    r = A x + B u + e,   x free,   u ~ N(0, Λ),   Λ = (λ · size)²

λ, one for what is elastic and one for gears whose softness depends on the load, is found by restricted maximum
likelihood (Patterson & Thompson 1971), e from replicates beside all columns at once; both are weighed over a grid of λ
(Kennedy & O'Hagan 2001 call such a part discrepancy; here it is no process over space but over the machine's own
interfaces, so that two rotations of one job share what they really share). What is known of (x, u) afterwards, mean μ
and covariance S, is what stiffness.yaml takes on: the file's numbers stay those of the model, and everything that is
predicted from them is uncertain by μ and S.

Two things keep S honest where the suspects are no exact law of what is missing: the readings' part of it is cluster-
robust (one cluster a pose, as in :mod:`machopt.measurement.identification.assessment.coefficient_uncertainty`, where
that is larger), and what regions of
poses that are left out show beyond S and noise counts as ``local``, a compliance that any other pose has for itself,
with how badly a handful of regions tells it.

Where springs explain the readings (twice the log-likelihood rises by less than ``IDENTIFIED.misfit``) no suspect stays,
but one: what weight and load do to posture and lever arms (``loaded``) is no suspicion. It is there in every arm, to
first order as written down, and small loads hide it from the readings without making it any smaller. Where masses are
known it counts in full, 1 ± PRIOR_LOADED before the readings are asked, and the springs' own errors with what it took
from them. A file with ``geometric_stiffness`` counts the load's own part already, without the weight; the rest is left
to ``loaded``.

Nor is the play of a gear a matter of what explains the readings: load tests whose torques never change sign, the weight
counted, say nothing of it, and a job whose torques do meets all of it. So beside each model stands the same with the
usual play in one gear, one time in four before the readings are asked; those that cross it soon rule it out.
Whether springs explain the readings is asked without: plays, whose form is no knee's, would take in enough of one.

A gear whose law is named in the file was bent to these very readings, and some other law of it, or a second gear that
the named one took in, would have fitted as well. There springs and laws that explain the readings prove less: every λ
counts by its likelihood, however little that rises, and so does ``local``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from machopt.data_types.discrepancy_names import (
    JOINT,
    LOADED,
    format_joint_name,
    format_term_name,
    parse_discrepancy_name,
)
from machopt.data_types.stiffness import ArmStiffness, ModelDiscrepancy
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.measurement.estimation.error_clusters import (
    ErrorClusters,
    NormalEquations,
    VarianceComponents,
    build_normal_equations,
    sum_channel_equations,
)
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.variance_components import estimate_variance_components
from machopt.measurement.identification import thresholds
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.discrepancy_columns import (
    PLAY_COLUMN,
    TYPICAL_PLAY_RAD,
    DiscrepancyColumns,
    compute_typical_sizes,
    list_elastic_columns,
    list_gear_columns,
)

GRID = np.concatenate([[0.0], np.logspace(-2.5, 0.5, 13)])  # λ; 1: as soft as the joints beside it
UNKNOWN_COMPLIANCE_SIGMA = 1.0  # 1 sigma of a joint's compliance that no reading shows, as a share of the file's
FITTED_COEFFICIENT_SIGMA = 3.0  # the same of a coefficient that was found: next to nothing is known before
PRIOR_LOADED = 0.25  # 1 sigma of ``loaded``, known to be 1: masses in a URDF are good to 15 %, and it is of first order
BACKLASH_PRIOR_ODDS = 1.0 / 3.0  # odds that a gear has some before the readings are asked
MAX_DROPPED_VARIANCE = (
    1e-6  # of the variance over the readings' poses that the modes left out may have; a job goes elsewhere
)
DIRECTIONS = 2  # along which poses are parted into regions: every pose is in one of each
BLOCKS = 4  # regions along either direction
LEAST_WEIGHT = 1e-3  # of a λ beside the best


LambdaLikelihood = tuple[float, Array, float]  # log-likelihood, 1 sigma of every column beforehand, sum of both λ


@dataclass(frozen=True, kw_only=True)
class ResidualReadings:
    """What a model left of a recording."""

    residual: Array  # (N, D) m, rad
    wrench: Array  # (N, 6)
    clusters: ErrorClusters
    precision: Array  # (C, N, 3, 3) inverse covariance of each reading's own error
    robust: Array  # (N, D) in [0, 1]
    components: tuple[VarianceComponents, ...]  # found beside the springs alone
    stated: tuple[bool, ...]  # one a channel


def estimate_model_discrepancy(
    suspects: DiscrepancyColumns, state: ArmState, k: Array, readings: ResidualReadings
) -> ModelDiscrepancy:
    """What a model may lack; of the model's own coefficients alone where readings say nothing against it.

    Args:
        suspects: its ``names`` are those of the model's own coefficients.
        state: ArmState of the readings, with bodies.
        k: (6,) N·m/rad of the model.
        readings: what it left.
    """
    own = len(suspects.names)
    weighed = suspects.masses is not None
    more = (*list_elastic_columns(), *list_gear_columns(), *([LOADED] if weighed else []))
    whole = replace(suspects, names=(*suspects.names, *more))
    N, D = readings.residual.shape
    Z = whole.compute_columns(state, np.broadcast_to(k, (N, 6)), readings.wrench)[:, :D]
    size = compute_typical_sizes(whole, state, k, more)
    unit = np.concatenate([_compute_prior_sigma(suspects, k), size])
    Z = Z * unit
    known = np.zeros(len(unit))
    known[own + len(more) - 1] = float(weighed)
    readings = replace(
        readings, residual=readings.residual - Z @ known
    )  # from here on the deviation from what is known
    group = np.array([0] * own + [{True: 2}.get(n in list_gear_columns(), 3 if n == LOADED else 1) for n in more])
    usual = np.array(
        [TYPICAL_PLAY_RAD if parse_discrepancy_name(n).kind == PLAY_COLUMN else 0.0 for n in whole.names]
    ) / np.maximum(unit, 1e-300)
    equations, noise, scatter = _build_normal_equations(Z, readings)
    H, h = equations.total()
    best: list[LambdaLikelihood] = []
    for elastic, gears in product(GRID, GRID):
        spread = np.array([UNKNOWN_COMPLIANCE_SIGMA, elastic, gears, PRIOR_LOADED])[group]
        best.append((_compute_log_likelihood(H, h, spread), spread, elastic + gears))
    plain = next(b for b in best if b[2] == 0.0)  # springs, and the load's own doing
    misfit = bool(2.0 * (max(b[0] for b in best) - plain[0]) >= thresholds.IDENTIFIED.misfit)
    named = bool(suspects.terms)  # what a name leaves out is never known to be nothing
    if not misfit and not named:
        best = [plain]
    top = max(b[0] for b in best)
    near = [b for b in best if b[0] > top + np.log(LEAST_WEIGHT)]
    near += [one for b in near for one in _add_usual_backlash(H, h, b, whole.names, usual)]
    share = np.exp(np.array([b[0] for b in near]) - max(b[0] for b in near))
    share /= share.sum()
    mean, second = np.zeros(len(h)), np.zeros_like(H)
    for w, (_, spread, _) in zip(share, near, strict=True):
        use, P = _select_possible_columns(H, spread)
        S = np.asarray(np.linalg.inv(P), float)
        x = np.zeros(len(h))
        x[use] = S @ h[use]
        mean += w * x
        second[np.ix_(use, use)] += w * _robustify_information(equations, use, S, x)
        second += w * np.outer(x, x)
    covariance = second - np.outer(mean, mean)
    modes = select_significant_modes(covariance, _compute_displacement_metric(H, whole.names))
    keep = np.abs(covariance).sum(axis=0) > 0
    likeliest = max(best, key=lambda b: b[0])[1]
    left = readings.residual[:, :3][readings.robust[:, :3] > thresholds.IDENTIFIED.out]
    return ModelDiscrepancy(
        parts=tuple(n for n, used in zip(whole.names, keep, strict=True) if used),
        torque=suspects.torque,
        shift=((mean + known) * unit)[keep],
        modes=(modes * unit)[:, keep],
        left=float(np.sqrt(np.mean(left**2))) if left.size else 0.0,
        noise=noise,
        misfit=misfit,
        local=_estimate_local_discrepancy(
            Z, state.q, readings, equations, _select_possible_columns(H, likeliest), scatter
        )
        if misfit or named
        else 0.0,
    )


def _compute_displacement_metric(H: Array, names: Sequence[str]) -> Array:
    """What columns move at the readings' poses; a play no less than its joint's spring, as where a job meets it."""
    out = H + 1e-12 * np.trace(H) * np.eye(len(H))
    for n, part in enumerate(parse_discrepancy_name(name) for name in names):
        if part.kind == PLAY_COLUMN:
            spring = names.index(format_joint_name(JOINT, part.numbers[0] + 1))
            out[n, n] += H[spring, spring]
    return np.asarray(out)


def _add_usual_backlash(
    H: Array, h: Array, model: LambdaLikelihood, names: Sequence[str], usual: Array
) -> list[LambdaLikelihood]:
    """The same model with the usual play in one gear, gear by gear, by how likely that is beside it."""
    out = []
    for n, name in enumerate(names):
        if parse_discrepancy_name(name).kind == PLAY_COLUMN and usual[n] > model[1][n]:
            spread = model[1].copy()
            spread[n] = usual[n]
            out.append((_compute_log_likelihood(H, h, spread) + float(np.log(BACKLASH_PRIOR_ODDS)), spread, model[2]))
    return out


def _compute_log_likelihood(H: Array, h: Array, spread: Array) -> float:
    """Logarithm, of the readings, but for what all models share."""
    use, P = _select_possible_columns(H, spread)
    L = np.linalg.cholesky(P)
    half = np.linalg.solve(L, h[use])
    return -float(np.log(np.diag(L)).sum() + np.log(spread[use]).sum()) + 0.5 * float(half @ half)


def _select_possible_columns(H: Array, spread: Array) -> tuple[NDArray[np.intp], Array]:
    """Columns that may be there, and their precision by all readings and by what is known beforehand."""
    use = np.flatnonzero(spread > 0)
    return use, np.asarray(H[np.ix_(use, use)] + np.diag(spread[use] ** -2.0))


def _compute_prior_sigma(suspects: DiscrepancyColumns, k: Array) -> Array:
    """(P,) 1 sigma of the model's own coefficients before the readings are asked; zero for one that is zero."""
    c = 1.0 / np.asarray(k, float)
    out = []
    for name in suspects.names:
        part = parse_discrepancy_name(name)
        if part.kind == JOINT:
            out.append(c[part.numbers[0]])
        else:
            n, p = part.numbers
            out.append(FITTED_COEFFICIENT_SIGMA * abs(float(suspects.terms[n].values[p])))
    return np.array(out)


def _robustify_information(equations: NormalEquations, use: NDArray[np.intp], S: Array, x: Array) -> Array:
    """S with the readings' part of it by the scatter of the poses' scores, where that is larger (never smaller)."""
    H, h = equations.H[:, use][:, :, use], equations.h[:, use]
    scores = h - H @ x[use]
    more = S @ (scores.T @ scores - H.sum(axis=0)) @ S
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return np.asarray(S + (vectors * np.maximum(values, 0.0)) @ vectors.T)


def _split_into_regions(r: ResidualReadings, q: Array) -> list[NDArray[np.intp]]:
    """Poses in blocks along the two directions in which their joints differ most, to be left out together."""
    at = np.array([q[r.clusters.readings(g)[0]] for g in range(r.clusters.poses)])
    at = at - at.mean(axis=0)
    axes = np.linalg.svd(at, full_matrices=False)[2][:DIRECTIONS]
    return [part for a in axes for part in np.array_split(np.argsort(at @ a, kind="stable"), BLOCKS) if len(part)]


def _estimate_local_discrepancy(
    Z: Array, q: Array, r: ResidualReadings, e: NormalEquations, found: tuple[NDArray[np.intp], Array], scatter: Array
) -> float:
    """m/N of a coordinate that regions left out show beyond what the others, and noise, make of them.

    Args:
        found: columns in use and their precision by all poses.
        scatter: (N,) m², variance of a reading's three translations together.
    """
    use, P = found
    H, h = e.H[:, use][:, :, use], e.h[:, use]
    regions = []
    for region in _split_into_regions(r, q):
        rows = np.flatnonzero(np.isin(r.clusters.pose, region))
        rows = rows[(r.robust[rows, :3] > thresholds.IDENTIFIED.out).all(axis=1)]
        S = np.linalg.inv(P - H[region].sum(axis=0))
        X = Z[rows, :3][:, :, use]
        left = r.residual[rows, :3] - X @ (S @ (h.sum(axis=0) - h[region].sum(axis=0)))
        expected = np.einsum("nci,ij,ncj->n", X, S, X, optimize=True) + scatter[rows]
        regions.append([np.sum(left**2), expected.sum(), 3.0 * np.sum(r.wrench[rows, :3] ** 2)])
    return float(np.sqrt(estimate_pose_variance(*np.array(regions).T)))


def estimate_pose_variance(left: Array, expected: Array, force: Array) -> float:
    """(m/N)² that a pose has for itself, by regions left out whose squares are ``expected`` + variance · ``force``.

    A region counts by one over what is expected of it, else one of which the others know little drowns all others
    (first step of Paule & Mandel 1982). A handful of regions tells a variance badly, and the likeliest value, often
    zero, is what a job is least safe with: taken is the mean of all that are not negative, under the standard error
    that the regions' own scatter shows.

    Args:
        left: (R,) m², sum of squares of a region's readings.
        expected: (R,) m².
        force: (R,) N².
    """
    told = (expected > 0) & (force > 0)
    if not told.any():
        return 0.0
    beyond, per_newton = left[told] / expected[told] - 1.0, force[told] / expected[told]
    found = float(beyond.sum() / per_newton.sum())
    count = len(beyond)
    if count < 2:
        return max(found, 0.0)
    off = float(np.sum((beyond - found * per_newton) ** 2)) * count / (count - 1)
    error = float(np.sqrt(DIRECTIONS * off) / per_newton.sum())
    if not error > 0:
        return max(found, 0.0)
    away = found / error
    mean = found + error * float(np.exp(-0.5 * away**2 - log_ndtr(away)) / np.sqrt(2.0 * np.pi))
    return max(mean, 0.0)  # rounding, far below zero


def _build_normal_equations(Z: Array, r: ResidualReadings) -> tuple[NormalEquations, float, Array]:
    """Normal equations of all columns under the noise that replicates show; that noise, m a coordinate; and (N,) m² of
    the three translations of each reading."""
    out: NormalEquations | None = None
    noise, scatter = 0.0, np.zeros(len(Z))
    for c in range(len(r.precision)):
        rows = slice(3 * c, 3 * c + 3)
        count = float(r.robust[:, rows].sum())
        found = r.components[c]
        part = sum_channel_equations(r.clusters, r.precision[c], Z[:, rows], r.residual[:, rows], count)
        typical = float(1.0 / np.median(r.precision[c][:, [0, 1, 2], [0, 1, 2]]))
        if count > thresholds.IDENTIFIED.replicates * Z.shape[2]:
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
    """(R, K) with Σ mᵀm the covariance, those left out that hardly move anything at the readings' poses."""
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
    """What an identified stiffness may lack.

    Args:
        fit: how the readings count; their residual is taken anew, of what the file will say.
        tests: the readings.
        robot, T_flange_tcp: the arm.
        stiffness: as it will be written.
        masses: of links and tool; None where they are not known.
        limits: lower and upper (6,) rad, where a term has to be a spring; None: at any angle.
    """
    arm = ArmElasticity(robot, T_flange_tcp, stiffness, limits, masses)
    said = arm.evaluate(tests.state.q).compute_twist(tests.wrench)[:, : tests.dimensions]
    suspects = list_coefficient_suspects(arm, tests, masses)
    w = fit.weighting
    told = tests.uncertainty
    readings = ResidualReadings(
        residual=tests.measured - said,
        wrench=tests.wrench,
        clusters=fit.clusters,
        precision=w.precision,
        robust=w.robust,
        components=w.components,
        stated=(told.displacement is not None, told.rotation is not None)[: len(w.covariance)],
    )
    return estimate_model_discrepancy(suspects, tests.state, stiffness.joints, readings)


def list_coefficient_suspects(
    arm: ArmElasticity, tests: LoadTestExperiment, masses: RobotMasses | None
) -> DiscrepancyColumns:
    """A model's own coefficients, as suspects."""
    torque = np.abs(np.einsum("nci,nc->ni", tests.state.J, tests.wrench))
    typical = np.quantile(torque, 0.9, axis=0)
    own = [format_joint_name(JOINT, j) for j in range(1, 7)]
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
