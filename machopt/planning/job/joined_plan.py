"""Joined plan of a job with tool changes: each tool's stretch is planned by itself.

Between two stretches the machine rests at one known pose, where the tool is changed. The motions of the stretches are
therefore independent. With s_k a stretch's share of the length cut the whole has

    J = Σ s_k (J_k − w_worst·m_k) + w_worst·max m_k,    m_k its worst index in units of one c₀ (the first stretch's)

The stretches are planned for J_k alone, and then for the common worst index
(:mod:`machopt.planning.job.worst_index_over_tools`). Without that step, Σ s_k·bound_k is a lower bound of
the whole, as Σ s_k = 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import PlanObjective, compute_total
from machopt.planning.cost.stiffness_index import CandidateScores, LoadDirections
from machopt.planning.pipeline.plan_data_types import PathCompensation, Plan, ToolPlanPart
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.pipeline.sequence_breaks import CHANGE, HOME, SequenceBreak
from machopt.planning.sampling.candidate_grid import CandidateGrid, spread_branches
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.stations.planning_path import PlanningPath

OPTIONAL_FIELDS = ("untilted", "lead", "side", "unshifted")  # of a path; one stretch may have them, another not
NO_OPTIONAL_FIELDS: dict[str, Any] = dict.fromkeys(OPTIONAL_FIELDS)
COUNTED_UP = ("time", "s")  # columns of a path that increase over all stretches


@dataclass(frozen=True)
class ToolSegmentPlan:
    """One tool's plan before it is joined with the others."""

    plan: Plan  # its toolpath indices count from the stretch's first point
    first: int  # toolpath point of the whole
    tool: str


def join_plans(
    stretches: Sequence[ToolSegmentPlan], bound: float | None = None, options: PlanOptions | None = None
) -> Plan:
    """Return the job as one plan, with its stretches in ``parts``.

    Args:
        stretches: plans in order.
        bound: as in :class:`~machopt.planning.pipeline.plan_data_types.Plan`.
        options: of the whole job; None: those of the first stretch.
    """
    plans = [_place_in_job(s) for s in stretches]
    share = compute_length_shares(plans)
    rows = np.cumsum([0, *(len(p.path.index) for p in plans)])[:-1]
    stations = np.cumsum([0, *(len(p.path.stations) for p in plans)])[:-1].tolist()
    first, options = plans[0], options or plans[0].options

    def scored(of: Callable[[Plan], ScoredAssignment]) -> ScoredAssignment:
        some = [of(p) for p in plans]
        assignment = replace(
            some[0].assignment,
            **{
                f.name: _stack_arrays([getattr(s.assignment, f.name) for s in some]) for f in fields(some[0].assignment)
            },
        )
        cost = np.concatenate([s.cost for s in some])
        return ScoredAssignment(assignment, cost, _sum_objectives([s.objective for s in some], share, options))

    numbers = np.unique(np.concatenate([p.candidates.branch for p in plans]))
    candidates = _join_candidates([p.candidates.expand_branches(numbers) for p in plans])
    return Plan(
        setup=first.setup,
        options=options,
        path=_join_paths([p.path for p in plans]),
        directions=LoadDirections(
            **{f.name: _stack_arrays([getattr(p.directions, f.name) for p in plans]) for f in fields(LoadDirections)}
        ),
        candidates=candidates,
        scores=_join_scores(plans, numbers),
        choice=_join_choices(plans, candidates, stations),
        chosen=scored(lambda p: p.chosen),
        chosen_from=" / ".join(dict.fromkeys(p.chosen_from for p in plans)),
        grid=_sum_objectives([p.grid for p in plans], share, options),
        cam_default=scored(lambda p: p.cam_default),
        jiao2022=scored(lambda p: p.jiao2022),
        check=None,
        rounds=sum(p.rounds for p in plans),
        breaks=tuple(b for p in plans for b in p.breaks),
        notes={int(row) + p: text for row, one in zip(rows, plans, strict=True) for p, text in one.notes.items()},
        ways={int(row) + p: b for row, one in zip(rows, plans, strict=True) for p, b in one.ways.items()},
        compensation=_join_compensations(plans),
        conflict=" ".join(p.conflict for p in plans if p.conflict),
        parts=tuple(ToolPlanPart(p, int(row), float(s)) for p, row, s in zip(plans, rows, share, strict=True)),
        bound=bound,
    )


def _join_scores(plans: Sequence[Plan], numbers: NDArray[np.intp]) -> CandidateScores:
    """Return the scores at all stations, over the branches ``numbers``; the prices where no tool has any are None."""

    def joined(tables: Sequence[Array | None], missing: float) -> Array:
        every = []
        for p, table in zip(plans, tables, strict=True):
            own = np.full(p.scores.cost.shape, missing) if table is None else table
            to = np.searchsorted(numbers, p.candidates.branch)
            every.append(spread_branches(own, to, len(numbers), missing, axis=2))
        return np.concatenate(every)

    place = [p.scores.place_price for p in plans]
    return CandidateScores(
        joined([p.scores.cost for p in plans], np.nan),
        plans[0].scores.index,
        plans[0].scores.scale,
        place_price=None if all(c is None for c in place) else joined(place, 0.0),
    )


def shift_break_indices(b: SequenceBreak, s: ToolSegmentPlan) -> SequenceBreak:
    """Return a break of a stretch with the toolpath indices of the whole job.

    Args:
        b: break with indices of the stretch.
        s: stretch that has the break.
    """
    begin, end = (HOME if at is None else CHANGE for at in (s.plan.begin, s.plan.end))
    text = f"with tool {s.tool}: {b.text}"
    return replace(b, before=b.before + s.first, after=b.after + s.first, text=text, begin=begin, end=end)


def _place_in_job(s: ToolSegmentPlan) -> Plan:
    """Return the plan with the toolpath indices of the whole job; its messages count points from the stretch's
    first.
    """
    notes = {p: f"with tool {s.tool}, points counted from {s.first}: {text}" for p, text in s.plan.notes.items()}
    return replace(
        s.plan,
        path=replace(s.plan.path, index=s.plan.path.index + s.first),
        breaks=tuple(shift_break_indices(b, s) for b in s.plan.breaks),
        ways={p: shift_break_indices(b, s) for p, b in s.plan.ways.items()},
        notes=notes if s.first else s.plan.notes,
        conflict=f"With tool {s.tool}, points counted from {s.first}: {s.plan.conflict}" if s.plan.conflict else "",
    )


def compute_length_shares(plans: Sequence[Plan]) -> Array:
    """Return (K,) shares of the length cut; of the counted points where nothing has a length.

    Args:
        plans: plans of the stretches.
    """
    length = []
    for p in plans:
        step = np.linalg.norm(np.diff(p.path.position, axis=0), axis=1)
        length.append(float(step @ p.path.counted[1:]))
    share = np.array(length) if sum(length) > 0 else np.array([float(p.path.counted.sum()) for p in plans])
    return share / share.sum() if share.sum() > 0 else np.full(len(plans), 1.0 / len(plans))


def _sum_objectives(parts: Sequence[PlanObjective], share: Array, options: PlanOptions) -> PlanObjective:
    """J of the whole, by the formula above; a stretch without cuts counts for its worst index only."""
    cuts = share > 0

    def mean(name: str) -> float:
        return float(share[cuts] @ np.array([getattr(o, name) for o in parts])[cuts])

    worst = max(o.worst for o in parts)
    whole = PlanObjective(
        total=math.nan,
        mean=mean("mean"),
        worst=worst,
        travel=mean("travel"),
        rotation=mean("rotation"),
        feed=mean("feed"),
        preferred=mean("preferred"),
        clearance=mean("clearance"),
        tolerance=sum(o.tolerance for o in parts),
        stability=mean("stability"),
        rapid=mean("rapid"),
        reorientation=sum(o.reorientation for o in parts),
    )
    return replace(whole, total=compute_total(whole, options.weights))


def _stack_arrays(arrays: Sequence[Array]) -> Any:
    """Concatenate arrays of numbers or flags; None where no stretch has any."""
    if arrays[0] is None:
        return None
    return np.concatenate(arrays)


def _join_paths(paths: Sequence[PlanningPath]) -> PlanningPath:
    """Return one path of all runs; the last of one stretch and the first of the next are not connected."""
    before = dict.fromkeys(COUNTED_UP, 0.0)
    columns: dict[str, list[Array]] = {}
    runs: list[tuple[int, int]] = []
    row = run = 0
    for path in paths:
        for f in fields(path):
            if f.name in OPTIONAL_FIELDS:
                continue
            value = getattr(path, f.name)
            if f.name == "runs":
                runs += [(a + row, b + row) for a, b in value]
                continue
            if f.name in COUNTED_UP:
                value = value + before[f.name]
                before[f.name] = float(value[-1])
            by = {"run": run, "stations": row}.get(f.name, 0)
            columns.setdefault(f.name, []).append(value + np.asarray(by, value.dtype) if by else value)
        row += len(path.index)
        run += int(path.run[-1]) + 1
    stacked: dict[str, Any] = {name: _stack_arrays(some) for name, some in columns.items()}
    whole = replace(paths[0], runs=tuple(runs), **stacked, **NO_OPTIONAL_FIELDS)
    if any(path.unshifted is not None for path in paths):
        whole = replace(whole, unshifted=np.concatenate([path.without_shift.position for path in paths]))
    return whole if all(path.untilted is None for path in paths) else _add_tilts(whole, paths)


def _add_tilts(planning_path: PlanningPath, paths: Sequence[PlanningPath]) -> PlanningPath:
    """Return the joined path with the tilts of its stretches, zero where a stretch has none."""
    tilts: dict[str, Any] = {
        name: np.concatenate(
            [np.zeros(len(path.index)) if path.lead is None else getattr(path, name) for path in paths]
        )
        for name in ("lead", "side")
    }
    return replace(
        planning_path, untilted=_join_paths([replace(path.programmed, index=path.index) for path in paths]), **tilts
    )


def _find_furthest_dropped(c: CandidateGrid) -> NDArray[np.uint8]:
    """Return (S, R, 1) the reason of the branch left out that came furthest."""
    if c.dropped is None:
        return np.full((*c.reason.shape[:2], 1), InfeasibilityReason.UNREACHABLE, np.uint8)
    return np.asarray(c.dropped.max(axis=2, keepdims=True))


def _join_candidates(some: Sequence[CandidateGrid]) -> CandidateGrid:
    """Return all stations of grids with the same branches, with the union of their whole turns."""
    turns = np.unique(np.concatenate([c.turns for c in some]), axis=0)
    feasible = []
    for c in some:
        wide = np.zeros((*c.feasible.shape[:3], len(turns)), bool)
        wide[..., _find_turn_rows(c.turns, turns)] = c.feasible
        feasible.append(wide)
    nudged = any(c.nudge is not None for c in some)
    nudge = [np.zeros(len(c.q)) if c.nudge is None else c.nudge for c in some]
    dropped = [_find_furthest_dropped(c) for c in some]
    return CandidateGrid(
        phi=some[0].phi,
        branch=some[0].branch,
        q=np.concatenate([c.q for c in some]),
        turns=turns,
        reason=np.concatenate([c.reason for c in some]),
        feasible=np.concatenate(feasible),
        stable=all(c.stable for c in some),
        shortfall=np.concatenate([c.shortfall for c in some]),
        nudge=np.concatenate(nudge) if nudged else None,
        dropped=None if all(c.dropped is None for c in some) else np.concatenate(dropped),
    )


def _find_turn_rows(turns: Array, among: Array) -> Array:
    """Return (T,) the row of ``among`` equal to each of ``turns``."""
    return np.array([int(np.flatnonzero((among == t).all(axis=1))[0]) for t in turns], np.intp)


def _join_choices(plans: Sequence[Plan], candidates: CandidateGrid, stations: Sequence[int]) -> SequenceChoice:
    choices = [p.choice for p in plans]
    turn, branch = [], []
    for p in plans:
        place = _find_turn_rows(p.candidates.turns, candidates.turns)
        turn.append(np.where(p.choice.turn >= 0, place[np.maximum(p.choice.turn, 0)], -1).astype(p.choice.turn.dtype))
        to = np.searchsorted(candidates.branch, p.candidates.branch)
        branch.append(np.where(p.choice.branch >= 0, to[p.choice.branch], -1).astype(p.choice.branch.dtype))
    return SequenceChoice(
        rotation=np.concatenate([c.rotation for c in choices]),
        branch=np.concatenate(branch),
        turn=np.concatenate(turn),
        q=np.concatenate([c.q for c in choices]),
        broken=tuple(s + at for c, at in zip(choices, stations, strict=True) for s in c.broken),
    )


def _join_compensations(plans: Sequence[Plan]) -> PathCompensation | None:
    """Return the shifts of all stretches; None where a stretch has none."""
    some = [p.compensation for p in plans if p.compensation is not None]
    if not some:
        return None
    every = [p.compensation or _build_no_compensation(len(p.path.index)) for p in plans]
    return PathCompensation(
        offset=np.concatenate([c.offset for c in every]),
        force=np.concatenate([c.force for c in every]),
        length=max(c.length for c in every),
        fade=max(c.fade for c in every),
        lost=np.concatenate([c.lost for c in every]),
    )


def _build_no_compensation(count: int) -> PathCompensation:
    """Return a shift of zero at a number of planning points."""
    zero = np.zeros((count, 3))
    lost = np.zeros(count, bool)
    return PathCompensation(offset=zero, force=zero, length=0.0, fade=0.0, lost=lost)
