"""Where the external joints stand: at home, at one value for each operation, or moving along the path.

A run cannot be left to move a rail, so operations that share a run share a value. For each such group a grid of values
is laid over the ranges of its joints, coarse first and then finer around the best, and each is judged by some stations
(:mod:`machopt.plan.values`), where the best sequence has the mean m, the worst w and motion. c₀, the unit of the index,
is the median over the candidates of all values. The best few are then planned in full
(:func:`machopt.plan.pipeline.plan`), with home among them, and the best plan is taken: fewest points lost, then least
J. Joints that may move along the path are first held at such values too; the way of :mod:`machopt.plan.moving`, of all
of them or of some, is planned in full beside them, and never taken where it is worse.

    J = Σ share·(m + motion) + w_worst·max w + Σ price·|Δe|
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import ExternalAxis, PlanOptions
from machopt.domain.steering import kept, steered
from machopt.domain.toolpath import Toolpath
from machopt.plan.along import fewer, moved
from machopt.plan.axes import axes_of
from machopt.plan.groups import Group, groups_of
from machopt.plan.made import Plan
from machopt.plan.part import rows_of
from machopt.plan.path import Path, build_path
from machopt.plan.pipeline import plan
from machopt.plan.refine_external import refined
from machopt.plan.setup import Timings, prepare
from machopt.plan.stands import refuse_strangers
from machopt.plan.timeline import build_timeline
from machopt.plan.values import PREFERRED, STEP, Values

PLANNED = 3  # values planned in full where all can be driven
TRIED = 8  # where the first ones cannot
AS_GOOD = 1.15  # times the best estimate: home is planned in full below that
MOVES_TRIED = 2  # the same where the joints may move along the path


def best_plan(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: Timings | None = None,
    before: Plan | None = None,
    *,
    scale: float | None = None,
) -> Plan:
    """Plan one toolpath, the external joints where they serve it best by their modes.

    Args:
        before: a plan of the same but for the user's wishes (:func:`machopt.plan.pipeline.plan`).
        scale: c₀ of a plan that this one belongs to; None: of its own.

    Raises:
        InputError: an option names no external joint or asks for what is not planned.
    """
    clock = timings or Timings()
    axes = axes_of(cell, options)
    refuse_strangers(cell, options.steer)
    if not cell.external_joints:
        return plan(cell, toolpath, options, clock, before=before, scale=scale)
    found = _coarse_to_fine(cell, toolpath, options, clock, before, axes, scale)
    if any(wish.joint for wish in options.steer):  # where such a wish holds a joint only the curves of the search know
        return found
    groups = groups_of(cell, toolpath, found.path, axes, found.options.steer)
    if all((g.low == g.high).all() for g in groups):
        return found
    return refined(found, toolpath, groups, axes, clock, PREFERRED, before)


def _coarse_to_fine(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    clock: Timings,
    before: Plan | None,
    axes: Sequence[ExternalAxis],
    scale: float | None,
) -> Plan:
    """The best plan over grids of values, and along a curve between them where the joints may move."""
    options = steered(options, toolpath)
    with clock.stage("prepare"):
        setup = prepare(cell, options) if before is None else before.setup
        path = build_path(toolpath, kept(options))
        groups = groups_of(cell, toolpath, path, axes, options.steer)
    if all((g.low == g.high).all() and not g.moves.any() for g in groups):
        at = _spread(path, groups, [g.low for g in groups])
        return plan(cell, toolpath, options, clock, setup=setup, external=at, before=before, scale=scale)
    with clock.stage("external"):
        search = Values(setup, options, path, groups, axes, scale)
        search.judge()
    best: tuple[tuple[float, float], Plan] | None = None
    seen: list[list[Array]] = []

    def planned(values: list[Array]) -> Plan:
        nonlocal best
        seen.append(values)
        at = _spread(path, groups, values)
        found = plan(cell, toolpath, options, clock, setup=setup, external=at, scale=search.scale, before=before)
        key = _lost(found), found.chosen.objective.total + search.liking(values)
        if best is None or key < best[0]:
            best = key, found
        return found

    moves, must = any(g.moves.any() for g in groups), any(g.must.any() for g in groups)
    whole, tried = 0, MOVES_TRIED if moves else TRIED
    while len(seen) < tried and whole < PLANNED:
        values = search.chain()
        if values is None:
            break
        bad = [
            n for n in _lost_groups(planned(values), groups) if np.ptp([groups[n].low, groups[n].high], axis=0).any()
        ]
        whole += not bad
        for n in bad or ([0] if len(groups) == 1 else []):
            search.exclude(n, values[n], 0.5 if bad else 0.25)
        if not bad and len(groups) > 1:
            break
    home = search.at_home()
    new = not any(np.array_equal(home, values) for values in seen)
    if new and (best is None or best[0][0] or search.estimate(home) <= AS_GOOD * search.estimate(seen[0])):
        planned(home)
    if best is None:
        raise AssertionError("home has been planned")
    if not moves:
        return best[1]
    with clock.stage("external"):
        fixed = best[1].path.external
        stands = [fixed[rows_of(path, g.runs)[0]] for g in groups]
        ways = [
            moved(setup, options, path, some, axes, stands, search.scale)
            for some in fewer(groups, stands, cell.external_home)
        ]
    looks = replace(options, rotation_step=max(options.rotation_step, STEP)) if len(ways) > 1 else options

    def along(at: Array, options: PlanOptions = options) -> tuple[tuple[float, float], Plan]:
        found = plan(cell, toolpath, options, clock, setup=setup, external=at, scale=search.scale, before=before)
        return (_lost(found), found.chosen.objective.total + search.liking_along(at)), found

    looked = [along(at, looks) for at in ways]
    k = min(range(len(ways)), key=lambda k: looked[k][0])
    key, found = looked[k] if looks.rotation_step == options.rotation_step else along(ways[k])
    if must:  # no place keeps what was asked
        return found
    if not key < best[0]:
        return best[1]
    if best[0][0] == 0:  # there is another answer, should this one not be driven
        with clock.stage("external"):
            timeline = build_timeline(found, toolpath)
        if timeline.trajectory is None:
            return best[1]
    return found


def _lost_groups(found: Plan, groups: Sequence[Group]) -> list[int]:
    """Groups with points that have no configuration, or with breaks."""
    path = found.path
    runs = set(path.run[found.missing[path.may_touch[found.missing]]].tolist())
    for b in found.breaks:
        if np.isfinite(b.after):
            runs.add(int(path.run[np.searchsorted(path.index, b.after - 1e-9)]))
    return [n for n, group in enumerate(groups) if runs & set(group.runs)]


def _lost(found: Plan) -> float:
    """Points that have no configuration, and breaks."""
    missing = found.missing[found.path.may_touch[found.missing]]
    return float(len(missing) + len(found.breaks))


def _spread(path: Path, groups: Sequence[Group], values: Sequence[Array]) -> Array:
    """(P, E) the values of the groups at the planning points."""
    out = np.empty((len(path.index), len(values[0])))
    for group, value in zip(groups, values, strict=True):
        out[rows_of(path, group.runs)] = value
    return out
