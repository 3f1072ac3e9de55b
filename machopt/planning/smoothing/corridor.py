"""Corridor around the chosen rotation: feasible range and costs from the grid, run by run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, compute_any_last
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.cache import compute_cached, is_cache_active
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.smoothing.cubic_curves import CubicSpline
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.planning_path import PlanningPath

REACH = 16  # maximum number of steps to either side of the chosen rotation
STEP = np.radians(5.0)  # step of the corridor, or one grid step where that is wider
SIDE_STEP = np.radians(30.0)  # largest joint step between neighbouring rotations of one branch


@dataclass(frozen=True)
class StretchEnds:
    """Joints before and after a stretch, at the other ends of its rapid moves; None at the first and last."""

    before: Array | None = None  # (6,) rad
    after: Array | None = None  # (6,) rad
    onward: float = 0.0  # price of the following move, per rad of any joint


Merit = Callable[[CubicSpline, StretchEnds, float], float]
"""Worth of an answer, given what it is tied to, and the worst cost elsewhere."""


@dataclass(frozen=True, kw_only=True)
class RotationCorridor:
    """Corridor around the chosen rotation, per station (n of them) and step j = −REACH … REACH."""

    phi: Array  # (n,) rad, chosen rotation, unwrapped inside the run
    low: Array  # (n,) rad ≤ 0, feasible side below
    high: Array  # (n,) rad ≥ 0
    cost: Array  # (n, 2·REACH+1), dimensionless, edge values repeated beyond the corridor
    slope: Array  # (n, 6) dq/dphi at the chosen rotation
    step: float  # rad
    q: Array  # (n, 6) rad at the chosen rotation
    crowded: Array | None = None  # (n, 2·REACH+1) crowding, like ``cost``; None: not counted


@dataclass(kw_only=True)
class SmoothingStretch:
    """A continuous stretch of stations while it is being smoothed."""

    rows: NDArray[np.intp]  # stations
    points: NDArray[np.int32]  # their planning points
    band: RotationCorridor
    x: Array  # (n,) m, turning length at the stations
    terms: ObjectiveTerms  # of the objective, at the stations
    weight: float  # of its motion
    pins: dict[int, float]  # rad, fixed offsets by row
    offset: Array  # (n,) rad, present solution
    turns: bool = False  # the rotation may change along it
    spline: CubicSpline | None = None
    answers: tuple[CubicSpline, ...] = ()  # candidate curves, from the optimised to the simplest
    merit: Merit = lambda *_: float("inf")

    @classmethod
    def build(
        cls,
        path: PlanningPath,
        candidates: CandidateGrid,
        scores: CandidateScores,
        choice: SequenceChoice,
        rows: NDArray[np.intp],
        terms: ObjectiveTerms,
        band: RotationCorridor | None = None,
    ) -> SmoothingStretch:
        """Return the stretch of some stations.

        Args:
            path: planning points.
            candidates: candidate grid.
            scores: cost of the candidates.
            choice: sequence of the grid.
            rows: (n,) stations of the stretch.
            terms: terms of J at all stations.
            band: corridor of the stretch; None: it is computed.
        """
        points = path.stations[rows]
        band = compute_corridor(candidates, scores, choice, rows) if band is None else band
        turning = compute_turning_length(path, points[0], points[-1])
        return cls(
            rows=rows,
            points=points,
            band=band,
            x=turning[points - points[0]],
            terms=terms.take(rows),
            weight=float(path.motion_share[points[0]]),
            pins=_find_pins(path, rows, band.phi, terms.options),
            offset=np.zeros(len(rows)),
        )

    def bounds(self) -> tuple[Array, Array]:
        """Return the corridor, (n,) rad each, reduced to the exact value where the user fixed the rotation."""
        low, high = np.minimum(self.band.low, 0.0), np.maximum(self.band.high, 0.0)
        for row, value in self.pins.items():
            low[row] = high[row] = value
        return low, high

    def worst(self) -> float:
        """Return the largest cost where it counts, at the present offset."""
        at = np.flatnonzero(self.terms.counted)
        if not len(at):
            return 0.0
        return float(self._interpolate_table(self.band.cost, self.offset)[at].max())

    def _interpolate_table(self, table: Array, offset: Array) -> Array:
        """Interpolate a table (n, 2·REACH+1) of the corridor linearly at offsets (…, n) rad."""
        x = np.clip(offset / self.band.step + REACH, 0, 2 * REACH - 1e-9)
        k, row = x.astype(int), np.arange(table.shape[0])
        low, high = table[row, k], table[row, k + 1]
        return np.asarray(low + (x - k) * (high - low))

    def joints(self) -> Array:
        """Return the (n, 6) joints in rad, to first order in the offset."""
        return self.joints_at(self.offset)

    def joints_at(self, offset: Array, rows: Any = slice(None)) -> Array:
        """Return the (…, n, 6) joints in rad at given offsets, to first order.

        Args:
            offset: (…, n) rad, of all stations, or of some rows of them.
            rows: these rows.
        """
        return np.asarray(self.band.q[rows] + self.band.slope[rows] * offset[..., None])

    def price(self, cost: Array, offset: Array) -> Array:
        """Return the (…) contribution to J without the worst index and rapid moves.

        Args:
            cost: (…, n) cost at the offsets, in units of c₀.
            offset: (…, n) rad.
        """
        phi = self.band.phi + offset
        inside = self.terms.steps(self.joints_at(offset), phi).sum(axis=-1)
        crowded = 0.0 if self.band.crowded is None else self._interpolate_table(self.band.crowded, offset)
        return np.asarray(self.terms.nodes(cost, phi, crowded).sum(axis=-1) + inside)

    def price_of_flights(self, first: Array, last: Array, ends: StretchEnds) -> float:
        """Return the price of the rapid moves at its ends.

        Args:
            first: (6,) rad, joints at the beginning of the stretch.
            last: (6,) rad, joints at its end.
            ends: joints before and after the rapid moves.
        """
        here = self.terms.weights.travel * float(self.terms.travel[0])
        flown = ((first, ends.before, here), (last, ends.after, ends.onward))
        return float(sum(price * np.abs(own - other).sum() for own, other, price in flown if other is not None))


def compute_corridors(
    candidates: CandidateGrid, scores: CandidateScores, choice: SequenceChoice, parts: list[NDArray[np.intp]]
) -> Iterator[RotationCorridor]:
    """Yield the corridor of each of many stretches, computed together: a job of holes has thousands of short ones.

    With a cache they are computed one by one, so that a re-planned job finds the unchanged ones.

    Args:
        candidates: candidate grid.
        scores: cost of the candidates.
        choice: sequence of the grid.
        parts: stations of each stretch.
    """
    if is_cache_active() or not parts:
        yield from (compute_corridor(candidates, scores, choice, rows) for rows in parts)
        return
    tables = [scores.cost] if scores.crowded is None else [scores.cost, scores.crowded]
    whole = _build_grid_corridor(candidates, tables, choice, np.concatenate(parts))
    whole = replace(whole, cost=whole.cost / scores.scale)
    first = 0
    for rows in parts:
        some = slice(first, first + len(rows))
        first = some.stop
        yield replace(
            whole,
            phi=_get_chosen_rotations(candidates, choice, rows),
            low=whole.low[some].copy(),
            high=whole.high[some].copy(),
            cost=whole.cost[some],
            slope=whole.slope[some],
            q=whole.q[some],
            crowded=None if whole.crowded is None else whole.crowded[some],
        )


def _get_chosen_rotations(candidates: CandidateGrid, choice: SequenceChoice, rows: NDArray[np.intp]) -> Array:
    """(n,) rad, unwrapped along the stretch."""
    return np.unwrap(candidates.phi_of(rows, np.maximum(choice.rotation[rows], 0)))


def compute_corridor(
    candidates: CandidateGrid, scores: CandidateScores, choice: SequenceChoice, rows: NDArray[np.intp]
) -> RotationCorridor:
    """Extend the corridor from the chosen vertex to both sides while the same branch and turn stay feasible.

    Args:
        candidates: candidate grid.
        scores: cost of the candidates.
        choice: sequence of the grid.
        rows: (n,) stations of the stretch.
    """
    b, tables = choice.branch[rows], [scores.cost] if scores.crowded is None else [scores.cost, scores.crowded]

    def inputs() -> tuple[object, ...]:
        of_branch = [table[rows, :, b] for table in (candidates.q, candidates.feasible, *tables)]
        r = choice.rotation[rows]
        return (
            candidates.phi,
            candidates.phi_of(rows, np.maximum(choice.rotation[rows], 0)),
            candidates.turns,
            r,
            b,
            *of_branch,
        )

    walked = compute_cached(
        "corridor", lambda: (*inputs(), choice.q[rows]), lambda: _build_grid_corridor(candidates, tables, choice, rows)
    )
    return replace(walked, cost=walked.cost / scores.scale)


def _build_grid_corridor(
    candidates: CandidateGrid, tables: list[Array], choice: SequenceChoice, rows: NDArray[np.intp]
) -> RotationCorridor:
    """The corridor with its cost in the unit of the table."""
    R = len(candidates.phi)
    grid = 2 * np.pi / R
    stride = max(1, round(STEP / grid))  # a finer grid uses every n-th step, so that its corridor is as wide
    r, b = choice.rotation[rows], choice.branch[rows]
    phi = _get_chosen_rotations(candidates, choice, rows)
    n = len(rows)
    found = np.empty((len(tables), n, 2 * REACH + 1))
    found[:, :, REACH] = [table[rows, r, b] for table in tables]
    limit, reached = np.zeros((n, 2)), np.zeros((n, 2))
    neighbour = np.stack([choice.q[rows], choice.q[rows]])
    for side, sign in ((0, -1), (1, 1)):
        alive, previous = np.ones(n, bool), choice.q[rows]
        seen = found[:, :, REACH]
        for j in range(1, min(REACH * stride, R) + 1):
            rj = (r + sign * j) % R
            base = candidates.q[rows, rj, b]
            q = previous + wrap_angle(base - previous)
            turn = (np.round((q - base)[:, None] / (2 * np.pi)) == np.round(candidates.turns / (2 * np.pi))).all(axis=2)
            alive &= compute_any_last(candidates.feasible[rows, rj, b] & turn)
            alive &= np.abs(q - previous).max(axis=1) < SIDE_STEP
            limit[alive, side] = sign * j * grid
            seen = np.where(alive, [table[rows, rj, b] for table in tables], seen)
            if j % stride == 0:
                found[:, :, REACH + sign * (j // stride)] = seen
            previous = np.where(alive[:, None], q, previous)
            if j == 1:
                neighbour[side], reached[:, side] = previous, alive * grid
        for column in range(min(REACH * stride, R) // stride + 1, REACH + 1):  # one full turn
            found[:, :, REACH + sign * column] = seen
    span = np.maximum(reached.sum(axis=1), 1e-12)[:, None]
    return RotationCorridor(
        phi=phi,
        low=limit[:, 0],
        high=limit[:, 1],
        cost=found[0],
        slope=(neighbour[1] - neighbour[0]) / span,
        step=stride * grid,
        q=choice.q[rows],
        crowded=found[1] if len(found) > 1 else None,
    )


def compute_turning_length(path: PlanningPath, first: int, last: int) -> Array:
    """Return the path length in m from ``first`` on which the rotation may change: plunges do not count.

    Args:
        path: planning points.
        first: first planning point.
        last: last planning point.
    """
    step = np.diff(path.s[first : last + 1])
    step[path.plunge[first + 1 : last + 1]] = 0.0
    return np.asarray(np.r_[0.0, np.cumsum(step)])


def _find_pins(path: PlanningPath, rows: NDArray[np.intp], phi: Array, options: PlanOptions) -> dict[int, float]:
    """Return the user's fixed rotations in this run: row to exact offset from the grid's phi."""
    points = path.stations[rows]
    row_of = {int(point): i for i, point in enumerate(points)}
    fixed = find_fixed_rotations(path, options).items()
    return {row_of[row]: float(wrap_angle(target - phi[row_of[row]])) for row, target in fixed if row in row_of}
