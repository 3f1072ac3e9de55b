"""Link compliance: links that bend and twist as beams between their joints."""

from __future__ import annotations

from machopt.data_types.effect_locations import MOST_JOINTS, format_link_location
from machopt.effects.compliance_matrices.tapered_tube import TAPERED, read_tube_law
from machopt.effects.compliance_matrices.uniform_beam_law import TWO_PLANES, UniformBeamLaw
from machopt.effects.protocol import Effect

EFFECT = Effect(
    name="link_compliance",
    noun="compliance",
    short_noun="link compliance",
    sentence="The link body bends or twists; the joint beside it does not.",
    port="body",
    places=tuple(format_link_location(i) for i in range(1, MOST_JOINTS + 1)),
    body_laws=(UniformBeamLaw(("EI_Nm2",)), UniformBeamLaw(("GJ_Nm2",)), UniformBeamLaw(), TWO_PLANES, TAPERED),
    file_reader=read_tube_law,
    is_elastic=True,
)
