"""Joint stiffness per cell of a grid of TCP positions (jiao2022 section 2), shrunk to one set of values by the data.

Space is cut into cubes and each has its own six stiffnesses; on a face, edge or corner they are averaged, as
:func:`machopt.stiffness.arm_stiffness.compute_joint_stiffness` does, so a reading there informs every cell that it
touches. A cell alone
would follow its readings' noise, with few readings wildly. Here the cells' log compliances are drawn from one
distribution per joint, whose width the data choose
(:mod:`~machopt.measurement.identification.grid_stiffness.grid_marginal_likelihood`): a cell is moved away from
the constant model as far as its readings warrant, one without readings stays there with the width as its uncertainty,
and where nothing varies the grid is the constant model. Logarithms keep every stiffness positive.

Harmonic mean and logarithm are not linear, so cells, prior, noise and outlier weights are found in a few rounds of
linearised problems.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.stiffness import StiffnessGrid
from machopt.errors import InputError
from machopt.measurement.estimation.bounded_least_squares import minimise_bounded_quadratic
from machopt.measurement.estimation.error_clusters import build_normal_equations
from machopt.measurement.identification import thresholds
from machopt.measurement.identification.fitting.weighted_fit import ReadingWeights, StiffnessFit
from machopt.measurement.identification.grid_stiffness.grid_cells import (
    GridRegion,
    build_grid_region,
    find_measured_cells,
    interpolate_by_kriging,
)
from machopt.measurement.identification.grid_stiffness.grid_equations import GridEquations
from machopt.measurement.identification.grid_stiffness.grid_marginal_likelihood import (
    GridLikelihood,
    GridPosterior,
    GridPrior,
    add_normal_equations,
    sum_by_group,
)
from machopt.numerics.array_types import Array, Bools, Ints

FACE_TOLERANCE = 1e-3  # m; a pose meant to be on a face is that near it, by the arm's own repeatability
MIN_COLUMN_EFFECT = 1e-6  # of the largest reading: less than this is no reading of a joint, whatever its compliance
MOST_CELLS = 1000  # that readings touch; their unknowns are solved together
ROUNDS = 6
STEPS = (30, 10)  # of the likelihood in the first round, in later ones
DRAFT_STEPS = 5
CONVERGENCE_TOLERANCE = 0.15  # change of a log compliance per its standard error between rounds, root mean square


@dataclass(frozen=True)
class GridHoldoutErrors:
    """Errors at readings of poses that the prediction did not see; prior and noise are those of all poses."""

    grid: Array  # (N, D) m, rad
    constant: Array  # (N, D)
    pose: Ints  # (N,)
    counts: Bools  # (N,) False for outliers

    @property
    def rmse(self) -> tuple[float, float]:
        """Root mean square of a translation's coordinate in m: grid, constant."""
        rows = self.counts
        return tuple(float(np.sqrt(np.mean(e[rows, :3] ** 2))) for e in (self.grid, self.constant))  # type: ignore[return-value]

    @property
    def gain(self) -> tuple[float, float]:
        """Constant's mean square less the grid's, per pose, in m², and the standard error of that mean."""
        rows = self.counts
        _, pose = np.unique(self.pose[rows], return_inverse=True)
        square = np.mean(self.constant[rows, :3] ** 2 - self.grid[rows, :3] ** 2, axis=1)
        each = np.bincount(pose, square) / np.bincount(pose)
        return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each)))


@dataclass(frozen=True, kw_only=True)
class GridFit:
    """A grid of joint stiffness, what it was shrunk to, and how much each cell learned."""

    grid: StiffnessGrid  # with std
    covariance: Array  # (G, 6, 6) of each cell's joint compliances, (rad/(N·m))²
    centre: Array  # (6,) N·m/rad: the joints' mean over cells, in log compliance, that cells shrink to
    centre_covariance: Array  # (6, 6) of the compliances of a cell that nobody measured: mean's error and spread
    constant: Array  # (6,) N·m/rad of the constant model the comparison is with; inf where its compliance is 0
    spread: Array  # (6,) 1 sigma of log compliance between cells; 0 for held joints
    place_spread: Array  # (6,) 1 sigma of log compliance at one TCP about its cell's value; not in ``grid.std``
    range: float  # m, distance at which cells' correlation has fallen to 1/e; 0 where cells are independent
    constant_joints: tuple[int, ...]  # joints (1 … 6) with the same value in every cell, for want of data
    readings: Array  # (G,) that inform a cell: shared among the cells touched, outliers by their weight
    information_gain: (
        Array  # (G, 6) in 0 … 1: share of a cell's prior variance that the readings removed; 0 for held joints
    )
    terms: Array  # (T,) coefficients of the terms beside the joints
    heldout: GridHoldoutErrors
    weighting: ReadingWeights  # of the readings inside the grid
    inside: Bools  # (N,) readings inside the grid, the only ones used
    rounds: int


def fit_grid(
    constant: StiffnessFit,
    cell: float,
    origin: Array | None = None,
    shape: tuple[int, int, int] | None = None,
    *,
    smooth: bool = True,
    robust: bool = True,
    on_face: float = FACE_TOLERANCE,
    hold: Array | None = None,
    spread: Array | None = None,
    draft: bool = False,
) -> GridFit:
    """Identify grid-variable joint stiffness.

    z_g,j = log c_g,j ~ N(μ_j, s_j²); at a place touching m cells, c_j = m / Σ_g k_g,j; displacements as in the constant
    model. s, correlation range and noise by restricted maximum likelihood, cells by their conditional mean.

    Args:
        constant: fit of the constant model to the same readings, with its terms, weights and groups.
        cell: edge in m.
        origin: (3,) m in base_link, lowest corner; None: whole cells about the measured TCPs.
        shape: cells along x, y, z; None: as many as hold the measured TCPs.
        smooth: let the data choose a correlation between neighbouring cells; False: cells are independent.
        robust: find outliers anew with the cells' residuals; False: keep the constant fit's weights.
        on_face: m; a pose this near a face counts as on it.
        hold: (6,) N·m/rad of joints that shall be the same everywhere, NaN for the others. Of those, one whose constant
            compliance is below two standard errors is held too, at that compliance or one standard error.
        spread: (6,) s_j up to 1 to be taken instead of estimated, and a cell's value holding all over it; 1 leaves the
            cells to themselves, as the paper does.
        draft: one round of a few steps, enough to see whether a grid predicts unseen poses better at all.

    Returns:
        The grid with standard deviations, and held-out errors by pose against the constant model.

    Raises:
        InputError: no reading inside the grid; too many cells; a joint that no reading moves and nothing holds.

    Source:
        jiao2022 sections 2.2, 2.3. Invalid where stiffness depends on the posture at a place rather than on the place.
    """
    position, pose_of = _compute_pose_positions(constant)
    region = build_grid_region(position, cell, origin, shape, on_face, constant.experiment.source)
    inside_pose = region.contains(position, on_face)
    inside = inside_pose[pose_of]
    if not inside.any():
        low, high = region.origin * 1e3, (region.origin + region.cell * np.array(region.shape)) * 1e3
        raise InputError(
            f"no reading lies inside the grid {_format_point_mm(low)} to {_format_point_mm(high)} mm in "
            f"base_link; the TCPs measured lie within "
            f"{_format_point_mm(position.min(axis=0) * 1e3)} to {_format_point_mm(position.max(axis=0) * 1e3)} mm",
            file=constant.experiment.source,
        )
    places = find_measured_cells(region, position[inside_pose], on_face)
    if len(places.cells) > MOST_CELLS:
        raise InputError(
            f"the readings touch {len(places.cells)} cells of {cell * 1e3:g} mm, more than the {MOST_CELLS} that are "
            "solved together; larger cells would work",
            file=constant.experiment.source,
        )
    vary, reference = _select_varying_joints(constant, hold)
    work = GridEquations.from_fit(constant, inside, places, vary, reference, smooth)
    weighting = work.start()
    prior = work.prior(weighting, spread)
    beta = work.first_unknowns()
    for rounds in range(1, ROUNDS + 1):
        evidence = work.evidence(weighting)
        steps = DRAFT_STEPS if draft else STEPS[min(rounds - 1, 1)]
        prior = evidence.maximise(prior, work.linear(beta), steps, fixed=spread is not None)
        new = evidence.mode(prior, work.linear, beta)
        posterior = evidence.posterior(prior, work.linear(new))
        change = (new - beta) / np.sqrt(np.diag(posterior.covariance))
        beta = new
        if np.sqrt(np.mean(change**2)) < CONVERGENCE_TOLERANCE or rounds == ROUNDS or draft:
            break
        weighting = work.compute_reading_covariance(weighting, prior, posterior) if robust else weighting
    weighting = replace(weighting, components=prior.noise)
    return _build_grid_fit(work, region, evidence, weighting, prior, posterior, rounds)


def _compute_pose_positions(fit: StiffnessFit) -> tuple[Array, Ints]:
    """(G, 3) m of each pose, the mean over its readings, and the pose (N,) of each reading."""
    pose = fit.clusters.pose
    count = np.bincount(pose)
    at = fit.experiment.T_base_tcp[:, :3, 3]
    return np.stack([np.bincount(pose, at[:, a]) / count for a in range(3)], axis=1), pose


def _select_varying_joints(fit: StiffnessFit, hold: Array | None) -> tuple[Bools, Array]:
    """(6,) which joints vary by cell, and their reference compliance (6,); of the others, their value."""
    c = fit.compliance
    held = np.full(6, np.nan) if hold is None else np.asarray(hold, float)
    M = np.linalg.pinv(fit.normal.total()[0], hermitian=True)
    sigma = np.sqrt(np.maximum(np.diag(M)[:6], 0.0)) * fit.column[:6]
    seen = np.abs(fit.A[..., :6]).max(axis=(0, 1)) * c.max() > MIN_COLUMN_EFFECT * np.abs(fit.y).max()
    vary = ~np.isfinite(held) & seen & (c > thresholds.IDENTIFIED.varies * sigma)
    blind = ~np.isfinite(held) & ~seen
    if blind.any():
        raise InputError(
            f"no reading moves joint {_format_joint_list(blind)}, so that a grid needs its stiffness from "
            f"elsewhere (hold)",
            file=fit.experiment.source,
        )
    if not vary.any():
        raise InputError(
            f"no joint's compliance is known to better than 1/{thresholds.IDENTIFIED.varies:g} of itself; there is "
            "nothing to vary by cell. More readings, or larger loads, would work",
            file=fit.experiment.source,
        )
    value = np.where(np.isfinite(held), 1.0 / np.where(np.isfinite(held), held, 1.0), np.maximum(c, sigma))
    return vary, np.where(vary, c, value)


def _build_grid_fit(
    work: GridEquations,
    region: GridRegion,
    evidence: GridLikelihood,
    weighting: ReadingWeights,
    prior: GridPrior,
    posterior: GridPosterior,
    rounds: int,
) -> GridFit:
    fit, vary, used, F, C, G = (
        work.constant,
        work.varying_joints,
        work.places.cells,
        int(work.varying_joints.sum()),
        len(work.places.cells),
        len(region),
    )
    weight, left, mean, unsure = interpolate_by_kriging(region, used, prior.range if work.smooth else 0.0)
    z, cov = posterior.beta[: C * F].reshape(C, F), posterior.covariance[: C * F, : C * F].reshape(C, F, C, F)
    every = weight @ z  # (G, F)
    spread2 = prior.spread**2
    # a cell's covariance: what the measured cells' errors carry to it, and what they leave open
    full = np.einsum("gc,cidj,gd->gij", weight, cov, weight, optimize=True)
    full += left[:, None, None] * np.diag(spread2)
    centre_cov = np.einsum("c,cidj,d->ij", mean, cov, mean, optimize=True) + unsure * np.diag(spread2)
    log_c, log_cov = np.zeros((G, 6)), np.zeros((G, 6, 6))
    log_c[:, vary] = every
    log_cov[np.ix_(np.arange(G), vary, vary)] = full
    c = work.reference * np.exp(log_c)
    sigma = np.sqrt(np.diagonal(log_cov, axis1=1, axis2=2))
    centre, around = np.ones(6), np.zeros((6, 6))
    centre[vary] = np.exp(mean @ z)
    centre *= work.reference
    around[np.ix_(vary, vary)] = centre_cov + np.diag(spread2)
    learned, spread, keep = np.zeros((G, 6)), np.zeros(6), work.kept_columns
    # the prior variance of one cell about the estimated mean; a lone cell has nothing to be compared with
    apart = spread2 + np.diag(centre_cov)
    learned[:, vary] = np.clip(1.0 - np.diagonal(full, axis1=1, axis2=2) / apart, 0.0, 1.0)
    spread[vary] = prior.spread
    terms = fit.x[6:].copy()
    terms[keep] = posterior.beta[C * F :] * fit.column[6:][keep]
    own = weighting.robust.mean(axis=1)
    per_place = np.bincount(
        work.places.place[work.places.site[work.groups.pose]], own, minlength=len(work.places.members)
    )
    readings = np.zeros(G)
    readings[used] = per_place @ work.places.share
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
        readings=readings,
        information_gain=learned,
        terms=terms,
        heldout=_predict_left_out_poses(work, evidence, weighting, prior, posterior),
        weighting=weighting,
        inside=work.rows,
        rounds=rounds,
    )


def _predict_left_out_poses(
    work: GridEquations, evidence: GridLikelihood, weighting: ReadingWeights, prior: GridPrior, posterior: GridPosterior
) -> GridHoldoutErrors:
    """Each pose predicted from the others, in closed form.

    What a pose adds to its site's equations, ΔH and Δh with the site's own part integrated out, is taken out of the
    posterior N(r, W) of the responses there: r₋ = (I − W ΔH)⁻¹ (r − W Δh). The constant model's coefficients solve
    (H − H_p) x = h − h_p within their bounds.
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
        np.asarray((weighting.robust >= thresholds.IDENTIFIED.out).all(axis=1)),
    )


def _format_joint_list(which: Bools) -> str:
    return ", ".join(str(j + 1) for j in np.flatnonzero(which))


def _format_point_mm(point: Array) -> str:
    return f"({', '.join(f'{v:.0f}' for v in point)})"
