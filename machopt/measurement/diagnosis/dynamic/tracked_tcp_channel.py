"""Channel of a tracked TCP in motion: y = measured position − forward kinematics of the commanded joints.

Without a recorded command the encoders are used. Always refitted: the tracker frame (6), the target in the tool (3),
and the compliance of each joint under its torque. The problem is linearised at the loaded equilibrium of a first fit,
so that deflections of a millimetre cause no curvature error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.data_types.parameter_keys import build_joint_spring_key
from machopt.effects.recording.time_delay import CLOCK_EFFECT, COMMAND_DELAY_EFFECT
from machopt.errors import RecordingError
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
    RecordCorrection,
    UntestableEffect,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.dynamic import joint_angle_errors
from machopt.measurement.diagnosis.dynamic.gear_compliance import (
    build_gear_hypotheses,
    compute_joint_load_torque,
    compute_known_twist,
)
from machopt.measurement.diagnosis.dynamic.joint_torque_channel import list_motion_axes
from machopt.measurement.diagnosis.dynamic.link_mass_uncertainty import compute_holdout_squares
from machopt.measurement.diagnosis.dynamic.motion_record_checks import compute_sign_test
from machopt.measurement.diagnosis.dynamic.time_delays import (
    build_channel_delay_hypotheses,
    build_command_delay_hypotheses,
    find_best_delay,
)
from machopt.measurement.diagnosis.effect_columns.motion_columns import ExplainedPower, MotionModel
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import skew_matrix as cross

ROUNDS = 3


def build_tracked_tcp_problem(
    scene: MotionModel, robot: Robot
) -> tuple[DiagnosisProblem, HypothesisCatalogue, list[Finding]]:
    """Build equations and catalogue of the channel ``tip``.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        robot: Kinematic model of the arm.

    Returns:
        The problem, the hypotheses, and findings about the recording.

    Raises:
        InputError: The recording has no tracked position.
    """
    m, rec, cell = scene.motion, scene.recording, scene.cell
    if rec.position is None:
        raise RecordingError(f"{rec.source}: the channel tip needs x_mm, y_mm, z_mm")
    T_tool = cell.tool.T_flange_tcp
    commanded = rec.q_command is not None
    commanded_angles = m.q if rec.q_command is None else np.ascontiguousarray(rec.q_command[m.index])
    scene.notes.append("the TCP is predicted from the " + ("commanded joints" if commanded else "encoders"))
    measured = rec.position[m.index]
    lag = estimate_encoder_delays(scene, commanded_angles) if commanded else np.zeros(m.q.shape[1])
    commanded_angles = scene.true_angles(commanded_angles)
    # Jacobians and orientations at the encoder angles
    pose = _BentArm(robot, T_tool, scene.true_angles(m.q), np.zeros_like(m.q))
    tip = robot.compute_fk(commanded_angles, T_tool)[:, :3, 3]
    followed = pose.p - tip  # following error by the encoders

    found = compute_joint_load_torque(scene)
    load = None if found is None else found.load
    unknowns = [BaseUnknown(name=f"registration {a}", unit="m", location="sensor:position") for a in "xyz"]
    unknowns += [BaseUnknown(name=f"registration turn {a}", unit="rad", location="sensor:position") for a in "xyz"]
    unknowns += [BaseUnknown(name=f"target {a}", unit="m", location="tool") for a in "xyz"]
    untestable: list[UntestableEffect] = []
    y_fine = measured - tip
    if found is not None and load is not None:
        scene.notes.append(f"gears are loaded by the {found.words}")
        unknowns += [
            BaseUnknown(
                name=f"compliance {j}",
                unit="rad/(N·m)",
                lower=0.0,
                location=format_joint_location(j),
                key=build_joint_spring_key(j),
            )
            for j in range(1, m.q.shape[1] + 1)
        ]
        y_fine, pose = _linearise_at_equilibrium(scene, pose, measured - tip, load, followed)
    else:
        untestable.append(UntestableEffect("joint_backlash", "arm", "neither torques nor inertias are known"))
    y, base = m.subtract_period_mean(m.average_blocks(y_fine)), scene.average_coordinates(pose.columns(load))
    if load is not None:
        for j in range(m.q.shape[1]) if scene.known_terms else ():
            y = y - scene.average_coordinates(pose.J[:, :, j] * compute_known_twist(scene, j, load[:, j])[:, None])
    problem = scene.problem(
        "position",
        y,
        base,
        unknowns,
        CoordinateFamily(
            name="translation",
            columns=(0, 1, 2),
            unit="mm",
            factor=1e3,
            stated_uncertainty=rec.uncertainty.displacement,
        ),
    )

    def lift(joint: int, x: Array) -> Array:
        return scene.average_coordinates(pose.J[:, :, joint, None] * x[:, None, :])

    scene = replace(scene, lift=lift)
    out: list[EffectHypothesis] = []
    inertia = None if scene.dynamics is None else scene.dynamics.compute_own_inertia(m.q)
    fit = ExplainedPower(y, base, np.ones(3))
    for j in range(m.q.shape[1]):
        if load is not None:
            out += build_gear_hypotheses(scene, j, load[:, j], None if inertia is None else inertia[:, j], fit)
        laws, taken_up = joint_angle_errors.build_motion_angle_hypotheses(scene, j, fit)
        out += laws
        untestable += taken_up

    def late(d: float) -> Array:
        return m.subtract_period_mean(m.average_blocks(m.delay_cubic(tip, d) - tip))

    best = find_best_delay(lambda d: fit.misfit(late(d)))
    out += build_channel_delay_hypotheses(scene, "position", late, best, penalty=1.0 if commanded else 0.0)
    if commanded:
        out += _build_servo_hypotheses(scene, fit, robot, commanded_angles, followed, lag)
    else:
        untestable.append(
            UntestableEffect(
                COMMAND_DELAY_EFFECT.name, COMMAND_DELAY_EFFECT.places[0], "the commanded joints are not recorded"
            )
        )
    return (
        problem,
        HypothesisCatalogue(tuple(out), tuple(untestable), list_motion_axes(scene)),
        _find_late_encoders(y, base, scene, followed, lag),
    )


class _BentArm:
    """Arm at joints q with deflections b: position, Jacobian, and the base columns there."""

    def __init__(self, robot: Robot, T_tool: Array, q: Array, bent: Array) -> None:
        state = robot.compute_state(q + bent, T_tool)
        self.robot, self.T_tool, self.q, self.bent = robot, T_tool, q, bent
        self.p, self.R = state.T_base_tool[:, :3, 3], state.T_base_tool[:, :3, :3]
        self.J = state.J[:, :3]

    def columns(self, load: Array | None) -> Array:
        """Return the base columns: tracker frame, target, and joint compliances.

        Args:
            load: (M, n) joint torques, N·m; None omits the compliances.

        Returns:
            (M, 3, P).
        """
        parts = [np.broadcast_to(np.eye(3), (len(self.p), 3, 3)), -cross(self.p), self.R]
        if load is not None:
            parts.append(self.J * load[:, None, :])
        return np.concatenate(parts, axis=2)


def _linearise_at_equilibrium(
    scene: MotionModel, pose: _BentArm, y: Array, load: Array, followed: Array
) -> tuple[Array, _BentArm]:
    """Return measured minus nominal (M, 3) at the loaded equilibrium, so that columns keep their full coefficients.

    f(q + b) − f(q) is nonlinear in b = c τ. The difference to J b at the deflected arm is moved to the measured side.
    """
    m, straight, y_fine = scene.motion, pose.p, y
    for _ in range(ROUNDS):
        X = scene.average_coordinates(np.concatenate([pose.columns(load), followed[:, :, None]], axis=2))
        A = X.reshape(-1, X.shape[2])
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        x = (
            np.linalg.lstsq(A / size, m.subtract_period_mean(m.average_blocks(y_fine)).reshape(-1), rcond=1e-10)[0]
            / size
        )
        pose = _BentArm(pose.robot, pose.T_tool, pose.q, load * np.clip(x[9:15], 0.0, None))
        y_fine = y - (pose.p - straight) + np.einsum("nci,ni->nc", pose.J, pose.bent)
    return y_fine, pose


def estimate_encoder_delays(scene: MotionModel, commanded_angles: Array) -> Array:
    """Estimate the delay of each encoder behind its command.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        commanded_angles: (M, n) commanded joint angles, rad.

    Returns:
        (n,) s; 0 if an encoder follows without delay.
    """
    m = scene.motion
    speed = m.differentiate(commanded_angles)
    out = np.zeros(commanded_angles.shape[1])
    for j in range(commanded_angles.shape[1]):
        behind = commanded_angles[:, j] - m.q[:, j]
        if (
            np.std(behind) > thresholds.LIMITS.reading_step
            and np.ptp(commanded_angles[:, j]) > thresholds.LIMITS.joint_motion
        ):
            x = np.stack([speed[:, j], np.ones(len(behind))], axis=1)
            out[j] = float(np.linalg.lstsq(x, behind, rcond=None)[0][0])
    return out


def _find_late_encoders(y: Array, base: Array, scene: MotionModel, followed: Array, lag: Array) -> list[Finding]:
    """Return findings on encoders that lag the command while the TCP does not: a clock error, not a servo lag."""
    moving = lag[np.abs(lag) > 0]
    if not len(moving) or abs(float(np.mean(moving))) < thresholds.LIMITS.delay:
        return []
    own = scene.average_coordinates(followed[:, :, None])
    X = np.concatenate([base, own], axis=2).reshape(-1, base.shape[2] + 1)
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    share = float((np.linalg.lstsq(X / size, y.reshape(-1), rcond=1e-10)[0] / size)[-1])
    if share > thresholds.SHARES.minority or np.std(moving) > thresholds.SHARES.minority * abs(float(np.mean(moving))):
        return []
    late, sigma = 1e3 * float(np.mean(moving)), 1e3 * float(np.std(moving)) / np.sqrt(len(moving))
    # predicted from the encoders as recorded, and with a corrected clock, that is from the command
    group, even = scene.motion.group, np.ones(3)
    count = 3.0 * np.unique(group, return_counts=True)[1]
    before, after = (
        1e3 * np.sqrt(compute_holdout_squares(e, base, group, even) / count) for e in (y - own[:, :, 0], y)
    )
    return [
        Finding(
            effect=CLOCK_EFFECT.name,
            location="sensor:q",
            law=CLOCK_EFFECT.delay_laws[0].name,
            equation="q_recorded(t) = q(t − d)",
            note="in proportion to speed",
            one_of=((CLOCK_EFFECT.name, "sensor:q"),),
            parameters={
                "late": EstimatedValue(
                    late, "ms", (late - 1.645 * sigma, late + 1.645 * sigma), (late - 1.96 * sigma, late + 1.96 * sigma)
                )
            },
            before=float(np.median(before)),
            after=float(np.median(after)),
            p_value=compute_sign_test(before, after),
            correction=RecordCorrection(CLOCK_EFFECT.name, "sensor:q", {"late_ms": late}),
            record=True,
        )
    ]


def _build_servo_hypotheses(
    scene: MotionModel, fit: ExplainedPower, robot: Robot, commanded_angles: Array, followed: Array, lag: Array
) -> list[EffectHypothesis]:
    """Return the servo-lag laws: as the encoders show it, and one delay common to all joints."""
    m = scene.motion
    T_tool = scene.cell.tool.T_flange_tcp
    tip = robot.compute_fk(commanded_angles, T_tool)[:, :3, 3]

    def late(d: float) -> Array:
        return m.subtract_period_mean(
            m.average_blocks(robot.compute_fk(m.delay_cubic(commanded_angles, d), T_tool)[:, :3, 3] - tip)
        )

    best = find_best_delay(lambda d: fit.misfit(late(d)))
    return build_command_delay_hypotheses(scene, late, best, scene.average_coordinates(followed[:, :, None]), lag)
