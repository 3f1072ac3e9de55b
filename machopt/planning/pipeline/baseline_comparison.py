"""Baselines of a path, and the comparison of a search result with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import is_inside_zone, select_steered_rows
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.baselines import plan_cam_default, plan_jiao2022
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.planning.pipeline.collision_free_search import CollisionFreeSequence
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, ScoredAssignment
from machopt.planning.pipeline.sequence_breaks import find_configuration_jumps
from machopt.planning.sampling.joint_path import JointAssignment
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.planning_path import PlanningPath

PAPER, DEFAULT = "jiao2022", "cam default"  # sources of assignments without a search
PINNED = 1e-6  # rad, tolerance of a pin
BOUND_SLACK = np.radians(0.05)  # tolerance of the user's rotation bounds for the baselines


@dataclass(frozen=True, kw_only=True)
class PlannedPaths:
    """The path that is planned and that of the baselines, with the load directions at their points."""

    path: PlanningPath
    directions: LoadDirections
    at_home: PlanningPath  # external joints at home, tool axes of the CAM file
    at_home_d: LoadDirections
    same: bool  # both are the same path


@dataclass(frozen=True)
class SelectedAssignment:
    """The selected assignment."""

    chosen: ScoredAssignment
    source: str
    check: PathCollisions | None  # None: not needed, or already done
    searched: bool = False  # it is the result of the search


def build_baselines(
    before: Plan | None, paths: PlannedPaths, setup: PlanningSetup, options: PlanOptions
) -> tuple[JointAssignment, JointAssignment]:
    """Return the CAM baseline and the paper's, with the external joints at home; those of another plan, where there
    is one.
    """
    if before is not None:
        known = (before.cam_default.assignment, before.jiao2022.assignment)
        return known
    path, d = paths.at_home, paths.at_home_d
    by_file = _mark_collisions(plan_cam_default(path, setup.arm, setup.driven.home), path, setup, options)
    by_paper = plan_jiao2022(path, setup.arm, setup.elasticity, d, setup.collision, setup.driven.home, options)
    return by_file, _mark_collisions(by_paper, path, setup, options)


def _mark_collisions(
    assignment: JointAssignment, path: PlanningPath, setup: PlanningSetup, options: PlanOptions
) -> JointAssignment:
    """Return a baseline with its collisions marked, if it is otherwise drivable: only then a gain over it is
    reported.
    """
    if setup.collision is not None and (assignment.reason[path.may_touch] == InfeasibilityReason.OK).all():
        q = np.where((assignment.reason == InfeasibilityReason.OK)[:, None], assignment.q, np.nan)
        found = PathCollisionChecker.build(path, setup.arm, setup.robot, setup.collision, options).whole(
            assignment.phi, q
        )
        return assignment.marked(found.lost, InfeasibilityReason.NO_PATH).marked(
            found.hit, InfeasibilityReason.COLLIDING
        )
    return assignment


def select_baseline(
    default: ScoredAssignment, paper: ScoredAssignment, path: PlanningPath, setup: PlanningSetup, options: PlanOptions
) -> SelectedAssignment:
    """Return the baseline that the method of the options names, with its contacts."""
    chosen, source = (paper, PAPER) if options.method == "jiao2022" else (default, DEFAULT)
    unstable = find_unstable_points(chosen.assignment, path, setup.arm)
    a = chosen.assignment
    if unstable.any():
        a = a.marked(unstable, InfeasibilityReason.UNSTABLE)
        chosen = replace(chosen, assignment=a)
    checker = PathCollisionChecker.build(path, setup.arm, setup.robot, setup.collision, options)
    q = np.where((a.reason == InfeasibilityReason.OK)[:, None], a.q, np.nan)
    return SelectedAssignment(chosen, source, checker.whole(a.phi, q))


def select_best_assignment(
    sequence: CollisionFreeSequence,
    scored: Callable[[JointAssignment], ScoredAssignment],
    others: Sequence[ScoredAssignment],
    path: PlanningPath,
    options: PlanOptions,
    arm: PlanningArm,
) -> SelectedAssignment:
    """Return the result of a search, or a baseline that is better: the paper's first, then the CAM file's."""
    best = SelectedAssignment(scored(sequence.assignment), sequence.source, sequence.check, searched=True)
    for other, name in zip(others, (PAPER, DEFAULT), strict=False):
        is_allowed = is_rotation_allowed(other.assignment.phi, path, options)
        is_allowed &= not find_unstable_points(other.assignment, path, arm).any()
        if is_allowed and other.objective.total < best.chosen.objective.total and _is_complete(other, path):
            best = SelectedAssignment(other, name, None)
    return best


def find_unstable_points(a: JointAssignment, path: PlanningPath, arm: PlanningArm) -> Bools:
    """Return (P,) feasible points of a baseline below the least ratio of stability, which baselines do not consider.

    Args:
        a: rotation and joints.
        path: planning points.
        arm: arm model with the limit.
    """
    out = np.zeros(len(a.reason), bool)
    if arm.stability is not None:
        known = np.flatnonzero(a.reason == InfeasibilityReason.OK)
        out[known] = arm.stability.find_violations(arm, path, known, a.q[known])
    return out


def _is_complete(scored: ScoredAssignment, path: PlanningPath) -> bool:
    """Return whether every point is feasible."""
    return bool((scored.assignment.reason == InfeasibilityReason.OK).all()) and not find_configuration_jumps(
        path, scored
    )


def is_rotation_allowed(phi: Array, path: PlanningPath, options: PlanOptions) -> bool:
    """Return whether a rotation keeps the user's range and fixed values, which the baselines do not consider.

    Args:
        phi: (P,) rad, rotation.
        path: planning points.
        options: plan options.
    """
    if options.steer:
        return False
    gamma = np.asarray(wrap_angle(phi + path.offset))
    low, high = options.rotation_range
    inside = (gamma >= low - BOUND_SLACK) & (gamma <= high + BOUND_SLACK)
    if high - low < 2 * np.pi - BOUND_SLACK and not inside[path.counted].all():
        return False
    rows = np.flatnonzero(path.is_point)  # toolpath point k is planning point rows[k]
    return all(abs(float(wrap_angle(gamma[rows[f.point]] - f.gamma))) < BOUND_SLACK for f in options.fixed)


def is_assignment_allowed(a: JointAssignment, path: PlanningPath, options: PlanOptions) -> bool:
    """Return whether rotation and branch keep the user's range, pins, zones and branches at every planning point.

    Args:
        a: rotation and joints.
        path: planning points.
        options: plan options.
    """
    if not is_rotation_allowed(a.phi, path, replace(options, steer=())):
        return False
    if any(
        abs(float(wrap_angle(a.phi[row] - phi))) > PINNED for row, phi in find_fixed_rotations(path, options).items()
    ):
        return False
    gamma = np.asarray(wrap_angle(a.phi + path.offset))
    for wish in options.steer:
        rows = select_steered_rows(wish, path.index)
        if wish.forbid is not None and is_inside_zone(gamma[rows], wish.forbid).any():
            return False
        if wish.branch is not None and (a.branch[rows] != wish.branch).any():
            return False
    return True
