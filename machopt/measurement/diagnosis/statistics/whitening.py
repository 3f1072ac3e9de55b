"""Whitening of readings with shared errors: W with W Σ Wᵀ = I, visit by visit.

Within a visit Σ = D + U Uᵀ. D holds the variances of single readings. U has one column per coordinate for each shift
that a cycle or the visit shares, and one per gain error of a cycle. With the singular values Q s Rᵀ of D^(−½) U, W =
(I − Q (1 − 1/√(1 + s²)) Qᵀ) D^(−½) exactly. Rows are sorted by group, so that sums over a group are slices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
MOST_CLUSTERS = 500  # most clusters with individual signs: more do not improve the p-value and cost time


@dataclass(frozen=True)
class WhiteningBlock:
    """Whitening of one visit."""

    rows: slice  # position in the flattened, sorted rows
    Q: Array  # (n D, r)
    shrink: Array  # (r,)


@dataclass(frozen=True, kw_only=True)
class ErrorWhitening:
    """Transformation of (N, D, …) columns to (M, …) rows with independent unit errors; M used coordinates."""

    index: Ints  # (n,) used readings, sorted by group and visit
    sigma: Array  # (D,) standard deviation of a single reading, SI
    blocks: tuple[WhiteningBlock, ...]
    visit_starts: Ints  # (V + 1,) rows at which visits begin
    group_of_visit: Ints  # (V,) index of its group, ascending
    groups: Ints  # (G,) labels
    session: Ints  # (V,) session of each visit
    reading: Ints  # (M,) reading of each row
    used_rows: Ints | None = None  # (M,) measured ones of the n D coordinates of used readings; None: all
    is_independent: bool = False  # no error is shared between coordinates: each is whitened separately

    def whiten(self, x: Array) -> Array:
        """Whiten values or columns.

        Args:
            x: (N, D) or (N, D, p), SI.

        Returns:
            (M,) or (M, p).
        """
        flat = (x[self.index] / (self.sigma if x.ndim == 2 else self.sigma[:, None])).reshape(
            len(self.index) * len(self.sigma), *x.shape[2:]
        )
        out = np.ascontiguousarray(flat if self.used_rows is None else flat[self.used_rows])
        for b in self.blocks:
            part = out[b.rows]
            along = b.Q.T @ part
            part -= b.Q @ (b.shrink[:, None] * along if out.ndim > 1 else b.shrink * along)
        return out

    def rows_of(self, coordinates: Ints) -> Ints:
        """Return the rows of some coordinates, if all were measured.

        Args:
            coordinates: (d,) coordinate indices.

        Returns:
            (m,) row indices.
        """
        D = len(self.sigma)
        return np.asarray((D * np.arange(len(self.index))[:, None] + coordinates).reshape(-1))

    def whiten_rows(self, x: Array, coordinates: Ints) -> Array:
        """Whiten columns of some coordinates, if coordinates are whitened separately.

        Args:
            x: (N, d, p) columns, SI.
            coordinates: (d,) coordinate indices.

        Returns:
            (m, p), for the rows of :meth:`rows_of`.
        """
        d, D, p = len(coordinates), len(self.sigma), x.shape[2]
        out = (x[self.index] / self.sigma[coordinates, None]).reshape(-1, p)
        for rows, Q, shrink in self._group_equal_blocks(tuple(coordinates.tolist())):
            at = (d * (rows // D)[:, :, None] + np.arange(d)).reshape(len(rows), -1)
            part = out[at]
            out[at] = part - Q @ (shrink[:, :, None] * (np.swapaxes(Q, 1, 2) @ part))
        return np.asarray(out)

    def _group_equal_blocks(self, coordinates: tuple[int, ...]) -> Iterator[tuple[Ints, Array, Array]]:
        """Yield blocks of equal size together: first row of each reading (B, n), Q (B, n d, r) of some coordinates,
        shrink.
        """
        D = len(self.sigma)
        sizes: dict[tuple[int, ...], list[WhiteningBlock]] = {}
        for b in self.blocks:
            sizes.setdefault(b.Q.shape, []).append(b)
        for (rows, r), blocks in sizes.items():
            Q = np.stack([b.Q for b in blocks]).reshape(len(blocks), rows // D, D, r)[:, :, list(coordinates)]
            first = np.stack([np.arange(b.rows.start, b.rows.stop, D) for b in blocks])
            yield first, Q.reshape(len(blocks), -1, r), np.stack([b.shrink for b in blocks])

    def sum_by_cluster(self, values: Array, rows: Ints | None = None) -> Array:
        """Sum whitened rows over groups; adjacent groups are merged if there are very many.

        Args:
            values: (M, …), or (m, …) for ``rows``.
            rows: (m,) ascending row indices, all others being zero; None: all.

        Returns:
            (C, …) sums.
        """
        first = np.flatnonzero(np.diff(self.group_of_visit, prepend=-1))
        first = first[:: max(1, -(-len(first) // MOST_CLUSTERS))]
        starts = self.visit_starts[first]
        if rows is not None:
            starts = np.searchsorted(rows, starts)
        return np.asarray(np.add.reduceat(values, starts, axis=0))


def build_whitening(problem: DiagnosisProblem, noise: ReplicateNoise, used: Flags) -> ErrorWhitening:
    """Build the whitening of a problem.

    Args:
        problem: Problem with group, visit and cycle labels.
        noise: Estimated noise.
        used: (N,) True for readings that are used.

    Returns:
        The whitening.
    """
    D = problem.dimensions
    family = np.zeros(D, np.int64)
    for f, part in enumerate(problem.families):
        family[list(part.columns)] = f
    sigma = noise.reading[family]
    rows = np.flatnonzero(used)
    groups, group = np.unique(problem.group[rows], return_inverse=True)
    order = np.lexsort((rows, problem.visit[rows], group))
    index, group = rows[order], group[order]
    visit = problem.visit[index]
    starts = np.flatnonzero(np.r_[True, (np.diff(visit) != 0) | (np.diff(group) != 0)])
    ends = np.r_[starts[1:], len(index)]
    present = None if problem.present is None else np.flatnonzero(problem.present[index].reshape(-1))
    bounds = np.r_[starts, len(index)] * D
    if present is not None:
        bounds = np.searchsorted(present, bounds)
    blocks = []
    for n, (a, b) in enumerate(zip(starts, ends, strict=True)):
        U = _build_shared_error_columns(problem, noise, family, sigma, index[a:b])
        if present is not None:
            U = U[present[bounds[n] : bounds[n + 1]] - a * D]
        if U.shape[1]:
            Q, s, _ = np.linalg.svd(U, full_matrices=False)
            keep = s > 1e-6
            blocks.append(
                WhiteningBlock(
                    slice(int(bounds[n]), int(bounds[n + 1])), Q[:, keep], 1.0 - 1.0 / np.sqrt(1.0 + s[keep] ** 2)
                )
            )
    return ErrorWhitening(
        index=index,
        sigma=sigma,
        blocks=tuple(blocks),
        visit_starts=bounds,
        group_of_visit=group[starts].astype(np.int64),
        groups=groups,
        session=problem.session[index[starts]].astype(np.int64),
        reading=np.repeat(index, D) if present is None else index[present // D],
        used_rows=present,
        is_independent=present is None and (problem.scale is None or noise.gain == 0.0),
    )


def _build_shared_error_columns(
    problem: DiagnosisProblem, noise: ReplicateNoise, family: Ints, sigma: Array, rows: Ints
) -> Array:
    """Return the shared errors (n D, r) of one visit, relative to the standard deviation of a single reading."""
    D, n = len(family), len(rows)
    columns: list[Array] = []

    def shift(among: Flags, size: Array) -> None:
        for d in range(D):
            if size[family[d]] > 0:
                u = np.zeros((n, D))
                u[among, d] = size[family[d]] / sigma[d]
                columns.append(u.reshape(-1))

    labels = np.unique(problem.cycle[rows])
    for label in labels:
        among = problem.cycle[rows] == label
        if len(labels) > 1:
            shift(among, noise.cycle)
        if noise.gain > 0 and problem.scale is not None:
            u = np.where(among[:, None], problem.scale[rows], 0.0) * noise.gain / sigma
            columns.append(u.reshape(-1))
    everyone = np.ones(n, bool)
    shift(everyone, np.hypot(noise.visit, noise.cycle) if len(labels) == 1 else noise.visit)
    return np.stack(columns, axis=1) if columns else np.zeros((n * D, 0))
