"""The base: pedestal, bolts and floor as a spring at base_link's origin, or where the file says."""

from __future__ import annotations

from machopt.effects.bodies import DIAGONAL, Entries, stated_law
from machopt.effects.protocol import Effect

TILTS = ((3, 3), (3, 4), (4, 4))  # of a base that tilts about some axis more than across it
# of a plate on upright bolts: it sinks and tilts, and one uneven bolt couples them
SINKS = ((2, 2), (2, 3), (2, 4), (3, 3), (3, 4), (4, 4))

EFFECT = Effect(
    name="base_compliance",
    noun="compliance",
    spoken="base compliance",
    sentence="Pedestal, anchors or floor give way under the overturning moment.",
    port="body",
    places=("base",),
    gives=(
        Entries(DIAGONAL[3:5], "tilts", "G₀ C₀ G₀ᵀ w, C₀ about x and y of base_link", weighs=True),
        Entries(TILTS, "tilts about any axis", "G₀ C₀ G₀ᵀ w, C₀ symmetric about x and y of base_link"),
        Entries(
            SINKS,
            "tilts and sinks",
            "G₀ C₀ G₀ᵀ w, C₀ symmetric in z, about x and about y of base_link: a plate on uneven bolts",
            weighs=True,
        ),
        Entries(DIAGONAL, "gives way in six directions", "G₀ C₀ G₀ᵀ w, C₀ diagonal"),
    ),
    reads=stated_law,
    elastic=True,
)
