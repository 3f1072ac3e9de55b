"""One joint that moves another: through the gears (kinematic), or by its torque (elastic)."""

from __future__ import annotations

from machopt.effects.protocol import Effect

EFFECT = Effect(
    name="joint_coupling",
    noun="coupling",
    sentence="What one joint does turns or twists the other one too.",
    port="twist",
    places=tuple(f"joint:{i}-{j}" for i in range(1, 7) for j in range(i + 1, 7)),
    elastic=True,
)
