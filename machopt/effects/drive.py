"""What controllers and swinging links do in motion."""

from __future__ import annotations

from machopt.effects.protocol import JOINTS, Effect

LAG = Effect(
    name="servo_lag",
    noun="servo lag",
    sentence="The arm follows its command late, in proportion to speed.",
    port="angle",
    places=("controller",),
    of="",
)

VIBRATION = Effect(
    name="joint_elasticity",
    noun="vibration",
    spoken="vibration of a flexible joint",
    sentence="The joint swings on its own spring.",
    port="twist",
    places=JOINTS,
)
