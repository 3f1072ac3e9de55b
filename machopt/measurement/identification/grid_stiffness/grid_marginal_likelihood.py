"""Marginal likelihood of a grid's prior: how much joints vary between cells, and the resulting cell values.

Log compliances z of the cells are distributed about their joint's mean, z_g,j ~ N(μ_j, s_j²), with correlation
exp(−d/ℓ) between cells at distance d (ℓ → 0: independent). For given s, ℓ and noise, the cells follow as best linear
unbiased prediction. s, ℓ and the noise maximise the restricted likelihood, with all cells and means integrated out
(Patterson & Thompson 1971; Harville 1977). A joint without variation gets s → 0, and its cells shrink to the constant
model.

Within a cell the joint varies too. The deviation of a site (a TCP position) from its cell is a further random effect
with standard deviation η s_j, integrated out for each site. Without it, many readings at few sites would make a cell
seem far better known than it is.

All computations use sums by pose (:mod:`~machopt.measurement.estimation.error_clusters`). A step costs one dense
factorisation of the cells' unknowns and nothing that grows with the number of readings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import bsr_matrix, csr_matrix

from machopt.measurement import thresholds
from machopt.measurement.estimation.error_clusters import (
    ClusterSums,
    ErrorClusters,
    NormalEquations,
    VarianceComponents,
    build_normal_equations,
)
from machopt.measurement.estimation.tiled_linear_algebra import (
    invert_positive_definite,
    multiply_matrices,
    multiply_vector,
)
from machopt.measurement.estimation.variance_components import LEAST, MOST
from machopt.measurement.identification.grid_stiffness.grid_prior import (
    RANGE_LEAST,
    GridPosterior,
    GridPrior,
    LinearisedResponse,
    MarginalEquations,
)
from machopt.numerics.array_types import Array, Ints

SPREADS = (1e-3, 1.0)  # bounds of s in log compliance; at the lower bound all cells are equal
WITHIN = (1e-3, 1.0)  # bounds of η: a site deviates at most as much as cells do
LIKELIHOOD_TOLERANCE = 0.2  # of −2 log likelihood: negligible for any interval
MODE_STEPS, HALVINGS = 12, 8
RIDGE = 1e-10  # relative to a unit diagonal
STEP = 1e-5  # finite-difference step of a logarithm: balances rounding and curvature


@dataclass(frozen=True, kw_only=True)
class GridLikelihood:
    """Readings as sums by cluster, and the geometry of cells and places."""

    clusters: ErrorClusters
    channel_sums: Sequence[ClusterSums]  # one per channel, for unit noise
    unit: Sequence[float]  # m² or rad²: typical variance of a reading's coordinate at s² = 1
    stated: Sequence[bool]  # whether a channel's uncertainty is stated
    site: Ints  # (G,) site of each pose
    place: Ints  # (S,) place of each site
    cells: int  # number of cells with readings
    joints: int  # number of varying joints
    distance: Array  # (cells, cells) distance between centres, in cell lengths
    smooth: bool

    def prior(self, x: Array) -> GridPrior:
        """Convert a parameter vector to a prior.

        Args:
            x: Logarithms of the parameters, see :meth:`parameters`.

        Returns:
            The prior.
        """
        noise, at = [], 0
        for unit in self.unit:
            scale, at = float(np.exp(x[at])), at + 1
            ratio = [0.0, 0.0]
            for k, there in enumerate((self.clusters.has_cycle, self.clusters.has_visit)):
                if there:
                    ratio[k], at = float(np.exp(x[at])) * unit, at + 1
            noise.append(VarianceComponents(scale, *ratio))
        spread = np.exp(x[at : at + self.joints])
        range_ = float(np.exp(x[-1])) if self.smooth else RANGE_LEAST
        return GridPrior(spread, range_, float(np.exp(x[at + self.joints])), tuple(noise))

    def parameters(self, prior: GridPrior) -> Array:
        """Convert a prior to a parameter vector of logarithms.

        Args:
            prior: Prior of the cells.

        Returns:
            The vector.
        """
        x: list[float] = []
        for unit, c in zip(self.unit, prior.noise, strict=True):
            x.append(np.log(c.scale))
            for there, ratio in ((self.clusters.has_cycle, c.cycle), (self.clusters.has_visit, c.visit)):
                if there:
                    x.append(np.log(np.clip(ratio / unit, LEAST, MOST)))
        x += [*np.log(prior.spread), np.log(max(prior.site_spread_share, WITHIN[0]))]
        if self.smooth:
            x.append(np.log(prior.range))
        return np.array(x)

    def bounds(self) -> list[tuple[float, float]]:
        shifts = int(self.clusters.has_cycle) + int(self.clusters.has_visit)
        out = ([(-20.0, 20.0)] + [(np.log(LEAST), np.log(MOST))] * shifts) * len(self.unit)
        out += [(np.log(SPREADS[0]), np.log(SPREADS[1]))] * self.joints
        out.append((np.log(WITHIN[0]), np.log(WITHIN[1])))
        if self.smooth:  # a correlation longer than the grid cannot be distinguished from a larger mean
            out.append((np.log(RANGE_LEAST), np.log(max(float(self.distance.max()), 1.0))))
        return out

    def _compute_units(self) -> Array:
        """Return scales of the logarithms so that the curvature of the likelihood is similar in all of them."""
        out: list[float] = []
        for s in self.channel_sums:
            out.append(s.count)
            out += [3.0 * len(self.clusters.visit_of_cycle)] * int(self.clusters.has_cycle)
            out += [3.0 * len(self.clusters.pose_of_visit)] * int(self.clusters.has_visit)
        out += [2.0 * self.cells] * self.joints + [float(len(self.place))]
        out += [float(self.cells * self.joints)] * int(self.smooth)
        return np.sqrt(np.array(out) / 2.0)

    def maximise(self, start: GridPrior, linear: LinearisedResponse, steps: int) -> GridPrior:
        """Maximise the likelihood over the prior.

        Args:
            start: Start values.
            linear: Linearised responses of the places.
            steps: Most optimiser steps.

        Returns:
            The most likely prior.
        """
        bounds = self.bounds()
        x = np.clip(self.parameters(start), *np.array(bounds).T)

        def misfit(y: Array) -> tuple[float, Array]:
            value, slope = self.misfit(self.prior(y / unit), linear)
            return value, slope / unit

        unit = self._compute_units()
        scaled = [(a * u, b * u) for (a, b), u in zip(bounds, unit, strict=True)]
        size = sum(s.count for s in self.channel_sums) + 1.0  # about what −2 log likelihood is large
        options = {"maxiter": steps, "ftol": LIKELIHOOD_TOLERANCE / size, "gtol": 0.0}
        return self.prior(
            minimize(misfit, x * unit, jac=True, method="L-BFGS-B", bounds=scaled, options=options).x / unit
        )

    def mode(self, prior: GridPrior, linearise: Callable[[Array], LinearisedResponse], beta: Array) -> Array:
        """Find the most likely unknowns under a prior by Gauss–Newton with step halving.

        Args:
            prior: Prior of the cells.
            linearise: Function that linearises the responses about given unknowns, where u + E β is exact.
            beta: (n,) start values.

        Returns:
            (n,) unknowns.
        """
        m = self.marginal(prior, self._build_equations(prior))
        H, h = m.H, m.h
        Q = self._compute_contrast(prior.range)[0]
        z = slice(0, self.cells * self.joints)

        def misfit(beta: Array, linear: LinearisedResponse) -> float:
            r = linear.u + (linear.E @ beta).reshape(h.shape)
            cells = beta[z].reshape(self.cells, self.joints) / prior.spread
            return float(np.einsum("li,lij,lj->", r, H, r) - 2 * np.sum(r * h) + np.sum(cells * (Q @ cells)))

        linear = linearise(beta)
        value = misfit(beta, linear)
        for _ in range(MODE_STEPS):
            P, b = self._build_system(H, h, Q, prior, linear)
            d = 1.0 / np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))
            step = d * multiply_vector(_invert_with_ridge(P * d[:, None] * d)[0], d * b) - beta
            step /= max(float(np.abs(step[z]).max(initial=0.0)), 1.0)  # at most a factor of e per step
            before = value
            for _ in range(HALVINGS):
                there = linearise(beta + step)
                value = misfit(beta + step, there)
                if value <= before:
                    beta, linear = beta + step, there
                    break
                step = step / 2
            else:
                return beta
            if before - value < LIKELIHOOD_TOLERANCE:
                break
        return beta

    def posterior(self, prior: GridPrior, linear: LinearisedResponse) -> GridPosterior:
        """Compute the posterior of cells and terms under a prior.

        Args:
            prior: Prior of the cells.
            linear: Linearised responses of the places.

        Returns:
            The posterior.
        """
        m = self.marginal(prior, self._build_equations(prior))
        H, h = m.H, m.h
        L, R = h.shape
        Q, log_prior = self._compute_contrast(prior.range)
        P, b = self._build_system(H, h, Q, prior, linear)
        d = 1.0 / np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))
        inverse, log_P = _invert_with_ridge(P * d[:, None] * d)
        covariance = inverse * d[:, None] * d
        beta = multiply_vector(covariance, b)
        response = linear.u + (linear.E @ beta).reshape(L, R)
        fit = float(np.einsum("li,lij,lj->", linear.u, H, linear.u) - 2 * np.sum(linear.u * h) - b @ beta)
        value = m.yy + fit + m.logdet + log_P - 2 * float(np.log(d).sum())
        value += self.joints * log_prior + (self.cells - 1) * 2 * float(np.log(prior.spread).sum())
        for stated, c in zip(self.stated, prior.noise, strict=True):
            value += thresholds.COUNTS.min_degrees_of_freedom * (np.log(c.scale) + 1 / c.scale) if stated else 0.0
        own = m.T @ (m.h_site - np.einsum("sij,sj->si", m.H_site, response[self.place]))[..., None]
        spread = self._spread_to_places(linear.E, covariance, L, R)
        return GridPosterior(
            beta=beta,
            covariance=covariance,
            response=response,
            response_covariance=spread,
            site_response=response[self.place] + own[..., 0],
            value=value,
        )

    def misfit(self, prior: GridPrior, linear: LinearisedResponse) -> tuple[float, Array]:
        """Compute −2 log restricted likelihood and its gradient in the logarithms of :meth:`parameters`.

        Args:
            prior: Prior of the cells.
            linear: Linearised responses of the places.

        Returns:
            Value and gradient.
        """
        post = self.posterior(prior, linear)
        slope: list[float] = []
        r, W = post.response, post.response_covariance
        around, at_site = (W + r[:, :, None] * r[:, None, :])[self.place], r[self.place]

        def rest(m: MarginalEquations) -> float:
            """What depends on noise and site parts, with the unknowns at their mean and spread."""
            return float(np.sum(m.H_site * around) - 2 * np.sum(m.h_site * at_site)) + m.yy + m.logdet

        equations = self._build_equations(prior)
        now = self.marginal(prior, equations)
        for n, (s, c, unit) in enumerate(zip(self.channel_sums, prior.noise, self.unit, strict=True)):
            there = (True, self.clusters.has_cycle, self.clusters.has_visit)
            for name in [name for name, is_there in zip(("scale", "cycle", "visit"), there, strict=True) if is_there]:
                least = 0.0 if name == "scale" else LEAST * unit
                more = replace(c, **{name: max(getattr(c, name), least) * float(np.exp(STEP))})
                changed = [
                    build_normal_equations(self.clusters, s, more) if k == n else e for k, e in enumerate(equations)
                ]
                slope.append((rest(self.marginal(prior, changed)) - rest(now)) / STEP)
                if name == "scale" and self.stated[n]:
                    slope[-1] += thresholds.COUNTS.min_degrees_of_freedom * (1 - 1 / c.scale)
        # with dH = −H dT H, dh = −H dT h: the derivative by each joint's variance T_jj of the site's own part
        F = self.joints
        Hr = np.einsum("sij,sj->si", now.H_site, at_site)
        HaH = np.einsum("sij,sjk,ski->si", now.H_site, around, now.H_site)
        each = np.diagonal(now.H_site, axis1=1, axis2=2) - HaH + 2 * Hr * now.h_site - now.h_site**2
        by_site = 2 * (prior.site_spread_share * prior.spread) ** 2 * each.sum(axis=0)[:F]
        Q = self._compute_contrast(prior.range)[0]
        second = np.zeros_like(Q)  # Σ_j E[z_j z_jᵀ] / s_j²
        for j, spread in enumerate(prior.spread):
            own = np.arange(self.cells) * self.joints + j
            moment = (post.covariance[np.ix_(own, own)] + np.outer(post.beta[own], post.beta[own])) / spread**2
            second += moment
            slope.append(2 * (self.cells - 1 - float(np.sum(Q * moment))) + float(by_site[j]))
        slope.append(float(by_site.sum()))
        if self.smooth:
            dK = self._compute_kernel(prior.range) * self.distance / prior.range
            # log|K| + log 1ᵀK⁻¹1 has the differential tr(Q dK), and dQ = −Q dK Q
            slope.append(
                float(np.sum(Q * dK)) * self.joints
                - float(np.sum(multiply_matrices(multiply_matrices(Q, dK), Q) * second))
            )
        return post.value, np.array(slope)

    def _build_equations(self, prior: GridPrior) -> list[NormalEquations]:
        return [
            build_normal_equations(self.clusters, s, c) for s, c in zip(self.channel_sums, prior.noise, strict=True)
        ]

    def _build_system(
        self, H: Array, h: Array, Q: Array, prior: GridPrior, linear: LinearisedResponse
    ) -> tuple[Array, Array]:
        """Return P β = b: equations of the places through E, and the prior precision of the cells."""
        L, R = h.shape
        blocks = bsr_matrix((H, np.arange(L), np.arange(L + 1)), shape=(L * R, L * R))
        P = (linear.E.T @ (blocks @ linear.E).tocsr()).toarray()
        for j, s in enumerate(prior.spread):
            own = np.arange(self.cells) * self.joints + j
            P[np.ix_(own, own)] += Q / s**2
        return P, linear.E.T @ (h - np.einsum("lij,lj->li", H, linear.u)).reshape(-1)

    def _compute_kernel(self, range_: float) -> Array:
        return np.exp(-self.distance / range_) if self.smooth else np.eye(self.cells)

    def _compute_contrast(self, range_: float) -> tuple[Array, float]:
        """Return the precision of the cells with their mean integrated out, for s = 1, and log|K| + log(1ᵀ K⁻¹ 1)."""
        K = self._compute_kernel(range_)
        inverse, log_K = _invert_with_ridge(K)
        ones = inverse.sum(axis=1)
        total = float(ones.sum())
        return inverse - np.outer(ones, ones) / total, log_K + float(np.log(total))

    def marginal(self, prior: GridPrior, each: Sequence[NormalEquations]) -> MarginalEquations:
        """Integrate out the sites' deviations and sum the equations by place.

        With r_site = r + ε, ε ~ N(0, T): H → (I + H T)⁻¹ H, h → (I + H T)⁻¹ h, yᵀWy → yᵀWy − hᵀ T (I + H T)⁻¹ h.

        Args:
            prior: Prior of the cells.
            each: Normal equations of each channel.

        Returns:
            The marginal equations.
        """
        S, L = len(self.place), int(self.place.max()) + 1
        H = sum_by_group(self.site, add_normal_equations([e.H for e in each]), S)
        h = sum_by_group(self.site, add_normal_equations([e.h for e in each]), S)
        R = h.shape[1]
        T = np.zeros((R, R))
        T[range(self.joints), range(self.joints)] = (prior.site_spread_share * prior.spread) ** 2
        M = np.eye(R) + H @ T
        solved = np.linalg.solve(M, np.concatenate([H, h[..., None]], axis=-1))
        H_site, h_site = solved[..., :R], solved[..., R]
        yy = sum(e.yy for e in each) - float(np.einsum("si,ij,sj->", h, T, h_site))
        logdet = sum(e.logdet for e in each) + float(np.linalg.slogdet(M)[1].sum())
        return MarginalEquations(
            H=sum_by_group(self.place, H_site, L),
            h=sum_by_group(self.place, h_site, L),
            H_site=H_site,
            h_site=h_site,
            T=T,
            yy=yy,
            logdet=logdet,
        )

    @staticmethod
    def _spread_to_places(E: csr_matrix, covariance: Array, L: int, R: int) -> Array:
        """Return E_l Cov E_lᵀ (L, R, R) without the products between places."""
        EC = np.asarray(E @ covariance).reshape(L, R, -1)
        entries = E.tocoo()
        place, row = entries.row // R, entries.row % R
        out = np.zeros((L, R, R))
        for i in range(R):
            np.add.at(out[:, i], (place, row), EC[place, i, entries.col] * entries.data)
        return out


def sum_by_group(group: Ints, x: Array, groups: int) -> Array:
    """Sum values over the members of each group.

    Args:
        group: (M,) group index.
        x: (M, …) values.
        groups: Number of groups.

    Returns:
        (groups, …) sums.
    """
    out = np.zeros((groups, *x.shape[1:]))
    np.add.at(out, group, x)
    return out


def add_normal_equations(parts: Sequence[Array]) -> Array:
    """Add arrays of equal shape.

    Args:
        parts: Arrays to add.

    Returns:
        The sum.
    """
    return np.asarray(np.sum(parts, axis=0))


def _invert_with_ridge(A: Array) -> tuple[Array, float]:
    try:
        return invert_positive_definite(A)
    except np.linalg.LinAlgError:  # a direction determined by neither readings nor prior
        return invert_positive_definite(A + RIDGE * np.eye(len(A)))
