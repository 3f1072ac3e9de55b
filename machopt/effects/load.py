"""What loads do to an arm beside bending its springs: K_C, and masses that are not as stated."""

from __future__ import annotations

from machopt.effects.protocol import Effect

GEOMETRIC = Effect(
    name="geometric_stiffness",
    noun="geometric stiffness (K_C)",
    spoken="stiffness of the load itself (K_C)",
    sentence="The load turns lever arms by its own deflection (Chen and Kao's K_C).",
    port="twist",
    places=("arm",),
    elastic=True,
    of="",
)

PAYLOAD = Effect(
    name="payload",
    noun="mass or centre of mass",
    spoken="wrong payload",
    sentence="Mass or centre of mass on the flange are not what the cell says.",
    port="torque",
    places=("tool",),
    form=0.12,
    at={"tool": "the tool side"},
)
