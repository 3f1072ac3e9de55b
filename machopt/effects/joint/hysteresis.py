"""Hysteresis of a gear with internal friction: play operators, saturating play, or the Bouc–Wen model.

All laws have memory. A plan has no load history; it uses the branch of a load that rises from a gear at rest, P_r =
sgn(τ) max(|τ| − r, 0). A gear that an earlier load left on the opposite side of its play yields up to a·r more, once.
A *small* additional load meets the slope after the play is taken up, which is the most compliant state of the gear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint.play_and_drag_operators import compute_drag, compute_play
from machopt.effects.protocol import (
    ARCMIN,
    COMPLIANCE,
    JOINTS,
    Effect,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    Quantity,
    Shape,
)
from machopt.numerics.array_types import Array

STEPS = ((0.03,), (0.08,), (0.15,), (0.3,), (0.5,))  # half-widths tried in load tests, relative to the largest torque
STEP_PAIRS = ((0.03, 0.15), (0.03, 0.3), (0.08, 0.3), (0.15, 0.5))
SAMPLES = ((0.02,), (0.05,), (0.1,), (0.18,), (0.3,), (0.45,))  # in motions
SAMPLE_PAIRS = ((0.02, 0.1), (0.02, 0.3), (0.05, 0.18), (0.05, 0.3), (0.1, 0.3), (0.1, 0.45), (0.18, 0.45))
BOUC_WEN_SHAPES = tuple((r, b) for r in (0.1, 0.2, 0.4, 0.8, 1.6) for b in (0.5, 0.65, 0.8))  # in motions
SATURATED_PLAY_SHAPES = tuple(
    (r, k) for r in (0.08, 0.18, 0.35) for k in (0.12, 0.35)
)  # half-width and reach, in load tests
# one load cycle from rest: up, down, up again; DOWN and UP are its indices of zero load
CYCLE = np.concatenate([np.linspace(0.0, 1.0, 40), np.linspace(1.0, -1.0, 81)[1:], np.linspace(-1.0, 1.0, 81)[1:]])
DOWN, UP = 79, 159


@dataclass(frozen=True)
class PlayHysteresis(JointLawDefaults):
    """φ = Σ a_n P_n[τ], P_n the play operator of half-width r_n."""

    count: int
    word = "play"
    equation = "φ = c τ + Σ a P_r[τ], P_r the play operator of half-width r (Prandtl–Ishlinskii); rate-independent"
    coefficients = (LawParameter(key="weights_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0, is_list=True),)
    shape = (LawParameter(key="thresholds_Nm", unit="N·m", lower_limit=0.0, positive=True, is_list=True),)
    has_memory = True

    @property
    def name(self) -> str:
        return "play" if self.count == 1 else "two plays"

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the joint twist per unit of each weight.

        Args:
            shape: (P,) half-widths r_n, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) N·m; without history the branch from a gear at rest.
        """
        if drive.segment_start is None:
            tau = drive.torque[..., None]
            return np.asarray(tau - np.clip(tau, -shape, shape))
        return np.stack([compute_play(drive.torque, drive.segment_start, r) for r in shape], axis=-1)

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the slope with all play taken up: 1 for each weight.

        Args:
            shape: (P,) half-widths r_n, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., P) ones.
        """
        return np.ones((*drive.torque.shape, len(shape)))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance by the law.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (P,) half-widths r_n, N·m.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and NaN: it does not depend on the angle.
        """
        return min(0.0, float(np.cumsum(values[np.argsort(shape)]).min())), np.nan

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
        # opening of the loop in the middle of a cycle up to the largest torque and back
        """Return the width of the loop in the middle of a full load cycle.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (P,) half-widths r_n, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``width`` in arcmin and ``threshold`` in N·m.
        """
        opened = sum(
            2.0 * abs(float(a)) * min(float(r), 0.5 * scale.max_torque) for a, r in zip(values, shape, strict=True)
        )
        return {"width": Quantity(opened / ARCMIN, "arcmin"), "threshold": Quantity(float(shape[0]), "N·m")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the half-widths that a search tries.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes of ``count`` half-widths in N·m.
        """
        one, two = (SAMPLES, SAMPLE_PAIRS) if scale.is_motion else (STEPS, STEP_PAIRS)
        return tuple(tuple(s * scale.max_torque for s in shares) for shares in (one if self.count == 1 else two))


@dataclass(frozen=True)
class SaturatedPlay(JointLawDefaults):
    """φ = a tanh(P_r[τ] / k): friction holds the tooth flanks while they cross a clearance, until they are in
    contact.

    With play operators alone the loop widens with the load. Here both branches separate once and stay parallel.
    """

    word = "used_up"
    name = "play that is used up"
    equation = "φ = c τ + a tanh(P_r[τ]/k), P_r the play operator of half-width r (generalised play); rate-independent"
    coefficients = (
        LawParameter(key="half_clearance_arcmin", unit="rad", factor=ARCMIN, lower_limit=0.0, name="half clearance"),
    )
    shape = (
        LawParameter(key="threshold_Nm", unit="N·m", lower_limit=0.0, positive=True),
        LawParameter(key="reach_Nm", unit="N·m", positive=True),
    )
    has_memory = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the joint twist per unit of half clearance.

        Args:
            shape: (2,) half-width r and reach k, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) −1 to 1; without history the branch from a gear at rest.
        """
        r, k = float(shape[0]), float(shape[1])
        tau = drive.torque
        taken = tau - np.clip(tau, -r, r) if drive.segment_start is None else compute_play(tau, drive.segment_start, r)
        return np.asarray(np.tanh(taken / k)[..., None])

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return the largest slope that a small load can meet, for any load history.

        Args:
            shape: (2,) half-width r and reach k, N·m.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) 1/(N·m).
        """
        r, k = float(shape[0]), float(shape[1])
        nearest = (
            np.maximum(np.abs(drive.torque) - r, 0.0) / k
        )  # least possible distance to the middle of the clearance for any history
        return np.asarray(((1.0 - np.tanh(nearest) ** 2) / k)[..., None])

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
        """Return the width of the loop at zero torque of a full load cycle.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (2,) half-width r and reach k, N·m.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``width`` in arcmin and ``threshold`` in N·m.
        """
        r, k = float(shape[0]), float(shape[1])
        # between the branches where a full cycle crosses zero torque
        width = 2.0 * float(values[0]) * float(np.tanh(max(min(r, scale.max_torque - r), 0.0) / k)) / ARCMIN
        return {"width": Quantity(width, "arcmin"), "threshold": Quantity(r, "N·m")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the half-widths and reaches that a search tries; none for motions.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes (r, k) in N·m.
        """
        return (
            ()
            if scale.is_motion
            else tuple((r * scale.max_torque, k * scale.max_torque) for r, k in SATURATED_PLAY_SHAPES)
        )


@dataclass(frozen=True)
class BoucWenHysteresis(JointLawDefaults):
    """φ = −a z: the part of c τ that friction retains; a loop with rounded ends."""

    word = "bouc_wen"
    name = "Bouc–Wen"
    equation = "φ = c τ − a z, dz = [1 − |z| (β sgn(z dτ) + 1 − β)] dτ/r"
    coefficients = (LawParameter(key="drag_arcmin", unit="rad", factor=ARCMIN, lower_limit=0.0, name="drag"),)
    shape = (LawParameter(key="reach_Nm", unit="N·m", positive=True), LawParameter(key="beta", unit="1", positive=True))
    has_memory = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        """Return the joint twist per unit of drag.

        Args:
            shape: (2,) characteristic load r, N·m, and β.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) −1 to 1; without history the branch from a gear at rest.
        """
        if drive.segment_start is None:
            return np.asarray(np.expm1(-np.abs(drive.torque) / shape[0]) * np.sign(drive.torque))[..., None]
        return -compute_drag(drive.torque, drive.segment_start, *shape)[..., None]

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        """Return a slope of zero: with saturated drag a small load meets the linear spring alone.

        Args:
            shape: (2,) characteristic load r, N·m, and β.
            drive: Torque, angle and load history of the joint, one entry per state.

        Returns:
            (..., 1) zeros.
        """
        return np.zeros((*drive.torque.shape, 1))

    def compute_max_slope(self, values: Array, shape: Array, low: float, high: float) -> tuple[float, float]:
        """Return the largest reduction of the joint compliance by the law.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (2,) characteristic load r, N·m, and β.
            low: Lower end of the joint's angle range, rad.
            high: Upper end of the joint's angle range, rad.

        Returns:
            Compliance change, ≤ 0 rad/(N·m), and NaN: it does not depend on the angle.
        """
        return min(0.0, -float(values[0] / shape[0])), np.nan

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
        # twist between the branches where a full cycle crosses zero torque
        """Return the width of the loop at zero torque of a full load cycle.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (2,) characteristic load r, N·m, and β.
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            ``width`` in arcmin and ``reach`` in N·m.
        """
        z = compute_drag(CYCLE * scale.max_torque, np.zeros(len(CYCLE), np.int64), *shape)
        width = float(values[0]) * abs(float(z[UP] - z[DOWN])) / ARCMIN
        return {"width": Quantity(width, "arcmin"), "reach": Quantity(float(shape[0]), "N·m")}

    def grid(self, scale: JointLoadRange) -> tuple[Shape, ...]:
        """Return the characteristic loads and β that a search tries; none for load tests.

        Args:
            scale: Range of torque, angle and time that the recording or plan covers at this joint.

        Returns:
            Shapes (r, β).
        """
        return tuple((r * scale.max_torque, beta) for r, beta in BOUC_WEN_SHAPES) if scale.is_motion else ()


EFFECT = Effect(
    name="joint_hysteresis",
    noun="hysteresis",
    sentence="The joint comes back by another path than it went: friction in the drive train holds twist back.",
    port="twist",
    places=JOINTS,
    joint_laws=(PlayHysteresis(1), PlayHysteresis(2), SaturatedPlay(), BoucWenHysteresis()),
    default_law="play",
    is_elastic=True,
    form_uncertainty=0.2,
    plausible_sizes={"arcmin": 30.0},
    note="on load reversal",
)
