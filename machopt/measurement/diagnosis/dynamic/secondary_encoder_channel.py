"""Channel of secondary (link-side) encoders: y = q_secondary − q − Δ(q), the twist of the gear.

Δ is the correction in the cell's kinematics.yaml, so a known transmission error is not found again. Always refitted
for each joint with a secondary encoder: an offset (mounting and zero), and the compliance under the torque of the
gear.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.data_types.parameter_keys import build_joint_spring_key
from machopt.effects import registry
from machopt.effects.protocol import JointLoadRange
from machopt.errors import RecordingError
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
    UntestableEffect,
)
from machopt.measurement.diagnosis.dynamic import joint_angle_errors
from machopt.measurement.diagnosis.dynamic.gear_compliance import (
    build_gear_hypotheses,
    compute_joint_load_torque,
    compute_known_twist,
)
from machopt.measurement.diagnosis.dynamic.joint_torque_channel import list_motion_axes
from machopt.measurement.diagnosis.dynamic.time_delays import build_channel_delay_hypotheses, find_best_delay
from machopt.measurement.diagnosis.effect_columns.motion_columns import ExplainedPower, MotionModel
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array

DEFAULT_LOAD_RANGE = JointLoadRange(max_torque=1.0, is_motion=True)  # used to query which laws apply to motions


def find_secondary_encoder_joints(scene: MotionModel) -> list[int]:
    """Find the joints with a moving secondary encoder.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.

    Returns:
        Joint indices, 0-based.
    """
    other = scene.recording.q_secondary
    if other is None:
        return []
    part = other[scene.motion.index, : scene.joints]
    finite = np.isfinite(part).all(axis=0)
    return [j for j in np.flatnonzero(finite).tolist() if np.ptp(part[:, j]) > 1e-6 and scene.is_joint_moving(j)]


def build_secondary_encoder_problem(
    scene: MotionModel, joints: list[int]
) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
    """Build equations and catalogue of the channel ``link``.

    Args:
        scene: Motion model with D = len(joints); ``lift`` maps joints to coordinates.
        joints: Joints with a secondary encoder, 0-based.

    Returns:
        The problem and the hypotheses.

    Raises:
        InputError: No secondary encoder moves.
    """
    m, rec = scene.motion, scene.recording
    if not joints or rec.q_secondary is None:
        raise RecordingError(f"{rec.source}: no link-side encoder moves; qse1_deg … are needed for the channel link")
    y = m.subtract_period_mean(
        m.average_blocks((rec.q_secondary[m.index][:, : scene.joints] - scene.true_angles(m.q))[:, joints])
    )
    offset = np.concatenate([scene.column(j, np.ones(len(m.q))) for j in joints], axis=2)
    found = compute_joint_load_torque(scene)
    base, unknowns = (
        offset,
        [BaseUnknown(name=f"offset {j + 1}", unit="rad", location=format_joint_location(j + 1)) for j in joints],
    )
    out: list[EffectHypothesis] = []
    untestable: list[UntestableEffect] = []
    inertia = None if scene.dynamics is None else scene.dynamics.compute_own_inertia(m.q)
    if found is None:
        reason = "neither torques are recorded nor does the URDF have inertias"
        untestable += [
            UntestableEffect(effect, format_joint_location(j + 1), reason)
            for j in joints
            for effect in (
                e.name
                for e in registry.select_joint_torque_effects()
                if any(law.grid(DEFAULT_LOAD_RANGE) for law in e.joint_laws)
            )
        ]
    else:
        load = found.load
        scene.notes.append(f"gears are loaded by the {found.words}")
        base = np.concatenate([offset, *(scene.column(j, load[:, j]) for j in joints)], axis=2)
        unknowns += [
            BaseUnknown(
                name=f"compliance {j + 1}",
                unit="rad/(N·m)",
                lower=0.0,
                location=format_joint_location(j + 1),
                key=build_joint_spring_key(j + 1),
            )
            for j in joints
        ]
        if not found.is_from_rigid_bodies:
            for j in joints:  # the motor torque contains friction that the gear does not transmit
                way = np.stack([np.sign(m.v[:, j]), m.v[:, j]], axis=1)
                base = np.concatenate([base, scene.column(j, way)], axis=2)
                unknowns += [
                    BaseUnknown(
                        name=f"friction in the torque {j + 1}, {k}", unit=u, location=format_joint_location(j + 1)
                    )
                    for k, u in (("Coulomb", "rad"), ("viscous", "s"))
                ]
    if found is not None:
        for j in joints if scene.known_terms else ():
            y = y - scene.column(j, compute_known_twist(scene, j, found.load[:, j]))[:, :, 0]
    # encoders of one kind have equal noise
    fit = ExplainedPower(y, base, np.ones(len(joints)))
    for j in joints:
        if found is not None:
            out += build_gear_hypotheses(scene, j, found.load[:, j], None if inertia is None else inertia[:, j], fit)
        laws, taken_up = joint_angle_errors.build_motion_angle_hypotheses(scene, j, fit)
        out += laws
        untestable += taken_up
    problem = scene.problem(
        "position",
        y,
        base,
        unknowns,
        CoordinateFamily(name="link-side angle", columns=tuple(range(len(joints))), unit="mrad", factor=1e3),
    )
    near = m.q[:, joints]
    far = near
    if found is not None:  # the twist of the gear is delayed together with the secondary encoder
        far = near + found.load[:, joints] * _fit_joint_compliance(m, fit, y, base, near, len(joints))
    # a load computed from the motor encoder is delayed with it: both delays are identical
    alone = far if found is not None and found.is_from_rigid_bodies else near

    def late(q: Array, d: float) -> Array:
        return m.subtract_period_mean(m.average_blocks(m.delay_cubic(q, d) - q))

    def far_late(d: float) -> Array:
        return late(far, d)

    def near_late(d: float) -> Array:  # a late motor encoder makes the difference appear early
        return -late(alone, -d)

    best = find_best_delay(lambda d: fit.misfit(far_late(d)))
    out += build_channel_delay_hypotheses(scene, "qse", far_late, best)
    early = -best if alone is far else find_best_delay(lambda d: fit.misfit(near_late(d)))
    out += build_channel_delay_hypotheses(scene, "q", near_late, early, penalty=2.0)
    return problem, HypothesisCatalogue(tuple(out), tuple(untestable), list_motion_axes(scene))


def _fit_joint_compliance(m: MotionSignals, fit: ExplainedPower, y: Array, base: Array, q: Array, joints: int) -> Array:
    """Return the compliance (joints,) rad/(N·m) of the base, fitted with the best delay of the joint angles."""

    def late(d: float) -> Array:
        return m.subtract_period_mean(m.average_blocks(m.delay_cubic(q, d) - q))

    X = base.reshape(-1, base.shape[2])
    size = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)
    shown = (y - late(find_best_delay(lambda d: fit.misfit(late(d))))).reshape(-1)
    x = np.linalg.lstsq(X / size, shown, rcond=1e-10)[0] / size
    return np.asarray(np.clip(x[joints : 2 * joints], 0.0, None))
