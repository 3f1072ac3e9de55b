"""The balancer of joint 2. Its law still stands in :mod:`machopt.model.terms.compensator`."""

from __future__ import annotations

from machopt.effects.protocol import Effect

EFFECT = Effect(
    name="gravity_compensator",
    noun="gravity compensator",
    sentence="The spring or gas cylinder at joint 2 carries a torque that depends on its angle.",
    port="torque",
    places=("joint:2",),
    elastic=True,
    form=0.2,
)
