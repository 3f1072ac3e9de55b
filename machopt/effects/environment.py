"""What heat does to arm and set-up."""

from __future__ import annotations

from machopt.effects.protocol import Effect

THERMAL = Effect(
    name="thermal_drift",
    noun="thermal drift",
    sentence="The arm or the set-up grows with temperature or time, load or not.",
    port="body",
    places=("environment",),
    form=0.2,
    plausible={"mm": 5.0},
    of="",
)
