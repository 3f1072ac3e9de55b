"""The constant fit's readings as equations of a grid: relative compliances of the joints that vary, then the terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array, Bools
from machopt.estimate.clusters import Clusters, Components, clusters, shifts, sums
from machopt.estimate.robust import scale, weights
from machopt.identify.fit import Fit, Weighting
from machopt.identify.gridcells import Touched
from machopt.identify.gridevidence import Evidence, Linear, Posterior, Prior

SHIFT_START = 0.3  # variance of a shared shift per reading's: away from none, where the likelihood is flat


@dataclass(frozen=True, kw_only=True)
class GridEquations:
    """M readings inside the grid, y = A r of their place + error, r = (relative compliances, scaled terms)."""

    constant: Fit
    rows: Bools  # (N,) readings inside the grid
    places: Touched
    vary: Bools  # (6,)
    reference: Array  # (6,) rad/(N·m) that relative compliances are of; held joints: their value
    A: Array  # (M, D, R) of the readings inside
    y: Array  # (M, D)
    keep: Bools  # (T,) terms fitted along; the others stay at their bound
    groups: Clusters
    smooth: bool

    @classmethod
    def of(
        cls, constant: Fit, rows: Bools, places: Touched, vary: Bools, reference: Array, smooth: bool
    ) -> GridEquations:
        """Rewrite the equations of ``constant`` for the readings ``rows`` (N,)."""
        A = constant.A[rows]
        joints = A[..., :6] * reference
        keep = constant.x[6:] > constant.lower[6:]
        fixed = np.where(keep, 0.0, constant.x[6:])
        y = constant.y[rows] - joints[..., ~vary].sum(axis=-1) - A[..., 6:] @ fixed
        scaled = (A[..., 6:] * constant.column[6:])[..., keep]
        groups = constant.clusters if rows.all() else clusters(constant.experiment.take(rows))
        A = np.concatenate([joints[..., vary], scaled], axis=-1)
        return cls(
            constant=constant,
            rows=rows,
            places=places,
            vary=vary,
            reference=reference,
            A=A,
            y=y,
            keep=keep,
            groups=groups,
            smooth=smooth,
        )

    @property
    def terms(self) -> int:
        return int(self.keep.sum())

    def start(self) -> Weighting:
        """The constant fit's weights; where it had none, variances of the size of its residuals."""
        w = self.constant.weighting
        V, robust = w.covariance[:, self.rows], w.robust[self.rows]
        if self.constant.weighted:
            return Weighting(V, w.components, robust)
        residual = self.constant.residual[self.rows]
        size = [max(scale(residual[:, 3 * c : 3 * c + 3]), np.finfo(float).tiny) ** 2 for c in range(len(V))]
        return Weighting(V * np.array(size)[:, None, None, None], w.components, robust)

    def prior(self, weighting: Weighting, spread: Array | None) -> Prior:
        """Where the search for the prior begins; with ``spread`` (6,) given, cells that are that and nothing else."""
        start = Prior.start(int(self.vary.sum()), self.smooth)
        if spread is not None:
            start = replace(start, spread=np.asarray(spread, float)[self.vary], within=0.0)
        noise = tuple(
            Components(c.scale, max(c.cycle, SHIFT_START * unit), max(c.visit, SHIFT_START * unit))
            for c, unit in zip(weighting.components, map(_variance, weighting.covariance), strict=True)
        )
        return replace(start, noise=noise)

    def evidence(self, weighting: Weighting) -> Evidence:
        """The readings as sums, under given weights."""
        Q, V = weighting.precision, weighting.covariance
        parts = []
        for c in range(len(Q)):
            rows = slice(3 * c, 3 * c + 3)
            parts.append(
                sums(self.groups, Q[c], self.A[:, rows], self.y[:, rows], float(weighting.robust[:, rows].sum()))
            )
        stated = self.constant.experiment.uncertainty
        return Evidence(
            clusters=self.groups,
            parts=parts,
            unit=[_variance(v) for v in V],
            stated=[s is not None for s in (stated.displacement, stated.rotation)][: len(V)],
            site=self.places.site,
            place=self.places.place,
            cells=len(self.places.cells),
            joints=int(self.vary.sum()),
            distance=self.places.distance,
            smooth=self.smooth,
        )

    def first_unknowns(self) -> Array:
        """(n,) log relative compliances of the cells, cell by cell, then the scaled terms: the constant model."""
        terms = (self.constant.x[6:] / self.constant.column[6:])[self.keep]
        return np.concatenate([np.zeros(len(self.places.cells) * int(self.vary.sum())), terms])

    def linear(self, beta: Array) -> Linear:
        """Responses of the places about unknowns (n,)."""
        C = len(self.places.cells)
        return Linear(*self.places.linear(beta[: C * int(self.vary.sum())].reshape(C, -1), self.terms))

    def residual(self, response: Array) -> Array:
        """(M, D) of responses per pose (G, R)."""
        return np.asarray(self.y - np.einsum("ndr,nr->nd", self.A, response[self.groups.pose]))

    def doubt(self, before: Weighting, prior: Prior, posterior: Posterior) -> Weighting:
        """Outlier weights of what cells and shared shifts leave of the readings."""
        found = Weighting(before.covariance, prior.noise, before.robust)
        residual = self.residual(posterior.at_site[self.places.site])
        out = np.empty_like(residual)
        for c, (V, share) in enumerate(zip(found.covariance, prior.noise, strict=True)):
            part = residual[:, 3 * c : 3 * c + 3]
            rest = part - shifts(self.groups, found.precision[c], part, share)
            out[:, 3 * c : 3 * c + 3] = weights(rest, np.sqrt(share.scale * V[:, [0, 1, 2], [0, 1, 2]]))
        return Weighting(before.covariance, prior.noise, out)


def _variance(V: Array) -> float:
    return float(np.median(V[:, [0, 1, 2], [0, 1, 2]]))
