"""One joint that moves another: through the gears (Δ_j = κ q_i), or by its torque (Δ_i = c_ij τ_j, Δ_j = c_ij τ_i).

Two effects, and two files: what is elastic stands in stiffness.yaml, what needs no load in kinematics.yaml. Files and
findings call both ``joint_coupling``; which one is meant their parameters say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.data_types.locations import format_joint_pair_location
from machopt.effects.protocol import (
    COMPLIANCE,
    Effect,
    JointAngleLawDefaults,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    MotorLoading,
    Quantity,
    Shape,
)
from machopt.numerics.array_types import Array

WORD = "joint_coupling"
PLACES = tuple(format_joint_pair_location(i, j) for i in range(1, 7) for j in range(i + 1, 7))
WRIST = ("joint:4-5", "joint:4-6", "joint:5-6")
SHAFT_RATIOS = (
    0.02,
    0.05,
    0.1,
    0.2,
    0.35,
    0.5,
    0.75,
    1.0,
)  # turns of a motor, at its joint, per turn of the other joint
SIZE_QUANTILE = 0.98  # quantile of what a law adds that counts as its size
SHARED_CASTING_PAIRS = ("joint:2-3", *WRIST, "joint:1-2", "joint:3-4")  # joints whose gears share a shaft or a casting


@dataclass(frozen=True)
class ElasticCoupling(JointLawDefaults):
    """A torque on one joint turns another one, and the other way round by as much (Maxwell)."""

    name = "elastic coupling"
    equation = "Δ_i = c_ij τ_j, Δ_j = c_ij τ_i"
    coefficients = (LawParameter(key="compliance_rad_per_Nm", unit=COMPLIANCE),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        return drive.torque[..., None]

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.ones((*drive.torque.shape, 1))

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        return {"compliance": Quantity(float(values[0]), COMPLIANCE)}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class KinematicCoupling(JointAngleLawDefaults):
    """Δ_j = κ q_i: the shaft of joint j runs through joint i (hollow wrists)."""

    name = "gears drag the next joint"
    equation = "Δ_j = κ q_i (hollow wrist: the shaft of joint j runs through joint i)"
    note = "the second joint without load, in proportion to the first"
    static_only = True  # proven in settled poses
    prior = 3e-4  # wrists that no controller compensates drag 1e-4 to 1e-3; more is rather a turned axis
    coefficients = (
        LawParameter(key="ratio", unit="rad/rad", required=True, magnitude_limit=0.1, unit_in_words="rad/rad"),
    )

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        of = angle if derivative == 0 else np.full(np.shape(angle), 1.0 if derivative == 1 else 0.0)
        return np.asarray(of, float)[..., None]

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        return abs(float(values[0]))

    def compute_max_error(self, values: Array, shape: Array) -> float:
        return np.inf

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"ratio": Quantity(abs(float(values[0])), "rad/rad")}


@dataclass(frozen=True)
class ThroughShaftCoupling:
    """The shaft of joint j runs through joint i: its motor turns by φ = q_j + κ q_i and rubs and spins with that.

    What all motors do to the joints is Aᵀ of what they give, φ = A q. A controller tells the one or the other.
    """

    is_motor_side: bool  # what each motor gives, times its gear; else what all of them do to each joint
    forward: bool  # whether the motor turns further where joint i turns forward
    word = ""
    has_memory = False
    penalty = 0.0
    absorbed_by_gain = False
    shape = (LawParameter(key="ratio", unit="rad/rad", positive=True),)

    @property
    def name(self) -> str:
        told = "torques of motors" if self.is_motor_side else "torques of joints"
        return f"motor turns with the other joint, {'forward' if self.forward else 'back'}, {told}"

    @property
    def equation(self) -> str:
        phi = f"φ̇ = q̇_j {'+' if self.forward else '−'} κ q̇_i"
        own = f"τ_j += F z(φ̇) + d φ̇ + I φ̈, {phi}"
        return own + (", τ_i ∓= κ τ_j" if self.is_motor_side else ", and κ times that on τ_i")

    @property
    def note(self) -> str:
        return "where the other joint turns"

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        own = (
            LawParameter(key="coulomb_Nm", unit="N·m", lower_limit=0.0),
            LawParameter(key="viscous", unit="N·m·s/rad", lower_limit=0.0),
            LawParameter(key="inertia", unit="kg·m²", lower_limit=0.0),
        )
        return (*own, LawParameter(key="share", unit="1", lower_limit=0.0)) if self.is_motor_side else own

    def columns(self, shape: Array, seen: MotorLoading) -> Array:
        ratio = float(shape[0]) * (1.0 if self.forward else -1.0)
        v, a = (x[:, 1] + ratio * x[:, 0] for x in (seen.speed, seen.acceleration))
        out = np.zeros((len(v), 2, 4 if self.is_motor_side else 3))
        for k, x in enumerate((seen.compute_friction_direction(v), v, a)):
            out[:, 1, k] = x
        if self.is_motor_side:
            out[:, 0, 3] = -ratio * seen.required_torque[:, 1]
        else:
            out[:, 0] = ratio * out[:, 1]
        return out

    def sizes(self, values: Array, shape: Array, seen: MotorLoading) -> Mapping[str, Quantity]:
        rubs = self.columns(shape, seen)[:, 1, :3] @ values[:3]
        return {
            "torque": Quantity(float(np.quantile(np.abs(rubs - np.median(rubs)), SIZE_QUANTILE)), "N·m"),
            "ratio": Quantity(float(shape[0]), "rad/rad"),
        }

    def grid(self) -> tuple[Shape, ...]:
        return tuple((k,) for k in SHAFT_RATIOS)


ELASTIC = Effect(
    name="joint_elastic_coupling",
    word=WORD,
    noun="coupling",
    sentence="What one joint does turns or twists the other one too.",
    port="twist",
    places=PLACES,
    preferred_places=SHARED_CASTING_PAIRS,
    joint_laws=(ElasticCoupling(),),
    is_elastic=True,
)

KINEMATIC = Effect(
    name="joint_kinematic_coupling",
    word=WORD,
    noun=ELASTIC.noun,
    sentence=ELASTIC.sentence,
    port="angle",
    places=PLACES,
    preferred_places=WRIST,
    angle_laws=(KinematicCoupling(),),
    motor_laws=tuple(
        ThroughShaftCoupling(by_motors, forward) for by_motors in (False, True) for forward in (True, False)
    ),
)
