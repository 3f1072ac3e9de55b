"""A choice at some stations whose own poses are free of contacts: what a value of external joints is judged by.

Only the poses of the choice are looked at, and what lies near a contact; ways between them, and whether the rest of the
path is free, the plan in full says. A few times, as a value where much collides is no good one anyway.
"""

from __future__ import annotations

import numpy as np

from machopt.domain.options import PlanOptions
from machopt.plan.choice.choose import Choice, choose
from machopt.plan.configurations.candidates import Candidates
from machopt.plan.contacts.lookahead import Ahead
from machopt.plan.cost.score import Scores
from machopt.plan.pipeline.setup import Setup
from machopt.plan.stations.path import Path

TIMES = 4  # the choice is made again after contacts at most
LOOKED = 2000  # vertices looked at around the contacts of each


def free_choice(
    part: Path, candidates: Candidates, scores: Scores, setup: Setup, options: PlanOptions
) -> tuple[Choice, int]:
    """The choice, and at how many of its stations the pose still collides; ``candidates`` lose what does."""
    velocity = setup.cell.limits.velocity[:6]
    choice = choose(part, candidates, scores, velocity, options)
    if setup.collision is None:
        return choice, 0
    touch, external = part.may_touch[part.stations], part.external[part.stations]
    pairs = np.full(candidates.feasible.shape[:3], -1, np.int32)
    ahead = Ahead(candidates=candidates, model=setup.collision, may_touch=touch, external=external, pairs=pairs)
    for _ in range(TIMES):
        s = np.flatnonzero(~choice.dropped)
        found = setup.collision.check(ahead.whole(s, choice.rotation[s], choice.branch[s]), touch[s])
        if not found.any:
            return choice, 0
        at = (s[found.hit], choice.rotation[s][found.hit], choice.branch[s][found.hit])
        vertices, pair = np.ravel_multi_index(at, pairs.shape), found.pair[found.hit]
        ahead.strike(vertices, pair)
        ahead.look(vertices, pair, LOOKED)
        choice = choose(part, candidates, scores, velocity, options)
    s = np.flatnonzero(~choice.dropped)
    found = setup.collision.check(ahead.whole(s, choice.rotation[s], choice.branch[s]), touch[s])
    return choice, int(found.hit.sum())
