"""Which readings to take: exact designs that make the most of a number of poses and of loads at each pose.

A reading n of D numbers has the response A_n (D, P) to P unknowns, own noise Σ_n and a pose error with covariance V
that all readings at its pose share. A pose with the readings S gives the information
A_Sᵀ (blockdiag Σ + 1 1ᵀ ⊗ V)⁻¹ A_S;
poses add. A design maximises Σ_k w_k log det M_k over one or several models of the same readings:

- one model, w = 1: D-optimal, the smallest ellipsoid of uncertainty;
- several believed stiffnesses, w = 1/K: Bayesian D-optimal;
- a law [A, y] with w = 1 against a law A with w = −1: T-optimal, the largest deviation y that A cannot imitate
  (:mod:`machopt.measurement.design.two_model_discrimination`).

Poses are added greedily, each with the loads that add most to one another, then exchanged one by one for a better pose
with its loads, and single loads for better loads (Fedorov's exchange), until nothing improves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.numerics.array_types import Array, Bools, Ints

RIDGE = 1e-4  # information before any reading: 1 sigma of 100 (of a relative unknown: 10,000 %)
SHORTLIST = 48  # poses whose loads are worked out together, the best by single readings
FOCUS = 400  # poses an exchange looks at before it looks at all
GAIN = 1e-8  # least improvement of log det that counts; below it is rounding
PASSES = 40  # an exchange settles in 3–8


@dataclass(frozen=True)
class ModelBelief:
    """One belief about the same N readings."""

    response: Array  # (N, D, P)
    covariance: Array  # (N, D, D) own noise of each reading
    weight: float = 1.0


@dataclass(frozen=True)
class DesignProblem:
    """Readings to choose from."""

    models: tuple[ModelBelief, ...]
    pose: Ints  # (N,) ascending
    shared: Array  # (D, D) covariance of the pose error

    def select_poses(self, poses: Ints) -> tuple[DesignProblem, Ints]:
        """The problem of these poses alone, and the indices its readings have here."""
        rows = np.flatnonzero(np.isin(self.pose, poses))
        models = tuple(replace(m, response=m.response[rows], covariance=m.covariance[rows]) for m in self.models)
        return DesignProblem(models, self.pose[rows], self.shared), rows


@dataclass(frozen=True)
class ReadingDesign:
    """Chosen readings, pose by pose in the order they were found."""

    blocks: tuple[tuple[int, ...], ...]  # indices of readings; one tuple a pose
    value: float  # Σ w log det
    history: tuple[float, ...] = field(default=(), compare=False)  # value after every accepted exchange

    @property
    def readings(self) -> Ints:
        return np.array([n for block in self.blocks for n in block], np.int64)

    def map_rows(self, rows: Ints) -> ReadingDesign:
        """The same design, its indices looked up in ``rows``."""
        return replace(self, blocks=tuple(tuple(int(rows[n]) for n in block) for block in self.blocks))


def find_d_optimal_design(
    problem: DesignProblem, poses: int, loads: int, *, rng: np.random.Generator, starts: int = 2, passes: int = PASSES
) -> ReadingDesign:
    """The best design found of ``poses`` different poses with ``loads`` different loads each.

    Args:
        problem: N readings.
        poses: fewer are used where there are not so many.
        loads: at each pose; fewer where the pose admits fewer.
        rng: for the starts after the greedy one.
        starts: of the exchange.
        passes: most rounds of exchange.

    Source: Fedorov, Theory of Optimal Experiments (1972), ch. 3; Atkinson, Donev & Tobias (2007), ch. 12.
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
    """M (P, P) of a model, without any prior."""
    m = problem.models[model]
    M = np.zeros((m.response.shape[2],) * 2)
    for block in blocks:
        M += _compute_block_information(m, problem.shared, np.asarray(block, np.int64))
    return M


def compute_design_criterion(problem: DesignProblem, blocks: Sequence[Sequence[int]]) -> float:
    """Σ_k w_k log det(M_k + ridge)."""
    Ms = [compute_information_matrix(problem, blocks, k) for k in range(len(problem.models))]
    return _compute_weighted_log_det(problem, [M + RIDGE * np.eye(len(M)) for M in Ms])


def select_promising_poses(problem: DesignProblem, design: ReadingDesign, loads: int, count: int) -> Ints:
    """The poses that would add most to a design, and its own; ascending."""
    search = _DesignSearch(problem)
    parts = [search.compute_block_information(b) for b in design.blocks]
    own = [search.row_of[b[0]] for b in design.blocks]
    rows = np.union1d(search.find_promising_poses(parts, loads, count), own)
    return np.asarray(problem.pose[search.slots[rows, 0]])


def index_readings_by_pose(pose: Ints) -> Ints:
    """(poses, L) indices of each pose's readings, −1 where it has fewer."""
    _, start, count = np.unique(pose, return_index=True, return_counts=True)
    column = np.arange(count.max())
    return np.asarray(np.where(column < count[:, None], start[:, None] + column, -1), np.int64)


class _DesignSearch:
    """A problem made ready: readings by pose, whitened responses."""

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
        readings = self.slots[row][self.slots[row] >= 0]
        return tuple(int(n) for n in rng.permutation(readings)[:loads])

    def greedy(self, blocks: list[tuple[int, ...]], poses: int, loads: int) -> list[tuple[int, ...]]:
        """Add the pose that adds most until there are enough."""
        blocks = list(blocks)
        parts = [self.compute_block_information(b) for b in blocks]
        while len(blocks) < poses:
            blocks.append(self._find_best_block(self._sum(parts), loads, self._sum_chosen(blocks)))
            parts.append(self.compute_block_information(blocks[-1]))
        return blocks

    def exchange(self, blocks: list[tuple[int, ...]], loads: int, passes: int) -> ReadingDesign:
        """Improve a design until no single pose and no single load can be exchanged with gain."""
        blocks = list(blocks)
        parts = [self.compute_block_information(b) for b in blocks]
        value = self._value(parts)
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
                for block in (new, self._better_loads(blocks[i], rest, loads)):
                    part = self.compute_block_information(block)
                    v = self._value([*rest, part])
                    if v > value + GAIN:
                        blocks[i], parts[i], value = block, part, v
                        history.append(v)
            if value <= before + GAIN:
                if whole:
                    break
                whole = True  # nothing near helps: look everywhere once more
            else:
                whole = bool(focus.all())
        return ReadingDesign(tuple(blocks), value, tuple(history))

    def find_promising_poses(self, parts: list[list[Array]], loads: int, count: int) -> Ints:
        """Rows of the poses that would add most to a design as it is."""
        sums = self._sums_of_best(self._compute_first_gains(self._sum(parts)), loads)
        return np.asarray(np.argsort(-sums, kind="stable")[:count], np.int64)

    def _better_loads(self, block: tuple[int, ...], rest: list[list[Array]], loads: int) -> tuple[int, ...]:
        """The pose of the block with one load exchanged or added, the best such."""
        row = self.slots[self.row_of[block[0]]]
        readings = [int(n) for n in row[row >= 0]]
        others = [n for n in readings if n not in block]
        variants = [tuple(n if m == old else m for m in block) for old in block for n in others]
        if len(block) < min(loads, len(readings)):
            variants += [(*block, n) for n in others]
        if not variants:
            return block
        values = [self._value([*rest, self.compute_block_information(v)]) for v in variants]
        return variants[int(np.argmax(values))]

    def _find_best_block(
        self, Ms: list[Array], loads: int, taken: Bools, among: Bools | None = None
    ) -> tuple[int, ...]:
        """The free pose, with its loads, that adds most to Σ w log det."""
        gains = self._compute_first_gains(Ms, among)
        sums = self._sums_of_best(gains, loads)
        sums[taken] = -np.inf
        if loads == 1:
            row = int(np.argmax(sums))
            return (int(self.slots[row, int(np.argmax(_pad_values(gains, self.slots[row])))]),)
        short = np.argsort(-sums, kind="stable")[: min(SHORTLIST, int((~taken).sum()))]
        return self._grow(short, Ms, loads)

    def _compute_first_gains(self, Ms: list[Array], among: Bools | None = None) -> Array:
        """(N,) what each reading adds as the first of its pose, −inf for poses not asked about."""
        asked = None if among is None else np.flatnonzero(among[self.row_of])
        total = np.zeros(len(self.row_of) if asked is None else len(asked))
        for m, U, M in zip(self.problem.models, self.whitened, Ms, strict=True):
            G = (U if asked is None else U[asked]) @ _compute_inverse_root(M)
            total += m.weight * _compute_log_det_one_plus(G)
        if asked is None:
            return total
        out = np.full(len(self.row_of), -np.inf)
        out[asked] = total
        return out

    def _sums_of_best(self, gains: Array, loads: int) -> Array:
        """(rows,) sum of the best ``loads`` gains of each pose."""
        padded = _pad_values(gains, self.slots)
        if loads == 1:
            return np.asarray(padded.max(axis=1))
        take = min(loads, padded.shape[1])
        best = np.partition(padded, padded.shape[1] - take, axis=1)[:, -take:]
        lonely = ~np.isfinite(best)
        sums = np.where(lonely, 0.0, best).sum(axis=1)
        return np.asarray(np.where(lonely.all(axis=1), -np.inf, sums))

    def _grow(self, rows: Ints, Ms: list[Array], loads: int) -> tuple[int, ...]:
        """Of some poses, each with loads added one after the other, the one that adds most.

        After a reading at a pose its error b is known better, and the next reading counts by what is new in it: its
        response less what the error's estimate takes, with the error's remaining covariance (a Kalman update of b).
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
        """Of one pose, for each model."""
        return [compute_information_matrix(self.problem, [block], k) for k in range(len(self.problem.models))]

    def _sum(self, parts: list[list[Array]]) -> list[Array]:
        """Information of several poses and the ridge, for each model."""
        sizes = [m.response.shape[2] for m in self.problem.models]
        return [np.sum([p[k] for p in parts], axis=0) + RIDGE * np.eye(n) for k, n in enumerate(sizes)]

    def _value(self, parts: list[list[Array]]) -> float:
        return _compute_weighted_log_det(self.problem, self._sum(parts))


@dataclass(kw_only=True)
class _LoadAddition:
    """One model's readings at K poses while loads are added."""

    A: Array  # (K, L, D, P)
    S: Array  # (K, L, D, D)
    C: Array  # (K, P, P) covariance of the unknowns
    W: Array  # (K, D, D) covariance of the pose error, given the readings taken
    H: Array  # (K, D, P) how its estimate responds to the unknowns
    weight: float

    def gains(self) -> Array:
        """(K, L) w · (log det(N + R C Rᵀ) − log det N), R what is new in a reading, N its noise now."""
        N = self.S + self.W[:, None]
        R = self.A - self.H[:, None]
        spread = R @ self.C[:, None] @ np.swapaxes(R, -1, -2)
        return np.asarray(self.weight * (np.linalg.slogdet(N + spread)[1] - np.linalg.slogdet(N)[1]))

    def add_readings(self, best: Ints, more: Bools) -> None:
        """Take one reading at each pose where there is one more."""
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
    """Information of the readings of one pose."""
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
    """R with R Rᵀ = M⁻¹; never indefinite, however ill-conditioned M is."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(M)).T)


def _invert_matrix(M: Array) -> Array:
    R = _compute_inverse_root(M)
    return np.asarray(R @ R.T)


def _pad_values(values: Array, slots: Ints) -> Array:
    return np.asarray(np.where(slots >= 0, values[np.maximum(slots, 0)], -np.inf))


def _compute_log_det_one_plus(G: Array) -> Array:
    """log det(1 + G Gᵀ) (N,) of G (N, D, P): an LDLᵀ factorisation over all N at once, D small."""
    D = G.shape[1]
    S = [[np.einsum("np,np->n", G[:, i], G[:, j]) for j in range(i + 1)] for i in range(D)]
    total = np.zeros(len(G))
    pivot: list[Array] = []
    L: list[list[Array]] = []
    for i in range(D):
        row: list[Array] = []
        for j in range(i):
            s = S[i][j] - sum((row[k] * L[j][k] * pivot[k] for k in range(j)), np.zeros(len(G)))
            row.append(s / pivot[j])
        pivot.append(1.0 + S[i][i] - sum((row[k] ** 2 * pivot[k] for k in range(i)), np.zeros(len(G))))
        L.append(row)
        total += np.log(pivot[i])
    return total
