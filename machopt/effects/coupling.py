"""One joint that moves another: through the gears (Δ_j = κ q_i), or by its torque (Δ_i = c_ij τ_j, Δ_j = c_ij τ_i)."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.effects.protocol import COMPLIANCE, Effect, Parameter


@dataclass(frozen=True)
class Elastic:
    """A torque on one joint turns another one, and the other way round by as much (Maxwell)."""

    word = ""
    remembers = False
    coefficients = (Parameter(key="compliance_rad_per_Nm", unit=COMPLIANCE),)
    shape: tuple[Parameter, ...] = ()


ELASTIC = Elastic()


EFFECT = Effect(
    name="joint_coupling",
    noun="coupling",
    sentence="What one joint does turns or twists the other one too.",
    port="twist",
    places=tuple(f"joint:{i}-{j}" for i in range(1, 7) for j in range(i + 1, 7)),
    elastic=True,
)
