"""Recorded drive torques beyond the joint's own motor model: gain errors, and shafts that run through another joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import COLUMN, parse_joint_location, parse_location
from machopt.effects import parameter_conversion, registry
from machopt.effects.joint.drive_gain import DriveGainError
from machopt.effects.protocol import Effect, MotorLaw, MotorLoading
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    Quantity,
    RecordCorrection,
    Shape,
)
from machopt.measurement.diagnosis.dynamic.friction import (
    IMMEDIATE_REVERSAL,
    PATH,
    SMOOTH,
    FrictionReversal,
    compute_friction_direction,
    compute_reversal_signal,
    fit_least_squares,
)
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import build_ratio_refinement
from machopt.numerics.array_types import Array

ROUNDS = 3  # alternating fits of load and gain
MAX_SHAPES = 3  # most shapes of a law in the search, because columns of two joints use much memory


def build_drive_hypotheses(
    scene: MotionModel,
    paths: Sequence[FrictionReversal],
    torque: Array,
    other_columns: Array,
    carried: Mapping[int, Array],
) -> list[EffectHypothesis]:
    """Build the hypotheses of all motor laws at all places with moving joints.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        paths: Reversal shape of the base friction of each joint.
        torque: (N, n) measured minus predicted torque, N·m.
        other_columns: (N, n, p) columns of mass errors that the torque may contain.
        carried: (M,) torque of each joint (0-based) with an additional load, N·m: see
            :func:`compute_gain_error_torque`.

    Returns:
        The hypotheses.
    """
    assert scene.predicted is not None  # guaranteed by the torque channel
    out = []
    for effect in registry.select_motor_effects():
        for where in effect.search_places:
            joints = _parse_joints(where)
            if _has_moving_joints(scene, joints):
                last = _LastJointTorque(
                    scene, joints, paths[joints[-1]], torque[:, joints[-1]], other_columns[:, joints[-1]]
                )
                laws = [law for law in effect.motor_laws if not (scene.free_gains and law.absorbed_by_gain)]
                own = scene.predicted[:, sorted(set(joints))]
                out += [_build_drive_hypothesis(scene, effect, where, law, joints, last, own) for law in laws]
                for law in laws:
                    if law.absorbed_by_gain and joints[-1] in carried:
                        more = _build_drive_hypothesis(
                            scene, effect, where, law, joints, last, carried[joints[-1]][:, None]
                        )
                        out.append(replace(more, law=f"{more.law}, of what it carries with the load besides"))
    return out


def compute_gain_error_torque(
    scene: MotionModel, y: Array, base: Array, load: Array, lifted: Array
) -> dict[int, Array]:
    """Compute the torque that each joint would carry if its drive gain were wrong and an unknown load were at the
    flange.

    A gain error also scales the torque of the load. With a gain of one half and an equal load, a law on the stated
    masses alone would miss a quarter of the torque. The load is estimated from all joints together with the gain, in
    a few iterations.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        y: (N, D) measured minus predicted torque of the problem.
        base: (N, D, P) base columns.
        load: (M, n, 4) torque per kg and kg·m at the flange, N·m.
        lifted: (N, D, 4) the same as columns of the problem.

    Returns:
        (M,) N·m for each joint (0-based).
    """
    assert scene.predicted is not None  # guaranteed by the torque channel
    X = np.concatenate([base, lifted], axis=2)
    X = X.reshape(-1, X.shape[2])
    size = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)
    Q, R = np.linalg.qr(X / size)
    flat = y.reshape(-1)
    rest = flat - Q @ (Q.T @ flat)
    out = {}
    for j in range(scene.joints):
        if not scene.is_joint_moving(j) or scene.prismatic[j]:
            continue
        carried = scene.predicted[:, j]
        for _ in range(ROUNDS):
            column = scene.column(j, carried).reshape(-1)
            alone = column - Q @ (Q.T @ column)
            power = float(alone @ alone)
            gain = float(alone @ rest) / power if power > 0.0 else 0.0
            x = np.linalg.lstsq(R, Q.T @ (flat - gain * column), rcond=1e-10)[0] / size
            carried = scene.predicted[:, j] + load[:, j] @ x[base.shape[2] :]
        out[j] = carried
    return out


def _parse_joints(where: str) -> tuple[int, ...]:
    """Return the 0-based joints of a torque column, a joint or a pair of joints."""
    at = parse_location(where)
    return (int("".join(filter(str.isdecimal, at.which))) - 1,) if at.kind == COLUMN else parse_joint_location(where)


def _has_moving_joints(scene: MotionModel, joints: tuple[int, ...]) -> bool:
    return all(
        j < scene.joints and scene.is_joint_moving(j) and not scene.prismatic[j] and j not in scene.joints_without_gain
        for j in joints
    )


class _LastJointTorque:
    """Torque of the last joint of a place, without the parts that base and masses explain."""

    def __init__(
        self, scene: MotionModel, joints: tuple[int, ...], turn: FrictionReversal, torque: Array, beside: Array
    ) -> None:
        m, j = scene.motion, joints[-1]
        speeds = [m.v[:, k] for k in sorted(set(joints))]
        own = np.stack([np.ones(len(m.q)), compute_friction_direction(scene, j, turn), m.a[:, j], *speeds], axis=1)
        rest = np.concatenate([m.subtract_period_mean(m.average_blocks(own)), beside], axis=1)
        size = np.linalg.norm(rest, axis=0)
        self.scene, self.turn = scene, turn
        self._base, _ = np.linalg.qr(rest[:, size > 0] / size[size > 0])
        self._torque = self._compute_own_torque(torque)

    def _compute_own_torque(self, x: Array) -> Array:
        return np.asarray(x - self._base @ (self._base.T @ x))

    def gain(self, signal: Array) -> float:
        """Return the power that a signal of the joint explains.

        Args:
            signal: (M, p) signal.

        Returns:
            Reduction of the residual sum of squares.
        """
        m = self.scene.motion
        left, _ = fit_least_squares(
            self._torque, self._compute_own_torque(m.subtract_period_mean(m.average_blocks(signal)))
        )
        return float(self._torque @ self._torque - left @ left)

    def compute_friction_direction(self, v: Array) -> Array:
        """Return the direction of the motor's friction by the motor speed, with the reversal shape that fits the
        torque best.

        The reversal shape of the base was fitted to the joint speed, which differs from the motor speed.

        Args:
            v: (M,) motor speed, rad/s.

        Returns:
            (M,) −1 to 1.
        """
        return self._turning(v)[1]

    def is_immediate_reversal(self, v: Array) -> bool:
        """Return whether the friction reverses at once or over a displacement, instead of over a range of speeds.

        Args:
            v: (M,) motor speed, rad/s.

        Returns:
            True for a discontinuity.
        """
        _, over_speed = self._turning(v)[0]
        return over_speed == 0.0

    def _turning(self, v: Array) -> tuple[FrictionReversal, Array]:
        turns = dict.fromkeys((self.turn, IMMEDIATE_REVERSAL, PATH, SMOOTH))
        each = [(t, compute_reversal_signal(self.scene, v, t)) for t in turns]
        return max(each, key=lambda e: self.gain(e[1][:, None]))


def _build_drive_hypothesis(
    scene: MotionModel,
    effect: Effect,
    where: str,
    law: MotorLaw,
    joints: tuple[int, ...],
    last: _LastJointTorque,
    needed: Array,
) -> EffectHypothesis:
    m, own = scene.motion, sorted(set(joints))
    seen = MotorLoading(
        required_torque=needed,
        speed=m.v[:, own],
        acceleration=m.a[:, own],
        compute_friction_direction=last.compute_friction_direction,
    )

    def columns(shape: Shape) -> Array:
        parts = law.columns(np.array(shape), seen)
        return np.asarray(np.sum([scene.column(j, parts[:, k]) for k, j in enumerate(own)], axis=0))

    def kept() -> tuple[Shape, ...]:
        """Those that the last joint shows most of."""
        grid = law.grid()
        if len(grid) <= MAX_SHAPES:
            return grid
        best = sorted(grid, key=lambda s: -last.gain(law.columns(np.array(s), seen)[:, -1]))
        return tuple(s for s in grid if s in best[:MAX_SHAPES])

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape), seen)

    def fix(x: Array, shape: Shape) -> RecordCorrection:
        return RecordCorrection(effect.file_word, where, {k: q.value for k, q in sizes(x, shape).items()})

    lower = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, len(law.coefficients)))
    grid = kept()

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=columns,
        quantities=sizes,
        least_size=100.0 * thresholds.SHARES.drive_gain if isinstance(law, DriveGainError) else 0.0,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        family="drive",
        correction=fix,
        note=law.note,
        penalty=law.penalty,
        refinement=build_ratio_refinement(law.grid()),
        has_jumps=bool(law.shape) and any(_has_friction_jump(law, shape, seen, last) for shape in grid),
    )


def _has_friction_jump(law: MotorLaw, shape: Shape, motor_loading: MotorLoading, last: _LastJointTorque) -> bool:
    """Return whether the friction of a law at a shape is discontinuous at motor reversal."""
    speeds: list[Array] = []

    def way(v: Array) -> Array:
        speeds.append(v)
        return v

    law.columns(np.array(shape), replace(motor_loading, compute_friction_direction=way))
    return any(last.is_immediate_reversal(v) for v in speeds)
