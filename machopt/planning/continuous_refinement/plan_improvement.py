"""Improvement of a plan by its continuous refinement: offsets proposed at stations are tried on the whole path.

:class:`machopt.planning.continuous_refinement.refinement.PlanRefinement` finds offsets at stations. Between these a
pose may be lost or touch something, so the full offsets are tried first, then a share of them. The refinement
continues from the result that can be driven and is better. Candidates and choice of a refined plan are those of the
plan it began with. :func:`plan_on_other_grid` plans the final result in full, with its external joints, because the
search may find a better rotation for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.continuous_refinement.refinement import TRUST, PlanRefinement, RefinementResult
from machopt.planning.continuous_refinement.starting_point import RefinementStart
from machopt.planning.cost.lost_feed_time import compute_lost_time
from machopt.planning.cost.objective import AssignmentCosts, compute_objective, compute_total
from machopt.planning.cost.stiffness_index import LoadDirections, compute_load_directions
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.motion.trajectory_builder import has_motion
from machopt.planning.pipeline.baseline_comparison import is_assignment_allowed
from machopt.planning.pipeline.path_planner import PathVariant
from machopt.planning.pipeline.path_planner import plan_path as planned
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings, fix_external_axes
from machopt.planning.sampling.joint_path import solve_joint_path
from machopt.planning.stations.planning_path import PlanningPath

PASSES = 3  # of the refinement at most
SHARES = (1.0, 0.6, 0.3)  # shares of its offsets that are tried
GAINS = 1e-3  # share of the objective: a smaller gain does not justify another pass or a full plan

SAME = 1e-5  # share of the objective: plans that differ by less are at the same optimum


@dataclass(frozen=True, kw_only=True)
class RefinementJob:
    """What the refinements of the plans of one toolpath have in common."""

    toolpath: Toolpath
    groups: Sequence[OperationGroup]  # with the ranges of their external joints
    worth: AxisPlanRanking
    clock: StageTimings
    before: Plan | None = None  # as for :func:`machopt.planning.pipeline.path_planner.plan_path`


def refine_plan(
    plan: Plan,
    job: RefinementJob,
    below: float = np.inf,
    trust: float = TRUST,
    start: RefinementStart | None = None,
    passes: int = PASSES,
) -> Plan:
    """Return the plan with its external joints refined where that makes it better, else the plan itself.

    :func:`is_drivable` checks afterwards whether the result keeps the joint limits.

    Args:
        plan: plan to refine.
        job: toolpath, operation groups and ranking of the plans.
        below: ranking value that the result has to reach.
        trust: rad, trust region of the refinement's steps, initial and maximum value.
        start: starting point in place of the plan.
        passes: maximum number of refinement passes.
    """
    if plan.found is None or plan.breaks or len(plan.missing):
        return plan
    best = _Passes(plan=plan, job=job, trust=trust, passes=passes).best(start)
    return best if job.worth.plan(best) < below else plan


def is_drivable(plan: Plan, toolpath: Toolpath, clock: StageTimings) -> bool:
    """Return whether the whole motion of a plan keeps the limits of every joint.

    Args:
        plan: plan to check.
        toolpath: toolpath of the plan.
        clock: stage timings.
    """
    with clock.stage("external"):
        return has_motion(plan, toolpath)


def plan_on_other_grid(plan: Plan, step: float, job: RefinementJob) -> list[Plan]:
    """Return plans with another rotation step, best first: the result of the search there, and the own rotation.

    The rotation of a plan with external joints is a curve between the grid's steps and therefore valid on
    any grid. No grid makes a complete plan worse.

    Args:
        plan: plan with external joints.
        step: rad, step of the rotation grid.
        job: toolpath and ranking of the plans; no external joint moves.
    """
    on = replace(plan, options=replace(plan.options, rotation_step=step))
    return _Passes(plan=on, job=job).planned_again()


@dataclass(frozen=True, kw_only=True)
class _Passes:
    """Refinement passes of one plan without gaps or breaks."""

    plan: Plan
    job: RefinementJob
    trust: float = TRUST  # rad
    passes: int = PASSES

    def best(self, start: RefinementStart | None = None) -> Plan:
        """Return the result of the passes; the plan itself where none makes it better.

        Args:
            start: starting point in place of the plan.
        """
        best = self.plan
        for _ in range(self.passes):
            with self.job.clock.stage("external"):
                proposed = PlanRefinement(best, self.job.groups, self.job.worth, self.trust).found(start)
                start = None
                if proposed is None or proposed.saved < GAINS * best.chosen.objective.total:
                    break
                better = self._find_best_share(best, proposed)
            if better is None:
                break
            gained, best = self.job.worth.plan(best) - self.job.worth.plan(better), better
            if gained < GAINS * better.chosen.objective.total:
                break
        return best

    def planned_again(self) -> list[Plan]:
        """Return the plan planned in full by its own options, best first: as searched where that is complete and not
        the same optimum, and with its own rotation where it is complete.
        """
        plan = self.plan
        is_incomplete = plan.found is None or bool(plan.breaks) or len(plan.missing) > 0
        searched = planned(
            plan.setup.cell,
            self.job.toolpath,
            plan.options,
            self.job.clock,
            setup=plan.setup,
            variant=PathVariant(
                external=plan.path.external, below=np.inf if is_incomplete else _compute_searched_objective(plan)
            ),
            scale=plan.scores.scale,
            before=self.job.before,
        )
        if is_incomplete:
            return [searched]
        # the price of rapid moves follows from the stations' external joints
        own = replace(searched, chosen_from=plan.chosen_from, check=plan.check, breaks=())
        own = replace(rescore_plan(own, plan.chosen.assignment), over_external=plan.over_external)
        gained = self.job.worth.plan(own) - self.job.worth.plan(searched)
        is_better = self._is_better(searched, own) and gained > SAME * own.chosen.objective.total
        return [searched, own] if is_better else [own]

    def _is_better(self, one: Plan, other: Plan) -> bool:
        return not one.breaks and not len(one.missing) and self.job.worth.plan(one) < self.job.worth.plan(other)

    def _find_best_share(self, plan: Plan, proposed: RefinementResult) -> Plan | None:
        """Return the plan with the largest share of the offsets that makes it better and drivable; None where none
        does.
        """
        a = plan.chosen.assignment
        for share in SHARES:
            external = plan.path.external + share * (proposed.external - plan.path.external)
            phi = a.phi + share * (proposed.phi - a.phi)
            seed = proposed.seed if share == 1.0 else a.q + share * (proposed.seed - a.q)
            path = fix_external_axes(plan.path, external)
            there = replace(plan, path=path, directions=_compute_directions(plan, path))
            found = self._rate_rotation(there, phi, seed)
            if found is not None and self._is_better(found, plan):  # before contacts, which cost far more than J
                check = self._find_contacts(found)
                if check.free:
                    return replace(found, check=check)
        return None

    def _rate_rotation(self, plan: Plan, phi: Array, seed: Array) -> Plan | None:
        """Return the plan with another rotation (P,) rad, its poses next to some (P, 6) rad, contacts not yet checked;
        None where it is infeasible.
        """
        path, setup = plan.path, plan.setup
        if plan.found is None:
            return None
        a = solve_joint_path(path, setup.arm, setup.robot, phi, seed)
        if (a.reason != InfeasibilityReason.OK).any() or not is_assignment_allowed(a, path, plan.options):
            return None
        return replace(rescore_plan(plan, a), chosen_from="smooth", breaks=())

    def _find_contacts(self, plan: Plan) -> PathCollisions:
        setup, a = plan.setup, plan.chosen.assignment
        checker = PathCollisionChecker.build(plan.path, setup.arm, setup.robot, setup.collision, plan.options)
        return checker.whole(a.phi, a.q)


def _compute_searched_objective(plan: Plan) -> float:
    """Return J of a plan as the search counts it: the travel of its external joints, a constant there, is left out."""
    a, objective, cell = plan.chosen.assignment, plan.chosen.objective, plan.setup.cell
    late = compute_lost_time(plan.path, plan.setup.drives, plan.options, a.q, a.phi)
    costs = AssignmentCosts(cost=plan.chosen.cost, q=a.q, phi=a.phi, late=late)
    own = compute_objective(plan.path, costs, plan.scores.scale, cell.limits.velocity[:6], plan.options)
    return compute_total(
        replace(objective, travel=own.travel, feed=own.feed), plan.options.weights, plan.scores.elsewhere
    )


def _compute_directions(plan: Plan, path: PlanningPath) -> LoadDirections:
    return compute_load_directions(path, plan.setup.arm, plan.setup.elasticity, plan.options.force)
