"""Bodies that bend: links, base, tool. The matrices of beams are in :mod:`machopt.effects.beam`; frames, forms and
files stand in :mod:`machopt.model.terms.body`.
"""

from __future__ import annotations

from machopt.effects.protocol import Effect

LINK = Effect(
    name="link_compliance",
    noun="compliance",
    spoken="link compliance",
    sentence="The link body bends or twists; the joint beside it does not.",
    port="body",
    places=tuple(f"link:{i}" for i in range(1, 7)),
    elastic=True,
)

BASE = Effect(
    name="base_compliance",
    noun="compliance",
    spoken="base compliance",
    sentence="Pedestal, anchors or floor give way under the overturning moment.",
    port="body",
    places=("base",),
    elastic=True,
)

TOOL = Effect(
    name="tool_compliance",
    noun="compliance",
    spoken="tool compliance",
    sentence="Flange, force sensor, spindle or holder bend behind the tool tip.",
    port="body",
    places=("tool",),
    elastic=True,
)
