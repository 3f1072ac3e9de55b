"""What one tool cuts of one toolpath, ready to be looked at from anywhere."""

from __future__ import annotations

from collections.abc import Sequence
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
from machopt.plan.axes import axes_of
from machopt.plan.candidates import Arm
from machopt.plan.drive import motion_of
from machopt.plan.explain import all_breaks, explain_points
from machopt.plan.external import best_plan
from machopt.plan.groups import Group, groups_of
from machopt.plan.joined import Stretch, joined, shares_of
from machopt.plan.made import Plan
from machopt.plan.part import rows_of
from machopt.plan.path import Path, build_path
from machopt.plan.setup import Setup, Timings, prepare, standing
from machopt.plan.together import together


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
        arm = Arm.of(cell, self.setup.arm.solver, load_machine(cell, self.setup.robot), options)
        if self.free:
            found = free_outlook(self.setup, arm, self.path, options, self.groups)
        else:
            found = outlook(self.setup, arm, self.path, options)
        return replace(found, point=found.point + self.stint.first)


def stints_whole(cell: Cell, toolpath: Toolpath) -> tuple[Stint, ...]:
    """A job that changes no tools."""
    home = cell.stands_at_home
    return (Stint(cell, toolpath, toolpath, 0, home, home),)


def planned_at(
    stints: Sequence[Stint], carried: Carried, shift: Shift, options: PlanOptions
) -> tuple[Plan, float, str]:
    """A job planned at a place, to its motion: the plan, its time in s, and why there is no motion (else empty)."""
    plans: list[Plan] = []
    for k, stint in enumerate(stints):
        cell = moved(stint.cell, carried, shift)
        scale = plans[0].scores.scale if plans else None  # of all: the worst index is that of the whole job
        one = best_plan(cell, stint.toolpath, stint.of(options), Timings(), scale=scale)
        begin, end = (stint.begin if k else None), (stint.end if k + 1 < len(stints) else None)
        plans.append(replace(one, begin=begin, end=end))
    bound = None
    if len(plans) > 1:
        plans, bound = together(plans, shares_of(plans), Timings())
    seconds, done = 0.0, [Stretch(one, s.first, s.tool) for one, s in zip(plans, stints, strict=True)]
    whole = joined(done, bound) if len(done) > 1 else plans[0]
    for stint, one in zip(stints, plans, strict=True):
        timeline = motion_of(one, stint.toolpath, stint.of(options), Timings())
        if timeline is None or timeline.trajectory is None:
            return whole, seconds, _lost(whole)
        seconds += float(timeline.trajectory.time[-1])
    return whole, seconds, ""


def _lost(one: Plan) -> str:
    """The first reason why a plan is not driven."""
    points = [f"point {one.path.index[p]:g}: {sentence}" for p, sentence in explain_points(one).items()]
    breaks = [f"{b.where}: {b.text}" for b in all_breaks(one)]
    return (*points, *breaks, "it could not be driven")[0]
