"""Base compliance: pedestal, anchor bolts and floor as a spring at base_link's origin, or where the file states it."""

from __future__ import annotations

from machopt.effects.compliance_matrices.body_compliance_laws import DIAGONAL_ENTRIES, MatrixEntriesLaw, read_body_law
from machopt.effects.protocol import Effect

TILT_ENTRIES = ((3, 3), (3, 4), (4, 4))  # a base whose tilt compliance depends on the tilt axis
# a plate on vertical bolts: settlement and tilt, coupled if the bolts differ
SETTLEMENT_ENTRIES = ((2, 2), (2, 3), (2, 4), (3, 3), (3, 4), (4, 4))

EFFECT = Effect(
    name="base_compliance",
    noun="compliance",
    short_noun="base compliance",
    sentence="Pedestal, anchors or floor deflect under the overturning moment.",
    port="body",
    places=("base",),
    body_laws=(
        MatrixEntriesLaw(
            DIAGONAL_ENTRIES[3:5], "tilts", "G₀ C₀ G₀ᵀ w, C₀ about x and y of base_link", includes_weight=True
        ),
        MatrixEntriesLaw(TILT_ENTRIES, "tilts about any axis", "G₀ C₀ G₀ᵀ w, C₀ symmetric about x and y of base_link"),
        MatrixEntriesLaw(
            SETTLEMENT_ENTRIES,
            "tilts and sinks",
            "G₀ C₀ G₀ᵀ w, C₀ symmetric in z, about x and about y of base_link: a plate on uneven bolts",
            includes_weight=True,
        ),
        MatrixEntriesLaw(DIAGONAL_ENTRIES, "compliant in six directions", "G₀ C₀ G₀ᵀ w, C₀ diagonal"),
    ),
    file_reader=read_body_law,
    is_elastic=True,
)
