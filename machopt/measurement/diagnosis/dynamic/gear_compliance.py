"""Gear deflection under the torque of a moving arm, as a twist of the joint: hysteresis, backlash, nonlinear
stiffness, creep, vibration.

``load`` is the torque that twists the joint in its positive direction: minus the torque that the motor transmits to
the link.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import (
    MEMORIES,
    Effect,
    JointLaw,
    JointLoading,
    JointLoadRange,
    VibrationLaw,
    VibrationLoading,
    is_time_dependent,
)
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, LawCurve, Quantity, Shape
from machopt.measurement.diagnosis.dynamic.joint_torque_channel import compute_gear_load
from machopt.measurement.diagnosis.effect_columns.motion_columns import (
    ARCMIN,
    ExplainedPower,
    HypothesisFields,
    MotionModel,
    build_binned_curve,
    build_joint_law_hypothesis,
    build_joint_selector,
)
from machopt.measurement.diagnosis.motion_data.lowpass_filter import apply_zero_phase_filter
from machopt.numerics.array_types import Array


def build_gear_hypotheses(
    scene: MotionModel, joint: int, load: Array, inertia: Array | None, fit: ExplainedPower
) -> list[EffectHypothesis]:
    """Build all gear hypotheses of one joint.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        load: (M,) torque that twists the joint in its positive direction, N·m.
        inertia: (M,) inertia behind the joint, kg·m²; None if unknown.
        fit: Explained power of the channel's problem, used to find the vibration frequency.

    Returns:
        The hypotheses.
    """
    swing = load - np.median(load)
    largest = float(np.quantile(np.abs(load), 0.99))
    around = float(np.quantile(np.abs(swing), 0.99))
    if largest <= 0 or around < thresholds.SHARES.negligible * largest:
        return []
    m = scene.motion
    lasting = min(float(m.time[s.stop - 1] - m.time[s.start]) for s in m.segments())
    out = []
    # hysteresis first, time-dependent laws last: of equally good laws the first one is reported
    for effect in sorted(
        registry.select_joint_torque_effects(), key=lambda e: (is_time_dependent(e.joint_laws[0]), not e.has_memory)
    ):
        for law in effect.joint_laws:
            scale = JointLoadRange(
                max_torque=around if law.has_memory else largest, longest_history=lasting, is_motion=True
            )
            if not law.explain_undetectable(load, np.zeros(0), scale):
                grid = law.grid(scale)
                out += [_build_registry_hypothesis(scene, joint, effect, law, load, scale, grid)] if grid else []
    if inertia is not None and inertia.min() > 0.0:  # without inertia there is no vibration
        for effect in registry.select_vibration_effects():
            for spring in effect.vibration_laws:
                out += _build_vibration_hypotheses(scene, joint, effect, spring, load, inertia, fit)
    return out


def _build_gear_hypothesis(
    scene: MotionModel,
    joint: int,
    effect: str,
    words: str,
    equation: str,
    signal: Callable[[Shape], Array],
    driver: Array,
    sizes: Callable[[Array, Shape], Mapping[str, Quantity]],
    shapes: tuple[Shape, ...],
    lower: tuple[float, ...],
    note: str,
    term: Callable[[Array, Shape], StiffnessTerm] | None = None,
) -> EffectHypothesis:
    def line(x: Array, s: Shape) -> LawCurve:
        part = signal(s)
        twist = part * x[0] if part.ndim == 1 else part @ x
        return build_binned_curve(
            scene, driver, twist / ARCMIN, f"load torque at joint {joint + 1} in N·m", "twist in arcmin"
        )

    more: HypothesisFields = {"lower": lower, "note": note, "curve": line}
    if term is not None:
        more["correction"] = term
    return build_joint_law_hypothesis(scene, joint, effect, words, equation, signal, sizes, shapes, **more)


def _build_registry_hypothesis(
    scene: MotionModel,
    joint: int,
    effect: Effect,
    law: JointLaw,
    load: Array,
    scale: JointLoadRange,
    grid: tuple[Shape, ...],
) -> EffectHypothesis:
    """Return the hypothesis of a registered law over the samples."""
    drive = _build_joint_loading(scene, joint, load)
    memory = MEMORIES[-1] if law.has_memory else ""

    def term(x: Array, s: Shape) -> StiffnessTerm:
        return StiffnessTerm(
            effect.name,
            format_joint_location(joint + 1),
            parameter_conversion.write_law_parameters(law, x, np.array(s), memory),
        )

    lower = tuple(
        least
        for _, _, least in parameter_conversion.list_coefficient_names(
            law, law.columns(np.array(grid[0]), drive).shape[-1]
        )
    )
    return _build_gear_hypothesis(
        scene,
        joint,
        effect.name,
        law.name,
        law.equation,
        lambda s: law.columns(np.array(s), drive),
        load,
        lambda x, s: law.sizes(x, np.array(s), scale),
        grid,
        lower if np.isfinite(lower).any() else (),
        effect.note,
        term,
    )


def compute_known_twist(scene: MotionModel, joint: int, load: Array) -> Array:
    """Compute the twist of a joint by the cell's known terms, with the load history from the beginning of each
    segment.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        load: (M,) torque that twists the joint in its positive direction, N·m.

    Returns:
        (M,) rad.
    """
    out = np.zeros(len(load))
    for term in scene.known_terms:
        effect = registry.find_elastic_effect(term.effect)
        if term.location != format_joint_location(joint + 1) or not effect.joint_laws:
            continue
        given = ParameterReader(term.parameters, term.effect)
        law = parameter_conversion.find_law(effect, given)
        values, shape, _ = parameter_conversion.read_law_parameters(law, given)
        out += law.columns(shape, _build_joint_loading(scene, joint, load)) @ values
    return out


def _build_joint_loading(scene: MotionModel, joint: int, load: Array) -> JointLoading:
    """Return the loading of a joint; the gear has settled at the beginning of a segment."""
    gap = np.where(scene.segment_start > 0, np.inf, scene.time_step)
    return JointLoading(load, scene.motion.q[:, joint], gap, scene.segment_start)


def _build_vibration_hypotheses(
    scene: MotionModel, joint: int, effect: Effect, law: VibrationLaw, load: Array, inertia: Array, fit: ExplainedPower
) -> list[EffectHypothesis]:
    """Return the vibration laws of a joint, integrated in time; the static part is in the base."""
    seen = VibrationLoading(load, inertia, scene.time_step, scene.segment_start)

    def response(s: Shape) -> Array:
        at = np.array(s)
        return law.stiffness(at, seen) * law.deflection(at, seen)

    grid = law.grid(scene.motion.rate, lambda s: fit.gain(scene.column(joint, response(s))))
    if not grid:
        return []
    return [
        _build_gear_hypothesis(
            scene,
            joint,
            effect.file_word,
            law.name,
            f"{law.equation}: beyond c τ it swings",
            response,
            load,
            lambda x, s: law.sizes(float(x[0]), np.array(s), seen),
            grid,
            (0.0,),
            effect.note,
        )
    ]


@dataclass(frozen=True)
class JointLoadTorque:
    """Torques that twist the joints during a motion."""

    load: Array  # (M, n) N·m, in the joints' positive directions
    is_from_rigid_bodies: bool  # from the rigid-body model, without friction; else as recorded

    @property
    def words(self) -> str:
        if self.is_from_rigid_bodies:
            return "torque by rigid-body dynamics from the URDF's inertias"
        return "recorded torque, smoothed"


def compute_joint_load_torque(scene: MotionModel) -> JointLoadTorque | None:
    """Compute the torques that twist the joints.

    The rigid-body torque is used if it describes the recorded torque, which also contains friction and noise.
    Otherwise the filtered recorded torque is used.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.

    Returns:
        The torques; None if neither is known.
    """
    # one coordinate per joint, independent of the channel
    load = compute_gear_load(
        replace(scene, dimensions=scene.joints, lift=build_joint_selector(scene.motion, scene.joints))
    )
    m = scene.motion
    if load is not None:
        return JointLoadTorque(-load, True)
    if scene.recording.torque is None:
        return None
    tau = scene.recording.torque[m.index, : scene.joints]
    smooth = np.empty_like(tau)
    for s in m.segments():
        smooth[s] = apply_zero_phase_filter(tau[s], 2, min(2.0 * m.cutoff, 0.4 * m.rate), m.rate)
    return JointLoadTorque(-smooth, False)
