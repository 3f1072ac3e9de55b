"""Where the arm stands without any load: zeros of the encoders, waves of the gears."""

from __future__ import annotations

from machopt.effects.protocol import JOINTS, Effect

ZERO = Effect(
    name="joint_zero_offset",
    noun="zero offset",
    sentence="The mastering of the joint is off by a constant angle.",
    port="angle",
    places=JOINTS,
    plausible={"deg": 10.0},
)

WAVES = Effect(
    name="transmission_error",
    noun="transmission error",
    sentence="The gear runs ahead and behind periodically, with no load at all.",
    port="angle",
    places=JOINTS,
    form=0.1,
    plausible={"arcsec": 3600.0},
)
