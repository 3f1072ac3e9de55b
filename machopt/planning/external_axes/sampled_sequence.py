"""Sequence at some stations whose own poses are free of contacts: the assessment of a value of external joints.

Only the poses of the sequence and their neighbours near a contact are checked. The full plan checks the moves between
them and the rest of the path. The number of repetitions is small, because a value with many contacts is not a good
one anyway.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.planning.collision_handling.contact_lookahead import ContactLookahead
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.stations.planning_path import PlanningPath

TIMES = 4  # maximum number of repetitions of the choice after contacts
LOOKED = 2000  # vertices checked around the contacts of each


def choose_collision_free_sequence(
    part: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, setup: PlanningSetup, options: PlanOptions
) -> tuple[SequenceChoice, int]:
    """Return the sequence, and the number of its stations whose pose still collides.

    Args:
        part: path with few stations.
        candidates: candidate grid; colliding candidates are removed in place.
        scores: cost of the candidates.
        setup: planning setup of the cell.
        options: plan options.
    """
    velocity = setup.cell.limits.velocity[:6]
    choice = choose_sequence(part, candidates, scores, velocity, options)
    if setup.collision is None:
        return choice, 0
    touch, external = part.may_touch[part.stations], part.external[part.stations]
    pairs = np.full(candidates.feasible.shape[:3], -1, np.int32)
    ahead = ContactLookahead(
        candidates=candidates, model=setup.collision, may_touch=touch, external=external, pairs=pairs
    )
    for _ in range(TIMES):
        s = np.flatnonzero(~choice.dropped)
        found = setup.collision.check_configurations(ahead.whole(s, choice.rotation[s], choice.branch[s]), touch[s])
        if not found.any:
            return choice, 0
        at = (s[found.hit], choice.rotation[s][found.hit], choice.branch[s][found.hit])
        vertices, pair = np.ravel_multi_index(at, pairs.shape), found.pair[found.hit]
        ahead.strike(vertices, pair)
        ahead.look(vertices, pair, LOOKED)
        choice = choose_sequence(part, candidates, scores, velocity, options)
    s = np.flatnonzero(~choice.dropped)
    found = setup.collision.check_configurations(ahead.whole(s, choice.rotation[s], choice.branch[s]), touch[s])
    return choice, int(found.hit.sum())
