"""Rotation as a smooth curve along the path, between and beyond the grid steps.

In each run phi(s) is a cubic B-spline over path length (plunges excluded: there it is constant). It minimises the
objective (:mod:`machopt.planning.cost.objective`, by :mod:`machopt.planning.smoothing.newton_solver`) with the cost of
the chosen branch interpolated from the grid, inside the corridor of feasible rotations around the grid optimum, with
joint speeds limited by the programmed feed. Runs without travel (drilling) have one rotation: the vertex of a
parabola.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools, Ints
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.joint_path import interpolate_between_stations
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.smoothing.corridor import (
    REACH,
    SmoothingStretch,
    StretchEnds,
    compute_corridors,
    compute_turning_length,
)
from machopt.planning.smoothing.rotation_angle_spline import build_spline_solutions
from machopt.planning.stations.planning_path import PlanningPath

SWEEPS = 2  # over the runs
FINE = 8  # subdivisions of a grid step for runs with one rotation


@dataclass(frozen=True)
class SmoothedRotation:
    """Rotation at every planning point, and a seed for the joints."""

    phi: Array  # (P,) rad
    seed: Array  # (P, 6) rad


def smooth_rotation(
    path: PlanningPath,
    candidates: CandidateGrid,
    scores: CandidateScores,
    choice: SequenceChoice,
    velocity: Array,
    options: PlanOptions,
) -> SmoothedRotation:
    """Smooth every run of the choice. Stations without a vertex stay NaN, and so do the points around them.

    Args:
        path: planning points.
        candidates: candidate grid.
        scores: cost of the candidates.
        choice: sequence of the grid.
        velocity: (6,) rad/s, joint velocity limits.
        options: plan options with the weights.
    """
    worst = max(_compute_grid_worst(path, scores, choice), scores.elsewhere)
    rows = _list_stretch_rows(path, choice)
    terms = ObjectiveTerms.at_stations(path, velocity, options)
    parts = [
        SmoothingStretch.build(path, candidates, scores, choice, some, terms, band)
        for some, band in zip(rows, compute_corridors(candidates, scores, choice, rows), strict=True)
    ]
    for part, ends in zip(parts, [_get_stretch_ends(parts, n) for n in range(len(parts))], strict=True):
        if part.x[-1] > 0 and len(part.rows) >= 3:
            part.turns = True
            part.answers, part.merit = build_spline_solutions(
                path, part, _compute_worst_elsewhere(parts, part, scores), ends
            )
            if part.pins:  # where no curve stays in the corridor, the grid's own sequence is shifted to meet the pins
                part.offset = np.interp(part.x, part.x[list(part.pins)], list(part.pins.values()))
    # runs are coupled by the rapid moves between them, so each is chosen with the others fixed
    for _ in range(SWEEPS):
        for n, part in enumerate(parts):
            if part.turns:
                ends = _get_stretch_ends(parts, n)
                elsewhere = _compute_worst_elsewhere(parts, part, scores)
                value, spline = min(
                    ((part.merit(a, ends, elsewhere), a) for a in part.answers), key=lambda pair: pair[0]
                )
                if np.isfinite(value):
                    part.spline, part.offset = spline, spline(part.x) - part.band.phi
        _choose_constant_rotations(parts, worst)
    return _evaluate_stretches(path, parts)


def _list_stretch_rows(path: PlanningPath, choice: SequenceChoice) -> list[Ints]:
    """Return the stations of each stretch: runs, divided where the choice drops a vertex or breaks."""
    position = np.searchsorted(path.stations, np.arange(len(path.index)))
    dropped, broken = choice.dropped, frozenset(choice.broken)
    return [
        np.arange(a, b + 1)
        for first, last in path.runs
        for a, b in _list_unbroken_stretches(dropped, broken, position[first], position[last])
    ]


def _evaluate_stretches(path: PlanningPath, parts: list[SmoothingStretch]) -> SmoothedRotation:
    """Return rotation and seed at every planning point; NaN where no stretch lies."""
    P = len(path.index)
    phi, seed = np.full(P, np.nan), np.full((P, 6), np.nan)
    for part in parts:
        within = slice(part.points[0], part.points[-1] + 1)
        turning = compute_turning_length(path, part.points[0], part.points[-1])
        bend = part.spline(turning) if part.spline else np.interp(turning, part.x, part.band.phi + part.offset)
        phi[within] = bend
        near = part.joints()
        for i in range(6):
            seed[within, i] = np.interp(path.s[within], path.s[part.points], near[:, i])
        seed[part.points] = near
    return SmoothedRotation(phi=phi, seed=seed)


def _get_stretch_ends(parts: list[SmoothingStretch], n: int) -> StretchEnds:
    """Return the joints before and after the rapid moves of stretch n, with the other stretches as they are."""
    before = parts[n - 1].joints()[-1] if n else None
    if n + 1 == len(parts):
        return StretchEnds(before)
    after = parts[n + 1]
    return StretchEnds(before, after.joints()[0], after.terms.weights.travel * float(after.terms.travel[0]))


def _compute_worst_elsewhere(parts: list[SmoothingStretch], one: SmoothingStretch, scores: CandidateScores) -> float:
    """Return the worst cost of the other stretches, or of the other tools: a lower one here gains nothing."""
    return max(scores.elsewhere, *(p.worst() for p in parts if p is not one), 0.0)


def _choose_constant_rotations(parts: list[SmoothingStretch], worst: float) -> None:
    """Choose one rotation per drilling run, between the grid steps: the cheapest sequence over a fine grid (exact
    there).

    Holes are coupled by the joint travel between them, so they are chosen together. The cost between grid
    steps is the parabola through three of them.
    """
    fine = np.linspace(-1.0, 1.0, 2 * FINE + 1)
    choices, value, back = [], np.zeros(1), []
    previous = None
    for part in parts:
        free = not part.turns
        delta = fine * part.band.step if free else np.zeros(1)
        node = np.zeros(len(delta))
        if free:
            c0, c1, c2 = (part.band.cost[:, REACH + j] for j in (-1, 0, 1))
            cost = c1 + 0.5 * (c2 - c0) * fine[:, None] + 0.5 * (c0 - 2 * c1 + c2) * fine[:, None] ** 2  # (F, n)
            node = part.price(cost, np.broadcast_to(delta[:, None], cost.shape))
            low, high = float(part.band.low.max()), float(part.band.high.min())
            outside = (
                (delta < low - 1e-12)
                | (delta > high + 1e-12)
                | (cost[:, part.terms.counted] > worst * (1 + 1e-9)).any(axis=1)
            )
            if part.pins:
                delta, node, outside = np.array([next(iter(part.pins.values()))]), np.zeros(1), np.zeros(1, bool)
            node = np.where(outside & (np.abs(delta) > 1e-12), np.inf, node)
        offset = delta + (np.zeros((2, 1)) if free else part.offset[[0, -1]][:, None])  # (2, F)
        start = part.band.q[0] + part.band.slope[0] * offset[0][:, None]
        end = part.band.q[-1] + part.band.slope[-1] * offset[1][:, None]
        if previous is None:
            back.append(np.zeros(len(delta), int))
            value = node
        else:
            flown = np.abs(start[None] - previous[:, None]).sum(axis=-1)
            total = value[:, None] + part.terms.weights.travel * part.terms.travel[0] * flown
            back.append(total.argmin(axis=0))
            value = total.min(axis=0) + node
        previous = end
        choices.append(delta)
    pick = int(value.argmin())
    for part, delta, source in zip(parts[::-1], choices[::-1], back[::-1], strict=True):
        if not part.turns:
            part.offset = np.full(len(part.rows), delta[pick])
        pick = int(source[pick])


def follow_grid_rotation(path: PlanningPath, candidates: CandidateGrid, choice: SequenceChoice) -> SmoothedRotation:
    """Return the grid optimum itself, linear in path length between stations.

    Args:
        path: planning points.
        candidates: candidate grid.
        choice: sequence of the grid.
    """
    phi = np.where(choice.dropped, np.nan, candidates.phi_at(choice.rotation))
    run = path.run[path.stations]
    for n in np.unique(run):
        rows = np.flatnonzero((run == n) & ~choice.dropped)
        phi[rows] = np.unwrap(phi[rows])
    return SmoothedRotation(
        phi=interpolate_between_stations(path, phi), seed=interpolate_between_stations(path, choice.q)
    )


def _compute_grid_worst(path: PlanningPath, scores: CandidateScores, choice: SequenceChoice) -> float:
    at = np.flatnonzero(~choice.dropped & path.counted[path.stations])
    return float((scores.cost[at, choice.rotation[at], choice.branch[at]] / scores.scale).max(initial=0.0))


def _list_unbroken_stretches(dropped: Bools, broken: frozenset[int], a: int, b: int) -> list[tuple[int, int]]:
    """The parts of stations a…b without dropped stations or breaks."""
    out, start = [], None
    for s in range(a, b + 1):
        if start is not None and (dropped[s] or s in broken):
            out.append((start, s - 1))
            start = None
        if start is None and not dropped[s]:
            start = s
    if start is not None:
        out.append((start, b))
    return out
