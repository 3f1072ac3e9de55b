"""Second search of a planned path, with another price of the worst index or without some changes of branch.

Vertices that the first search excluded stay excluded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Bools
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.pipeline.collision_free_search import CollisionFreeSequence
from machopt.planning.pipeline.path_planner import PathProblem, mark_contacts
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import find_sequence_breaks
from machopt.planning.sampling.candidate_grid import CandidateGrid


def search_with_worst_price(
    before: Plan, sequence: CollisionFreeSequence, worst: float, elsewhere: float, clock: StageTimings
) -> Plan:
    """Return the plan searched again with another price of the worst index; exclusions remain.

    Args:
        before: plan without gaps or breaks; its candidates are not changed.
        sequence: result of its search.
        worst: price of the worst index.
        elsewhere: worst index of the other tools, in units of c₀: below it a lower one gains nothing.
        clock: stage timings.
    """
    options = replace(before.options, weights=replace(before.options.weights, worst=worst))
    scores = replace(before.scores, elsewhere=elsewhere)
    return _search_again(before, sequence, _copy_candidates(before.candidates), scores, options, clock)


def search_without_branch_changes(
    before: Plan, sequence: CollisionFreeSequence, shut: Bools, ends: Sequence[tuple[int, int]], clock: StageTimings
) -> Plan:
    """Return the plan searched again without some changes of branch; exclusions remain.

    Args:
        before: plan without gaps or breaks; its candidates are not changed.
        sequence: result of its search.
        shut: (A, A) branch changes that rapid moves must not make, by the arm's branch numbers.
        ends: stations at the ends of the path, and numbers of branches that cannot be reached there.
        clock: stage timings.
    """
    c = before.candidates
    candidates = replace(_copy_candidates(c), shut=shut if c.shut is None else shut | c.shut)
    for station, number in ends:
        branch = candidates.branch == number
        candidates.feasible[station, :, branch] = False
        candidates.reason[station, :, branch] = np.where(
            c.reason[station, :, branch] == InfeasibilityReason.OK,
            InfeasibilityReason.NO_PATH,
            c.reason[station, :, branch],
        )
    after = _search_again(before, sequence, candidates, before.scores, before.options, clock)
    bound = min(after.choice.bound, before.choice.bound)  # an unsuccessful search is no proof that no path exists
    return replace(after, choice=replace(after.choice, bound=bound), over_external=None)


def _copy_candidates(c: CandidateGrid) -> CandidateGrid:
    """Return a copy of candidates that may lose vertices."""
    return replace(c, feasible=c.feasible.copy(), reason=c.reason.copy())


def _search_again(
    before: Plan,
    sequence: CollisionFreeSequence,
    candidates: CandidateGrid,
    scores: CandidateScores,
    options: PlanOptions,
    clock: StageTimings,
) -> Plan:
    problem = PathProblem(
        path=before.path,
        directions=before.directions,
        setup=before.setup,
        options=options,
        candidates=candidates,
        scores=scores,
        pricing=before.pricing,
    )
    search = problem.build_search(clock)
    search.resume(sequence)
    sequence = problem.find_sequence(search, clock)
    return replace(
        before,
        options=options,
        candidates=candidates,
        scores=scores,
        choice=sequence.choice,
        chosen=mark_contacts(problem.score(sequence.assignment), sequence.check),
        chosen_from=sequence.source,
        grid=problem.rate_grid_choice(sequence.choice),
        check=sequence.check,
        rounds=before.rounds + sequence.rounds,
        breaks=find_sequence_breaks(problem.path, problem.setup, candidates, sequence),
        found=sequence,
    )
