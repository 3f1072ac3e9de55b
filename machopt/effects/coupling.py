"""One joint that moves another: through the gears (Δ_j = κ q_i), or by its torque (Δ_i = c_ij τ_j, Δ_j = c_ij τ_i).

Two effects, and two files: what is elastic stands in stiffness.yaml, what needs no load in kinematics.yaml. Files and
findings call both ``joint_coupling``; which one is meant their parameters say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.domain.location import joints_at
from machopt.effects.protocol import (
    COMPLIANCE,
    Drive,
    Effect,
    Free,
    Geared,
    Law,
    Parameter,
    Quantity,
    Scale,
    Settled,
    Shape,
)

WORD = "joint_coupling"
PLACES = tuple(joints_at(i, j) for i in range(1, 7) for j in range(i + 1, 7))
WRIST = ("joint:4-5", "joint:4-6", "joint:5-6")
THROUGH = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)  # turns of a motor, at its joint, per turn of the other joint
LARGE = 0.98  # quantile of what a law adds that counts as its size
CASTINGS = ("joint:2-3", *WRIST, "joint:1-2", "joint:3-4")  # joints whose gears share a shaft or a casting


@dataclass(frozen=True)
class Elastic(Settled):
    """A torque on one joint turns another one, and the other way round by as much (Maxwell)."""

    name = "elastic coupling"
    equation = "Δ_i = c_ij τ_j, Δ_j = c_ij τ_i"
    coefficients = (Parameter(key="compliance_rad_per_Nm", unit=COMPLIANCE),)
    shape: tuple[Parameter, ...] = ()

    def columns(self, shape: Array, drive: Drive) -> Array:
        return drive.torque[..., None]

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.ones((*drive.torque.shape, 1))

    def within(self, values: Array, room: float) -> Law:
        return self

    def sizes(self, values: Array, shape: Array, scale: Scale) -> Mapping[str, Quantity]:
        return {"compliance": Quantity(float(values[0]), COMPLIANCE)}

    def grid(self, scale: Scale) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class Dragged(Free):
    """Δ_j = κ q_i: the shaft of joint j runs through joint i (hollow wrists)."""

    name = "gears drag the next joint"
    equation = "Δ_j = κ q_i (hollow wrist: the shaft of joint j runs through joint i)"
    note = "the second joint without load, in proportion to the first"
    at_rest_only = True  # proven in settled poses
    prior = 3e-4  # wrists that no controller compensates drag 1e-4 to 1e-3; more is rather a turned axis
    coefficients = (Parameter(key="ratio", unit="rad/rad", required=True, most=0.1, said="rad/rad"),)

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        of = angle if derivative == 0 else np.full(np.shape(angle), 1.0 if derivative == 1 else 0.0)
        return np.asarray(of, float)[..., None]

    def steepest(self, values: Array, shape: Array) -> float:
        return abs(float(values[0]))

    def largest(self, values: Array, shape: Array) -> float:
        return np.inf

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"ratio": Quantity(abs(float(values[0])), "rad/rad")}


@dataclass(frozen=True)
class Through:
    """The shaft of joint j runs through joint i: its motor turns by φ = q_j + κ q_i and rubs and spins with that.

    What all motors do to the joints is Aᵀ of what they give, φ = A q. A controller tells the one or the other.
    """

    by_motors: bool  # what each motor gives, times its gear; else what all of them do to each joint
    forward: bool  # whether the motor turns further where joint i turns forward
    word = ""
    remembers = False
    penalty = 0.0
    of_gain = False
    shape = (Parameter(key="ratio", unit="rad/rad", positive=True),)

    @property
    def name(self) -> str:
        told = "torques of motors" if self.by_motors else "torques of joints"
        return f"motor turns with the other joint, {'forward' if self.forward else 'back'}, {told}"

    @property
    def equation(self) -> str:
        phi = f"φ̇ = q̇_j {'+' if self.forward else '−'} κ q̇_i"
        own = f"τ_j += F z(φ̇) + d φ̇ + I φ̈, {phi}"
        return own + (", τ_i ∓= κ τ_j" if self.by_motors else ", and κ times that on τ_i")

    @property
    def note(self) -> str:
        return "where the other joint turns"

    @property
    def coefficients(self) -> tuple[Parameter, ...]:
        own = (
            Parameter(key="coulomb_Nm", unit="N·m", least=0.0),
            Parameter(key="viscous", unit="N·m·s/rad", least=0.0),
            Parameter(key="inertia", unit="kg·m²", least=0.0),
        )
        return (*own, Parameter(key="share", unit="1", least=0.0)) if self.by_motors else own

    def columns(self, shape: Array, seen: Geared) -> Array:
        ratio = float(shape[0]) * (1.0 if self.forward else -1.0)
        v, a = (x[:, 1] + ratio * x[:, 0] for x in (seen.speed, seen.acceleration))
        out = np.zeros((len(v), 2, 4 if self.by_motors else 3))
        for k, x in enumerate((seen.way(v), v, a)):
            out[:, 1, k] = x
        if self.by_motors:
            out[:, 0, 3] = -ratio * seen.needed[:, 1]
        else:
            out[:, 0] = ratio * out[:, 1]
        return out

    def sizes(self, values: Array, shape: Array, seen: Geared) -> Mapping[str, Quantity]:
        rubs = self.columns(shape, seen)[:, 1, :3] @ values[:3]
        return {
            "torque": Quantity(float(np.quantile(np.abs(rubs - np.median(rubs)), LARGE)), "N·m"),
            "ratio": Quantity(float(shape[0]), "rad/rad"),
        }

    def grid(self) -> tuple[Shape, ...]:
        return tuple((k,) for k in THROUGH)


ELASTIC = Effect(
    name="joint_elastic_coupling",
    word=WORD,
    noun="coupling",
    sentence="What one joint does turns or twists the other one too.",
    port="twist",
    places=PLACES,
    likely=CASTINGS,
    laws=(Elastic(),),
    elastic=True,
)

KINEMATIC = Effect(
    name="joint_kinematic_coupling",
    word=WORD,
    noun=ELASTIC.noun,
    sentence=ELASTIC.sentence,
    port="angle",
    places=PLACES,
    likely=WRIST,
    unloaded=(Dragged(),),
    motors=tuple(Through(by_motors, forward) for by_motors in (False, True) for forward in (True, False)),
)
