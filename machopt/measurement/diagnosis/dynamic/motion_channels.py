"""Diagnosis of a motion: available channels, and equations and catalogue of a channel.

``link``: secondary against motor encoders. ``tip``: tracked TCP against commanded joints. ``torque``: joint torque
against rigid-body dynamics with the URDF's inertias.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.dynamics.rigid_body import MissingInertiaError, RigidBodyDynamics, load_dynamics
from machopt.errors import RecordingError
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    DiagnosisProblem,
    HypothesisCatalogue,
    UntestableEffect,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.dynamic import (
    exchanged_torque_columns,
    joint_torque_channel,
    link_mass_uncertainty,
    motion_record_checks,
    motor_currents,
    secondary_encoder_channel,
    servo_lag,
    tracked_tcp_channel,
)
from machopt.measurement.diagnosis.effect_columns import gravity_compensator
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel, build_joint_selector, cache_columns
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals, build_motion_signals
from machopt.numerics.array_types import Array

MotionChannel = Literal["link", "tip", "torque"]
CHANNEL_WORDS: dict[MotionChannel, str] = {
    "link": "link-side against motor-side joint position",
    "tip": "tracked position of the TCP",
    "torque": "joint torque by rigid-body dynamics from the URDF's inertias",
}


def list_testable_channels(recording: Recording, cell: Cell) -> tuple[MotionChannel, ...]:
    """List the channels that can be predicted and compared, the most sensitive first.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        cell: Robot cell.

    Returns:
        Channel names.
    """
    out: list[MotionChannel] = []
    other = recording.q_secondary
    if other is not None and any(np.isfinite(x).all() and np.ptp(x) > 1e-6 for x in other.T):
        out.append("link")
    if recording.position is not None and len(cell.arm_joints) >= 6 and not cell.arm_prismatic:
        out.append("tip")
    if (recording.torque is not None or motor_currents.has_currents_only(recording)) and _build_dynamics(
        cell
    ) is not None:
        out.append("torque")
    return tuple(out)


def check_joint_names(recording: Recording, cell: Cell) -> None:
    """Check that the recording has the joints of the cell.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        cell: Robot cell.

    Raises:
        InputError: Number or type of the joints differ.
    """
    n = recording.q.shape[1]
    slides = cell.arm_prismatic or (False,) * len(cell.arm_joints)
    if n != len(slides):
        raise RecordingError(
            f"the recording has {n} joint{'s' if n > 1 else ''}, the cell's arm {len(slides)}: "
            f"{', '.join(cell.arm_joints)}; one column q1_deg (q1_mm where it slides) … for each of them would work",
            file=recording.source,
        )
    for j, (own, name) in enumerate(zip(slides, cell.arm_joints, strict=True)):
        if own != (recording.prismatic or (False,) * n)[j]:
            found, right = ("deg", "mm") if own else ("mm", "deg")
            raise RecordingError(
                f"q{j + 1}_{found} is of a joint that {'turns' if own else 'slides'}, but {name!r} of the cell "
                f"{'slides' if own else 'turns'}; q{j + 1}_{right} is expected",
                file=recording.source,
            )


def build_motion_problem(
    recording: Recording,
    cell: Cell,
    channel: MotionChannel,
    rng: np.random.Generator,
    *,
    repeats: bool = True,
    terms: tuple[StiffnessTerm, ...] = (),
) -> tuple[DiagnosisProblem, HypothesisCatalogue, tuple[str, ...], tuple[Finding, ...]]:
    """Build equations and hypotheses of one channel of a motion.

    Args:
        recording: Recording of kind motion.
        cell: Cell with the URDF; only the arm joints are used.
        channel: One of :func:`list_testable_channels`.
        rng: Not used; these channels make no random choices.
        repeats: Whether the periods of a repeating motion share cross-validation groups; False uses time blocks
            only.
        terms: Terms of the cell's stiffness that count as known: those of single joints, and gravity
            compensators.

    Returns:
        Problem, hypotheses, notes, and findings about the recording.

    Raises:
        InputError: Required signals are missing or implausible.
    """
    n = min(len(cell.arm_joints), recording.q.shape[1])
    corrected, found = motion_record_checks.correct_motion_units(recording, n)
    corrected, warnings = motion_record_checks.check_channel_quality(corrected, n)
    motion = build_motion_signals(corrected, n, repeats=repeats)
    dynamics = _build_dynamics(cell)
    predicted = _predict_joint_torque(dynamics, motion, terms)
    free_gains, unsized = motor_currents.has_currents_only(corrected) and predicted is not None, frozenset[int]()
    if predicted is not None and free_gains:
        converted = motor_currents.convert_currents_to_torques(corrected, motion, predicted)
        corrected, unsized, warnings = converted.recording, converted.joints_without_gain, [*warnings, converted.notes]
    elif predicted is not None and channel == "torque":
        corrected, exchanged = exchanged_torque_columns.correct_exchanged_torques(corrected, motion, predicted)
        corrected, of_torque = motion_record_checks.correct_torque_side(corrected, motion, predicted)
        found += [*exchanged, *of_torque]
    scene = replace(
        _build_motion_model(corrected, cell, motion, dynamics, predicted),
        known_terms=terms,
        free_gains=free_gains,
        joints_without_gain=unsized,
    )
    scene.notes.extend(warnings)
    if scene.correction is not None and channel != "torque":
        labels = ", ".join(dict.fromkeys(part.label for part in scene.correction.parts))
        scene.notes.append(f"corrections of the cell's kinematics.yaml count as known: {labels}")
    problem, catalogue, more = _build_channel_equations(scene, channel)
    if channel != "tip":
        found += servo_lag.find_servo_lag(corrected, motion)
    if found:
        errors = (
            _compute_holdout_errors(problem),
            _evaluate_uncorrected_record(recording, cell, channel, repeats, terms)
            if corrected is not recording
            else None,
        )
        found = [_add_errors_to_finding(f, *errors) for f in found]
    missing = [*catalogue.untestable]
    if float(np.ptp(motion.time)) < thresholds.LIMITS.warm_up_time:
        missing.append(
            UntestableEffect("thermal_drift", "environment", f"{np.ptp(motion.time):.0f} s are too short for heat")
        )
    if recording.q_command is None and channel != "tip":
        missing.append(UntestableEffect("servo_lag", "controller", "the commanded joints are not recorded"))
    usable, nameless = (
        tuple(replace(h, columns=cache_columns(h.columns)) for h in laws)
        for laws in (catalogue.hypotheses, catalogue.uncatalogued_hypotheses)
    )
    catalogue = replace(catalogue, hypotheses=usable, untestable=tuple(missing), uncatalogued_hypotheses=nameless)
    return problem, catalogue, tuple(scene.notes), (*found, *more)


def _build_motion_model(
    recording: Recording, cell: Cell, motion: MotionSignals, dynamics: RigidBodyDynamics | None, predicted: Array | None
) -> MotionModel:
    n = motion.q.shape[1]
    prismatic = tuple(dynamics is not None and dynamics.is_prismatic(j) for j in range(n))
    return MotionModel(
        recording=recording,
        cell=cell,
        motion=motion,
        dynamics=dynamics,
        predicted=predicted,
        dimensions=n,
        lift=build_joint_selector(motion, n),
        prismatic=prismatic,
        correction=build_encoder_correction(cell.kinematics),
        notes=[*motion.notes],
    )


def _build_channel_equations(
    scene: MotionModel, channel: MotionChannel
) -> tuple[DiagnosisProblem, HypothesisCatalogue, list[Finding]]:
    if channel == "torque":
        return *joint_torque_channel.build_joint_torque_problem(scene), []
    if channel == "link":
        joints = secondary_encoder_channel.find_secondary_encoder_joints(scene)
        lift = build_joint_selector(scene.motion, len(joints), joints)
        return *secondary_encoder_channel.build_secondary_encoder_problem(
            replace(scene, dimensions=len(joints), lift=lift), joints
        ), []
    from machopt.kinematics.urdf_loading import load_robot

    if scene.joints < 6:
        raise RecordingError(
            f"{scene.recording.source}: a tracked TCP needs an arm of six joints or more; the cell has {scene.joints}"
        )
    return tracked_tcp_channel.build_tracked_tcp_problem(scene, load_robot(scene.cell))


def _evaluate_uncorrected_record(
    recording: Recording, cell: Cell, channel: MotionChannel, repeats: bool, terms: tuple[StiffnessTerm, ...]
) -> Array | None:
    """Return the errors of the recording as stated; None if no equations can be built."""
    motion = build_motion_signals(recording, min(len(cell.arm_joints), recording.q.shape[1]), repeats=repeats)
    dynamics = _build_dynamics(cell)
    scene = _build_motion_model(recording, cell, motion, dynamics, _predict_joint_torque(dynamics, motion, terms))
    if channel == "link" and not secondary_encoder_channel.find_secondary_encoder_joints(scene):
        return None  # joints appear not to move
    return _compute_holdout_errors(_build_channel_equations(scene, channel)[0])


def _compute_holdout_errors(problem: DiagnosisProblem) -> Array:
    """Return the cross-validated rmse (G,) of the first family in its report unit, with the base alone.

    Unknowns with a prior (link masses) stay at their stated value: freely fitted they would compensate a wrong unit.
    """
    free = [u.prior is None for u in problem.unknowns]
    left = link_mass_uncertainty.compute_holdout_squares(
        problem.y, problem.base[:, :, free], problem.group, np.ones(problem.dimensions)
    )
    return problem.families[0].factor * np.sqrt(
        left / np.unique(problem.group, return_counts=True)[1] / problem.dimensions
    )


def _add_errors_to_finding(finding: Finding, errors: Array, stated: Array | None) -> Finding:
    """Return a record finding with the median cross-validated error of time blocks, as stated and as corrected."""
    if np.isfinite(finding.before):
        return finding
    after = float(np.median(errors))
    before = after if stated is None or not finding.record else float(np.median(stated))
    return replace(finding, before=before, after=after)


def _predict_joint_torque(
    dynamics: RigidBodyDynamics | None, motion: MotionSignals, terms: tuple[StiffnessTerm, ...]
) -> Array | None:
    """Return the joint torque (M, n) N·m by rigid bodies and the cell's known gravity compensators."""
    if dynamics is None:
        return None
    return dynamics.compute_torque(motion.q, motion.v, motion.a) - gravity_compensator.compute_known_torque(
        terms, motion.q
    )


def _build_dynamics(cell: Cell) -> RigidBodyDynamics | None:
    """Return the rigid-body dynamics of the arm; None if the URDF has no inertias."""
    try:
        return load_dynamics(cell)
    except MissingInertiaError:
        return None
