"""What one tool cuts of one toolpath, ready to be looked at from anywhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.model.machine import load_machine
from machopt.placement.asked import Shift
from machopt.placement.freedom import free_outlook
from machopt.placement.moved import Carried, moved
from machopt.placement.outlook import Outlook, outlook
from machopt.plan.best.base import best_plan
from machopt.plan.configurations.candidates import PlanningArm
from machopt.plan.external.axes import axes_of
from machopt.plan.external.groups import Group, groups_of
from machopt.plan.job.joined import Stretch, joined, shares_of
from machopt.plan.job.run import driven
from machopt.plan.job.worst_over_tools import together
from machopt.plan.pipeline.breaks import Break
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Setup, Timings, prepare, standing
from machopt.plan.stations.path import Path, build_path
from machopt.plan.stations.subpath import rows_of
from machopt.plan.written.explain import all_breaks, explain_points


@dataclass(frozen=True, eq=False)
class Task:
    """A stint; its springs and its chain are the same at every place."""

    stint: Stint
    setup: Setup  # without collisions
    path: Path  # external joints where they are locked, else at home
    groups: tuple[Group, ...]  # operations that share where external joints stand; empty without these

    @classmethod
    def of(cls, stint: Stint, options: PlanOptions) -> Task:
        cell, path = stint.cell, build_path(stint.toolpath)
        setup = prepare(cell, replace(options, collision=False))
        if not cell.external_joints:
            return cls(stint, setup, path, ())
        groups = groups_of(cell, stint.toolpath, path, axes_of(cell, options))
        at = np.empty((len(path.index), len(cell.external_joints)))
        for group in groups:
            at[rows_of(path, group.runs)] = np.clip(cell.external_home, group.low, group.high)
        return cls(stint, setup, standing(path, at), tuple(groups))

    @property
    def free(self) -> bool:
        """External joints may choose where they stand."""
        return any((g.high > g.low).any() for g in self.groups)

    @property
    def length(self) -> float:
        """m that are cut."""
        step = np.linalg.norm(np.diff(self.path.position, axis=0), axis=1)
        return float(step @ self.path.counted[1:])

    def outlook(self, carried: Carried, shift: Shift, options: PlanOptions) -> Outlook:
        """What a place promises."""
        cell = moved(self.setup.driven, carried, shift)
        arm = PlanningArm.of(cell, self.setup.arm.solver, load_machine(cell, self.setup.robot), options)
        if self.free:
            found = free_outlook(self.setup, arm, self.path, options, self.groups)
        else:
            found = outlook(self.setup, arm, self.path, options)
        return replace(found, point=found.point + self.stint.first)


def stints_whole(cell: Cell, toolpath: Toolpath) -> tuple[Stint, ...]:
    """A job that changes no tools."""
    home = cell.stands_at_home
    return (Stint(cell=cell, toolpath=toolpath, whole=toolpath, first=0, begin=home, end=home),)


def planned_at(
    stints: Sequence[Stint], carried: Carried, shift: Shift, options: PlanOptions
) -> tuple[Plan, float, str]:
    """A job planned at a place, to its motion: the plan, its time in s, and why there is no motion (else empty)."""
    here = [replace(stint, cell=moved(stint.cell, carried, shift)) for stint in stints]
    plans: list[Plan] = []
    for stint in here:
        plans.append(_planned(stint, len(here), plans[0].scores.scale if plans else None, options))
    scale, bound = plans[0].scores.scale, None  # of all: the worst index is that of the whole job
    if len(plans) > 1:
        plans, bound = together(plans, shares_of(plans), Timings())

    def again(stint: Stint) -> Callable[[PlanOptions], Plan]:
        return lambda other: _planned(stint, len(here), scale if len(here) > 1 else None, other)

    seconds, why = 0.0, ""
    for k, stint in enumerate(here):
        plans[k], _, timeline = driven(stint, plans[k], options, Timings(), again(stint))
        if timeline is None or timeline.trajectory is None:
            why = _lost(plans[k], timeline.obstructions if timeline is not None else ())
            break
        seconds += float(timeline.trajectory.time[-1])
    done = [Stretch(one, s.first, s.tool) for one, s in zip(plans, here, strict=True)]
    return joined(done, bound) if len(done) > 1 else plans[0], seconds, why


def _planned(stint: Stint, count: int, scale: float | None, options: PlanOptions) -> Plan:
    """One tool's plan; between others the machine stands where tools are changed."""
    one = best_plan(stint.cell, stint.toolpath, stint.of(options), Timings(), scale=scale)
    begin, end = (stint.begin if stint.number > 1 else None), (stint.end if stint.number < count else None)
    return replace(one, begin=begin, end=end) if count > 1 else one


def _lost(one: Plan, obstructions: Sequence[Break]) -> str:
    """The first reason why a plan is not driven."""
    points = [f"point {one.path.index[p]:g}: {sentence}" for p, sentence in explain_points(one).items()]
    breaks = [f"{b.where}: {b.text}" for b in (*all_breaks(one), *obstructions)]
    return (*points, *breaks, "it could not be driven")[0]
