"""The base: pedestal, bolts and floor as a spring at base_link's origin, or where the file says."""

from __future__ import annotations

from machopt.effects.bodies import DIAGONAL, Entries, stated_law
from machopt.effects.protocol import Effect

EFFECT = Effect(
    name="base_compliance",
    noun="compliance",
    spoken="base compliance",
    sentence="Pedestal, anchors or floor give way under the overturning moment.",
    port="body",
    places=("base",),
    gives=(
        Entries(DIAGONAL[3:5], "tilts", "G₀ C₀ G₀ᵀ w, C₀ about x and y of base_link", weighs=True),
        Entries(DIAGONAL, "gives way in six directions", "G₀ C₀ G₀ᵀ w, C₀ diagonal"),
    ),
    reads=stated_law,
    elastic=True,
)
