"""An effect of one's own: a joint that gives more at small torque than at large."""

from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import COMPLIANCE, JOINTS, Effect, JointLawDefaults, LawParameter, Quantity


@dataclass(frozen=True)
class Softening(JointLawDefaults):
    """phi = a tau0 tanh(tau / tau0): the slope a is there for small torque tau and fades beyond tau0."""

    name = "tanh"
    equation = "phi = c tau + a tau0 tanh(tau/tau0)"
    coefficients = (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0),)
    shape = (LawParameter(key="half_way_Nm", unit="N·m", positive=True),)
    includes_weight = True

    def columns(self, shape, drive):
        """rad per unit of the coefficient."""
        return shape * np.tanh(drive.torque[..., None] / shape)

    def tangent(self, shape, drive):
        """Its slope over the torque."""
        return np.cosh(drive.torque[..., None] / shape) ** -2.0

    def limit_to_compliance(self, values, room):
        """The law where a joint has less room; this one needs none."""
        return self

    def sizes(self, values, shape, scale):
        """What a report says of it."""
        return {"slope": Quantity(1e6 * float(values[0]), "rad/(MN·m)")}

    def grid(self, scale):
        """Shapes that a search tries."""
        return tuple((s * scale.max_torque,) for s in (0.2, 0.5))


EFFECTS = [
    Effect(
        name="joint_softening",
        noun="softening",
        sentence="The joint gives more at small torque.",
        port="twist",
        places=JOINTS,
        joint_laws=(Softening(),),
        is_elastic=True,
        note="at small torque",
    )
]
