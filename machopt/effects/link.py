"""Links that bend and twist as beams between their joints."""

from __future__ import annotations

from machopt.domain.location import link_at
from machopt.effects.bodies import TWO_PLANES, Beam
from machopt.effects.protocol import Effect
from machopt.effects.tube import TAPERED, stated_law

EFFECT = Effect(
    name="link_compliance",
    noun="compliance",
    spoken="link compliance",
    sentence="The link body bends or twists; the joint beside it does not.",
    port="body",
    places=tuple(link_at(i) for i in range(1, 7)),
    gives=(Beam(("EI_Nm2",)), Beam(("GJ_Nm2",)), Beam(), TWO_PLANES, TAPERED),
    reads=stated_law,
    elastic=True,
)
