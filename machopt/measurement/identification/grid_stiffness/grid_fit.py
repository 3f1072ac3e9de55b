"""Joint stiffness for each cell of a grid of TCP positions (jiao2022 section 2), shrunk towards a constant model.

Space is divided into cubes, each with its own six stiffnesses. On a face, edge or corner they are averaged, as in
:func:`machopt.stiffness.joint_stiffness.compute_joint_stiffness`, so a reading there informs every cell that it
touches. A cell alone would follow the noise of its readings. Therefore the log compliances of the cells have a common
distribution per joint, whose width is estimated
(:mod:`~machopt.measurement.identification.grid_stiffness.grid_marginal_likelihood`). A cell deviates from the
constant model as far as its readings support. A cell without readings stays there, with the width as its uncertainty.
If nothing varies, the grid equals the constant model. Logarithms keep every stiffness positive.

Harmonic mean and logarithm are nonlinear. Cells, prior, noise and outlier weights are found in a few rounds of
linearised problems.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.stiffness import StiffnessGrid
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.estimation.bounded_least_squares import minimise_bounded_quadratic
from machopt.measurement.estimation.error_clusters import build_normal_equations
from machopt.measurement.identification.fitting.reading_weights import ReadingWeights
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.measurement.identification.grid_stiffness.grid_cells import (
    GridRegion,
    build_grid_region,
    find_measured_cells,
    interpolate_by_kriging,
)
from machopt.measurement.identification.grid_stiffness.grid_equations import GridEquations
from machopt.measurement.identification.grid_stiffness.grid_marginal_likelihood import (
    GridLikelihood,
    add_normal_equations,
    sum_by_group,
)
from machopt.measurement.identification.grid_stiffness.grid_prior import GridPosterior, GridPrior
from machopt.numerics.array_types import Array, Bools, Ints

FACE_TOLERANCE = 1e-3  # m; tolerance for a pose on a face, about the repeatability of an arm
MIN_COLUMN_EFFECT = 1e-6  # relative to the largest response; a joint with less is not observed
MOST_CELLS = 1000  # most cells with readings; their unknowns are solved jointly
ROUNDS = 6
STEPS = (30, 10)  # optimiser steps in the first round and in later ones
DRAFT_STEPS = 5
CONVERGENCE_TOLERANCE = 0.15  # rms change of log compliances between rounds, in standard errors


@dataclass(frozen=True)
class GridHoldoutErrors:
    """Cross-validated errors by pose; prior and noise are those of all poses."""

    grid: Array  # (N, D) m, rad
    constant: Array  # (N, D)
    pose: Ints  # (N,)
    counts: Bools  # (N,) False for outliers

    @property
    def rmse(self) -> tuple[float, float]:
        """Root mean square error per translation coordinate in m: grid, constant model."""
        rows = self.counts
        return tuple(float(np.sqrt(np.mean(e[rows, :3] ** 2))) for e in (self.grid, self.constant))  # type: ignore[return-value]

    @property
    def gain(self) -> tuple[float, float]:
        """Mean square of the constant model minus that of the grid, per pose, in m², and its standard error."""
        rows = self.counts
        _, pose = np.unique(self.pose[rows], return_inverse=True)
        square = np.mean(self.constant[rows, :3] ** 2 - self.grid[rows, :3] ** 2, axis=1)
        each = np.bincount(pose, square) / np.bincount(pose)
        return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each)))


@dataclass(frozen=True, kw_only=True)
class GridFit:
    """Grid of joint stiffness with prior, uncertainty and cross-validated errors."""

    grid: StiffnessGrid  # with std
    covariance: Array  # (G, 6, 6) covariance of each cell's joint compliances, (rad/(N·m))²
    centre: Array  # (6,) N·m/rad, mean over cells (in log compliance) that cells are shrunk to
    centre_covariance: Array  # (6, 6) covariance of an unmeasured cell's compliances: error of the mean and spread
    constant: Array  # (6,) N·m/rad of the constant model; inf if its compliance is 0
    spread: Array  # (6,) 1 sigma of log compliance between cells; 0 for fixed joints
    place_spread: Array  # (6,) 1 sigma of log compliance of a site about its cell; not in ``grid.std``
    range: float  # m, correlation length (1/e); 0 for independent cells
    constant_joints: tuple[int, ...]  # joints (1 … 6) with a constant value, for lack of data
    readings: Array  # (G,) effective number of readings of a cell
    information_gain: Array  # (G, 6) 0 … 1, reduction of a cell's prior variance by the readings; 0 for fixed joints
    terms: Array  # (T,) coefficients of the terms
    heldout: GridHoldoutErrors
    weighting: ReadingWeights  # of the readings inside the grid
    inside: Bools  # (N,) True for readings inside the grid; only these are used
    rounds: int


def _build_outside_error(constant: StiffnessFit, region: GridRegion, position: Array) -> RecordingError:
    """Return the error of poses (G, 3) m that all lie outside the grid."""
    low, high = region.origin * 1e3, (region.origin + region.cell * np.array(region.shape)) * 1e3
    return RecordingError(
        f"no reading lies inside the grid {_format_point_mm(low)} to {_format_point_mm(high)} mm in "
        f"base_link; the TCPs measured lie within "
        f"{_format_point_mm(position.min(axis=0) * 1e3)} to {_format_point_mm(position.max(axis=0) * 1e3)} mm",
        file=constant.experiment.source,
    )


def _check_cell_count(count: int, cell: float, source: str) -> None:
    """Raise RecordingError where more cells of the edge length ``cell`` (m) have readings than are solved together."""
    if count > MOST_CELLS:
        raise RecordingError(
            f"the readings touch {count} cells of {cell * 1e3:g} mm, more than the {MOST_CELLS} that are "
            "solved together; larger cells would work",
            file=source,
        )


def fit_grid(
    constant: StiffnessFit,
    cell: float,
    origin: Array | None = None,
    shape: tuple[int, int, int] | None = None,
    *,
    smooth: bool = True,
    robust: bool = True,
    hold: Array | None = None,
    draft: bool = False,
) -> GridFit:
    """Identify joint stiffness that varies over a grid.

    z_g,j = log c_g,j ~ N(μ_j, s_j²); at a place touching m cells c_j = m / Σ_g k_g,j; displacements as in the
    constant model. s, correlation range and noise by restricted maximum likelihood, cells by their conditional mean.
    Not valid if stiffness depends on the arm configuration at a place rather than on the place.

    Args:
        constant: Fit of the constant model to the same readings, with terms, weights and clusters.
        cell: Edge length of a cell, m.
        origin: (3,) lowest corner in base_link, m; None: whole cells around the measured TCPs.
        shape: Number of cells along x, y, z; None: as many as needed.
        smooth: Whether to estimate a correlation between neighbouring cells; False: independent cells.
        robust: Whether to update the outliers with the cells' residuals; False: weights of the constant fit.
        hold: (6,) N·m/rad of joints with a constant value, NaN for others. A varying joint with an
            insignificant compliance (below two standard errors) is fixed too.
        draft: Whether to run only one short round, sufficient to see whether a grid improves the
            cross-validated error.

    Returns:
        The grid with standard deviations and cross-validated errors.

    Raises:
        InputError: No reading inside of the grid, too many cells, or an unobserved joint without a value.

    Source:
        jiao2022 sections 2.2, 2.3.
    """
    position, pose_of = _compute_pose_positions(constant)
    region = build_grid_region(position, cell, origin, shape, FACE_TOLERANCE, constant.experiment.source)
    inside_pose = region.contains(position, FACE_TOLERANCE)
    inside = inside_pose[pose_of]
    if not inside.any():
        raise _build_outside_error(constant, region, position)
    places = find_measured_cells(region, position[inside_pose], FACE_TOLERANCE)
    _check_cell_count(len(places.cells), cell, constant.experiment.source)
    vary, reference = _select_varying_joints(constant, hold)
    n = constant.joint_count
    fitted = constant.x[n:] > constant.lower[n:]
    while True:  # a coefficient of a term that falls below its bound is held there
        work = GridEquations.from_fit(constant, inside, places, vary, reference, smooth, fitted)
        solution = _solve_grid(work, robust=robust, draft=draft)
        below = _get_terms(work, solution) < constant.lower[n:]
        if not below.any():
            return _build_grid_fit(work, region, solution)
        fitted = fitted & ~below


@dataclass(frozen=True, kw_only=True)
class _GridSolution:
    """Most likely prior and cells of a grid."""

    evidence: GridLikelihood
    weighting: ReadingWeights
    prior: GridPrior
    posterior: GridPosterior
    rounds: int


def _solve_grid(work: GridEquations, *, robust: bool, draft: bool) -> _GridSolution:
    """Estimate prior, cells and outliers in turn; ``draft``: one short round."""
    weighting = work.start()
    prior = work.prior(weighting)
    beta = work.first_unknowns()
    for rounds in range(1, ROUNDS + 1):
        evidence = work.evidence(weighting)
        steps = DRAFT_STEPS if draft else STEPS[min(rounds - 1, 1)]
        prior = evidence.maximise(prior, work.linear(beta), steps)
        new = evidence.mode(prior, work.linear, beta)
        posterior = evidence.posterior(prior, work.linear(new))
        change = (new - beta) / np.sqrt(np.diag(posterior.covariance))
        beta = new
        if np.sqrt(np.mean(change**2)) < CONVERGENCE_TOLERANCE or rounds == ROUNDS or draft:
            break
        weighting = work.compute_reading_covariance(weighting, prior, posterior) if robust else weighting
    weighting = replace(weighting, components=prior.noise)
    return _GridSolution(evidence=evidence, weighting=weighting, prior=prior, posterior=posterior, rounds=rounds)


def _compute_pose_positions(fit: StiffnessFit) -> tuple[Array, Ints]:
    """Return the mean position (G, 3) m of each pose, and the pose index (N,) of each reading."""
    pose = fit.clusters.pose
    count = np.bincount(pose)
    at = fit.experiment.T_base_tcp[:, :3, 3]
    return np.stack([np.bincount(pose, at[:, a]) / count for a in range(3)], axis=1), pose


def _select_varying_joints(fit: StiffnessFit, hold: Array | None) -> tuple[Bools, Array]:
    """Return which joints vary (6,), and the reference compliance (6,); for fixed joints their value."""
    c = fit.compliance
    n = fit.joint_count
    is_fixed = np.full(n, np.nan) if hold is None else np.asarray(hold, float)
    M = np.linalg.pinv(fit.normal.total()[0], hermitian=True)
    sigma = np.sqrt(np.maximum(np.diag(M)[:n], 0.0)) * fit.column[:n]
    seen = np.abs(fit.A[..., :n]).max(axis=(0, 1)) * c.max() > MIN_COLUMN_EFFECT * np.abs(fit.y).max()
    vary = ~np.isfinite(is_fixed) & seen & (c > thresholds.LEVELS.two_sigma * sigma)
    blind = ~np.isfinite(is_fixed) & ~seen
    if blind.any():
        raise RecordingError(
            f"no reading moves joint {_format_joint_list(blind)}, so that a grid needs its stiffness from "
            f"elsewhere (hold)",
            file=fit.experiment.source,
        )
    if not vary.any():
        raise RecordingError(
            f"no joint's compliance is known to better than 1/{thresholds.LEVELS.two_sigma:g} of itself; there is "
            "nothing to vary by cell. More readings, or larger loads, would work",
            file=fit.experiment.source,
        )
    value = np.where(np.isfinite(is_fixed), 1.0 / np.where(np.isfinite(is_fixed), is_fixed, 1.0), np.maximum(c, sigma))
    return vary, np.where(vary, c, value)


@dataclass(frozen=True, kw_only=True)
class _CellLogarithms:
    """Logarithms of the compliances relative to the reference, and their covariances, of G cells and F joints."""

    cells: Array  # (G, 6)
    covariance: Array  # (G, 6, 6)
    centre: Array  # (F,) of the estimated mean, joints that vary
    centre_covariance: Array  # (F, F) with the variance of a cell about it
    information_gain: Array  # (G, 6)


def _predict_cells(
    work: GridEquations, region: GridRegion, prior: GridPrior, posterior: GridPosterior
) -> _CellLogarithms:
    """Return every cell of the region from the measured ones, by kriging."""
    vary, used = work.varying_joints, work.places.cells
    F, C, G = int(vary.sum()), len(used), len(region)
    weight, left, mean, unsure = interpolate_by_kriging(region, used, prior.range if work.smooth else 0.0)
    z, cov = posterior.beta[: C * F].reshape(C, F), posterior.covariance[: C * F, : C * F].reshape(C, F, C, F)
    spread2 = prior.spread**2
    # covariance of a cell: propagated errors of the measured cells plus the kriging variance
    full = np.einsum("gc,cidj,gd->gij", weight, cov, weight, optimize=True)
    full += left[:, None, None] * np.diag(spread2)
    centre_cov = np.einsum("c,cidj,d->ij", mean, cov, mean, optimize=True) + unsure * np.diag(spread2)
    n = len(vary)
    log_c, log_cov, learned = np.zeros((G, n)), np.zeros((G, n, n)), np.zeros((G, n))
    log_c[:, vary] = weight @ z
    log_cov[np.ix_(np.arange(G), vary, vary)] = full
    # prior variance of a cell about the estimated mean; undefined for a single cell
    apart = spread2 + np.diag(centre_cov)
    learned[:, vary] = np.clip(1.0 - np.diagonal(full, axis1=1, axis2=2) / apart, 0.0, 1.0)
    return _CellLogarithms(
        cells=log_c,
        covariance=log_cov,
        centre=mean @ z,
        centre_covariance=centre_cov + np.diag(spread2),
        information_gain=learned,
    )


def _build_grid_fit(work: GridEquations, region: GridRegion, solution: _GridSolution) -> GridFit:
    fit, vary = work.constant, work.varying_joints
    prior, posterior, weighting = solution.prior, solution.posterior, solution.weighting
    predicted = _predict_cells(work, region, prior, posterior)
    log_cov = predicted.covariance
    c = work.reference * np.exp(predicted.cells)
    sigma = np.sqrt(np.diagonal(log_cov, axis1=1, axis2=2))
    n = fit.joint_count
    centre, around, spread = np.ones(n), np.zeros((n, n)), np.zeros(n)
    centre[vary] = np.exp(predicted.centre)
    centre *= work.reference
    around[np.ix_(vary, vary)] = predicted.centre_covariance
    spread[vary] = prior.spread
    with np.errstate(divide="ignore"):
        constant = 1.0 / fit.compliance
    return GridFit(
        grid=StiffnessGrid(region.origin, region.cell, region.shape, 1.0 / c, sigma / c),
        covariance=c[:, :, None] * c[:, None, :] * log_cov,
        centre=1.0 / centre,
        centre_covariance=np.outer(centre, centre) * around,
        constant=constant,
        spread=spread,
        place_spread=prior.site_spread_share * spread,
        range=prior.range * region.cell if work.smooth else 0.0,
        constant_joints=tuple(int(j) + 1 for j in np.flatnonzero(~vary)),
        readings=_count_readings(work, weighting, len(region)),
        information_gain=predicted.information_gain,
        terms=_get_terms(work, solution),
        heldout=_predict_left_out_poses(work, solution.evidence, weighting, prior, posterior),
        weighting=weighting,
        inside=work.rows,
        rounds=solution.rounds,
    )


def _get_terms(work: GridEquations, solution: _GridSolution) -> Array:
    """Return the (T,) coefficients of all terms, SI; those that are not fitted are at their bound."""
    fit, keep = work.constant, work.kept_columns
    first = len(work.places.cells) * int(work.varying_joints.sum())
    terms = np.where(keep, 0.0, fit.lower[fit.joint_count :])
    terms[keep] = solution.posterior.beta[first:] * fit.column[fit.joint_count :][keep]
    return terms


def _count_readings(work: GridEquations, weighting: ReadingWeights, cells: int) -> Array:
    """Return the (G,) readings of each cell by their outlier weights; places on faces count in parts."""
    own = weighting.robust.mean(axis=1)
    per_place = np.bincount(
        work.places.place[work.places.site[work.groups.pose]], own, minlength=len(work.places.members)
    )
    readings = np.zeros(cells)
    readings[work.places.cells] = per_place @ work.places.share
    return readings


def _predict_left_out_poses(
    work: GridEquations, evidence: GridLikelihood, weighting: ReadingWeights, prior: GridPrior, posterior: GridPosterior
) -> GridHoldoutErrors:
    """Predict each pose from the others in closed form.

    The contribution ΔH, Δh of a pose to its site's equations, with the site's own part integrated out, is removed
    from the posterior N(r, W) of the responses: r₋ = (I − W ΔH)⁻¹ (r − W Δh). The constant model solves (H − H_p) x =
    h − h_p within bounds.
    """
    each = [
        build_normal_equations(evidence.clusters, s, c) for s, c in zip(evidence.channel_sums, prior.noise, strict=True)
    ]
    H, h, site = add_normal_equations([e.H for e in each]), add_normal_equations([e.h for e in each]), evidence.site
    marginal = evidence.marginal(prior, each)
    less_H = sum_by_group(site, H, len(evidence.place))[site] - H
    less_h = sum_by_group(site, h, len(evidence.place))[site] - h
    inverse = np.linalg.inv(np.eye(h.shape[1]) + less_H @ marginal.T)
    dH = marginal.H_site[site] - inverse @ less_H
    dh = marginal.h_site[site] - np.einsum("gij,gj->gi", inverse, less_h)
    r, W = posterior.response[evidence.place[site]], posterior.response_covariance[evidence.place[site]]
    without = np.linalg.solve(np.eye(r.shape[1]) - W @ dH, (r - np.einsum("gij,gj->gi", W, dh))[..., None])[..., 0]
    fit = work.constant
    total_H, total_h = fit.normal.total()
    _, pose = _compute_pose_positions(fit)
    lower, x = fit.lower / fit.column, np.zeros((fit.clusters.poses, len(fit.x)))
    for p in np.unique(pose[work.rows]):
        x[p] = minimise_bounded_quadratic(total_H - fit.normal.H[p], total_h - fit.normal.h[p], lower) * fit.column
    rows = work.rows
    constant = fit.y[rows] - np.einsum("ndp,np->nd", fit.A[rows], x[pose[rows]])
    return GridHoldoutErrors(
        work.residual(without),
        constant,
        fit.experiment.pose[rows],
        np.asarray((weighting.robust >= thresholds.SHARES.majority).all(axis=1)),
    )


def _format_joint_list(which: Bools) -> str:
    return ", ".join(str(j + 1) for j in np.flatnonzero(which))


def _format_point_mm(point: Array) -> str:
    return f"({', '.join(f'{v:.0f}' for v in point)})"
