"""Coupling of two joints: kinematic (through the gears, Δ_j = κ q_i) or elastic (Δ_i = c_ij τ_j, Δ_j = c_ij τ_i).

These are two effects in two files: the elastic one in stiffness.yaml, the kinematic one in kinematics.yaml. Files and
findings call both ``joint_coupling``; the parameters tell which one is meant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.data_types.effect_locations import MOST_JOINTS, format_joint_pair_location
from machopt.effects import prior_scales
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
PLACES = tuple(
    format_joint_pair_location(i, j) for i in range(1, MOST_JOINTS + 1) for j in range(i + 1, MOST_JOINTS + 1)
)
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
)  # motor turns, referred to its joint, per turn of the other joint
SIZE_QUANTILE = 0.98  # quantile of what a law adds that counts as its size
SHARED_CASTING_PAIRS = ("joint:2-3", *WRIST, "joint:1-2", "joint:3-4")  # joints whose gears share a shaft or a casting


@dataclass(frozen=True)
class ElasticCoupling(JointLawDefaults):
    """A torque on one joint twists another joint, and vice versa with the same coefficient (Maxwell reciprocity)."""

    name = "elastic coupling"
    equation = "Δ_i = c_ij τ_j, Δ_j = c_ij τ_i"
    coefficients = (LawParameter(key="compliance_rad_per_Nm", unit=COMPLIANCE),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the twist per unit of the coupling compliance: the torque of the other joint.

        Args:
            shape: Empty; the law has no shape parameters.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) N·m.
        """
        return drive.torque[..., None]

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope of the twist: 1.

        Args:
            shape: Empty; the law has no shape parameters.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) ones.
        """
        return np.ones((*drive.torque.shape, 1))

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        """Return the law unchanged.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            room: Compliance that the joint has left to lose before its slope becomes zero, rad/(N·m).

        Returns:
            The law.
        """
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> Mapping[str, Quantity]:
        """Return the coupling compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``compliance`` in rad/(N·m).
        """
        return {"compliance": Quantity(float(values[0]), COMPLIANCE)}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return one empty shape: the law has no shape parameters to search.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            The shapes that a search tries.
        """
        return ((),)


@dataclass(frozen=True)
class KinematicCoupling(JointAngleLawDefaults):
    """Δ_j = κ q_i: the shaft of joint j runs through joint i (hollow wrists)."""

    name = "gears drag the next joint"
    equation = "Δ_j = κ q_i (hollow wrist: the shaft of joint j runs through joint i)"
    note = "the second joint without load, in proportion to the first"
    static_only = True  # identified from static poses only
    prior = prior_scales.COUPLING_RATIO.scale
    coefficients = (
        LawParameter(key="ratio", unit="rad/rad", required=True, magnitude_limit=0.1, unit_in_words="rad/rad"),
    )

    def columns(self, shape: Array, angle: Array, derivative: int = 0) -> Array:
        """Return the angle of the driving joint, or its derivative.

        Args:
            shape: Empty; the law has no shape parameters.
            angle: (...,) angle of the driving joint i, rad.
            derivative: Order of the derivative with respect to the angle; 0 is the function itself.

        Returns:
            (..., 1) rad per rad/rad.
        """
        of = angle if derivative == 0 else np.full(np.shape(angle), 1.0 if derivative == 1 else 0.0)
        return np.asarray(of, float)[..., None]

    def compute_max_slope(self, values: Array, shape: Array) -> float:
        """Return the coupling ratio with its sign.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.

        Returns:
            Largest |dΔ/dq|, rad/rad.
        """
        return abs(float(values[0]))

    def compute_max_error(self, values: Array, shape: Array) -> float:
        """Return infinity: only the angle range of joint i bounds the error.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.

        Returns:
            Infinity.
        """
        return np.inf

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude of the coupling ratio.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Empty; the law has no shape parameters.

        Returns:
            ``ratio`` in rad/rad.
        """
        return {"ratio": Quantity(float(values[0]), "rad/rad")}


@dataclass(frozen=True)
class ThroughShaftCoupling:
    """The drive shaft of joint j runs through joint i. Its motor turns by φ = q_j + κ q_i, with the friction of that
    motion.

    The joint torques of all motors are Aᵀ times the motor torques, with φ = A q. A controller reports either of the
    two.
    """

    is_motor_side: bool  # recorded: torque of each motor times its gear ratio; else the joint torque of all motors
    forward: bool  # whether κ is positive: the motor turns further when joint i moves forward
    word = ""
    has_memory = False
    penalty = 0.0
    absorbed_by_gain = False
    shape = (LawParameter(key="ratio", unit="rad/rad", positive=True),)

    @property
    def name(self) -> str:
        torques = "torques of motors" if self.is_motor_side else "torques of joints"
        return f"motor turns with the other joint, {'forward' if self.forward else 'back'}, {torques}"

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

    def columns(self, shape: Array, motor_loading: MotorLoading) -> Array:
        """Return the additional torques at joints i and j per unit of each coefficient.

        Args:
            shape: (1,) coupling ratio |κ|, rad/rad.
            motor_loading: Torque, speed and acceleration of both joints in K samples.

        Returns:
            (K, 2, P) N·m; coefficients are Coulomb friction, viscous friction, inertia and, on the motor side, the
            torque transfer.
        """
        ratio = float(shape[0]) * (1.0 if self.forward else -1.0)
        v, a = (x[:, 1] + ratio * x[:, 0] for x in (motor_loading.speed, motor_loading.acceleration))
        out = np.zeros((len(v), 2, 4 if self.is_motor_side else 3))
        for k, x in enumerate((motor_loading.compute_friction_direction(v), v, a)):
            out[:, 1, k] = x
        if self.is_motor_side:
            out[:, 0, 3] = -ratio * motor_loading.required_torque[:, 1]
        else:
            out[:, 0] = ratio * out[:, 1]
        return out

    def sizes(self, values: Array, shape: Array, motor_loading: MotorLoading) -> Mapping[str, Quantity]:
        """Return the size of the friction torque and the coupling ratio.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (1,) coupling ratio |κ|, rad/rad.
            motor_loading: Torque, speed and acceleration of both joints in K samples.

        Returns:
            ``torque`` in N·m and ``ratio`` in rad/rad.
        """
        friction_torque = self.columns(shape, motor_loading)[:, 1, :3] @ values[:3]
        return {
            "torque": Quantity(
                float(np.quantile(np.abs(friction_torque - np.median(friction_torque)), SIZE_QUANTILE)), "N·m"
            ),
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
