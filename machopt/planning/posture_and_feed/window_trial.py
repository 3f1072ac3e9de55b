"""Trial of a window's result: exact joints, margins, contacts, feed advice and motion of the whole run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.cost.stiffness_index import compute_load_directions
from machopt.planning.motion.retract_moves import RetractMoves
from machopt.planning.motion.segment_planner import SegmentPlanner
from machopt.planning.pipeline.baseline_comparison import is_assignment_allowed
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import fix_external_axes
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.posture_and_feed.advised_feeds import advise_feeds, apply_advised_feeds
from machopt.planning.posture_and_feed.node_curves import interpolate_naturally
from machopt.planning.posture_and_feed.window_builder import RunState, Window
from machopt.planning.posture_and_feed.window_data import WindowSolution
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.smoothing.corridor import compute_turning_length

LEAST_GAIN = 0.012  # s: a gain below one usual sample of the motion is none
_WORDS = {
    InfeasibilityReason.LIMIT: "a joint limit margin is lost",
    InfeasibilityReason.UNREACHABLE: "the pose cannot be reached",
    InfeasibilityReason.NO_PATH: "the posture does not continue",
    InfeasibilityReason.COLLIDING: "bodies touch",
}


@dataclass(frozen=True)
class TrialRefusal:
    """Why a window's result is not driven."""

    reason: str


def measure_run(plan: Plan, toolpath: Toolpath, run: int) -> RunState | TrialRefusal:
    """Return the state of a plan, with the duration of one run at the advised feeds.

    Args:
        plan: Plan of one tool.
        toolpath: Its toolpath.
        run: Number of the run.
    """
    advised = advise_feeds(plan, toolpath)
    first, last = plan.path.runs[run]
    driven = apply_advised_feeds(plan, advised)
    found = SegmentPlanner(driven, toolpath, RetractMoves(driven)).run(first, last)
    if isinstance(found, SequenceBreak):
        return TrialRefusal(f"the run cannot be driven: {found.text}")
    return RunState(plan, advised, (len(found.q) - 1) * plan.options.sample)


def try_solution(
    before: RunState, toolpath: Toolpath, window: Window, solution: WindowSolution
) -> RunState | TrialRefusal:
    """Return the state with the rotation and external joints of a solution, or the reason against it.

    Args:
        before: The state that the window was built from.
        toolpath: Its toolpath.
        window: The window.
        solution: Result of its program.
    """
    plan = before.plan
    phi, external, seed = _spread_over_run(plan, window, solution)
    path = fix_external_axes(plan.path, external) if external is not None else plan.path
    setup = plan.setup
    a = solve_joint_path(path, setup.arm, setup.robot, phi, seed)
    refused = _find_lost_point(plan, a)
    if refused:
        return TrialRefusal(refused)
    if not is_assignment_allowed(a, path, plan.options):
        return TrialRefusal("a rotation, zone or branch that the options fix is not kept")
    check = PathCollisionChecker.build(path, setup.arm, setup.robot, setup.collision, plan.options).whole(a.phi, a.q)
    if not check.free:
        return TrialRefusal(_describe_contact(plan, check))
    directions = compute_load_directions(path, setup.arm, setup.elasticity, plan.options.force)
    chosen = replace(plan.chosen, assignment=a)
    changed = replace(plan, path=path, directions=directions, chosen=chosen, chosen_from="joint", check=check)
    return measure_run(rescore_plan(changed, a), toolpath, window.run)


def compare_states(before: RunState, after: RunState) -> str:
    """Return why a state is no improvement; empty where it is one.

    Args:
        before: Accepted state.
        after: Result of a trial.
    """
    if after.advised.failing > before.advised.failing:
        return (
            f"{after.advised.failing} points would be out of tolerance at any feed, {before.advised.failing} are before"
        )
    if after.advised.unstable > before.advised.unstable:
        return f"chatter is predicted at {after.advised.unstable} points, at {before.advised.unstable} before"
    gain = before.seconds - after.seconds
    if gain < LEAST_GAIN:
        return f"the run would take {after.seconds:.2f} s, {before.seconds:.2f} s before"
    return ""


def _spread_over_run(plan: Plan, window: Window, solution: WindowSolution) -> tuple[Array, Array | None, Array]:
    """Return phi (P,) rad, external joints (P, E) or None where they stay, and a seed (P, 6) rad.

    Rotation and external joints are cubic splines through all nodes of the run, over the length on which the rotation
    may change, so that they continue with two derivatives where a window ends.
    """
    path, a, nodes = plan.path, plan.chosen.assignment, window.nodes
    first, last = path.runs[window.run]
    rows = np.arange(first, last + 1)
    turning = compute_turning_length(path, first, last)
    at = turning[nodes - first]
    keep = np.flatnonzero(np.r_[True, np.diff(at) > 1e-9])
    x = path.whole(a.q)[nodes]
    x[window.first : window.last + 1] = solution.x
    node_phi = a.phi[nodes].copy()
    node_phi[window.first : window.last + 1] = solution.phi
    phi, seed = a.phi.copy(), a.q.copy()
    phi[rows] = interpolate_naturally(at[keep], node_phi[keep], turning)
    way = path.s[nodes]
    for i in range(6):
        seed[rows, i] = np.interp(path.s[rows], way, x[:, i])
    if not np.any(solution.x[:, 6:] != path.external[window.points]):
        return phi, None, seed
    external = path.external.copy()
    external[rows] = interpolate_naturally(way, x[:, 6:], path.s[rows])
    return phi, external, seed


def _find_lost_point(plan: Plan, a: JointAssignment) -> str:
    before = plan.chosen.assignment.reason
    lost = np.flatnonzero((a.reason != InfeasibilityReason.OK) & (before == InfeasibilityReason.OK))
    if not len(lost):
        return ""
    return f"{_describe_reason(a.reason[lost])} at point {plan.path.index[lost[0]]:g}"


def _describe_reason(reasons: NDArray[np.uint8]) -> str:
    return _WORDS.get(InfeasibilityReason(int(reasons[0])), "a singularity margin is lost")


def _describe_contact(plan: Plan, check: PathCollisions) -> str:
    model = plan.setup.collision
    rows = np.flatnonzero(check.hit)
    if not len(rows) or model is None:
        at = int(np.flatnonzero(check.lost)[0])
        return f"the posture does not continue at point {plan.path.index[at]:g}"
    pair = model.pairs[int(check.pair[rows[0]])]
    return f"{pair.name} touch or come nearer than the clearance at point {plan.path.index[rows[0]]:g}"
