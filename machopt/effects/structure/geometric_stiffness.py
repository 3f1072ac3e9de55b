"""Geometric stiffness K_C: the change of lever arms under load. Every equilibrium includes it; no law adds it."""

from __future__ import annotations

from machopt.effects.protocol import Effect

GEOMETRIC = Effect(
    name="geometric_stiffness",
    noun="geometric stiffness (K_C)",
    short_noun="stiffness of the load itself (K_C)",
    sentence="The load turns lever arms by its own deflection (Chen and Kao's K_C).",
    port="twist",
    places=("arm",),
    is_elastic=True,
    preposition="",
)
