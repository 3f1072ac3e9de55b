"""Torque ripple of gears and torque of elastic joints in the torque channel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.effects import registry
from machopt.effects.joint.harmonic_functions import HarmonicSeries
from machopt.effects.joint.joint_angle_errors import SUM_NAME, WAVES, describe_wave_amplitudes, list_testable_orders
from machopt.effects.protocol import Effect, VibrationLaw, VibrationLoading
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    Correction,
    EffectHypothesis,
    LawCurve,
    Quantity,
    RecordCorrection,
    Shape,
)
from machopt.measurement.diagnosis.dynamic.joint_angle_errors import build_order_refinement, compute_motion_angle_range
from machopt.measurement.diagnosis.effect_columns.motion_columns import (
    MotionModel,
    build_binned_curve,
    build_joint_law_hypothesis,
)
from machopt.numerics.array_types import Array


def build_ripple_hypotheses(scene: MotionModel, joint: int) -> list[EffectHypothesis]:
    """Build torque ripple A sin(Nq + φ) of one joint, with and without its second harmonic.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.

    Returns:
        The hypotheses; none for joints that do not rotate.
    """
    if not scene.is_joint_moving(joint) or scene.prismatic[joint]:
        return []
    orders_shown = list_testable_orders(compute_motion_angle_range(scene, joint))
    shapes: dict[int, tuple[Shape, ...]] = {
        1: tuple((n,) for n in orders_shown),
        2: tuple((n, 2 * n) for n in orders_shown if 2 * n <= orders_shown[-1]),
    }
    turning = HarmonicSeries(scene.motion.q[:, joint])
    return [_build_ripple_hypothesis(scene, joint, turning, shapes[k], k) for k in (1, 2) if shapes[k]]


def _build_ripple_hypothesis(
    scene: MotionModel, joint: int, turning: HarmonicSeries, shapes: tuple[Shape, ...], harmonics: int
) -> EffectHypothesis:
    q, over, where = turning.angle, turning.compute, format_joint_location(joint + 1)

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return describe_wave_amplitudes(np.hypot(x[0::2], x[1::2]), s, "N·m", doubled=harmonics > 1)

    def fix(x: Array, s: Shape) -> Correction:
        stated = {"per_turn": list(s), "cos_Nm": x[0::2].tolist(), "sin_Nm": x[1::2].tolist()}
        return RecordCorrection(WAVES.file_word, where, stated)

    def line(x: Array, s: Shape) -> LawCurve:
        label = f"joint {joint + 1} within one of {s[0]:g} waves a turn in degrees"
        return build_binned_curve(scene, np.degrees(np.mod(q, 2 * np.pi / s[0])), over(s) @ x, label, "in N·m")

    return build_joint_law_hypothesis(
        scene,
        joint,
        WAVES.file_word,
        "one wave" if harmonics == 1 else "wave and its second harmonic",
        "A sin(Nq + φ)" + (" + B sin(2Nq + ψ)" if harmonics > 1 else ""),
        over,
        sizes,
        shapes,
        family="kinematic",
        curve=line,
        correction=fix,
        note="periodic with the gear",
        refinement=build_order_refinement(scene, joint),
        sum_name=SUM_NAME if harmonics == 1 else "",
    )


def build_elastic_joint_hypotheses(scene: MotionModel, joint: int, inertia: Array) -> list[EffectHypothesis]:
    """Build the motor torque of an elastic joint: the link moves by −τ/k more than the motor, which adds M_j ẍ.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        inertia: (M, n) inertia behind each joint, kg·m².

    Returns:
        The hypotheses.
    """
    if scene.predicted is None or scene.prismatic[joint] or not scene.is_joint_moving(joint):
        return []
    if inertia[:, joint].min() <= 0.0:  # without inertia there is no vibration
        return []
    m = scene.motion
    seen = VibrationLoading(-scene.predicted[:, joint], inertia[:, joint], scene.time_step, scene.segment_start)
    laws = ((e, law, law.grid(m.rate)) for e in registry.select_vibration_effects() for law in e.vibration_laws)
    return [_build_elastic_joint_hypothesis(scene, joint, e, law, seen, grid) for e, law, grid in laws if grid]


def _build_elastic_joint_hypothesis(
    scene: MotionModel,
    joint: int,
    effect: Effect,
    law: VibrationLaw,
    vibration_loading: VibrationLoading,
    grid: tuple[Shape, ...],
) -> EffectHypothesis:
    """Return the hypothesis. The coefficient is compliance times stiffness: the present share of the spring's inertia
    force.
    """
    m = scene.motion

    def response(s: Shape) -> Array:
        return vibration_loading.inertia * m.differentiate(
            m.differentiate(law.deflection(np.array(s), vibration_loading))
        )

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        at = np.array(s)
        return law.sizes(float(x[0]) / law.stiffness(at, vibration_loading), at, vibration_loading)

    return build_joint_law_hypothesis(
        scene,
        joint,
        effect.file_word,
        law.name,
        f"τ += M φ̈, {law.equation}",
        response,
        sizes,
        grid,
        lower=(0.0,),
        family="vibration",
        note=effect.note,
    )
