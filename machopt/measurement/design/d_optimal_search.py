"""D-optimal selection of readings: exact designs for a given number of poses and of loads at each pose.

A reading n of D numbers has the response A_n (D, P) to P unknowns, its own noise Σ_n, and a pose error with
covariance V that all readings at its pose share. A pose with the readings S gives the information

    A_Sᵀ (blockdiag Σ + 1 1ᵀ ⊗ V)⁻¹ A_S;

poses add. A design maximises Σ_k w_k log det M_k over one or several models of the same readings:

- one model, w = 1: D-optimal, the smallest confidence ellipsoid;
- several prior stiffnesses, w = 1/K: Bayesian D-optimal.

Poses are added greedily, each with its most informative loads. Then single poses with their loads, and single loads,
are exchanged for better ones (Fedorov's exchange) until nothing improves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.measurement.design.design_problem import DesignProblem, ModelBelief, ReadingDesign, index_readings_by_pose
from machopt.measurement.design.log_determinant import compute_log_det_one_plus
from machopt.numerics.array_types import Array, Bools, Ints

RIDGE = 1e-4  # prior information: 1 sigma of 100 (10,000 % of a relative unknown)
SHORTLIST = 48  # best poses by single readings, for which combinations of loads are evaluated
FOCUS = 400  # poses that an exchange tries first
GAIN = 1e-8  # least improvement of log det above rounding
PASSES = 40  # most passes; an exchange typically converges in 3–8


def find_d_optimal_design(
    problem: DesignProblem, poses: int, loads: int, *, rng: np.random.Generator, starts: int = 2, passes: int = PASSES
) -> ReadingDesign:
    """Find the best design of a number of different poses with different loads.

    Args:
        problem: Design problem: candidate readings and models.
        poses: Number of poses; fewer are used if not enough are available.
        loads: Loads at each pose; fewer if the pose admits fewer.
        rng: Random generator of the starts after the greedy one.
        starts: Number of starts of the exchange.
        passes: Most passes of the exchange.

    Returns:
        The design.

    Source:
        Fedorov, Theory of Optimal Experiments (1972), ch. 3; Atkinson, Donev & Tobias (2007), ch. 12.
    """
    search = _DesignSearch(problem)
    best: ReadingDesign | None = None
    poses = min(poses, len(search.slots))
    for start in range(max(starts, 1)):
        first: list[tuple[int, ...]] = []
        if start:  # half of a random design, completed greedily
            rows = rng.permutation(len(search.slots))[: (poses + 1) // 2]
            first = [search.random_block(int(row), loads, rng) for row in rows]
        found = search.exchange(search.greedy(first, poses, loads), loads, passes)
        if best is None or found.value > best.value + GAIN:
            best = found
    assert best is not None
    return best


def compute_information_matrix(problem: DesignProblem, blocks: Sequence[Sequence[int]], model: int = 0) -> Array:
    """Compute the information matrix of a design for one model, without prior.

    Args:
        problem: Design problem: candidate readings and models.
        blocks: Selected readings, grouped by pose.
        model: Index of the model.

    Returns:
        (P, P).
    """
    m = problem.models[model]
    M = np.zeros((m.response.shape[2],) * 2)
    for block in blocks:
        M += _compute_block_information(m, problem.shared, np.asarray(block, np.int64))
    return M


def compute_design_criterion(problem: DesignProblem, blocks: Sequence[Sequence[int]]) -> float:
    """Compute the design criterion Σ_k w_k log det(M_k + ridge).

    Args:
        problem: Design problem: candidate readings and models.
        blocks: Selected readings, grouped by pose.

    Returns:
        Value; larger is better.
    """
    Ms = [compute_information_matrix(problem, blocks, k) for k in range(len(problem.models))]
    return _compute_weighted_log_det(problem, [M + RIDGE * np.eye(len(M)) for M in Ms])


def select_promising_poses(problem: DesignProblem, design: ReadingDesign, loads: int, count: int) -> Ints:
    """Select the poses that would improve a design most, including its own.

    Args:
        problem: Design problem: candidate readings and models.
        design: Selected readings.
        loads: Number of different loads at each pose.
        count: Number of poses to select.

    Returns:
        Pose labels, ascending.
    """
    search = _DesignSearch(problem)
    parts = [search.compute_block_information(b) for b in design.blocks]
    own = [search.row_of[b[0]] for b in design.blocks]
    rows = np.union1d(search.find_promising_poses(parts, loads, count), own)
    return np.asarray(problem.pose[search.slots[rows, 0]])


class _DesignSearch:
    """Prepared problem: readings by pose, whitened responses."""

    def __init__(self, problem: DesignProblem) -> None:
        self.problem = problem
        self.slots = index_readings_by_pose(problem.pose)
        self.row_of = np.empty(len(problem.pose), np.int64)  # reading → row of slots
        rows, columns = np.nonzero(self.slots >= 0)
        self.row_of[self.slots[rows, columns]] = rows
        self.whitened = [
            np.linalg.solve(np.linalg.cholesky(m.covariance + problem.shared), m.response) for m in problem.models
        ]

    def random_block(self, row: int, loads: int, rng: np.random.Generator) -> tuple[int, ...]:
        """Draw random loads of a pose.

        Args:
            row: Row of the pose.
            loads: Number of different loads at each pose.
            rng: Random generator.

        Returns:
            Reading indices.
        """
        readings = self.slots[row][self.slots[row] >= 0]
        return tuple(int(n) for n in rng.permutation(readings)[:loads])

    def greedy(self, blocks: list[tuple[int, ...]], poses: int, loads: int) -> list[tuple[int, ...]]:
        """Add the best pose until there are enough.

        Args:
            blocks: Selected readings, grouped by pose.
            poses: Number of poses.
            loads: Number of different loads at each pose.

        Returns:
            Selected readings.
        """
        blocks = list(blocks)
        parts = [self.compute_block_information(b) for b in blocks]
        while len(blocks) < poses:
            blocks.append(self._find_best_block(self._sum(parts), loads, self._sum_chosen(blocks)))
            parts.append(self.compute_block_information(blocks[-1]))
        return blocks

    def exchange(self, blocks: list[tuple[int, ...]], loads: int, passes: int) -> ReadingDesign:
        """Improve a design until no exchange of a pose or a load increases the criterion.

        Args:
            blocks: Selected readings, grouped by pose.
            loads: Number of different loads at each pose.
            passes: Most passes.

        Returns:
            The design.
        """
        blocks = list(blocks)
        parts = [self.compute_block_information(b) for b in blocks]
        value = self._compute_value(parts)
        history = [value]
        focus = np.zeros(len(self.slots), bool)
        focus[self.find_promising_poses(parts, loads, FOCUS)] = True
        whole = bool(focus.all())
        for _ in range(passes):
            before = value
            for i in range(len(blocks)):
                rest = parts[:i] + parts[i + 1 :]
                taken = self._sum_chosen(blocks[:i] + blocks[i + 1 :])
                new = self._find_best_block(self._sum(rest), loads, taken, None if whole else focus)
                for block in (new, self._find_better_loads(blocks[i], rest, loads)):
                    part = self.compute_block_information(block)
                    v = self._compute_value([*rest, part])
                    if v > value + GAIN:
                        blocks[i], parts[i], value = block, part, v
                        history.append(v)
            if value <= before + GAIN:
                if whole:
                    break
                whole = True  # no improvement among the first poses: try all once
            else:
                whole = bool(focus.all())
        return ReadingDesign(tuple(blocks), value, tuple(history))

    def find_promising_poses(self, parts: list[list[Array]], loads: int, count: int) -> Ints:
        """Find the poses that would improve the current design most.

        Args:
            parts: Information of each pose of the design, by model.
            loads: Number of different loads at each pose.
            count: Number of poses.

        Returns:
            Rows of the poses.
        """
        sums = self._sum_best_gains(self._compute_first_gains(self._sum(parts)), loads)
        return np.asarray(np.argsort(-sums, kind="stable")[:count], np.int64)

    def _find_better_loads(self, block: tuple[int, ...], rest: list[list[Array]], loads: int) -> tuple[int, ...]:
        """Return the block with the best exchange or addition of one load."""
        row = self.slots[self.row_of[block[0]]]
        readings = [int(n) for n in row[row >= 0]]
        others = [n for n in readings if n not in block]
        variants = [tuple(n if m == old else m for m in block) for old in block for n in others]
        if len(block) < min(loads, len(readings)):
            variants += [(*block, n) for n in others]
        if not variants:
            return block
        values = [self._compute_value([*rest, self.compute_block_information(v)]) for v in variants]
        return variants[int(np.argmax(values))]

    def _find_best_block(
        self, Ms: list[Array], loads: int, taken: Bools, among: Bools | None = None
    ) -> tuple[int, ...]:
        """Return the free pose with loads that increases Σ w log det most."""
        gains = self._compute_first_gains(Ms, among)
        sums = self._sum_best_gains(gains, loads)
        sums[taken] = -np.inf
        if loads == 1:
            row = int(np.argmax(sums))
            return (int(self.slots[row, int(np.argmax(_pad_values(gains, self.slots[row])))]),)
        short = np.argsort(-sums, kind="stable")[: min(SHORTLIST, int((~taken).sum()))]
        return self._grow(short, Ms, loads)

    def _compute_first_gains(self, Ms: list[Array], among: Bools | None = None) -> Array:
        """Return the gain (N,) of each reading as the first one of its pose, −inf for excluded poses."""
        requested_rows = None if among is None else np.flatnonzero(among[self.row_of])
        total = np.zeros(len(self.row_of) if requested_rows is None else len(requested_rows))
        for m, U, M in zip(self.problem.models, self.whitened, Ms, strict=True):
            G = (U if requested_rows is None else U[requested_rows]) @ _compute_inverse_root(M)
            total += m.weight * compute_log_det_one_plus(G)
        if requested_rows is None:
            return total
        out = np.full(len(self.row_of), -np.inf)
        out[requested_rows] = total
        return out

    def _sum_best_gains(self, gains: Array, loads: int) -> Array:
        """Return the sum (rows,) of the best ``loads`` gains of each pose."""
        padded = _pad_values(gains, self.slots)
        if loads == 1:
            return np.asarray(padded.max(axis=1))
        take = min(loads, padded.shape[1])
        best = np.partition(padded, padded.shape[1] - take, axis=1)[:, -take:]
        lonely = ~np.isfinite(best)
        sums = np.where(lonely, 0.0, best).sum(axis=1)
        return np.asarray(np.where(lonely.all(axis=1), -np.inf, sums))

    def _grow(self, rows: Ints, Ms: list[Array], loads: int) -> tuple[int, ...]:
        """Return the best pose of some, with loads added one by one.

        After a reading, the pose error b is better known. The next reading counts by its innovation: its response
        minus the part explained by the estimate of b, with the remaining covariance of b (Kalman update).
        """
        slots = self.slots[rows]
        K, D = len(rows), len(self.problem.shared)
        pick = np.maximum(slots, 0)
        states = [
            _LoadAddition(
                A=m.response[pick],
                S=m.covariance[pick],
                C=np.broadcast_to(_invert_matrix(M), (K, *M.shape)),
                W=np.broadcast_to(self.problem.shared, (K, D, D)),
                H=np.zeros((K, D, M.shape[0])),
                weight=m.weight,
            )
            for m, M in zip(self.problem.models, Ms, strict=True)
        ]
        free = slots >= 0
        chosen = np.full((K, loads), -1, np.int64)
        total = np.zeros(K)
        at = np.arange(K)
        for step in range(loads):
            gains = np.where(free, np.sum([s.gains() for s in states], axis=0), -np.inf)
            best = gains.argmax(axis=1)
            more = free[at, best]
            chosen[more, step] = slots[at, best][more]
            total += np.where(more, gains[at, best], 0.0)
            free[at, best] = False
            for s in states:
                s.add_readings(best, more)
        winner = int(np.argmax(total))
        return tuple(int(n) for n in chosen[winner] if n >= 0)

    def _sum_chosen(self, blocks: Sequence[tuple[int, ...]]) -> Bools:
        out = np.zeros(len(self.slots), bool)
        out[[int(self.row_of[b[0]]) for b in blocks]] = True
        return out

    def compute_block_information(self, block: tuple[int, ...]) -> list[Array]:
        """Compute the information of one pose for each model.

        Args:
            block: Readings of the pose.

        Returns:
            (P, P) per model.
        """
        return [compute_information_matrix(self.problem, [block], k) for k in range(len(self.problem.models))]

    def _sum(self, parts: list[list[Array]]) -> list[Array]:
        """Return the information of several poses plus the ridge, for each model."""
        sizes = [m.response.shape[2] for m in self.problem.models]
        return [np.sum([p[k] for p in parts], axis=0) + RIDGE * np.eye(n) for k, n in enumerate(sizes)]

    def _compute_value(self, parts: list[list[Array]]) -> float:
        return _compute_weighted_log_det(self.problem, self._sum(parts))


@dataclass(kw_only=True)
class _LoadAddition:
    """Readings of one model at K poses while loads are added."""

    A: Array  # (K, L, D, P)
    S: Array  # (K, L, D, D)
    C: Array  # (K, P, P) covariance of the unknowns
    W: Array  # (K, D, D) covariance of the pose error, given the selected readings
    H: Array  # (K, D, P) response of its estimate to the unknowns
    weight: float

    def gains(self) -> Array:
        """Return w · (log det(N + R C Rᵀ) − log det N) (K, L), R the innovation of a reading, N its current noise."""
        N = self.S + self.W[:, None]
        R = self.A - self.H[:, None]
        spread = R @ self.C[:, None] @ np.swapaxes(R, -1, -2)
        return np.asarray(self.weight * (np.linalg.slogdet(N + spread)[1] - np.linalg.slogdet(N)[1]))

    def add_readings(self, best: Ints, more: Bools) -> None:
        """Add one reading at each pose that has a further one.

        Args:
            best: (K,) index of the load to add.
            more: (K,) True for poses with a further reading.
        """
        at = np.arange(len(best))
        N = self.S[at, best] + self.W
        R = self.A[at, best] - self.H
        RC = R @ self.C
        C = self.C - np.swapaxes(RC, -1, -2) @ np.linalg.solve(N + RC @ np.swapaxes(R, -1, -2), RC)
        K = self.W @ np.linalg.inv(N)
        keep = ~more[:, None, None]
        self.C = np.where(keep, self.C, 0.5 * (C + np.swapaxes(C, -1, -2)))
        self.H = np.where(keep, self.H, self.H + K @ R)
        self.W = np.where(keep, self.W, self.W - K @ self.W)


def _compute_block_information(model: ModelBelief, shared: Array, block: Ints) -> Array:
    """Return the information of the readings of one pose."""
    A, S = model.response[block], model.covariance[block]
    n, D = A.shape[:2]
    noise = np.tile(shared, (n, n))
    for i in range(n):
        noise[i * D : (i + 1) * D, i * D : (i + 1) * D] += S[i]
    stacked = A.reshape(n * D, -1)
    return np.asarray(stacked.T @ np.linalg.solve(noise, stacked))


def _compute_weighted_log_det(problem: DesignProblem, Ms: Sequence[Array]) -> float:
    """Σ w log det."""
    return sum(m.weight * float(np.linalg.slogdet(M)[1]) for m, M in zip(problem.models, Ms, strict=True))


def _compute_inverse_root(M: Array) -> Array:
    """Return R with R Rᵀ = M⁻¹, positive semidefinite even for an ill-conditioned M."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(M)).T)


def _invert_matrix(M: Array) -> Array:
    R = _compute_inverse_root(M)
    return np.asarray(R @ R.T)


def _pad_values(values: Array, slots: Ints) -> Array:
    return np.asarray(np.where(slots >= 0, values[np.maximum(slots, 0)], -np.inf))
