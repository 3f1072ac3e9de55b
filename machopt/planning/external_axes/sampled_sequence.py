"""A choice at some stations whose own poses are free of contacts: what a value of external joints is judged by.

Only the poses of the choice are looked at, and what lies near a contact; ways between them, and whether the rest of the
path is free, the plan in full says. A few times, as a value where much collides is no good one anyway.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.planning.collision_handling.contact_lookahead import ContactLookahead
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.configurations import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.stations.planning_path import PlanningPath

TIMES = 4  # the choice is made again after contacts at most
LOOKED = 2000  # vertices looked at around the contacts of each


def choose_collision_free_sequence(
    part: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, setup: PlanningSetup, options: PlanOptions
) -> tuple[SequenceChoice, int]:
    """The choice, and at how many of its stations the pose still collides; ``candidates`` lose what does."""
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
